"""Sets of effects that explain a campaign together: screened jointly, fitted with everything free, weighed as models.

Effects hide each other: beside a viscous damping, dry friction and square drag each gain nothing, and both together
nearly everything. So sets are screened as sets: each formula's response where it is just switched on, cleared of all
that parameters and nuisances can do, gives one Gram matrix, from which any combination follows at no cost; amplitudes
that a formula cannot have (a negative drag) count as none. The best sets are fitted in full, and screened again from
where the best fit lies, up to `LARGEST` effects.

Each set is weighed under the discrepancy that it leaves itself. No formula is right to the last digit, and on a rig
with a clean sensor it is what the model leaves, not the noise, that sets the scale of evidence. The discrepancy is
taken as Gaussian with a size of its own that is learnt, in as many independent pieces N as the correlation of the
residuals allows. With D the chi-square that is left beyond the sensors' noise,

    log Z = log Z(noise alone) + D / 2 - N / 2 log(1 + D / N),

the plain evidence where nothing is left, and -N/2 log of the sum of squares where the noise hardly matters. N is one
for all sets that are compared, the smallest of the nominal model's and the leading sets'. So is the sensors' noise, the
smallest that the residuals of any set show: a set gains nothing by calling more of what it leaves noise. So is the
noise by which the parameters are known that all sets have, nuisances among them: beside so few pieces of discrepancy
the readings fix them as well whichever set is true, and none may count as less informed because it leaves more. That
noise is the smallest that any set leaves; what an effect adds is known by the noise that its own set leaves.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import chain
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_damper.calibration import (
    Block,
    Calibration,
    Coordinate,
    Group,
    Indices,
    Noise,
    Problem,
    calibrate,
    coordinate_of,
    learn_noise,
    simulated_once,
    value_and_slope,
)
from bayes_damper.calibration.groups import trust_of
from bayes_damper.calibration.input_noise import followed
from bayes_damper.calibration.least_squares import Essence, essence, restored
from bayes_damper.calibration.scatter import SHOWN_FROM, likeliest_sizes, with_scatter
from bayes_damper.calibration.unlearnt import gained_over_sizes
from bayes_damper.diagnosis.pairs import ComposedProblem, Pair, PairProblem
from bayes_damper.diagnosis.remainder import LOW_BAND, own_frequency, repeats_of, whitened_records
from bayes_damper.diagnosis.search import Candidate, Screen
from bayes_damper.diagnosis.verdict import FRICTIONS, RULE, USUAL, Rule, mended_share
from bayes_damper.effects.base import Effect, Variant
from bayes_damper.priors.distributions import HalfNormal
from bayes_damper.rig.parameters import OF_EFFECT
from bayes_damper.runs.parallel_map import forked_map
from bayes_damper.runs.progress import now_and_then
from bayes_damper.simulation.composition import compose

Array = NDArray[np.float64]
Member = tuple[Effect, Variant]
Key = tuple[tuple[str, str], ...]  # of a set: its effects and formulas

LARGEST = 4  # effects at once
KEPT = 60  # columns that sets are made of: the most promising ones of each formula
AT_ONCE = 50_000  # readings of the trials whose responses to every formula are held at a time
SWITCHED_ON = 0.05  # of the residuals' sum of squares: the change of the records at which a response is taken
FITTED = 3  # sets fitted in each round
ROUNDS = 3
RELEARNT, LONGEST = 2, 5  # times that the noise is learnt from what a set leaves; the latter while it still changes
RESIZED = 3  # times that sizes of scatter are learnt from what a set leaves
SETTLED = 0.03  # relative change of the noise that does not count
STARTS = (1.0, 0.6, 0.3)  # shares of the screening's amplitudes from which a set is fitted
FAINT = 0.03  # the same where the base is kept
LEAST = 0.05  # of a parameter's value, to which it gives way at most at a start
STEPS, STEPS_ALONE = 16, 40  # of a fit; over the many periods of a record without repeats valleys are long


class SetProblem(Problem):
    """The fit of a campaign with several effects at once.

    Effects that share a kernel are composed into one and act on each other; the changes that the kernels make to the
    records add up. Coordinates are the nominal model's, then `effect.K.NAME` of each member K (from 0) in order.
    """

    def __init__(self, base: Problem, members: Sequence[Member], exact: bool) -> None:
        """`base`: the nominal problem, whose data, noise and nuisances are used; exact: compose wherever possible.

        Otherwise only what needs no kernel of its own is composed with another effect.
        """
        self.__dict__.update(base.__dict__)
        self.base, self.members, self.exact = base, tuple(members), exact
        clusters = _clusters(self.members, exact)
        self.parts = tuple(_cluster_problem(base, [members[k][1] for k in cluster]) for cluster in clusters)
        self.effect, self.models = self.parts[0].effect, self.parts[0].models
        own = [
            [Coordinate(f"{OF_EFFECT}{k}.{p.name}", "effect", p.prior, shape=p.null is None) for p in v.parameters]
            for k, (_, v) in enumerate(self.members)
        ]
        self.coordinates = (*base.coordinates, *chain.from_iterable(own))
        self.names = tuple(c.name for c in self.coordinates)
        self.size = len(self.coordinates)
        nominal = list(range(base.size))
        labels = [[c.name for k in cluster for c in own[k]] for cluster in clusters]
        self._places = [np.array([*nominal, *map(self.names.index, names)]) for names in labels]

    @property
    def identity(self) -> tuple[Any, ...]:
        return (*super().identity, [variant for _, variant in self.members], self.exact)

    def changed(self, **changes: Any) -> Self:
        """The same problem with other arguments."""
        return cast("Self", SetProblem(self.base.changed(**changes), self.members, self.exact))

    def finer(self) -> SetProblem:
        """The same problem with records integrated more finely, for differences between them."""
        out = copy(self)
        out.base, out.parts = self.base.finer(), tuple(part.finer() for part in self.parts)
        return out

    def _inputs(self, group: Group, which: Indices, q: Array, eta: Array) -> tuple[dict[str, Any], dict[str, Any]]:
        # Whoever asks for the motion gets that of the first kernel, about which the others are small changes.
        return self.parts[0]._inputs(group, which, q[:, self._places[0]], eta)  # noqa: SLF001 (the same class)

    def simulate(self, group: Group, which: Indices, q: Array, eta: Array) -> Array:
        """Readings (n, channels, n_times) of vectors q (n, size), eta (n, m) on the group's trials `which` (n,)."""
        if len(self.parts) == 1:
            return self.parts[0].simulate(group, which, q[:, self._places[0]], eta)
        each = [
            simulated_once(part, group, which, q[:, place], eta)
            for part, place in zip(self.parts, self._places, strict=True)
        ]
        alone = simulated_once(self.base, group, which, q[:, : self.base.size], eta)
        return np.asarray(sum(each) - (len(each) - 1) * alone)

    def acts(self, c: Coordinate, group: Group) -> bool:
        if c.role != "effect":
            return super().acts(c, group)
        return group.coupled or self.members[int(c.name.split(".")[1])][1].uncoupled

    def parameters_of(self, effect: str) -> dict[str, str]:
        """Name of each parameter of an effect -> that of its coordinate."""
        k, variant = next((k, v) for k, (e, v) in enumerate(self.members) if e.name == effect)
        return {p.name: f"{OF_EFFECT}{k}.{p.name}" for p in variant.parameters}


