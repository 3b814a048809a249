"""Tables 1-12: every printed number beside the computed one, with a verdict that knows about rounding."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from bayes_damper.rig import linear
from bayes_damper.rig.linear import LinearRig
from bayes_damper.thesis.printed import (
    BAR_RADIUS,
    CASE_IV_DAMPING,
    CASES,
    INERTIA,
    INERTIA_ROWS,
    MAGNET_PULL,
    SECONDARY_FREQUENCY,
    T_MIN,
    half_unit,
    printed_case,
    spread,
    table_12,
)
from bayes_damper.thesis.rig import (
    J1,
    delay_of_peak,
    effective_coupling,
    linear_features,
    linear_rig,
    pairs_against_energy,
    secondary_inertia,
)

Array = NDArray[np.float64]

AGREES, ROUNDING, CONTRADICTION, OPEN = "agrees", "rounding", "contradiction", "not determined by what is printed"


def judge(printed: str, computed: Array) -> str:
    """Verdict on a printed number; `computed` holds the value first, then those that rounded inputs allow."""
    value, half = float(printed), half_unit(printed) * (1.0 + 1e-9)
    if not np.isfinite(computed[0]):
        return CONTRADICTION
    if abs(computed[0] - value) <= half:
        return AGREES
    inside = np.nanmin(computed) - half <= value <= np.nanmax(computed) + half
    return ROUNDING if inside else CONTRADICTION


class Rows:
    """Collects the rows of the table."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []

    def add(
        self,
        where: str,
        page: int,
        quantity: str,
        unit: str,
        printed: str,
        formula: Callable[..., ArrayLike],
        inputs: Sequence[str | float],
        explanation: str,
        verdict: str | None = None,
    ) -> float:
        """Judges one printed number; a `verdict` given takes the place of "contradiction" only. Returns the value."""
        values = np.atleast_1d(np.asarray(formula(*spread(inputs)), dtype=np.float64))
        found = judge(printed, values)
        if found == CONTRADICTION and verdict is not None:
            found = verdict
        finite = values[np.isfinite(values)]
        low, high = (finite.min(), finite.max()) if finite.size else (np.nan, np.nan)
        self._put(where, page, quantity, unit, printed, values[0], low, high, found, explanation)
        return float(values[0])

    def say(self, where: str, page: int, quantity: str, printed: str, verdict: str, explanation: str) -> None:
        """A statement in words, or a number that nothing printed determines."""
        self._put(where, page, quantity, "", printed, np.nan, np.nan, np.nan, verdict, explanation)

    def _put(
        self,
        where: str,
        page: int,
        quantity: str,
        unit: str,
        printed: str,
        computed: float,
        low: float,
        high: float,
        verdict: str,
        explanation: str,
    ) -> None:
        try:
            difference = computed - float(printed)
        except ValueError:
            difference = np.nan
        self.rows.append(
            {
                "where": where, "page": page, "quantity": quantity, "unit": unit, "printed": printed,
                "computed": computed, "low": low, "high": high, "difference": difference, "verdict": verdict,
                "explanation": explanation,
            }
        )  # fmt: skip


def _design(rows: Rows) -> None:
    """Tables 1 and 2, pp. 9-11."""
    parts = [*INERTIA_ROWS.values()]
    rows.add(
        *("Table 1", 9, "J1, sum of its rows", "kg mm^2", INERTIA, lambda *x: sum(x), parts),
        "The rows add up to 92 less than the total: exactly a second shaft collar (p. 8 speaks of collars).",
    )
    for case in CASES:
        p = printed_case(case)
        rows.add(
            *("Table 2", 11, f"{case}: initial potential energy", "mJ", p.energy),
            lambda k, th: 1e3 * linear.potential_energy(k, np.deg2rad(th)),
            (p.k1t, p.theta0),
            "Eq. 9 from the rounded stiffness and angle.",
        )
    for k1t, printed in (("6.2", "7.2"), ("10.2", "9.3")):
        rows.add(
            *("text", 10, f"designed natural frequency at k1t = {k1t}", "Hz", printed),
            lambda k, j: linear.natural_frequency(k, 1e-6 * j),
            (k1t, INERTIA),
            "Eq. 6.",
        )
    lo, hi = float(printed_case("I").energy), float(printed_case("IV").energy)
    rows.say(
        *("text", 11, "initial energies of cases I and IV", "approximately the same", AGREES),
        f"They differ by {100 * (hi / lo - 1):.0f} %; the other two cases by factors of 1.6 and 0.37 from I.",
    )


