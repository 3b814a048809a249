"""Two effects at once, where one does not close the gap.

Each of the leading effects is held in turn, at its own fit, and every other effect is screened against what that fit
leaves: first pick and swap in one sweep. The best few pairs are then fitted with everything free at once. An effect
without a kernel (a wrong constant, a lag, another start) is composed with any other one, exactly and at no cost. Of two
with kernels it is assumed that they change the records by the sum of what each changes alone. What they do to each
other beyond that grows with the gap; where a fitted pair still leaves something, its formulas are composed into one
kernel (composition.py; compiled when a pair is met for the first time on a machine) and fitted again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any, Self, cast

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Calibration, Coordinate, Group, Indices, Problem, calibrate, simulated_once
from bayes_damper.calibration.least_squares import essence, restored
from bayes_damper.diagnosis.generic import UNKNOWN
from bayes_damper.diagnosis.remainder import Remainder, remainder_of
from bayes_damper.diagnosis.search import (
    FAINTER,
    MISSED,
    NOTHING,
    Candidate,
    Screen,
    Screened,
    bases_of,
    fainter,
    screen_column,
    start_points,
)
from bayes_damper.diagnosis.verdict import pair_log_prior
from bayes_damper.effects.base import Effect, Variant
from bayes_damper.rig.parameters import OF_EFFECT
from bayes_damper.runs.parallel_map import forked_map
from bayes_damper.simulation.composition import PLACES, Labels, compose

Array = NDArray[np.float64]

LEADERS = 4  # families that are held in turn
LEAST_GAIN = 8.0  # nats of the second effect by the screening, below which no pair is fitted
MOST_PAIRS = 4  # pairs fitted in full
MOST_STEPS = 16
MOST_TOGETHER = 3  # choices of formulas of two given effects that are fitted


class PairProblem(Problem):
    """The fit of a campaign with two effects: their changes of the records add up.

    Coordinates are those of the nominal model, then the first effect's (`effect.NAME`), then the second's
    (`second.NAME`).
    """

    def __init__(self, base: Problem, first: Variant, second: Variant) -> None:
        """`base`: the nominal problem, whose data, noise and nuisances are used."""
        self.__dict__.update(base.__dict__)
        self.base = base
        self.parts = (base.with_effect(first), base.with_effect(second))
        self.variants = (first, second)
        self.effect = first
        others = tuple(
            Coordinate(f"second.{p.name}", "effect", p.prior, len(first.parameters), shape=p.null is None)
            for p in second.parameters
        )
        self.coordinates = self.parts[0].coordinates + others
        self.names = tuple(c.name for c in self.coordinates)
        self.size = len(self.coordinates)
        self._split = self.parts[0].size

    @property
    def identity(self) -> tuple[Any, ...]:
        return (*super().identity, self.variants)

    def changed(self, **changes: Any) -> Self:
        """The same problem with other arguments."""
        return cast("Self", PairProblem(self.base.changed(**changes), *self.variants))

    def finer(self) -> PairProblem:
        """The same problem with records integrated more finely, for differences between them."""
        out = copy(self)
        out.base, out.parts = self.base.finer(), (self.parts[0].finer(), self.parts[1].finer())
        return out

    def _inputs(self, group: Group, which: Indices, q: Array, eta: Array) -> tuple[dict[str, Any], dict[str, Any]]:
        # Whoever asks for the motion gets that of the first effect, about which the second one is a small change.
        return self.parts[0]._inputs(group, which, q[:, : self._split], eta)  # noqa: SLF001 (the same class)

    def simulate(self, group: Group, which: Indices, q: Array, eta: Array) -> Array:
        """Readings (n, channels, n_times) of vectors q (n, size), eta (n, m) on the group's trials `which` (n,)."""
        n = self.base.size
        alone = (q[:, : self._split], np.concatenate([q[:, :n], q[:, self._split :]], axis=1))
        first, second = (simulated_once(part, group, which, x, eta) for part, x in zip(self.parts, alone, strict=True))
        return first + second - simulated_once(self.base, group, which, q[:, :n], eta)

    def acts(self, c: Coordinate, group: Group) -> bool:
        if c.role != "effect":
            return super().acts(c, group)
        variant = self.parts[1 if c.name.startswith("second.") else 0].effect
        return group.coupled or (variant is not None and variant.uncoupled)


