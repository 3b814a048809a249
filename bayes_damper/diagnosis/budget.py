"""The gap as a budget: every effect that is present with its share of the gap, and what stays unexplained.

From sets of effects that were fitted together (sets.py): an effect is present with the probability of all sets that
hold it, less the probability that a cause outside the library does what the set explains. Shares of the gap are those
on held-out trials (shares.py), divided among the effects of the best set as Shapley (1953) does: what an effect closes
beyond those before it, averaged over all orders, so that shares and what stays unexplained sum to 1, whichever effects
hide each other. What is left does not speak against what is found; it stands beside it. A part of the effects alone may
do harm there, as where a small effect is bent to do what a large one does: it closes nothing.

Held-out trials have chosen no set, so they judge it. With s the share that an effect closes there beyond all others, e
its standard error, S what it would be without noise, and p the same on the trials it was fitted to: an effect that
acts has S anywhere between 0 and R = 2 p, at most 1; one that only stands for something else, be it another effect, a
cause outside the library or what does not repeat, has as often nothing to do with other trials, S = 0, as it does good
or harm there, -R to R. So a small effect leaves only where one of its size would have shown. What does more harm than R
does all that there is, in each draw of the blocks too: the error of such a share grows with it, and would hide that.
Bayes' rule on the two takes an effect away that closes nothing on data that did not choose it. It makes none more
probable: an impostor closes a gap as well. What loses more than half of its probability leaves, one effect after the
other, and with it every set that holds it: the best of the others is judged next. Shares are those of what remains.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from bayes_damper.calibration import Calibration, calibrate
from bayes_damper.diagnosis.remainder import odd_shapes
from bayes_damper.diagnosis.sets import (
    Member,
    SetFit,
    SetProblem,
    log_prior,
    probabilities,
    set_fit,
    squares_of,
    weighed,
)
from bayes_damper.diagnosis.shares import DOUBT, NO_SHARE, UNTESTED, Closed, Products, products_of, shortest_interval
from bayes_damper.diagnosis.verdict import FLOOR, RULE, Answers, Left, Rule, imitated
from bayes_damper.rig.parameters import OF_EFFECT
from bayes_damper.runs.contents.diagnosis import BudgetEntry, Estimate

Array = NDArray[np.float64]

SUBSET_STEPS = 12  # of the fits of smaller sets, which begin where the best set's lies
LEAST_REACH = 1e-3  # share of the gap
UNLIKELY = 0.01  # probability of a set below which it is not asked what it leaves
BORNE_OUT = 0.5  # of its probability that an effect must keep on held-out trials to be in the budget


@dataclass(frozen=True)
class Part:
    """One effect of the budget: probability that it is present, its share of the gap, names of its coordinates.

    kept: share of its probability that held-out trials leave it.
    """

    member: Member
    present: float
    share: Closed
    parameters: Mapping[str, str]
    kept: float = 1.0

    @property
    def name(self) -> str:
        """The effect."""
        return self.member[0].name


@dataclass(frozen=True, eq=False)
class Budget:
    """Parts, the largest share first; unexplained: share of the gap; sites: where that lies; best: the set behind it.

    leading: probability that each part, or "unknown", has the largest share; absent: effects of the set that readings
    chose which close nothing on held-out ones.
    """

    best: SetFit
    parts: tuple[Part, ...]
    unexplained: Closed
    sites: Mapping[str, float]
    leading: Mapping[str, float]
    absent: tuple[Part, ...] = ()

    @property
    def method(self) -> str:
        """How the shares were measured, in words."""
        how = self.unexplained.how
        divided = "; each effect closes what it does on average over all orders of adding the effects (Shapley)"
        return how if self.unexplained.median is None else how + divided

    def to_json(self, estimate: Callable[[str, str], Estimate]) -> BudgetEntry:
        """The `budget` of diagnosis.json; estimate : (coordinate, unit) -> value, sd and interval of a parameter."""
        return {
            "effects": [
                {
                    "name": part.name,
                    "variant": part.member[1].name,
                    "formula": part.member[1].formula,
                    "site": part.member[0].site,
                    "present": part.present,
                    "share": part.share.to_json(),
                    "parameters": {
                        p.name: estimate(part.parameters[p.name], p.unit) for p in part.member[1].parameters
                    },
                }
                for part in self.parts
            ],
            "unexplained": {"share": self.unexplained.to_json(), "sites": dict(self.sites), "law": None},
            "leading": dict(self.leading),
            "absent": [{"name": p.name, "present": p.present, "share": p.share.to_json()} for p in self.absent],
            "method": self.method,
        }


def budget_of(
    nominal: Calibration,
    sets: Sequence[SetFit],
    offered: int,
    outside: Mapping[frozenset[str], float],
    rng: np.random.Generator | None = None,
    shows: bool = False,
) -> Budget:
    """The budget of weighed sets, without sites.

    offered : effects that the rig can have; outside : probability that a cause outside the library does what a set
    explains, for the sets that are likely; shows : whether noise cannot account for what the nominal model leaves. What
    no effect explains is then an unknown cause, which divides no gap, and the best set with a name shows how far it
    would close it.
    """
    absent: list[Part] = []
    left = list(sets)
    while True:
        weights = probabilities(left, offered)
        named = [names for names in weights if names and "unknown" not in names and weights[names] > UNLIKELY]
        top = max(named if shows and named else weights, key=lambda names: weights[names])
        top = frozenset() if "unknown" in top else top  # of generic.py
        best = next(s for s in left if s.names == top)
        parts, unexplained, leading = _parts(nominal, best, sets, weights, outside, rng)
        least = min(parts, key=lambda part: part.kept, default=None)
        if least is None or least.kept >= BORNE_OUT:
            return Budget(best, parts, unexplained, {}, leading, tuple(absent))
        absent.append(least)
        smaller = _smaller(nominal, best, sets, best.names - {least.name})
        left = [s for s in left if least.name not in s.names]
        left += [] if any(s is smaller for s in left) else [smaller]


def _parts(
    nominal: Calibration,
    best: SetFit,
    sets: Sequence[SetFit],
    weights: Mapping[frozenset[str], float],
    outside: Mapping[frozenset[str], float],
    rng: np.random.Generator | None,
) -> tuple[tuple[Part, ...], Closed, dict[str, float]]:
    """Effects of a set with their shares, largest first, what is unexplained, and which share is the largest."""
    heldout = nominal.problem.experiment.heldout
    names = [e.name for e, _ in best.members]
    found = _shares(nominal, best, sets, heldout, rng) if heldout else None
    nothing = NO_SHARE if heldout else UNTESTED
    shares, beyond, unexplained, leading = found or (dict.fromkeys(names, nothing), {}, nothing, {})
    parts = []
    for member in best.members:
        name = member[0].name
        acts = sum(p * (1.0 - outside.get(names, 0.0)) for names, p in weights.items() if name in names)
        present = acts
        if name in beyond:
            more, error, reach = beyond[name]
            present = borne_out(more, error, acts, reach)
        parts.append(Part(member, present, shares[name], _coordinates(best, name), present / max(acts, 1e-300)))
    parts.sort(key=lambda part: -(part.share.median if part.share.median is not None else part.present))
    return tuple(parts), unexplained, leading


def borne_out(share: float, error: float, acts: float, reach: float = 1.0) -> float:
    """Probability that an effect acts, after its share of the gap on held-out trials is known with standard error.

    error : of the share with draws no less than -reach; acts : the probability before; reach : the largest share that
    such an effect has (R above).
    """
    share, error = max(-reach, min(share, reach)), max(error, 1e-9)
    above = ndtr((reach - share) / error)
    inside = acts * (above - ndtr(-share / error)) / reach
    harm = 0.5 * (above - ndtr((-reach - share) / error)) / reach
    nothing = math.exp(-0.5 * min((share / error) ** 2, 1400.0)) / (error * math.sqrt(2.0 * math.pi))
    other = (1.0 - acts) * 0.5 * (harm + nothing)
    return min(acts, float(inside / (inside + other))) if inside > 0.0 else 0.0


def _coordinates(best: SetFit, effect: str) -> dict[str, str]:
    """Name of each parameter of an effect -> that of its coordinate in the best set's fit."""
    problem = best.fit.problem
    if isinstance(problem, SetProblem):
        return problem.parameters_of(effect)
    return {p.name: OF_EFFECT + p.name for p in best.members[0][1].parameters}


