"""What records of two carts show of what is declared: where they stand at the release, channels, signs, units."""

from __future__ import annotations

import re
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from campaigns import read_table, write_synthetic, write_table
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from bayes_damper.campaign import load_campaign
from bayes_damper.campaign.balance import _stretch
from bayes_damper.campaign.declarations import _moving
from bayes_damper.cli import main
from bayes_damper.errors import InputError

M1, M2, K1, K2, C1, C2, C3 = 1.8, 0.9, 900.0, 150.0, 5.0, 3.0, 1.0
STEP, HELD = 2e-3, 10
TIMES = np.arange(-HELD, 1500) * STEP


def decay(x2, mm=20.0):
    """Displacements of both carts, the second released from `x2` times the first's; (2, n) m, held before t = 0."""
    masses = np.array([[M1], [M2]])
    stiffness = np.array([[K1 + K2, -K2], [-K2, K2]]) / masses
    damping = np.array([[C1 + C2, -C2], [-C2, C2 + C3]]) / masses
    step = expm(STEP * np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -damping]]))
    state = 1e-3 * mm * np.array([1.0, x2, 0.0, 0.0])
    found = [state[:2]] * HELD
    for _ in TIMES[HELD:]:
        found.append(state[:2])
        state = step @ state
    return np.array(found).T


@cache
def rubbing(x2, mm):
    """As `decay`, with a spring that hardens and bearings that rub."""

    def rates(_, y):
        (p, q), (v, w) = y[:2], y[2:]
        pull = K2 * (p - q) + C2 * (v - w)
        first = -K1 * p * (1.0 + 150.0 * p * p) - C1 * v - 0.6 * np.tanh(v / 2e-4) - pull
        return [v, w, first / M1, (pull - C3 * w - 0.6 * np.tanh(w / 2e-4)) / M2]

    times = np.maximum(TIMES, 0.0)
    found = solve_ivp(rates, (0.0, times[-1]), [1e-3 * mm, 1e-3 * mm * x2, 0.0, 0.0], "LSODA", rtol=1e-8, atol=1e-10,
                      dense_output=True)  # fmt: skip
    return found.sol(times)[:2]


def carts(
    folder, x2=1.0, change=lambda y: y, mm=20.0, declared=20.0, begin=0, end=None, m1=M1, m2=M2, k1=K1, start="rest",
    rig=decay,
):  # fmt: skip
    """Warnings of three coupled trials, changed by `change`; begin, end : of the readings that are kept."""
    rng = np.random.default_rng(1)
    folder.mkdir(parents=True)
    (folder / "campaign.toml").write_text(
        f'name = "carts"\n[rig]\nkind = "translational"\nprimary_inertia = {m1}\nsecondary_inertia = {m2}\n'
        f'[measurement]\nquantity = "displacement"\nstart = "{start}"\n'
    )
    (folder / "priors.toml").write_text("mu = 0.0\n")
    rows = ["file,case,configuration,k1_n_per_m,theta0_mm,trial"]
    for k in range(3):
        y = change(rig(x2, mm) + rng.normal(0.0, 5e-6, (2, TIMES.size)))
        lines = ["time_s,x1_m,x2_m", *(f"{t:.6g},{a!r},{b!r}" for t, a, b in zip(TIMES, *y.tolist(), strict=True))]
        (folder / f"{k}.csv").write_text("\n".join(lines[:1] + lines[1:][begin:end]) + "\n")
        rows.append(f"{k}.csv,A,coupled,{k1},{declared if start == 'rest' else ''},{k + 1}")
    (folder / "trials.csv").write_text("\n".join(rows) + "\n")
    return " ".join(load_campaign(folder).warnings)


@pytest.mark.parametrize("begin", [0, HELD])
def test_a_second_body_that_is_not_held_beside_the_first_is_told_with_what_to_do(tmp_path, begin):
    said = carts(tmp_path / "apart", x2=0.0, begin=begin)
    assert "0.csv and 2 other coupled trials: at the release body 1 stands at 20 mm and body 2 at 0 mm" in said
    assert all(words in said for words in ("x2(0) = x1(0)", "without theta0", 'start = "free"'))
    assert "stands at" not in carts(tmp_path / "free", x2=0.0, begin=HELD, start="free")


@pytest.mark.parametrize("x2", [0.95, 1.0, 1.05])
@pytest.mark.parametrize("begin", [0, HELD])
def test_bodies_released_together_are_not_remarked_on(tmp_path, x2, begin):
    assert not carts(tmp_path / "sound", x2=x2, begin=begin)


