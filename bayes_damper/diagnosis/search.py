"""Which effects explain the gap: every variant screened with the linearised problem, the leaders fitted in full.

Screening costs one simulation per trial and start: the finite difference that an effect makes to the records is
projected off everything that the nominal parameters and the nuisances can do, and compared with the residuals. Leaders
are then fitted by calibration.calibrate from several starts, and ranked by Laplace evidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import (
    Block,
    Calibration,
    Experiment,
    Group,
    Linear,
    Normals,
    Problem,
    calibrate,
    coordinate_of,
    grown,
)
from bayes_damper.calibration.experiment import angles_of, late_by_the_clock
from bayes_damper.calibration.heldout import freed
from bayes_damper.calibration.least_squares import Essence, essence, restored
from bayes_damper.calibration.nominal import broad_noise, out_of_phase
from bayes_damper.calibration.problem import READINGS_AT_ONCE
from bayes_damper.calibration.scatter import carried, own_values, placed
from bayes_damper.campaign.records import DERIVATIVE
from bayes_damper.diagnosis.generic import GENERIC
from bayes_damper.effects import REFERENCE, Scales, candidates, scaled
from bayes_damper.effects.base import Effect, Variant
from bayes_damper.priors.distributions import HalfNormal, widths_out
from bayes_damper.runs.parallel_map import forked_map
from bayes_damper.runs.progress import now_and_then
from bayes_damper.simulation.links import of_links
from bayes_damper.simulation.precompile import compile_ahead

Array = NDArray[np.float64]
"""Of a fit: q, eta, whether it converged, iterations, whether its differences are central, and r, J, T, eta of each
block, unless these are large."""

FULL_FITS = 8  # variants fitted in full, at least
LEADING_SHARE = 0.25  # every variant that screens above this share of the best gain is fitted too
MOST_FITS = 14
MOST_STEPS = 25
FAINT = 8.0  # nats: below, formulas that replace the friction are not tried
LEADERS, UNUSUAL = 3, 2.0  # candidates, and widths of its prior from which friction is unusual
FRICTION = frozenset({"mu", "drag", "nu", "tail", "c1t", "c3t", "c2t"})
STARTS_OF_LEADERS = 2
MISSED = 10.0  # nats that a fit may stay behind its screening before other starts are tried
LOST = -1.2  # prior sds below the median at which a friction counts as given up
FAINTER = 50.0  # nats: where no start screens above, effects are tried again where they would just be seen
JUST_SEEN = 30.0  # squared change of the records in noise sds at which an effect is just seen
NOTHING = np.zeros(0)  # coordinates of another effect, where there is none
SMALLER = 0.1  # of the starts of effects in records that begin in motion: cut from long decays, seen by their sum


@dataclass(frozen=True)
class Screened:
    """What the linearised problem says of one start of a variant: gain in nats, and amplitude relative to the start."""

    start: tuple[float, ...]
    gain: float
    amplitude: float
    log_evidence: float
    base: tuple[float, ...]
    """Nominal coordinates at which the effect was switched on."""
    length: float = 0.0
    """Squared change of the records that nothing else can make, in noise sds."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One variant of an effect, screened and perhaps fitted. log_evidence is relative to the nominal model's."""

    effect: Effect
    variant: Variant
    screens: tuple[Screened, ...]
    fit: Calibration | None
    log_evidence: float

    @property
    def label(self) -> str:
        """Family and formula."""
        return f"{self.effect.name}/{self.variant.name}"


def scales_of(experiment: Experiment) -> Scales:
    """Magnitudes of the rig, each a power of 2 times the library's reference, so that kernels are reused."""
    j1 = experiment.constants["J1"][0]
    k1 = float(np.median([k for k, _ in experiment.stiffnesses]))
    omega = math.sqrt(k1 / j1)
    reach = omega ** DERIVATIVE[experiment.quantity]
    angle = float(np.median(angles_of(experiment)))
    exact = Scales(angle, 1.0 / omega, k1 * angle, reach * angle)

    def rounded(value: float, reference: float) -> float:
        return reference * 2.0 ** round(math.log2(value / reference))

    return Scales(*(rounded(getattr(exact, f), getattr(REFERENCE, f)) for f in ("angle", "time", "torque", "reading")))


