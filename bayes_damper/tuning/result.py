"""`tune`: from draws to designs judged, sentences, tables and figures."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayes_damper import figures
from bayes_damper.effects import load_effects, names_in
from bayes_damper.effects._law import SITES, Law
from bayes_damper.errors import ExitCode, InputError
from bayes_damper.rig.parameters import OTHER_UNIT, PARAMETERS, unit_of
from bayes_damper.rig.units import BODIES, CHOSEN, design_in_words, in_words_of, motion_in_words
from bayes_damper.runs.json_files import write_json
from bayes_damper.runs.parallel_map import single_threaded
from bayes_damper.runs.provenance import provenance
from bayes_damper.runs.threads import kernel_threads
from bayes_damper.text import Printable, counted, warning_lines
from bayes_damper.tuning.acting import Acting, acting_of
from bayes_damper.tuning.curves import Band, Curve, driven_responses, frequency_responses, tuning_curves
from bayes_damper.tuning.draws import Draws, Origin, chosen_case, origin_of, posterior_draws
from bayes_damper.tuning.optimum import TRIED, Optimum, best_design, best_driven, shares_of_variance, usual_bounds
from bayes_damper.tuning.performance import (
    Design,
    Performance,
    driven,
    drives,
    linear_performance,
    outside_of,
    probability_of,
    refused,
)

Array = NDArray[np.float64]
SCHEMA = "bayes-damper/tune/1"
_DEFINITION = "20 log10 of the highest accelerance without the secondary over the highest with it (eq. 24)"
_LAW_ACTS = (
    "The driven rig has the law {}, as large as in the fit; the linear model, and with it the search for the best "
    "design, leaves it out."
)
_BY_TIME = (
    "{} depends on the time since a release, and a rig that is driven on and on has none: the torque of its last "
    "moment is held"
)
_LEARNT = tuple(f"learnt_{site}" for site in SITES)
_GIVE_FILE = "The fit has the effect {}, which is left out here: give its file, --effects learnt/SITE.toml, to keep it."


@dataclass(frozen=True)
class TuneResult(Printable):
    """What `tune` found; `linear` and `nonlinear` belong to `design`, and `optimum` to the best one within bounds."""

    case: str
    design: Design
    draws: Draws
    target_db: float
    linear: Performance
    nonlinear: Mapping[float, Performance]
    optimum: Optimum | None
    optimum_nonlinear: Mapping[float, Performance]
    """Of that one, which the linear model chose, at each amplitude."""
    shares: Mapping[str, float]
    response: Mapping[str, Band]
    curves: Mapping[str, Curve] = field(default_factory=dict)
    origin: Origin = field(default_factory=Origin)
    seed: int = 1
    provenance: Mapping[str, Any] = field(default_factory=dict)
    folder: Path | None = None
    law: str = ""
    """Name of the learnt law that acts on the driven rig."""
    note: str = ""
    """What becomes of the effect that the fit has."""
    present: Performance | None = None
    """Of the rig as it is, by the linear model; None where that is the design."""
    present_nonlinear: Mapping[float, Performance] = field(default_factory=dict)
    better: Mapping[float, Optimum] = field(default_factory=dict)
    """Amplitude -> a design that is better there than the best one of the linear model."""
    curves_of_best: Mapping[str, Curve] = field(default_factory=dict)
    """As `curves`, with all else as in the best design."""

    @property
    def exit_code(self) -> ExitCode:
        """As that of the fit that the draws come from."""
        return ExitCode.DONE if self.origin.converged else ExitCode.NOT_CONVERGED

    def to_json(self) -> dict[str, Any]:
        """The content of tune.json."""
        best = self.optimum
        return {
            "schema": SCHEMA,
            "campaign": self.origin.campaign,
            "campaign_sha256": self.origin.sha256,
            "seed": self.seed,
            "case": self.case,
            "kind": self.origin.kind,
            "converged": self.origin.converged,
            "warnings": [*self.origin.known, *self.origin.warnings],
            "warnings_of_check": len(self.origin.known),
            "definition": in_words_of(_DEFINITION, self.origin.kind),
            "draws": len(self.draws["J1"]),
            "target_db": self.target_db,
            "design": self.design.to_json(),
            "linear": _performance_json(self.linear, self.target_db),
            "nonlinear": self._driven_json(self.nonlinear),
            "records_reach": self.origin.reach,
            "present": None
            if self.present is None
            else {
                "linear": _performance_json(self.present, self.target_db),
                "nonlinear": self._driven_json(self.present_nonlinear),
            },
            "optimum": None if best is None else self._optimum_json(best),
            "variance_shares": dict(self.shares),
            "hangs_most_on": next(iter(self.shares), None),
            "law": self.law or None,
            "notes": [self.note] if self.note else [],
            "frequency_response": {
                name: {
                    "frequency_hz": band.frequency_hz.tolist(),
                    "q05": band.low.tolist(),
                    "median": band.median.tolist(),
                    "q95": band.high.tolist(),
                }
                for name, band in self.response.items()
            },
            "curves": {name: self._curve_json(name) for name in self.curves},
            "provenance": dict(self.provenance),
        }  # fmt: skip

    def _optimum_json(self, best: Optimum) -> dict[str, Any]:
        """Entry `optimum` of tune.json."""
        return {
            "design": best.design.to_json(),
            "at_bound": list(best.at_bound),
            "linear": _performance_json(best.performance, self.target_db),
            "nonlinear": self._driven_json(self.optimum_nonlinear),
            "better_when_driven": [
                {"torque_amplitude_n_m": a, "design": b.design.to_json(), "at_bound": list(b.at_bound)}
                | _performance_json(b.performance, self.target_db)
                for a, b in self.better.items()
            ],
        }

    def _curve_json(self, name: str) -> dict[str, Any]:
        """Entry of `curves` of tune.json: losses along one value of the design, the others as they are."""
        c, best = self.curves[name], self.optimum
        return {
            "design": self._place(self.design, name),
            "best_design": None if best is None else self._place(best.design, name),
            "value": c.values.tolist(), "mean": c.mean.tolist(), "q05": c.low.tolist(), "q95": c.high.tolist(),
            "probability_of_target": c.probability.tolist(),
            "of_best_design": None
            if name not in self.curves_of_best
            else {
                key: getattr(self.curves_of_best[name], field_).tolist()
                for key, field_ in (("value", "values"), ("mean", "mean"), ("q05", "low"), ("q95", "high"))
            },
        }  # fmt: skip

    def _motion(self, p: Performance) -> str:
        if p.displacement is None or p.displacement_without is None or not np.isfinite(p.displacement).any():
            return ""
        first, second = BODIES[self.origin.kind]
        moves, without = (
            motion_in_words(float(np.nanmedian(x)), self.origin.kind) for x in (p.displacement, p.displacement_without)
        )
        return f"; {first} moves {moves} ({without} without {second})"

    def _who(self, best: Optimum) -> str:
        """A design by what it sets, and what of that is at a bound."""
        bound = f" (at the bound: {', '.join(best.at_bound)})" if best.at_bound else ""
        return (design_in_words(best.design.to_json(), self.origin.kind) or "the rig as it is") + bound

    def _driven_json(self, found: Mapping[float, Performance]) -> list[dict[str, Any]]:
        return [{"torque_amplitude_n_m": a} | _performance_json(p, self.target_db) for a, p in found.items()]

    def _place(self, design: Design, name: str) -> float:
        given = getattr(design, name)
        return float(np.median(self.draws[name]) if given is None else given)

    def text(self) -> str:
        """The result in a few lines."""
        effort, unit = self.origin.effort
        known = self.origin.known
        lines = warning_lines([*known, *self.origin.warnings], len(known))
        if not self.origin.converged:
            lines.append("*** THE FIT DID NOT CONVERGE: do not use these numbers ***")
        lines += [f"Case {self.case}, {counted(len(self.draws['J1']), 'draw')}; target {self.target_db:g} dB."]
        lines.append(f"linear model: {_sentence(self.linear, self.target_db)}")
        lines += [
            f"{effort} {a:g} {unit}: {_sentence(p, self.target_db)}{self._motion(p)}" for a, p in self.nonlinear.items()
        ]
        if self.present is not None:
            lines.append(f"the rig as it is, linear model: {_sentence(self.present, self.target_db)}")
        if self.optimum is not None:
            free = self._who(self.optimum)
            sentence = _sentence(self.optimum.performance, self.target_db)
            lines.append(f"best design, linear model: {free}; {sentence}")
            present = self.present_nonlinear or self.nonlinear
            lines += [
                f"  at {a:g} {unit}: {_sentence(p, self.target_db)}{self._motion(p)}; the rig as it is: "
                f"{_loss(present[a])}"
                for a, p in self.optimum_nonlinear.items()
            ]
            lines += [
                f"At {a:g} {unit} another design is better, {_loss(b.performance)}: {self._who(b)} (the best of the "
                f"linear model: {_loss(self.optimum_nonlinear[a])}; the rig as it is: {_loss(present[a])})."
                for a, b in self.better.items()
            ]
        if any("no resonance" in line for line in lines):
            lines.append("No resonance: dry friction holds the rig, or damping leaves no peak.")
        lines += [self.note] if self.note else []
        if self.shares:
            name, share = next(iter(self.shares.items()))
            meant = in_words_of(PARAMETERS[name].meaning, self.origin.kind) if name in PARAMETERS else ""
            what = f"{name} ({meant})" if meant else name
            lines.append(f"The insertion loss depends most on {what}: {100 * share:.0f} % of its variance.")
        if self.folder is not None:
            lines += [f"Files: {self.folder}", f"Next: bayes-damper report {shlex.quote(str(self.folder))}"]
        return "\n".join(lines)


def _loss(p: Performance) -> str:
    """The loss alone."""
    known = p.insertion_loss[np.isfinite(p.insertion_loss)]
    return "no resonance" if known.size == 0 else f"{known.mean():.1f} dB"


def _sentence(p: Performance, target: float) -> str:
    known = p.insertion_loss[np.isfinite(p.insertion_loss)]
    if known.size == 0:
        return "no resonance in any draw"
    low, high = np.quantile(known, [0.05, 0.95])
    gone = 1.0 - known.size / p.insertion_loss.size
    where, among = "", ""
    if gone > 0.005:
        where = f"no resonance in {100 * gone:.0f} % of the draws; in the others "
        among = " among all of them"
    down, up = np.nanquantile(p.shift, [0.05, 0.95])
    # Of two peaks that are as high, which is the highest is a matter of chance.
    either = f" (90 %: {down:+.2f} to {up:+.2f})" if down < 0.0 < up else ""
    return (
        f"{where}insertion loss {known.mean():.1f} dB (90 %: {low:.1f} to {high:.1f}), resonance moves by "
        f"{np.nanmedian(p.shift):+.2f} Hz{either}, P(loss >= {target:g} dB){among} = {probability_of(p, target):.2f}"
    )


def _performance_json(p: Performance, target: float) -> dict[str, Any]:
    return {
        "insertion_loss_db": _summary(p.insertion_loss),
        "resonance_hz": _summary(p.resonance),
        "resonance_without_hz": _summary(p.resonance_without),
        "resonance_shift_hz": _summary(p.shift),
        "probability_of_target": probability_of(p, target),
    } | (
        {}
        if p.displacement is None or p.displacement_without is None
        else {"displacement": _summary(p.displacement), "displacement_without": _summary(p.displacement_without)}
    )


def _summary(x: Array) -> dict[str, Any]:
    known = x[np.isfinite(x)]
    if known.size == 0:
        return {"mean": None, "sd": None, "median": None, "interval90": None, "without": int(x.size)}
    return {
        "mean": float(known.mean()),
        "sd": float(known.std()),
        "median": float(np.median(known)),
        "interval90": [float(q) for q in np.quantile(known, [0.05, 0.95])],
        "without": int(x.size - known.size),
    }


def _check_numbers(n_draws: int, n_nonlinear: int, target_db: float, amplitudes: Sequence[float]) -> None:
    """InputError for numbers with which nothing can be predicted."""
    faults = []
    if min(n_draws, n_nonlinear) < 1:
        faults.append(f"n_draws = {n_draws}, n_nonlinear = {n_nonlinear}: at least one draw of each is needed")
    if not math.isfinite(target_db):
        faults.append(f"target_db = {target_db:g}: give the loss to reach as a number of dB")
    faults += [refused(a) for a in amplitudes if not drives(a)]
    if faults:
        raise InputError(faults)


def _bounds_of(
    draws: Draws, origin: Origin, free: Sequence[str] | None, given: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """Bounds of the search: those given, and the usual ones of what else is free."""
    usual = usual_bounds(draws, ("J2", "k2t", *(("R",) if origin.radius else ())) if free is None else free)
    bounds = {**usual, **given}
    if missing := [name for name in free or () if name not in bounds]:
        raise InputError([f"{n}: it is 0 on the rig, so nothing says where to look; give bounds" for n in missing])
    return bounds


@single_threaded
@kernel_threads(2)
def tune(
    source: Mapping[str, ArrayLike] | Path | str,
    *,
    case: str | None = None,
    rig: Mapping[str, float] | None = None,
    J2: float | None = None,
    k2t: float | None = None,
    R: float | None = None,
    magnet_pull: float | None = None,
    bar_inertia: float = 0.0,
    c2t: float | None = None,
    friction_torque: float | None = None,
    target_db: float = 10.0,
    amplitudes: Sequence[float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    free: Sequence[str] | None = None,
    optimise: bool = True,
    n_draws: int = 400,
    n_nonlinear: int = 50,
    seed: int = 1,
    effects: Path | str | None = None,
    out: Path | str | None = None,
    report: Callable[[str], None] = lambda _: None,
) -> TuneResult:
    """Insertion loss and resonance shift of a design over a posterior, and the design of highest expected loss.

    Parameters
    ----------
    source : posterior draws, name -> (n,), or the folder of a fit; case : which of its cases ("joint": all together),
    by default the only one, else IV.
    rig : constants that the posterior does not hold (SI); else those of the fitted campaign, else the thesis's.
    J2, k2t, R, magnet_pull, c2t : the design: inertia of the secondary (kg m^2; mass, kg), stiffness (N m/rad; N/m) and
    damping (N m s/rad; N s/m) of the coupling, radius of the magnets (m), pull (N); None keeps the rig as it is.
    bar_inertia : the part of J2 that grows with R^3; friction_torque : dry friction between the bodies at full overlap,
    N m (force, N), in place of what the pull makes of mu.
    target_db : loss whose probability is given; amplitudes : torques (N m; forces, N) at which the nonlinear model is
    driven, by default of the size of the rig.
    free : what the search for the best design changes, of "J2", "k2t", "R" and "c2t"; by default the first three.
    bounds : name -> lowest and highest value (SI) in that search, of further ones or of these in place of the usual
    shares of what the rig has; out : folder for `tune.json` and figures.
    n_draws, n_nonlinear : draws for the linear and, among them, for the nonlinear model; seed : picks them.
    effects : the file of a learnt law (learnt/SITE.toml) that the fit has, or a folder with it: it then acts on the
    driven rig; beyond the range that it was learnt in it holds its last value, and a warning says so. An effect of the
    library that the fit has acts without being asked for.
    optimise : False leaves out the search for the best design; report : called with a sentence for each step.

    Raises
    ------
    InputError
        if the design, the draws or the bounds mean nothing physically, or `effects` is not a law that the fit has.
    """
    design = Design(J2, k2t, R, magnet_pull, bar_inertia, c2t, friction_torque)
    _check_numbers(n_draws, n_nonlinear, target_db, amplitudes or ())
    rng = np.random.default_rng(seed)
    case = chosen_case(source, case)
    origin = origin_of(source, case, rig)
    if not origin.radius and (R is not None or "R" in {*(free or ()), *(bounds or {})}):
        which = "a translational rig" if origin.kind == "translational" else "a rig without a magnet, bar_radius = 1,"
        raise InputError(f"R{'' if R is None else f' = {R:g}'}: {which} has no radius; change J2 or k2t")
    law = None if effects is None else _law_of(Path(effects), origin, isinstance(source, Mapping))
    if amplitudes is None:
        amplitudes = origin.amplitudes
    draws: Draws = posterior_draws(source, case, n_draws, rng, {**origin.constants, **(rig or {})})
    if law is not None:
        acting, note = Acting.of_law(law), _LAW_ACTS.format(law.name)
    elif origin.effect in _LEARNT:
        acting, note = None, _GIVE_FILE.format(origin.effect)
    else:
        acting, draws, note = acting_of(origin, draws)
    if magnet_pull is not None and not draws["mu"].any():
        raise InputError(
            f"magnet_pull = {magnet_pull:g}: the fit has no friction between the bodies (mu = 0), so the pull changes "
            "nothing; leave it out, or give the friction itself (friction_torque)"
        )
    varied = ("J2", "R") if origin.radius else ("J2",)
    if bounds is None or free is not None:
        bounds = _bounds_of(draws, origin, free, bounds or {})
    origin = replace(origin, warnings=(*origin.warnings, *_unlike(design, draws, origin.kind)))
    performance = linear_performance(draws, design)
    if optimise:
        report("looking for the best design")
    optimum = best_design(draws, design, bounds) if optimise else None
    if optimum is not None and not np.isfinite(optimum.performance.insertion_loss).any():
        optimum = None
    same = {name: np.array_equal(x, draws[name]) for name, x in design.apply(draws).items()}
    designs = ({} if all(same.values()) else {"present": Design()}) | {"design": design}
    if optimum is not None:
        designs |= {"best design": optimum.design}
    few = {name: column[:n_nonlinear] for name, column in draws.items()}
    linear_is_exact = acting is None and not any(design.apply(few)[name].any() for name in ("mu", "drag"))
    by_amplitude: dict[str, dict[float, Performance]] = {name: {} for name in designs}
    better: dict[float, Optimum] = {}
    response = {f"linear, {name}": band for name, band in frequency_responses(draws, designs).items()}
    for i, a in enumerate(map(float, amplitudes), 1):
        report(f"driving the nonlinear rig: {a:.2g} {origin.effort[1]}, amplitude {i} of {len(amplitudes)}")
        found = driven(few, a, designs, acting)
        for name, p in found.performances.items():
            by_amplitude[name][a] = p
        response |= {f"{a:g} {origin.effort[1]}, {name}": band for name, band in driven_responses(few, found).items()}
        moves = any(np.isfinite(p.insertion_loss).any() for p in found.performances.values())
        if optimum is not None and moves and not linear_is_exact:
            report(f"trying {sum(TRIED)} designs at this amplitude")
            # What is not free is as in the first of them: the best one of the linear model.
            best, at_bound = best_driven(few, list(reversed(designs.values())), bounds, a, acting)
            if best != optimum.design:
                p = driven(few, a, {"": best}, acting, found.sweeps["uncoupled"]).performances[""]
                better[a] = Optimum(best, p, at_bound)
    nonlinear = by_amplitude["design"]
    outside = [] if acting is None else _beyond(acting, few, nonlinear, design)
    outside += _far(origin, by_amplitude)
    origin = replace(origin, warnings=(*origin.warnings, *outside))
    shares = shares_of_variance(draws, performance.insertion_loss)
    result = TuneResult(
        case, design, draws, target_db, performance, nonlinear, optimum, by_amplitude.get("best design", {}),
        shares, response,
        tuning_curves(draws, design, target_db, varied), origin, seed, provenance(),
        None if out is None else Path(out), "" if law is None else law.name, note,
        linear_performance(draws) if "present" in designs else None, by_amplitude.get("present", {}), better,
        {} if optimum is None else tuning_curves(draws, optimum.design, target_db, varied),
    )  # fmt: skip
    if out is not None:
        saved = result.to_json()
        write_json(Path(out) / "tune.json", saved)
        about = f"{origin.campaign or 'design'}, case {case}"
        figures.save(figures.response_figure(saved, title=f"{about}: frequency response"), Path(out) / "tune_response")
        figures.save(figures.tuning_figure(saved, title=f"{about}: insertion loss"), Path(out) / "tune_loss")
    return result


def _law_of(path: Path, origin: Origin, arrays: bool) -> Law:
    """The learnt law that a fit has; draws given as arrays may have any.

    Raises
    ------
    InputError
        if there is none, or it is that of another rig.
    """
    laws: dict[str, Law] = {name: e.law for name, e in load_effects(path).items() if e.law is not None}
    wanted = origin.effect if not arrays else next(iter(laws), "")
    law = laws.get(wanted)
    if beside := [name for name in names_in(wanted or None) if name in laws and name != wanted]:
        raise InputError(
            f"{path}: the fit has {beside[0]} beside another effect, and tune drives a learnt law alone; leave out "
            "--effects to drive the rig without the law"
        )
    if law is None:
        has = f"the fit has the effect {origin.effect}" if origin.effect else "the fit has no learnt law"
        raise InputError(
            f"{path}: holds {', '.join(laws) or 'no learnt law'}, and {has}; tune takes a learnt law that was fitted: "
            f"`bayes-damper fit CAMPAIGN --effects {path} --effect {next(iter(laws), 'learnt_SITE')}`"
        )
    if (why := law.mismatch(origin.kind, origin.constants)) is not None:
        raise InputError(f"{path}: {why}")
    return law


def _unlike(design: Design, draws: Draws, kind: str) -> list[str]:
    """Warnings on numbers of a design that are far from the rig's: perhaps in another unit."""
    out = []
    has = {**draws, "friction_torque": draws["mu"] * draws["N0"] * draws["R"]}
    for name, value in design.to_json().items():
        key = CHOSEN[name]
        usual = 0.0 if name == "bar_inertia" else float(np.median(has[key]))
        if value and usual > 0.0 and not 1.0 / OTHER_UNIT <= value / usual <= OTHER_UNIT:
            unit = unit_of(key, kind)
            out.append(
                f"{name} = {value:g} {unit} is {value / usual:.3g} times what the rig has, {usual:.3g}; in {unit}?"
            )
    return out