@pytest.mark.parametrize("held", [10, 100, 400])
def test_a_rig_that_is_held_moves_from_its_release_on(held):
    """What holds it is no spring and no force between bodies: first swings had been too small, second channels late."""
    times = STEP * np.arange(-held, 1500)
    trial = SimpleNamespace(times=times, channels=np.where(times < 0.0, 0.02, 0.02 * np.cos(20.0 * times))[None])
    assert _moving(trial)[0] == pytest.approx(0.0, abs=1e-9)
    assert _stretch(trial)[0] == pytest.approx(2.0 * STEP, abs=1e-9)


def test_zeros_of_the_sensors_do_not_set_the_bodies_apart(tmp_path):
    assert "stands at" not in carts(tmp_path / "zeros", change=lambda y: y + np.array([[8e-3], [-6e-3]]))


def turned(first, second):
    return lambda y: y * np.array([[first], [second]])


@pytest.mark.parametrize("x2", [0.0, 1.0])
@pytest.mark.parametrize(
    ("change", "said"),
    [(lambda y: y[::-1], "the channels look exchanged"), (turned(1.0, -1.0), "its sign looks reversed")],
    ids=["exchanged", "second turned"],
)
def test_channels_are_judged_wherever_the_second_body_was_released(tmp_path, x2, change, said):
    found = carts(tmp_path / "wrong", x2, change)
    assert said in found
    assert "stands at" not in found
    assert said not in carts(tmp_path / "right", x2)


@pytest.mark.parametrize("begin", [0, HELD])
def test_a_reversed_channel_is_named_where_noise_hides_how_the_second_body_begins(tmp_path, begin):
    """By where it stands at the release; of a reversed first channel nothing says that it is the second."""
    noise = np.random.default_rng(2).normal(0.0, 5e-4, (2, TIMES.size))
    found = carts(tmp_path / "second", change=lambda y: turned(1.0, -1.0)(y + noise), begin=begin)
    assert found.count("at the release the second channel stands as far on the other side of 0 as body 1") == 3
    assert "stands at" not in found
    found = carts(tmp_path / "first", change=lambda y: turned(-1.0, 1.0)(y + noise), begin=begin)
    assert "the sign of the channel looks reversed" in found
    assert "sign of the second" not in found


def test_an_entry_that_a_free_start_leaves_empty_is_told_once_for_all_lines(tmp_path, capsys):
    carts(tmp_path / "rig")
    head = tmp_path / "rig" / "campaign.toml"
    head.write_text(head.read_text().replace('"rest"', '"free"'))
    assert main(["check", str(tmp_path / "rig")]) == 2
    said = capsys.readouterr().err
    assert said.startswith('bayes-damper check: trials.csv, lines 2 to 4: theta0_mm is given but start = "free"; empty')
    assert said.count("\n") == 1


@pytest.mark.parametrize("x2", [0.0, 1.0])
@pytest.mark.parametrize(
    ("scale", "m2", "said"),
    [
        (1e3, M2, r"about 0\.00\d+ kg in case A, not with the declared 0\.9: .* in thousandths of the declared unit"),
        (1e-3, M2, "not with the declared 0.9: .* a thousand times too small in the declared unit"),
        (1.0, 1e3 * M2, r"about [01]\.\d+ kg in case A, not with the declared 900: correct it \(is it in kg\?\)"),
    ],
    ids=["um as mm", "mm as um", "g as kg"],
)
def test_another_unit_of_the_second_body_shows_beside_friction_and_a_hard_spring(tmp_path, x2, scale, m2, said):
    """A warning, or an error where friction leaves the sum of forces explained by more than 95 %."""
    try:
        found = carts(tmp_path / "wrong", x2, turned(1.0, scale), m2=m2, rig=rubbing)
    except InputError as error:
        found = str(error)
    assert re.search(said, found)


@pytest.mark.parametrize("m2", [0.5 * M2, M2, 3.0 * M2])
def test_friction_and_a_hard_spring_are_no_other_unit(tmp_path, m2):
    found = carts(tmp_path / "sound", m2=m2, rig=rubbing)
    assert ("add up" in found) == (m2 != M2)
    assert "is it in kg" not in found
    about = re.search(r"only with a secondary_inertia of about (\S+) kg", found)
    assert about is None or 0.7 * M2 < float(about.group(1)) < 1.3 * M2


@pytest.mark.parametrize("kept", [2, HELD])
@pytest.mark.parametrize("x2", [0.0, 1.0])
def test_a_first_channel_turned_round_is_told_after_few_readings_at_rest(tmp_path, x2, kept):
    found = carts(tmp_path / "wrong", x2, turned(-1.0, 1.0), begin=HELD - kept)
    assert "0.csv: body 1 is held on the other side of 0 than theta0" in found
    assert "the trigger came" not in found


def test_a_record_that_begins_at_the_far_turning_point_is_not_called_turned_round(tmp_path):
    """A few readings about it lie nearly still, as those of a held rig do."""
    far = int(np.argmin(decay(1.0)[0])) - HELD // 2
    found = carts(tmp_path / "late", change=lambda y: np.roll(y, -far, axis=1), end=TIMES.size - far)
    assert "other side of 0" not in found