Shares = tuple[dict[str, Closed], dict[str, tuple[float, float, float]], Closed, dict[str, float]]


def _shares(
    nominal: Calibration, best: SetFit, sets: Sequence[SetFit], heldout: Sequence[int], rng: np.random.Generator | None
) -> Shares | None:
    """Share of each effect; its share beyond all others, with standard error and reach; share unexplained; and
    probability that each is the largest. None where held-out trials show no gap.
    """
    names = [e.name for e, _ in best.members]
    smaller = [frozenset(some) for n in range(1, len(names)) for some in combinations(names, n)]
    fits = {some: _subset(nominal, best, sets, some) for some in smaller}
    keys = [frozenset[str](), *smaller, best.names] if names else [frozenset[str]()]
    models = [nominal, *(fits[k] for k in smaller), best.fit] if names else [nominal]
    found = products_of(models, heldout, rng)
    if not found.is_known():
        return None
    squares = np.array([squares_of(nominal, model) for model in models])
    gained = float(squares[0] - squares[-1])
    fitted = squares / gained if gained > 0.0 else np.zeros_like(squares)
    left, draws = found.shares()
    return _divided(names, {k: i for i, k in enumerate(keys)}, left, draws, fitted, found)


def _divided(
    names: Sequence[str], place: Mapping[frozenset[str], int], left: Array, draws: Array, fitted: Array, found: Products
) -> Shares:
    """Shapley's shares of what each subset of effects leaves: left, fitted (subsets,), draws (draws, subsets).

    fitted : on the trials that were fitted, where all effects together close the whole gap.
    """
    out: dict[str, Closed] = {}
    beyond, columns = {}, {}
    last = place[frozenset(names)]
    for name in names:
        without = place[frozenset(names) - {name}]
        share, drawn, own = (x[..., without] - x[..., last] for x in (left, draws, fitted))
        reach = float(np.clip(2.0 * own, LEAST_REACH, 1.0))
        beyond[name] = float(share), float(np.std(np.maximum(drawn, -reach))), reach
    harmful = np.mean(draws <= 1.0, axis=0) < DOUBT
    harmful[last] = False
    left, draws = np.where(harmful, 1.0, left), np.where(harmful, 1.0, draws)
    for name in names:
        columns[name] = drawn = _shapley(name, names, place, draws)
        out[name] = Closed(float(_shapley(name, names, place, left)), shortest_interval(np.sort(drawn)), found.method)
    columns["unknown"] = draws[:, last]
    unexplained = Closed(float(left[last]), shortest_interval(np.sort(draws[:, last])), found.method)
    largest = np.argmax(np.stack(list(columns.values())), axis=0)
    return out, beyond, unexplained, {n: float(np.mean(largest == k)) for k, n in enumerate(columns)}


