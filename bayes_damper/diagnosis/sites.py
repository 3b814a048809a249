"""Where a gap lies, without any library: one evidence per physical site, and the torque that is missing there.

Along the motion of a fit, the rig's response to generic torques of each site (shapes.py) is computed by linearised
dynamics (response.py), everything that parameters and nuisances can do is taken out, and what is left of the residuals
is explained by a Gaussian prior on the coefficients: within one group of shapes, over all shapes of the site, or by a
few shapes only. The evidence of a site is the mean over these hypotheses, so a site with many shapes pays for them.
Where there is a gap, causes that act in one case or in one configuration only are hypotheses too.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from bayes_damper.calibration import Calibration
from bayes_damper.diagnosis.response import (
    Motion,
    Pieces,
    Projected,
    in_slices,
    in_turns,
    motions,
    nominal_slopes,
    project_parts,
    whiten,
)
from bayes_damper.diagnosis.shapes import Scale, Shape, scale_of_motions, shapes_of
from bayes_damper.diagnosis.verdict import credible_set
from bayes_damper.effects.base import SITES
from bayes_damper.runs.contents.diagnosis import CurveEntry, SiteMapEntry

Array = NDArray[np.float64]

STRENGTHS = np.geomspace(1.0, 3e4, 19)  # of a column's response, in noise standard deviations
MOST_SHAPES = 6  # in a sparse hypothesis
SHAPES_AT_ONCE = 64  # responses to them that are held at a time
USABLE = 1e-3  # a column of which parameters leave less than this share of its length is not used
PRIOR_NONE = 0.4
CONFIGURATIONS = {False: "uncoupled", True: "coupled"}
WORTH_A_TORQUE = 0.1  # probability of a site, given a gap, from which the torque that is missing there is given
LARGEST_LEFT = 0.1  # rms left of a record, over its sd, up to which linear responses give the missing torque
LAWS = {
    "ground1": {"k1t", "c1t", "J1"},
    "bearings": {"drag", "c1t", "c3t"},
    "interface": {"mu", "N0", "R", "r", "k2t", "c2t"},
    "ground2": {"k3t", "c3t", "J2"},
}  # parameters of the nominal laws that act where a torque may be missing, and can stand for it
PRIOR_CASE = 0.1  # that a cause acts in one case only
PRIOR_CONFIGURATION = 0.02  # in one configuration only, whose own inertia and couplings are no explanation
PARTS_FROM = 3.0  # nats of a gap, from which that is asked
MOST_CASES = 12  # of which one is asked for by itself
TEMPERING = 0.1  # share of the best evidence by which linear responses and approximate shapes may be wrong


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """One way to explain residuals at one site: columns, strength of their prior, evidence in nats over none.

    only : the part of the trials in which it acts, as "case IV" or "coupled"; None: in all of them.
    """

    site: str
    group: str
    columns: NDArray[np.int64]
    strength: float
    log_evidence: float
    only: str | None = None


@dataclass(frozen=True, eq=False)
class MissingTorque:
    """Torque that the model lacks on one trial, from the release on, with standard deviations.

    times (n,) s; torque, sd (2, n) N m on each inertia; th1 ... (n,) the motion, rad and rad/s.
    """

    trial: int
    times: Array
    torque: Array
    sd: Array
    th1: Array
    w1: Array
    th2: Array
    w2: Array

    @property
    def phi(self) -> Array:
        """Relative angle, rad."""
        return self.th1 - self.th2

    @property
    def slip(self) -> Array:
        """Relative velocity, rad/s."""
        return self.w1 - self.w2


@dataclass(frozen=True, eq=False)
class SiteMap:
    """Where a gap lies.

    log_evidence: of each site over no gap, nats; strength: that of the best site, as far as its cause acts in all
    trials; probabilities: of the sites and "none", sum 1; leaders: the leading
    hypothesis of each site; torque: what is missing at the best site (empty for a sensor: no torque is wrong there; and
    where `left` > `LARGEST_LEFT`); left: rms that the fit leaves of a record beyond the sensors' noise, over the
    record's standard deviation, where that is largest (0 where no torque is asked for).
    """

    log_evidence: Mapping[str, float]
    probabilities: Mapping[str, float]
    leaders: Mapping[str, Hypothesis]
    torque: tuple[MissingTorque, ...]
    fit: Calibration
    scale: Scale
    strength: float
    torque_site: str | None = None
    left: float = 0.0

    @property
    def best(self) -> str:
        """The most probable site, "none" left out."""
        return max(self.leaders, key=lambda s: self.probabilities[s])

    @property
    def only(self) -> str | None:
        """The part of the trials, as "case IV" or "coupled", in which alone the best site's leading cause acts."""
        return self.leaders[self.best].only

    def credible_set(self, share: float = 0.9) -> list[str]:
        """The smallest set of sites that holds at least `share` of the probability of a gap."""
        return credible_set({s: p for s, p in self.probabilities.items() if s != "none"}, share)

    @property
    def torque_body(self) -> int:
        """The inertia that the torque is shown on: 1, the secondary, where it acts on that alone or between both."""
        on_primary = not self.torque or any(np.any(m.torque[0]) for m in self.torque)
        return int(self.torque_site in ("interface", "ground2") or not on_primary)

    def curve(self, bins: int = 25) -> dict[str, CurveEntry]:
        """Missing torque against the coordinates of its site, averaged in bins.

        Gives for each coordinate its bin centres, mean torque (weights 1 / sd^2: what is known well counts more), its
        sd, as of one instant with that weight, and the number of instants.
        Names: "th1", "w1" / "phi", "slip" / "th2", "w2".
        """
        inertia = self.torque_body
        names = ("phi", "slip") if self.torque_site == "interface" else (("th1", "w1"), ("th2", "w2"))[inertia]
        out: dict[str, Any] = {}
        used = [m for m in self.torque if inertia == 0 or np.any(m.th2)]
        for name in names:
            if not used:
                break
            x = np.concatenate([getattr(m, name) for m in used])
            y = np.concatenate([m.torque[inertia] for m in used])
            sd = np.concatenate([m.sd[inertia] for m in used])
            edges = np.linspace(x.min(), x.max() + 1e-300, bins + 1)
            which = np.clip(np.digitize(x, edges) - 1, 0, bins - 1)
            count = np.bincount(which, minlength=bins)
            known = sd / (float(np.max(sd)) or 1.0)
            weight = 1.0 / np.maximum(known, 1e-3) ** 2
            total = np.maximum(np.bincount(which, weight, bins), 1e-300)
            mean = np.bincount(which, weight * y, bins) / total
            spread = np.bincount(which, weight * sd**2, bins) / total
            keep = count > 0
            out[name] = {
                "centre": (0.5 * (edges[1:] + edges[:-1]))[keep].tolist(), "torque_n_m": mean[keep].tolist(),
                "sd_n_m": np.sqrt(spread)[keep].tolist(), "count": count[keep].tolist(),
            }  # fmt: skip
        return out

    def to_json(self) -> SiteMapEntry:
        """Plain numbers for diagnosis.json."""
        return {
            "sites": {s: float(p) for s, p in self.probabilities.items()},
            "log_evidence": {s: float(v) for s, v in self.log_evidence.items()},
            "credible_set": self.credible_set(),
            "shape": {s: h.group for s, h in self.leaders.items()},
            "torque_site": self.torque_site,
            "only": {s: h.only for s, h in self.leaders.items() if h.only is not None},
        }