@pytest.mark.parametrize(("mm", "told"), [(12.0, True), (18.0, True), (20.0, False)])
def test_a_rig_held_elsewhere_than_declared_is_said_to_be(tmp_path, mm, told):
    found = carts(tmp_path / "carts", mm=mm)
    assert (f"0.csv: before the release body 1 stands {mm:g} mm from 0, not 20 mm as theta0 says" in found) == told
    assert "the trigger came" not in found


@pytest.mark.parametrize("units", [{"m1": 1e3 * M1, "m2": 1e3 * M2}, {"k1": 1e-3 * K1}], ids=["g as kg", "N/mm as N/m"])
def test_a_record_too_short_for_its_declared_period_names_the_unit(tmp_path, units):
    with pytest.raises(InputError, match=r"is less than one natural period.*: g taken for kg, or N/mm for N/m\?"):
        carts(tmp_path / "carts", **units)


@pytest.mark.parametrize(("declared", "unit"), [(0.02, "metres"), (2e4, "micrometres")])
def test_another_unit_of_a_release_in_millimetres_is_named(tmp_path, declared, unit):
    """The record was said to be in millimetres, whose largest reading is 2 cm; and micrometres to be metres."""
    with pytest.raises(InputError, match=f"it looks like {unit} given for theta0, which is in mm"):
        carts(tmp_path / "carts", declared=declared)


def test_a_record_that_is_too_short_gets_no_guess(tmp_path):
    with pytest.raises(InputError) as error:
        carts(tmp_path / "carts", end=HELD + 100)
    assert "less than one natural period" in str(error.value)
    assert "taken for" not in str(error.value)


def test_a_first_channel_that_is_cut_off_is_not_called_exchanged(tmp_path):
    """Of two bodies that move as one."""
    found = carts(tmp_path / "cut", change=lambda y: np.stack([np.clip(y[0], -0.01, 0.01), y[0]]), begin=HELD)
    assert "it looks clipped" in found
    assert "look exchanged" not in found


def test_a_second_channel_that_reads_ten_times_too_much_is_not_called_exchanged(tmp_path):
    folder = write_synthetic(tmp_path)
    for path in folder.glob("trials/*_coupled_*.csv"):
        names, columns = read_table(path)
        write_table(path, names, [*columns[:2], 9.81 * columns[2]])
    assert not any("look exchanged" in w for w in load_campaign(folder).warnings)


def test_a_record_that_begins_before_a_hand_lifts_the_rig_is_said_to(tmp_path):
    """The clock begins at 0 and the release is at 0.6 s."""

    def lifted(y):
        hand = np.interp(TIMES, [0.0, 0.3, 0.5, 0.6], [0.0, 0.0, 1.0, 1.0]) * y[:, HELD : HELD + 1]
        return np.where(TIMES < 0.6, hand, np.roll(y, 300, axis=1))

    found = carts(tmp_path / "lifted", change=lifted, begin=HELD)
    assert "the motion grows until" in found
    assert "put t = 0 there and take off what is read before" in found
    assert "begins after the motion began" not in found
    assert "grows" not in carts(tmp_path / "sound", begin=HELD)


def test_displacements_that_are_zero_until_the_logger_begins_are_not_called_exchanged(tmp_path):
    """Then both leap to where the bodies are by then."""
    for until in range(HELD + 20, HELD + 200, 20):

        def change(y, until=until):
            return np.where(np.arange(TIMES.size) < until, 0.0, y)

        found = carts(tmp_path / str(until), change=change, begin=HELD)
        assert "stands still at 0" in found
        assert "exchanged" not in found


@pytest.mark.parametrize("held", [0, 50])
def test_two_bodies_that_a_hand_lifts_before_a_free_start_are_not_called_clipped(tmp_path, held):
    """The lift is slower than the rig swings, which was taken for the rig's own frequency."""
    lift = np.concatenate([np.zeros(300), np.linspace(0.0, 1.0, 100), np.ones(held)])

    def change(y):
        rng = np.random.default_rng(3)
        return np.hstack([0.02 * lift + rng.normal(0.0, 2e-5, (2, lift.size)), y[:, HELD:]])[:, : TIMES.size]

    def damped(x2, mm):
        return decay(x2, mm) * np.exp(-8.0 * np.maximum(TIMES, 0.0))

    found = carts(tmp_path / "lifted", change=change, start="free", rig=damped)
    assert found.count("a hand moves it, before it is let go") == 3
    assert "clipped" not in found
    for x2 in (0.0, 1.0, -1.0):
        assert "before it is let go" not in carts(tmp_path / f"free{x2}", x2, begin=HELD, start="free")
