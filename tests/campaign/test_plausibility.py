"""Remarks of `check` on records: what is wrong in them is named, and what is sound is not."""

from __future__ import annotations

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from campaigns import read_table, write_synthetic, write_table

from bayes_damper.campaign import load_campaign
from bayes_damper.campaign import readings as look
from bayes_damper.campaign.importing.importer import init_campaign
from bayes_damper.campaign.plausibility import _look_at_clock
from bayes_damper.campaign.structure import noise_floor
from bayes_damper.errors import InputError

RATE, OMEGA = 30.0, 6.0  # a camera that films a slow cart


def swing(times, amplitude=0.1, decay=0.15):
    return amplitude * np.exp(-decay * times) * np.cos(OMEGA * times)


def cart(
    folder,
    records,
    *,
    times=None,
    start="rest",
    measurement="",
    theta0=100.0,
    case=lambda i: "A",
    quantity="displacement",
):
    """A campaign of a cart on a spring, displacement in m; theta0: declared in mm, one or one a record."""
    times = np.arange(0.0, 12.0, 1.0 / RATE) if times is None else times
    folder.mkdir()
    column = {"displacement": "x1_m", "velocity": "v1_m_s"}[quantity]
    (folder / "campaign.toml").write_text(
        f'name = "cart"\n[rig]\nkind = "translational"\nprimary_inertia = 1.0\n[measurement]\n'
        f'quantity = "{quantity}"\nstart = "{start}"\n{measurement}\n'
    )
    released = theta0 if isinstance(theta0, list) else [theta0] * len(records)
    rows = ["file,case,configuration,k1_n_per_m,theta0_mm,theta0_std_mm,trial"]
    for i, (x, mm) in enumerate(zip(records, released, strict=True)):
        (folder / f"{i}.csv").write_text(
            "\n".join([f"time_s,{column}", *(f"{t!r},{v!r}" for t, v in zip(times.tolist(), x.tolist(), strict=True))])
        )
        given = ",,," if start == "free" else f",{mm},0.5,"
        rows.append(f"{i}.csv,{case(i)},uncoupled,{OMEGA**2}{given}{i + 1}")
    (folder / "trials.csv").write_text("\n".join(rows) + "\n")
    return load_campaign(folder).warnings


def noisy(seed, x, sd=2e-4):
    return x + sd * np.random.default_rng(seed).standard_normal(x.size)


TIMES = np.arange(0.0, 12.0, 1.0 / RATE)


def test_spikes_half_as_large_as_the_motion_are_named_in_a_coarse_record(tmp_path):
    x = noisy(1, swing(TIMES))
    sound = cart(tmp_path / "sound", [noisy(s, swing(TIMES)) for s in (1, 2, 3)])
    assert not any("stick" in w for w in sound)
    x[[100, 200]] += 0.05
    found = cart(tmp_path / "spiked", [x, noisy(2, swing(TIMES)), noisy(3, swing(TIMES))])
    (warning,) = [w for w in found if "stick" in w]
    assert "0.csv" in warning
    assert "at 3.333, 6.667 s" in warning


def test_steps_and_kinks_of_a_displacement_are_no_spikes():
    step = np.where(TIMES < 5.0, 0.0, 1.0) + 1e-4 * np.sin(7.0 * TIMES)
    kink = np.abs(swing(TIMES))
    for y in (step, kink):
        assert not look._off_the_cubic(y, 1e-5).any()


LIFT = 0.1 * np.sin(0.5 * math.pi * np.linspace(0.0, 1.0, 60)) ** 2


@pytest.mark.parametrize("before", [np.zeros(60), LIFT, np.concatenate([LIFT, np.full(40, LIFT[-1])])])
def test_rest_or_a_hand_before_the_release_of_a_free_start_is_named(tmp_path, before):
    x = np.concatenate([np.zeros(40), before, swing(TIMES)])
    times = np.arange(x.size) / RATE
    found = cart(tmp_path / "lifted", [noisy(s, x) for s in (1, 2)], times=times, start="free")
    assert sum("a hand moves it, before it is let go" in w for w in found) == 2
    assert not any("clipped" in w for w in found), "a hand that holds the rig"
    found = cart(tmp_path / "free", [noisy(s, swing(TIMES)) for s in (1, 2)], start="free")
    assert not any("before it is let go" in w for w in found)


