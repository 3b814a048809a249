"""The library of effects: what a rig may do that the nominal model leaves out, one file each.

`EFFECTS` holds those of this folder, found by scanning it; a file whose name begins with an underscore holds shapes
that effects share. Effects of a user's own come from a folder (`load_effects`) or from installed packages (entry points
of the group "bayes_damper.effects"). `candidates` gives the effects that a rig can have.
"""

from __future__ import annotations

import hashlib
import importlib.util
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType
from typing import Any, Literal

import numpy as np

from bayes_damper.effects._law import is_law, read_law
from bayes_damper.effects.base import SITES, Effect, EffectParameter, Variant
from bayes_damper.errors import InputError
from bayes_damper.inputs import is_file
from bayes_damper.priors.distributions import Distribution, HalfNormal, LogScale, LogUniform, Normal, Uniform
from bayes_damper.rig.equations import Rig

__all__ = [
    "EFFECTS",
    "ENTRY_POINTS",
    "REFERENCE",
    "Effect",
    "EffectParameter",
    "Scales",
    "Variant",
    "all_effects",
    "candidates",
    "classes",
    "effects_sha256",
    "faults",
    "load_effects",
    "names_in",
    "same_effects",
    "scaled",
]

ENTRY_POINTS = "bayes_damper.effects"
FORMERLY = {
    "bayes_damper.lanes": "bayes_damper.rig.vector_math",
    "bayes_damper.damper": "bayes_damper.rig.equations",
    "bayes_damper.distributions": "bayes_damper.priors.distributions",
}
"""Where files of users' effects used to import from -> where that lies now; such files go on working."""

EFFECTS: dict[str, Effect] = {
    module.name: import_module(f"{__name__}.{module.name}").EFFECT
    for module in iter_modules(__path__)
    if module.name != "base" and not module.name.startswith("_")
}
"""Name -> effect of the library, in alphabetical order."""


def names_in(effect: str | Sequence[str] | None) -> tuple[str, ...]:
    """Names of the effects that a model is given: of one, of two ("A+B" or a name each), or of none.

    Raises
    ------
    InputError
        for more than two, or twice the same.
    """
    words = [effect] if isinstance(effect, str) else effect or ()
    names = tuple(name.strip() for word in words for name in word.split("+"))
    given = " ".join(f"--effect {name}" for name in names)
    if "" in names:
        raise InputError(f"{given}: a name is missing; give the name of an effect, or leave this out")
    if len(set(names)) < len(names):
        raise InputError(f"{given}: this is the same effect twice; give it once, or another one beside it")
    if len(names) > 2:
        raise InputError(f"{given}: a fit takes one effect, or two at once; leave out {len(names) - 2} of these")
    return names


@dataclass(frozen=True)
class Scales:
    """Magnitudes of a rig: release angle (rad), inverse frequency (s/rad), spring torque (N m), peak reading."""

    angle: float
    time: float
    torque: float
    reading: float


REFERENCE = Scales(angle=0.1, time=1.0 / 55.0, torque=0.8, reading=200.0)
"""Magnitudes of the thesis's rig, for which the priors and starts of the library are written."""

_DIMENSIONS = {"T": "torque", "rad": "angle", "s": "time", "reading": "reading", "1": ""}


def _exponents(unit: str) -> dict[str, float]:
    """Powers of the scales in a unit such as "N m s/rad^2" or "1/(N m rad)"; ValueError if it cannot be read."""
    powers: dict[str, float] = {}
    above, _, below = unit.replace("N m", "T").partition("/")
    for sign, part in ((1.0, above), (-1.0, below)):
        for token in re.sub(r"[()]", " ", part).split():
            symbol, _, power = token.partition("^")
            if symbol not in _DIMENSIONS:
                raise ValueError(f"unit {unit!r}: {symbol!r} is none of N m, rad, s, reading and 1")
            scale = _DIMENSIONS[symbol]
            powers[scale] = powers.get(scale, 0.0) + sign * float(power or 1.0)
    return powers


def _ratio(unit: str, scales: Scales) -> float:
    ratio = 1.0
    for scale, power in _exponents(unit).items():
        if scale:
            ratio *= (getattr(scales, scale) / getattr(REFERENCE, scale)) ** power
    return ratio


def _stretched(prior: Distribution, ratio: float) -> Distribution:
    """The distribution of `ratio` times the variable."""
    if isinstance(prior, LogScale):
        return replace(prior, median_value=prior.median_value * ratio)
    if isinstance(prior, Normal | HalfNormal | Uniform | LogUniform):
        changes: dict[str, Any] = {
            f.name: getattr(prior, f.name) * ratio for f in fields(prior) if f.name != "coordinate"
        }
        return replace(prior, **changes)
    raise TypeError(f"cannot scale a prior of the kind {type(prior).__name__}")


