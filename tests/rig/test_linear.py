"""The closed forms against scipy's independent routines, and against the printed numbers they should give."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import freqresp

from bayes_damper.errors import InputError
from bayes_damper.rig import linear
from bayes_damper.rig.linear import LinearRig

J1, J2 = 3.015e-3, 2.474e-3
CASE_IV = LinearRig(J1, J2, 10.2, 0.0109, 1.0, 0.08, 0.0109)
TIMES = np.linspace(0.0, 0.5, 101)


def draws(n, seed=0, coupling=0.08):
    rng = np.random.default_rng(seed)

    def spread(x):
        return x * np.exp(0.5 * rng.standard_normal(n))

    return LinearRig(
        spread(J1), spread(J2), spread(10.2), spread(0.01), spread(1.0), spread(coupling), spread(0.01), spread(0.5),
        0.3 * np.sqrt(J1 * J2) * rng.uniform(-1, 1, n) * 0.2,
    )  # fmt: skip


def one(rig, i):
    return LinearRig(**{name: value[i] for name, value in rig.arrays().items()})


def test_free_response_equals_the_matrix_exponential():
    rig = draws(6)
    response = linear.free_response(rig, 0.08, TIMES, theta2_0=0.05, omega1_0=1.0, omega2_0=-0.5)
    start = np.array([0.08, 0.05, 1.0, -0.5])
    a = linear.state_matrix(rig)
    for i in range(6):
        exact = np.array([expm(a[i] * t) @ start for t in TIMES]).T
        np.testing.assert_allclose(response.angle[i], exact[:2], atol=1e-12)
        np.testing.assert_allclose(response.velocity[i], exact[2:], atol=1e-10)


def test_free_response_equals_tight_time_integration():
    response = linear.free_response(CASE_IV, np.deg2rad(4.7), TIMES)
    p = {k: v[0] for k, v in CASE_IV.arrays().items()}

    def rhs(_, x):
        th1, th2, w1, w2 = x
        t = p["k2t"] * (th1 - th2) + p["c2t"] * (w1 - w2)
        a1 = (-p["c1t"] * w1 - p["k1t"] * th1 - t) / p["J1"]
        return [w1, w2, a1, (t - p["c3t"] * w2) / p["J2"]]

    start = [np.deg2rad(4.7)] * 2 + [0.0, 0.0]
    run = solve_ivp(rhs, (0, TIMES[-1]), start, t_eval=TIMES, method="DOP853", rtol=1e-12, atol=1e-14)
    alpha = np.array([rhs(0, x)[2:] for x in run.y.T]).T
    np.testing.assert_allclose(response.acceleration[0], alpha, atol=1e-8 * np.abs(alpha).max())


def test_equal_modes_are_propagated_by_the_exponential():
    # Two identical, critically damped inertias without coupling: the state matrix has no full set of modes.
    c = 2.0 * np.sqrt(10.2 * J1)
    rig = LinearRig(J1, J1, 10.2, c, 0.0, 0.0, c, k3t=10.2)
    response = linear.free_response(rig, 0.1, TIMES)
    theta, _, alpha = linear.sdof_response(TIMES, 0.1, J1, 10.2, c)
    np.testing.assert_allclose(response.angle[0], [theta, theta], atol=1e-10)
    np.testing.assert_allclose(response.acceleration[0], [alpha, alpha], atol=1e-6)


@pytest.mark.parametrize("zeta", [0.0, 0.03, 0.5, 1.0, 1.7])
def test_sdof_response_solves_its_equation(zeta):
    """Eqs. 4 and 15 (pp. 7, 15), below, at and above critical damping."""
    c = float(linear.damping_coefficient(zeta, 10.2, J1))
    theta, omega, alpha = linear.sdof_response(TIMES, 0.08, J1, 10.2, c, omega0=2.0)
    a = np.array([[0.0, 1.0], [-10.2 / J1, -c / J1]])
    exact = np.array([expm(a * t) @ [0.08, 2.0] for t in TIMES]).T
    np.testing.assert_allclose(theta, exact[0], atol=1e-9)
    np.testing.assert_allclose(omega, exact[1], atol=1e-7)
    np.testing.assert_allclose(alpha, (a @ exact)[1], atol=1e-5)


@pytest.mark.filterwarnings("ignore:Badly conditioned")  # scipy goes through a numerator with leading zeros
def test_transfer_function_equals_scipys_state_space():
    """Eq. 23 (p. 28) against signal.freqresp of the state matrix."""
    rig = draws(4, seed=1)
    f = np.geomspace(0.5, 50.0, 60)
    ours = linear.transfer_function(rig, f)
    a = linear.state_matrix(rig)
    inertia = linear.matrices(rig)[0]
    for i in range(4):
        b = np.concatenate([[0.0, 0.0], np.linalg.solve(inertia[i], [1.0, 0.0])])[:, None]
        for channel in range(2):
            c = np.eye(4)[channel : channel + 1]
            _, h = freqresp((a[i], b, c, np.zeros((1, 1))), 2 * np.pi * f)
            np.testing.assert_allclose(ours[i, channel], h, rtol=1e-8)


def test_transfer_function_equals_time_integration_under_harmonic_torque():
    f, amplitude = 7.0, 0.3
    p = {k: v[0] for k, v in CASE_IV.arrays().items()}
    w = 2 * np.pi * f

    def rhs(t, x):
        interface = p["k2t"] * (x[0] - x[1]) + p["c2t"] * (x[2] - x[3])
        drive = amplitude * np.cos(w * t)
        return [
            x[2], x[3],
            (drive - p["c1t"] * x[2] - p["k1t"] * x[0] - interface) / p["J1"],
            (interface - p["c3t"] * x[3]) / p["J2"],
        ]  # fmt: skip

    settle, n = 40 / f, 400
    t = settle + np.arange(n) / n / f
    run = solve_ivp(rhs, (0, t[-1]), np.zeros(4), t_eval=t, method="DOP853", rtol=1e-10, atol=1e-13)
    fundamental = 2.0 * np.mean(run.y[:2] * np.exp(-1j * w * t), axis=1) / amplitude
    np.testing.assert_allclose(fundamental, linear.transfer_function(CASE_IV, f)[0, :, 0], rtol=1e-5)


def test_resonances_are_the_maxima_of_a_fine_grid():
    rig = draws(200, seed=2, coupling=0.03)
    found = linear.resonances(rig)
    f = np.geomspace(0.05, 400.0, 60001)
    several = 0
    for i in range(200):
        a = linear.accelerance(one(rig, i), f)[0, 0]
        k = 1 + np.flatnonzero((a[1:-1] > a[:-2]) & (a[1:-1] >= a[2:]))
        assert len(k) == np.isfinite(found.frequency_hz[i]).sum()
        several += len(k) > 1
        np.testing.assert_allclose(found.frequency_hz[i, : len(k)], f[k], rtol=2e-4)
        np.testing.assert_allclose(found.accelerance[i, : len(k)], a[k], rtol=1e-5)
    assert several > 10  # the draws cover both one and two resonances


def test_uncoupled_resonance_is_that_of_a_coupling_of_zero():
    frequency, peak = linear.uncoupled_resonance(J1, 10.2, 0.0109)
    found = linear.resonances(LinearRig(J1, J2, 10.2, 0.0109, 0.0, 0.0, 0.0109))
    np.testing.assert_allclose([found.peak_frequency_hz[0], found.peak[0]], [frequency, peak], rtol=1e-6)
    # Printed by the working notes: 9.27 Hz and 5338; Table 12 (p. 31) has 9.2 Hz and 772.1.
    assert float(frequency) == pytest.approx(9.27, abs=0.005)
    assert float(peak) == pytest.approx(5338, rel=0.005)


def test_a_heavily_damped_primary_has_no_peak():
    c = float(linear.damping_coefficient(0.8, 10.2, J1))
    assert np.isnan(linear.uncoupled_resonance(J1, 10.2, c)[1])
    loss = linear.insertion_loss(LinearRig(J1, J2, 10.2, c, 1.0, 0.08, 0.0109))
    assert np.isnan(loss[0])


def test_first_row_of_table_12():
    """Case IV with stiffness: 9.0 Hz and 680.7 per kg m^2 (Table 12, p. 31), to 0.05 Hz and 0.5 %."""
    found = linear.resonances(CASE_IV)
    assert found.peak_frequency_hz[0] == pytest.approx(9.0, abs=0.05)
    assert found.peak[0] == pytest.approx(680.7, rel=0.005)


def test_insertion_losses_are_not_the_printed_ones():
    """17.9 dB untuned, 7.1 dB with J2/8 (printed 1 and 5 dB, p. 29): the contradiction is in the thesis, not here."""
    assert linear.insertion_loss(CASE_IV)[0] == pytest.approx(17.9, abs=0.05)
    tuned = LinearRig(J1, J2 / 8, 10.2, 0.0109, 1.0, 0.08, 0.0109)
    assert linear.insertion_loss(tuned)[0] == pytest.approx(7.1, abs=0.05)


@pytest.mark.parametrize(
    ("case", "decrement", "ratio"),
    [("I", 0.95, 0.150), ("II", 0.26, 0.041), ("III", 0.42, 0.067), ("IV", 0.20, 0.031),
     ("I", 1.61, 0.249), ("II", 0.96, 0.151), ("III", 1.66, 0.256), ("IV", 1.21, 0.189)],
)  # fmt: skip
def test_damping_ratios_of_table_6(case, decrement, ratio):
    """Eq. 11 gives the ratios of Table 6 (p. 17) from its decrements, within the rounding of both."""
    assert linear.damping_ratio_of_decrement(decrement) == pytest.approx(ratio, abs=0.0015)
    back = linear.decrement_of_damping_ratio(linear.damping_ratio_of_decrement(decrement))
    assert back == pytest.approx(decrement, rel=1e-12)


def test_elementary_formulas():
    """Eqs. 1, 6-9, 12-14, 16 at the thesis's own numbers (pp. 2-16)."""
    assert linear.natural_frequency(10.2, J1) == pytest.approx(9.26, abs=0.005)  # Table 4, p. 14
    assert linear.stiffness_for(linear.natural_frequency(6.2, J1), J1) == pytest.approx(6.2, rel=1e-12)
    assert linear.damping_coefficient(0.031, 10.2, J1) == pytest.approx(0.0109, abs=5e-5)
    assert linear.damping_ratio(linear.damping_coefficient(0.031, 10.2, J1), 10.2, J1) == pytest.approx(0.031)
    assert 1e3 * linear.potential_energy(10.2, np.deg2rad(4.7)) == pytest.approx(34.3, abs=0.05)  # Table 2, p. 11
    assert linear.acceleration_bound(10.2, np.deg2rad(4.7), J1) == pytest.approx(277.5, abs=0.05)  # Table 5, p. 16
    assert linear.percent_difference(7.19, 6.76, "predicted") == pytest.approx(5.98, abs=0.005)  # Table 4, p. 14
    assert linear.percent_difference(7.19, 6.76) == pytest.approx(6.36, abs=0.005)
    assert linear.transmissibility(np.sqrt(2.0), [0.01, 0.5]) == pytest.approx([1.0, 1.0])
    assert linear.log_decrement(np.e, 1.0) == pytest.approx(1.0)


@pytest.mark.parametrize(("name", "value"), [("J2", 0.0), ("J1", -1e-3), ("k2t", np.nan), ("J12", 1.0)])
def test_a_rig_that_means_nothing_is_refused(name, value):
    values = {"J1": J1, "J2": J2, "k1t": 10.2, "c1t": 0.01, "k2t": 1.0, "c2t": 0.08, "c3t": 0.01, "J12": 0.0}
    with pytest.raises(InputError, match=name):
        linear.insertion_loss(LinearRig(**{**values, name: value}))