@pytest.mark.parametrize("count", [0.0005, 0.003])
@pytest.mark.parametrize("rate", [30.0, 1000.0])
@pytest.mark.parametrize("omega", [2.0, OMEGA])
def test_pixels_and_encoder_counts_are_not_called_clipped_and_clipped_ones_are(count, rate, omega):
    """Whatever the frequency is taken for: the record swings at OMEGA, `omega` is what the spring gives."""
    times = np.arange(0.0, 12.0, 1.0 / rate)
    for top in (0.1, 0.1004, 0.1009):
        y = count * np.round(swing(times, top, 0.02) / count)
        assert look.flat_tops_of(times, y, look.noise_floor_of(y), omega, True) == []
    if rate > 100.0:  # a few readings to a swing show no flat top
        cut = np.minimum(count * np.round(swing(times, 0.1, 0.02) / count), 24 * 0.003)
        assert look.flat_tops_of(times, cut, look.noise_floor_of(cut), omega, True) == [pytest.approx(0.072, abs=1e-3)]


def test_rest_before_a_release_is_no_sensor_that_stopped(tmp_path):
    """A simulated record, or one of a sensor that shows nothing below a threshold, is exactly 0 before the release."""
    times = np.arange(-1.0, 11.0, 1.0 / RATE)
    speed = np.where(times < 0.0, 0.0, np.gradient(swing(times), times))
    for name, record, stopped in (
        ("rest", speed, False),
        ("stopped", np.where(abs(times - 3.0) < 0.5, 0.02, speed), True),
    ):
        found = cart(tmp_path / name, [record], times=times, quantity="velocity")
        assert any("stands still" in w for w in found) == stopped, found


@pytest.mark.parametrize("held", [0.1, 0.5, 1.0])
def test_a_displacement_that_is_held_before_the_release_is_sound(tmp_path, held):
    """It had been called clipped, or released from less than declared: the first period began with the rest."""
    times = np.arange(-held, 12.0, 1.0 / 300.0)
    records = [noisy(s, np.where(times < 0.0, 0.1, swing(times))) for s in range(6)]
    assert not cart(tmp_path / "held", records, times=times)


@pytest.mark.parametrize("begin", [0.0, -0.3])
@pytest.mark.parametrize("start", ["rest", "free"])
def test_a_displacement_that_stands_still_at_first_and_then_leaps_is_named(tmp_path, begin, start):
    """It had been a rig that is held, and a release that came late."""
    times = np.arange(begin, 12.0, 1.0 / 300.0)
    records = [noisy(s, np.where(times < 0.0, 0.1, swing(times))) for s in (1, 2)]
    assert not any("stands still" in w for w in cart(tmp_path / "sound", records, times=times, start=start))
    for record in records:
        record[:200] = record[0]
    found = cart(tmp_path / "frozen", records, times=times, start=start)
    said = [w for w in found if "stands still at" in w]
    assert len(said) == 2
    assert f"from {begin:g} to {begin + 199.0 / 300.0:.4g} s, 200 equal readings" in said[0]
    assert not any("motion begins" in w or "first readings" in w for w in found)


@pytest.mark.parametrize("rate", [15.0, 60.0, 1000.0])
@pytest.mark.parametrize("held", [0.02, 0.8])
@pytest.mark.parametrize("damping", [0.02, 0.5, 1.0, 8.0])
@pytest.mark.parametrize("step", [0.0, 1e-3])
def test_a_rig_that_is_held_and_let_go_does_not_leap(tmp_path, rate, held, damping, step):
    """However fast it is read, rounded, damped, and let go some time after t = 0."""
    times = np.arange(-1.0, 12.0, 1.0 / rate)
    t = np.maximum(times - held, 0.0) * OMEGA
    root = np.emath.sqrt(damping**2 - 1.0) or 1e-6
    x = 0.1 * np.real(np.exp(-damping * t) * (np.cosh(root * t) + damping / root * np.sinh(root * t)))
    found = cart(tmp_path / "held", [step * np.round(x / step) if step else x], times=times)
    assert not any("stands still" in w and "from -1 to" in w for w in found), found


def test_a_record_that_ends_in_mid_swing_rests_nowhere(tmp_path):
    times = np.arange(0.0, 1.6, 1.0 / 300.0)  # a swing and a half, seen at ten times the rate
    found = cart(tmp_path / "short", [noisy(s, swing(times)) for s in (1, 2)], times=times)
    assert not any("rests at" in w for w in found)
    found = cart(tmp_path / "offset", [noisy(s, swing(TIMES) + 0.02) for s in (1, 2)], theta0=120.0)
    assert sum("rests at 0.0" in w and "or dry friction holds it there" in w for w in found) == 2
    records = [noisy(s, swing(TIMES) + 0.02) for s in (1, 2)]
    for declared, said in ((0.01, False), (0.005, True)):  # within three of what is declared fits infer it
        found = cart(tmp_path / f"{declared}", records, theta0=120.0, measurement=f"offset_std = [{declared}]")
        assert any("rests at" in w for w in found) == said


