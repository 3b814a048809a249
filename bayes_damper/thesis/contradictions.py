"""Where the thesis contradicts itself or leaves a gap, with the evidence and what the printed number would need.

Nothing is tuned to make numbers meet; plausibility is judged by the thesis's own measurements.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from bayes_damper.published.features import features
from bayes_damper.rig import linear
from bayes_damper.simulation.model import Model
from bayes_damper.thesis.printed import (
    BAR_RADIUS,
    CASE_IV_DAMPING,
    CASES,
    INERTIA,
    INERTIA_ROWS,
    LAWS,
    MAGNET_PULL,
    T_MIN,
    printed_case,
    spread,
)
from bayes_damper.thesis.rig import (
    EARLY_TIMES,
    J1,
    delay_of_peak,
    effective_coupling,
    linear_features,
    linear_rig,
    nonlinear_rig,
    pairs_against_energy,
    secondary_inertia,
    solve_for,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Needed:
    """The value of one parameter that a printed number would need, and what the thesis's own data say to it."""

    parameter: str
    unit: str
    value: float | None  # None: no value does it
    printed: str
    plausibility: str


@dataclass(frozen=True)
class Contradiction:
    """One place where the thesis contradicts itself or leaves a gap."""

    name: str
    pages: tuple[int, ...]
    statement: str
    evidence: str
    needed: tuple[Needed, ...] = ()


def _inertias() -> list[Contradiction]:
    total = sum(float(x) for x in INERTIA_ROWS.values())
    shaft, collar, bar = (1e-6 * float(INERTIA_ROWS[k]) for k in ("shaft", "collar", "bar"))

    def peak(j2: float) -> float:
        return float(linear.resonances(linear_rig("IV", J2=j2)).peak[0])

    needed = solve_for(peak, 680.7, 1e-3, 5e-3)
    one, two = shaft + collar + bar, shaft + 2 * collar + bar
    lines = ", ".join(
        f"{1e6 * j:.0f} kg mm^2 gives {np.sqrt(1 / j) / (2 * np.pi):.2f} Hz and {peak(j):.1f}" for j in (one, two)
    )
    return [
        Contradiction(
            "total inertia",
            (8, 9),
            "The rows of Table 1 do not add up to its total J1 = 3015 kg mm^2.",
            f"They add up to {total:.0f}, which is {float(INERTIA) - total:.0f} less.",
            (
                Needed(
                    *("number of shaft collars", "1", 2.0, INERTIA),
                    "Plausible: a second collar of 92 kg mm^2 closes the sum exactly, and p. 8 speaks of collars.",
                ),
            ),
        ),
        Contradiction(
            "secondary inertia",
            (9, 27, 31),
            "J2 is printed nowhere; 3.2 Hz at k2t = 1 N m/rad (p. 27) fixes it within 3 %.",
            f"3.2 Hz is J2 = {1e6 * secondary_inertia():.0f} kg mm^2 (2398 to 2553 by rounding). Shaft, one or two "
            "collars and bar "
            f"of Table 1 fall inside: {lines} 1/(kg m^2) in Table 12's first row (printed 680.7).",
            (
                Needed(
                    *("J2", "kg m^2", needed, "680.7"),
                    f"Plausible: within 3.2 Hz's rounding, {1e6 * ((needed or np.nan) - one):+.0f} kg mm^2 from "
                    "shaft, one collar and bar.",
                ),
            ),
        ),
    ]


def _table_12() -> list[Contradiction]:
    return [_uncoupled_accelerance(), _undamped_coupling(), _coupling_without_stiffness(), _insertion_loss()]