def site_map(
    fit: Calibration, *, torque: bool = True, prior_none: float = PRIOR_NONE,
    against: Callable[[Sequence[tuple[Hypothesis, Array]]], Array] | None = None,
) -> SiteMap:  # fmt: skip
    """Evidence and probability of every site that the rig has, from what a fit leaves; 1 to 3 s a campaign.

    torque : also estimate the missing torque, unless the fit is too far off (`SiteMap.left`); prior_none : prior
    probability of no gap; against : nats, at most 0, that other data have against hypotheses with the amounts of
    their columns (`Later`).
    """
    whole, fit = fit, in_slices(fit)
    moved = motions(fit)
    experiment = fit.problem.experiment
    released = experiment.start == "rest" and any(t.theta0 for t in experiment.trials)
    scale = scale_of_motions(moved, peak_of(fit), released)
    fit, moved = in_turns(fit, moved)
    pieces, vocabulary = pieces_of(fit, moved, scale)
    judged, found, priors = _per_part(pieces, vocabulary)
    by_part = _evidence_of(found)
    strength = max(v for (_, name), v in by_part.items() if name is None)
    leading = {key: max(own, key=lambda h: h.log_evidence) for key, own in found.items()}
    refuted: dict[tuple[str, str | None], float] = {}
    if against is not None:
        every = [(h, _coefficients(judged[only], h)[0]) for (_, only), own in found.items() for h in own]
        lost = iter(against(every))
        temperature = _temperature(by_part)
        for key, own in found.items():
            tempered = np.array([h.log_evidence for h in own]) / temperature
            losses = np.array(list(islice(lost, len(own))))
            refuted[key] = float(logsumexp(tempered + losses) - logsumexp(tempered))
            leading[key] = own[int(np.argmax(tempered + losses))]
    shares = shares_of(by_part, priors, prior_none, refuted)
    leaders: dict[str, Hypothesis] = {}
    for site in dict.fromkeys(site for site, _ in found):
        leaders[site] = leading[max((key for key in found if key[0] == site), key=lambda key: shares[key])]
    probabilities: dict[str, float] = {s: math.fsum(p for (site, _), p in shares.items() if site == s) for s in SITES}
    probabilities["none"] = max(1.0 - math.fsum(probabilities.values()), 0.0)
    evidence = {
        s: float(logsumexp([v + math.log(priors[n]) for (site, n), v in by_part.items() if site == s])) for s in leaders
    }
    missing: tuple[MissingTorque, ...] = ()
    silent = {s for s, leader in leaders.items() if not any(vocabulary[c][2] for c in leader.columns)}
    place = _torque_site(probabilities, silent) if torque else None
    left = 0.0 if place is None else share_left(whole)
    if place is not None and left <= LARGEST_LEFT:
        missing = _torque(fit, moved, scale, judged[leaders[place].only], leaders[place], left)
    # The fit that was given: one in slices holds its derivatives.
    return SiteMap(evidence, probabilities, leaders, missing, whole, scale, strength, place, left)


