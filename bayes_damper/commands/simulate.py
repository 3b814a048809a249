"""`bayes-damper simulate`: one noise-free record of a rig, any parameter changed and any effect added.

The rig is that of a campaign, fitted or not, measured or planned, or the thesis's.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration import Experiment, experiment_of, middle
from bayes_damper.calibration.experiment import longest_step
from bayes_damper.calibration.unknowns import NOMINAL
from bayes_damper.campaign import INPUT_COLUMNS, Constant, Measurement, Trial, load_plan, record_text
from bayes_damper.campaign.importing.logger_files import read_file
from bayes_damper.campaign.structure import INPUTS
from bayes_damper.diagnosis.search import offered
from bayes_damper.effects import Effect, all_effects
from bayes_damper.effects._law import Law
from bayes_damper.effects.base import Variant
from bayes_damper.errors import ExitCode, InputError
from bayes_damper.inputs import number_in, real
from bayes_damper.priors.distributions import Normal
from bayes_damper.priors.files import campaign_priors, load_priors
from bayes_damper.priors.limits import CURVES, OF_CURVES
from bayes_damper.published.measurements import load_published
from bayes_damper.published.sources import is_published
from bayes_damper.rig.equations import ROWS
from bayes_damper.rig.parameters import OTHER_UNIT, RIG_KEYS, hint, unit_of
from bayes_damper.rig.units import effect_unit
from bayes_damper.runs.json_files import write_text
from bayes_damper.simulation.model import Model, Quantity, Simulation
from bayes_damper.simulation.outcome import Outcome
from bayes_damper.text import Printable

_ABOVE_ZERO = ("J1", "J2", "R", "r", "nu")
_NOT_NEGATIVE = ("k1t", "c1t", "c2t", "c3t", "mu", "N0", "drag", "drag_ratio")
_MOST_APART = 1e6  # times what a rig has, above which a number cannot be one of its kind
_FEWEST = 4.0  # readings in a period, below which a motion is not seen
_WORDS = {"normal_force": ("linear", "constant"), "restoring": ("linear", "pendulum")}


@dataclass(frozen=True)
class SimulatedRecord(Printable):
    """A record written to `path`; `values` holds every value that was used."""

    path: Path
    values: dict[str, Any]
    exit_code: ExitCode = ExitCode.DONE
    warnings: tuple[str, ...] = ()

    def text(self) -> str:
        """For people."""
        files = f"{self.path}: the record; {self.path.with_suffix('.toml')}: all values used"
        return "\n".join([*(f"warning: {w}" for w in self.warnings), files])

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        result = {"schema": "bayes-damper/simulate/1", "record": str(self.path), "values": self.values}
        return result | ({"warnings": list(self.warnings)} if self.warnings else {})


@dataclass(frozen=True)
class _Rig:
    """What a record begins with: values of `equations.ROWS`, words of the rig, and what is offered for it.

    whose : for sentences; ties : name -> the one whose value it takes; experiment : of the campaign, None for the
    thesis.
    """

    whose: str
    case: str
    values: dict[str, float]
    words: dict[str, str]
    coupled: bool
    kind: str = "torsional"
    quantity: Quantity = "acceleration"
    rate: float = 1000.0
    duration: float = 1.0
    ties: Mapping[str, str] = field(default_factory=dict)
    experiment: Experiment | None = None

    def scaled(self, effect: Effect, variant: Variant) -> Variant | None:
        """A formula at the scale of the rig; None where the rig cannot have it."""
        if self.experiment is None:
            return variant
        able = offered(self.experiment, "nonlinear", {effect.name: effect})
        return next((v for _, v in able if v.name == variant.name), None)

    def model(self, coupled: bool, variant: Variant | None) -> Model:
        """The rig with an effect."""
        laws: dict[str, Any] = {**self.words, "effect": variant}
        if self.experiment is not None:
            laws |= {"coupling_law": self.experiment.coupling_law, "longest_step": longest_step(self.experiment)}
        return Model(coupled, **laws)


def _thesis(case: str | None) -> _Rig:
    """The thesis's rig at the medians of its priors."""
    published, case = load_published(), case or "IV"
    if case not in published.cases:
        raise InputError(f"--case {case}: the thesis has no such case; its cases are {', '.join(published.cases)}")
    priors = load_priors("thesis").for_case(case)
    # Cut at physical bounds, a normal prior's median lies a little off the declared value: that one is meant.
    values = priors.medians() | {name: d.mean for name, d in priors.free.items() if isinstance(d, Normal)}
    values |= {"k1t": published.cases[case].k1t, "theta0": published.cases[case].theta0, "J12": 0.0, "k3t": 0.0}
    words = {key: choices[0] for key, choices in _WORDS.items()}
    return _Rig("the thesis's rig", case, values, words, coupled=True, ties=priors.tied)


