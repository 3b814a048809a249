"""Numbers that are certainly wrong: an error where nothing sensible can follow, else a warning with its cause."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from campaigns import CAMPAIGN_TOML, read_table, write_table
from small_rig import RIG

from bayes_damper.campaign import Campaign, load_campaign
from bayes_damper.campaign.importer import init_campaign
from bayes_damper.errors import InputError
from bayes_damper.simulation.model import Model


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two coupled and two uncoupled trials of a rig whose bodies obey the equations."""
    folder = tmp_path_factory.mktemp("sound")
    (folder / "trials").mkdir()
    (folder / "campaign.toml").write_text(CAMPAIGN_TOML, encoding="utf-8")
    rows = ["file,case,configuration,k1t_n_m_per_rad,theta0_deg,trial"]
    times = np.arange(1000) / 1000.0
    rng = np.random.default_rng(1)
    for configuration in ("uncoupled", "coupled"):
        for number in (1, 2):
            y = Model(configuration == "coupled").simulate({**RIG, "k1t": 10.2, "theta0": 0.082}, times).y[0]
            names = ["time_s", "alpha1_rad_s2", "alpha2_rad_s2"][: 1 + len(y)]
            name = f"trials/{configuration}_{number}.csv"
            write_table(folder / name, names, [times, *(y + 2.0 * rng.standard_normal(y.shape))])
            rows.append(f"{name},IV,{configuration},10.2,4.7,{number}")
    (folder / "trials.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder


@pytest.fixture
def folder(sound: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(sound, tmp_path / "campaign"))


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def read(folder: Path) -> Campaign:
    return load_campaign(folder)


def test_a_sound_campaign_has_no_remark(folder):
    assert read(folder).warnings == ()


@pytest.mark.parametrize("factor", [3.0, 1000.0, 0.3, 1e-3])
def test_an_inertia_that_balances_no_torques_is_named_with_the_one_that_does(folder, factor):
    edit(folder / "campaign.toml", "secondary_inertia = 2.474e-3", f"secondary_inertia = {2.474e-3 * factor!r}")
    (told,) = [w for w in read(folder).warnings if "add up to zero" in w]
    found = float(told.partition("secondary_inertia of ")[2].partition(" ")[0])
    assert found == pytest.approx(2.474e-3, rel=0.15)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda t, y: 0.1 * y, "in m/s^2 at the bar's end"),
        (lambda t, y: 1e-3 * y, "a thousand times too small"),
        (lambda t, y: 57.3 * y, "in degrees"),
        (lambda t, y: 2.0 * y, "reads 2"),
        (lambda t, y: np.interp(t - 0.02, t, y), "ms late"),
        (lambda t, y: np.interp(t + 0.02, t, y), "ms early"),
        (lambda t, y: 2.0 * np.random.default_rng(3).standard_normal(y.size), "nothing but noise"),
        (lambda t, y: np.where((t > 0.2) & (t < 0.3), y[200], y), "stands still at"),
        (lambda t, y: np.where((t > 0.05) & (t < 0.15), 0.0, y), "stands still at 0 from 0.051 to 0.149 s"),
    ],
)
def test_a_second_channel_that_cannot_be_is_named_with_its_cause(folder, change, told):
    for path in folder.glob("trials/coupled_*.csv"):
        names, columns = read_table(path)
        write_table(path, names, [*columns[:2], change(columns[0], columns[2])])
    assert any(told in w for w in read(folder).warnings), read(folder).warnings


@pytest.mark.parametrize("factor", [1.0, -0.5])
def test_a_copy_of_the_first_channel_is_an_error(folder, factor):
    path = folder / "trials/coupled_1.csv"
    names, columns = read_table(path)
    write_table(path, names, [*columns[:2], factor * columns[1]])
    with pytest.raises(InputError, match=r"column 'alpha2_rad_s2' is .*column 'alpha1_rad_s2', noise and all"):
        read(folder)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("primary_inertia = 3.015e-3", "primary_inertia = { value = 3.015e-3, std = 3.0 }", "as large as the value"),
        ('quantity = "acceleration"', 'quantity = "acceleration"\nscale_std = 1.5', "scale_std is relative"),
        ('quantity = "acceleration"', 'quantity = "acceleration"\nlag_std = 20', "lag_std is as long as"),
        ('quantity = "acceleration"', 'quantity = "acceleration"\nevery = 60', "every = 60 leaves 16 readings"),
    ],
)
def test_what_nothing_sensible_can_follow_from_is_an_error(folder, old, new, told):
    edit(folder / "campaign.toml", old, new)
    with pytest.raises(InputError, match=told):
        read(folder)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("magnet_radius = 0.0127", "magnet_radius = 0.127", "is not smaller than bar_radius"),
        (
            'quantity = "acceleration"',
            'quantity = "acceleration"\nsensor_bandwidth = 1',
            "below the rig's own frequency",
        ),
    ],
)
def test_what_is_hardly_so_is_a_warning(folder, old, new, told):
    edit(folder / "campaign.toml", old, new)
    assert any(told in w for w in read(folder).warnings)