def scaled(variant: Variant, scales: Scales) -> Variant:
    """The variant with priors, starts and nulls for a rig of other magnitudes than the thesis's.

    Each parameter is multiplied by the ratio of the scales that its unit is made of, so that a pendulum that swings 1
    rad in 2 s has the same prior probabilities of relative effects as a rig that swings 0.1 rad in 0.1 s.
    """
    ratios = [_ratio(p.unit, scales) for p in variant.parameters]
    parameters = tuple(
        p if ratio == 1.0 else replace(
            p, prior=_stretched(p.prior, ratio), null=None if p.null is None else p.null * ratio
        )
        for p, ratio in zip(variant.parameters, ratios, strict=True)
    )  # fmt: skip
    starts = tuple(tuple(x * ratio for x, ratio in zip(start, ratios, strict=True)) for start in variant.starts)
    return replace(variant, parameters=parameters, starts=starts)


_SENTENCE = "must be a sentence: a capital letter first, three words or more, a full stop last"


def _is_sentence(text: str) -> bool:
    return len(text.split()) >= 3 and text[0].isupper() and text.endswith(".")


def _variant_faults(variant: Variant) -> Iterable[str]:
    names = [p.name for p in variant.parameters]
    if not names or len(set(names)) != len(names):
        yield "needs parameters, each with a name of its own"
    for p in variant.parameters:
        for name in ("meaning", "reason"):
            if not _is_sentence(text := getattr(p, name)):
                yield f"parameter {p.name}: {name} {text!r} {_SENTENCE}"
        try:
            _exponents(p.unit)
        except ValueError as error:
            yield f"parameter {p.name}: {error}"
        if p.null is not None and not np.isfinite(p.prior.logpdf(p.null)):
            yield f"parameter {p.name}: its null {p.null:g} lies outside its prior"
    if not variant.starts:
        yield "needs `starts`, points from which a search begins"
    for start in variant.starts:
        outside = [
            p.name for p, x in zip(variant.parameters, start, strict=True) if not np.isfinite(float(p.prior.logpdf(x)))
        ]
        if outside:
            yield f"start {start} lies outside the prior of {', '.join(outside)}"
    kernels = {hook: getattr(variant, hook) for hook in ("torque", "rate", "start", "sense")}
    for hook, kernel in kernels.items():
        if kernel is not None and not hasattr(kernel, "py_func"):
            yield f"`{hook}` must be decorated with `vector_math.lane`"
    if all(kernel is None for kernel in (*kernels.values(), variant.lag, variant.amend)):
        yield "does nothing: it needs at least one of torque, sense, lag and amend"
    if (variant.rate is not None) != (variant.memory > 0):
        yield "`rate` and `memory` belong together"
    if variant.replaces_friction != (variant.null is None):
        yield "a variant has a parameter with a null unless it replaces the friction, and only then"


def faults(effect: Effect) -> list[str]:
    """What an effect lacks of the duties in base.py, one sentence each; empty if nothing."""
    found = []
    if not effect.name.isidentifier():
        found.append("its name must be letters, digits and underscores")
    if effect.site not in SITES:
        found.append(f"its site {effect.site!r} is none of {', '.join(SITES)}")
    found += [
        f"{name} {text!r} {_SENTENCE}"
        for name in ("summary", "looks_like", "source")
        if not _is_sentence(text := getattr(effect, name))
    ]
    if not effect.variants or len({v.name for v in effect.variants}) != len(effect.variants):
        found.append("it needs variants, each with a name of its own")
    found += [f"variant {v.name}: {fault}" for v in effect.variants for fault in _variant_faults(v)]
    return [f"effect {effect.name}: {fault}" for fault in found]


def _taken(effect: object, where: str, known: Mapping[str, Effect], wrong: list[str]) -> dict[str, Effect]:
    """What a user's file or package offers as an effect, under its name; none where faults are added to `wrong`."""
    if not isinstance(effect, Effect):
        found = ["defines no EFFECT; write EFFECT = Effect(...) as the files of bayes_damper/effects do"]
    elif effect.name in known:
        found = [f"there is an effect {effect.name} already; give this one another name"]
    elif not (found := faults(effect)):
        return {effect.name: replace(effect, variants=tuple(map(_with_a_small_start, effect.variants)))}
    wrong += [f"{where}: {fault}" for fault in found]
    return {}