def _far(origin: Origin, by_amplitude: Mapping[str, Mapping[float, Performance]]) -> list[str]:
    """A warning where the primary moves farther than in the records of the fit; by_amplitude : of each design."""
    first, second = BODIES[origin.kind]
    effort, unit = origin.effort
    as_it_is = f"{second} as it is"
    own = "your design" if "present" in by_amplitude else as_it_is
    names = {"present": as_it_is, "design": own, "best design": "the best design"}
    where = []
    for a in by_amplitude["design"]:
        moves = {f"without {second}": by_amplitude["design"][a].displacement_without}
        moves |= {f"with {names[name]}": performances[a].displacement for name, performances in by_amplitude.items()}
        reach = {side: float(np.nanmedian(x)) for side, x in moves.items() if x is not None and np.isfinite(x).any()}
        far = [
            f"{motion_in_words(x, origin.kind)} {side}"
            for side, x in reach.items()
            if origin.reach is not None and x > 1.02 * origin.reach
        ]
        where += [f"{effort} {a:g} {unit}: {', '.join(far)}"] if far else []
    if not where or origin.reach is None:
        return []
    reach_said = motion_in_words(origin.reach, origin.kind)
    farther = f"{first} moves farther than in the records of the fit ({reach_said}), where the model is not tested: "
    return [farther + "; ".join(where)]


def _beyond(acting: Acting, draws: Draws, driven: Mapping[float, Performance], design: Design) -> list[str]:
    """Warnings on a law where it does not reach, at the largest amplitude."""
    law = acting.law
    if law is None:
        return []
    out = [_BY_TIME.format(law.name)] if any(t.along == "time" for t in law.terms) else []
    if driven:
        largest = max(driven)
        effort = f"driven at {largest:g}"
        out += [f"{effort}: {said}" for said in outside_of(acting, draws, largest, design, driven[largest])]
    return out
