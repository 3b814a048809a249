"""The missing law, learnt: what stays unexplained as a smooth function of its site's own coordinates.

At the most probable site, the records' response to a vocabulary of generic terms (carriers times Chebyshev polynomials
of an angle, a velocity or the time; effects/_law.py) is taken at the fit, cleared of all that parameters and nuisances
can do. Terms are added one at a time while the evidence grows; each has a size and a smoothness of its own, learnt.
What the records decide of the chosen terms is brought to a dozen directions at most, and these are fitted through the
nonlinear model with everything else free. Training trials decide all of that; the share of the gap that the law closes
comes from held-out trials (shares.py), and a law is offered only where its 90 % interval lies above 0.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Calibration, calibrate, learn_noise
from bayes_damper.diagnosis.budget import Budget
from bayes_damper.diagnosis.named import Named, Place, name_law
from bayes_damper.diagnosis.remainder import own_frequency
from bayes_damper.diagnosis.response import Motion, Projected, in_slices, motions, project, whiten
from bayes_damper.diagnosis.sets import Member, SetProblem, from_cheapest
from bayes_damper.diagnosis.shares import Closed, products_of, shortest_interval
from bayes_damper.diagnosis.sites import TEMPERING, SiteMap
from bayes_damper.effects._law import (
    CARRIERS,
    COORDINATES,
    MOST_DIRECTIONS,
    ORDER,
    SITES,
    Law,
    Term,
    basis_of,
    free_law,
    term_words,
    variant_of,
    written,
)
from bayes_damper.effects.base import Effect, EffectParameter
from bayes_damper.priors.distributions import Normal
from bayes_damper.rig.parameters import OF_EFFECT
from bayes_damper.runs.contents.diagnosis import LawEntry
from bayes_damper.simulation.links import of_links

Array = NDArray[np.float64]

TERMS = tuple(
    (carrier, along) for along in COORDINATES for carrier in CARRIERS if carrier != along
)  # x f(x) and v f(v) are f(x) and f(v)
MOST_CHOSEN = 3  # terms of a law
WORTH_A_TERM = 5.0  # nats that a further term has to add: a dozen to choose from, and its own size
WORTH_TIME = 2.0  # tempered nats from which a law depends on the time
SIZES = np.geomspace(1.0, 1e4, 9)  # prior sizes of a term's response, in noise standard deviations
SMOOTHNESS = (0.5, 0.75, 1.0)  # factor on the prior size from one Chebyshev order to the next
PRESENT = 0.5  # probability from which an effect stands beside the law
LEAST_SHARE = 0.02  # of the nominal model's gap: less than that, beside effects that close nearly all, is no law
STEPS = 14
RELEARNT = 2
WORTH_RELEARNING = 0.7  # share of the noise that a law leaves, below which it is learnt again
STARTS = (1.0, 0.6, 0.3, 0.0)  # shares of the linearised answer from which the fit may begin
TABLE = {1: 101, 2: 41, 3: 17}  # points along each coordinate of the table, by the number of coordinates


@dataclass(frozen=True, eq=False)
class Learnt:
    """A learnt law with the fit behind it.

    closes: share of the nominal model's gap that the law closes on held-out trials, beyond what the effects beside it
    close; of_the_rest: of what those leave; freedom: effective degrees of freedom; fit: everything free, the law's
    coefficients too; density: readings in cells of angle and velocity (n, n), and the cells' edges (n + 1,); named: the
    short formulas that may stand for it.
    """

    law: Law
    closes: Closed
    of_the_rest: Closed
    freedom: float
    fit: Calibration
    density: tuple[Array, Array, Array]
    named: Named | None = None

    @property
    def file(self) -> str:
        """The law's file below the folder of the diagnosis."""
        return f"learnt/{self.law.site}.toml"

    def to_json(self) -> LawEntry:
        """The `law` of diagnosis.json."""
        law = self.law
        return {
            "site": law.site,
            "bodies": law.bodies,
            "effect": law.name,
            "file": self.file,
            "formula": " + ".join(term_words(t) for t in law.terms),
            "beside": list(law.beside),
            "closes": self.closes.to_json(),
            "closes_of_the_rest": self.of_the_rest.to_json(),
            "effective_degrees_of_freedom": self.freedom,
            "ranges": {name: list(bounds) for name, bounds in law.ranges.items()},
            "named": None if self.named is None else self.named.to_json((law.rig or {}).get("kind") == "translational"),
            "parameters": dict(law.nominal or {}),
            "tables": [f"learnt/{law.site}.csv", f"learnt/{law.site}_table.csv"],
        }

    def write(self, folder: Path) -> None:
        """The law as an effect's file, its curves with bands and a table over its coordinates, in `folder`/learnt."""
        home = folder / "learnt"
        home.mkdir(parents=True, exist_ok=True)
        (folder / self.file).write_text(written(self.law), encoding="utf-8")
        _write_rows(home / f"{self.law.site}.csv", *self._curves())
        _write_rows(home / f"{self.law.site}_table.csv", *self._table())

    def _curves(self) -> tuple[list[str], list[list[Any]]]:
        """Each term's curve without its carrier: coordinate, torque, sd."""
        rows: list[list[Any]] = []
        for k, term in enumerate(self.law.terms):
            rows += [[k + 1, term.carrier, term.along, *row] for row in zip(*self.law.curve(k), strict=True)]
        effort, sd = self._heads("torque", "torque_sd")
        return ["term", "carrier", "along", "at", effort, sd], rows

    def _table(self) -> tuple[list[str], list[list[Any]]]:
        """The whole law over the coordinates that it uses."""
        law = self.law
        used = used_coordinates(law.terms)
        axes = [np.linspace(*law.ranges[name], TABLE[len(used)]) for name in used]
        grid = dict(zip(used, (g.ravel() for g in np.meshgrid(*axes, indexing="ij")), strict=True))
        nothing = np.zeros(next(iter(grid.values())).size)
        value, sd = law.torque(*(grid.get(name, nothing) for name in COORDINATES))
        columns = [*grid.values(), value, sd]
        if "angle" in grid and "speed" in grid:
            columns.append(self._seen(grid["angle"], grid["speed"]))
        head = self._heads(*used, "torque", "torque_sd")
        head += ["readings_nearby"] if len(columns) > len(head) else []
        return head, [list(row) for row in zip(*columns, strict=True)]

    def _seen(self, angle: Array, speed: Array) -> Array:
        """Readings in the cell of each place."""
        count, angles, speeds = self.density
        i = np.clip(np.searchsorted(angles, angle, side="right") - 1, 0, count.shape[0] - 1)
        j = np.clip(np.searchsorted(speeds, speed, side="right") - 1, 0, count.shape[1] - 1)
        return count[i, j]

    def _heads(self, *names: str) -> list[str]:
        """Names of columns with their units, in the words of the rig."""
        kind = (self.law.rig or {}).get("kind")
        return [_HEADS[name][kind == "translational"] for name in names]