def test_a_spring_less_known_than_large_is_an_error(folder):
    edit(folder / "trials.csv", "k1t_n_m_per_rad,theta0_deg", "k1t_n_m_per_rad,k1t_std_n_m_per_rad,theta0_deg")
    edit(folder / "trials.csv", ",10.2,4.7", ",10.2,12,4.7")
    with pytest.raises(InputError, match="the uncertainty of the spring, 12, is as large as the spring itself"):
        read(folder)


def test_time_in_microseconds_is_an_error(folder):
    for path in folder.glob("trials/*.csv"):
        names, columns = read_table(path)
        write_table(path, names, [1e6 * columns[0], *columns[1:]])
    with pytest.raises(InputError, match="the time column is in milliseconds or microseconds"):
        read(folder)


def test_missing_readings_are_counted(folder):
    path = folder / "trials/coupled_1.csv"
    names, columns = read_table(path)
    there = np.random.default_rng(1).random(columns[0].size) > 0.5
    write_table(path, names, [c[there] for c in columns])
    (told,) = [w for w in read(folder).warnings if "are missing" in w]
    assert 0.4 < float(told.split(": ")[1].split("%")[0]) / 100.0 < 0.6


def test_a_reversed_primary_is_named_after_a_rest_of_half_a_radian(folder):
    """What `init --release find` keeps before the release, 20 ms, is 1.2 rad at 9.3 Hz; 10 ms of it are enough."""
    for path in folder.glob("trials/uncoupled_*.csv"):
        names, (times, y) = read_table(path)
        rest = 2.0 * np.random.default_rng(5).standard_normal(12)
        early = np.concatenate([np.arange(-12, 0) / 1000.0, times])
        write_table(path, names, [early, -np.concatenate([rest, y])])
    told = [w for w in read(folder).warnings if "the sign of the channel looks reversed" in w]
    assert len(told) == 2


def test_a_stretch_that_was_held_out_may_be_short(folder):
    path = folder / "trials/coupled_2.csv"
    names, columns = read_table(path)
    write_table(path, names, [c[:500] for c in columns])
    assert any("was one cut off" in w for w in read(folder).warnings)
    rows = (folder / "trials.csv").read_text(encoding="utf-8").splitlines()
    marked = [f"{rows[0]},holdout", *(f"{row},{str(row.startswith('trials/coupled_2')).lower()}" for row in rows[1:])]
    (folder / "trials.csv").write_text("\n".join(marked) + "\n", encoding="utf-8")
    assert not any("was one cut off" in w for w in read(folder).warnings)


def test_the_rate_of_a_thinned_import_is_that_of_its_records(folder, tmp_path):
    source = folder / "trials/uncoupled_1.csv"
    made = init_campaign(
        tmp_path / "thinned", [source], columns=[2], time=1, sample_rate=1000.0, every=5, primary_inertia=3.015e-3,
        k1t=10.2, theta0=4.7,
    )  # fmt: skip
    found = load_campaign(made)
    assert found.measurement.sample_rate == 200.0
    assert not any("sample_rate says" in w for w in found.warnings)


def test_a_pendulum_that_hangs_at_half_a_turn_is_named(tmp_path):
    times = np.arange(1000) / 100.0
    y = np.pi + 0.5 * np.exp(-times) * np.cos(6.0 * times) + 1e-3 * np.random.default_rng(1).standard_normal(1000)
    source = tmp_path / "swing.csv"
    write_table(source, ["t", "angle"], [times, y])
    made = init_campaign(
        tmp_path / "rig", [source], columns=["angle"], time="t", quantity="displacement", primary_inertia=1.0, k1t=36.0
    )
    assert any("half a turn: it may count from the upper position" in w for w in load_campaign(made).warnings)


@pytest.mark.parametrize(("rate", "every"), [("abc", 2), (1000.0, "x"), (1000.0, 0), (True, 2), (0, 2), (1e999, 2)])
def test_a_rate_that_cannot_be_divided_is_refused_with_a_sentence(folder, tmp_path, rate, every):
    source = folder / "trials/uncoupled_1.csv"
    with pytest.raises(InputError):
        init_campaign(tmp_path / "new", [source], columns=[2], time=1, sample_rate=rate, every=every)
