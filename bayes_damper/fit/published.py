"""The posterior of a case from its published features."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bayes_damper.fit.draw import DRAWN, Report, number_of, sampled, search, shaped
from bayes_damper.fit.drawings import draw_case
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
from bayes_damper.priors.files import PriorSet, priors_from_dict
from bayes_damper.published.measurements import load_published
from bayes_damper.published.posterior import (
    Coordinates,
    Datum,
    FeaturePosterior,
    damping_pairs,
    data_of,
    feature_sheets,
)
from bayes_damper.runs.contents.fit import CheckEntry, FitPlan
from bayes_damper.sampling.arviz_adapter import hdi


def published_posterior(case: str, priors: PriorSet, normal_force: str = "linear") -> FeaturePosterior:
    """The posterior of one thesis case: six published numbers, priors of the thesis's rig."""
    return feature_posterior(list(data_of(load_published(), case)), case, priors, normal_force)


def feature_posterior(
    data: Sequence[Datum], case: str, priors: PriorSet, normal_force: str = "linear"
) -> FeaturePosterior:
    """The posterior of one thesis case from any numbers in place of the published."""
    own = priors.for_case(case)
    typical = own.medians()
    coordinates = Coordinates(own.free, own.fixed, own.tied, damping_pairs(typical), feature_sheets(data, typical))
    return FeaturePosterior(data, coordinates, normal_force, case)


def fit_published_case(folder: Path, report: Report, *, name: str, plan: FitPlan) -> Any:
    """Task: fit one thesis case and write its files; its entry of summary.json."""
    posterior = published_posterior(name, priors_from_dict(plan["priors"] or {}), plan["normal_force"] or "linear")
    rng = np.random.default_rng([plan["seed"], number_of(name)])
    standard = posterior.coordinates.standard
    sampling = sampled(posterior, folder, report, plan, lambda: search(posterior, rng), standard)
    flat = sampling.flat()
    draws = {key: shaped(value, sampling) for key, value in posterior.coordinates.values(flat).items()}
    draws = {key: draws[key] for key in posterior.names} | derived(draws)
    report(DRAWN, "sampling done; next: predictions, files, figures")
    kept = sampling.flat(KEPT_DRAWS)
    features, likelihood = posterior.predict(kept), posterior.log_likelihood(kept)
    noise = rng.standard_t([d.n - 1.0 for d in posterior.data], size=features.shape)
    replicated = features + noise * [d.standard_error for d in posterior.data]
    checks: list[CheckEntry] = [
        {
            "name": f"case {name}: {d.name}",
            "unit": {"log_decrement": "1", "period": "s", "max_acceleration": "rad/s^2"}[d.quantity],
            "measured": d.value,
            "standard_error": d.standard_error,
            "median": float(np.nanmedian(features[:, i])),
            "hdi50": list(hdi(features[:, i], 0.5)),
            "hdi90": list(hdi(features[:, i], 0.9)),
            "percentile": float(100.0 * np.mean(replicated[:, i] < d.value)),
        }
        for i, d in enumerate(posterior.data)
    ]
    groups = {
        "prior": one_chain(posterior.coordinates.values(posterior.coordinates.draw(rng, 2000))),
        "posterior_predictive": {"features": as_chains(replicated, sampling)},
        "log_likelihood": {"features": as_chains(likelihood, sampling)},
        "observed_data": {"features": np.array([d.value for d in posterior.data])},
    }
    names = {"features": json.dumps([d.name for d in posterior.data])}
    entry = entry_of(draws, shares_left(posterior.names, standard(flat)), sampling)
    assumed = tell_priors(entry, groups["prior"])
    report(0.8, "predictions done; next: files, figures")
    write_draws(folder, draws, sampling, entry["parameters"], groups, attributes_of(plan, name) | names)
    entry["predictive"] = checks
    report(0.85, "files written; next: figures")
    draw_case(folder, f"thesis, case {name}", draws, sampling, entry, assumed)
    return entry