def _uncoupled_accelerance() -> Contradiction:
    p = printed_case("IV")
    k1t, z = float(p.k1t), float(p.ratio[0])
    frequency, peak = linear.uncoupled_resonance(J1, k1t, CASE_IV_DAMPING)
    c_high = solve_for(lambda c: float(linear.uncoupled_resonance(J1, k1t, c)[1]), 772.1, 1e-3, 0.12)
    assert c_high is not None
    f_high = float(linear.uncoupled_resonance(J1, k1t, c_high)[0])
    decrement = float(linear.decrement_of_damping_ratio(linear.damping_ratio(c_high, k1t, J1)))
    untuned = linear.resonances(linear_rig("IV"))
    return Contradiction(
        "uncoupled accelerance",
        (17, 29, 31),
        "Table 12 and Figure 11: the uncoupled rig peaks at 9.2 Hz with 772.1 1/(kg m^2).",
        f"Eq. 23 with zeta = {z} (Table 6) gives {float(frequency):.2f} Hz and {float(peak):.0f}; only the first "
        "row, "
        f"{untuned.peak_frequency_hz[0]:.2f} Hz and {untuned.peak[0]:.1f}, follows from the "
        "parameters.",
        (
            Needed(
                *("c1t", "N m s/rad", c_high, "772.1"),
                f"Implausible: {c_high / CASE_IV_DAMPING:.0f} times the measured damping, a decrement of "
                f"{decrement:.2f} "
                f"(measured 0.20 +- 0.01), and the peak would lie at {f_high:.1f} Hz, not 9.2.",
            ),
        ),
    )


def _undamped_coupling() -> Contradiction:
    def two_heights(x: Array) -> Array:
        c1, c3 = np.exp(x)
        heights = linear.resonances(linear_rig("IV", c1t=c1, c3t=c3, c2t=0.0)).accelerance[0]
        return np.array(np.nan_to_num(np.log(heights / [900.1, 7069.2]), nan=10.0))

    fit = least_squares(two_heights, np.log([8.7e-3, 3e-4]))
    c1_none, c3_none = np.exp(fit.x)
    without = linear.resonances(linear_rig("IV", c2t=0.0))
    undamped = linear.resonances(linear_rig("IV", c1t=c1_none, c3t=c3_none, c2t=0.0)).frequency_hz[0]
    return Contradiction(
        "undamped coupling",
        (19, 31),
        "Table 12: with c2t = 0 the resonances are 3.1 and 9.8 Hz with 900.1 and 7069.2 1/(kg m^2).",
        "With c3t = c1t = 0.0109 (p. 19) they are "
        + " and ".join(
            f"{f:.2f} Hz with {a:.0f}" for f, a in zip(without.frequency_hz[0], without.accelerance[0], strict=True)
        )
        + ".",
        (
            Needed(
                *("c3t", "N m s/rad", float(c3_none), "900.1"),
                f"With c1t = {c1_none:.4f} both heights come out, at {undamped[0]:.2f} and {undamped[1]:.2f} Hz: "
                "c3t seems to "
                "have been dropped, against p. 19, and c1t is a fifth below that of zeta = 0.031.",
            ),
        ),
    )


def _coupling_without_stiffness() -> Contradiction:
    stiffless = linear.resonances(linear_rig("IV", k2t=0.0))
    c2_none = solve_for(lambda c: float(linear.resonances(linear_rig("IV", k2t=0.0, c2t=c)).peak[0]), 873.9, 0.02, 0.08)
    f_none = (
        linear.resonances(linear_rig("IV", k2t=0.0, c2t=c2_none or np.nan)).peak_frequency_hz[0] if c2_none else np.nan
    )
    shifted = "it also moves the resonance to" if c2_none else "no value does it;"
    return Contradiction(
        "coupling without stiffness",
        (30, 31),
        "Table 12: with k2t = 0 the resonance stays at 9.0 Hz and rises to 873.9 1/(kg m^2).",
        f"Eq. 23 gives {stiffless.peak_frequency_hz[0]:.2f} Hz and {stiffless.peak[0]:.0f}.",
        (
            Needed(
                *("c2t", "N m s/rad", c2_none, "873.9"),
                f"Implausible: the table's other rows have 0.08, and {shifted} {f_none:.2f} Hz.",
            ),
        ),
    )


