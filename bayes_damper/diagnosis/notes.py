"""What the data of a campaign cannot show and why, in sentences."""

from __future__ import annotations

import math

import numpy as np

from bayes_damper.calibration import Calibration, Experiment
from bayes_damper.calibration.cases import by_case_in_words, damping_in_words
from bayes_damper.calibration.noise_spread import spread_in_words
from bayes_damper.calibration.scatter import odd_values_in_words, scatter_in_words
from bayes_damper.campaign.records import DERIVATIVE
from bayes_damper.diagnosis.remainder import oddness, unlike_in_words
from bayes_damper.diagnosis.search import Candidate
from bayes_damper.diagnosis.sites import SiteMap
from bayes_damper.diagnosis.verdict import Answers
from bayes_damper.effects import EFFECTS
from bayes_damper.priors.distributions import from_standard
from bayes_damper.rig.parameters import OF_EFFECT

ODD_SHAPE = 3.0  # nats by which a shape speaks for something else, from which that is said
ONE_AMPLITUDE = 1.25  # ratio of the largest to the smallest first swing up to which trials have one amplitude


def notes_on(
    experiment: Experiment, fit: Calibration, named: Calibration | None, answers: Answers, place: SiteMap
) -> list[str]:
    """What the data cannot show and why.

    named : the fit with the effect that the verdict names; place : where the nominal model's gap lies.
    """
    notes = spread_in_words(experiment)
    if not experiment.coupled:
        notes.append("There are no coupled trials, so nothing can be said about the interface or the secondary.")
    if len(fit.problem.trials) == 1:
        kept_back = ", and another held out" if len(experiment.trials) > 1 else ""
        notes.append(
            f"There is only one trial to fit{kept_back}, so nothing shows which of its features would repeat; "
            "add repeats."
        )
    elif not any(
        len({t.number for t in experiment.trials if (t.case, t.coupled) == key}) > 1
        for key in {(t.case, t.coupled) for t in experiment.trials}
    ):
        notes.append(
            "There are no repeats, so the noise is estimated from the fast content of the records; repeat a case."
        )
    judged = fit if named is None else named  # what the answer explains does not scatter
    notes += [
        *damping_in_words(judged),
        *scatter_in_words(judged),
        *by_case_in_words(judged, missing=answers.verdict == "unknown"),
        *odd_values_in_words(judged),
        *unlike_in_words(judged),
        *symmetries(experiment),
    ]
    notes += time_or_amplitude(experiment, answers)
    still = {} if named is None else named.pulled
    priors = {} if named is None else {c.name: c.prior for c in named.problem.coordinates}
    for name, z in still.items():
        value = float(from_standard(priors[name], z))
        notes.append(
            f"With {answers.verdict} in the model, {name} still differs from {_origin(name)} by {z:+.1f} standard "
            f"deviations ({value:.4g}): a second cause, or a typo. Measure it again."
        )
    for name, z in fit.pulled.items() if named is None else ():
        notes.append(
            f"The nominal model fits {name} {z:+.1f} standard deviations from {_origin(name)}: an effect, or a typo."
        )
    if place.torque_site is not None and not place.torque:
        notes.append(
            f"The nominal model leaves up to {100.0 * place.left:.0f} % of a record, too much for a linear estimate of "
            "the missing torque: missing_torque.csv is empty."
            + (" Add what you know of the rig, and diagnose again." if named is None else "")
        )
    if answers.verdict == "unknown" and place.only is not None:
        trials = f"the trials of {place.only}" if place.only.startswith("case ") else f"{place.only} trials"
        notes.append(
            f"The gap looks like a cause at {place.best} that acts only in {trials}: what was different there?"
        )
    if answers.probabilities["none"] > 0.1 and answers.verdict != "none":
        notes.append("The gap is not certain: the answer `none` has a probability above 10 %.")
    hidden = hidden_by(fit)
    if answers.probabilities["none"] > 0.5 and hidden:
        notes += hidden
    return notes


