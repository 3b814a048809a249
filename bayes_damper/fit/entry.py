"""What is written of a case: its draws in posterior.nc and its entry in summary.json."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bayes_damper.fit.plan import kept
from bayes_damper.fit.summary import summarise
from bayes_damper.rig.parameters import unit_of
from bayes_damper.runs.contents.fit import CaseEntry, FitPlan, ParameterEntry
from bayes_damper.runs.provenance import provenance
from bayes_damper.sampling import Sampling, arviz_adapter
from bayes_damper.sampling.arviz_adapter import hdi

Array = NDArray[np.float64]
Units = Callable[[str], str]
KEPT_DRAWS = 4000
"""Draws of each case that go into posterior.nc: thinned so that they are all but independent."""


def derived(draws: Mapping[str, Array]) -> dict[str, Array]:
    """Combinations that free decay determines better than their factors."""
    if not {"mu", "N0", "R"} <= set(draws):
        return {}
    torque = draws["mu"] * draws["N0"] * draws["R"]
    found = {"friction_torque": torque}
    if "J1" in draws:
        found["friction_torque_per_inertia"] = torque / draws["J1"]
    return found


def thinned_draws(draws: Mapping[str, Array], sampling: Sampling) -> dict[str, Array]:
    """The kept draws by ensemble: name -> (ensembles, kept / ensembles)."""
    count = _kept(sampling)
    index = np.linspace(0, sampling.draws.shape[1] * sampling.draws.shape[2] - 1, count).round().astype(int)
    return {key: value.reshape(value.shape[0], -1)[:, index] for key, value in draws.items()}


def _kept(sampling: Sampling) -> int:
    ensembles, steps, walkers = sampling.log_prob.shape
    return int(min(KEPT_DRAWS // ensembles, steps * walkers))


def one_chain(values: Mapping[str, Array]) -> dict[str, Array]:
    """Draws that have no ensembles, as a single one."""
    return {key: np.asarray(value)[None] for key, value in values.items()}


def write_draws(
    folder: Path,
    draws: Mapping[str, Array],
    sampling: Sampling,
    diagnostics: Mapping[str, ParameterEntry],
    groups: Mapping[str, Mapping[str, Array]],
    attributes: Mapping[str, str],
) -> None:
    """Write posterior.nc of one case; the groups are those of ArviZ."""
    found = arviz_adapter.results(
        draws, log_prob=sampling.log_prob, diagnostics=diagnostics, groups=groups, attributes=dict(attributes)
    )
    arviz_adapter.write(found, folder / "posterior.nc")


def as_chains(values: Array, sampling: Sampling) -> Array:
    """(n, ...) of kept draws as (ensembles, n / ensembles, ...)."""
    ensembles = sampling.draws.shape[0]
    per = len(values) // ensembles
    return values[: per * ensembles].reshape(ensembles, per, *values.shape[1:])


def entry_of(
    draws: Mapping[str, Array],
    prior_shares: Mapping[str, float],
    sampling: Sampling,
    units: Units = unit_of,
) -> CaseEntry:
    """The entry of summary.json for one run."""
    verdict, outcomes = sampling.verdict, sampling.outcomes
    failed = {name: count for name, count in outcomes.items() if name != "COMPLETED" and count}
    sentences = list(verdict.sentences)
    if failed:
        counts = ", ".join(f"{count} {name}" for name, count in failed.items())
        sentences.append(f"Failed simulations, which got no weight: {counts} of {sum(outcomes.values())}.")
    return {
        "converged": verdict.converged,
        "parameters": summarise(draws, {name: units(name) for name in draws}, prior_shares),
        "sentences": sentences,
        "steps": verdict.steps,
        "autocorrelation_steps": float(np.max(verdict.tau)),
        "acceptance": [float(a) for a in sampling.acceptance],
        "evaluations": sampling.evaluations,
        "outcomes": dict(outcomes),
        "stranded_walkers": [list(pair) for pair in verdict.stranded],
    }


def tell_priors(
    entry: CaseEntry, draws: Mapping[str, Array], constants: Mapping[str, Array] | None = None
) -> dict[str, Array]:
    """Adds to each parameter of an entry of summary.json what was assumed about it, from draws of its prior.

    Those draws, by parameter: of what was free and of what derives from it.
    """
    before = {
        name: np.ravel(values)
        for name, values in {**draws, **derived({**(constants or {}), **draws})}.items()
        if name in entry["parameters"] and np.isfinite(values).all() and np.ptp(values) > 0.0
    }
    for name, values in before.items():
        entry["parameters"][name]["prior"] = {"median": float(np.median(values)), "hdi90": list(hdi(values))}
    return before


def shares_left(names: Sequence[str], points: Array) -> dict[str, float]:
    """Posterior variance of each standard coordinate: what is left of the prior's own 1."""
    return {name: float(min(1.0, points[:, i].var())) for i, name in enumerate(names)}


def attributes_of(plan: FitPlan, name: str) -> dict[str, str]:
    """What posterior.nc says of where it comes from."""
    return {
        "campaign": plan["name"],
        "case": name,
        "plan": json.dumps(kept(plan)),
        "provenance": json.dumps(provenance()),
    }