def _insertion_loss() -> Contradiction:
    loss = float(linear.insertion_loss(linear_rig("IV"))[0])
    tuned = linear_rig("IV", J2=secondary_inertia() / 8)
    loss_tuned = float(linear.insertion_loss(tuned)[0])
    return Contradiction(
        "insertion loss",
        (29, 34),
        "Figure 11, abstract and summary: 1 dB untuned, 5 dB with J2/8; the resonance falls from 9.0 to 8.6 Hz.",
        f"Eq. 24 gives {loss:.1f} dB untuned and {loss_tuned:.1f} dB with J2/8, at "
        f"{linear.resonances(tuned).peak_frequency_hz[0]:.2f} Hz: matching the frequencies makes this damper "
        "worse, because its "
        "c2t is several times what an inertia of J2/8 wants. The printed losses rest on the uncoupled 772.1.",
        (
            Needed(
                *("uncoupled peak", "1/(kg m^2)", 772.1, "1"),
                "Implausible, see uncoupled accelerance. Against it the tuned curve's peak of "
                f"{linear.resonances(tuned).peak[0]:.0f} would be a loss of "
                f"{20 * np.log10(772.1 / linear.resonances(tuned).peak[0]):.1f} dB.",
            ),
            Needed(
                *("tuned peak", "1/(kg m^2)", 772.1 / 10 ** (5 / 20), "5"),
                "Implausible: far below the tuned curve of eq. 23, and below the untuned one.",
            ),
        ),
    )


def _stiffness() -> list[Contradiction]:
    return [
        _low_stiffness(),
        _natural_frequencies(),
        Contradiction(
            "differences in percent",
            (14, 16),
            "Eq. 14 divides by the measurement; Tables 4 and 5 divide by the prediction.",
            "Case I: (7.19 - 6.76)/7.19 = 5.98 % as printed, by eq. 14 it is 6.36 %. Table 5 cites eq. 14 for eq. 16, "
            "and prints "
            "164.2 where Table 8 prints 164.1.",
        ),
        Contradiction(
            "frequency and damping are printed twice",
            (13, 14, 17, 18),
            "Tables 4 and 7, and both halves of Table 6, show one measurement in two forms.",
            "Table 4 is Table 7 corrected by the damping ratio, and the damping ratio is eq. 11 of the decrement, in "
            "every row of "
            "the recomputation: a likelihood may use each once.",
        ),
        _uncoupled_peaks(),
        _frequency_errors(),
    ]  # fmt: skip


def _low_stiffness() -> Contradiction:
    stiffness, angle, spans = [], [], []
    for case in ("I", "II"):
        energy, bound, j1 = spread((printed_case(case).energy, printed_case(case).bound, INERTIA))
        torque = 1e-6 * bound * j1
        k, th = torque**2 / (2e-3 * energy), np.rad2deg(2e-3 * energy / torque)
        stiffness.append(k[0])
        angle.append(th[0])
        spans.append(f"{k.min():.2f} to {k.max():.2f}")
    f, j1 = spread(("7.19", INERTIA))
    k = linear.stiffness_for(f, 1e-6 * j1)
    designed = float(k[0])
    spans.append(f"{k.min():.2f} to {k.max():.2f}")
    return Contradiction(
        "low stiffness",
        (11, 14, 16),
        "k1t = 6.2 N m/rad of cases I and II is used with three different values.",
        f"7.19 Hz belongs to {designed:.3f}. Energy and bound together, which fix angle and stiffness, belong to "
        f"{stiffness[0]:.3f} at {angle[0]:.2f} deg in case I and {stiffness[1]:.3f} at {angle[1]:.2f} deg in case "
        "II; the latter "
        f"angle would have been printed as 7.3. By rounding they span {spans[2]} (7.19 Hz), {spans[0]} (I) and "
        f"{spans[1]} (II).",
        (
            Needed("k1t", "N m/rad", designed, "7.19", "Plausible: rounds to 6.2."),
            Needed("k1t", "N m/rad", stiffness[0], "203.6 and 30.4", "Plausible: rounds to 6.2, but gives 7.22 "
                "Hz."),
            Needed("k1t", "N m/rad", stiffness[1], "257.1 and 49.2", "Implausible: would have been printed as "
                "6.1."),
        ),
    )  # fmt: skip