def test_an_encoder_that_ends_within_a_step_of_zero_has_no_offset(tmp_path):
    """It stands on its last step: what it rests at lies within its rounding."""
    step = 7.7e-4
    for name, away, said in (("within", 0.8 * step, 0), ("beyond", 3.0 * step, 2)):
        records = [step * np.round((swing(TIMES) * np.exp(-TIMES) + away + 1e-4 * s) / step) for s in (1, 2)]
        found = cart(tmp_path / name, records)
        assert sum("rests at" in w for w in found) == said, found


def test_a_release_declared_half_as_large_again_in_one_case_is_named(tmp_path):
    records = [noisy(i, swing(TIMES, a)) for i, a in enumerate([0.1, 0.1, 0.06, 0.06])]
    case = lambda i: "large" if i < 2 else "small"  # noqa: E731 (two words)
    assert not any(
        "another release" in w for w in cart(tmp_path / "right", records, theta0=[100.0, 100.0, 60.0, 60.0], case=case)
    )
    found = cart(tmp_path / "wrong", records, theta0=[100.0, 100.0, 90.0, 90.0], case=case)
    assert any("another release than declared: case small 0.6" in w for w in found)


def test_a_release_declared_half_as_large_again_in_all_cases_is_named(tmp_path):
    """The records were said to begin after the motion began, which others do."""
    found = cart(tmp_path / "declared", [noisy(s, swing(TIMES)) for s in (1, 2)], theta0=150.0)
    said = [w for w in found if "not those of a release" in w]
    assert len(said) == 2
    assert re.search(r"body 1 stands (99.\d|100) mm from 0, not 150 mm as theta0 says; correct theta0 in tri", said[0])
    assert said[0].endswith(", or the record begins after the motion began")
    found = cart(tmp_path / "late", [noisy(s, swing(TIMES + 0.8)) for s in (1, 2)], theta0=90.0)
    assert sum(w.endswith("not those of a release; the record begins after the motion began") for w in found) == 2
    assert not any("not those" in w for w in cart(tmp_path / "sound", [noisy(s, swing(TIMES)) for s in (1, 2)]))


@pytest.mark.parametrize("repeats", [2, 3])
def test_displacements_of_two_cases_that_are_exchanged_are_named(tmp_path, repeats):
    """Their first readings are not at the declared release, and begin with it nevertheless."""
    sizes = [*[0.1] * repeats, *[0.06] * repeats]
    case, declared = (lambda i: "large" if i < repeats else "small"), [1e3 * size for size in sizes]
    sound = [noisy(i, swing(TIMES, a)) for i, a in enumerate(sizes)]
    assert not any("like" in w for w in cart(tmp_path / "sound", sound, theta0=declared, case=case))
    sound[0], sound[-1] = sound[-1], sound[0]
    found = cart(tmp_path / "exchanged", sound, theta0=declared, case=case)
    if repeats == 3:
        for file, other in (("0.csv", "small"), ("5.csv", "large")):
            assert any(
                w.startswith(file) and f"it is like the trials of case {other}: a wrong name?" in w for w in found
            )
    else:
        (told,) = [w for w in found if "exchanged" in w]
        assert told.startswith("0.csv: like 2.csv of case small")
        assert all(f"{i}.csv" in told for i in range(4))
        assert not any("another release" in w for w in found)


def test_a_spring_that_is_wrong_is_no_late_release(tmp_path):
    """It is softer than declared, so the motion takes longer to leave the noise."""
    records = [noisy(s, 0.1 * np.exp(-0.05 * TIMES) * np.cos(0.3 * OMEGA * TIMES)) for s in (1, 2)]
    found = cart(tmp_path / "soft", records)
    assert any("swings at another frequency" in w for w in found)
    assert not any("motion begins" in w for w in found), found
    late = cart(tmp_path / "late", [np.where(TIMES < 0.5, 0.1, np.roll(x, 15)) for x in records])
    assert any("motion begins" in w for w in late)


def test_a_strongly_damped_case_is_not_said_to_have_another_release(tmp_path):
    records = [noisy(i, swing(TIMES, 0.1, d)) for i, d in enumerate([0.1, 0.1, 1.2, 1.2])]
    found = cart(tmp_path / "damped", records, case=lambda i: "light" if i < 2 else "damped")
    assert not any("another release" in w for w in found)


