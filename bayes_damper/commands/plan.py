"""Before measuring: what a planned rig and its trials could distinguish at all, and with how many trials.

The plan is a campaign without records. Its trials are simulated at the prior medians, without noise, and the problem is
linearised there. What an effect changes in the records is projected off everything that the nominal parameters, within
their priors, and each trial's own nuisances can do; with L^2 the squared length that is left, in units of the noise, an
effect of that size is expected to gain

    E = L^2 / 2 - (k / 2) ln(1 + L^2)     nats

of evidence over the nominal model, k being the number of its parameters. A rival counts against an effect in the same
way: the span of the rival's change and of its parameters' derivatives is projected off as well. Repeating every trial m
times multiplies the information of the data, not that of the priors, so that what hides behind a declared uncertainty
stays hidden. Everything is linear in the nominal parameters; in the effect's own parameters nothing is.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bayes_damper import figures
from bayes_damper.calibration import Calibration, Noise, Problem, coordinate_of, experiment_of, summarise
from bayes_damper.calibration.scatter import typical_scatter
from bayes_damper.campaign import Campaign, load_plan, noise_floor
from bayes_damper.diagnosis.next_experiment import candidate_trials, places_of, with_events
from bayes_damper.diagnosis.search import offered
from bayes_damper.effects import Effect, all_effects, classes
from bayes_damper.effects.base import Variant
from bayes_damper.errors import ExitCode, InputError
from bayes_damper.priors.distributions import from_standard
from bayes_damper.priors.files import PriorSet, campaign_priors
from bayes_damper.rig.parameters import unit_of
from bayes_damper.rig.units import effect_unit, in_words_of, sentence_of
from bayes_damper.runs.contents.plan import Addition, PlanFile, PlannedEffect, PlannedParameter
from bayes_damper.runs.json_files import write_json
from bayes_damper.runs.parallel_map import single_threaded
from bayes_damper.runs.provenance import provenance
from bayes_damper.runs.threads import kernel_threads
from bayes_damper.sampling.prior_sensitivity import decided_by
from bayes_damper.text import Printable, counted, trial_words

Array = NDArray[np.float64]

SCHEMA = "bayes-damper/plan/1"
NATS = 10.0
"""Expected evidence from which an effect counts as seen, or as distinguished from a rival."""
ALIKE = 3.0
"""Nats below which two effects count as not distinguished, as in a diagnosis."""
FACTORS = tuple(float(x) for x in np.geomspace(1.0 / 1024.0, 4.0, 25))
"""Sizes tried, relative to the typical one."""
PRIOR_DRAWS = 48
REPEATS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 100)
_TANGENT = 0.05  # step in standard prior coordinates of a rival's derivatives
_FARTHEST = 6.0  # standard deviations of a prior beyond which no size is tried
_BATCH = 2_000_000  # readings of one simulation call
_PROPOSED = 5


@dataclass(frozen=True)
class Plan(Printable):
    """What a plan could distinguish; `result` is what plan.json holds, `folder` where it is (None: not written)."""

    result: PlanFile
    folder: Path | None
    campaign: str = ""
    """What was planned, as the command line names it."""
    recorded: bool = False
    """Whether all of its trials have been measured already."""
    exit_code: ExitCode = ExitCode.DONE

    def to_json(self) -> PlanFile:
        """What plan.json holds."""
        return self.result

    def text(self) -> str:
        """A table of effects, then of parameters, then sentences."""
        r = self.result
        lines = [
            f"{r['campaign']}: {counted(r['trials'], 'trial')} for fitting, noise "
            + ", ".join(f"{x:g}" for x in r["noise"]),
            f"  {'effect':22s}{'seen':>6s}   {'strongest rival':22s}{'nats over it':>13s}   {'trials needed':20s}from",
        ]
        for row in r["effects"]:
            rival, over = "-", ""
            if (found := row["rival"]) is not None:
                rival, over = found["name"], "above 100" if found["nats"] > 100.0 else f"{found['nats']:.1f}"
            times = "more than 100 x" if row["repeats_needed"] is None else f"{row['repeats_needed']} x"
            least = ", ".join(f"{k} {v['value']:.2g} {v['unit']}".strip() for k, v in (row["smallest"] or {}).items())
            lines.append(
                f"  {row['name']:22s}{100 * row['chance']:4.0f} %   {rival:22s}{over:>13s}   {times:20s}{least}"
            )
        lines.append(f"  {'parameter':22s}{'unit':>14s}{'expected 90 % interval':>30s}   sd / prior sd")
        for name, p in r["parameters"].items():
            lines.append(
                f"  {name:22s}{p['unit']:>14s}{' to '.join(_digits(*p['expected90'])):>30s}{p['sd_over_prior']:16.2f}"
            )
        lines += [f"  {row['name']}: {title}" for row in r["effects"] if (title := row.get("title"))]
        lines += [f"  {s}" for s in r["sentences"]]
        return "\n".join([*lines, *([] if self.folder is None else [f"Files: {self.folder}"]), *self._next()])

    def _next(self) -> list[str]:
        """The trial worth adding, and the command that follows."""
        if not self.campaign:
            return []
        best = next((a for a in self.result["add"] if a.get("helps")), None)
        helped = [] if best is None else [
            f"To distinguish more ({', '.join(best['helps'])}): plan one more {trial_words(best)}."
        ]  # fmt: skip
        folder = shlex.quote(self.campaign)
        if self.recorded:
            return [*helped, f"Next: bayes-damper diagnose {folder} --out results/diagnose"]
        return [
            *helped,
            f"Next: measure these trials, put the records into the folder, and run: bayes-damper check {folder}",
        ]


def _digits(low: float, high: float) -> tuple[str, str]:
    """Both ends of an interval, with two digits of its width."""
    width = high - low
    if not (math.isfinite(width) and width > 0.0):
        return f"{low:.4g}", f"{high:.4g}"
    digits = max(0, 1 - math.floor(math.log10(width)))
    return f"{low:.{digits}f}", f"{high:.{digits}f}"


@single_threaded
def plan(
    campaign: str | Path,
    *,
    nominal: Literal["nonlinear", "linear"] = "nonlinear",
    effects: str | Path | None = None,
    priors: str | Path | None = None,
    out: str | Path | None = None,
    seed: int = 1,
    workers: int = 2,
) -> Plan:
    """What a planned campaign could distinguish at all, and with how many trials.

    Parameters
    ----------
    campaign : folder with campaign.toml and trials.csv; the records need not exist. [measurement] must declare
    noise_std, unless records that are there give it, and, where records are missing, sample_rate. nominal, effects,
    priors : as for `diagnose`. out : folder for plan.json and its figure, None to write nothing. seed : of the draws
    from the priors of the effects. workers : simulations side by side.

    Raises
    ------
    InputError
        if the campaign cannot be read, declares no noise, or is not released from rest.
    """
    loaded = load_plan(campaign)
    file = Path(priors) if priors is not None else Path(campaign) / "priors.toml"
    chosen = campaign_priors(file, loaded) if priors is not None or file.exists() else None
    if loaded.measurement.start != "rest":
        raise InputError(
            f'{campaign}: a plan needs a release from rest; with start = "free" nothing gives the size of the motion; '
            'where the rig is let go at rest, write start = "rest" under [measurement] and the release in trials.csv'
        )
    measured = loaded.measurement.noise_std is None
    if measured:
        loaded = replace(loaded, measurement=replace(loaded.measurement, noise_std=_noise_of_records(loaded)))
    with kernel_threads(workers):
        result = judge(loaded, all_effects(effects), nominal, chosen, seed)
    if measured:
        result["sentences"].append("The noise was taken from the records that are there: noise_std is not declared.")
    result |= {"campaign_sha256": loaded.sha256, "seed": seed, "provenance": provenance()}
    if out is not None:
        write_json(Path(out) / "plan.json", result)
        drawn = figures.plan_figure(result, title=f"{loaded.name}: what could be distinguished")
        figures.save(drawn, Path(out) / "plan")
    recorded = all(np.any(t.channels) for t in loaded.trials)
    return Plan(result, None if out is None else Path(out), str(campaign), recorded)


def _noise_of_records(campaign: Campaign) -> tuple[float, ...]:
    """Noise of each channel, in the unit of the readings: the median over the records that have been measured.

    Raises
    ------
    InputError
        if there are none.
    """
    floors = [noise_floor(t) for t in campaign.trials if np.any(t.channels)]
    if not floors:
        raise InputError(
            f"{campaign.folder}/campaign.toml [measurement]: noise_std is missing; give the noise of your sensors in "
            f"{campaign.reading_unit} (from a record of the rig at rest)"
        )
    channels = range(2 if any(t.coupled for t in campaign.trials) else 1)
    # Where no record has a second channel, its sensor is taken to be like the first one's.
    return tuple(float(np.median([f[c] for f in floors if len(f) > c] or [f[0] for f in floors])) for c in channels)


def judge(
    campaign: Campaign,
    effects: Mapping[str, Effect],
    nominal: Literal["nonlinear", "linear"] = "nonlinear",
    priors: PriorSet | None = None,
    seed: int = 1,
) -> PlanFile:
    """The content of plan.json, without checksum and provenance."""
    fit = planned_fit(campaign, nominal, priors)
    sd = campaign.measurement.noise_std or ()
    pool = offered(fit.problem.experiment, nominal, effects)
    rng = np.random.default_rng([seed, 9])
    views = _views(fit, pool, rng)
    kin = {name: group for group in classes({v.effect.name: v.effect for v in views}) for name in group}
    rivals = _rivals(fit, pool, views, kin)
    rows = [_row(view, rivals[view.effect.name], campaign) for view in views]
    rows.sort(key=lambda row: (-row["chance"], -row["nats"]))
    groups = _alike(rows)
    parameters = _parameters(_that_scatters(fit), campaign.rig.kind)
    return {
        "schema": SCHEMA,
        "campaign": campaign.name,
        "nominal": nominal,
        "trials": len(fit.problem.trials),
        "held_out": len(fit.problem.experiment.trials) - len(fit.problem.trials),
        "noise": [sd[min(c, len(sd) - 1)] for c in range(2 if fit.problem.experiment.coupled else 1)],
        "duration_s": campaign.measurement.duration,
        "nats_needed": NATS,
        "effects": rows,
        "matrix": {view.effect.name: rivals[view.effect.name].nats for view in views},
        "invisible": [row["name"] for row in rows if row["chance"] < 0.05 and row["nats"] < NATS],
        "indistinguishable": groups,
        "parameters": parameters,
        "add": _additions(fit, views, rivals, campaign.rig.kind),
        "sentences": _sentences(campaign, fit, rows, groups, parameters),
    }


# The nominal problem --------------------------------------------------------------------------------------------------


def planned_fit(campaign: Campaign, nominal: Literal["nonlinear", "linear"], priors: PriorSet | None) -> Calibration:
    """The nominal model at its prior medians, linearised on the readings that it predicts itself."""
    experiment = experiment_of(campaign, priors)
    sd = experiment.noise_sd
    channels = 2 if experiment.coupled else 1
    noise = Noise(tuple(sd[min(c, len(sd) - 1)] for c in range(channels)), (0.0,) * channels, (0.0,) * channels)
    blank = Problem(experiment, nominal=nominal, noise=noise)
    at = np.zeros(blank.size)
    experiment = with_events(summarise(blank, at, blank.no_nuisance(), True, 0, central=False), experiment)
    problem = Problem(experiment, nominal=nominal, noise=noise)
    return summarise(problem, at, problem.no_nuisance(), True, 0)


@dataclass(frozen=True)
class Pieces:
    """Normal equations of trials with each trial's nuisances eliminated, priors of the parameters left out.

    S (trials, size, size), mixed (trials, size, k), gram (trials, k, k) for k columns.
    """

    S: Array
    mixed: Array
    gram: Array

    def left(self, repeats: float = 1.0) -> Array:
        """Gram matrix (k, k) of the columns after the parameters have taken what they can, all trials repeated."""
        S = np.eye(self.S.shape[1]) + repeats * self.S.sum(axis=0)
        mixed = repeats * self.mixed.sum(axis=0)
        gram = repeats * self.gram.sum(axis=0) - mixed.T @ np.linalg.solve(S, mixed)
        return np.asarray(0.5 * (gram + gram.T))

    def joined(self, other: Pieces, places: Sequence[int | None]) -> Pieces:
        """With other trials; `places` says where each of their parameters stands here, None for a new one."""
        size, new = self.S.shape[1], sum(p is None for p in places)
        fresh = iter(range(size, size + new))
        at = np.array([next(fresh) if p is None else p for p in places])
        k = self.gram.shape[1]
        S = np.zeros((len(self.S) + len(other.S), size + new, size + new))
        mixed = np.zeros((len(S), size + new, k))
        S[: len(self.S), :size, :size], mixed[: len(self.S), :size] = self.S, self.mixed
        added = np.arange(len(self.S), len(S))
        S[np.ix_(added, at, at)] = other.S
        mixed[np.ix_(added, at)] = other.mixed
        return Pieces(S, mixed, np.concatenate([self.gram, other.gram]))

    def one(self, trial: int) -> Pieces:
        """A single trial."""
        only = slice(trial, trial + 1)
        return Pieces(self.S[only], self.mixed[only], self.gram[only])


class Bench:
    """The linearised problem, ready to judge what effects change."""

    def __init__(self, fit: Calibration) -> None:
        self.fit = fit
        self.blocks = fit.linear.blocks
        self.inverses = [
            np.asarray(np.linalg.inv(b.T @ b.T.transpose(0, 2, 1) + np.eye(b.T.shape[1])), float) for b in self.blocks
        ]
        pairs = zip(self.blocks, self.inverses, strict=True)
        self.S = np.concatenate([self._without(b.J, b.J, b.T, h) for b, h in pairs])

    @staticmethod
    def _without(x: Array, y: Array, nuisance: Array, inverse: Array) -> Array:
        """Products of rows of x and y (trials, ., data) with the nuisances eliminated."""
        products = x @ y.transpose(0, 2, 1)
        if nuisance.shape[1]:
            turned = nuisance @ y.transpose(0, 2, 1)
            products = products - (x @ nuisance.transpose(0, 2, 1)) @ (inverse @ turned)
        return np.asarray(products)

    def changes(self, variant: Variant, z: Array) -> list[Array]:
        """Whitened changes of the records, per block (trials, k, data), of an effect at z (k, parameters), standard
        prior coordinates; zeros where a simulation failed.
        """
        problem = self.fit.problem.with_effect(variant)
        q = np.concatenate([np.tile(self.fit.q, (len(z), 1)), z], axis=1)
        out = []
        for block in self.blocks:
            group, n = block.group, len(block.group.trials)
            most = max(1, _BATCH // (n * block.group.times.size * block.group.y.shape[1]))
            parts = []
            for some in np.array_split(q, -(-len(q) // most)):
                which = np.tile(np.arange(n), len(some))
                eta = np.tile(block.eta, (len(some), 1))
                y = problem.simulate(group, which, np.repeat(some, n, axis=0), eta)
                r = problem.whitened(y - group.y[which], group.weight[which]).reshape(len(some), n, -1)
                parts.append(r - block.r[None])
            change = np.concatenate(parts).transpose(1, 0, 2)
            out.append(np.where(np.isfinite(change).all(axis=2, keepdims=True), change, 0.0))
        return out

    def pieces(self, columns: Sequence[Array]) -> Pieces:
        """Normal equations with columns, one array (trials, k, data) for each block."""
        mixed = [self._without(b.J, d, b.T, h) for b, h, d in zip(self.blocks, self.inverses, columns, strict=True)]
        gram = [self._without(d, d, b.T, h) for b, h, d in zip(self.blocks, self.inverses, columns, strict=True)]
        return Pieces(self.S, np.concatenate(mixed), np.concatenate(gram))


def expected(length2: Array | float, parameters: int) -> Array:
    """Expected log evidence, nats, of an effect of which the nominal model leaves squared lengths length2."""
    x = np.maximum(np.asarray(length2, dtype=np.float64), 0.0)
    return np.asarray(0.5 * x - 0.5 * parameters * np.log1p(x))


# Effects against the nominal model ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class View:
    """How an effect would show. typical: parameters of its first formula that lie in the middle of what its priors hold
    plausible, by how much they would show; z the same in standard prior coordinates; nats: expected evidence there for
    each number of `REPEATS`; chance: share of sizes and shapes drawn from its priors that would be seen; smallest: the
    typical shape at the smallest size that would be seen, None where the formula has no size or none would be.
    """

    effect: Effect
    variant: Variant
    typical: Mapping[str, float]
    z: Array
    nats: Mapping[int, float]
    chance: float
    smallest: Mapping[str, float] | None


def _standard(variant: Variant, values: Sequence[float]) -> Array:
    return np.array([coordinate_of(p.prior, x) for p, x in zip(variant.parameters, values, strict=True)])


def _values(variant: Variant, z: Array) -> list[float]:
    return [float(from_standard(p.prior, x)) for p, x in zip(variant.parameters, z, strict=True)]


def _named(variant: Variant, values: Sequence[float]) -> dict[str, float]:
    return {p.name: float(x) for p, x in zip(variant.parameters, values, strict=True)}


def _views(fit: Calibration, pool: Sequence[tuple[Effect, Variant]], rng: np.random.Generator) -> list[View]:
    bench = Bench(fit)
    families: dict[str, tuple[Effect, list[Variant]]] = {}
    for effect, variant in pool:
        families.setdefault(effect.name, (effect, []))[1].append(variant)
    return [_view(bench, effect, variants, rng) for effect, variants in families.values()]


def _view(bench: Bench, effect: Effect, variants: Sequence[Variant], rng: np.random.Generator) -> View:
    first = variants[0]
    drawn = [rng.standard_normal((PRIOR_DRAWS, len(v.parameters))) for v in variants]
    lengths = [_lengths(bench, v, z) for v, z in zip(variants, drawn, strict=True)]
    seen = [expected(x, len(v.parameters)) >= NATS for v, x in zip(variants, lengths, strict=True)]
    z = drawn[0][np.argsort(lengths[0])[PRIOR_DRAWS // 2]]
    values = _values(first, z)
    pieces = bench.pieces(bench.changes(first, z[None]))
    nats = {m: float(expected(pieces.left(m)[0, 0], len(z))) for m in REPEATS}
    return View(
        effect, first, _named(first, values), z, nats, float(np.mean(np.concatenate(seen))),
        _smallest(bench, first, values),
    )  # fmt: skip


def _smallest(bench: Bench, variant: Variant, values: Sequence[float]) -> dict[str, float] | None:
    """The parameters at which an effect of this shape is first seen, interpolated between the sizes tried."""
    if variant.null is None:
        return None

    def sized(factor: float) -> list[float]:
        pairs = zip(variant.parameters, values, strict=True)
        return [x if p.null is None else p.null + factor * (x - p.null) for p, x in pairs]

    points = {f: _standard(variant, sized(f)) for f in FACTORS}
    factors = [f for f, z in points.items() if np.all(np.abs(z) < _FARTHEST)]
    lengths = _lengths(bench, variant, np.array([points[f] for f in factors]))
    nats = expected(lengths, len(values))
    k = int(np.argmax(nats >= NATS))
    if nats[k] < NATS:
        return None
    if k == 0:
        return _named(variant, sized(factors[0]))
    share = (NATS - nats[k - 1]) / (nats[k] - nats[k - 1])
    low, high = math.log(factors[k - 1]), math.log(factors[k])
    return _named(variant, sized(math.exp(low + share * (high - low))))


def _lengths(bench: Bench, variant: Variant, z: Array) -> Array:
    """Squared lengths (k,) that the nominal model leaves of an effect at z (k, parameters)."""
    readings = sum(b.r.size for b in bench.blocks)
    parts = np.array_split(z, -(-len(z) * readings // (8 * _BATCH)))
    return np.concatenate([np.diag(bench.pieces(bench.changes(variant, some)).left()) for some in parts])


# Effects against each other -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Rivals:
    """What is left of one effect beside each rival: nats: rival -> at the plan's trials; first: the strongest one, with
    its formula and start; needed: number of repeats at which the effect is distinguished from all, None beyond the last
    tried.
    """

    nats: dict[str, float]
    first: tuple[str, Variant, tuple[float, ...]] | None
    needed: int | None


def _span(variant: Variant, start: Sequence[float]) -> Array:
    """Points (1 + parameters, parameters) whose changes span what a rival can do near a start."""
    z = _standard(variant, start)
    return np.concatenate([z[None], z + _TANGENT * np.eye(len(z))])


def _beside(gram: Array, truths: int) -> Array:
    """Squared lengths (truths,) of the first columns after the others have taken what they can."""
    own, cross, rest = np.diag(gram)[:truths], gram[:truths, truths:], gram[truths:, truths:]
    scale = np.sqrt(np.maximum(np.diag(rest), 1e-12))
    values, vectors = np.linalg.eigh(rest / np.outer(scale, scale))
    keep = values > 1e-9
    along = (cross / scale) @ vectors[:, keep] / np.sqrt(values[keep])
    return np.asarray(np.maximum(own - np.sum(along**2, axis=1), 0.0))


def _differences(columns: list[Array]) -> list[Array]:
    """Changes at a start and beside it, (trials, 1 + p, data), as the former and p derivatives."""
    return [np.concatenate([c[:, :1], (c[:, 1:] - c[:, :1]) / _TANGENT], axis=1) for c in columns]


def _rivals(
    fit: Calibration, pool: Sequence[tuple[Effect, Variant]], views: Sequence[View],
    kin: Mapping[str, frozenset[str]],
) -> dict[str, Rivals]:  # fmt: skip
    bench = Bench(fit)
    parts = [bench.changes(view.variant, view.z[None]) for view in views]
    truths = [np.concatenate([p[b] for p in parts], axis=1) for b in range(len(bench.blocks))]
    n = len(views)
    best: dict[str, tuple[Array, list[tuple[Variant, tuple[float, ...]]]]] = {}
    own_names = [view.effect.name for view in views]
    left_at = np.full((len(REPEATS), n), np.inf)
    for effect, variant in pool:
        for start in variant.starts:
            span = _differences(bench.changes(variant, _span(variant, start)))
            pieces = bench.pieces([np.concatenate([t, s], axis=1) for t, s in zip(truths, span, strict=True)])
            now = 0.5 * _beside(pieces.left(), n)
            lowest, where = best.setdefault(effect.name, (np.full(n, np.inf), [(variant, start)] * n))
            closer = now < lowest
            best[effect.name] = (
                np.where(closer, now, lowest),
                [(variant, start) if c else w for c, w in zip(closer, where, strict=True)],
            )
            foreign = np.array([effect.name not in kin.get(name, {name}) for name in own_names])
            # More repeats matter only where the plan itself does not distinguish the two.
            if np.any(foreign & (now < NATS)):
                for i, m in enumerate(REPEATS):
                    lengths = 0.5 * _beside(pieces.left(m), n)
                    left_at[i] = np.where(foreign, np.minimum(left_at[i], lengths), left_at[i])
    seen = np.array([[view.nats[m] for view in views] for m in REPEATS])
    needed = (left_at >= NATS) & (seen >= NATS)
    out = {}
    for k, view in enumerate(views):
        name = view.effect.name
        rows = {rival: float(v[0][k]) for rival, v in best.items() if rival not in kin.get(name, {name})}
        strongest = min(rows, key=lambda rival: rows[rival], default=None)
        first = None if strongest is None else (strongest, *best[strongest][1][k])
        enough = [m for m, ok in zip(REPEATS, needed[:, k], strict=True) if ok]
        out[name] = Rivals(rows, first, min(enough, default=None))
    return out


# More trials ----------------------------------------------------------------------------------------------------------


def _additions(fit: Calibration, views: Sequence[View], rivals: Mapping[str, Rivals], kind: str) -> list[Addition]:
    """Single trials that would help most, ranked by the nats, up to `NATS` for each effect, that one of each adds.

    An effect's nats are those over the nominal model or over its strongest rival, whichever is less.
    """
    bench = Bench(fit)
    candidates = candidate_trials(fit.problem.experiment, None, None)
    candidates = with_events(fit, candidates)
    base = fit.problem
    problem = Problem(
        candidates, nominal=base.nominal, noise=base.noise, switches=base.switches,
        trials=tuple(range(len(candidates.trials))),
    )  # fmt: skip
    places = places_of(fit, problem)
    q = np.array([0.0 if k is None else fit.q[k] for k in places])
    other = summarise(problem, q, problem.no_nuisance(), True, 0)
    there = Bench(other)
    order = [i for block in there.blocks for i in block.group.trials]
    gains: Array = np.zeros((len(order), len(views)))
    for k, view in enumerate(views):
        rival = rivals[view.effect.name].first
        span = None if rival is None else _span(rival[1], rival[2])

        def columns(bench: Bench, view: View = view, rival: Any = rival, span: Any = span) -> list[Array]:
            own = bench.changes(view.variant, view.z[None])
            if rival is None:
                return own
            return [
                np.concatenate(pair, axis=1)
                for pair in zip(own, _differences(bench.changes(rival[1], span)), strict=True)
            ]

        here, more = bench.pieces(columns(bench)), there.pieces(columns(there))
        parameters = len(view.variant.parameters)

        def worth(pieces: Pieces, parameters: int = parameters, rival: Any = rival) -> float:
            gram = pieces.left()
            gained = float(expected(gram[0, 0], parameters))
            return min(gained, NATS) if rival is None else min(gained, 0.5 * float(_beside(gram, 1)[0]), NATS)

        before = worth(here)
        if before >= NATS:
            continue
        for t in range(len(order)):
            gains[t, k] = worth(here.joined(more.one(t), places)) - before
    total = gains.sum(axis=1)
    out: list[Addition] = []
    for t in np.argsort(-total)[:_PROPOSED]:
        trial = candidates.trials[order[t]]
        if total[t] < 0.1:
            break
        helped = [views[k].effect.name for k in np.argsort(-gains[t]) if gains[t, k] > 0.1 * total[t]]
        k1t, theta0 = candidates.stiffnesses[trial.k1t][0], trial.theta0
        place: Addition = (
            {"k1_n_per_m": k1t, "theta0_mm": 1e3 * theta0}
            if kind == "translational"
            else {"k1t_n_m_per_rad": k1t, "theta0_deg": math.degrees(theta0)}
        )
        out.append({
            "configuration": "coupled" if trial.coupled else "uncoupled", **place, "nats": float(total[t]),
            "helps": helped,
        })  # fmt: skip
    return out


# Words ----------------------------------------------------------------------------------------------------------------


def _row(view: View, rivals: Rivals, campaign: Campaign) -> PlannedEffect:
    of_rig = campaign.rig.kind, campaign.measurement.quantity
    units = {p.name: "" if p.unit == "1" else effect_unit(p.unit, *of_rig) for p in view.variant.parameters}
    strongest = rivals.first
    return {
        "name": view.effect.name,
        "title": in_words_of(view.effect.title, campaign.rig.kind, campaign.rig.has_magnet),
        "site": view.effect.site,
        "variant": view.variant.name,
        "typical": {name: {"value": x, "unit": units[name]} for name, x in view.typical.items()},
        "nats": view.nats[1],
        "chance": view.chance,
        "smallest": None
        if view.smallest is None
        else {name: {"value": x, "unit": units[name]} for name, x in view.smallest.items()},
        "rival": None if strongest is None else {"name": strongest[0], "nats": rivals.nats[strongest[0]]},
        "repeats_needed": rivals.needed,
        "repeats_to_see": next((m for m in REPEATS if view.nats[m] >= NATS), None),
    }


def _alike(rows: Sequence[PlannedEffect]) -> list[list[str]]:
    """Pairs that the plan's trials could not distinguish, though at least one of the two would be seen."""
    out: list[list[str]] = []
    for row in rows:
        if row["nats"] >= NATS and row["rival"] is not None and row["rival"]["nats"] < ALIKE:
            pair = sorted((row["name"], row["rival"]["name"]))
            if pair not in out:
                out.append(pair)
    return out


