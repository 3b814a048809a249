"""The posterior of one case, or of all together, from recorded trials."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Calibration, Experiment, calibrate, calibrate_nominal, learn_noise, middle
from bayes_damper.calibration.cases import by_case_in_words, one_damping_in_words
from bayes_damper.calibration.correlated_noise import FittedNoise, fit_with_noise
from bayes_damper.calibration.experiment import trial_label
from bayes_damper.calibration.influence import comparison, influence, without
from bayes_damper.calibration.noise_spread import spread_in_words
from bayes_damper.calibration.posterior import RecordPosterior
from bayes_damper.calibration.scatter import (
    odd_values_in_words,
    scatter_in_words,
    scatter_shown,
    unseen_in_words,
    with_sizes_of_intervals,
)
from bayes_damper.effects import all_effects, names_in
from bayes_damper.fit.draw import DRAWN, Report, number_of, sampled, shaped
from bayes_damper.fit.drawings import draw_case, draw_records
from bayes_damper.fit.entry import (
    KEPT_DRAWS,
    as_chains,
    attributes_of,
    derived,
    entry_of,
    one_chain,
    shares_left,
    tell_priors,
    write_draws,
)
from bayes_damper.fit.plan import check_room, possible, recorded_experiment
from bayes_damper.rig.parameters import OF_EFFECT, unit_of
from bayes_damper.rig.units import effect_unit, in_words_of
from bayes_damper.runs.contents.fit import BestFitEntry, CaseEntry, EvidenceEntry, FitPlan, TrialUnknown
from bayes_damper.runs.execution import processes
from bayes_damper.runs.memory import shortage
from bayes_damper.runs.progress import NOTICE
from bayes_damper.runs.threads import kernel_threads
from bayes_damper.sampling import Sampling, resampled_start
from bayes_damper.sampling.arviz_adapter import hdi
from bayes_damper.sampling.bridge import bridge
from bayes_damper.sampling.prior_sensitivity import of_standard_draws
from bayes_damper.text import missed, misses

Array = NDArray[np.float64]
PROPOSALS = 4000
"""Points of bridge sampling for the evidence."""
_CHOICES = 4
"""Times that the formula of an effect is chosen, each under the noise that the last choice leaves, until it stays."""


def fit_recorded_cases(folder: Path, report: Report, *, name: str, plan: FitPlan) -> Any:
    """Task: fit one case of a campaign, or all together (`name` "joint"); its entry of summary.json."""
    with kernel_threads(processes()):
        return _fitted(folder, report, name, plan)


def _fitted(folder: Path, report: Report, name: str, plan: FitPlan) -> CaseEntry:
    """The entry of summary.json; files of the draws and figures are in the folder then."""
    experiment, kind = recorded_experiment(plan, None if name == "joint" else name)
    report(0.0, shortage(sum(t.y.size for t in experiment.trials)) or "finding the best fit")
    effect = plan.get("effect")
    found = fit_with_effect(experiment, effect, plan["effects"]) if effect else calibrate_nominal(experiment)
    begin_with = with_sizes_of_intervals(found)
    news = _News(report, plan)
    report = news.report
    noise = fit_with_noise(experiment, plan.get("noise", "auto"), partial(report, 0.0), begin_with, news.excess)
    if not news.notice and misses({"noise": noise.to_json("")}):
        news.excess(any(c.repeats is not None for c in noise.channels))
    best = noise.fit
    declared = () if best.problem.effect is None else best.problem.effect.parameters
    own = {OF_EFFECT + p.name: effect_unit(p.unit, kind, experiment.quantity) for p in declared}

    def units(name: str) -> str:
        name = "sigma1" if name.startswith("offset") else name
        return own.get(name) or unit_of(name, kind, experiment.quantity)

    freedom = noise.freedom if noise.kind == "student" else None
    posterior = RecordPosterior(best, power=noise.power, freedom=freedom)
    rng = np.random.default_rng([plan["seed"], number_of(name)])

    begin = partial(resampled_start, posterior, posterior.start, posterior.covariance, rng)
    sampling = sampled(posterior, folder, report, plan, begin)
    draws = {key: shaped(value, sampling) for key, value in posterior.values(sampling.flat()).items()}
    constants = {key: np.full(1, value) for key, (value, _) in experiment.constants.items() if key not in draws}
    draws |= derived(constants | draws)
    report(DRAWN, "sampling done; next: predictions, evidence, files, figures")
    kept = sampling.flat(KEPT_DRAWS)
    likelihood, drawn = posterior.evaluated(kept, rng)
    nuisances = _trial_draws(posterior, drawn)
    few = sampling.flat(60)
    bands = posterior.predictive(few, rng)
    entry = entry_of(draws, shares_left(posterior.names, sampling.flat()), sampling, units)
    labels = {i: trial_label(experiment.trials[i]) for i in posterior.trials}
    report(0.76, "predictions done; next: influence of each trial, evidence, files, figures")
    entry["noise"] = noise.to_json(units("sigma1"))
    entry["scatter"] = scatter_shown(best, units("sigma1"))
    entry["sentences"] += [
        *spread_in_words(best.problem.experiment),
        *noise.sentences(units("sigma1")),
        *scatter_in_words(best),
        *unseen_in_words(best),
    ]
    entry["sentences"] += [*odd_values_in_words(best), *one_damping_in_words(best), *by_case_in_words(found)]
    entry |= _trials_apart(experiment, noise, labels, plan.get("noise", "auto"))
    entry["prior_sensitivity"] = of_standard_draws(posterior.names, sampling.flat(4 * KEPT_DRAWS))
    report(0.8, "influence of each trial done; next: evidence, files, figures")
    entry["log_evidence"] = _evidence(posterior, sampling, rng)
    entry["trials"] = _trials_entry(nuisances, labels, units)
    entry["best_fit"] = _best_fit_entry(best, plan.get("effect"), kind)
    groups: dict[str, Mapping[str, Array]] = {
        "trial_posterior": _per_trial(nuisances, labels, sampling),
        "prior": one_chain(posterior.values(rng.standard_normal((2000, posterior.ndim)))),
        "posterior_predictive": {labels[i]: y[None] for i, y in bands.items()},
        "log_likelihood": {"trials": as_chains(likelihood + posterior.constant, sampling)},
        "observed_data": {labels[i]: experiment.trials[i].y for i in posterior.trials},
        "constant_data": {labels[i]: experiment.trials[i].times for i in posterior.trials},
    }
    assumed = tell_priors(entry, groups["prior"], constants)
    report(0.84, "evidence done; next: files, figures")
    names = {"trials": json.dumps([labels[i] for i in posterior.trials])}
    write_draws(folder, draws, sampling, entry["parameters"], groups, attributes_of(plan, name) | names)
    report(0.87, "files written; next: figures")
    title = f"{plan['name']}, {'all cases' if name == 'joint' else f'case {name}'}"
    draw_case(folder, title, draws, sampling, entry, assumed, units)
    draw_records(folder, experiment, bands, sampling.converged, units("sigma1"))
    return entry


def _trials_entry(
    nuisances: Mapping[int, Mapping[str, Array]], labels: Mapping[int, str], units: Callable[[str], str]
) -> dict[str, dict[str, TrialUnknown]]:
    return {
        labels[i]: {
            key: {"mean": float(x.mean()), "sd": float(x.std()), "hdi90": list(hdi(x)), "unit": units(key)}
            for key, x in values.items()
        }
        for i, values in nuisances.items()
    }


def _per_trial(
    nuisances: Mapping[int, Mapping[str, Array]], labels: Mapping[int, str], sampling: Sampling
) -> dict[str, Array]:
    """Draws of what each trial has for itself, by name and trial."""
    return {
        f"{key}[{labels[i]}]": as_chains(x, sampling) for i, values in nuisances.items() for key, x in values.items()
    }


def _best_fit_entry(best: Calibration, effect: str | None, kind: str) -> BestFitEntry:
    declared = () if best.problem.effect is None else best.problem.effect.parameters
    return {
        "chi2": best.chi2,
        "readings": best.problem.n_data,
        "log_evidence_laplace": best.log_evidence,
        "noise_learnt": list(best.problem.noise.total),
        "noise_correlation": list(best.problem.noise.phi),
        "constants_pulled": best.pulled,
        "effect": effect,
        "formula": None if best.problem.effect is None else best.problem.effect.formula,
        "meanings": {
            OF_EFFECT + p.name: in_words_of(p.meaning[0].lower() + p.meaning[1:].rstrip("."), kind)
            for p in declared
            if p.meaning
        },
    }


@dataclass
class _News:
    """Progress of a case with a notice that the model misses something, from when that is known: nobody need wait."""

    to: Report
    plan: FitPlan
    notice: str = ""

    def excess(self, repeats: bool) -> None:
        """The fit leaves more than the noise."""
        command = f"bayes-damper diagnose {shlex.quote(self.plan['campaign'])}"
        said = missed(repeats, self.plan["effect"])
        self.notice = said if self.plan["effect"] else f"{said.partition(':')[0]}: stop with Ctrl-C and run `{command}`"

    def report(self, share: float, text: str) -> None:
        """A stage of the fit."""
        self.to(share, text + NOTICE + self.notice if self.notice else text)


def fit_with_effect(experiment: Experiment, effect: str | Sequence[str], folder: str | None = None) -> Calibration:
    """The best fit of the model with one effect or two ("A+B"), in the formulas with the largest evidence.

    Raises
    ------
    InputError
        if these trials cannot show an effect, or no kernel has room for two.
    """
    from bayes_damper.diagnosis.pairs import fit_together
    from bayes_damper.diagnosis.search import Screen, fit_variant, screen_variant

    names = names_in(effect)
    pool = possible(experiment, names, all_effects(folder))
    check_room(pool)
    nominal = calibrate_nominal(experiment)
    screen = Screen(nominal)
    found = [fit_variant(nominal, e, v, screen_variant(screen, v), len(v.starts)) for e, v in pool]
    fits = [fit_together(nominal, found)] if len(names) > 1 else [c.fit for c in found if c.fit is not None]
    # Under the noise of the nominal model, which holds all that it misses, formulas that differ by far seem alike.
    chosen = max(fits, key=lambda f: f.log_evidence)
    for _ in range(_CHOICES):
        before, noise = chosen.problem.effect, learn_noise(chosen)
        fits = [calibrate(f.problem.with_noise(noise), [f.q], eta=f.eta, anneal=False) for f in fits]
        chosen = max(fits, key=lambda f: f.log_evidence)
        if chosen.problem.effect is before:
            break
    return chosen


def _trials_apart(experiment: Experiment, noise: FittedNoise, labels: Mapping[int, str], kind: str) -> CaseEntry:
    """Entries `influence` and `unlike_repeats` of summary.json."""
    names = noise.fit.problem.names
    moved = {labels[i]: shift for i, shift in influence(noise.fit).items()}
    found = noise.unlike
    entry: CaseEntry = {
        "influence": {
            label: {
                "moves_most": names[k],
                "shift_sd": float(shift[k]),
                "shifts_sd": {n: float(x) for n, x in zip(names, shift, strict=True)},
            }
            for label, shift in moved.items()
            if len(shift)
            for k in [int(np.argmax(np.abs(shift)))]
        },
        "unlike_repeats": None,
    }
    if found:
        other = without(experiment, tuple(u.trial for u in found), kind)
        entry["unlike_repeats"] = {
            "trials": [
                {"trial": labels[u.trial], "residual_power": u.power, "or_its_only_repeat": u.alone} for u in found
            ],
            "answers": None if other is None else comparison(noise.fit, other.fit),
        }
    return entry


def _evidence(posterior: RecordPosterior, sampling: Sampling, rng: np.random.Generator) -> EvidenceEntry:
    """Entry `log_evidence` of summary.json: of the readings, all unknowns integrated out, in nats."""
    found = bridge(posterior, sampling.draws, sampling.log_prob, rng, proposals=PROPOSALS)
    constant = float(posterior.constant.sum())
    return {
        "value": found.log_z + constant,
        "error": found.error,
        "health": found.health,
        "spread_of_halves": found.spread,
        "evaluations": found.evaluations,
        "sentence": found.words(constant),
    }


def _trial_draws(posterior: RecordPosterior, drawn: Mapping[int, Array]) -> dict[int, dict[str, Array]]:
    """What each trial has for itself, from draws of its nuisances in standard coordinates: trial -> name -> (n,).

    Release angle (rad), instant (s), parameters relative to those of all trials (ln_mu, ln_k1t), gains and offsets of
    channels, and what the prior file gives to trials. Waves of a drift or a hum and noise of inputs are left out.
    """
    out: dict[int, dict[str, Array]] = {}
    problem = posterior.problem
    for part in posterior.parts:
        for k, i in enumerate(part.group.trials):
            out[i] = {}
            for m, (name, mean, sd) in enumerate(part.group.nuisances):
                if name.startswith(("drift", "hum", "input")):
                    continue
                within = np.clip(drawn[i][:, m], part.group.lower[k, m], part.group.upper[k, m])  # no time is negative
                value = mean[k] + sd[k] * within
                own = name.removeprefix("ln_")
                if own != name and problem.experiment.levels.get(own) == "trial":
                    case = problem.experiment.trials[i].case
                    out[i][own] = middle(problem.prior(own, case)) * np.exp(value)
                else:
                    out[i][name] = value
    return {i: values for i, values in out.items() if values}