@pytest.mark.parametrize("stretch", [0.5, 2.0, 60.0])
def test_a_wrong_unit_of_time_is_told_from_a_wrong_spring_by_the_size_of_velocities(tmp_path, stretch):
    """Half the spring swings as slowly as twice the time, but 0.7 times as fast."""
    times = np.arange(0.0, 12.0, 1.0 / 300.0)
    records = [noisy(s, -OMEGA * 0.1 * np.exp(-0.1 * times) * np.sin(OMEGA * times)) for s in (1, 2)]
    if stretch == 60.0:
        with pytest.raises(InputError, match=r"correct the unit of time|time column"):
            cart(tmp_path / "c", records, times=times / stretch, quantity="velocity")
        return
    found = cart(tmp_path / "c", records, times=stretch * times, quantity="velocity")
    assert any(f"that time is {stretch:.3g} times what it should be" in w for w in found), found
    assert not any("another release" in w for w in found)


def test_a_fast_rig_that_is_read_slowly_begins_with_its_release(tmp_path):
    """Two readings after its release it had swung as far as one that is read from the middle of its motion."""
    times = np.arange(0.0, 12.0, 0.4 / OMEGA)

    def named(since):
        y = -0.1 * OMEGA * np.exp(-0.15 * since) * np.sin(OMEGA * since)
        found = cart(tmp_path / f"{since[0]:.3f}", [noisy(k, y) for k in range(2)], times=times, quantity="velocity")
        return any("not those of a release" in warning for warning in found)

    assert not named(times)
    assert named(times + 1.2 / OMEGA)


def test_single_wrong_readings_do_not_make_another_release(tmp_path):
    times = np.arange(0.0, 12.0, 1.0 / 300.0)
    records = [noisy(s, swing(times)) for s in (1, 2)]
    for record in records:
        record[5::199] = 0.3
    found = cart(tmp_path / "c", records, times=times)
    assert sum("single readings stick out" in w for w in found) == 2
    assert not any("another release" in w or "the largest reading" in w or "not those of a release" in w for w in found)


@pytest.mark.parametrize(("every", "lines"), [(2, True), (5, True), (20, True), (2, False), (5, False)])
def test_readings_made_from_a_slower_record_are_named(tmp_path, every, lines):
    times = np.arange(0.0, 12.0, 1.0 / 300.0)
    x = noisy(1, swing(times), 1e-3)
    made = np.interp(times, times[::every], x[::every]) if lines else np.repeat(x[::every], every)
    found = cart(tmp_path / "made", [made, noisy(2, made, 1e-4)], times=times)
    said = [w for w in found if f"only one reading in {every} was measured" in w]
    assert len(said) == 1, found
    assert said[0].startswith("0.csv")
    assert ("straight lines" in said[0]) == lines
    assert not any("0.csv" in w and w not in said for w in found), found


def test_rounded_and_smooth_readings_are_measured_ones():
    times = np.arange(0.0, 12.0, 1.0 / 1000.0)
    for counts in (0.0, 1e-5, 1e-4, 1e-3, 1e-2):
        for sd in (0.0, 1e-5, 1e-3):
            x = noisy(3, swing(times), sd)
            x = np.round(x / counts) * counts if counts else x
            assert look.filled_in_of(x, look.resolution_of(x)) is None, (counts, sd)


@pytest.mark.parametrize("mark", [-9999.0, 1e6])
def test_a_number_that_stands_for_missing_readings_is_named(tmp_path, mark):
    """It had been called degrees taken for radians."""
    x = noisy(1, swing(TIMES))
    x[40::7] = mark
    with pytest.raises(InputError, match=rf"readings are {re.escape(f'{mark:g}')}, far beyond all others: .* Remove"):
        cart(tmp_path / "c", [x, noisy(2, swing(TIMES))])


def test_times_that_count_from_something_else_than_the_release_are_refused(tmp_path):
    """A fit would simulate all the time before."""
    records = [noisy(s, swing(TIMES)) for s in (1, 2)]
    with pytest.raises(InputError, match=r"begins 1.7e\+09 s after t = 0, the release, and lasts 12 s: take"):
        cart(tmp_path / "rest", records, times=TIMES + 1.7e9)
    cart(tmp_path / "late", records, times=TIMES + 30.0)
    cart(tmp_path / "free", records, times=TIMES + 1.7e9, start="free")


def test_a_decay_that_is_over_soon_swings_at_its_own_frequency():
    """A rate of turn: its mean over the decay is not the level at which it rests for most of the record."""
    times = np.arange(8000) / 200.0
    noise = 0.002 * np.random.default_rng(2).standard_normal(8000)
    rate = -18.0 * np.exp(-times) * np.sin(2.0 * np.pi * 4.7 * times) + noise
    assert look.dominant_frequency(times, rate) == pytest.approx(4.7, rel=0.02)