class ComposedProblem(Problem):
    """The fit of a campaign with two effects composed into one kernel: exact, whatever they do to each other.

    Coordinates as those of a `PairProblem`, named `effect.LABEL.NAME`: by default `effect.first.NAME` and
    `effect.second.NAME`.
    """

    def __init__(self, base: Problem, first: Variant, second: Variant, labels: Labels = PLACES) -> None:
        """`base`: the nominal problem, whose data, noise and nuisances are used.

        Raises
        ------
        ValueError
            if the kernel has no room for both.
        """
        both, apart = (compose(first, second, coupled=coupled, labels=labels) for coupled in (True, False))
        if both is None or apart is None:
            raise ValueError(f"{first.name} and {second.name} cannot be composed: the kernel has no room for both")
        self.__dict__.update(base.with_effect(both).__dict__)
        self.models = self.models | {False: replace(self.models[False], effect=apart)}
        self.base = base
        self.variants = (first, second)
        self.labels = labels

    @property
    def identity(self) -> tuple[Any, ...]:
        return (*super().identity, self.variants, self.labels)

    def changed(self, **changes: Any) -> Self:
        """The same problem with other arguments."""
        return cast("Self", ComposedProblem(self.base.changed(**changes), *self.variants, self.labels))


def pair_problem(base: Problem, first: Variant, second: Variant) -> PairProblem | ComposedProblem:
    """The fit of a campaign with two effects: composed where no kernel has to be compiled for it, else by their sum.

    Its `variants` may come in the other order: one without a kernel of its own stands last.
    """
    one, two = _in_order(first, second)
    if not two.has_kernel and compose(one, two) is not None:
        return ComposedProblem(base, one, two)
    return PairProblem(base, first, second)


def _in_order(first: Variant, second: Variant) -> tuple[Variant, Variant]:
    """Two formulas as a kernel takes them: one that has none of its own stands last."""
    return (first, second) if first.has_kernel else (second, first)


def _vector(problem: PairProblem | ComposedProblem, nominal: Array, *own: tuple[Variant, Array]) -> Array:
    """Coordinates of a pair's problem: those of the nominal model, and each variant's own."""
    return np.concatenate([nominal, *(z for v in problem.variants for w, z in own if w is v)])


@dataclass(frozen=True, eq=False)
class Second:
    """A second effect screened against what a first one leaves; gain: nats of its linearised evidence."""

    first: Candidate
    effect: Effect
    variant: Variant
    screened: Screened

    @property
    def gain(self) -> float:
        """Nats over the first effect alone, its parameters' priors paid for."""
        return self.screened.log_evidence

    @property
    def log_evidence(self) -> float:
        """Of both, over the nominal model."""
        return self.first.log_evidence + self.gain


@dataclass(frozen=True, eq=False)
class Pair:
    """Two effects that explain a campaign together.

    first, second: families and formulas, the stronger first; fit: of both at once; log_evidence over the nominal model;
    gain: nats over the stronger one alone; after: what both leave.
    """

    first: tuple[Effect, Variant]
    second: tuple[Effect, Variant]
    fit: Calibration
    log_evidence: float
    gain: float
    after: Remainder

    @property
    def effects(self) -> tuple[str, str]:
        """Names of both, the stronger first."""
        return self.first[0].name, self.second[0].name

    @property
    def exact(self) -> bool:
        """Whether one of the formulas is a definition."""
        return self.first[0].exact or self.second[0].exact

    def parameters(self) -> dict[str, dict[str, str]]:
        """Effect -> name of its parameter -> that of the coordinate of `fit`."""
        problem = self.fit.problem
        assert isinstance(problem, PairProblem | ComposedProblem)
        prefixes = [OF_EFFECT, "second."]
        if isinstance(problem, ComposedProblem):
            prefixes = [f"{OF_EFFECT}{label}." for label in problem.labels]
        out = {}
        for prefix, variant in zip(prefixes, problem.variants, strict=True):
            effect = self.first[0] if self.first[1] is variant else self.second[0]
            out[effect.name] = {p.name: prefix + p.name for p in variant.parameters}
        return out