def from_cheapest(problem: Problem, starts: Sequence[Array], eta: Mapping[int, Array], most: int) -> Calibration:
    """The problem fitted from the cheapest of some starts, with the trials' own values where they are in eta."""
    costs = problem.costs(np.array(starts), {i: np.tile(v, (len(starts), 1)) for i, v in eta.items()})
    return calibrate(problem, [starts[int(np.argmin(costs))]], eta=eta, anneal=False, most=most)


def _clusters(members: Sequence[Member], exact: bool) -> list[list[int]]:
    """Members, by number, in groups that share a kernel; those that need one come first."""
    clusters: list[list[int]] = []
    for k in sorted(range(len(members)), key=lambda k: not members[k][1].has_kernel):
        for cluster in clusters:
            together = [members[j][1] for j in (*cluster, k)]
            if (exact or not members[k][1].has_kernel) and _composed(together) is not None:
                cluster.append(k)
                break
        else:
            clusters.append([k])
    return clusters


def _composed(variants: Sequence[Variant]) -> Variant | None:
    """One variant for all of them, None where the kernel has no room."""
    out: Variant | None = variants[0]
    for second in variants[1:]:
        out = None if out is None else compose(out, second)
    return out


def _cluster_problem(base: Problem, variants: Sequence[Variant]) -> Problem:
    out = base.with_effect(variants[0])
    for second in variants[1:]:
        assert out.effect is not None
        out = ComposedProblem(base, out.effect, second)
    return out


# Screening ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Columns:
    """Responses of the records to effects that are just switched on, at one fit.

    members, points : the formula of each column and the values of its parameters; gram (k, k), product (k,): after all
    that parameters and nuisances can do; signed: whether the amplitude cannot be negative; absorbed (size, k): by how
    much the fit's parameters give way to a column.
    """

    members: tuple[Member, ...]
    points: tuple[tuple[float, ...], ...]
    signed: tuple[bool, ...]
    gram: Array
    product: Array
    absorbed: Array