def _that_scatters(fit: Calibration) -> Calibration:
    """The fit of trials that differ from each other as usual, or as the campaign says; a single one as it is."""
    problem = fit.problem
    if len(problem.trials) == 1:
        return fit
    wide = problem.changed(switches=replace(problem.switches, scatter=typical_scatter(problem)))
    return summarise(wide, fit.q, wide.no_nuisance(), True, 0)


def _parameters(fit: Calibration, kind: str) -> dict[str, PlannedParameter]:
    out: dict[str, PlannedParameter] = {}
    for i, c in enumerate(fit.problem.coordinates):
        low, high = sorted(float(from_standard(c.prior, z)) for z in (-1.645, 1.645))
        out[c.name] = {
            "unit": unit_of(c.name.partition("[")[0], kind),
            "prior90": [low, high],
            "expected90": list(fit.interval(c.name)),
            "sd_over_prior": float(math.sqrt(max(fit.covariance[i, i], 0.0))),
        }
    return out


def _sentences(
    campaign: Campaign, fit: Calibration, rows: Sequence[PlannedEffect], groups: Sequence[Sequence[str]],
    parameters: Mapping[str, PlannedParameter],
) -> list[str]:  # fmt: skip
    seen = [row["name"] for row in rows if row["nats"] >= NATS]
    blind = [row for row in rows if row["nats"] < NATS]
    titled = {row["name"]: f"{row['name']} ({row.get('title')})" if row.get("title") else row["name"] for row in rows}
    out = [f"{len(seen)} of {len(rows)} effects would be seen at their typical size."]
    if blind:
        out.append(f"Not seen at their typical size: {', '.join(titled[row['name']] for row in blind)}.")
    for row in blind:
        if row["repeats_to_see"] is not None:
            out.append(f"{row['name']} would be seen with {row['repeats_to_see']} times as many trials.")
    out += [f"{titled[a]} and {titled[b]} could not be distinguished." for a, b in groups]
    unknown = [name for name, p in parameters.items() if decided_by(p["sd_over_prior"] ** 2) == "prior"]
    if unknown:
        out.append(f"Nothing would be learnt about {', '.join(unknown)}: the prior would decide.")
    sensor = campaign.measurement.sensor_range
    if sensor is not None:
        reach = max(float(np.max(np.abs(t.y[0]))) for t in fit.problem.experiment.trials)
        if reach > 0.9 * sensor[0]:
            out.append(
                sentence_of(
                    f"The sensor of the primary would read up to {reach:.3g} {campaign.reading_unit}; its range ends "
                    f"at {sensor[0]:.3g}: choose a wider range or smaller angles.",
                    campaign.rig.kind,
                )
            )
    repeats: dict[tuple[Any, ...], int] = {}
    for t in fit.problem.experiment.trials:
        key = (t.case, t.coupled)
        repeats[key] = repeats.get(key, 0) + 1
    if min(repeats.values()) < 3:
        out.append("Plan at least three trials of each case and configuration: one is held out to judge the model.")
    return out