def offered(
    experiment: Experiment, nominal: str, effects: Mapping[str, Effect], scales: Scales | None = None
) -> list[tuple[Effect, Variant]]:
    """Every variant that this rig can have, with priors at the rig's scale."""
    scales = scales or scales_of(experiment)
    imposed = all(t.prescribed for t in experiment.trials)  # and nothing is released
    able = candidates(
        experiment.coupled,
        experiment.face,
        "linear" if nominal == "linear" else "nonlinear",
        effects,
        "free" if imposed else experiment.start,
        experiment.restoring,
        experiment.magnet and experiment.priors.get("mu") != 0.0,
    )
    pool = [(effect, scaled(variant, scales)) for effect in able.values() for variant in effect.variants]
    if experiment.coupling_law == "cosine":
        pool = [(effect, of_links(v) if effect.site == "bearings" else v) for effect, v in pool]
    return [(effect, _with_smaller_starts(v)) for effect, v in pool] if experiment.start == "free" else pool


def generics_of(experiment: Experiment) -> list[tuple[Effect, Variant]]:
    """Formulas that stand for causes without a name, at the rig's own magnitudes."""
    scales, coupled = scales_of(experiment), experiment.coupled
    return [(effect, scaled(v, scales)) for effect in GENERIC for v in effect.variants if coupled or v.uncoupled]


def _with_smaller_starts(variant: Variant) -> Variant:
    """The variant with each start also nearer to the null, where its response to a long record is still linear."""
    if not variant.fades:
        return variant
    return replace(variant, starts=variant.starts + tuple(variant.faded(start, SMALLER) for start in variant.starts))


# Screening ----------------------------------------------------------------------------------------------------------