def test_stamps_of_an_even_clock_with_too_few_digits_give_its_rate():
    times = np.round(np.arange(200) / 29.97, 2)
    assert look.rounded_clock(times) == pytest.approx((0.01, 29.97), rel=1e-3)
    jittering = np.round(np.arange(200) / 29.97 + 0.006 * np.sin(np.arange(200.0)), 2)
    assert look.rounded_clock(jittering) is None
    assert look.rounded_clock(np.arange(200) / 29.97) is None
    assert look.rounded_clock(np.delete(times, [20, 21, 90])) == pytest.approx((0.01, 29.97), rel=1e-3)


def test_check_names_the_rate_behind_rounded_stamps(tmp_path):
    times = np.round(np.arange(0.0, 12.0, 1.0 / 29.97), 2)
    warnings = cart(tmp_path / "rig", [swing(times)] * 2, times=times)
    assert any("stamps rounded to 0.01 s; fits take the readings as even, at 29.97" in w for w in warnings)


def test_stretches_far_apart_swing_at_their_own_frequency():
    """Three stretches of one long decay: the straight lines through the gaps are no oscillation."""
    times = np.concatenate([start + np.arange(200) / 30.0 for start in (0.0, 68.0, 134.0)])
    y = 0.05 + 0.3 * np.exp(-times / 200.0) * np.cos(2.0 * np.pi * 0.7 * times)
    assert look.dominant_frequency(times, y) == pytest.approx(0.7, rel=0.02)


@pytest.mark.filterwarnings("error")
def test_readings_as_large_as_numbers_get_are_looked_at_without_a_warning():
    times = np.arange(400) / 100.0 + 1e-3 * (np.arange(400) % 3)
    y = 1e308 * np.where(np.arange(400) % 2 == 0, 1.0, -1.0)
    assert look.dominant_frequency(times, y) > 0.0
    spiked = np.where(np.arange(400) == 77, 1.5e308, 1e307 * np.cos(times))
    with np.errstate(over="ignore"):
        assert np.isfinite(look.without_outliers(times, spiked, 1.0)).all()


def test_cases_that_differ_in_capitals_only_are_named(tmp_path):
    records = [noisy(s, swing(TIMES)) for s in (1, 2)]
    found = cart(tmp_path / "c", records, case=lambda i: "Aa"[i])
    assert any("the cases A and a differ in capitals only and count as 2" in w for w in found)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("sensor_range = 0.05", "readings go to 0.1.* beyond the sensor's range of 0.05"),
        ("sensor_range = 0.1", "readings reach the sensor's range of 0.1; it may be clipped"),
        ("sensor_range = 1.0", None),
        ("offset_std = 5.0", "offset_std = 5 is above the largest reading, 0.1"),
        ("offset_std = 0.01", None),
    ],
)
def test_a_range_or_an_offset_in_another_unit_is_named(tmp_path, given, said):
    found = cart(tmp_path / "c", [noisy(s, swing(TIMES), 1e-5) for s in (1, 2)], measurement=given)
    own = [w for w in found if "range" in w or "offset_std =" in w]
    assert all(re.search(said, w) for w in own) and own if said else not own


def test_a_lag_uncertain_by_more_than_half_a_period_is_named(tmp_path):
    found = cart(tmp_path / "late", [noisy(s, swing(TIMES)) for s in (1, 2)], measurement="lag_std = 0.6")
    assert any("lag_std = 0.6 s is more than half a period" in w for w in found)
    found = cart(tmp_path / "sound", [noisy(s, swing(TIMES)) for s in (1, 2)], measurement="lag_std = 0.1")
    assert not any("lag_std" in w for w in found)


def magnet_rig(folder, **changed):
    constants = {"magnet_pull": 100.0, "magnet_radius": 0.0127, "bar_radius": 0.1} | changed
    (folder / "campaign.toml").write_text(
        'name = "rig"\n[rig]\nprimary_inertia = 0.003\nsecondary_inertia = 0.002\n'
        + "".join(f"{k} = {v}\n" for k, v in constants.items())
        + '[measurement]\nquantity = "displacement"\n'
    )
    (folder / "trials.csv").write_text(
        "file,case,configuration,k1t_n_m_per_rad,theta0_deg,theta0_std_deg,trial\na.csv,I,uncoupled,0.108,5.73,0.1,1\n"
    )
    rows = [f"{t!r},{x!r}" for t, x in zip(TIMES.tolist(), swing(TIMES).tolist(), strict=True)]
    (folder / "a.csv").write_text("\n".join(["time_s,theta1_rad", *rows]))
    return folder