def _own(folder: str | Path, case: str | None) -> _Rig:
    """The rig of a campaign at its declared constants and the medians of its priors; its records need not be there."""
    campaign = load_plan(folder)
    file = Path(folder) / "priors.toml"
    experiment = experiment_of(campaign, campaign_priors(file, campaign) if file.exists() else None)
    case = case or campaign.cases[0]
    if case not in campaign.cases:
        raise InputError(f"--case {case}: there is no such case; {folder} has {', '.join(campaign.cases)}")
    trials = [t for t in campaign.trials if t.case == case]
    first = next((t for t in trials if t.coupled), trials[0])
    values = {"J12": 0.0, "k3t": 0.0, "N0": 0.0, "R": 1.0, "r": 1.0}
    values |= {name: value for name, (value, _) in experiment.constants.items()}
    values |= {"k1t": first.k1t.value, "theta0": 0.0 if first.theta0 is None else first.theta0.value}
    values |= {name: middle(experiment.prior(name, case)) for name in NOMINAL}
    values |= {name: values[other] for name, other in experiment.ties.items() if name in NOMINAL}
    if not experiment.magnet:
        values["mu"] = 0.0
    rig, rate = campaign.rig, float(f"{1.0 / np.median(np.diff(first.times)):.6g}")
    return _Rig(
        f"{campaign.name} at the medians of its priors", case, values,
        {"normal_force": rig.normal_force, "restoring": rig.restoring}, first.coupled, rig.kind,
        campaign.measurement.quantity, rate, float(first.times[-1]), experiment.ties, experiment,
    )  # fmt: skip