def _with_a_small_start(variant: Variant) -> Variant:
    """The variant with a start at a tenth of its first one where all starts are of a size.

    A search that begins far from a small effect misses it; the library's own files have such a start (how-to, rule 5).
    """
    i = next((i for i, p in enumerate(variant.parameters) if p.null == 0.0), None)
    if i is None:
        return variant
    sizes = [abs(start[i]) for start in variant.starts]
    if min(sizes) <= 0.2 * max(sizes):
        return variant
    first = variant.starts[0]
    small = (*first[:i], 0.1 * first[i], *first[i + 1 :])
    inside = np.isfinite(float(variant.parameters[i].prior.logpdf(small[i])))
    return replace(variant, starts=(*variant.starts, small)) if inside else variant


def _module(path: Path) -> ModuleType:
    """The module of a file, under a name that does not depend on where it lies."""
    name = f"bayes_damper_effect_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    formerly = {old: sys.modules[new] for old, new in FORMERLY.items() if new in sys.modules}
    sys.modules |= formerly | {name: module}
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    finally:
        for old in formerly:
            del sys.modules[old]
    return module


def effects_sha256(folder: str | Path) -> str:
    """Checksum of a folder with effects of one's own, names and bytes of every file: or of one such file.

    Files are those with effects (.py) in and below the folder, and learnt laws (.toml) in it.
    """
    digest = hashlib.sha256()
    home = Path(folder)
    files = [*home.rglob("*.py"), *(f for f in home.glob("*.toml") if is_law(f))] if home.is_dir() else [home]
    for path in sorted(files):
        digest.update(path.relative_to(home if home.is_dir() else home.parent).as_posix().encode() + b"\0")
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def same_effects(run: Path, begun: str | None, folder: str | Path | None) -> None:
    """Refuses to go on with a run in other company than it began in.

    run : its folder; begun : checksum of the user's own effects that it began with, None for none; folder : those that
    are given now. A folder of results names no code: whoever goes on with a run says where its effects lie.

    Raises
    ------
    InputError
        if effects are missing, too many or changed.
    """
    if begun is None and folder is not None:
        raise InputError(f"--effects {folder}: the run in {run} began without effects of your own; leave it out")
    if begun is None or folder is None:
        if begun is not None:
            raise InputError(
                f"{run}: this run began with effects of a folder of your own, and no code is taken from a folder of "
                f"results; say where they lie: bayes-damper resume {run} --effects DIR"
            )
        return
    now = effects_sha256(folder)
    if now != begun:
        raise InputError(
            f"--effects {folder}: these are not the effects that the run in {run} began with (SHA-256 {begun[:12]}, "
            f"now {now[:12]}); give those, or begin anew with another --out"
        )


def load_effects(folder: str | Path, known: Mapping[str, Effect] = EFFECTS) -> dict[str, Effect]:
    """Effects of a user's own: name -> effect.

    folder : with a .py file per effect (names that begin with an underscore are left out), files of learnt laws
    (.toml), or both; or one such file.

    Raises
    ------
    InputError
        if the folder is not there or holds no effect, a file cannot be imported or defines no EFFECT, an effect lacks
        one of its duties or has a name that is taken; all faults at once.
    """
    path = Path(folder)
    if path.is_dir():
        files = sorted(f for f in path.glob("*.py") if not f.name.startswith("_"))
        files += sorted(f for f in path.glob("*.toml") if is_law(f))
    else:
        files = [path] if path.suffix in (".py", ".toml") and is_file(path) else []
        if not files:
            raise InputError(
                f"{path}: there is no such folder of effects; give one that holds a .py file per effect, or one file: "
                "an effect (.py) or a learnt law (.toml)"
            )
    if not files:
        raise InputError(f"{path}: holds no .py file; write one per effect, each with an EFFECT")
    loaded: dict[str, Effect] = {}
    wrong: list[str] = []
    for file in files:
        try:
            effect = _effect_in(file)
        except InputError as error:
            wrong += error.faults
            continue
        except Exception as error:  # noqa: BLE001 (a user's file may fail in any way)
            wrong.append(f"{file}: cannot be imported ({type(error).__name__}: {error}); run it with python")
            continue
        loaded |= _taken(effect, str(file), {**known, **loaded}, wrong)
    if wrong:
        raise InputError(wrong)
    return loaded


def _effect_in(file: Path) -> Any:
    """What a user's file offers as an effect."""
    return read_law(file).effect() if file.suffix == ".toml" else getattr(_module(file), "EFFECT", None)