def _uncoupled(rows: Rows) -> None:
    """Tables 3, 4 and 5, pp. 13-16."""
    for case in CASES:
        _uncoupled_case(rows, case)
    differences = [printed_case(c).acceleration_difference for c in CASES]
    rows.add(
        *("text", 16, "low-stiffness cases deviate more, on average, by", "%", "11"),
        lambda a, b, c, d: (a + b - c - d) / 2,
        differences,
        "Means of the differences of Table 5.",
    )
    pairs = pairs_against_energy([float(printed_case(c).ratio[0]) for c in CASES])
    rows.say(
        *("text", 13, "damping ratio against energy", "falls", CONTRADICTION),
        f"It falls in {pairs} of the 6 pairs of cases, rises in {6 - pairs}: case I damps more than III, II more than "
        "IV.",
    )


def _uncoupled_case(rows: Rows, case: str) -> None:
    """One case's row of Tables 3, 4 and 5."""
    p = printed_case(case)
    rows.add(
        *("Table 3", 13, f"{case}: damping ratio", "1", p.ratio_table_3[0]),
        linear.damping_ratio_of_decrement,
        (p.decrement[0],),
        "Eq. 11 from the decrement of Table 6.",
    )
    rows.add(
        *("Table 4", 14, f"{case}: designed natural frequency", "Hz", p.designed),
        lambda k, j: linear.natural_frequency(k, 1e-6 * j),
        (p.k1t, INERTIA),
        f"Eq. 6; the printed value belongs to k1t = {linear.stiffness_for(float(p.designed), J1):.3f} N m/rad.",
    )
    rows.add(
        *("Table 4", 14, f"{case}: measured natural frequency", "Hz", p.measured_frequency[0]),
        lambda t, z: linear.natural_frequency_of_period(1e-3 * t, z),
        (p.period[0], p.ratio[0]),
        "The damped period of Table 7 corrected by the damping ratio of Table 6: the same measurement twice.",
    )
    rows.add(
        *("Table 4", 14, f"{case}: its standard error", "Hz", p.measured_frequency[1]),
        lambda t, e, z: e * 1e3 / t**2 / np.sqrt(1 - z**2),
        (p.period[0], p.period[1], p.ratio[0]),
        "From the error of the period alone; that of the damping ratio is left out (see the contradictions).",
    )
    rows.add(
        *("Table 4", 14, f"{case}: difference", "%", p.frequency_difference),
        lambda a, b: linear.percent_difference(a, b, "predicted"),
        (p.designed, p.measured_frequency[0]),
        "Relative to the prediction. Eq. 14 divides by the measurement, which would give "
        f"{linear.percent_difference(float(p.designed), float(p.measured_frequency[0])):.2f} %.",
    )
    rows.add(
        *("Table 5", 16, f"{case}: undamped bound", "rad/s^2", p.bound),
        lambda k, th, j: linear.acceleration_bound(k, np.deg2rad(th), 1e-6 * j),
        (p.k1t, p.theta0, INERTIA),
        "Eq. 16 (the table cites eq. 14); the printed value belongs to k1t = "
        f"{float(p.bound) * J1 / np.deg2rad(float(p.theta0)):.3f} N m/rad at the printed angle.",
    )
    rows.add(
        *("Table 5", 16, f"{case}: measured acceleration", "rad/s^2", p.acceleration_table_5, lambda x: x),
        (float(p.acceleration[0]),),
        "The same measurement as in Table 8 (p. 18).",
    )
    rows.add(
        *("Table 5", 16, f"{case}: difference", "%", p.acceleration_difference),
        lambda a, b: linear.percent_difference(a, b, "predicted"),
        (p.bound, p.acceleration_table_5),
        "Relative to the prediction; by eq. 14 it would be "
        f"{linear.percent_difference(float(p.bound), float(p.acceleration_table_5)):.1f} %.",
    )