_Hypotheses = dict[tuple[str, str | None], list[Hypothesis]]  # of (site, part of the trials)
Vocabulary = Sequence[tuple[str, str, bool]]  # site, group, and whether it is a torque, of each shape


def pieces_of(fit: Calibration, moved: Sequence[Motion], scale: Scale) -> tuple[Pieces, Vocabulary]:
    """Responses to all shapes along the motions of a fit, by (case, coupled), and what the shapes are.

    One case alone, and more than `MOST_CASES` of them, have the name "".
    """
    coupled = any(m.group.coupled for m in moved)
    vocabulary: list[tuple[str, str, bool]] = []  # known when the first columns have been made
    columns = (
        _columns(fit, m, _noted(shapes_of(m, scale, coupled), vocabulary if m is moved[0] else [])) for m in moved
    )
    every = fit.problem.experiment.trials
    by_case = 1 < len({every[i].case for block in fit.linear.blocks for i in block.group.trials}) <= MOST_CASES
    pieces = project_parts(
        fit, columns, lambda i: (every[i].case if by_case else "", every[i].coupled), lambda: [v[0] for v in vocabulary]
    )
    return pieces, vocabulary


def best_evidence(judged: Projected, vocabulary: Vocabulary) -> float:
    """Evidence of the best site over no gap, nats."""
    found = _by_site(hypotheses_of(judged, [(site, group) for site, group, _ in vocabulary]), None)
    return max(_evidence_of(found).values())