def _natural_frequencies() -> Contradiction:
    designs = [float(linear.natural_frequency(float(printed_case(c).k1t), J1)) for c in CASES]
    measured = [float(printed_case(c).measured_frequency[0]) for c in CASES]
    lower = [100 * (1 - (m / d) ** 2) for m, d in zip(measured, designs, strict=True)]
    short = [100 * (1 - float(printed_case(c).acceleration[0]) / float(printed_case(c).bound)) for c in CASES]
    remaining = [100 * (1 - (1 - a / 100) / (1 - x / 100)) for a, x in zip(short, lower, strict=True)]
    return Contradiction(
        "natural frequencies",
        (14, 16),
        "All measured natural frequencies lie below the design, and all uncoupled peaks below the bound.",
        "k1t/J1 would be " + ", ".join(f"{x:.0f}" for x in lower) + " % lower in cases I-IV; the peaks are "
        + ", ".join(f"{x:.0f}" for x in short) + " % low and would then be "
         + ", ".join(f"{x:.1f}" for x in remaining) + " %.",
        tuple(
            Needed(
                *("J1", "kg m^2", J1 / (1 - lower[i] / 100), printed_case(CASES[i]).measured_frequency[0]),
                "No single J1 does it for both stiffnesses: k1t must be uncertain too.",
            )
            for i in (1, 3)
        ),
    )  # fmt: skip


def _uncoupled_peaks() -> Contradiction:
    needed = []
    for case in CASES:
        p = printed_case(case)
        bound, decrement = float(p.bound), float(p.decrement[0])
        drag = (bound - float(p.acceleration[0])) * J1
        torque = bound * J1
        would = float(linear.log_decrement(torque - drag, torque - 3.0 * drag))
        off = (would - decrement) / float(p.decrement[1])
        fits = "Plausible" if abs(off) < 2.0 else "Implausible"
        needed.append(
            Needed(
                *(f"drag, case {case}", "N m", drag, p.acceleration[0]),
                f"{fits}: drag alone would make a decrement of {would:.2f}, measured {p.decrement[0]} +- "
                f"{p.decrement[1]} "
                f"({off:+.1f} standard errors).",
            )
        )
    values = ", ".join(f"{1e3 * n.value:.0f}" for n in needed if n.value is not None)
    return Contradiction(
        "uncoupled peaks",
        (16, 17, 23),
        "The uncoupled peaks lie below the bound of eq. 16, which viscous damping cannot do in a millisecond.",
        f"A bearing drag d would lower the first acceleration by d/J1: cases I-IV need {values} mN m, of one pair of "
        "bearings. "
        "It would also set the decrement, ln((k th0 - d)/(k th0 - 3 d)), which the larger values miss. Lower k1t/J1, "
        "as the "
        "frequencies ask for, explains half of the shortfall; the rest is left open.",
        tuple(needed),
    )


def _frequency_errors() -> Contradiction:
    lines = []
    for case in ("I", "III"):
        p = printed_case(case)
        z, e = (float(x) for x in p.ratio)
        period = 1e-3 * float(p.period[0])
        f = 1 / period * z * e / (1 - z**2) ** 1.5
        t = 1e3 * period * z * e / np.sqrt(1 - z**2)
        lines.append(f"case {case} {f:.3f} Hz (printed 0.01) and {t:.2f} ms (printed {p.period[1]})")
    return Contradiction(
        "errors of frequency and period",
        (14, 17, 18),
        "The errors of natural frequency and period are far smaller than the scatter of the damping ratio allows.",
        "If the damping were viscous, its scatter alone would move the natural frequency, or else the period, by "
        + " and ".join(lines)
        + ". The period stays while the decrement scatters: what scatters is dry friction or the first peak, not a "
        "viscous rate.",
    )