def _shapley(name: str, names: Sequence[str], place: Mapping[frozenset[str], int], left: Array) -> Array:
    """What an effect closes beyond those before it, averaged over all orders; left (..., subsets): what each leaves."""
    others = [n for n in names if n != name]
    total = np.zeros(left.shape[:-1])
    for size in range(len(names)):
        weight = math.factorial(size) * math.factorial(len(others) - size) / math.factorial(len(names))
        for before in combinations(others, size):
            a, b = place[frozenset(before)], place[frozenset((*before, name))]
            total = total + weight * (left[..., a] - left[..., b])
    return total


def _smaller(nominal: Calibration, best: SetFit, sets: Sequence[SetFit], some: frozenset[str]) -> SetFit:
    """The set of some of the best one's effects, weighed beside the others."""
    known = next((s for s in sets if s.names == some), None)
    if known is not None:
        return known
    members = tuple(m for m in best.members if m[0].name in some)
    new = set_fit(members, _subset(nominal, best, sets, some))
    return next(s for s in weighed([*sets, new]) if s.members is members)


def _subset(nominal: Calibration, best: SetFit, sets: Sequence[SetFit], some: frozenset[str]) -> Calibration:
    """The fit of some of the best set's effects: a known one of the same formulas, or one from the best's place."""
    members = tuple(m for m in best.members if m[0].name in some)
    for s in sets:
        if s.names == some and all(any(v is w for _, w in s.members) for _, v in members):
            return s.fit
    whole = best.fit.problem
    assert isinstance(whole, SetProblem)
    problem = SetProblem(nominal.problem.with_noise(whole.noise), members, whole.exact)
    labels = [label for m in members for label in whole.parameters_of(m[0].name).values()]
    own = [whole.names.index(label) for label in labels]
    n = nominal.problem.size
    starts = [np.concatenate([q, best.fit.q[own]]) for q in (best.fit.q[:n], nominal.q)]
    return calibrate(
        problem, starts, eta=best.fit.eta, anneal=False, most=SUBSET_STEPS, finish=False, straight=whole.exact
    )  # fmt: skip