def _per_part(
    pieces: Pieces, vocabulary: Vocabulary
) -> tuple[dict[str | None, Projected], _Hypotheses, dict[str | None, float]]:
    """Columns, hypotheses of each site, and prior: of causes that act in all trials (None), or in a part.

    Parts are asked for where there is a gap: each case and each configuration of a campaign of several.
    """
    cases = [case for case in dict.fromkeys(case for case, _ in pieces.names) if case]
    labels = [(site, group) for site, group, _ in vocabulary]
    judged: dict[str | None, Projected] = {None: pieces.on()}
    found = _by_site(hypotheses_of(judged[None], labels), None)
    parts: dict[str, tuple[float, int, str | bool]] = {}
    if max(_evidence_of(found).values()) > PARTS_FROM:
        parts |= {f"case {case}": (PRIOR_CASE / len(cases), 0, case) for case in cases}
        if len({coupled for _, coupled in pieces.names}) == 2:
            parts |= {name: (PRIOR_CONFIGURATION / 2.0, 1, coupled) for coupled, name in CONFIGURATIONS.items()}
    for name, (_, place, value) in parts.items():
        judged[name] = pieces.on([key for key in pieces.names if key[place] == value])
        elsewhere = judged[name].raw < 0.999 * judged[None].raw  # what acts there alone is in the first answer
        found |= _by_site(hypotheses_of(judged[name], labels, elsewhere), name)
    priors: dict[str | None, float] = {name: prior for name, (prior, _, _) in parts.items()}
    return judged, found, priors | {None: 1.0 - sum(priors.values())}


def acts_in(only: str | None, case: str, coupled: bool) -> bool:
    """Whether a cause that acts in one part of the trials acts in those of a case and configuration."""
    return only in (None, f"case {case}", CONFIGURATIONS[coupled])


def _torque_site(probabilities: Mapping[str, float], silent: Collection[str] = ()) -> str | None:
    """The most probable site where a torque can be missing, None if it is nearly sure that none is.

    silent : sites whose cause is no torque: a start that is not as declared, say. A sensor never is one.
    """
    gap = {s: p for s, p in probabilities.items() if s not in ("sensor", "none", *silent) and p > 0.0}
    place = max(gap, key=lambda s: gap[s], default=None)
    if place is None or gap[place] < WORTH_A_TORQUE * (1.0 - probabilities["none"]):
        return None
    return place


def share_left(fit: Calibration) -> float:
    """Rms that a fit leaves of a record beyond the sensors' noise, over the record's standard deviation: the largest.

    Roughly the phase (rad) by which model and record part. Responses are linear in it, and the errors of parameters
    that give way to a missing torque multiply with it. Nothing responds where the motion of the primary is prescribed:
    what its reaction lacks is the torque itself.
    """
    trials, noise = fit.problem.experiment.trials, fit.problem.noise.floor
    shares = [0.0]
    for i, residual in fit.residuals().items():
        first = int(trials[i].prescribed)
        for r, y, sd in list(zip(residual, trials[i].y, noise, strict=False))[first:]:
            if np.isfinite(r).any():
                beyond = max(float(np.nanmean(r**2)) - sd**2, 0.0)
                shares.append(math.sqrt(beyond / max(float(np.nanvar(y)), sd**2)))
    return max(shares)


def peak_of(fit: Calibration) -> float:
    """Frequency (rad/s) of the strongest line of the residuals above 1.5 times the rig's own, 0 if there is none."""
    experiment = fit.problem.experiment
    own = math.sqrt(max(k for k, _ in experiment.stiffnesses) / experiment.constants["J1"][0])
    found: dict[tuple[bool, bytes], tuple[Array, Array]] = {}  # of trials that share a clock, however they are sliced
    for block in fit.linear.blocks:
        times = block.group.times
        if times.size < 32:
            continue
        r = block.r.reshape(block.r.shape[0], -1, times.size)
        power = np.sum(np.abs(np.fft.rfft(r, 4 * times.size, axis=2)) ** 2, axis=(0, 1)) / times.size
        omega = np.asarray(2.0 * np.pi * np.fft.rfftfreq(4 * times.size, float(np.median(np.diff(times)))))
        key = block.group.coupled, times.tobytes()
        found[key] = omega, np.asarray(power + found[key][1] if key in found else power)
    best, peak = 0.0, 0.0
    for omega, power in found.values():
        above = np.where((omega > 1.5 * own) & (omega < 0.8 * omega[-1]), power, 0.0)
        k = int(np.argmax(above))
        if above[k] > best:
            best, peak = float(above[k]), float(omega[k])
    return peak