def _coupled(rows: Rows) -> None:
    """Tables 6, 7 and 8, pp. 17-18: relations between measured numbers."""
    for case in CASES:
        p = printed_case(case)
        for name, decrement, ratio in (
            ("uncoupled", p.decrement, p.ratio),
            ("coupled", p.coupled_decrement, p.coupled_ratio),
        ):
            rows.add(
                *("Table 6", 17, f"{case} {name}: damping ratio", "1", ratio[0]),
                linear.damping_ratio_of_decrement,
                (decrement[0],),
                "Eq. 11.",
            )
            rows.add(
                *("Table 6", 17, f"{case} {name}: standard error of the ratio", "1", ratio[1]),
                lambda d, e: e * 4 * np.pi**2 / np.hypot(d, 2 * np.pi) ** 3,
                decrement,
                "Error of the decrement carried to first order through eq. 11; the thesis took it over three trials, "
                "which"
                " differs where the error is as large as the value.",
                OPEN,
            )
        change = float(p.coupled_period[0]) - float(p.period[0])
        falls = case in ("I", "II")
        rows.say(
            *("Table 7", 18, f"{case}: change of the period by coupling", "falls" if falls else "rises"),
            AGREES if (change < 0) == falls else CONTRADICTION,
            f"By {change:+.1f} ms; the linear model with Table 9 makes it "
            f"{1e3 * float(linear_features(linear_rig(case), np.deg2rad(float(p.theta0))).period[0]):.0f} ms, so "
            "longer in"
            " every case.",
        )
        rows.say(
            *("Table 8", 18, f"{case}: change of the highest acceleration by coupling", "falls", AGREES),
            f"By {float(p.acceleration[0]) - float(p.coupled_acceleration[0]):.1f} rad/s^2, which no model without dry"
            " friction gives at release.",
        )
        rows.say(
            *("Tables 7, 8", 18, f"{case}: medians and standard errors", "as printed", OPEN),
            "The records were never published: the medians cannot be recomputed.",
        )


def _linear_model(rows: Rows) -> None:
    """Tables 9 and 10, pp. 20-21."""
    energy_order = sorted(CASES, key=lambda c: float(printed_case(c).energy))
    for name in ("k2t", "c2t"):
        values = [float(getattr(printed_case(c), name)) for c in energy_order]
        rows.say(
            *(
                "Table 9",
                20,
                f"{name} against energy",
                "falls",
                AGREES if values == sorted(values)[::-1] else CONTRADICTION,
            ),
            f"In order of energy ({', '.join(energy_order)}): {', '.join(f'{v:g}' for v in values)}.",
        )
    for case in CASES:
        p = printed_case(case)
        k2t, c2t, misfit = effective_coupling(case)
        rows.say(
            *("Table 9", 20, f"{case}: fitted k2t, c2t", f"{p.k2t}, {p.c2t}", OPEN),
            "Fitted to records that were not published. Decrement and period of Tables 6 and 7 alone would be met "
            "best by "
            f"k2t = {k2t:.2g} N m/rad, c2t = {c2t:.2g} N m s/rad ({misfit:.1f} standard errors off).",
        )

        inputs = (p.k1t, float(p.theta0), p.k2t, p.c2t, SECONDARY_FREQUENCY)
        later = delay_of_peak(case)
        rows.add(
            *("Table 10", 21, f"{case}: highest acceleration of the linear model", "rad/s^2", p.model_acceleration),
            _feature_of_record("max_acceleration"),
            inputs,
            f"{1e3 * T_MIN:g} ms after release. The printed value is the acceleration {1e3 * later:.2f} ms after "
            "release at "
            f"the printed bound of Table 5 ({p.bound}).",
        )
        own = float(linear_features(linear_rig(case, None), np.deg2rad(float(p.theta0))).log_decrement[0])
        rows.add(
            *("Table 10", 21, f"{case}: decrement of the linear model", "1", p.model_decrement),
            _feature_of_record("log_decrement"),
            inputs,
            f"With c1t = c3t = {CASE_IV_DAMPING} of case IV in every case; with the case's own damping ratio it is "
            f"{own:.2f}.",
        )
        rows.add(
            *("Table 10", 21, f"{case}: measured decrement", "1", p.decrement_table_10, lambda x: x),
            (p.coupled_decrement[0],),
            "Table 6, rounded.",
        )
    pairs = pairs_against_energy([-float(printed_case(c).coupled_acceleration[0]) for c in CASES])
    rows.say(
        *("text", 21, "highest acceleration against energy", "rises", CONTRADICTION),
        f"It rises in {pairs} of the 6 pairs of cases: case IV, 34.3 mJ, has 218.7 rad/s^2 and case II, 49.2 mJ, has "
        "177.3. "
        "It goes with k1t theta0 (eq. 16), not with the energy.",
    )