# Answers where no trial has repeats ---------------------------------------------------------------------------------


def foreign_alone(left: float, rule: Rule = RULE, odd: float = 0.0) -> float:
    """Probability that a cause outside the library does what a set explains that leaves this share of the gap."""
    return imitated(max(min(left, 1.0), rule.least), odd, rule)


def misses_alone(left: float, rule: Rule = RULE) -> float:
    """Probability that a set is no explanation, since it leaves this share of what noise does not account for.

    Evidence is the likelihood under noise that stands for the error of the model too. Where that is not what it is
    taken for, coloured noise say, or one trial that went wrong, a set may have much evidence and close next to nothing.
    """
    return rule.large(left, rule.share_lone)


def idle_alone(left: float, none: Left, rule: Rule = RULE) -> float:
    """Probability that nothing is missing although a set has evidence: it closes little, and noise accounts for that.

    none : what the nominal model leaves.
    """
    return misses_alone(left, rule) * (1.0 - rule.seen(none.nats)) * min(left, 1.0)


def answers_of(
    budget: Budget,
    sets: Sequence[SetFit],
    offered: Sequence[str],
    alone: Mapping[str, float],
    shares: Mapping[frozenset[str], float],
    none: Left,
    left: Left,
    generic: float = -math.inf,
    rule: Rule = RULE,
) -> Answers:
    """Probabilities of all answers from weighed sets: a set speaks for the effect with its largest share.

    `unknown` stands for what a cause outside the library does, for a gap that no set explains, and for the largest
    share being that which stays unexplained. A set that closes little is no explanation: there is none where noise
    accounts for what the nominal model leaves, else an unknown one. offered : all effects; alone : effect -> log
    evidence of its set of one, which decides for what other sets than the budget's speak; shares : that each likely
    set leaves; none, left : what the nominal model and the best set leave; generic : log evidence of an unnamed cause
    that was fitted, such as exchanged channels.
    """
    weights = probabilities(sets, len(offered))
    fits = {s.names: s.fit for s in reversed(sets)}
    known = sets[0].evidence
    other = math.exp(min(generic + log_prior(("unknown",), len(offered)) - known, 60.0)) if generic > 0.0 else 0.0
    scale = 1.0 / (1.0 + other)
    out = dict.fromkeys(("none", "unknown", *offered), 0.0)
    out["unknown"] = other * scale
    seen = rule.seen(none.nats)
    pair, pair_effects = 0.0, None
    for names, weight in weights.items():
        p = weight * scale
        if not names:
            out["none"] += p * (1.0 - seen)
            out["unknown"] += p * seen
            continue
        share = shares.get(names, 1.0)
        missed, idle = misses_alone(share, rule), idle_alone(share, none, rule)
        out["none"] += p * idle
        out["unknown"] += p * (missed - idle)
        p *= 1.0 - missed
        lost = 1.0 if "unknown" in names else foreign_alone(share, rule, odd_shapes(fits[names]))
        leading: Mapping[str, float] = budget.leading if names == budget.best.names else {}
        if not leading:
            leading = {max(sorted(names), key=lambda n: alone.get(n, -math.inf)): 1.0}
        for name, largest in leading.items():
            out[name] += p * (1.0 - lost) * largest
        out["unknown"] += p * lost
        if names == budget.best.names and len(names) > 1:
            pair, pair_effects = p * (1.0 - lost), (budget.parts[0].name, budget.parts[1].name)
    mixed = {n: (1.0 - FLOOR) * p + FLOOR / len(out) for n, p in out.items()}
    total = sum(mixed.values())
    return Answers({n: p / total for n, p in mixed.items()}, 1.0, left, out["unknown"], pair, pair_effects)