def simulate_record(
    case: str | None = None,
    *,
    campaign: str | Path | None = None,
    coupled: bool = True,
    settings: Sequence[str] = (),
    effect: str | None = None,
    rate: float | None = None,
    duration: float | None = None,
    inputs: str | Path | None = None,
    out: str | Path,
    effects_folder: str | Path | None = None,
) -> SimulatedRecord:
    """Simulate one record and write it in the record format, with a TOML of all values beside it.

    Parameters
    ----------
    case : gives k1t and theta0; default IV of the thesis, the first of a campaign. campaign : folder, whose rig takes
    the place of the thesis's: its declared constants and the medians of its priors, in its units; its records need not
    be there.
    settings : "NAME=VALUE" each: a parameter, a rig key of campaign.toml, or EFFECT.PARAMETER. SI units.
    effect : name of an effect, or NAME/VARIANT; at the first of its starts where `settings` say nothing else.
    rate : Hz; duration : s; by default those of the campaign's first trial of the case, 1000 and 1 for the thesis.
    out : the CSV file to write. coupled : False for the primary alone.
    inputs : CSV file of what acts, time_s and any of torque1_n_m, torque2_n_m, ground_rad and ground_rad_s2, linear
        between samples; the record has its times, in place of rate and duration, and absolute readings. With
        motion1_rad or motion1_rad_s2 the primary moves so, and its channel is the reaction (reaction1_n_m).
    effects_folder : folder with effects of your own or learnt laws, or one such file.

    Raises
    ------
    InputError
        for an unknown name, a value that is no number, or a record that cannot be simulated: all faults at once.
    """
    rig = _thesis(case) if campaign is None or is_published(campaign) else _own(campaign, case)
    coupled = coupled and rig.coupled
    rate, duration = rig.rate if rate is None else rate, rig.duration if duration is None else duration
    faults: list[str] = []
    if not (np.isfinite(rate) and rate > 0.0):
        faults.append(f"--rate {rate}: expected a positive number of samples per second")
    if not (np.isfinite(duration) and duration > 0.0) or not 0.5 < duration * rate <= 1e7:
        faults.append(f"--duration {duration}: expected a positive number of seconds, with 2 to ten million samples")
    chosen = _chosen(effect, effects_folder, faults)
    variant = None if chosen is None else rig.scaled(*chosen)
    if chosen is not None and variant is None:
        faults.append(f"--effect {effect}: this rig cannot have it: it needs {chosen[0].needs_in_words()}")
    values, words = rig.values, rig.words
    own = {} if variant is None else dict(zip((p.name for p in variant.parameters), variant.starts[0], strict=True))
    suspect = _apply(settings, rig, own, effect, faults)
    if not inputs and not values["theta0"]:
        faults.append(
            f"this rig declares no release; give one with --set theta0=NUMBER, in {unit_of('theta0', rig.kind)}"
        )
    law: Law | None = None if chosen is None else chosen[0].law
    if law is not None and (why := law.mismatch(rig.kind, values)) is not None:
        faults.append(f"--effect {effect}: {why}")
    if faults:
        raise InputError(faults)
    path = Path(out)
    if path.suffix == ".toml":
        raise InputError(f"--out {path}: the values used go to that name; give the record another ending, e.g. .csv")
    trial = None if inputs is None else _driven(Path(inputs), coupled, rig.kind)
    times = np.arange(round(duration * rate) + 1) / rate if trial is None else trial.times
    model = rig.model(coupled, variant)

    def run(quantity: Quantity) -> Simulation:
        return model.simulate(
            {name: values[name] for name in ROWS if name in values},
            times,
            effect=own or None,
            inputs=None if trial is None else trial.inputs(Measurement()),
            quantity=quantity,
        )

    try:
        simulation = run(rig.quantity)
    except ValueError as error:
        raise InputError(f"--inputs {inputs}: {error}") from None
    outcome = Outcome(int(simulation.outcome[0]))
    if outcome is not Outcome.COMPLETED:
        raise InputError(f"this record cannot be simulated: {outcome.sentence.partition(';')[0]}; see what --set gives")
    acting = None if trial is None else {name: getattr(trial, name) for name in INPUTS}
    write_text(path, record_text(times, simulation.y[0], rig.kind, rig.quantity, acting))
    used: dict[str, Any] = {"case": rig.case, "configuration": "coupled" if coupled else "uncoupled"}
    used |= {"rate": rate, "duration": duration} if inputs is None else {"inputs": str(inputs)}
    used |= {} if rig.experiment is None else {"campaign": str(campaign), "kind": rig.kind}
    used |= words | {name: values[name] for name in ROWS if name in values}
    write_text(path.with_suffix(".toml"), _values_text(used, str(effect), variant, own, rig))
    warnings = (*suspect, *([] if law is None else _beyond(law, run, times, coupled)), *_unseen(values, times))
    return SimulatedRecord(path, used | ({"effect": own} if variant is not None else {}), warnings=warnings)


def _values_text(
    used: Mapping[str, object], effect: str, variant: Variant | None, own: Mapping[str, float], rig: _Rig
) -> str:  # fmt: skip
    """The values of a record as TOML, those of an effect in a table of their own."""
    lines = [f"{key} = {_toml(value)}{_comment(key, rig.kind)}" for key, value in used.items()]
    if variant is not None:
        lines += ["", "[effect]", f'name = "{effect.partition("/")[0]}"', f'variant = "{variant.name}"']
        lines += [
            f"{p.name} = {own[p.name]!r}  # {effect_unit(p.unit, rig.kind, rig.quantity)}" for p in variant.parameters
        ]
    return "\n".join(lines) + "\n"