def _noted(shapes: Iterable[Shape], notes: list[tuple[str, str, bool]]) -> Iterator[Shape]:
    """The shapes, one after the other; of each, site, group and whether it is a torque are noted."""
    for shape in shapes:
        notes.append((shape.site, shape.group, shape.acts))
        yield shape


def _columns(fit: Calibration, motion: Motion, shapes: Iterable[Shape]) -> Array:
    """Whitened responses (trials, k, data) to the shapes, of which `SHAPES_AT_ONCE` are held at a time."""
    zero, still = np.zeros_like(motion.th1), np.zeros((motion.th1.shape[0], 4))
    parts: list[tuple[list[int], Array]] = []
    count = 0

    def numbered() -> Iterator[tuple[int, Shape]]:
        nonlocal count
        for shape in shapes:
            count += 1
            if not shape.silent:
                yield count - 1, shape

    for of_sensor, alike in groupby(numbered(), key=lambda s: s[1].reading is not None):
        while chunk := list(islice(alike, SHAPES_AT_ONCE)):
            if of_sensor:
                y = np.stack([s.reading for _, s in chunk if s.reading is not None], axis=1)
            else:
                q1 = np.stack([_or(s.q1, zero) for _, s in chunk], axis=1)
                q2 = np.stack([_or(s.q2, zero) for _, s in chunk], axis=1)
                y = motion.respond(q1, q2, np.stack([_or(s.start, still) for _, s in chunk], axis=1))
            parts.append(([k for k, _ in chunk], whiten(fit, motion.group, y)))
    # Column after column in memory, as their products are made.
    out = np.zeros((count, len(motion.group.trials), motion.group.y[0].size))
    for places, part in parts:
        out[places] = part.transpose(1, 0, 2)
    return out.transpose(1, 0, 2)


def _or(shape: Array | None, zero: Array) -> Array:
    """The shape, or nothing."""
    return zero if shape is None else shape


# Evidence -------------------------------------------------------------------------------------------------------------


def hypotheses_of(
    judged: Projected, labels: Sequence[tuple[str, str]], allowed: NDArray[np.bool_] | None = None
) -> list[Hypothesis]:
    """All hypotheses of all sites: each group, the whole site, and the best few shapes of it.

    allowed (k,) : columns that count; None: all.
    """
    left = np.diag(judged.gram)
    usable = left > np.maximum(USABLE**2 * judged.raw, 1e-12)
    if allowed is not None:
        usable &= allowed
    size = np.sqrt(np.where(usable, left, 1.0))
    gram = judged.gram / size[:, None] / size[None, :]
    product = judged.product / size
    out = []
    for site in dict.fromkeys(s for s, _ in labels):
        members = np.array([k for k, (s, _) in enumerate(labels) if s == site and usable[k]], dtype=np.int64)
        if members.size == 0:
            continue
        groups = list(dict.fromkeys(labels[k][1] for k in members))
        prior = -math.log(2.0 * len(groups))
        for group in groups:
            which = np.array([k for k in members if labels[k][1] == group], dtype=np.int64)
            value, strength = dense_evidence(gram[np.ix_(which, which)], product[which])
            out.append(Hypothesis(site, group, which, strength, value + prior))
        value, strength = dense_evidence(gram[np.ix_(members, members)], product[members])
        out.append(Hypothesis(site, "all", members, strength, value - math.log(4.0)))
        out += _sparse(gram, product, members, site)
    return out


def dense_evidence(gram: Array, product: Array) -> tuple[float, float]:
    """Log evidence over none of Gaussian coefficients, mean over the prior's strengths; and the best strength."""
    values, vectors = np.linalg.eigh(gram)
    values = np.maximum(values, 0.0)
    along = (vectors.T @ product) ** 2
    s2 = STRENGTHS[:, None] ** 2
    nats = 0.5 * np.sum(along / (1.0 / s2 + values), axis=1) - 0.5 * np.sum(np.log1p(s2 * values), axis=1)
    best = int(np.argmax(nats))
    return float(nats[best] + math.log(np.mean(np.exp(nats - nats[best])))), float(STRENGTHS[best])


