"""What the table of prior sensitivity says by weights is what a fit under the other prior finds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import parts
import pytest
import synthetic
from calibrated import SEED, SWITCHES

from bayes_damper.calibration import calibrate_nominal, default_priors
from bayes_damper.calibration.posterior import RecordPosterior
from bayes_damper.priors.distributions import LogNormal, from_standard, to_standard
from bayes_damper.sampling import Sampling, resampled_start, sample
from bayes_damper.sampling.prior_sensitivity import WIDTHS, of_standard_draws

KIND = "repeats"
NAMES = ("mu", "k2t", "c2t", "drag", "nu", "c1t", "c3t")


def _fitted(priors: dict[str, Any]) -> tuple[RecordPosterior, Sampling]:
    """Posterior of one short campaign under other priors, sampled until the rule is met."""
    experiment = synthetic.campaign(KIND, SEED, 1).experiment
    experiment = replace(experiment, priors={**experiment.priors, **priors})
    posterior = RecordPosterior(calibrate_nominal(experiment, switches=SWITCHES[KIND]))
    start = resampled_start(posterior, posterior.start, posterior.covariance, np.random.default_rng(7))
    return posterior, sample(posterior, start, seed=7)


def _answer(number: int) -> dict[str, Any]:
    """One row: a parameter whose prior is half or twice as wide, by weights and by a new fit."""
    name, word = NAMES[number // 2], list(WIDTHS)[number % 2]
    posterior, run = _fitted({})
    known = posterior.problem.experiment
    prior = (default_priors(known) | dict(known.priors))[name]
    assert isinstance(prior, LogNormal)
    i = posterior.names.index(name)
    told = of_standard_draws(posterior.names, run.flat())[name][word]
    other, again = _fitted({name: LogNormal(prior.median_value, prior.factor ** WIDTHS[word])})
    found = other.problem.coordinates[i].prior
    before = run.flat()[:, i]
    after = to_standard(prior, from_standard(found, again.flat()[:, i]))
    return {
        "name": name,
        "prior": word,
        "told": {key: told[key] for key in ("shift", "width", "reliable")},
        "found": {
            "shift": float((after.mean() - before.mean()) / before.std()),
            "width": float(after.std() / before.std()),
        },
        "converged": run.converged and again.converged,
    }


@pytest.mark.prove
def test_weights_tell_what_a_new_fit_finds() -> None:
    rows = parts.finish("priors", 2 * len(NAMES), _answer)
    lines = [
        "One short campaign of two coupled repeats (of the calibration). Each prior is made half and twice as wide;",
        "table: what summary.json gives, by weights on the existing draws; new fit: sampled again until",
        "its rule is met. Shift of the mean in posterior standard deviations, and ratio of the standard deviations.",
        "",
        "| parameter | prior | shift, table | new fit | width, table | new fit | marked as reliable |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        a, b = row["told"], row["found"]
        lines.append(
            f"| {row['name']} | {row['prior']} | {a['shift']:+.2f} | {b['shift']:+.2f} | {a['width']:.2f} | "
            f"{b['width']:.2f} | {'yes' if a['reliable'] else 'no'} |"
        )
    sure = [row for row in rows if row["told"]["reliable"]]
    shift, width = (max(abs(row["told"][key] - row["found"][key]) for row in sure) for key in ("shift", "width"))
    verdict = (
        f"{len(sure)} of {len(rows)} rows are marked as reliable; in them shifts differ by at most {shift:.2f} "
        "standard "
        f"deviations, widths by at most {width:.0%}."
    )
    commits = sorted({row["commit"] for row in rows})
    parts.write_page("priors", verdict, lines, {"rows": rows, "commits": commits})
    assert all(row["converged"] for row in rows)
    assert len(sure) >= len(rows) // 2
    assert shift < 0.15
    assert width < 0.15