def _unseen(values: Mapping[str, float], times: NDArray[np.float64]) -> Iterator[str]:
    """Sentences where readings at these times show no motion."""
    if (delay := values.get("delay", 0.0)) >= times[-1]:
        yield f"the release, at {delay:g} s, comes after the record's end at {times[-1]:g} s: nothing moves"
    period = 2.0 * np.pi * np.sqrt(values["J1"] / values["k1t"]) if values["k1t"] > 0.0 else np.inf
    if (read := period / float(np.median(np.diff(times)))) < _FEWEST:
        yield (
            f"the primary on its spring swings with a period of {period:.3g} s, which has {read:.2g} readings: "
            "too few to show it; raise --rate"
        )


def _beyond(law: Law, run: Callable[[Quantity], Simulation], times: NDArray[np.float64], coupled: bool) -> list[str]:
    """Sentences where a record leaves the range of a learnt law."""
    angles, speeds = (run(quantity).y[0] for quantity in ("displacement", "velocity"))
    if law.site == "interface":
        own = [(angles[0] - angles[-1], speeds[0] - speeds[-1])] if coupled else []
    else:
        bodies = {"ground2": [1], "bearings": [0, 1]}.get(law.site, [0])[: 1 if law.bodies == "primary" else None]
        own = [(angles[b], speeds[b]) for b in bodies if b < len(angles)]
    seen = {"time": (0.0, float(times[-1] - times[0]))}
    for k, name in enumerate(("angle", "speed")):
        values = [pair[k] for pair in own]
        seen |= {name: (min(v.min() for v in values), max(v.max() for v in values))} if values else {}
    out = law.outside(seen)
    if law.beside:
        out.append(f"{law.name} was learnt beside {' and '.join(law.beside)}, which this record does not have")
    return out


def _driven(path: Path, coupled: bool, kind: str) -> Trial:
    """A trial with the times and inputs of a CSV file, and nothing measured yet."""
    columns = ("time_s", *INPUT_COLUMNS[kind])
    _, torque2, ground, ground_a, motion, motion_a, _ = INPUT_COLUMNS[kind]
    torque = columns[1]
    file = read_file(path)
    unknown = [name for name in file.names if name not in columns]
    if unknown or "time_s" not in file.names or len(file.names) < 2:
        found = ", ".join(file.names) or "none"
        raise InputError(
            f"--inputs {path}: expected a column time_s and some of {', '.join(columns[1:])}; found {found}"
        )
    table = {name: file.table[:, i] for i, name in enumerate(file.names)}
    times = table.pop("time_s")
    faults = [f"--inputs {path}: column '{n}' has gaps" for n, x in table.items() if not np.isfinite(x).all()]
    if times.size < 2 or not np.isfinite(times).all() or np.any(np.diff(times) <= 0.0):
        faults.append(f"--inputs {path}: time_s must rise from line to line")
    if torque2 in table and not coupled:
        faults.append(f"--inputs {path}: {torque2} acts on the secondary; leave it or --uncoupled out")
    if {ground, ground_a} <= set(table):
        faults.append(f"--inputs {path}: {ground} and {ground_a} are one motion of the ground; keep one")
    if {motion, motion_a} <= set(table):
        faults.append(f"--inputs {path}: {motion} and {motion_a} are one motion of the primary; keep one")
    if {motion, motion_a} & set(table) and {torque, ground, ground_a} & set(table):
        faults.append(
            f"--inputs {path}: a prescribed motion of the primary leaves no room for {torque} or a moving ground; "
            "keep one"
        )
    if faults:
        raise InputError(faults)
    names = dict(zip(INPUT_COLUMNS[kind], INPUTS, strict=True))
    acting: dict[str, Any] = {names[n]: x for n, x in table.items()}
    nothing = np.zeros((1 + int(coupled), times.size))
    configuration = "coupled" if coupled else "uncoupled"
    return Trial("", "", configuration, 1, Constant(1.0), None, times, nothing, **acting)