def _model_against_measurement() -> list[Contradiction]:
    return [
        _acceleration_at_release(),
        _instant_of_the_peak(),
        _damping_of_the_bearings(),
        _period_of_the_coupled_rig(),
        Contradiction(
            "trends with energy",
            (13, 21),
            "p. 13: damping ratios fall with the initial energy. p. 21: amplitudes rise with it.",
            "Of the 6 pairs of cases, ordered by energy, "
            f"{pairs_against_energy([float(printed_case(c).ratio[0]) for c in CASES])} show the first and "
            f"{pairs_against_energy([-float(printed_case(c).coupled_acceleration[0]) for c in CASES])} the second. "
            "Four cases of two stiffnesses cannot separate energy from stiffness and angle.",
        ),
        Contradiction(
            "scatter of three trials",
            (13, 17),
            "Standard errors of n = 3 are given as if sure; case III uncoupled has 0.42 +- 0.41.",
            "The true error lies between 0.74 and 2.4 times the printed one with 68 % probability (chi-square, 2 "
            "degrees of "
            "freedom): Student's t with 2 degrees of freedom is the right law, a Gaussian is too sure.",
        ),
    ]  # fmt: skip


def _acceleration_at_release() -> Contradiction:
    excess, drop, needed_torque = [], [], []
    for case in CASES:
        p = printed_case(case)
        excess.append(100 * (float(p.model_acceleration) / float(p.coupled_acceleration[0]) - 1))
        drop.append(float(p.acceleration[0]) - float(p.coupled_acceleration[0]))
        needed_torque.append(Needed(
            *("mu (at N0 = 100 N, R = 0.1 m)", "1", drop[-1] * J1 / (MAGNET_PULL * BAR_RADIUS)),
            p.coupled_acceleration[0],
            f"Case {case}: friction torque at release of {1e3 * drop[-1] * J1:.0f} mN m.",
        ))  # fmt: skip
    return Contradiction(
        "acceleration at release",
        (16, 18, 21),
        "No model of the thesis except dry friction can start below k1t theta0/J1, yet the measured coupled peaks "
        "do.",
        "The linear model's peak lies " + ", ".join(f"{x:.0f}" for x in excess) + " % above the measured one "
            "(Table 10). "
        "Coupling lowers the measured peak by " + ", ".join(f"{x:.1f}" for x in drop) + " rad/s^2, not in "
            "proportion to "
        f"anything printed; mu N0 R/J1 is {0.009 * MAGNET_PULL * BAR_RADIUS / J1:.0f} rad/s^2 for mu = 0.009.",
        tuple(needed_torque),
    )  # fmt: skip


def _instant_of_the_peak() -> Contradiction:
    delays = [1e3 * delay_of_peak(case) for case in CASES]
    return Contradiction(
        "instant of the first peak",
        (12, 21),
        "The linear model's printed peaks lie below its own acceleration at release.",
        "They are the accelerations " + ", ".join(f"{x:.2f}" for x in delays) + " ms after release (cases I-IV): "
            "the peak "
        "was read from samples, and the thesis does not say from when on.",
        tuple(
            Needed("t_min", "s", 1e-3 * d, printed_case(c).model_acceleration, "Plausible: half a millisecond.")
            for c, d in zip(CASES, delays, strict=True)
        ),
    )  # fmt: skip


def _damping_of_the_bearings() -> Contradiction:
    two = printed_case("II")
    theta0 = np.deg2rad(float(two.theta0))

    def decrement_ii(name: str) -> Callable[[float], float]:
        return lambda x: float(linear_features(linear_rig("II", **{name: x}), theta0).log_decrement[0])

    own = [
        float(linear_features(linear_rig(c, None), np.deg2rad(float(printed_case(c).theta0))).log_decrement[0])
        for c in CASES
    ]
    return Contradiction(
        "damping of the bearings in the linear model",
        (19, 21),
        "p. 19: c1t and c3t are those of the measured decrement; Table 10's decrements are those of c1t = 0.0109 "
        "throughout.",
        "With each case's own damping ratio the decrements would be " + ", ".join(f"{x:.2f}" for x in own)
        + " (printed 1.9, 1.9, 1.9, 1.4). With 0.0109 cases I, III and IV come out, but case II is "
        f"{decrement_ii('k2t')(1.0):.2f}.",
        (
            Needed("k2t, case II", "N m/rad", solve_for(decrement_ii("k2t"), 1.9, 0.5, 3.0), "1.9",
                   "Possible: it rounds to the printed 1."),
            Needed("c2t, case II", "N m s/rad", solve_for(decrement_ii("c2t"), 1.9, 0.04, 0.2), "1.9",
                   "No c2t does it at k2t = 1: the decrement has its maximum below 1.9."),
        ),
    )  # fmt: skip


