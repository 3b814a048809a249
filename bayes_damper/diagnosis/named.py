"""The learnt law, named: which short formula of a stated grammar makes the torque that is missing, if one does.

The records' response to each term of the grammar (effects/_formula.py) is taken along the motion of a fit. With all
that parameters and nuisances can do taken out, the evidence of any sum of terms follows from one Gram matrix: all
single terms and pairs are compared, and triples that hold one of the best pairs. The best single term, the best pair
and the best triple are fitted through the nonlinear model with everything free, up to the first that leaves no more
than noise, and what a posterior does not ask for is dropped. Along the motion of the best fit, which is nearly the
rig's own, all are compared again, with the formula's torque put back among what is missing; what comes near the best is
fitted too, and these fits decide, by the same integral as the learnt law's. Of a formula and the same with further
terms only the likelier one is kept.

"None of these" is a model too: the learnt law, or the best formula beside a discrepancy of a size of its own (as in
sets.py), whichever is likelier. Prior probability: half for it, the other half in equal parts for one, two and three
terms, and within these for each combination alike.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_damper.calibration import Calibration, Problem, coordinate_of
from bayes_damper.diagnosis.response import Motion, Projected, in_slices, motions, project, whiten
from bayes_damper.diagnosis.sets import Member, SetProblem, from_cheapest, left_over
from bayes_damper.diagnosis.shapes import dahl, relaxed
from bayes_damper.effects._formula import GRAMMAR, MOST_TERMS, SHAPE_UNITS, TERMS, FormulaTerm, formula_variant
from bayes_damper.effects.base import Effect
from bayes_damper.priors.distributions import LogUniform, Normal, from_standard
from bayes_damper.runs.contents.diagnosis import NamedEntry, NamedFormula, TermEntry
from bayes_damper.simulation.links import of_links

Array = NDArray[np.float64]
Coordinates = Callable[[Motion, int], tuple[Array, Array] | None]
Formula = tuple[FormulaTerm, ...]

ABSORBED = 1e-3  # share of a response that has to be left beyond what the nominal laws can do
SIZES = np.geomspace(1.0, 1e4, 9)  # prior sizes of a formula's response, in noise standard deviations
BEAM = 60  # pairs that are continued to triples
CLOSER = 12  # formulas whose shapes are looked at more closely
FITTED = 2  # further formulas fitted in full in each round
ROUNDS = 2
MOST_FITS = 6
NEAR = 12.0  # nats behind the best, beyond which a formula is not fitted
SHOWN = 3
STEPS = 14
STARTS = (1.0, 0.7, 0.4, 0.0)  # shares of the linearised answer from which a fit may begin
PRIOR_NONE = 0.5
WORTH_A_TERM = 5.0  # nats that a term of a generic law, or a discrepancy, costs: its size is learnt
WAVES = np.arange(1.0, 20.0, 0.75)  # k times the largest angle: finer than a wave differs from the next
SHARES = np.array([0.03, 0.06, 0.12, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])
FADES = np.array([0.05, 0.1, 0.2, 0.4, 0.8, 1.6])  # times over the record's length
MEMORIES = np.array([0.1, 0.3, 1.0, 3.0, 10.0])  # times over the period over 2 pi
BETWEEN = (-0.6, -0.3, 0.0, 0.3, 0.6)  # of the way to the next shape, where leading shapes are looked at more closely


@dataclass(frozen=True)
class Entry:
    """A term with its shape, 0 where it has none, and the prior of the shape."""

    term: FormulaTerm
    shape: float = 0.0
    prior: LogUniform | None = None
    count: int = 1


@dataclass(frozen=True, eq=False)
class Place:
    """Where a formula is looked for: a site, its bodies, and the angle and velocity there in a motion.

    at : (motion, body) -> (trials, N) each, None where nothing acts; period : of the motion over 2 pi, s.
    """

    site: str
    bodies: str
    at: Coordinates
    period: float


@dataclass(frozen=True, eq=False)
class Proposal:
    """Terms with their shapes, amounts (n,), sd of the amounts' prior (n,), and evidence in nats, prior included.

    gives_way (size, n): of the parameters where it was found, to a unit of each; None where a fit has no need of it.
    """

    entries: tuple[Entry, ...]
    amounts: Array
    prior: Array
    evidence: float
    gives_way: Array | None = None

    @property
    def formula(self) -> Formula:
        """The terms without their numbers."""
        return tuple(e.term for e in self.entries)


def entries_of(reach: float, fast: float, span: float, period: float) -> list[Entry]:
    """Every term of the grammar with the shapes that are tried: of an angle up to `reach`, a velocity up to `fast`.

    span : of the records, s; period : of the motion over 2 pi, s.
    """
    grids = {
        "k": WAVES / reach, "d": SHARES * reach, "u": SHARES[:6] * fast, "tau": FADES * span,
        "relaxes": MEMORIES * period, "yields": SHARES[:7] * reach,
    }  # fmt: skip
    out = []
    for term in TERMS:
        if not term.shape:
            out.append(Entry(term))
            continue
        grid = grids[term.memory or term.shape]
        prior = LogUniform(float(grid[0] ** 1.5 / grid[1] ** 0.5), float(grid[-1] ** 1.5 / grid[-2] ** 0.5))
        out += [Entry(term, float(x), prior, grid.size) for x in grid]
    return out


def closer(entries: Sequence[Entry], leading: Sequence[Proposal]) -> list[Entry]:
    """Terms without a shape, and those that lead with shapes between their own and the next ones."""
    wanted = {e for p in leading for e in p.entries if e.prior is not None}
    out = [e for e in entries if e.prior is None]
    for e in sorted(wanted, key=lambda e: (e.term.words, e.shape)):
        assert e.prior is not None
        every = np.array([o.shape for o in entries if o.term is e.term])
        k = int(np.argmin(np.abs(every - e.shape)))
        for share in BETWEEN:
            other = every[min(max(k + (1 if share > 0 else -1), 0), every.size - 1)]
            shape = float(every[k] + abs(share) * (other - every[k]))
            finer = Entry(e.term, shape, e.prior, e.count)
            if finer not in out:
                out.append(finer)
    return out


def response(fit: Calibration, m: Motion, place: Place, entries: Sequence[Entry]) -> Array:
    """Whitened responses (trials, k, data) to a unit amount of each term."""
    site = place.site
    q = np.zeros((2, m.th1.shape[0], len(entries), m.grid.size))
    for body in range(2):
        here = place.at(m, body)
        if here is None:
            continue
        x, v = here
        s = m.dry(v)
        on = q[int(body == 1 or site == "ground2")] if site != "interface" else q[1]
        for k, e in enumerate(entries):
            if e.term.memory == "relaxes":
                on[:, k] = relaxed(m, v, e.shape)
            elif e.term.memory:
                on[:, k] = e.shape * dahl(x, e.shape)
            else:
                on[:, k] = e.term.torque(x, v, m.since, s, e.shape)
    if site == "interface":
        q[0] = -q[1]
    return whiten(fit, m.group, m.respond(q[0], q[1]))


def put_back(fit: Calibration, problem: Problem, columns: Sequence[Array], amounts: Array) -> Calibration:
    """The fit as if the formula were missing whose terms make these columns, one (trials, k, data) for each block.

    problem : the same without the formula, whose coordinates stand last in the fit's.
    """
    keep = slice(0, problem.size)
    blocks = tuple(
        replace(b, J=b.J[:, keep], r=b.r - np.einsum("jkd,k->jd", c, amounts))
        for b, c in zip(fit.linear.blocks, columns, strict=True)
    )
    linear = replace(fit.linear.with_blocks(blocks), q=fit.q[keep])
    return replace(fit, problem=problem, q=fit.q[keep], covariance=fit.covariance[keep, keep], linear=linear)


# Proposing ------------------------------------------------------------------------------------------------------------


def log_prior(count: int) -> float:
    """Of a formula of so many terms."""
    return math.log((1.0 - PRIOR_NONE) / MOST_TERMS) - math.log(math.comb(len(TERMS), count))


def proposed(judged: Projected, entries: Sequence[Entry]) -> list[Proposal]:
    """The best shapes of each formula, best first: all of one and two terms, and of three what holds a good pair."""
    alive = np.flatnonzero(np.diag(judged.gram) > ABSORBED * np.maximum(judged.raw, 1e-300))
    unit = 1.0 / np.sqrt(judged.raw[alive])
    gram = unit[:, None] * judged.gram[np.ix_(alive, alive)] * unit
    b = unit * judged.product[alive]
    live = [entries[int(k)] for k in alive]
    words = np.array([TERMS.index(e.term) for e in live])
    shaped = np.array([math.log(e.count) for e in live])
    best: dict[tuple[int, ...], tuple[float, tuple[int, ...]]] = {}
    sets = np.arange(alive.size)[:, None]
    for count in range(1, MOST_TERMS + 1):
        if sets.size == 0:
            break
        value = gains(gram, b, sets) - shaped[sets].sum(axis=1) + log_prior(count)
        level: dict[tuple[int, ...], tuple[float, tuple[int, ...]]] = {}
        for k in np.argsort(-value):
            key = tuple(sorted(int(w) for w in words[sets[k]]))
            if key not in level:
                level[key] = (float(value[k]), tuple(map(int, sets[k])))
        best |= level
        if count == 1:
            sets = np.array([p for p in itertools.combinations(range(alive.size), 2) if words[p[0]] != words[p[1]]])
        else:
            leading = [chosen for _, chosen in list(level.values())[:BEAM]]
            wider = {
                tuple(sorted((*chosen, k)))
                for chosen in leading
                for k in range(alive.size)
                if words[k] not in words[list(chosen)]
            }
            sets = np.array(sorted(wider))
    ranked = sorted(best.values(), key=lambda pair: -pair[0])
    alone = {len(chosen): (value, chosen) for value, chosen in reversed(ranked)}  # the best of each length
    ranked = [*ranked[:BEAM], *(pair for pair in alone.values() if pair not in ranked[:BEAM])]
    out = []
    for value, chosen in ranked:
        i = list(chosen)
        size = best_size(gram, b, i)
        x = np.linalg.solve(gram[np.ix_(i, i)] + np.eye(len(i)) / size**2, b[i])
        out.append(
            Proposal(
                tuple(entries[alive[k]] for k in i), unit[i] * x, unit[i] * size, value, judged.absorbed[:, alive[i]]
            )
        )
    return out


def _not_nested(ranked: Iterable[tuple[Sequence[Hashable], Any]]) -> list[Any]:
    """Of (terms, anything), best first, those that neither hold all terms of a better one nor are part of one."""
    kept: list[tuple[set[Hashable], Any]] = []
    for terms, value in ranked:
        own = set(terms)
        if not any(own > other or own < other for other, _ in kept):
            kept.append((own, value))
    return [value for _, value in kept]


def _by_size(gram: Array, b: Array, sets: NDArray[np.int64]) -> Array:
    """Gain in nats of each set (n, k) of columns, for each prior size, (n, sizes)."""
    values, vectors = np.linalg.eigh(gram[sets[:, :, None], sets[:, None, :]])
    along = np.einsum("nkj,nk->nj", vectors, b[sets]) ** 2
    s = (SIZES**2)[:, None]
    inside = 1.0 + s * np.maximum(values, 0.0)[:, None, :]
    return np.asarray(0.5 * np.sum(s * along[:, None, :] / inside - np.log(inside), axis=2))


def gains(gram: Array, b: Array, sets: NDArray[np.int64]) -> Array:
    """Evidence of each set (n, k) of columns over none of them, nats: the best of the prior sizes, each as likely."""
    parts = np.array_split(sets, max(len(sets) // 20_000, 1))
    return np.concatenate([_by_size(gram, b, p).max(axis=1) for p in parts]) - math.log(SIZES.size)


def best_size(gram: Array, b: Array, chosen: Sequence[int]) -> float:
    """The prior size under which a set of columns has the largest evidence."""
    return float(SIZES[int(np.argmax(_by_size(gram, b, np.array([chosen]))[0]))])


# Weighing -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Weighed:
    """A formula: evidence in nats over the base, prior included; its fit, None if it was left far behind."""

    proposal: Proposal
    evidence: float
    fit: Calibration | None = None
    probability: float = 0.0

    def numbers(self) -> list[tuple[FormulaTerm, tuple[float, float], tuple[float, float]]]:
        """Each term with its amount and its shape, each with its standard deviation, in SI units."""
        entries, fit = self.proposal.entries, self.fit
        if fit is None:
            rough = zip(entries, self.proposal.amounts, strict=True)
            return [(e.term, (float(a), math.nan), (e.shape, math.nan)) for e, a in rough]
        known = list(fit.parameters.values())
        places = _amount_places(entries, len(known))
        return [
            (e.term, known[k], known[k + 1] if e.prior is not None else (0.0, 0.0))
            for e, k in zip(entries, places, strict=True)
        ]

    def words(self) -> str:
        """The formula with its numbers."""
        out = ""
        for term, (amount, _), (shape, _) in self.numbers():
            sign = ("-" if amount < 0.0 else "") if not out else (" - " if amount < 0.0 else " + ")
            written = re.sub(rf"\b{term.shape}\b", f"{shape:.3g}", term.words) if term.shape else term.words
            out += f"{sign}{abs(amount):.3g}" + ("" if written == "1" else f" {written}")
        return out

    def to_json(self, translational: bool) -> NamedFormula:
        """Plain numbers."""
        angle = "m" if translational else "rad"
        units = {"1/angle": f"1/{angle}", "angle": angle, "speed": f"{angle}/s", "s": "s"}
        torque, powered = "N" if translational else "N m", (angle, f"({angle}/s)", "s")
        terms = []
        for term, (a, sd), (shape, shape_sd) in self.numbers():
            per = [f"{unit}^-{power}" for unit, power in zip(powered, term.powers, strict=True) if power]
            row: TermEntry = {"term": term.words, "amount": a, "sd": sd, "unit": " ".join([torque, *per])}
            if term.shape:
                row |= {"shape": term.shape, "value": shape, "value_sd": shape_sd}
                row["value_unit"] = units[SHAPE_UNITS[term.shape]]
            terms.append(row)
        return {
            "formula": self.words(), "probability": self.probability, "fitted": self.fit is not None, "terms": terms,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Named:
    """The best formulas, best first, and the probability that it is none of the grammar."""

    formulas: tuple[Weighed, ...]
    shape_only: float

    def in_words(self) -> tuple[tuple[str, float], ...]:
        """Each formula with its numbers, and its probability."""
        return tuple((w.words(), w.probability) for w in self.formulas)

    def to_json(self, translational: bool = False) -> NamedEntry:
        """The `law.named` of diagnosis.json."""
        return {
            "formulas": [w.to_json(translational) for w in self.formulas],
            "shape_only": self.shape_only,
            "grammar": GRAMMAR,
        }


def name_law(
    law: Calibration, terms: int, base: Calibration, nominal: Calibration, members: Sequence[Member], place: Place
) -> Named | None:  # fmt: skip
    """The best formulas for what a learnt law of so many terms stands for; None if no term can make anything.

    law : its fit; base : the fit without it, under the same noise, with the effects that stand beside it (members).
    """
    ranked = _ranked(base, place)
    if not ranked:
        return None
    found: dict[Formula, Weighed] = {}

    def add(fit: Calibration, p: Proposal) -> Weighed:
        evidence = fit.log_evidence - base.log_evidence - math.log(SIZES.size) + log_prior(len(p.entries))
        new = Weighed(p, evidence, fit)
        if p.formula not in found or evidence > found[p.formula].evidence:
            found[p.formula] = new
        return new

    def follow(p: Proposal, where: Calibration) -> None:
        new = add(_fitted(p, where, nominal, members, place), p)
        fewer = _pruned(new)
        if fewer is not None and fewer.formula not in found:
            add(_fitted(fewer, where, nominal, members, place), fewer)

    def many() -> bool:
        return sum(w.fit is not None for w in found.values()) >= MOST_FITS

    for count in range(1, MOST_TERMS + 1):
        if (shortest := next((p for p in ranked if len(p.entries) == count), None)) is not None:
            follow(shortest, base)
        if any(_is_whole(w) for w in found.values()):
            break
    for _ in range(ROUNDS):
        best = max(found.values(), key=lambda w: w.evidence)
        near, ranked = _again(best, base, place)
        fresh = [p for p in _apart(ranked, best) if p.formula not in found]
        leading = [p for p in fresh if p.evidence > best.evidence - NEAR][:FITTED]
        for p in leading:
            if not many():
                follow(p, near)
        if many() or max(found.values(), key=lambda w: w.evidence) is best:
            break
    for p in ranked:
        if p.formula not in found:
            found[p.formula] = Weighed(p, min(p.evidence, best.evidence - NEAR))
    return _weighed(list(found.values()), law, terms, base)


def _is_whole(w: Weighed) -> bool:
    """Whether a formula leaves no more than noise."""
    assert w.fit is not None
    squares, pieces = left_over(w.fit)
    return discrepancy(squares, pieces) < WORTH_A_TERM


def discrepancy(squares: float, pieces: float) -> float:
    """Gain in nats of a discrepancy of a size of its own over noise alone (sets.py)."""
    return 0.5 * squares - 0.5 * pieces * math.log1p(squares / pieces)


def _apart(ranked: Sequence[Proposal], best: Weighed) -> list[Proposal]:
    """Formulas that are neither the best one with more terms nor part of each other."""
    own = set(best.proposal.formula)
    return _not_nested((p.formula, p) for p in ranked if not set(p.formula) > own)


def _weighed(found: Sequence[Weighed], law: Calibration, terms: int, base: Calibration) -> Named:
    order = _not_nested([(w.proposal.formula, w) for w in sorted(found, key=lambda w: -w.evidence)])
    best = order[0]
    assert best.fit is not None
    squares, pieces = left_over(best.fit)
    beside = best.evidence + discrepancy(squares, pieces) - WORTH_A_TERM
    learnt = math.log(PRIOR_NONE) + law.log_evidence - base.log_evidence - WORTH_A_TERM * terms
    logs = np.array([max(beside, learnt), *(w.evidence for w in order)])
    p = np.exp(logs - logsumexp(logs))
    shown = [replace(w, probability=float(x)) for w, x in zip(order, p[1:], strict=True)]
    return Named(tuple(shown[:SHOWN]), float(p[0]))


def _pruned(w: Weighed) -> Proposal | None:
    """The formula without the terms whose absence is likelier, by the posterior of the amounts at nothing."""
    fit, entries = w.fit, w.proposal.entries
    assert fit is not None
    at = _amount_places(entries, fit.problem.size)
    mean, covariance = fit.q[at], fit.covariance[np.ix_(at, at)]
    best, keep = 0.0, None
    for count in range(1, len(entries)):
        for kept in itertools.combinations(range(len(entries)), count):
            out = [k for k in range(len(entries)) if k not in kept]
            inside = covariance[np.ix_(out, out)]
            sign, log_det = np.linalg.slogdet(inside)
            if not (sign > 0 and np.isfinite(log_det)):
                continue
            # Density at nothing of the posterior over that of the prior.
            gain = -0.5 * (log_det + float(mean[out] @ np.linalg.solve(inside, mean[out])))
            gain += log_prior(count) - log_prior(len(entries))
            if gain > best:
                best, keep = gain, kept
    if keep is None:
        return None
    now = _as_fitted(w)
    i = list(keep)
    return Proposal(tuple(now.entries[k] for k in i), now.amounts[i], now.prior[i], w.evidence + best)


def _amount_places(entries: Sequence[Entry], size: int) -> list[int]:
    """Places of the amounts among so many coordinates, the last of which are the formula's."""
    counts = [1 + (e.prior is not None) for e in entries]
    first = size - sum(counts)
    return [first + sum(counts[:k]) for k in range(len(entries))]