@pytest.mark.parametrize(
    ("key", "value"), [("magnet_pull", 1e29), ("magnet_radius", 1e-29), ("bar_radius", 1e-29), ("magnet_pull", 1e-29)]
)
def test_a_magnet_that_cannot_be_is_refused(tmp_path, key, value):
    with pytest.raises(InputError, match=re.escape(f"{key} = {value:g}") + ".* is none of a rig"):
        load_campaign(magnet_rig(tmp_path, **{key: value}))


def test_a_magnet_that_was_taken_off_pulls_with_nothing(tmp_path):
    assert not load_campaign(magnet_rig(tmp_path, magnet_pull=0.0)).rig.has_magnet


@pytest.mark.parametrize(("value", "std", "said"), [(0.0, 1e-4, False), (1e-4, 1e-5, False), (-1e-4, 2e-4, True)])
def test_an_inertial_coupling_whose_sign_is_open_is_named(tmp_path, value, std, said):
    warnings = load_campaign(magnet_rig(tmp_path, inertial_coupling=f"{{ value = {value}, std = {std} }}")).warnings
    assert (
        any(f"inertial_coupling = {value:g} with std = {std:g}" in w and "sign is open" in w for w in warnings) == said
    )


@pytest.mark.parametrize(("pull", "said"), [(100.0, False), (450.0, False), (470.0, True), (10_200.0, True)])
def test_a_pull_that_no_magnet_of_that_face_has_is_named(tmp_path, pull, said):
    warnings = load_campaign(magnet_rig(tmp_path, magnet_pull=pull)).warnings
    assert any("more than any permanent magnet" in w and "1 kg is 9.81 N" in w for w in warnings) == said


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [("bar_radius", 0.2, 0), ("bar_radius", 10.0, 2), ("secondary_inertia", 2e-6, 1), ("secondary_inertia", 1e-4, 0)],
)
def test_an_inertia_less_than_its_magnet_has_is_named(tmp_path, key, value, said):
    folder = magnet_rig(tmp_path, **{} if key == "secondary_inertia" else {key: value})
    if key == "secondary_inertia":
        text = (folder / "campaign.toml").read_text().replace("secondary_inertia = 0.002", f"{key} = {value}")
        (folder / "campaign.toml").write_text(text)
    assert sum("is too little for a face of 0.0127 m" in w for w in load_campaign(folder).warnings) == said


@pytest.mark.parametrize(
    ("bandwidth", "said"),
    [
        (0.5, "shows 46% of the motion, 62 degrees late"),
        (1.2, "shows 78% of the motion, 39 degrees late"),
        (10.0, None),
    ],
)
def test_a_sensor_that_is_too_slow_for_the_rig_is_named_with_what_it_takes(tmp_path, bandwidth, said):
    records = [noisy(s, swing(TIMES)) for s in (1, 2)]
    found = [
        w for w in cart(tmp_path / "cart", records, measurement=f"sensor_bandwidth = {bandwidth}") if "sensor_band" in w
    ]
    assert (len(found) == 1 and said in found[0]) if said else not found


def test_three_columns_given_to_init_are_refused_by_name(tmp_path):
    rows = [f"{t},{x},{x},{x}" for t, x in zip(TIMES, swing(TIMES), strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["t,a,b,c", *rows]))
    with pytest.raises(InputError, match="'columns' names 3 channels, a, b, c; a rig has one, or when coupled two"):
        init_campaign(
            tmp_path / "rig", [tmp_path / "a.csv"], columns=["a", "b", "c"], time="t", kind="translational",
            quantity="displacement", primary_inertia=1.0, secondary_inertia=1.0, k1t=36.0, theta0=100.0,
        )  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "own", "other"),
    [
        (
            "translational",
            ("# J1, mass of body 1, kg;", "0.1 mm, or 2 %", "theta0_std_mm"),
            ("kg m^2", "N m/rad", " deg", "angle"),
        ),
        (
            "torsional",
            ("# J1, inertia of body 1, kg m^2;", "0.1 deg, or 2 %", "theta0_std_deg"),
            ("(kg)", "(N/m)", " mm"),
        ),
    ],
)
def test_what_init_writes_speaks_of_one_kind_of_rig(tmp_path, kind, own, other):
    rows = [f"{t},{x}" for t, x in zip(TIMES, swing(TIMES), strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["t,a", *rows]))
    theta0 = 100.0 if kind == "translational" else 5.73
    folder = init_campaign(
        tmp_path / "rig", [tmp_path / "a.csv"], columns=["a"], time="t", kind=kind, quantity="displacement",
        primary_inertia=1.0, k1t=36.0, theta0=theta0,
    )  # fmt: skip
    written = (folder / "campaign.toml").read_text(encoding="utf-8")
    assert all(words in written for words in own)
    assert not any(words in written for words in other)