def _nonlinear_model(rows: Rows) -> None:
    """Section 3.4 and Table 11, pp. 23-26."""
    for name, what in (
        ("R", "radius of the aluminium rod"),
        ("r", "radius of the magnet face"),
        ("nu", "smoothing constant"),
    ):
        rows.say("Table 11", 24, f"{name}, {what}", "no value", OPEN, "Named, but printed nowhere.")
    rows.say(
        "Table 11", 24, "d, bearing drag", "no value", OPEN, "Said to come from static and dynamic tests; not printed."
    )
    for law, mu in (("constant", "0.005"), ("linear", "0.009")):
        torque = float(mu) * MAGNET_PULL * BAR_RADIUS
        rows.say(
            *("Fig. 10", 26, f"mu with {law} normal force", mu, OPEN),
            f"Fitted to an unpublished record. Only mu N0 R enters: {torque:.3f} N m at the working R = {BAR_RADIUS} "
            "m, "
            f"{torque / J1:.1f} rad/s^2 at the primary.",
        )


def _frequency_response(rows: Rows) -> None:
    """Sections 3.5 and 3.6, Figure 11 and Table 12, pp. 27-31; case IV."""
    p = printed_case("IV")
    rows.add(
        *(
            "text",
            27,
            "natural frequency of the primary",
            "Hz",
            "9.3",
            lambda k, j: linear.natural_frequency(k, 1e-6 * j),
        ),
        (p.k1t, INERTIA),
        "Eq. 6.",
    )
    rows.add(
        *("text", 27, "factor by which the secondary's frequency must rise", "1", "2.8", lambda a, b: a / b),
        ("9.3", SECONDARY_FREQUENCY),
        "9.3 / 3.2.",
    )
    rows.add(
        *("text", 28, "factor by which J2 must fall", "1", "8", lambda a, b: (a / b) ** 2),
        ("9.3", SECONDARY_FREQUENCY),
        "Square of that factor: 8.4 from 9.3 Hz; 8 from the measured 9.05 Hz, or from 2.8.",
    )
    rows.add(
        *("text", 30, "damping ratio of the secondary, above", "1", "0.5"),
        lambda k2, c2, z, k, j, f: (
            (c2 + linear.damping_coefficient(z, k, 1e-6 * j)) / (2 * np.sqrt(k2 * secondary_inertia(f, k2)))
        ),
        (float(p.k2t), float(p.c2t), p.ratio[0], p.k1t, INERTIA, SECONDARY_FREQUENCY),
        "(c2t + c3t) / (2 sqrt(k2t J2)): indeed above 0.5.",
        AGREES,
    )
    variants: dict[str, dict[str, float]] = {
        "with effective stiffness": {},
        "no effective stiffness": {"k2t": 0.0},
        "undamped coupling": {"c2t": 0.0},
        "uncoupled": {"k2t": 0.0, "c2t": 0.0},
    }
    inputs = (p.k1t, p.ratio[0], INERTIA, SECONDARY_FREQUENCY)
    for name, change in variants.items():
        for i, printed in enumerate(table_12()[name]):
            for j, (quantity, unit) in enumerate((("resonance", "Hz"), ("peak accelerance", "1/(kg m^2)"))):
                rows.add(
                    *("Table 12", 31, f"{name}: {quantity} {i + 1}", unit, printed[j]),
                    _resonance_of_rig(change, i, j),
                    inputs,
                    "Eq. 23 with k2t = 1, c2t = 0.08 where not zero, c1t = c3t of zeta = 0.031, J2 from 3.2 Hz.",
                )
    for name, divisor, loss, frequency in (("untuned", 1.0, "1", "9.0"), ("tuned by J2/8", 8.0, "5", "8.6")):
        rows.add(
            *("Fig. 11", 29, f"{name}: insertion loss", "dB", loss),
            lambda *x, d=divisor: linear.insertion_loss(_rig_iv(x, d)),
            inputs,
            "Eq. 24, highest peak without over highest peak with the secondary.",
        )
        rows.add(
            *("Fig. 11", 29, f"{name}: resonance", "Hz", frequency),
            lambda *x, d=divisor: linear.resonances(_rig_iv(x, d)).peak_frequency_hz,
            inputs,
            "Eq. 23.",
        )
    rows.add(
        *("Fig. 11", 29, "untuned: insertion loss within Table 12", "dB", "1", lambda a, b: 20 * np.log10(a / b)),
        (table_12()["uncoupled"][0][1], table_12()["with effective stiffness"][0][1]),
        "772.1 / 680.7: the figure and the table have the same source.",
    )
    _figures(rows)