def all_effects(folder: str | Path | None = None) -> dict[str, Effect]:
    """The library, then effects of installed packages, then those of `folder`: name -> effect.

    Raises
    ------
    InputError
        as `load_effects`; also if an installed package offers something that is no effect.
    """
    effects = dict(EFFECTS)
    wrong: list[str] = []
    for point in sorted(entry_points(group=ENTRY_POINTS), key=lambda p: p.name):
        where = f"entry point {point.name} = {point.value}"
        try:
            offered = point.load()
        except Exception as error:  # noqa: BLE001 (another package's code may fail in any way)
            wrong.append(f"{where}: cannot be loaded ({type(error).__name__}: {error}); reinstall the package")
            continue
        effects |= _taken(getattr(offered, "EFFECT", offered), where, effects, wrong)
    if wrong:
        raise InputError(wrong)
    return effects if folder is None else effects | load_effects(folder, effects)


def options_of(names: Sequence[str], folder: str) -> str:
    """Options with which `fit` takes these effects; folder : of those that are not of the library, if any.

    None for what only a linear nominal model lacks: the model that is fitted has it.
    """
    own = f" --effects {folder}" if folder and any(name not in EFFECTS for name in names) else ""
    lacked = [name for name in names if name not in EFFECTS or "linear_nominal" not in EFFECTS[name].needs]
    return own + "".join(f" --effect {name}" for name in lacked)


def classes(effects: Mapping[str, Effect] = EFFECTS) -> list[frozenset[str]]:
    """Groups of two effects or more that agree to first order, each once."""
    groups: list[set[str]] = []
    for effect in effects.values():
        if not effect.alike:
            continue
        group = {effect.name, *(name for name in effect.alike if name in effects)}
        joined = [g for g in groups if g & group]
        groups = [g for g in groups if g not in joined] + [group.union(*joined)]
    return sorted((frozenset(g) for g in groups if len(g) > 1), key=sorted)


def _acts_without_dry_friction(variant: Variant) -> bool:
    """Whether the variant does anything on a rig with mu = drag = 0."""
    if variant.torque is None:
        return True
    rig = Rig(1.0, 0.8, 0.0, 9.0, 0.5, 0.1, 0.1, 1.0, 0.1, 0.0, 10.0, 0.1, 0.1, 0.0, 20.0, 0.0, 0.3, 0.5)
    states = ((1e-7, 0.25, 0.1, -0.8, 0.5, 0.3, 0.2), (0.02, -0.2, -0.3, 0.9, 1.2, -0.4, 0.5))
    return any(
        abs(torque) > 0.0
        for start in variant.starts
        for state in states
        for torque in getattr(variant.torque, "py_func", variant.torque)(*state, (*start, 0.0, 0.0, 0.0)[:4], rig)
    )


def candidates(
    rig_has_coupled: bool,
    has_magnet: bool = True,
    nominal: Literal["nonlinear", "linear"] = "nonlinear",
    effects: Mapping[str, Effect] = EFFECTS,
    start: Literal["rest", "free"] = "rest",
    restoring: Literal["linear", "pendulum"] = "linear",
    rubs: bool = True,
) -> dict[str, Effect]:
    """The effects that a rig can have, each with those of its variants that do anything there.

    rig_has_coupled : whether any trial is coupled; has_magnet : whether a magnet with a face is declared; rubs :
    whether the nominal model has dry friction between the bodies (mu is not 0): else it is a candidate;
    nominal : "linear" has mu = drag = 0, so that dry friction becomes a candidate and what scales with it none;
    start : "free" records begin in motion, so nothing is known of a release; restoring : what brings the primary back,
    a spring or, of a "pendulum", its weight, which has neither play nor hysteresis.
    """
    has = {
        "coupled": rig_has_coupled, "magnet": has_magnet, "linear_nominal": nominal == "linear",
        "no_rubbing": nominal == "linear" or not rubs, "spring": restoring == "linear",
    }  # fmt: skip
    offered = {}
    for name, effect in effects.items():
        if not all(has[need] for need in effect.needs) or (start == "free" and effect.site == "release"):
            continue
        variants = tuple(
            v
            for v in effect.variants
            if all(has[need] for need in v.needs)
            and (rig_has_coupled or v.uncoupled)
            and (nominal == "nonlinear" or _acts_without_dry_friction(v))
        )
        if variants:
            offered[name] = effect if len(variants) == len(effect.variants) else replace(effect, variants=variants)
    return offered