@pytest.mark.parametrize("jitter", [0.0, 0.05, 0.3, 0.45])
def test_the_noise_of_readings_does_not_grow_with_the_jitter_of_their_clock(jitter):
    """By differences of readings a clock of 5 % had shown four times the noise of a clean displacement."""
    rng = np.random.default_rng(1)
    times = np.arange(1001) / 1000.0 + jitter / 1000.0 * rng.uniform(-1.0, 1.0, 1001)
    y = 0.08 * np.exp(-2.0 * times) * np.cos(58.0 * times) + 2e-5 * rng.standard_normal(1001)
    assert look.noise_floor_of(y, times) == pytest.approx(2e-5, rel=0.1)
    assert look.noise_floor_of(1e9 * y, times) == pytest.approx(2e4, rel=0.1)


@pytest.mark.parametrize("noise", [1e-6, 2e-5, 1e-3])
@pytest.mark.parametrize("rate", [200.0, 1000.0])
def test_the_noise_of_readings_does_not_grow_with_those_that_are_lost(noise, rate):
    """Of an even clock 5 % were lost at random: a clean displacement had shown 1.6 times its noise."""
    times = np.arange(2001) / rate
    for seed in range(5):
        rng = np.random.default_rng(seed)
        y = 0.08 * np.exp(-2.0 * times) * np.cos(58.0 * times) + noise * rng.standard_normal(2001)
        kept = rng.random(2001) > 0.05
        whole, left = (
            noise_floor(SimpleNamespace(times=times[k], channels=y[None, k])) for k in (np.ones(2001, bool), kept)
        )
        assert left == pytest.approx(whole, rel=0.1)


def clocks(kind, share, seed):
    """Times of 1001 readings at 1 kHz: stamps or steps have jitter (a share of a step), or some are lost."""
    rng, even = np.random.default_rng(seed), np.arange(1001.0)
    if kind == "stamps":
        times = np.sort(even + share * rng.standard_normal(1001))
    elif kind == "steps":
        times = np.cumsum(np.exp(share * rng.standard_normal(1001) - 0.5 * share**2))
    elif kind == "whole":  # of a logger of 700 Hz
        times = np.round(even / 0.7)
    else:
        times = (even + 0.05 * rng.uniform(-1.0, 1.0, 1001))[rng.random(1001) > share]
    return 1e-3 * (times - times[0])


@pytest.mark.parametrize(
    ("kind", "share", "rate", "said"),
    [
        ("stamps", 0.05, 1000, {"uneven"}), ("stamps", 0.3, 1000, {"uneven"}), ("stamps", 0.45, 1000, {"uneven"}),
        ("steps", 0.05, 1000, {"uneven"}), ("steps", 0.3, 1000, {"uneven"}), ("whole", 0.0, 700, set()),
        ("steps", 0.3, 800, {"uneven", "says"}), ("lost", 0.05, 1000, {"uneven", "gap", "single"}),
        ("lost", 0.3, 1000, {"uneven", "gap", "missing"}),
    ],
)  # fmt: skip
def test_a_clock_with_jitter_has_no_other_rate_and_lacks_no_readings(kind, share, rate, said):
    """Stamps and steps; what is lost is missing, at the declared rate."""
    for seed in range(5):
        head = SimpleNamespace(measurement=SimpleNamespace(sample_rate=rate))
        warnings = []
        _look_at_clock(head, SimpleNamespace(times=clocks(kind, share, seed), file="f"), warnings)
        words = ("says", "uneven", "gap", "single", "missing")
        assert {next(w for w in words if w in sentence) for sentence in warnings} == said


def test_a_slow_swing_at_the_end_of_a_record_is_no_offset():
    """An acceleration whose last quarter is less than one swing of its slow mode; a level beside it is found."""
    times = np.arange(1001) / 1000.0
    slow, fast = np.exp(-0.6 * times) * np.cos(17.2 * times), np.exp(-6.0 * times) * np.cos(60.0 * times)
    y = 30.0 * slow + 60.0 * fast + 2.0 * np.random.default_rng(3).standard_normal(1001)
    noise = look.noise_floor_of(y)
    for shift in (0.0, 0.1, 0.2):
        until = times <= 1.0 - shift
        assert look.offset_of(times[until], y[until], noise, 58.0) == 0.0
    assert look.offset_of(times, y + 20.0, noise, 58.0) == pytest.approx(20.0, abs=3.0)