def _chosen(effect: str | None, folder: str | Path | None, faults: list[str]) -> tuple[Effect, Variant] | None:
    if effect is None:
        return None
    known = all_effects(folder)
    name, _, wanted = effect.partition("/")
    if name not in known:
        faults.append(f"--effect {name}: there is no such effect; {hint(name, known)}")
        return None
    variants = {v.name: v for v in known[name].variants}
    if wanted and wanted not in variants:
        faults.append(f"--effect {effect}: {name} has the variants {', '.join(variants)}")
        return None
    return known[name], variants[wanted] if wanted else known[name].variants[0]


def _apply(
    settings: Sequence[str], rig: _Rig, own: dict[str, float], effect: str | None, faults: list[str]
) -> list[str]:
    """Changes the rig's values and words, and `own`, as `settings` say; sentences on numbers that look like another
    unit's.
    """
    values, words = rig.values, rig.words
    given = set()
    suspect: list[str] = []
    for setting in settings:
        name, equals, text = (part.strip() for part in setting.partition("="))
        key = RIG_KEYS.get(name, name)
        if key == "kind":
            faults.append(f"--set {setting}: a rig of another kind is that of a campaign: bayes-damper simulate FOLDER")
            continue
        if not equals:
            faults.append(f"--set {setting}: expected NAME=VALUE")
            continue
        if key in _WORDS:
            if text not in _WORDS[key]:
                faults.append(f"--set {setting}: expected one of {', '.join(_WORDS[key])}")
            words[key] = text
            continue
        try:
            number = real(number_in(text), f"--set {name}")
        except ValueError:
            faults.append(f"--set {setting}: {text!r} is no number")
            continue
        except InputError as error:
            faults.extend(error.faults)
            continue
        prefix, dot, parameter = key.partition(".")
        if dot:
            if effect is None or prefix != effect.partition("/")[0]:
                faults.append(f"--set {setting}: choose the effect first: --effect {prefix}")
            elif parameter not in own:
                faults.append(f"--set {setting}: {prefix} has no {parameter!r}; {hint(parameter, own)}")
            else:
                own[parameter] = number
        elif key in ROWS and ((number < 0.0 and key in _NOT_NEGATIVE) or (number <= 0.0 and key in _ABOVE_ZERO)):
            faults.append(f"--set {setting}: must be {'above 0' if key in _ABOVE_ZERO else '0 or more'}")
        elif key in ROWS:
            usual = abs(values.get(key, 0.0)) if key not in given and key not in ("nu", "tail") else 0.0
            if usual > 0.0 and not 1.0 / OTHER_UNIT <= abs(number) / usual <= OTHER_UNIT and number:
                unit, beyond = unit_of(key, rig.kind), abs(number) > _MOST_APART * usual
                degrees = ": an angle in radians, not in degrees" if unit == "rad" else ""
                (faults if beyond else suspect).append(
                    f"--set {setting} is {abs(number) / usual:.3g} times what {rig.whose} has, {usual:.4g}"
                    f"{' ' + unit if unit and unit != '1' else ''}; "
                    + (f"no rig like it has so much{degrees}" if beyond else f"it is taken in SI units{degrees}")
                )
            values[key] = number
            given.add(key)
        else:
            of_effect = [f"{effect.partition('/')[0]}.{p}" for p in own] if effect is not None else []
            known = [*of_effect, *ROWS, *RIG_KEYS, *_WORDS]
            faults.append(f"--set {setting}: nothing is called {name!r}; {hint(name, known)}")
    for name, other in rig.ties.items():
        if other in given and name not in given:
            values[name] = values[other]
    if rig.coupled and "J12" in given and values["J12"] ** 2 >= values["J1"] * values["J2"]:
        faults.append("--set J12: must be smaller than sqrt(J1 J2): no rig has such an inertia matrix")
    if "tail" in given and not CURVES[0] <= values["tail"] <= CURVES[1]:
        faults.append(f"--set tail: {OF_CURVES}")
    return suspect


def _toml(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else repr(float(value))


def _comment(name: str, kind: str) -> str:
    unit = {"rate": "Hz", "duration": "s"}.get(name) or unit_of(name, kind)
    return f"  # {unit}" if unit else ""