def seconds_of(
    first: Candidate, nominal: Calibration, pool: Sequence[tuple[Effect, Variant]], workers: int = 1
) -> list[Second]:  # fmt: skip
    """Every formula of every other effect, screened against what the first effect's fit leaves, best first."""
    if first.fit is None:
        return []
    screen = Screen(first.fit)
    others = [(effect, variant) for effect, variant in pool if effect.name != first.effect.name]

    def judge(variant: Variant | None) -> list[Screened]:
        return [] if variant is None else _second(screen, nominal, first.variant, variant)

    rows = forked_map(judge, [variant for _, variant in others], workers)
    if max((s.gain for row in rows for s in row), default=0.0) < FAINTER:
        small = [fainter(variant, row) for (_, variant), row in zip(others, rows, strict=True)]
        rows = [row + more for row, more in zip(rows, forked_map(judge, small, workers), strict=True)]
    out = []
    for (effect, variant), row in zip(others, rows, strict=True):
        usable = [r for r in row if r.amplitude > 0.0 and np.isfinite(r.log_evidence)]
        if usable:
            out.append(Second(first, effect, variant, max(usable, key=lambda r: r.log_evidence)))
    return sorted(out, key=lambda s: -s.gain)


def _second(screen: Screen, nominal: Calibration, first: Variant, variant: Variant) -> list[Screened]:
    """Every start of a second effect at the fit of a first one."""
    n = nominal.problem.size
    alone, own = screen.fit.q[:n], screen.fit.q[n:]
    both = pair_problem(nominal.problem, first, variant)
    problem: Problem = both
    against, before, behind = screen.fit.problem, NOTHING, NOTHING
    if isinstance(both, PairProblem):
        problem, against = nominal.problem.with_effect(variant), nominal.problem
    elif both.variants[0] is first:
        before = own
    else:
        behind = own
    points = bases_of(replace(nominal, q=alone))
    return [row for at in points for row in screen_column(screen, problem, variant, at, against, before, behind)]


def leaders_of(found: Sequence[Candidate], count: int = LEADERS) -> list[Candidate]:
    """The best fitted formula of each of the leading families."""
    held: dict[str, Candidate] = {}
    for c in found:
        if c.effect.name != UNKNOWN and c.fit is not None and math.isfinite(c.log_evidence):
            held.setdefault(c.effect.name, c)
    return list(held.values())[:count]


def best_pairs(
    nominal: Calibration,
    found: Sequence[Candidate],
    pool: Sequence[tuple[Effect, Variant]],
    known: Sequence[Second] = (),
    *,
    workers: int = 1,
    most: int = MOST_PAIRS,
    least: float = LEAST_GAIN,
) -> list[Pair]:
    """Pairs fitted in full, the most probable first: by evidence and prior.

    known : second effects screened already, against one of the leaders; most : pairs that are fitted; least : nats that
    the screening must promise of the second effect.
    """
    done = {s.first.label for s in known}
    leaders = [c for c in leaders_of(found) if c.log_evidence > LEAST_GAIN and c.label not in done]

    rows = [*known, *(s for leader in leaders for s in seconds_of(leader, nominal, pool, workers))]
    chosen: dict[frozenset[str], Second] = {}
    for s in sorted(rows, key=lambda s: -s.log_evidence - pair_log_prior((s.first.effect.name, s.effect.name))):
        if s.gain > least:
            chosen.setdefault(frozenset((s.first.effect.name, s.effect.name)), s)
    picked = list(chosen.values())[:most]
    single = _alone(found)

    essences = forked_map(lambda s: essence(_fitted(nominal, s, found)), picked, workers)
    pairs = []
    for s, kept in zip(picked, essences, strict=True):
        fit = restored(pair_problem(nominal.problem, s.first.variant, s.variant), kept)
        pairs.append(_pair(nominal, ((s.first.effect, s.first.variant), (s.effect, s.variant)), fit, single))
    return sorted((p for p in pairs if p is not None), key=lambda p: -p.log_evidence - pair_log_prior(p.effects))