def columns_at(fit: Calibration, nominal: Calibration, pool: Sequence[Member], without: Collection[str]) -> Columns:
    """Every start of every formula of the pool, brought to where its response is small, at a fit.

    nominal : the fit of the nominal model; without : effects that are left out, those that the fit has. Responses are
    those of the nominal model with the fit's parameters.
    """
    screen = Screen(replace(fit, linear=fit.linear.sliced(AT_ONCE)))
    target = SWITCHED_ON * max(fit.chi2, 1.0)
    problem = nominal.problem.with_noise(fit.problem.noise)
    base = fit.q[: problem.size]
    blocks = screen.linear.blocks
    before = None if fit.problem.size == problem.size else screen.responses(problem, base[None])

    def response(b: int, variant: Variant, starts: Sequence[tuple[float, ...]]) -> Array:
        z = [[coordinate_of(p.prior, x) for p, x in zip(variant.parameters, s, strict=True)] for s in starts]
        q = np.concatenate([np.tile(base, (len(z), 1)), np.array(z)], axis=1)
        found = screen.response(blocks[b], problem.with_effect(variant), q)
        return found if before is None else found - before[b]

    chosen: list[tuple[Member, list[tuple[float, ...]]]] = []
    for member in pool:
        variant = member[1]
        if variant.null is None or member[0].name in without:
            continue
        starts = list(dict.fromkeys(variant.starts))
        if variant.fades:
            size = sum(np.sum(np.square(response(b, variant, starts)), axis=(1, 2)) for b in range(len(blocks)))
            shares = np.sqrt(target / np.maximum(np.nan_to_num(size, nan=np.inf), 1e-300))
            starts = [variant.faded(s, min(1.0, float(x))) for s, x in zip(starts, shares, strict=True)]
        chosen.append((member, starts))
    members = [member for member, starts in chosen for _ in starts]
    points = [point for _, starts in chosen for point in starts]
    bad = np.zeros(len(points), bool)

    def columns(b: int) -> Array:
        found = np.concatenate([response(b, variant, starts) for (_, variant), starts in chosen])
        failed = ~np.isfinite(found).all(axis=(1, 2))
        found[failed] = 0.0
        bad[failed] = True
        return found

    gram, product, absorbed = screen.projected(columns(b) for b in range(len(blocks)))
    gram[bad] = 0.0
    keep = np.flatnonzero(np.diag(gram) > 1e-9)
    return Columns(
        tuple(members[k] for k in keep),
        tuple(points[k] for k in keep),
        tuple(_signed(members[k][1]) for k in keep),
        gram[np.ix_(keep, keep)],
        -product[keep],
        absorbed[:, keep],
    )


def _signed(variant: Variant) -> bool:
    """Whether amplitudes of the formula cannot be negative."""
    return any(isinstance(p.prior, HalfNormal) for p in variant.parameters if p.null is not None) or not variant.fades


@dataclass(frozen=True)
class Proposal:
    """A set of columns that explain much together: explained chi-square, and the amplitude of each."""

    columns: tuple[int, ...]
    explained: float
    amplitudes: tuple[float, ...]


def proposals(columns: Columns, sizes: Sequence[int], most: int = FITTED) -> list[Proposal]:
    """The best sets of so many different effects, by what they explain of the residuals, best first by family."""
    d = np.sqrt(np.diag(columns.gram))
    gram = columns.gram / np.outer(d, d)
    b = columns.product / d
    names = [e.name for e, _ in columns.members]
    # Of one formula's columns that point the same way one is enough.
    alone = np.where(np.array(columns.signed) & (b < 0.0), 0.0, b**2)
    kept = _leading(names, gram, alone)
    found: dict[int, dict[frozenset[str], Proposal]] = {}
    beam: list[tuple[int, ...]] = [(k,) for k in kept]
    for size in range(1, max(sizes) + 1):
        level: dict[frozenset[str], Proposal] = {}
        for chosen in beam:
            best = _amplitudes(gram, b, columns.signed, chosen)
            if best is None:
                continue
            key = frozenset(names[k] for k in chosen)
            if key not in level or best[0] > level[key].explained:
                level[key] = Proposal(chosen, best[0], tuple(best[1] / d[list(chosen)]))
        found[size] = level
        top = sorted(level.values(), key=lambda p: -p.explained)[:25] if size > 1 else list(level.values())
        starting = beam if size == 1 else [p.columns for p in top]
        beam = sorted({
            tuple(sorted((*chosen, k))) for chosen in starting for k in kept
            if names[k] not in {names[j] for j in chosen}
        })  # fmt: skip
    out = []
    for size in sizes:
        out += sorted(found[size].values(), key=lambda p: -p.explained)[:most]
    return out


