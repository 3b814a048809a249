"""What the sections of several kinds of results show alike: figures, names of parameters, records of proposals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import cast

from bayes_damper.effects import EFFECTS
from bayes_damper.report.parts import Picture, Table, generic, words
from bayes_damper.rig.units import in_words_of, plain_meaning

_HEADS = {
    "k1t n m per rad": "k1t [N m/rad]", "k1 n per m": "k1 [N/m]", "theta0 deg": "theta0 [deg]",
    "theta0 mm": "release [mm]", "expected information nats": "expected information [nats]", "nats": "gain [nats]",
}  # fmt: skip
_PICTURES = {
    "forest": (
        "Parameters over the cases",
        (
            "Median (dot), 50 % interval (bar) and 90 % interval (line) of each case. Hollow and thin: decided by the "
            "prior."
        ),
    ),
    "predictive": (
        "Measurements and the fitted model",
        (
            "Each measurement is at 0, with its standard error in grey; dot and bars: the model's median, 50 and 90 % "
            "intervals."
        ),
    ),
    "records": (
        "Records, band and residuals",
        "Measured records of one trial of each configuration with the model's 90 % band; residuals below.",
    ),
    "corner": (
        "Pairs of parameters",
        (
            "Diagonal: each parameter alone (dashed, for a single case: median and 90 % interval; grey: the prior). "
            "Below: "
            "each pair, with contours around 50 and 90 % of the draws. A slanted contour: the two are correlated."
        ),
    ),
    "trace": (
        "Health of the run",
        "Left: the draws in their order, which should show no trend. Right: their ranks, flat if the ensembles agree.",
    ),
}
_MORE = {
    "gap": (
        "What the model misses",
        (
            "One record and the nominal model; the residuals before and after the answer is added; right: all "
            "probabilities."
        ),
    ),
    "residuals": (
        "Where the residuals are large",
        (
            "Residuals divided by the noise, by trial over time and frequency, and over position and velocity. "
            "1: noise alone."
        ),
    ),
    "ranking": ("Which effect, and where", "Bars: probability of each answer, and of each site of the rig."),
    "published": ("Published numbers", "Each published number and what the leading answers predict for it."),
    "missing_torque": (
        "The missing torque (force)",
        (
            "What the nominal model, with its parameters as fitted, would need beside its laws to follow the records, "
            "against time, position and velocity, with a 90 % band. What a fitted stiffness or damping has taken over "
            "is not in it: of a missing cubic spring, the linear part."
        ),
    ),
    "variability_effective": (
        "Effective stiffness and damping",
        (
            "Effective linear stiffness and damping of each case, and the part explained by friction at different "
            "amplitudes."
        ),
    ),
    "learnt_law": (
        "The learnt law",
        (
            "Each term's curve with its 90 % band (grey: where readings lie), and all terms over position and velocity "
            "(contours of equal force or torque, dashed below 0; hatched: no readings)."
        ),
    ),
    "variability_scatter": ("Scatter over the cases", "Median and 90 % interval of each part of the scatter."),
    "withheld": (
        "True causes and answers",
        (
            "Number of campaigns by true cause (row) and answer (column); the same by site; share of right answers by "
            "probability."
        ),
    ),
    "comparison": ("Parameters compared", "Median and 90 % interval of each parameter in each folder."),
    "tune_response": (
        "Frequency response",
        "Acceleration of the primary per exciting torque, without the secondary and with each design.",
    ),
    "tune_loss": (
        "Insertion loss",
        "Insertion loss against the exciting torque, and over the inertia of the secondary, else as in one design.",
    ),
    "plan": (
        "What could be distinguished",
        "Chance that each effect would be seen, and the evidence in nats that distinguishes it from its rivals.",
    ),
}
_KINDS = ("variability", "tune", "plan", "withheld", "comparison", "bench")
UNCONVERGED = "The run did not converge: do not use these numbers."


def fingerprint(data: Mapping[str, object]) -> dict[str, object]:
    """Where a result comes from, with the data and the seed that it is of, as far as it says so."""
    made = dict(cast("Mapping[str, object]", data.get("provenance", {})))
    return made | {k: data[k] for k in ("campaign", "campaign_sha256", "seed") if k in data}


def meaning_of(name: str, unit: str = "") -> str:
    """A parameter's name, with what it means where the library knows it.

    unit : its own, which shows whether the rig turns or slides.
    """
    meant = plain_meaning(name, unit)
    return f"{name}: {meant}" if meant else name


def titled(effect: str, kind: str = "torsional") -> str:
    """An effect as people call it, in the words of a rig; its name as words where the library does not know it.

    effect : its name, or "A+B" for both.
    """
    known = {name: EFFECTS.get(name) for name in effect.split("+")}
    return " and ".join(in_words_of(e.title, kind) if e and e.title else words(name) for name, e in known.items())


def meaning_in(effect: str, parameter: str) -> str:
    """What a parameter of an effect is, in a few words; "" where the library does not say.

    effect : "A+B" for two, whose parameters are called `A.NAME` and `B.NAME`.
    """
    if "+" in effect:
        effect, _, parameter = parameter.partition(".")
    variants = EFFECTS[effect].variants if effect in EFFECTS else ()
    said = next((p.meaning for v in variants for p in v.parameters if p.name == parameter and p.meaning), "")
    return said[:1].lower() + said[1:].rstrip(".")


def pictures_of(folder: Path, group: str = "", *, kind: str = "") -> tuple[Picture, ...]:
    """Figures that lie in a folder, known ones first; one entry for SVG and PNG of a name.

    Where several results share a folder, figures go by their names: to the `kind` that they begin with, else to the fit
    if it draws such figures, else to whichever of fit and diagnosis comes first on the page.
    """
    stems = sorted({p.stem for s in (".svg", ".png") for p in folder.glob(f"*{s}")})
    if kind not in ("", "diagnosis"):
        stems = [s for s in stems if s.startswith(kind)]
    else:
        stems = [s for s in stems if not s.startswith(_KINDS) and not (kind == "diagnosis" and s in _PICTURES)]
    order = list(_PICTURES)
    stems.sort(key=lambda s: (order.index(s) if s in order else len(order), s))
    out = []
    for stem in stems:
        title, alt = (_PICTURES | _MORE).get(stem, (words(stem).capitalize(), f"Figure: {words(stem)}."))
        note = alt if stem in _PICTURES or stem in _MORE else ""
        out.append(
            Picture(title, f"{group + ': ' if group else ''}{alt}", str(folder / stem), note, first=stem == "gap")
        )
    return tuple(out)


def records_table(caption: str, records: Sequence[Mapping[str, object]]) -> Table:
    """A row for each record, a column for each of their keys, with its unit."""
    table = generic({caption: list(records)}, "").tables[0]
    return replace(table, columns=tuple(_HEADS.get(c, c) for c in table.columns))