def _origin(name: str) -> str:
    """Where the prior of a constant comes from; inputs and readings are usually apart by some part of an interval."""
    return "its declared or usual value" if name.startswith("lag") else "its declared value"


def imitated_in_words(known: Candidate | None, answers: Answers) -> list[str]:
    """That the leading effect would explain the gap with a shape that such effects do not have."""
    left = answers.left
    if known is None or known.fit is None or answers.verdict != "unknown" or left.odd < ODD_SHAPE or left.share > 0.5:
        return []
    c, z = max(zip(known.fit.problem.coordinates, known.fit.q, strict=True), key=lambda each: oddness(*each))
    if not c.shape:  # that of a pair, in the other effect
        return []
    ratio = float(from_standard(c.prior, z) / from_standard(c.prior, 0.0))
    name = c.parameter.removeprefix(OF_EFFECT)
    meaning = next(p.meaning for p in known.variant.parameters if p.name == name).rstrip(".")
    said = (
        f"{known.effect.name} would close {max(1.0 - left.share, 0.0):.0%} of the gap, but only with `{name}` "
        f"({meaning[0].lower()}{meaning[1:]}) {max(ratio, 1.0 / ratio):.2g} times as "
        f"{'large' if ratio > 1.0 else 'small'} as usual. Something else at the site {known.effect.site} acts like it."
    )
    return [said]


def time_or_amplitude(experiment: Experiment, answers: Answers) -> list[str]:
    """That decays from one amplitude cannot distinguish a law of the motion from a change over the time since release.

    Nothing where the verdict is no such law, where trials begin far from each other, or where a rig is driven.
    """
    law = EFFECTS.get(answers.verdict)
    if law is None or law.site in ("sensor", "release") or law.exact:
        return []
    if any(t.driven for t in experiment.trials):
        return []
    rest = experiment.start == "rest"
    begins = [abs(t.theta0) if rest else float(np.nanmax(np.abs(t.y[0]), initial=0.0)) for t in experiment.trials]
    if min(begins) <= 0.0 or max(begins) > ONE_AMPLITUDE * min(begins):
        return []
    said = (
        f"All trials begin with about the same swing, so a law of the motion such as {law.name} looks like a stiffness "
        "or damping that changes over the time since release (oil that warms, say); a trial from half of that swing "
        "distinguishes them."
    )
    return [said]


def symmetries(experiment: Experiment) -> list[str]:
    """What no record of the campaign could show, in sentences: errors that scale every term of a free decay alike."""
    if experiment.start != "free" or any(t.driven for t in experiment.trials):
        return []
    pendulum = experiment.restoring == "pendulum"  # how far it swings shows in its period
    powers = {"dry friction": 2 - DERIVATIVE[experiment.quantity], "viscous damping": 1}
    also = " and ".join(f"{name} {power} % higher" for name, power in powers.items() if power)
    clock = (
        "A free decay cannot show an error of the clock. If the clock runs 1 % fast, the true stiffness is 2 % higher, "
        f"{also} than found here."
    )
    scale = (
        "A free decay cannot show an error of scale. If the sensor reads 1 % too high, the true dry friction is 1 % "
        "lower than found here."
    )
    shown = [clock] if experiment.quantity == "displacement" or not pendulum else []
    return shown if pendulum else [*shown, scale]


def hidden_by(fit: Calibration) -> list[str]:
    """Constants whose declared uncertainty the campaign cannot reduce, with the accuracy that would help."""
    out = []
    for i, c in enumerate(fit.problem.coordinates):
        if c.role not in ("constant", "stiffness"):
            continue
        sd = math.sqrt(max(fit.covariance[i, i], 0.0))
        middle = float(from_standard(c.prior, 0.0))
        declared = abs(float(from_standard(c.prior, 1.0)) - middle) / max(abs(middle), 1e-300)
        if sd > 0.5:
            out.append(
                f"{c.name} is declared with an uncertainty of {100.0 * declared:.2g} %, which can hide an effect of "
                "that "
                f"size; measure it to {30.0 * declared:.1g} % to rule that out."
            )
    return out