def _leading(names: Sequence[str], gram: Array, alone: Array) -> list[int]:
    """Columns to make sets of: of each effect those that do not nearly repeat a better one."""
    kept: list[int] = []
    for k in np.argsort(-alone):
        if all(names[j] != names[k] or abs(gram[j, k]) < 0.98 for j in kept):
            kept.append(int(k))
    return kept[:KEPT]


def _amplitudes(gram: Array, b: Array, signed: Sequence[bool], chosen: tuple[int, ...]) -> tuple[float, Array] | None:
    """Explained chi-square and amplitudes of columns; None where one has an impossible sign, or repeats another."""
    i = list(chosen)
    g = gram[np.ix_(i, i)]
    if len(i) > 1 and np.linalg.cond(g) > 1e8:
        return None
    x = np.asarray(np.linalg.solve(g, b[i]), float)
    if any(s and a <= 0.0 for s, a in zip((signed[k] for k in i), x, strict=True)):
        return None
    return float(x @ b[i]), x


# Sets and their evidence --------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class SetFit:
    """A set of effects fitted with everything free; without members the nominal model.

    plain: log evidence without what the discrepancy costs; squares, pieces: chi-square left beyond the sensors' noise,
    and in how many independent pieces; floor: that noise, sd of each channel, empty where trials have repeats; grams:
    what `known_by` needs of each group of trials, empty where trials have repeats; evidence: log Z over the nominal
    model (`weighed`).
    """

    members: tuple[Member, ...]
    fit: Calibration
    plain: float
    squares: float
    pieces: float
    grams: tuple[Array, ...] = ()
    evidence: float = 0.0
    floor: tuple[float, ...] = ()

    @property
    def names(self) -> frozenset[str]:
        """The effects."""
        return frozenset(e.name for e, _ in self.members)

    @property
    def noise(self) -> Array:
        """Of the fit, sd of each channel's innovation."""
        return np.array(self.fit.problem.noise.innovation)

    def under(self, noise: Array) -> float:
        """`plain` where the parameters that all sets have are known by another noise, sd of each channel."""
        return self.plain + self.known_by(self.noise) - self.known_by(noise) if self.grams else self.plain

    def known_by(self, noise: Array) -> float:
        """Half the log determinant of the information on the parameters that all sets have, under a noise."""
        problem = self.fit.problem
        common = sum(c.role != "effect" for c in problem.coordinates)  # they stand first
        total, S = 0.0, np.eye(common)
        for gram in self.grams:
            factor = (self.noise / noise)[: len(gram)] ** 2
            g = np.einsum("c,cjkl->jkl", factor, gram)
            S += g[:, :common, :common].sum(axis=0)
            if g.shape[1] > problem.size:
                H, TJ = g[:, problem.size :, problem.size :], g[:, problem.size :, :common]
                H = H + np.eye(H.shape[1])
                S -= np.sum(TJ.transpose(0, 2, 1) @ np.linalg.solve(H, TJ), axis=0)
                total += 0.5 * float(np.linalg.slogdet(H)[1].sum())
        return total + 0.5 * float(np.linalg.slogdet(S)[1])


def set_fit(members: Sequence[Member], fit: Calibration) -> SetFit:
    """A fit as one of the sets to be weighed."""
    squares, pieces = left_over(fit)
    alone = bool(fit.problem.noise.sensor)
    explained = fit.chi2 + followed(fit) if alone else squares
    grams = tuple(_gram_by_channel(b) for b in fit.linear.blocks) if alone else ()
    plain = fit.log_evidence + 0.5 * explained
    return SetFit(tuple(members), fit, plain, squares, pieces, grams, floor=fit.problem.noise.sensor)


def _gram_by_channel(block: Block) -> Array:
    """Products of the derivatives by parameters and nuisances, (channels, trials, size + m, size + m)."""
    rows = np.concatenate([block.J, block.T], axis=1)
    channels = block.group.y.shape[1]
    rows = rows.reshape(*rows.shape[:2], channels, -1).transpose(2, 0, 1, 3)
    return np.asarray(rows @ rows.transpose(0, 1, 3, 2))