def _sparse(gram: Array, product: Array, members: NDArray[np.int64], site: str) -> list[Hypothesis]:
    """Few shapes, added greedily; the choice among all subsets of that size is paid for."""
    chosen: list[int] = []
    out = []
    rest = list(members)
    for count in range(1, min(MOST_SHAPES, members.size) + 1):
        if chosen:
            inner = gram[np.ix_(chosen, chosen)] + 1e-9 * np.eye(len(chosen))
            across = gram[np.ix_(chosen, rest)]
            solved = np.linalg.solve(inner, np.column_stack([across, product[chosen]]))
            length = np.diag(gram)[rest] - np.einsum("ij,ij->j", across, solved[:, :-1])
            along = product[rest] - across.T @ solved[:, -1]
        else:
            length, along = np.diag(gram)[rest], product[rest]
        gain = np.where(length > 1e-6, along**2 / np.maximum(length, 1e-6), 0.0)
        best = int(np.argmax(gain))
        chosen.append(int(rest.pop(best)))
        value, strength = dense_evidence(gram[np.ix_(chosen, chosen)], product[chosen])
        total = members.size
        subsets = gammaln(total + 1) - gammaln(count + 1) - gammaln(total - count + 1)
        penalty = float(subsets) + math.log(4.0 * MOST_SHAPES)
        out.append(Hypothesis(site, "few", np.array(chosen, dtype=np.int64), strength, value - penalty))
    return out


def _by_site(hypotheses: Sequence[Hypothesis], only: str | None) -> _Hypotheses:
    """Hypotheses of each site that has any, on a part of the trials."""
    every = {site: [replace(h, only=only) for h in hypotheses if h.site == site] for site in SITES}
    return {(site, only): own for site, own in every.items() if own}


def _evidence_of(found: _Hypotheses) -> dict[tuple[str, str | None], float]:
    """Evidence of each site on a part of the trials over no gap, nats."""
    return {key: float(logsumexp([h.log_evidence for h in own])) for key, own in found.items()}


def _temperature(evidence: Mapping[tuple[str, str | None], float]) -> float:
    """What differences of evidence between sites and parts of the trials are divided by."""
    return 1.0 + TEMPERING * max(0.0, *evidence.values())


def shares_of(
    evidence: Mapping[tuple[str, str | None], float], priors: Mapping[str | None, float],
    prior_none: float = PRIOR_NONE, refuted: Mapping[tuple[str, str | None], float] | None = None,
) -> dict[tuple[str, str | None], float]:  # fmt: skip
    """Probability of each site and part of the trials; what is missing to 1 is that of no gap.

    Surrogates are linear and their shapes approximate, so differences between sites and parts count less the larger the
    gap is; against "none" they count in full.

    evidence : of (site, part), nats; priors : of the parts, sum 1; refuted : nats, at most 0, that other data have
    against it
    """
    best = max(evidence.values(), default=0.0)
    temperature = _temperature(evidence)
    logs = {key: max((v - best) / temperature, -700.0) + math.log(priors[key[1]]) for key, v in evidence.items()}
    norm = float(logsumexp(list(logs.values())))
    if refuted is not None:  # which moves probability between sites, and says nothing of whether there is a gap
        logs = {key: value + refuted.get(key, 0.0) for key, value in logs.items()}
    log_gap = math.log(1.0 - prior_none) + best + norm - math.log(len({site for site, _ in logs}))
    gap = math.exp(log_gap - float(np.logaddexp(log_gap, math.log(prior_none))))
    within = float(logsumexp(list(logs.values())))
    return {key: gap * math.exp(value - within) for key, value in logs.items()}


# Missing torque -------------------------------------------------------------------------------------------------------


def _coefficients(judged: Projected, hypothesis: Hypothesis) -> tuple[Array, Array]:
    """Posterior mean (k,) of the coefficients, in the units of the shapes, and a root of their covariance."""
    which = hypothesis.columns
    size = np.sqrt(np.diag(judged.gram)[which])
    gram = judged.gram[np.ix_(which, which)] / size[:, None] / size[None, :]
    values, vectors = np.linalg.eigh(gram)
    inverse = 1.0 / (np.maximum(values, 0.0) + 1.0 / hypothesis.strength**2)
    mean = vectors @ (inverse * (vectors.T @ (judged.product[which] / size)))
    return mean / size, vectors * np.sqrt(inverse) / size[:, None]