_HEADS = {
    "angle": ("angle_rad", "position_m"), "speed": ("speed_rad_s", "speed_m_s"), "time": ("time_s", "time_s"),
    "torque": ("torque_n_m", "force_n"), "torque_sd": ("torque_sd_n_m", "force_sd_n"),
}  # fmt: skip
"""Columns of the tables of a learnt law, on a torsional rig and on a translational one."""


def used_coordinates(terms: Sequence[Term]) -> list[str]:
    """Coordinates that a law depends on, in their order."""
    named = {t.along for t in terms} | {"speed" if t.carrier == "dry" else t.carrier for t in terms}
    return [name for name in COORDINATES if name in named]


def _write_rows(path: Path, head: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(head)
        writer.writerows([[f"{x:.9g}" if isinstance(x, float) else x for x in row] for row in rows])


def learn(
    nominal: Calibration, budget: Budget, verdict: str, place: SiteMap, campaign: str = "", kind: str = "torsional",
    rng: np.random.Generator | None = None, report: Callable[[str], None] = lambda _: None,
) -> Learnt | None:  # fmt: skip
    """The law of what stays unexplained; None where nothing is missing, or no torque, or nothing that is learnt helps.

    budget : effects that are present stand beside the law; place : where the nominal model's gap lies.
    """
    heldout = nominal.problem.experiment.heldout
    if verdict == "none" or not heldout:
        return None
    members = [part.member for part in budget.parts if part.present >= PRESENT]
    if not _above_nothing(budget.unexplained) if members else verdict != "unknown":
        return None
    base = _beside(nominal, budget, members)
    sites = dict(budget.sites) if members else {s: place.probabilities.get(s, 0.0) for s in place.probabilities}
    site = max((s for s in sites if s != "none"), key=lambda s: sites[s], default="none")
    if site not in SITES or (site == "ground2" and not nominal.problem.experiment.coupled):
        return None
    report(f"learning the missing law at {site}")
    under = base
    law, start = _linear(base, site, max(base.chi2 / max(base.problem.n_data, 1.0), 1.0))
    if law is None or start is None:
        return None
    fit, law, freedom = _refitted(nominal, base, budget, members, law, start)
    for _ in range(RELEARNT if nominal.problem.noise.sensor else 0):
        # Without repeats what a model leaves is its noise: a law that leaves less is learnt again under that.
        noise = learn_noise(fit)
        if noise.innovation[0] > WORTH_RELEARNING * fit.problem.noise.innovation[0]:
            break
        again = calibrate(base.problem.with_noise(noise), [base.q], eta=base.eta, anneal=False, most=STEPS)
        finer, start = _linear(again, site, 1.0)
        if finer is None or start is None:
            break
        fit, law, freedom = _refitted(nominal, again, budget, members, finer, start)
        under = again
    shown = products_of([nominal, base, fit], heldout, rng)
    rest = shown.closed(2, before=1)
    closes = _beyond(shown, rest)
    if not _above_nothing(rest) or not worth_offering(closes) or closes.median is None or closes.hdi90 is None:
        return None
    report("comparing formulas for it")
    named = _named(fit, law, nominal, under, budget, members)
    rig = {name: value for name, (value, _) in nominal.problem.experiment.constants.items() if name in ("J1", "J2")}
    moved = motions(in_slices(fit))
    law = replace(
        law, rig={"kind": kind, **rig}, campaign=campaign, beside=tuple(e.name for e, _ in members),
        closes=(closes.median, *closes.hdi90),
        nominal={n: v for n, (v, _) in fit.parameters.items() if not n.startswith(OF_EFFECT)},
        formulas=() if named is None else named.in_words(), shape_only=None if named is None else named.shape_only,
    )  # fmt: skip
    return Learnt(law, closes, rest, freedom, fit, _density(moved, law), named)


def _named(
    fit: Calibration, law: Law, nominal: Calibration, under: Calibration, budget: Budget, members: Sequence[Member]
) -> Named | None:  # fmt: skip
    """Short formulas for a law; under : the fit without it, under the same noise."""
    if members:
        problem = SetProblem(nominal.problem.with_noise(under.problem.noise), members, exact=False)
        start = under.q[_in_order(nominal, under, budget, members)]
        under = calibrate(problem, [start], eta=under.eta, anneal=False, most=STEPS)

    def at(m: Motion, body: int) -> tuple[Array, Array] | None:
        acts = any(n is m and b == body for n, b in acting([m], law.site, law.bodies))
        return coordinates_of(m, law.site, body) if acts else None

    period = 1.0 / (2.0 * math.pi * own_frequency(nominal.problem.experiment))
    return name_law(fit, len(law.terms), under, nominal, members, Place(law.site, law.bodies, at, period))


def _above_nothing(share: Closed) -> bool:
    """Whether a share's interval lies above 0."""
    return share.hdi90 is not None and share.hdi90[0] > 0.0


def worth_offering(closes: Closed) -> bool:
    """Whether a law closes enough of the nominal model's gap, beyond the effects beside it, to be kept."""
    return _above_nothing(closes) and closes.median is not None and closes.median >= LEAST_SHARE


def _beyond(shown: Any, rest: Closed) -> Closed:
    """Share of the nominal model's gap that model 2 closes beyond model 1."""
    if not shown.is_known():
        return Closed(None, None, rest.method)
    left, draws = shown.shares()
    drawn = np.sort(draws[:, 1] - draws[:, 2])
    return Closed(float(left[1] - left[2]), shortest_interval(drawn), shown.method)


def _beside(nominal: Calibration, budget: Budget, members: Sequence[Member]) -> Calibration:
    """The fit that the law is added to: of the effects that are present, or of the nominal model."""
    if not members:
        return nominal
    if len(members) == len(budget.best.members):
        return budget.best.fit
    problem = SetProblem(nominal.problem.with_noise(budget.best.fit.problem.noise), members, exact=False)
    start = np.concatenate([nominal.q, np.zeros(problem.size - nominal.problem.size)])
    return calibrate(problem, [start], eta=nominal.eta, anneal=False, most=STEPS)


# Linearised -----------------------------------------------------------------------------------------------------------


def coordinates_of(m: Motion, site: str, body: int) -> tuple[Array, Array]:
    """Angle and velocity (trials, N) that a law at a site depends on."""
    if site == "interface":
        return m.phi, m.slip
    second = site == "ground2" or body == 1
    return (m.th2, m.w2) if second else (m.th1, m.w1)


def acting(moved: Sequence[Motion], site: str, bodies: str) -> list[tuple[Motion, int]]:
    """Motions in which a law acts, and the bodies whose motion it follows."""
    if site in ("interface", "ground2"):
        return [(m, 0) for m in moved if m.group.coupled]
    both = site == "bearings" and bodies == "both"
    return [(m, b) for m in moved for b in range(1 + int(both and m.group.coupled))]


def ranges_of(moved: Sequence[Motion], site: str, bodies: str) -> dict[str, tuple[float, float]]:
    """Lowest and highest value of each coordinate after the release."""
    every = [(*coordinates_of(m, site, b), m.since) for m, b in acting(moved, site, bodies)]
    out = {}
    for k, name in enumerate(COORDINATES):
        values = [(c[k], c[2] > 0.0) for c in every]
        low = min(float(v[on].min()) for v, on in values)
        high = max(float(v[on].max()) for v, on in values)
        out[name] = (0.0 if name == "time" else low, high if high > low else low + 1e-9)
    return out


def columns_of(
    fit: Calibration,
    m: Motion,
    site: str,
    bodies: str,
    terms: Sequence[Term],
    ranges: Mapping[str, tuple[float, float]],
) -> Array:
    """Whitened responses (trials, k, data) to each coefficient of the terms."""
    size = len(terms) * ORDER
    trials = m.th1.shape[0]
    q = np.zeros((2, trials, size, m.grid.size))
    for body in range(1 + int(m.group.coupled)):
        if not any(n is m and b == body for n, b in acting([m], site, bodies)):
            continue
        x, v = coordinates_of(m, site, body)
        f = basis_of(terms, ranges, m.nu[:, None], x, v, m.since).transpose(0, 2, 1)
        if site == "interface":
            q[0], q[1] = -f, f
        else:
            q[int(site == "ground2" or body == 1)] = f
    return whiten(fit, m.group, m.respond(q[0], q[1]))


@dataclass(frozen=True)
class _Prior:
    """A term that was chosen: its number, prior size over the noise, and smoothness."""

    term: int
    size: float
    smooth: float


def _linear(fit: Calibration, site: str, heat: float) -> tuple[Law | None, tuple[Array, Array, Array] | None]:
    """The law's terms and the linearised answer: directions (k, terms * ORDER), p (k,), and the fit's shift.

    heat : as in `_chosen`.
    """
    fit = in_slices(fit)
    moved = motions(fit)
    best: tuple[float, str, list[Term], dict[str, tuple[float, float]], Projected, list[_Prior]] | None = None
    for bodies in ("both", "primary") if site == "bearings" and any(m.group.coupled for m in moved) else ("both",):
        ranges = ranges_of(moved, site, bodies)
        terms = [Term(c, along, (0.0,) * ORDER) for c, along in TERMS]
        judged = project(fit, (columns_of(fit, m, site, bodies, terms, ranges) for m in moved))
        chosen, gain = best_terms(judged, heat)
        if chosen and (best is None or gain > best[0]):
            best = (gain, bodies, terms, ranges, judged, chosen)
    if best is None:
        return None, None
    _, bodies, terms, ranges, judged, chosen = best
    which = np.concatenate([np.arange(c.term * ORDER, (c.term + 1) * ORDER) for c in chosen])
    prior = np.concatenate([_prior_sd(judged, c) for c in chosen])
    gram = prior[:, None] * judged.gram[np.ix_(which, which)] * prior
    values, vectors = np.linalg.eigh(gram)
    top = np.argsort(-values)[:MOST_DIRECTIONS]
    directions = (prior[:, None] * vectors[:, top]).T
    p = vectors[:, top].T @ (prior * judged.product[which]) / (1.0 + np.maximum(values[top], 0.0))
    shift = judged.absorbed[:, which] @ (directions.T @ p)
    law = Law(
        site, bodies, ranges, float(np.median(np.concatenate([m.nu for m in moved]))),
        tuple(terms[c.term] for c in chosen),
    )  # fmt: skip
    return law, (directions, p, shift)


def _prior_sd(judged: Projected, c: _Prior) -> Array:
    """Prior standard deviations of a term's coefficients (ORDER,), N m."""
    raw = judged.raw[c.term * ORDER : (c.term + 1) * ORDER]
    unit = 1.0 / math.sqrt(max(float(np.mean(raw[:4])), 1e-300))
    return np.asarray(unit * c.size * c.smooth ** np.arange(ORDER))


def best_terms(judged: Projected, heat: float) -> tuple[list[_Prior], float]:
    """Terms of the law, and their gain in nats.

    What repeats share can always be written as a function of time, which says nothing of another release: time comes in
    where a law of angle and velocity is clearly worse, as far as approximate responses tell.
    """
    alive = [k for k in range(len(TERMS)) if judged.raw[k * ORDER : (k + 1) * ORDER].max() > 1e-12]
    lasting = _chosen(judged, heat, [k for k in alive if TERMS[k][1] != "time"])
    every = _chosen(judged, heat, alive)
    clearly = (every[1] - lasting[1]) / (1.0 + TEMPERING * max(every[1], 0.0)) > WORTH_TIME
    return every if clearly else lasting


def _chosen(judged: Projected, heat: float, alive: Sequence[int]) -> tuple[list[_Prior], float]:
    """Terms of some that the evidence asks for, best first, and their gain in nats.

    heat : mean squared residual over the noise: what the model leaves counts as noise until a law explains it.
    """
    chosen: list[_Prior] = []
    total = 0.0

    def gain(priors: Sequence[_Prior]) -> float:
        which = np.concatenate([np.arange(c.term * ORDER, (c.term + 1) * ORDER) for c in priors])
        sd = np.concatenate([_prior_sd(judged, c) for c in priors])
        inside = sd[:, None] * judged.gram[np.ix_(which, which)] * sd / heat
        b = sd * judged.product[which] / heat
        try:
            root = np.linalg.cholesky(inside + np.eye(which.size))
        except np.linalg.LinAlgError:
            return -math.inf
        return float(0.5 * np.sum(np.linalg.solve(root, b) ** 2) - np.sum(np.log(np.diag(root))))

    while len(chosen) < MOST_CHOSEN:
        taken = {c.term for c in chosen}
        tried = [
            (gain([*chosen, c]), c)
            for c in (_Prior(k, s, r) for k in alive if k not in taken for s in SIZES for r in SMOOTHNESS)
        ]
        value, best = max(tried, key=lambda pair: pair[0], default=(-math.inf, None))
        if best is None or value - total < WORTH_A_TERM:
            break
        chosen, total = [*chosen, best], value
        for i, old in enumerate(chosen[:-1]):
            others = [replace(old, size=s, smooth=r) for s in SIZES for r in SMOOTHNESS]
            again = [(gain([*chosen[:i], c, *chosen[i + 1 :]]), c) for c in others]
            value, better = max(again, key=lambda pair: pair[0])
            if value > total:
                chosen[i], total = better, value
    return chosen, total


# Nonlinear ------------------------------------------------------------------------------------------------------------


def _refitted(
    nominal: Calibration, base: Calibration, budget: Budget, members: Sequence[Member], law: Law,
    start: tuple[Array, Array, Array],
) -> tuple[Calibration, Law, float]:  # fmt: skip
    """The fit with everything free, the law at its end, and its effective degrees of freedom."""
    directions, p, shift = start
    count = len(p)
    full = np.zeros((MOST_DIRECTIONS, directions.shape[1]))
    full[:count] = directions
    parameters = tuple(
        EffectParameter(f"a{k}", "1", "Amount of a direction.", Normal(0.0, 1.0), "Its size was learnt.", 0.0)
        for k in range(count)
    )
    kernel = free_law(law.terms, law.ranges, full)
    variant = variant_of(
        "learning", law.site, law.bodies, kernel, law.terms, parameters, ((0.1,) * count,), "Q = law"
    )  # fmt: skip
    if nominal.problem.experiment.coupling_law == "cosine" and law.site == "bearings":
        variant = of_links(variant)
    effect = Effect(law.name, law.site, "", "", (), "", (variant,))  # type: ignore[arg-type]
    problem = SetProblem(
        nominal.problem.with_noise(base.problem.noise), [*members, (effect, variant)], exact=False
    )  # fmt: skip
    order = _in_order(nominal, base, budget, members)
    starts = [np.concatenate([(base.q + share * shift)[order], share * p]) for share in STARTS]
    fit = from_cheapest(problem, starts, base.eta, STEPS)
    own = slice(problem.size - count, problem.size)
    covariance = fit.covariance[own, own]
    values, vectors = np.linalg.eigh(covariance)
    roots = (np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T) @ directions
    coefficients = (fit.q[own] @ directions).reshape(-1, ORDER)
    terms = tuple(replace(t, coefficients=tuple(map(float, c))) for t, c in zip(law.terms, coefficients, strict=True))
    law = replace(law, terms=terms, roots=tuple(tuple(map(float, r)) for r in roots))
    return fit, law, float(count - np.trace(covariance))


def _in_order(nominal: Calibration, base: Calibration, budget: Budget, members: Sequence[Member]) -> list[int]:
    """Coordinates of the base's fit in the order of a set of these members."""
    problem = base.problem
    labels = {part.member[0].name: part.parameters for part in budget.parts}
    if isinstance(problem, SetProblem):
        labels = {e.name: problem.parameters_of(e.name) for e, _ in members}
    own = [labels[e.name][p.name] for e, v in members for p in v.parameters]
    return [*range(nominal.problem.size), *map(problem.names.index, own)]


def _density(moved: Sequence[Motion], law: Law, cells: int = 20) -> tuple[Array, Array, Array]:
    """Readings in cells of (angle, speed), and the cells' edges."""
    edges = [np.linspace(*law.ranges[name], cells + 1) for name in ("angle", "speed")]
    count = np.zeros((cells, cells))
    for m, body in acting(moved, law.site, law.bodies):
        x, v = (c[:, m.at].ravel() for c in coordinates_of(m, law.site, body))
        count += np.histogram2d(x, v, edges)[0]
    return count, edges[0], edges[1]