def left_over(fit: Calibration, floor: Sequence[float] = ()) -> tuple[float, float]:
    """Chi-square that a fit leaves beyond the noise of the sensors, and in how many independent pieces.

    floor : that noise, sd of each channel; default: what the fit's own residuals show.

    Of what repeats share, below the frequencies at which torques show; of trials without repeats, over the noise of the
    sensors. Pieces: 4 (sum P)^2 / sum P^2 over the lines of the periodograms, as many readings as for white residuals
    (Bayley and Hammersley 1946). What the noise of inputs takes up counts with the rest: noise of both kinds leaves as
    much as there are readings, and a set that is wrong may not hide there what it leaves.
    """
    noise = fit.problem.noise
    scale = [a / b for a, b in zip(noise.innovation, floor or noise.sensor or noise.innovation, strict=True)]
    own = own_frequency(fit.problem.experiment)
    records = whitened_records(fit)
    lines = []
    for members in repeats_of(fit):
        mean = np.sum([records[i] for i in members], axis=0) / math.sqrt(len(members))
        times = fit.problem.experiment.trials[members[0]].times
        f = np.fft.rfftfreq(times.size, float(np.median(np.diff(times))))[1:-1]
        low = np.ones(f.size, bool) if noise.sensor else f < LOW_BAND * own
        for x, s in zip(mean, scale, strict=False):
            lines.append(s**2 * np.abs(np.fft.rfft(x)[1:-1][low]) ** 2 / max(int(np.count_nonzero(x)), 1))
    p = np.concatenate(lines)
    beyond = np.maximum(p - 1.0, 0.0)
    squares = 2.0 * float(np.sum(p - 1.0)) + followed(fit)
    if squares <= 0.0:
        return 0.0, float(2 * p.size)
    return squares, 4.0 * float(beyond.sum()) ** 2 / float(beyond @ beyond)


def weighed(sets: Sequence[SetFit]) -> list[SetFit]:
    """The sets with their evidence over the nominal model (the one without members), best first."""
    sets = _over_one_floor(sets)
    none = next(s for s in sets if not s.members)
    pieces = none.pieces
    sharp = _alike(sets)
    base = sharp[next(k for k, s in enumerate(sets) if s is none)]
    out = list(sets)
    for _ in range(2):
        out = [
            replace(s, evidence=plain - _cost(s, pieces) - base + _cost(none, pieces))
            for s, plain in zip(sets, sharp, strict=True)
        ]
        out = [s if math.isfinite(s.evidence) else replace(s, evidence=-math.inf) for s in out]
        out.sort(key=lambda s: -s.evidence)
        pieces = max(min(none.pieces, *(s.pieces for s in out[:FITTED])), 2.0)
    return out


def better(new: SetFit, old: SetFit, pieces: float) -> bool:
    """Whether one fit of a set explains more than another, each under the noise that it leaves itself."""
    new, old = _over_one_floor((new, old))
    ours, theirs = _alike((new, old))
    return ours - _cost(new, pieces) > theirs - _cost(old, pieces)


def _over_one_floor(sets: Sequence[SetFit]) -> list[SetFit]:
    """The sets with what each leaves beyond the same noise of the sensors, the smallest that any of them shows."""
    floors = [s.floor for s in sets if s.floor and math.isfinite(s.plain)]
    least = tuple(min(channel) for channel in zip(*floors, strict=True))
    out = list(sets)
    for k, s in enumerate(sets):
        if s.floor not in ((), least) and math.isfinite(s.plain):
            squares, pieces = left_over(s.fit, least)
            out[k] = replace(s, squares=squares, pieces=pieces, floor=least)
    return out


def _alike(sets: Sequence[SetFit]) -> list[float]:
    """`plain` of each, with what all sets know known by the smallest noise that any of them leaves."""
    noises = [s.noise for s in sets if s.grams and math.isfinite(s.plain)]
    return [s.under(np.min(noises, axis=0)) if noises else s.plain for s in sets]


def _cost(s: SetFit, pieces: float) -> float:
    """What a discrepancy of a size of its own, in so many pieces, costs a set in nats."""
    return 0.5 * pieces * math.log1p(s.squares / pieces)


def log_prior(names: Collection[str], offered: int) -> float:
    """Each effect is missing on its own with the probability that makes one missing effect the expected number.

    Both dry frictions beside a linear model are the usual nonlinear model, and count as one.
    """
    p = 1.0 / max(offered, USUAL)
    return (len(names) - int(set(names) >= FRICTIONS)) * math.log(p / (1.0 - p))