def _torque(
    fit: Calibration, moved: Sequence[Motion], scale: Scale, judged: Projected, leader: Hypothesis, left: float = 0.0
) -> tuple[MissingTorque, ...]:
    """Posterior mean and standard deviation of the torque that the leading shapes make.

    Less what the site's nominal laws took over of it in the fit: what they lack with their fitted parameters. The
    standard deviation has the shapes' coefficients, those parameters with the shapes as they are, and what linear
    responses err by: a share of the torque that grows with what is `left` of the records, up to all of it at
    `LARGEST_LEFT`.
    """
    which = leader.columns
    laws = LAWS.get(leader.site, set())
    theirs = np.array([[c.parameter in laws] for c in fit.problem.coordinates])
    spread = np.where(theirs & theirs.T, np.nan_to_num(fit.covariance), 0.0)
    mean, root = _coefficients(judged, leader)
    coupled = any(m.group.coupled for m in moved)
    out = []
    for m, block in zip(moved, fit.linear.blocks, strict=True):
        named = {c: shape for c, shape in enumerate(shapes_of(m, scale, coupled)) if c in which}
        own = [named[c] for c in which]
        zero = np.zeros_like(m.th1)
        slopes = nominal_slopes(fit, block, m)
        taken = np.einsum("jqbn,qk->jkbn", slopes, theirs * judged.absorbed[:, which])
        fitted = np.einsum("jqbn,qp,jpbn->jbn", slopes, spread, slopes, optimize=True)
        for k, trial in enumerate(m.group.trials):
            torque, sd = np.zeros((2, m.grid.size)), np.zeros((2, m.grid.size))
            of = fit.problem.experiment.trials[trial]
            acts = acts_in(leader.only, of.case, of.coupled)
            for inertia in (0, 1):
                features = taken[k, :, inertia] + acts * np.array([
                    (zero if q is None else q)[k]
                    for q in ((shape.q1 if inertia == 0 else shape.q2) for shape in own)
                ])  # fmt: skip
                torque[inertia] = mean @ features
                size = np.maximum(np.abs(torque[inertia]), math.sqrt(float(np.mean(torque[inertia] ** 2))))
                variance = np.sum((root.T @ features) ** 2, axis=0) + np.maximum(fitted[k, inertia], 0.0)
                sd[inertia] = np.sqrt(variance + (left / LARGEST_LEFT * size) ** 2)
            # Repeats share a grid of times: none of this trial's own readings lies beyond its last.
            read = np.flatnonzero(np.any(m.group.weight[k] > 0.0, axis=0))
            own_times = slice(0, int(read[-1]) + 1 if read.size else 0)
            at = m.at[own_times]
            out.append(
                MissingTorque(
                    trial,
                    m.group.times[own_times],
                    torque[:, at],
                    sd[:, at],
                    m.th1[k, at],
                    m.w1[k, at],
                    m.th2[k, at],
                    m.w2[k, at],
                )
            )
    return tuple(sorted(out, key=lambda o: o.trial))


def write_missing_torque(path: str | Path, found: SiteMap) -> None:
    """The missing torque of every fitted trial as CSV, one row a sample; a header alone if no torque is given."""
    trials = found.fit.problem.experiment.trials
    names = (
        "case", "configuration", "trial", "time_s", "torque1_n_m", "torque1_sd_n_m", "torque2_n_m", "torque2_sd_n_m",
        "theta1_rad", "omega1_rad_s", "theta2_rad", "omega2_rad_s",
    )  # fmt: skip
    with Path(path).open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        for m in found.torque:
            t = trials[m.trial]
            head = (t.case, "coupled" if t.coupled else "uncoupled", t.number)
            for i in range(m.times.size):
                numbers = (
                    m.times[i], m.torque[0, i], m.sd[0, i], m.torque[1, i], m.sd[1, i], m.th1[i], m.w1[i], m.th2[i],
                    m.w2[i],
                )  # fmt: skip
                writer.writerow((*head, *(f"{x:.9g}" for x in numbers)))