def _as_fitted(w: Weighed) -> Proposal:
    """The proposal with the amounts and shapes of its fit."""
    assert w.fit is not None
    q, p = w.fit.q, w.proposal
    at = _amount_places(p.entries, q.size)
    entries = tuple(
        e if e.prior is None else replace(e, shape=float(from_standard(e.prior, q[k + 1])))
        for e, k in zip(p.entries, at, strict=True)
    )
    return replace(p, entries=entries, amounts=q[at] * p.prior)


def _again(best: Weighed, base: Calibration, place: Place) -> tuple[Calibration, list[Proposal]]:
    """The best formula's fit as if it were missing, and all formulas compared there."""
    assert best.fit is not None
    fit, now = in_slices(best.fit), _as_fitted(best)
    moved = motions(fit)
    columns = [response(fit, m, place, now.entries) for m in moved]
    problem = base.problem.with_noise(fit.problem.noise)
    near = put_back(fit, problem, columns, now.amounts)
    return near, _ranked(near, place, moved, now.entries)


def _ranked(
    bare: Calibration, place: Place, moved: Sequence[Motion] = (), known: Sequence[Entry] = ()
) -> list[Proposal]:  # fmt: skip
    """All formulas compared, best first; moved : along these motions, the fit's own if none are given."""
    if not moved:
        bare = in_slices(bare)
        moved = motions(bare)
    acting = [(c, m) for m in moved for body in range(2) if (c := place.at(m, body)) is not None]
    reach = max(float(np.abs(x[m.since > 0.0]).max()) for (x, _), m in acting)
    fast = max(float(np.abs(v[m.since > 0.0]).max()) for (_, v), m in acting)
    span = max(float(m.since.max()) for _, m in acting)
    coarse = entries_of(reach, fast, span, place.period)
    entries = [*coarse, *(e for e in known if e.prior is not None)]
    found: list[Proposal] = []
    for again in range(2):
        judged = project(bare, (response(bare, m, place, entries) for m in moved))
        found = proposed(judged, entries)
        if again or not found:
            break
        fine = closer(coarse, found[:CLOSER])
        entries = [*fine, *(e for e in known if e.prior is not None and e not in fine)]
    return found