def probabilities(sets: Sequence[SetFit], offered: int) -> dict[frozenset[str], float]:
    """Probability of each set of effects, over its formulas, among those that were fitted.

    The formulas of an effect are equally likely beforehand, as those of single effects are (verdict.py).
    """
    weight: dict[frozenset[str], list[float]] = {}
    for s in sets:
        weight.setdefault(s.names, []).append(log_weight(s, offered))
    logs = {names: float(logsumexp(values)) for names, values in weight.items()}
    total = logsumexp(list(logs.values()))
    return {names: math.exp(v - total) for names, v in logs.items()}


def support(weights: Mapping[frozenset[str], float]) -> dict[str, float]:
    """Effect -> probability of the sets that hold it, over that of these and of what explains the gap without it.

    That are sets of several others, and causes without a name; other single effects are as good an answer alone.
    weights : probability of each set (`probabilities`).
    """
    out = {}
    for effect in set().union(*weights) - {"unknown"}:
        held = sum(p for names, p in weights.items() if effect in names)
        rivals = (names for names in weights if effect not in names and (len(names) > 1 or "unknown" in names))
        without = sum(weights[names] for names in rivals)
        out[effect] = held / max(held + without, 1e-300)
    return out


def log_weight(s: SetFit, offered: int) -> float:
    """Log evidence of a set with the prior of its effects and formulas; offered : effects that the rig can have."""
    return s.evidence - sum(math.log(len(e.variants)) for e, _ in s.members) + log_prior(s.names, offered)


# Search -------------------------------------------------------------------------------------------------------------


def grown(
    nominal: Calibration,
    found: Sequence[Candidate],
    pool: Sequence[Member],
    pairs: Sequence[Pair] = (),
    *,
    home: float = 1.0,
    workers: int = 1,
    report: Callable[[str], None] = lambda _: None,
) -> list[SetFit]:
    """Sets of effects, weighed, best first: the nominal model, single effects, pairs, and what screening proposes.

    found : fitted single effects; pool : all formulas that the rig can have; pairs : fitted already; home : probability
    that what the leading effect leaves lies at its own site. Where trials have repeats, pairs are known, and sets grow
    from the best one; else from the nominal model too, by two and three effects at once.
    """
    alone = bool(nominal.problem.noise.sensor)
    sets: dict[Key, SetFit] = {(): set_fit((), nominal)}
    settled: dict[Key, Calibration] = {}

    def add(members: tuple[Member, ...], fit: Calibration) -> None:
        key = _key(members)
        new = set_fit(members, fit)
        if key not in sets or better(new, sets[key], sets[()].pieces):
            sets[key] = new

    for c in found:
        # Under a noise of its own a fit that is far behind (`judgement`) cannot be weighed beside the others.
        comparable = c.fit is not None and (alone or c.fit.problem.noise == nominal.problem.noise)
        if c.fit is not None and comparable and math.isfinite(c.log_evidence):
            add(((c.effect, c.variant),), sharpened(c.fit) if alone else c.fit)
    explained = max((c.log_evidence for c in found if c.fit is not None), default=0.0)
    missed = cache(partial(squares_of, nominal))
    for pair in pairs:
        if not mends(pair.gain, explained, pair.exact, home):
            add(*_of_pair(pair))
    ranked = _with_own_sizes(sets, settled)
    tried = {s.names for s in ranked}
    done: set[frozenset[str]] = set()
    for step in range(ROUNDS if alone else 1):
        base = sets[()] if alone and step == 0 else ranked[0]
        if base.names in done or not _can_grow(base, pool, 0 if alone else 2):
            break
        done.add(base.names)
        wanted: list[tuple[Member, ...]] = []
        starts: list[list[Array]] = []
        columns = columns_at(base.fit, nominal, pool, base.names)
        sizes = [n for n in ((1, 2, 3) if alone else (1,)) if 1 < n + len(base.members) <= LARGEST][:2]
        for p in proposals(columns, sizes):
            members = (*base.members, *(columns.members[k] for k in p.columns))
            names = frozenset(e.name for e, _ in members)
            if names not in tried:
                tried.add(names)
                starts.append(_starts(base, columns, p))
                wanted.append(members)
        if not wanted:
            break
        report(f"fitting {len(wanted)} sets of effects")
        jobs = [(base, members, begun) for members, begun in zip(wanted, starts, strict=True)]
        each = now_and_then(report, len(jobs), "sets fitted")
        packed = forked_map(lambda job: _packed(_grown(nominal, *job)), jobs, workers, each)
        for members, (kept, noise) in zip(wanted, packed, strict=True):
            fit = restored(SetProblem(nominal.problem, members, exact=True).with_noise(noise), kept)
            smaller = [s for s in sets.values() if s.names < {e.name for e, _ in members}]
            defined = sum(not e.exact for e, _ in members) < 2  # one formula mends another
            gain = fit.log_evidence - max(s.fit.log_evidence for s in smaller)
            if not (mended_alone(missed, sets.values(), smaller, fit) if alone else mends(gain, explained, defined)):
                add(members, fit)
        ranked = _with_own_sizes(sets, settled)
    # A smaller set may have ended short of where the best one leads: each effect is left out of that once. That is how
    # the nominal model comes by times of release that only the fit with an effect has found.
    best = ranked[0]
    for members, start in _without_one(best) if alone else ():
        add(members, _fitted(replace(nominal, eta=best.fit.eta), members, [start]))
    return _with_own_sizes(sets, settled)