def _left(problem: Problem, group: Group, eta: Array, q: Array) -> Array:
    """Whitened residuals (k, trials, data) of k vectors q (k, size) with nuisances eta (trials, m)."""
    k, turns = q.shape[0], []
    for at, some in group.turns(READINGS_AT_ONCE // max(q.shape[0], 1)):
        own = eta[at]
        which = np.tile(np.arange(len(own)), k)
        y = problem.simulate(some, which, np.repeat(q, len(own), axis=0), np.tile(own, (k, 1)))
        y -= some.y[which]
        turns.append(problem.whitened(y, some.weight[which]).reshape(k, len(own), -1))
    return turns[0] if len(turns) == 1 else np.concatenate(turns, axis=1)


class Screen:
    """The linearised problem at a fit, ready to judge further columns."""

    def __init__(self, fit: Calibration) -> None:
        self.fit = fit
        self.linear: Linear = fit.linear.pinned()
        self.normals: Normals = self.linear.normal()
        self.S, self.g, self.inverses = self.normals.reduced()
        self.full = [b.full for b in self.linear.blocks]
        self._known: dict[tuple[int, bytes], tuple[Problem, list[Array]]] = {}

    def response_of_one(self, problem: Problem, q: Array) -> list[Array]:
        """`responses` of one vector (size,), kept: every formula is counted from the same one."""
        key = (id(problem), q.tobytes())
        if key not in self._known:
            self._known[key] = (problem, self.responses(problem, q[None]))
        return self._known[key][1]

    def responses(self, problem: Problem, q: Array) -> list[Array]:
        """Whitened changes of the records, per block (k, trials, data), that k vectors q (k, size) make."""
        blocks = {id(block.group): block for block in self.linear.blocks}
        if any(id(group) not in blocks for group in problem.groups):
            return [self.response(block, problem, q) for block in self.linear.blocks]
        found: dict[int, Array] = {}
        for bundle in problem.bundles:
            own = [blocks[id(group)] for _, group in bundle.parts]
            left = _left(problem, bundle.whole, np.concatenate([block.eta for block in own]), q)
            found |= {id(b.group): left[:, at] - b.r for (at, _), b in zip(bundle.parts, own, strict=True)}
        return [found[key] for key in blocks]

    def response(self, block: Block, problem: Problem, q: Array) -> Array:
        """Those of one block, (k, trials, data)."""
        out = _left(problem, block.group, block.eta, q)
        out -= block.r
        return out

    def project(self, columns: Sequence[Array]) -> tuple[Array, Array]:
        """For columns (k, trials, data) per block: their squared length and their product with the residuals.

        Both after everything that parameters and nuisances can do, priors included, has been taken out; (k, k), (k,).
        """
        length, product, _ = self.projected(columns)
        return length, product

    def projected(self, columns: Iterable[Array]) -> tuple[Array, Array, Array]:
        """The same, and by how much each parameter gives way to a column, (size, k).

        Columns are looked at once, in order, so that they can be made one block after the other.
        """
        size = self.fit.problem.size
        length: Array = np.zeros(())
        product: Array = np.zeros(())
        mixed: Array = np.zeros(())
        for (_, H, TJ, gT), inverse, full, d in zip(self.normals.parts, self.inverses, self.full, columns, strict=True):
            rows = d.transpose(1, 0, 2)  # (trials, k, data)
            gram = full @ rows.transpose(0, 2, 1)  # (trials, size + m + 1, k)
            m = H.shape[1]
            Td = gram[:, size : size + m]
            HTd = inverse @ Td if m else Td
            length = length + np.sum(rows @ rows.transpose(0, 2, 1) - Td.transpose(0, 2, 1) @ HTd, axis=0)
            mixed = mixed + np.sum(gram[:, :size] - TJ.transpose(0, 2, 1) @ HTd, axis=0)
            product = product + np.sum(gram[:, -1] - np.einsum("jmk,jm->jk", HTd, gT), axis=0)
        k = product.size
        solved = np.linalg.solve(self.S, np.column_stack([mixed, self.g]))
        return length - mixed.T @ solved[:, :k], product - mixed.T @ solved[:, k], np.asarray(-solved[:, :k], float)


def bases_of(fit: Calibration) -> list[Array]:
    """Nominal points at which effects are switched on: the optimum, and if it has lost its friction, one that has not.

    A nominal model that misses an effect of the friction may give up the friction altogether; whatever scales with it
    would then show no effect.
    """
    out = [fit.q]
    lost = fit.q.copy()
    for name in ("mu", "drag"):
        if name in fit.problem.names:
            i = fit.problem.names.index(name)
            lost[i] = max(lost[i], 0.0) if fit.q[i] < LOST else lost[i]
    if np.any(lost != fit.q):
        out.append(lost)
    return out


def screen_variant(screen: Screen, variant: Variant) -> tuple[Screened, ...]:
    """Gain and amplitude of every start of a variant, by the linearised problem."""
    out = [row for base in bases_of(screen.fit) for row in _screen_at(screen, variant, base)]
    return tuple(out)


def fainter(variant: Variant, screens: Sequence[Screened]) -> Variant | None:
    """The variant with starts where its effect would just be seen; None where its own are that small, or have no null.

    The response of a gap, a stop or a lag is anything but linear: what ten times too large a one does to the records
    says little of the effect that is there.
    """
    if not variant.fades:
        return None
    starts: dict[tuple[float, ...], tuple[float, ...]] = {}
    for s in sorted(screens, key=lambda s: -s.length):
        if s.length > 4.0 * JUST_SEEN:
            most = max(abs(x - p.null) for p, x in zip(variant.parameters, s.start, strict=True) if p.null is not None)
            direction = tuple(
                x if p.null is None else round((x - p.null) / (most or 1.0), 6)
                for p, x in zip(variant.parameters, s.start, strict=True)
            )
            # Of starts that differ in size alone the smallest one's response is the most nearly linear.
            starts[direction] = variant.faded(s.start, math.sqrt(JUST_SEEN / s.length))
    return replace(variant, starts=tuple(starts.values())) if starts else None


def _screen_at(screen: Screen, variant: Variant, base: Array) -> list[Screened]:
    problem = screen.fit.problem.with_effect(variant)
    without = None if base is screen.fit.q or variant.null is None else screen.fit.problem
    return screen_column(screen, problem, variant, base, against=without)


def screen_column(
    screen: Screen, problem: Problem, variant: Variant, base: Array, against: Problem | None = None,
    before: Array = NOTHING, behind: Array = NOTHING,
) -> list[Screened]:  # fmt: skip
    """Every start of a variant: `problem` (with it) at `base`, less `against` there (default: the screen's fit).

    before, behind : coordinates of another effect in both problems, which stand before or behind the variant's.
    """
    starts = variant.starts
    z = np.array([[coordinate_of(p.prior, x) for p, x in zip(variant.parameters, s, strict=True)] for s in starts])
    tiled = [np.tile(x, (len(starts), 1)) for x in (np.concatenate([base, before]), behind)]
    q = np.concatenate([tiled[0], z, tiled[1]], axis=1)
    columns = screen.responses(problem, q)
    if against is not None:
        without = screen.response_of_one(against, np.concatenate([base, before, behind]))
        for column, w in zip(columns, without, strict=True):
            np.subtract(column, w, out=column)
    bad = ~np.all([np.isfinite(c).all(axis=(1, 2)) for c in columns], axis=0)
    for column in columns:
        column[bad] = 0.0
    length, product = screen.project(columns)
    at = tuple(float(x) for x in base)
    out = []
    for k, start in enumerate(starts):
        d2, dr = float(length[k, k]), float(product[k])
        if bad[k] or not math.isfinite(d2) or d2 < 1e-9:
            out.append(Screened(start, 0.0, 0.0, 0.0, at))
            continue
        if variant.null is None:
            gain = -dr - 0.5 * d2 - 0.5 * float(z[k] @ z[k])
            out.append(Screened(start, gain, 1.0, gain - 3.0, at, d2))
            continue
        stiffness = _amplitude_stiffness(variant, start)
        amplitude = -dr / (d2 + stiffness)
        one_sided = any(isinstance(p.prior, HalfNormal) for p in variant.parameters if p.null is not None)
        gain = 0.5 * dr * dr / (d2 + stiffness)
        if one_sided and amplitude < 0.0:
            gain = 0.0
        occam = 0.5 * math.log1p(d2 / max(stiffness, 1e-12))
        out.append(Screened(start, gain, amplitude, gain - occam, at, d2))
    return out


def _amplitude_stiffness(variant: Variant, start: tuple[float, ...]) -> float:
    """Inverse prior variance of the factor on a start's distance from the null."""
    total = 0.0
    for p, x in zip(variant.parameters, start, strict=True):
        if p.null is not None:
            reach = abs(float(p.prior.ppf(0.84)) - p.null)
            total = max(total, ((x - p.null) / max(reach, 1e-300)) ** 2)
    return total


def start_points(variant: Variant, screens: Sequence[Screened], count: int) -> list[Array]:
    """Starts of full fits in q: the best screened ones, their amplitude set by the screening."""
    ranked = sorted(screens, key=lambda s: -s.gain)[:count]
    points = []
    for s in ranked:
        amplitude = float(np.clip(s.amplitude, 0.02, 1.5)) if s.amplitude > 0.0 else 0.05
        start = s.start if variant.null is None else variant.faded(s.start, amplitude)
        z = [coordinate_of(p.prior, x) for p, x in zip(variant.parameters, start, strict=True)]
        points.append(np.concatenate([s.base, z]))
    return points


# Search -------------------------------------------------------------------------------------------------------------


def fit_variant(
    fit: Calibration, effect: Effect, variant: Variant, screens: Sequence[Screened], count: int,
    target: float = -math.inf,
) -> Candidate:  # fmt: skip
    """A variant fitted in full from its best `count` screened starts; evidence relative to that of `fit`.

    Where the nominal model is out of phase, no descent leads from it to the effect's valley: the variant is fitted
    window by window too.
    """
    problem = fit.problem.with_effect(variant)
    starts = start_points(variant, screens, count)
    found = calibrate(problem, starts, eta=fit.eta, anneal=False, finish=True, most=MOST_STEPS, target=target)
    if variant.null is not None and found.cost > fit.cost + MISSED:
        # It holds the nominal model, so the descent from usual friction went astray: this one begins at that model.
        near = start_points(variant, [s for s in screens if s.base == tuple(fit.q)], 1)
        other = calibrate(problem, near, eta=fit.eta, anneal=False, finish=True, most=MOST_STEPS, target=target)
        found = min(found, other, key=lambda f: f.cost)
    if out_of_phase(fit):
        e = fit.problem.experiment
        begun = [
            np.concatenate([fit.q, [coordinate_of(p.prior, x) for p, x in zip(variant.parameters, s, strict=True)]])
            for s in variant.starts
        ]
        long = grown(e, problem.with_noise(broad_noise(e, fit.problem.trials)), begun)
        if long is not None:
            eta = carried(long, problem)
            other = calibrate(problem, [long.q], eta=eta, anneal=False, finish=True, most=MOST_STEPS, target=target)
            found = min(found, other, key=lambda f: f.cost)
    if variant.late and (late := _begun_on_time(fit)) is not None:
        eta, middle = late
        slow = (middle / variant.late, *variant.starts[0][1:])
        z = [coordinate_of(p.prior, x) for p, x in zip(variant.parameters, slow, strict=True)]
        start = np.concatenate([fit.q, z])
        other = calibrate(problem, [start], eta=eta, anneal=False, finish=True, most=MOST_STEPS, target=target)
        found = min(found, other, key=lambda f: f.cost)
    found = freed(found, MOST_STEPS)
    return Candidate(effect, variant, tuple(screens), found, found.log_evidence - fit.log_evidence)


def _begun_on_time(fit: Calibration) -> tuple[dict[int, Array], float] | None:
    """Nuisances with every release at t = 0, and the fit's instant, s, at which a slow effect has to show the motion.

    A sudden release in the middle of a slow one, or behind a slow sensor, does the same but for the first readings, and
    no short step leads from the one to the other. None where no release is late by more than any clock.
    """
    problem = fit.problem
    late = own_values(fit, "delay")
    middle = float(np.median(late)) if late else 0.0
    if middle <= 0.0 or not late_by_the_clock(problem.experiment, problem.trials):
        return None
    return placed(problem, fit.eta, "delay", 0.0), middle


def from_usual_friction(found: Sequence[Candidate]) -> list[Candidate]:
    """The candidates, best first, the leading ones fitted from usual friction too where theirs is none.

    A model that lacks something may smear its dry friction into a viscous one; with the effect added it is stuck in
    that valley, although the one of sharp friction lies far deeper.
    """
    out = list(found)
    for k, c in enumerate(found[:LEADERS]):
        if c.fit is None:
            continue
        every = c.fit.problem.coordinates
        friction = [i for i, own in enumerate(every) if own.parameter in FRICTION]
        if not any(widths_out(every[i].prior, c.fit.q[i]) > UNUSUAL for i in friction):
            continue
        usual = c.fit.q.copy()
        usual[friction] = 0.0
        again = calibrate(c.fit.problem, [usual], eta=c.fit.eta, anneal=False, most=MOST_STEPS, target=c.fit.cost)
        gained = again.log_evidence - c.fit.log_evidence
        if gained > 0.0:
            out[k] = replace(c, fit=again, log_evidence=c.log_evidence + gained)
    return sorted(out, key=lambda c: -c.log_evidence)


def promising(nominal: Calibration, pool: Sequence[tuple[Effect, Variant]], gains: Array, full_fits: int) -> list[int]:
    """Numbers of the formulas to fit in full, the best screened first; gains : of the screening, (formulas,)."""
    order = [int(k) for k in np.argsort(-gains)]
    best = float(gains[order[0]]) if len(pool) else 0.0
    chosen = [
        k
        for rank, k in enumerate(order)
        if rank < full_fits
        or (gains[k] > LEADING_SHARE * best and rank < MOST_FITS)
        or (pool[k][1].null is None and best > FAINT)
    ]
    if nominal.problem.noise.sensor:
        # Without repeats the error of the model stands for noise: gains are faint then, and rank the families badly.
        leading: dict[str, int] = {}
        for k in order:
            leading.setdefault(pool[k][0].name, k)
        # Where the model is out of phase, what a formula does to its motion ranks formulas of a family badly, too.
        rest = set(order) if out_of_phase(nominal) else set(leading.values())
        chosen += sorted(rest - set(chosen))
    return chosen


def _screened(
    nominal: Calibration, pool: Sequence[tuple[Effect, Variant]], workers: int, report: Callable[[str], None]
) -> list[tuple[Screened, ...]]:
    """Every start of every variant, screened, and fainter ones where none of them shows."""
    screen = Screen(nominal)  # with all derivatives, so that it must not outlive the screening

    def judge(item: tuple[Effect, Variant]) -> tuple[Screened, ...]:
        return screen_variant(screen, item[1])

    screens = forked_map(judge, list(pool), workers, now_and_then(report, len(pool), "formulas screened"))
    if max((s.gain for row in screens for s in row), default=0.0) < FAINTER:

        def again(item: tuple[Variant, tuple[Screened, ...]]) -> tuple[Screened, ...]:
            small = fainter(*item)
            return item[1] + (() if small is None else screen_variant(screen, small))

        screens = forked_map(again, [(v, row) for (_, v), row in zip(pool, screens, strict=True)], workers)
    return screens


def search(
    nominal: Calibration,
    pool: Sequence[tuple[Effect, Variant]],
    *,
    workers: int = 1,
    full_fits: int = FULL_FITS,
    report: Callable[[str], None] = lambda _: None,
) -> list[Candidate]:
    """All candidates, best first: screened, and the leading ones fitted, by `workers` processes."""
    groups = nominal.problem.groups
    models = [nominal.problem.models[coupled] for coupled in {g.coupled for g in groups}]
    curved = nominal.problem.nominal == "nonlinear"
    driven = any(g.inputs is not None and g.inputs.active for g in groups)
    compile_ahead((replace(model, effect=variant) for model in models for _, variant in pool), driven, curved, report)
    screens = _screened(nominal, pool, workers, report)
    gains = np.array([max(s.gain for s in row) for row in screens])
    best = float(gains.max()) if len(pool) else 0.0
    chosen = promising(nominal, pool, gains, full_fits)
    report(f"screened {len(pool)} formulas of effects; fitting the {len(chosen)} most promising")

    def screened(k: int) -> Candidate:
        return Candidate(*pool[k], screens[k], None, max(s.log_evidence for s in screens[k]))

    def refine(k: int, target: float) -> Candidate:
        effect, variant = pool[k]
        # Without a null the screening cannot set an amplitude, and ranks starts badly: try them all.
        leads = gains[k] > max(0.5 * best, FAINT)
        count = len(variant.starts) if variant.null is None else STARTS_OF_LEADERS if leads else 1
        candidate = fit_variant(nominal, effect, variant, screens[k], count, target)
        if candidate.log_evidence < screened(k).log_evidence - MISSED:
            # The screening promised more than the fit found: it went astray. Where that is little it is believed.
            if gains[k] < FAINT:
                return screened(k)
            again = fit_variant(nominal, effect, variant, screens[k], len(variant.starts), target)
            candidate = max(candidate, again, key=lambda c: c.log_evidence)
        return candidate

    fitted: dict[int, Candidate] = {}
    if chosen:
        first = refine(chosen[0], nominal.cost)
        reached = min(nominal.cost, math.inf if first.fit is None else first.fit.cost)
        each = now_and_then(report, len(chosen) - 1, "fitted")

        def sent(k: int) -> Essence | None:
            fit = refine(k, reached).fit
            return None if fit is None else essence(fit)

        essences = forked_map(sent, chosen[1:], workers, each)
        fitted = {chosen[0]: first}
        for k, found in zip(chosen[1:], essences, strict=True):
            if found is not None:
                fit = restored(nominal.problem.with_effect(pool[k][1]), found)
                fitted[k] = Candidate(*pool[k], screens[k], fit, fit.log_evidence - nominal.log_evidence)
    return sorted((fitted.get(k) or screened(k) for k in range(len(pool))), key=lambda c: -c.log_evidence)