def _period_of_the_coupled_rig() -> Contradiction:
    coupling = [effective_coupling(c) for c in CASES]
    periods = []
    for case in CASES:
        found = linear_features(linear_rig(case), np.deg2rad(float(printed_case(case).theta0)))
        periods.append((1e3 * float(found.period[0]), 1e3 * float(found.period_peaks[0])))
    return Contradiction(
        "period of the coupled rig",
        (17, 18, 20),
        "Table 7: at low stiffness the period falls by coupling; the linear model with Table 9 makes it longer.",
        "Cases I-IV: measured " + ", ".join(printed_case(c).coupled_period[0] for c in CASES) + " ms; linear model "
        + ", ".join(f"{a:.0f}" for a, _ in periods) + " ms between crossings, "
        + ", ".join(f"{b:.0f}" for _, b in periods) + " ms from release to the second peak; uncoupled "
        + ", ".join(printed_case(c).period[0] for c in CASES) + " ms.",
        tuple(
            Needed(f"k2t, c2t of case {c}", "N m/rad", k2t, printed_case(c).coupled_period[0],
                   f"With c2t = {c2t:.3f} N m s/rad period and decrement both come out within {miss:.1f} standard "
                   "errors; "
                   f"the thesis fitted {printed_case(c).k2t} and {printed_case(c).c2t} to the records.")
            for c, (k2t, c2t, miss) in zip(CASES, coupling, strict=True)
        ),
    )  # fmt: skip


def _design_options() -> list[Contradiction]:
    bar = float(INERTIA_ROWS["bar"])
    j2 = 1e6 * float(secondary_inertia())
    factor = 9.3 / 3.2

    def frequency(scale: float) -> float:
        return 3.2 * scale / float(np.sqrt((j2 - bar + bar * scale**3) / j2))

    grid = np.linspace(0.3, 3.0, 271)
    best = grid[np.argmax([frequency(x) for x in grid])]
    return [
        Contradiction(
            "factor of frequency",
            (27, 28),
            "p. 27 raises 3.2 to 9.3 Hz by a factor of 2.8; p. 28 divides J2 by 8.",
            f"9.3/3.2 = {factor:.2f}, whose square is {factor**2:.1f}; 8 leads to {3.2 * np.sqrt(8):.2f} Hz, the "
            "measured "
            "natural frequency.",
        ),
        Contradiction(
            "tuning by the bar's radius",
            (9, 27, 28),
            "p. 28: a bar 2.8 times as long would tune the secondary through k2t = k2 R^2 (eq. 21).",
            f"The bar makes up {100 * bar / j2:.0f} % of J2 and its inertia grows with R^3 at equal cross section, "
            "faster than "
            f"k2t: at 2.8 R the secondary would lie at {frequency(2.8):.1f} Hz. It never exceeds "
            f"{frequency(best):.2f} Hz, "
            f"reached at {best:.2f} R: no bar tunes it. Friction torque mu N0 R and the overlap slope R/(2r) grow too.",
            (Needed("R / R now", "1", solve_for(frequency, 9.3, 0.05, 20.0), "9.3", "No radius does it while the "
                "bar's mass "
                    "follows its length."),),
        ),
        Contradiction(
            "figures",
            (2, 17, 32),
            "Ordinate of Figure 2, caption of Figure 13, label 17.5 deg in Figures 6, 8 and 10.",
            "Eq. 1 at zeta = 0.07 lies between 0.3 and 7.2, Figure 2's ordinate between 1e-4 and 1e-1. Figure 13 is a "
            "transient, "
            "not a frequency response. No release angle of Table 2 is 17.5 deg; case IV's is 4.7.",
        ),
    ]  # fmt: skip