def _key(members: Sequence[Member]) -> Key:
    return tuple(sorted((e.name, v.name) for e, v in members))


def _without_one(best: SetFit) -> list[tuple[tuple[Member, ...], Array]]:
    """Each smaller set with one effect less than the best one, and where the best one's fit lies for it."""
    problem = best.fit.problem
    if len(best.members) == 1:
        return [((), best.fit.q[: sum(c.role != "effect" for c in problem.coordinates)])]  # they stand first
    if not isinstance(problem, SetProblem):
        return []
    out = []
    for effect, _ in best.members:
        left_out = set(problem.parameters_of(effect.name).values())
        kept = [i for i, name in enumerate(problem.names) if name not in left_out]
        out.append((tuple(m for m in best.members if m[0] is not effect), best.fit.q[kept]))
    return out


def mends(gain: float, explained: float, exact: bool, home: float = 1.0, rule: Rule = RULE) -> bool:
    """Whether a further effect gains no more than what mending the first one's formula would (verdict.py).

    gain : nats over the set without it, explained : by the best single effect; exact : whether its formula, or the
    first one's, is a definition, in which nothing is mended; home : probability that what the first one leaves lies at
    its own site.
    """
    return not exact and not gain > mended_share(home, rule) * max(explained, 0.0)


def mended_alone(
    missed: Callable[[Calibration], float], sets: Collection[SetFit], smaller: Sequence[SetFit], fit: Calibration
) -> bool:
    """The same where no trial has repeats, of the squares that fits miss instead of their evidences.

    Under what each set leaves itself an effect that takes up what another one's formula is off by gains as much as one
    that acts. sets : the nominal model and single effects among them; smaller : those that hold some of the effects.
    """
    whole = min(missed(s.fit) for s in sets if not s.members)
    alone = min((missed(s.fit) for s in sets if len(s.members) == 1), default=whole)
    return mends(min(missed(s.fit) for s in smaller) - missed(fit), whole - alone, exact=False)


def _can_grow(s: SetFit, pool: Sequence[Member], least: int) -> bool:
    known = {e.name for e, _ in pool}
    others = any(v.null is not None and e.name not in s.names for e, v in pool)
    return least <= len(s.members) < LARGEST and s.names <= known and others


def _of_pair(pair: Pair) -> tuple[tuple[Member, ...], Calibration]:
    """A fitted pair as a set: its effects in the order of the fit's coordinates."""
    problem = pair.fit.problem
    assert isinstance(problem, PairProblem | ComposedProblem)
    sides = (pair.first, pair.second)
    members = tuple(next(m for m in sides if m[1] is v) for v in problem.variants)
    exact = isinstance(problem, ComposedProblem)
    return members, replace(pair.fit, problem=SetProblem(problem.base, members, exact))


def _with_own_sizes(sets: dict[Key, SetFit], settled: dict[Key, Calibration]) -> list[SetFit]:
    """The sets, weighed, the best of them with the sizes of scatter that their trials' own values make likeliest.

    Evidences are integrated over the sizes (unlearnt.py). Where these are far from those of a fit, most of the integral
    is of fits that leave less than this one: what they leave has to be weighed with it.

    settled : the fits that have been looked at, which grows.
    """
    while True:
        ranked = weighed(list(sets.values()))
        leading = [(_key(s.members), s) for s in ranked[:FITTED] if s.members]
        anew = [(key, s) for key, s in leading if settled.get(key) is not s.fit]
        if not anew:
            return ranked
        for key, s in anew:
            fit = s.fit
            for _ in range(RESIZED):
                if gained_over_sizes(fit.problem, fit.linear.normal()) < SHOWN_FROM:
                    break
                fit = sharpened(with_scatter(fit, likeliest_sizes(fit)))
            if fit is not s.fit:
                sets[key] = set_fit(s.members, fit)
            settled[key] = fit