def _fitted(
    proposal: Proposal, bare: Calibration, nominal: Calibration, members: Sequence[Member], place: Place
) -> Calibration:
    """A formula fitted with everything free, from the linearised answer at `bare`."""
    priors: list[Any] = []
    start: list[float] = []
    for e, a, sd in zip(proposal.entries, proposal.amounts, proposal.prior, strict=True):
        priors.append(Normal(0.0, float(sd)))
        start.append(float(a / sd))
        if e.prior is not None:
            priors.append(e.prior)
            start.append(coordinate_of(e.prior, e.shape))
    middle = [float(p.ppf(0.5)) for p in priors]
    variant = formula_variant(proposal.formula, place.site, place.bodies, priors, (middle,))
    if nominal.problem.experiment.coupling_law == "cosine" and place.site == "bearings":
        variant = of_links(variant)
    effect = Effect(f"named_{place.site}", place.site, "", "", (), "", (variant,))  # type: ignore[arg-type]
    problem = SetProblem(nominal.problem.with_noise(bare.problem.noise), [*members, (effect, variant)], exact=False)
    S, g, _ = bare.linear.normal().reduced()
    shift = proposal.gives_way @ proposal.amounts - np.linalg.solve(S, g) if proposal.gives_way is not None else 0.0 * g
    amounts = np.zeros(problem.size, bool)
    amounts[_amount_places(proposal.entries, problem.size)] = True
    amounts = amounts[-len(start) :]
    starts = [
        np.concatenate([bare.q + share * shift, np.where(amounts, share, 1.0) * np.array(start)]) for share in STARTS
    ]
    return from_cheapest(problem, starts, bare.eta, STEPS)