@pytest.mark.parametrize("digits", [3, 4, 9])
@pytest.mark.parametrize("count", [150, 300, 2000])
def test_an_encoder_is_quantised_in_however_many_digits_it_was_written(digits, count):
    """Steps of one degree are 0.017 or 0.018 rad; of 150 readings two in three are values of their own."""
    y = np.round(np.degrees(swing(np.linspace(0.0, 20.0, count), 2.5))) * math.pi / 180.0
    found = look.resolution_of(np.round(y, digits) - 0.1234567, distinct=0.9)
    assert found == pytest.approx(math.pi / 180.0, rel=4e-3)


def test_what_lies_on_no_steps_is_not_called_quantised():
    rng = np.random.default_rng(3)
    for count in (60, 150, 1000):
        y = swing(np.linspace(0.0, 20.0, count), 2.5)
        assert look.resolution_of(y, distinct=1.0) == 0.0
        coarse = np.where(np.abs(y) < 0.5, np.round(y / 6.1e-5) * 6.1e-5, np.round(y, 3))  # two ranges of one sensor
        some = np.concatenate([coarse, coarse[rng.integers(0, count, 2 * count)]])
        assert look.resolution_of(some) == 0.0 or look.resolution_of(some) == pytest.approx(6.1e-5, rel=0.01)


def test_stretches_shorter_than_three_swings_show_no_frequency(tmp_path):
    """100 ms of readings and 100 ms without, in turns, of a rig with a period of 108 ms."""
    folder = write_synthetic(tmp_path, configurations=("uncoupled",))
    for path in folder.glob("trials/*.csv"):
        names, columns = read_table(path)
        kept = np.round(columns[0] * 1000.0) // 100 % 2 == 0
        write_table(path, names, [column[kept] for column in columns])
    warnings = load_campaign(folder).warnings
    assert any("5 gaps in time" in w for w in warnings)
    assert not [w for w in warnings if "swings at another frequency" in w]


def test_a_sensor_that_stands_still_at_the_largest_motion_is_not_in_another_unit(tmp_path):
    """Accelerations of a motion that has nearly died when the sensor begins to read."""
    folder = write_synthetic(tmp_path, configurations=("uncoupled",), noise=0.5)
    for path in folder.glob("trials/*.csv"):
        names, (times, y) = read_table(path)
        write_table(path, names, [times, np.where(times < 0.9, 0.0, y)])
    warnings = load_campaign(folder).warnings
    assert any("stands still at 0" in w for w in warnings)
    assert not [w for w in warnings if "the largest reading" in w]


def test_readings_that_are_lost_make_no_level_of_rest():
    """An oscillation cancels over time, not over readings; where a stretch of it is lost, it does not cancel."""
    times = np.arange(0.0, 1.0, 1e-3)
    y = 5.0 * np.exp(-1.5 * times) * np.cos(45.0 * times)
    in_stretches = (times // 0.1) % 2 == 0
    for seed in range(30):
        rng = np.random.default_rng(seed)
        noise = rng.normal(0.0, 0.03, times.size)
        for kept in (rng.random(times.size) < 0.3, np.roll(in_stretches, 7 * seed)):
            t, x = times[kept], (y + noise)[kept]
            assert look.offset_of(t, x, look.noise_floor_of(x, t), 45.0) == 0.0
        t = times[rng.random(times.size) < 0.5]
        x = np.interp(t, times, y + noise + 0.8)
        assert look.offset_of(t, x, 0.03, 45.0) == pytest.approx(0.8, abs=0.15)


def test_a_sensor_that_stops_in_mid_swing_is_not_said_to_rest_there(tmp_path):
    y, zero = noisy(1, swing(TIMES, 0.1, 0.1)), noisy(1, swing(TIMES, 0.1, 0.1)) + 0.02
    peak = TIMES.size - 75 + int(np.argmax(y[-75:-45]))
    for x in (y, zero):
        x[peak : peak + 35] = x[peak]
    found = cart(tmp_path / "stops", [y, noisy(2, swing(TIMES, 0.1, 0.1))])
    assert any("stands still" in w for w in found)
    assert not any("rests at" in w for w in found)
    assert any("rests at" in w for w in cart(tmp_path / "zero", [zero, noisy(2, swing(TIMES, 0.1, 0.1))]))