def sharpened(fit: Calibration) -> Calibration:
    """The fit under the noise that it leaves itself: a better fit leaves less, which sharpens it."""
    for number in range(LONGEST):
        noise = learn_noise(fit)
        known = fit.problem.noise.innovation
        same = all(abs(new / old - 1.0) < SETTLED for new, old in zip(noise.innovation, known, strict=True))
        if number >= RELEARNT and same:
            break
        if not noise.sensor:  # it leaves noise alone, and is still weighed beside sets that leave more
            noise = noise.of_sensors
        fit = calibrate(
            fit.problem.with_noise(noise), [fit.q], eta=fit.eta, anneal=False, most=STEPS_ALONE, straight=True,
        )  # fmt: skip
    return fit


def _fitted(nominal: Calibration, members: tuple[Member, ...], starts: Sequence[Array]) -> Calibration:
    """A set fitted from several starts; where no trial has repeats, under the noise that it leaves itself."""
    alone = bool(nominal.problem.noise.sensor)
    problem = nominal.problem
    if len(members) == 1:  # as single effects are fitted everywhere else
        problem = problem.with_effect(members[0][1])
    elif members:
        problem = SetProblem(problem, members, exact=True)
    most = STEPS_ALONE if alone else STEPS
    fit = calibrate(problem, starts, eta=nominal.eta, anneal=False, most=most, finish=not alone, straight=alone)
    return sharpened(fit) if alone else fit


def _grown(nominal: Calibration, base: SetFit, members: tuple[Member, ...], starts: Sequence[Array]) -> Calibration:
    """A set that holds another one, `base`, fitted from starts, the last of which is the nearest to the base.

    More effects explain no less. A fit that does has ended in another valley, and begins again from the base's own, in
    which the further effects are hardly there.
    """
    fit = _fitted(nominal, members, starts[:-1])
    if squares_of(nominal, fit) <= squares_of(nominal, base.fit):
        return fit
    begun = replace(nominal, problem=nominal.problem.with_noise(base.fit.problem.noise), eta=base.fit.eta)
    again = _fitted(begun, members, starts[-1:])
    return min(fit, again, key=lambda f: squares_of(nominal, f))


def squares_of(nominal: Calibration, fit: Calibration) -> float:
    """What a fit misses of the trials that it was fitted to, as a sum of squares over the nominal model's noise."""
    sds = np.array(nominal.problem.noise.floor)
    inside = fit.residuals()
    return sum(
        float(np.nansum(np.square(inside[i] * w / sds[: len(w), None])))
        for i, w in trust_of(nominal.problem.grouped(nominal.problem.trials)).items()
    )


def _starts(base: SetFit, columns: Columns, proposal: Proposal) -> list[Array]:
    """Where a set's fit begins: shares of the screening's amplitudes, with what the parameters give way to them."""
    out = []
    move = columns.absorbed[:, list(proposal.columns)] @ np.array(proposal.amplitudes)
    for share in (*STARTS, FAINT):
        z: list[float] = []
        for k, amplitude in zip(proposal.columns, proposal.amplitudes, strict=True):
            variant, point = columns.members[k][1], columns.points[k]
            if variant.fades:
                point = variant.faded(point, share * amplitude)
            z += [coordinate_of(p.prior, x) for p, x in zip(variant.parameters, point, strict=True)]
        own = [
            _moved(c, x, share * dx) for c, x, dx in zip(base.fit.problem.coordinates, base.fit.q, move, strict=True)
        ]
        out.append(np.concatenate([own, z]))
    return out


def _moved(c: Coordinate, z: float, step: float) -> float:
    """The coordinate z after a step that is linear in the value itself, which stops short of a change of sign."""
    value, slope = value_and_slope(c.prior, z)
    to = value + slope * step
    return coordinate_of(c.prior, to if to * value > 0.0 and abs(to) > LEAST * abs(value) else LEAST * value)


def _packed(fit: Calibration) -> tuple[Essence, Noise]:
    """Of a fit, what has to be sent from one process to another."""
    return essence(fit), fit.problem.noise


def as_candidates(found: Sequence[Candidate], sets: Sequence[SetFit]) -> list[Candidate]:
    """Single effects as weighed beside sets, best first; what was not fitted keeps the screening's evidence."""
    alone = {s.members[0][1].name + s.members[0][0].name: s for s in sets if len(s.members) == 1}
    out = []
    for c in found:
        s = alone.get(c.variant.name + c.effect.name)
        out.append(c if s is None or c.fit is None else replace(c, fit=s.fit, log_evidence=s.evidence))
    return sorted(out, key=lambda c: -c.log_evidence)