def _fitted(nominal: Calibration, s: Second, found: Sequence[Candidate]) -> Calibration:
    """Both effects fitted at once, as `pair_problem` puts them together."""
    first = s.first.fit
    assert first is not None
    problem = pair_problem(nominal.problem, s.first.variant, s.variant)
    n = nominal.problem.size
    own = (s.first.variant, first.q[n:])
    screened = start_points(s.variant, [replace(s.screened, base=tuple(first.q[:n]))], 1)[0]
    starts = [_vector(problem, first.q[:n], own, (s.variant, screened[n:]))]
    for c in found:
        if c.variant is s.variant and c.fit is not None:
            # Each effect as it is alone, the nominal parameters moved by both moves together, and by none.
            moved = first.q[:n] + c.fit.q[:n] - nominal.q
            starts += [_vector(problem, q, own, (s.variant, c.fit.q[n:])) for q in (moved, nominal.q)]
    return calibrate(problem, starts, eta=first.eta, anneal=False, most=MOST_STEPS)


def _pair(
    nominal: Calibration,
    sides: tuple[tuple[Effect, Variant], tuple[Effect, Variant]],
    fit: Calibration,
    single: Mapping[str, float],
) -> Pair | None:
    """The fit of two effects as an answer; None if it has no evidence."""
    evidence = fit.log_evidence - nominal.log_evidence
    if not math.isfinite(evidence):
        return None
    alone = [single.get(effect.name, -math.inf) for effect, _ in sides]
    first, second = sides if alone[0] >= alone[1] else (sides[1], sides[0])
    return Pair(first, second, fit, evidence, evidence - max(alone), remainder_of(fit))


def _alone(found: Sequence[Candidate]) -> dict[str, float]:
    """Log evidence of each effect by itself, of its best formula."""
    return {c.effect.name: c.log_evidence for c in reversed(leaders_of(found, len(found)))}


def exactly(nominal: Calibration, pair: Pair, found: Sequence[Candidate]) -> Pair:
    """The pair fitted with its formulas composed into one kernel; the pair itself where the kernel has no room."""
    problem = pair.fit.problem
    if not isinstance(problem, PairProblem):
        return pair
    first, second = problem.variants
    if compose(first, second) is None:
        return pair
    exact = ComposedProblem(nominal.problem, first, second)
    again = calibrate(exact, [pair.fit.q], eta=pair.fit.eta, anneal=False, most=MOST_STEPS)
    single = _alone(found)
    return _pair(nominal, (pair.first, pair.second), again, single) or pair


def room_for(pool: Sequence[tuple[Effect, Variant]]) -> bool:
    """Whether the kernel has room for two of these formulas that are not of the same effect."""
    return any(_composable(*two) for two in combinations(pool, 2))


def _composable(first: tuple[Effect, Variant], second: tuple[Effect, Variant]) -> bool:
    return first[0].name != second[0].name and compose(*_in_order(first[1], second[1])) is not None


def fit_together(nominal: Calibration, found: Sequence[Candidate]) -> Calibration:
    """The best fit with both of two effects, whatever they gain, composed into one kernel.

    Its coordinates are called `effect.NAME_OF_EFFECT.NAME`. found : every formula of the two, fitted alone; the kernel
    must have room for two of them.
    """
    beside = {
        c.label: [o for o in found if _composable((c.effect, c.variant), (o.effect, o.variant))]
        for c in found if c.fit is not None
    }  # fmt: skip
    leaders: dict[str, Candidate] = {}
    for c in sorted(found, key=lambda c: -c.log_evidence):
        if beside.get(c.label):
            leaders.setdefault(c.effect.name, c)
    rows = []
    for first in leaders.values():
        others = beside[first.label]
        shown = seconds_of(first, nominal, [(c.effect, c.variant) for c in others])
        # Where the screening shows none beside the first, each begins as it is alone.
        rows += shown or [Second(first, c.effect, c.variant, max(c.screens, key=lambda s: s.gain)) for c in others]
    rows.sort(key=lambda s: -s.log_evidence)
    chosen: dict[frozenset[str], Second] = {}
    for s in rows:
        if s.log_evidence >= rows[0].log_evidence - MISSED:
            chosen.setdefault(frozenset((s.first.label, f"{s.effect.name}/{s.variant.name}")), s)
    fits = [_fitted(nominal, s, found) for s in list(chosen.values())[:MOST_TOGETHER]]
    best = max(fits, key=lambda f: f.log_evidence)
    assert isinstance(best.problem, PairProblem | ComposedProblem)
    one, two = best.problem.variants
    labels = {id(c.variant): c.effect.name for c in found}
    both = ComposedProblem(nominal.problem, one, two, (labels[id(one)], labels[id(two)]))
    return calibrate(both, [best.q], eta=best.eta, anneal=False)