def _figures(rows: Rows) -> None:
    """Figures whose scale, caption or label contradicts the text."""
    peak = linear.transmissibility(np.linspace(0.6, 2.0, 2801), 0.07).max()
    rows.say(
        *("Fig. 2", 2, "scale of the ordinate", "1e-4 to 1e-1", CONTRADICTION),
        f"The transmissibility (eq. 1) at zeta = 0.07 lies between 0.3 and {peak:.1f} over the figure's abscissa; the"
        f" receptance of Table 2's springs would peak at {1 / (0.14 * 10.2):.1f} to {1 / (0.14 * 6.2):.1f} rad/(N m).",
    )
    rows.say(
        *("Fig. 13", 32, "caption", "frequency response", CONTRADICTION),
        "The figure shows free transient responses in time, as the text (p. 31) says.",
    )
    rows.say(
        *("Figs. 6, 8, 10", 17, "label of the record", "17.5 deg", CONTRADICTION),
        "No release angle of Table 2 is 17.5 deg; with high stiffness it would start at "
        f"{linear.acceleration_bound(10.2, np.deg2rad(17.5), J1):.0f} rad/s^2, beyond the figures' 300. By its k2t "
        "and c2t it"
        " is case IV, 4.7 deg: the label must count from another zero.",
    )


def _rig_iv(
    inputs: Sequence[Array], divisor: float = 1.0, k2t: float | None = None, c2t: float | None = None
) -> LinearRig:
    """Case IV from k1t, zeta, J1 (kg mm^2) and the frequency that fixes J2; J2 is divided by `divisor`."""
    k1t, zeta, j1, fn2 = inputs
    p = printed_case("IV")
    c = linear.damping_coefficient(zeta, k1t, 1e-6 * j1)
    j2 = secondary_inertia(fn2) / divisor
    return LinearRig(
        1e-6 * j1, j2, k1t, c, float(p.k2t) if k2t is None else k2t, float(p.c2t) if c2t is None else c2t, c
    )


def _resonance_of_rig(change: Mapping[str, float], i: int, j: int) -> Callable[..., Array]:
    """Frequency (j = 0) or height (j = 1) of the i-th resonance of case IV, as a function of `_rig_iv`'s inputs."""

    def value(*inputs: Array) -> Array:
        found = linear.resonances(_rig_iv(inputs, **change))
        return (found.frequency_hz, found.accelerance)[j][:, i]

    return value


def _feature_of_record(name: str) -> Callable[..., Array]:
    """A feature of the linear model's record as a function of k1t, theta0 (deg), k2t, c2t and the frequency of J2."""

    def value(k1t: Array, theta0: Array, k2t: Array, c2t: Array, fn2: Array) -> Array:
        rig = LinearRig(J1, secondary_inertia(fn2), k1t, CASE_IV_DAMPING, k2t, c2t, CASE_IV_DAMPING)
        return np.asarray(getattr(linear_features(rig, np.deg2rad(theta0)), name), dtype=np.float64)

    return value


def table() -> pd.DataFrame:
    """Every printed number beside the computed one; columns as `Recomputation.table` has them."""
    rows = Rows()
    for section in (_design, _uncoupled, _coupled, _linear_model, _nonlinear_model, _frequency_response):
        section(rows)
    return pd.DataFrame(rows.rows)