def _friction() -> Contradiction:
    mu = np.geomspace(0.002, 0.1, 160)
    found: dict[str, Array] = {}
    for law, _ in LAWS:
        alpha = Model(normal_force=law).simulate(nonlinear_rig(mu), EARLY_TIMES).y[:, 0]
        found[law] = features(EARLY_TIMES, alpha, T_MIN).log_decrement

    def at(law: str, x: float) -> float:
        return float(np.interp(np.log(x), np.log(mu), found[law]))

    def needs(law: str) -> float | None:
        ok = np.isfinite(found[law])
        return solve_for(lambda x: float(np.interp(np.log(x), np.log(mu[ok]), found[law][ok])), 1.21, mu[0], mu[ok][-1])

    drag = np.geomspace(1e-3, 0.2, 160)
    alpha = Model().simulate(nonlinear_rig(0.009, drag=drag), EARLY_TIMES).y[:, 0]
    with_drag = features(EARLY_TIMES, alpha, T_MIN).log_decrement
    alone = Model(coupled=False).simulate(_uncoupled_part(nonlinear_rig(0.0, drag=drag)), EARLY_TIMES).y[:, 0]
    uncoupled = features(EARLY_TIMES, alone, T_MIN).log_decrement
    ok = np.isfinite(with_drag)
    d = solve_for(lambda x: float(np.interp(np.log(x), np.log(drag[ok]), with_drag[ok])), 1.21, drag[0], drag[ok][-1])
    without = float(np.interp(np.log(d), np.log(drag), uncoupled)) if d is not None else np.nan
    by_friction = []
    for law, printed in LAWS:
        value, highest = needs(law), int(np.nanargmax(found[law]))
        if value is None:
            why = (
                f"No mu up to {mu[-1]:g} does it at R = 0.10 m without drag: the decrement is "
                f"{found[law][highest]:.2f} "
                f"at most (mu = {mu[highest]:.3f}), because faces that stick dissipate nothing."
            )
        else:
            why = (
                f"At R = 0.10 m without drag: {value / printed:.1f} times the printed {printed}. Plausible only if "
                "mu N0 R is larger by that factor through R or the pull."
            )
        by_friction.append(Needed(f"mu ({law} normal force)", "1", value, "1.21", why))
    by_drag = Needed(
        *("drag (linear normal force)", "N m", d, "1.21"),
        "At mu = 0.009, R = 0.10 m. Implausible: by the same drag the uncoupled rig of case IV would have a decrement "
        f"of {without:.2f}, measured 0.20 +- 0.01.",
    )
    return Contradiction(
        "friction of the nonlinear model",
        (20, 26),
        "Figure 10: mu = 0.005 (constant N) or 0.009 (linear N) describes the record of case IV better than the "
        "linear model.",
        "With the working R = 0.10 m, r = 0.0127 m and no bearing drag they give decrements of "
        f"{at('constant', 0.005):.2f} and {at('linear', 0.009):.2f}; measured 1.21 +- 0.05, the linear model 1.43. "
        "The drag d, R, r and nu are printed nowhere, so mu alone determines nothing.",
        (*by_friction, by_drag),
    )


def _uncoupled_part(parameters: Mapping[str, ArrayLike]) -> dict[str, ArrayLike]:
    names = ("J1", "k1t", "c1t", "drag", "nu", "theta0")
    return {name: parameters[name] for name in names}


def contradictions() -> tuple[Contradiction, ...]:
    """All of them, in the order of what they are about: inertias, frequency response, stiffness, models, designs."""
    found = (_inertias(), _table_12(), _stiffness(), _model_against_measurement(), _design_options(), [_friction()])
    return tuple(itertools.chain.from_iterable(found))
