"""Reading a campaign: every fault gets its sentence, every oddity its warning, and a sound one comes back whole."""

from __future__ import annotations

import gzip
import math
import re
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from campaigns import decay, read_table, write_synthetic, write_table
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from bayes_damper.calibration import Problem, experiment_of
from bayes_damper.calibration.scatter import typical_scatter
from bayes_damper.campaign import Constant, load_campaign, noise_floor, write_campaign
from bayes_damper.campaign.structure import SCATTER_RELATIVE, SCATTER_SIZES
from bayes_damper.commands.check import check
from bayes_damper.errors import InputError
from bayes_damper.fit import recorded_experiment

FIRST = "trials/IV_uncoupled_1.csv"
COUPLED = "trials/IV_coupled_1.csv"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_synthetic(tmp_path / "campaign")


def faults_of(folder: Path) -> list[str]:
    with pytest.raises(InputError) as caught:
        load_campaign(folder)
    return list(caught.value.faults)


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def edit_all(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")


def alter(path: Path, change: Callable[[list[np.ndarray]], list[np.ndarray]]) -> None:
    names, columns = read_table(path)
    write_table(path, names, change(columns))


def test_a_sound_campaign_gives_no_warning(folder: Path) -> None:
    campaign = load_campaign(folder)
    assert campaign.warnings == ()
    assert campaign.cases == ("IV",)
    assert sum(trial.coupled for trial in campaign.trials) == 3
    first = campaign.trials[0]
    assert first.channels.shape == (1, 1001)
    assert first.theta0 is not None
    assert first.theta0.value == pytest.approx(math.radians(4.7))
    assert first.theta0.std == pytest.approx(math.radians(0.1))
    assert campaign.measurement.noise_std == (2.0, 2.0)
    assert len(campaign.sha256) == 64


def test_of_very_many_readings_fits_use_some_and_say_so(tmp_path: Path) -> None:
    """20 kHz for two seconds: `every` under [measurement] decides; without it one reading in so many, and a warning."""
    folder = write_synthetic(tmp_path / "fast", rate=20000.0, duration=2.0, repeats=2)
    edit(folder / "campaign.toml", "sample_rate = 1000.0", "sample_rate = 20000.0")
    campaign = load_campaign(folder)
    assert campaign.trials[0].times.size == 40001
    (told,) = campaign.warnings
    assert "240006 readings" in told
    assert "one in 14" in told
    kept = experiment_of(campaign).trials[0]
    assert np.array_equal(kept.times, campaign.trials[0].times[::14])
    assert np.array_equal(kept.y, campaign.trials[0].channels[:, ::14])
    edit(folder / "campaign.toml", "[measurement]", "[measurement]\nevery = 1")
    whole = load_campaign(folder)
    assert whole.warnings == ()
    assert experiment_of(whole).trials[0].y.shape == (1, 40001)
    edit(folder / "campaign.toml", "every = 1", "every = 40")
    assert experiment_of(load_campaign(folder)).trials[0].y.shape == (1, 1001)
    edit(folder / "campaign.toml", "every = 40", "every = 2.5")
    assert faults_of(folder) == ["campaign.toml [measurement]: every must be one whole number"]


def test_the_last_trial_of_each_group_is_held_out_unless_marked(folder: Path) -> None:
    assert {t.key for t in load_campaign(folder).heldout} == {("IV", "uncoupled", 3), ("IV", "coupled", 3)}
    lines = (folder / "trials.csv").read_text().splitlines()
    marked = [lines[0] + ",holdout", lines[1] + ",true", *(line + "," for line in lines[2:])]
    (folder / "trials.csv").write_text("\n".join(marked))
    campaign = load_campaign(folder)
    assert [t.key for t in campaign.heldout] == [("IV", "uncoupled", 1)]
    assert len(campaign.training) == 5


def test_a_campaign_of_which_every_trial_is_held_out_is_refused(folder: Path) -> None:
    lines = (folder / "trials.csv").read_text().splitlines()
    (folder / "trials.csv").write_text("\n".join([lines[0] + ",holdout", *(line + ",true" for line in lines[1:])]))
    (fault,) = faults_of(folder)
    assert fault.startswith("trials.csv: every trial is marked holdout, so nothing is left to fit")


@pytest.mark.parametrize(("end", "said"), [(-100.0, "no reading lies behind it"), (0.05, "s lie behind it")])
def test_a_clock_that_begins_long_before_the_release_is_named(folder: Path, end: float, said: str) -> None:
    """It had been told how many times too small k1t/J1 is: 1."""
    trial = load_campaign(folder).trials[0]
    file = folder / trial.file
    head, *rows = file.read_text().splitlines()
    later = [row.partition(",") for row in rows]
    shift = end - float(trial.times[-1])
    file.write_text("\n".join([head, *(f"{float(t) + shift!r},{rest}" for t, _, rest in later)]))
    (fault,) = faults_of(folder)
    assert said in fault
    assert "put t = 0 at the release, as `bayes-damper init --release find` does" in fault
    assert "times too small" not in fault


def test_what_is_said_of_the_use_of_trials_is_what_the_commands_do(folder: Path) -> None:
    """`fit` uses all trials that are not marked; `diagnose` and `variability` hold out the last of each group."""

    def told() -> list[str]:
        return [line for line in load_campaign(folder).describe().splitlines() if "held out" in line]

    def fitted() -> int:
        plan = {"campaign": str(folder), "priors": None, "cases": ["IV"], "normal_force": None}
        plan["campaign_sha256"] = load_campaign(folder).sha256
        return len(recorded_experiment(plan, "IV")[0].training)

    assert all("held out by diagnose and variability" in line for line in told())
    assert (len(told()), fitted(), len(experiment_of(load_campaign(folder)).training)) == (2, 6, 4)
    lines = (folder / "trials.csv").read_text().splitlines()
    (folder / "trials.csv").write_text(
        "\n".join([lines[0] + ",holdout", lines[1] + ",true", *(x + "," for x in lines[2:])])
    )
    assert [line.partition("noise")[2].partition(", ")[2] for line in told()] == ["held out of every fit"]
    assert (fitted(), len(experiment_of(load_campaign(folder)).training)) == (5, 5)


def test_what_is_written_reads_back_the_same(folder: Path, tmp_path: Path) -> None:
    campaign = load_campaign(folder)
    again = load_campaign(write_campaign(tmp_path / "copy", campaign))
    assert (again.name, again.rig, again.measurement) == (campaign.name, campaign.rig, campaign.measurement)
    for a, b in zip(campaign.trials, again.trials, strict=True):
        assert (a.key, a.k1t, a.theta0, a.holdout) == (b.key, b.k1t, b.theta0, b.holdout)
        assert np.array_equal(a.channels, b.channels)
    with pytest.raises(InputError, match="holds a campaign already"):
        write_campaign(tmp_path / "copy", campaign)


def test_sizes_of_scatter_are_read_and_reach_the_fit(folder: Path, tmp_path: Path) -> None:
    plain = experiment_of(load_campaign(folder))
    with (folder / "campaign.toml").open("a") as head:
        head.write("\n[scatter]\nk1t = 0.004\ngain = 0\ndrift2 = 0.25\nrelease_time = 1e-3\ntheta0_deg = 0.2\n")
    found = experiment_of(load_campaign(folder))
    assert found.scatter == {"k1t": 0.004, "gain": 0.0, "drift2": 0.25, "release_time": 1e-3}
    for before, after in zip(plain.trials, found.trials, strict=True):
        assert after.theta0_sd == pytest.approx(math.hypot(before.theta0_sd, math.radians(0.2)))
    assert load_campaign(write_campaign(tmp_path / "again", load_campaign(folder))).scatter == {
        **found.scatter,
        "theta0": math.radians(0.2),
    }
    sizes = {s.name: s.typical for s in typical_scatter(Problem(found), releases=True).sizes}
    assert {name: sizes[name] for name in ("k1t", "drift2", "release_time")} == {
        "k1t": 0.004,
        "drift2": 0.25,
        "release_time": 1e-3,
    }
    assert "gain1" not in sizes
    assert "gain2" not in sizes


def test_every_name_of_a_scatter_can_be_given(folder: Path) -> None:
    """What a result calls by a name is what the campaign calls so."""
    experiment = experiment_of(load_campaign(folder))
    names = {s.name for s in typical_scatter(Problem(experiment), releases=True).sizes}
    assert names == {*SCATTER_RELATIVE, *SCATTER_SIZES} - {"gain", "offset", "drift"}


@pytest.mark.parametrize(
    ("entry", "sentence"),
    [
        ("k1 = 0.002", r"campaign.toml \[scatter\]: nothing that scatters is called 'k1'; did you mean 'k1t'"),
        ("theta0_mm = 0.1", r"nothing that scatters is called 'theta0_mm'; did you mean 'theta0_deg'"),
        ("k1t = -0.002", r"\[scatter\]: k1t = -0.002 is negative; give a standard deviation"),
        ("mu = nan", r"\[scatter\]: mu"),
        ("mu = inf", r"\[scatter\]: mu"),
        ('mu = "5 %"', r"\[scatter\]: mu .*one number, a standard deviation from trial to trial"),
        ("mu = [0.05, 0.05]", r"\[scatter\]: mu .*one number"),
        ("c1t = 5", r"c1t = 5.* is relative: half a percent is 0.005"),
    ],
)
def test_faults_of_the_table_of_scatter(folder: Path, entry: str, sentence: str) -> None:
    with (folder / "campaign.toml").open("a") as head:
        head.write(f"\n[scatter]\n{entry}\n")
    (told,) = faults_of(folder)
    assert re.search(sentence, told)


def test_a_scatter_that_is_no_table_is_a_fault(folder: Path) -> None:
    edit(folder / "campaign.toml", "[rig]", "scatter = 0.002\n\n[rig]")
    assert any("'scatter' must be a table, [scatter]" in told for told in faults_of(folder))


def test_the_checksum_changes_with_any_byte(folder: Path) -> None:
    before = load_campaign(folder).sha256
    assert load_campaign(folder).sha256 == before
    with (folder / FIRST).open("a") as file:
        file.write("\n")
    assert load_campaign(folder).sha256 != before


def test_reading_a_full_campaign_is_fast(tmp_path: Path) -> None:
    cases = (("I", 6.2, 5.7), ("II", 6.2, 7.2), ("III", 10.2, 2.7), ("IV", 10.2, 4.7))
    write_synthetic(tmp_path, cases)
    start = time.process_time()
    assert len(load_campaign(tmp_path).trials) == 24
    assert time.process_time() - start < 1.0


def test_compressed_records_are_read(folder: Path) -> None:
    raw = (folder / FIRST).read_bytes()
    (folder / (FIRST + ".gz")).write_bytes(gzip.compress(raw))
    edit(folder / "trials.csv", FIRST, FIRST + ".gz")
    assert len(load_campaign(folder).trials) == 6
    (folder / (FIRST + ".gz")).write_bytes(gzip.compress(raw)[:-400])
    assert "not a whole gzip file" in faults_of(folder)[0]


TOML_FAULTS = [
    (
        "primary_inertia = 3.015e-3",
        "primary_inertai = 3.015e-3",
        "unknown key 'primary_inertai'; did you mean 'primary_inertia'?",
    ),
    ("primary_inertia = 3.015e-3", "primary_inertia = -3.015e-3", "primary_inertia = -0.003015 must be positive"),
    ("primary_inertia = 3.015e-3", "primary_inertia = '3'", "primary_inertia must be a number"),
    ("primary_inertia = 3.015e-3", "primary_inertia = true", "primary_inertia must be a number"),
    ("primary_inertia = 3.015e-3", "primary_inertia = nan", "primary_inertia must be finite"),
    ("bar_radius = 0.10", "bar_radius = 100.0", "it looks like millimetres"),
    ("bar_radius = 0.10", "", "bar_radius (R, m) is missing"),
    ("secondary_inertia = 2.474e-3", "", "secondary_inertia is missing"),
    ("bar_radius = 0.10", "bar_radius = {value = 0.1, sd = 0.01}", "unknown key 'sd'; did you mean 'std'?"),
    ("bar_radius = 0.10", "bar_radius = {value = 0.1, std = -0.01}", "std = -0.01 is negative"),
    ('"acceleration"', '"accelration"', "did you mean 'acceleration'?"),
    ('name = "synthetic"', "", "key 'name' is missing"),
    ("[rig]", "[rigg]", "unknown key 'rigg'; did you mean 'rig'?"),
    ("[rig]", "", "unknown key 'primary_inertia'; it belongs into the table [rig]"),
    ("noise_std = 2.0", "noise_std = -2.0", "noise_std = -2.0 must be positive"),
    ("[rig]", "[rig", "campaign.toml: not valid TOML"),
    ("bar_radius = 0.10", "bar_radius = 0.10\ninertial_coupling = 1.0", "no rig has such an inertia matrix"),
    (
        "bar_radius = 0.10",
        "bar_radius = 0.10\ninertial_coupling = {value = 1e-4, std = 3e-3}",
        "no rig has such an inertia matrix",
    ),
    (
        "bar_radius = 0.10",
        "bar_radius = 0.10\nground2_stiffness = {value = 0.1, std = 0.2}",
        "ground2_stiffness = 0.1 with std = 0.2: the uncertainty is as large as the value, which cannot be negative",
    ),
    ("noise_std = 2.0", "sensor_range = 1e29", "sensor_range is more than 1e+06 times the largest reading"),
    ("noise_std = 2.0", "sensor_range = 1e-9", "sensor_range is less than a millionth of the largest reading"),
    ("noise_std = 2.0", "every = 600", "every = 600 leaves 1 reading of trials/"),
]


@pytest.mark.parametrize(("old", "new", "sentence"), TOML_FAULTS)
def test_faults_of_campaign_toml(folder: Path, old: str, new: str, sentence: str) -> None:
    edit(folder / "campaign.toml", old, new)
    assert any(sentence in fault and "campaign.toml" in fault for fault in faults_of(folder))


TRIAL_FAULTS = [
    ("configuration,", "config,", "column 'configuration' is missing"),
    ("k1t_n_m_per_rad", "k1_n_per_m", "does not belong to a torsional rig; use 'k1t_n_m_per_rad'"),
    (f"{FIRST},IV,uncoupled", f"{FIRST},IV,uncopled", "line 2: configuration 'uncopled' is not uncoupled or coupled"),
    (FIRST, "../other.csv", "line 2: ../other.csv leaves the campaign's folder"),
    (FIRST, "/etc/hosts", "leaves the campaign's folder"),
    (FIRST, "trials/none.csv", "trials/none.csv (trials.csv, line 2): no such file"),
    (FIRST, FIRST.replace("/", "\\"), f"no such file; did you mean {FIRST}?"),
    (FIRST, FIRST.replace("IV", "iv"), f"no such file; did you mean {FIRST}?"),
    ("4.7,2", "4.7,1", "line 3: case IV, uncoupled, trial 1 is already on line 2"),
    ("10.2,4.7,1", "ten,4.7,1", "line 2, k1t_n_m_per_rad: 'ten' is not a number"),
    ("10.2,4.7,1", "10.2,,1", "line 2: theta0_deg is empty"),
    ("10.2,4.7,1", "10.2,4,7,1", "line 2: 7 fields where the header has 6; a field with a comma in it needs quotes"),
    ("10.2,4.7,1", "10.2,4.7", "line 2: 5 fields where the header has 6; fill in what is missing"),
    ("10.2,4.7,1", "-10.2,4.7,1", "k1t_n_m_per_rad = -10.2 must be positive"),
    ("10.2,4.7,1", "10.2,nan,1", "'nan' is not finite"),
    ("10.2,4.7,1", "10.2,4.7,1.5", "trial '1.5' is not a whole number"),
    ("10.2,4.7,1", "10.2,4.7,1e29", "line 2: trial '1e29' is not a whole number up to 9007199254740992; count from 1"),
    ("10.2,4.7,1", "10.2,0.082,1", "radians given for theta0, which is in degrees; or degrees taken for radians"),
]


@pytest.mark.parametrize(("old", "new", "sentence"), TRIAL_FAULTS)
def test_faults_of_trials_csv(folder: Path, old: str, new: str, sentence: str) -> None:
    edit(folder / "trials.csv", old, new)
    assert any(sentence in fault for fault in faults_of(folder))


@pytest.mark.parametrize(
    ("theta0", "std", "kind"),
    [("4.7", "5", "fault"), ("4.7", "1", None), ("0.08", "", "warning"), ("0.08", "0.09", "fault"), ("0.1", "", None)],
)
def test_a_release_less_certain_than_its_size(folder: Path, theta0: str, std: str, kind: str | None) -> None:
    """An error where that is declared; the least that is taken without a declaration may be as large."""
    table = (folder / "trials.csv").read_text().replace("theta0_deg,", "theta0_deg,theta0_std_deg,")
    (folder / "trials.csv").write_text(table.replace("10.2,4.7,", f"10.2,{theta0},{std},"))
    said = "case IV: theta0 is smaller than its standard uncertainty"
    if kind == "fault":
        assert any(said in fault for fault in faults_of(folder))
    else:
        for trial in (folder / "trials").iterdir():
            alter(trial, lambda c: [c[0], *(float(theta0) / 4.7 * y for y in c[1:])])
        assert any(said in warning for warning in load_campaign(folder).warnings) == (kind == "warning")


RECORD_FAULTS = [
    ("alpha1_rad_s2", "alpha_1", "line 1: column 'alpha1_rad_s2' is missing"),
    ("alpha1_rad_s2", "theta1_rad", 'these are the columns of kind = torsional, quantity = "displacement"'),
    ("time_s,", "time_ms,", "column 'time_s' is missing"),
    ("\n0.002,", "\n0.002,nan\n0.0021,", "line 4, column 'alpha1_rad_s2': nan is no reading"),
    ("\n0.002,", "\n0.0019,\n0.002,", "line 4, column 'alpha1_rad_s2': the cell is empty"),
    ("\n0.002,", "\n0.0019,oops\n0.002,", "line 4, column 'alpha1_rad_s2': 'oops' is not a number"),
    ("\n0.002,", "\n0.0005,", "line 4: time_s does not increase"),
    ("\n0.002,", "\n0,002,", "line 4: 3 fields where the header has 2; decimal commas?"),
]


@pytest.mark.parametrize(("old", "new", "sentence"), RECORD_FAULTS)
def test_faults_of_a_record(folder: Path, old: str, new: str, sentence: str) -> None:
    edit(folder / FIRST, old, new)
    faults = faults_of(folder)
    assert any(sentence in fault and FIRST in fault for fault in faults), faults


ALTERED = [
    (lambda c: [c[0], np.degrees(c[1])], "it looks like degrees taken for radians"),
    (lambda c: [c[0], c[1] * 0.1 / 9.81], "it looks like g at the mounting radius"),
    (lambda c: [c[0] * 1000.0, c[1]], "from 0 to 1000 in steps of 1, where one natural period is 0.108 s"),
    (
        lambda c: [c[0] * 1000.0, c[1]],
        "it looks like milliseconds: give seconds, as `bayes-damper init` with --time-unit ms",
    ),
    (lambda c: [c[0][:60], c[1][:60]], "is less than one natural period"),
    (lambda c: [c[0], 0.0 * c[1]], "every reading is the same"),
    (lambda c: [c[0], 0.0 * c[1] + 0.5], "every reading is the same"),
    (lambda c: [c[0], 1e300 * c[1]], "check the units of the record"),
    (lambda c: [c[0], np.where(c[0] == 0.5, 1e300, c[1])], "1 number beyond reason, the first 1e+300 as reading 501"),
]


@pytest.mark.parametrize(("change", "sentence"), ALTERED)
def test_wrong_units_and_short_records(folder: Path, change: Callable, sentence: str) -> None:
    alter(folder / FIRST, change)
    faults = faults_of(folder)
    assert len(faults) == 1
    assert sentence in faults[0]
    assert FIRST in faults[0]


def test_a_time_in_microseconds_is_not_called_milliseconds(folder: Path) -> None:
    edit(folder / "campaign.toml", "sample_rate = 1000.0\n", "")
    alter(folder / FIRST, lambda c: [c[0] * 1e6, c[1]])
    (fault,) = faults_of(folder)
    assert "it looks like microseconds: give seconds, as `bayes-damper init` with --time-unit us" in fault


def test_a_wrong_rate_is_no_wrong_unit_of_time(folder: Path) -> None:
    """In milliseconds the record would be shorter than one natural period."""
    edit(folder / "campaign.toml", "sample_rate = 1000.0", "sample_rate = 1e6")
    (told,) = {w.partition(": ")[2] for w in load_campaign(folder).warnings}
    assert told == "the time column says 1000 Hz, sample_rate says 1e+06; the time column decides"


def test_a_motion_that_dies_within_some_readings_is_no_wrong_unit(folder: Path) -> None:
    """Its first reading sticks out of the rest, which had been held against the release: it looked like g."""
    alter(folder / FIRST, lambda c: [c[0], np.where(c[0] < 0.1, c[1][0] * 0.3 ** (c[0] / c[0][1]), 1e-3 * c[1])])
    assert not any("the most that this release can give" in w for w in load_campaign(folder).warnings)


def test_a_second_channel_beyond_reason_is_refused_and_the_largest_number_allowed_is_read(folder: Path) -> None:
    """Warnings of numpy are errors here: squares and differences of what is allowed do not overflow."""
    alter(folder / COUPLED, lambda c: [c[0], c[1], 1e300 * c[2]])
    faults = faults_of(folder)
    assert len(faults) == 1
    assert "column 'alpha2_rad_s2': 1001 numbers beyond reason" in faults[0]
    alter(folder / COUPLED, lambda c: [c[0], c[1], c[2] / np.max(np.abs(c[2])) * 9e29])
    alter(folder / FIRST, lambda c: [c[0], np.where(c[0] == 0.5, 9e29, c[1])])
    assert any("1 single reading sticks out, at 0.5 s" in w for w in load_campaign(folder).warnings)


def test_a_coupled_trial_needs_its_second_channel(folder: Path) -> None:
    names, columns = read_table(folder / COUPLED)
    write_table(folder / COUPLED, names[:2], columns[:2])
    assert "needs its second channel" in faults_of(folder)[0]


@pytest.mark.parametrize("content", [b"", b"\n \n", b"time_s;alpha1_rad_s2\n0,0;1,0\n", b"\xff\xfe\x00t", b"\0" * 999])
def test_unreadable_records(folder: Path, content: bytes) -> None:
    (folder / FIRST).write_bytes(content)
    faults = faults_of(folder)
    assert len(faults) == 1
    assert FIRST in faults[0]
    assert len(faults[0]) < 300


def test_a_spreadsheet_is_no_record(folder: Path) -> None:
    (folder / FIRST).write_bytes(b"PK\x03\x04" + bytes(range(256)))
    assert faults_of(folder) == [
        f"{FIRST} (trials.csv, line 2): a spreadsheet or an archive; save it as plain text in UTF-8, tables as CSV"
    ]


def test_check_reads_the_priors_too(folder: Path) -> None:
    """A fault of priors.toml is told by `check`, not only by the commands that use them."""
    (folder / "priors.toml").write_text("mu = 0.1\n")
    assert check(folder).warnings == ()
    (folder / "priors.toml").write_text("muu = 0.1\n")
    with pytest.raises(InputError, match=r"priors.toml: 'muu' is no parameter; did you mean 'mu'\?"):
        check(folder)


def test_all_faults_of_all_files_come_at_once(folder: Path) -> None:
    edit(folder / "campaign.toml", "bar_radius", "bar_radios")
    edit(folder / "trials.csv", "coupled,10.2,4.7,2", "coupled,x,4.7,2")
    edit(folder / COUPLED, "alpha2_rad_s2", "beta")
    text = "\n".join(faults_of(folder))
    assert all(part in text for part in ("'bar_radios'", "'x' is not a number", "column 'alpha2_rad_s2' is missing"))


def test_no_trials_and_no_folder(folder: Path) -> None:
    header = (folder / "trials.csv").read_text().splitlines()[0]
    (folder / "trials.csv").write_text(header + "\n")
    assert faults_of(folder) == ["trials.csv: no trials; write one row for each record"]
    assert "no such folder" in faults_of(folder / "nowhere")[0]
    assert "`bayes-damper init` makes a campaign from logger files" in faults_of(folder / "trials")[0]


def test_friction_fixed_at_zero_needs_no_magnet(folder: Path) -> None:
    for line in ("bar_radius = 0.10\n", "magnet_radius = 0.0127\n", "magnet_pull = 100.0\n"):
        edit(folder / "campaign.toml", line, "")
    assert len(faults_of(folder)) == 3
    (folder / "priors.toml").write_text("mu = 0.0\n")
    assert not load_campaign(folder).rig.has_magnet


def _clip(columns: list[np.ndarray]) -> list[np.ndarray]:
    return [columns[0], np.clip(columns[1], -100.0, 100.0)]


def _noisy_clip(columns: list[np.ndarray]) -> list[np.ndarray]:
    wave = decay(columns[0], math.radians(4.7), 10.2, 0.031)
    return [columns[0], np.clip(wave, -110.0, 110.0) + np.random.default_rng(2).standard_normal(len(wave))]


def _spike(columns: list[np.ndarray]) -> list[np.ndarray]:
    columns[1][300] += 90.0
    return columns


ODD = [
    (_clip, "it looks clipped there"),
    (_noisy_clip, "it looks clipped there"),
    (_spike, "1 single reading sticks out, at 0.3 s"),
    (lambda c: [c[0] + 0.0003 * np.sin(np.arange(len(c[0]))), c[1]], "time is uneven"),
    (lambda c: [np.delete(x, slice(400, 450)) for x in c], "1 gap in time, from 0.399 to 0.45 s"),
    (lambda c: [np.delete(x, [300, 400, 450]) for x in c], "3 single readings are missing"),
    (
        lambda c: [np.delete(x, 300) for x in (c[0] + 0.00004 * np.sin(np.arange(len(c[0]))), c[1])],
        "1 single reading is missing",
    ),
    (lambda c: [x[:500] for x in c], "trials/IV_uncoupled_1.csv at 0.499 s, the longest at 1 s"),
    (lambda c: [c[0][80:], c[1][80:]], "late start: the record begins 0.08 s"),
    (lambda c: [c[0][:-80], c[1][80:]], "the record begins after the motion began"),
    (lambda c: [c[0], -c[1]], "the sign of the channel looks reversed"),
    (lambda c: [c[0] - 0.04, c[1]], "motion begins 0.04 s before the nominal release"),
    (lambda c: [c[0], np.concatenate([0.1 * np.sin(np.arange(50)), c[1][:-50]])], "motion begins 0.05 s after"),
    (lambda c: [0.9 * c[0], c[1]], "the time column says 1111.1 Hz, sample_rate says 1000"),
    (lambda c: [c[0], 16.0 * np.round(c[1] / 16.0)], "quantised in steps of 16"),
    (lambda c: [c[0], c[1] + 20.0], "the sensor has an offset: `init --offset tail` takes off"),
    (lambda c: [c[0], c[1] + 9.0 * np.random.default_rng(3).standard_normal(len(c[0]))], "noise_std says 2"),
    (lambda c: [c[0], decay(c[0], 0.08, 12.5, 0.06) + 2.0 * np.sin(1e4 * c[0])], "unlike its repeats"),
]


RESTS = 0.2  # s before the release


def _held(quantity: str, columns: list[np.ndarray], sign: float = 1.0) -> list[np.ndarray]:
    """Records of a rig of one natural frequency that rests for 0.2 s before it is released at t = 0."""
    omega, theta0 = math.sqrt(10.2 / 3.015e-3), math.radians(4.7)
    times = columns[0] - RESTS
    t = np.maximum(times, 0.0)
    decaying = theta0 * np.exp(-0.03 * omega * t)
    waves = {
        "displacement": decaying * np.cos(omega * t),
        "velocity": -omega * decaying * np.sin(omega * t),
        "acceleration": np.where(times < 0.0, 0.0, -(omega**2) * decaying * np.cos(omega * t)),
    }
    noise = 0.005 * theta0 * omega ** ("displacement", "velocity", "acceleration").index(quantity)
    rng = np.random.default_rng(5)
    return [times, *(sign * waves[quantity] + noise * rng.standard_normal(len(t)) for _ in columns[1:])]


def _hold(folder: Path, quantity: str, sign: float, late: float) -> None:
    """Makes all trials such records, the first of that sign; all clocks `late` by so many seconds."""
    columns = {"displacement": "theta", "velocity": "omega", "acceleration": "alpha"}
    units = {"displacement": "rad", "velocity": "rad_s", "acceleration": "rad_s2"}
    edit(folder / "campaign.toml", 'quantity = "acceleration"', f'quantity = "{quantity}"')
    edit(folder / "campaign.toml", "noise_std = 2.0\n", "")
    for path in sorted(folder.glob("trials/*.csv")):
        names, table = read_table(path)
        names = [names[0], *(f"{columns[quantity]}{i}_{units[quantity]}" for i in range(1, len(names)))]
        times, *channels = _held(quantity, table, sign if path.name == Path(FIRST).name else 1.0)
        write_table(path, names, [times - late, *channels])


@pytest.mark.parametrize("late", [0.0, 0.1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("quantity", ["displacement", "velocity", "acceleration"])
def test_a_reversed_channel_is_told_where_the_record_rests_before_the_release(
    folder: Path, quantity: str, sign: float, late: float
) -> None:
    """... whether the clock begins at the release or a little later; never where the sign is right."""
    _hold(folder, quantity, sign, late)
    told = [w for w in load_campaign(folder).warnings if "reversed" in w]
    assert len(told) == (sign < 0.0)
    assert all(FIRST in w for w in told)
    assert not any("the first readings are not those of a release" in w for w in load_campaign(folder).warnings)


@pytest.mark.parametrize("quantity", ["velocity", "acceleration"])
def test_an_offset_is_no_motion_before_the_release(folder: Path, quantity: str) -> None:
    _hold(folder, quantity, 1.0, 0.0)
    for path in sorted(folder.glob("trials/*.csv")):
        alter(path, lambda c: [c[0], *(x + 0.05 * np.max(np.abs(x)) for x in c[1:])])
    told = load_campaign(folder).warnings
    assert any("the sensor has an offset" in w for w in told)
    assert not any("the trigger came" in w or "first readings" in w for w in told), told


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_reversed_velocity_is_told_where_the_record_begins_at_the_release(folder: Path, sign: float) -> None:
    _hold(folder, "velocity", sign, 0.0)
    for path in sorted(folder.glob("trials/*.csv")):
        alter(path, lambda c: [x[c[0] >= 0.0] for x in c])
    told = [w for w in load_campaign(folder).warnings if "the sign of the channel looks reversed" in w]
    assert [w.partition(":")[0] for w in told] == ([FIRST] if sign < 0.0 else [])


def test_a_gap_makes_no_trial_unlike_its_repeats(folder: Path) -> None:
    """Nothing is known of a gap, and a straight line across it is no motion."""
    times = read_table(folder / COUPLED)[1][0]
    for trial in (1, 2, 3):
        clean = decay(times, math.radians(4.7), 10.2, 0.02)
        noise = 0.3 * np.random.default_rng(trial).standard_normal((2, times.size))
        kept = (times < 0.05) | (times > 0.14) if trial == 3 else np.ones(times.size, bool)
        alter(
            folder / f"trials/IV_coupled_{trial}.csv",
            lambda c, y=clean, e=noise, k=kept: [x[k] for x in (c[0], y + e[0], 0.3 * y + e[1])],
        )
    warnings = load_campaign(folder).warnings
    assert any("1 gap in time, from" in w for w in warnings)
    assert not any("unlike its repeats" in w for w in warnings)


def test_a_late_trigger_alone_makes_no_trial_unlike_its_repeats(folder: Path) -> None:
    """The jump of an acceleration, two readings late, is a sixth of the rms of a whole record that decays soon."""
    times = read_table(folder / COUPLED)[1][0]
    for trial, late in ((1, 0.0), (2, 0.0), (3, 0.002)):
        path = folder / f"trials/IV_coupled_{trial}.csv"
        clean = decay(times - late, math.radians(4.7), 10.2, 0.19)
        noise = 0.3 * np.random.default_rng(trial).standard_normal((2, times.size))
        alter(path, lambda c, y=clean, e=noise: [c[0], y + e[0], 0.3 * y + e[1]])
    assert not any("unlike its repeats" in w for w in load_campaign(folder).warnings)
    alter(path, lambda c: [c[0], decay(c[0] - 0.002, math.radians(4.7), 12.5, 0.19), c[2]])
    alter(path, lambda c: [c[0], c[1], 0.3 * c[1]])
    told = [w for w in load_campaign(folder).warnings if "unlike its repeats" in w]
    assert len(told) == 1, "once for a trial, however many of its channels are odd"
    assert told[0].startswith("trials/IV_coupled_3.csv: unlike its repeats")


def test_a_spring_that_differs_a_little_makes_no_trial_unlike_its_repeats(folder: Path) -> None:
    """One per cent of it is a quarter of a radian after the nine periods of these records."""
    times = read_table(folder / COUPLED)[1][0]

    def warned(stiffness: float) -> bool:
        for trial, k1t in ((1, 10.2), (2, 10.205), (3, stiffness)):
            clean = decay(times, math.radians(4.7), k1t, 0.004)
            noise = 0.3 * np.random.default_rng(trial).standard_normal((2, times.size))
            alter(
                folder / f"trials/IV_coupled_{trial}.csv",
                lambda c, y=clean, e=noise: [c[0], y + e[0], 0.3 * y + e[1]],
            )
        return any("IV_coupled_3.csv: unlike its repeats" in w for w in load_campaign(folder).warnings)

    assert not warned(1.01 * 10.2)
    assert warned(1.1 * 10.2)


@pytest.mark.parametrize("seed", range(3))
def test_the_round_tops_of_a_slow_channel_are_not_taken_for_clipping(folder: Path, seed: int) -> None:
    """The second body swings at half the frequency of the first, so its turns last twice as long."""
    rng = np.random.default_rng(seed)
    for path in sorted(folder.glob("trials/IV_coupled_*.csv")):
        slow = 0.3 * decay(read_table(path)[1][0], math.radians(4.7), 0.3 * 10.2, 0.05)
        alter(path, lambda c, y=slow: [c[0], c[1], y + 0.08 * rng.standard_normal(y.size)])
    assert not any("clipped" in w for w in load_campaign(folder).warnings)
    alter(path, lambda c: [c[0], c[1], np.clip(c[2], -10.0, 10.0)])
    assert any("clipped" in w for w in load_campaign(folder).warnings)


@pytest.mark.parametrize("noise", [2.0, 8.0])
@pytest.mark.parametrize("repeats", [2, 3, 4])
def test_exchanged_channels_of_one_repeat_are_told_once(tmp_path: Path, repeats: int, noise: float) -> None:
    folder = write_synthetic(tmp_path, repeats=repeats, noise=noise)
    assert not any("exchanged" in w for w in load_campaign(folder).warnings)
    alter(folder / COUPLED, lambda c: [c[0], c[2], c[1]])
    told = [w for w in load_campaign(folder).warnings if "exchanged" in w]
    assert len(told) == 1
    assert told[0].startswith(
        f"{COUPLED}: channels exchanged?" if repeats > 2 else f"{COUPLED} and trials/IV_coupled_2"
    )
    assert not any("unlike its repeats" in w for w in load_campaign(folder).warnings)


@pytest.mark.parametrize(("change", "sentence"), ODD)
def test_odd_records_are_told_and_read(folder: Path, change: Callable, sentence: str) -> None:
    alter(folder / FIRST, change)
    warnings = load_campaign(folder).warnings
    assert any(sentence in w and FIRST in w for w in warnings), warnings


@pytest.mark.parametrize(("late", "begins"), [(0.0, 0), (0.002, 1)])
def test_an_acceleration_that_rises_faster_than_it_swings_begins_in_its_record(
    folder: Path, late: float, begins: int
) -> None:
    """A slow sensor or latch lets it rise from 0. From the middle of the motion it swings through 0."""

    def found(change: Callable[[np.ndarray], np.ndarray]) -> list[str]:
        alter(folder / FIRST, lambda c: [c[0], change(c[0])])
        return [w for w in load_campaign(folder).warnings if FIRST in w and re.search("motion beg|first readings", w)]

    def risen(times: np.ndarray) -> np.ndarray:
        t = times - late
        return decay(t, math.radians(4.7), 10.2, 0.03) * -np.expm1(-np.maximum(t, 0.0) / 0.003)

    told = found(risen)
    assert len(told) == begins
    assert all("motion begins 0.00" in w for w in told)
    (told,) = found(lambda times: -risen(times))
    assert "looks reversed" in told
    (told,) = found(lambda times: decay(times + 0.0275, math.radians(4.7), 10.2, 0.03))
    assert told.endswith("the record begins after the motion began")


def _contradictions(folder: Path) -> list[str]:
    return [w for w in load_campaign(folder).warnings if w.startswith("trials.csv: uncoupled, ")]


CASES = (("I", 6.2, 9.0), ("II", 6.2, 4.7), ("IV", 10.2, 4.7))


def test_a_case_that_swings_at_another_frequency_than_declared_is_told(tmp_path: Path) -> None:
    """The spring of case IV typed over from case II: the closed form gives the stiffness that would do."""
    folder = write_synthetic(tmp_path, CASES)
    assert _contradictions(folder) == []
    edit_all(folder / "trials.csv", "10.2,4.7", "6.2,4.7")
    (told,) = _contradictions(folder)
    assert "case IV at 9.2" in told
    assert "case II at" not in told
    found = float(told.partition("k1t of ")[2].partition(" ")[0])
    assert found == pytest.approx(10.2, rel=0.02)


def test_a_spring_in_another_unit_is_no_sensor_in_another_unit(tmp_path: Path) -> None:
    """Ten times the stiffness makes readings a tenth of what is expected, as m/s^2 at 0.1 m would."""
    folder = write_synthetic(tmp_path)
    edit_all(folder / "trials.csv", ",10.2,", ",102,")
    told = [w for w in load_campaign(folder).warnings if "the largest reading" in w]
    assert told
    assert all("the record swings at 9." in w and "m/s^2 at the mounting" not in w for w in told)


def test_trials_filed_under_each_other_s_case_are_told_with_the_case_that_they_are_like(tmp_path: Path) -> None:
    folder = write_synthetic(tmp_path, CASES)
    for a, b in (("I_uncoupled_2", "IV_uncoupled_1"), ("II_coupled_1", "IV_coupled_3")):
        first, second = (folder / f"trials/{name}.csv" for name in (a, b))
        one, other = first.read_text(encoding="utf-8"), second.read_text(encoding="utf-8")
        first.write_text(other, encoding="utf-8")
        second.write_text(one, encoding="utf-8")
    told = {w.partition(":")[0]: w for w in load_campaign(folder).warnings if "unlike its repeats" in w}
    for name, case in (
        ("I_uncoupled_2", "IV"),
        ("IV_uncoupled_1", "I"),
        ("II_coupled_1", "IV"),
        ("IV_coupled_3", "II"),
    ):
        assert f"like the trials of case {case}: a wrong name?" in told[f"trials/{name}.csv"]


@pytest.mark.parametrize(("a", "b"), [("I_uncoupled_2", "IV_uncoupled_1"), ("II_coupled_1", "IV_coupled_2")])
def test_repeats_exchanged_between_two_cases_of_two_are_named_and_nothing_else(tmp_path: Path, a: str, b: str) -> None:
    """Which of two is odd nobody can see; springs, releases and second channels had been blamed."""
    folder = write_synthetic(tmp_path, CASES, repeats=2)
    sound = load_campaign(folder).warnings
    names = [folder / f"trials/{name}.csv" for name in (a, b)]
    for path, text in zip(names, [path.read_text(encoding="utf-8") for path in reversed(names)], strict=True):
        path.write_text(text, encoding="utf-8")
    (told,) = set(load_campaign(folder).warnings) - set(sound)
    for case, configuration in (name.split("_")[:2] for name in (a, b)):
        assert all(f"trials/{case}_{configuration}_{k}.csv" in told for k in (1, 2))
    assert "two of these records look exchanged between the cases" in told


def test_a_file_of_a_campaign_in_place_of_its_folder_is_told_as_one(folder: Path) -> None:
    assert faults_of(folder / "trials.csv") == [
        f"{folder / 'trials.csv'}: a file; give the folder that holds it, {folder}"
    ]


def test_an_inertia_that_no_case_swings_with_is_told_as_one(tmp_path: Path) -> None:
    folder = write_synthetic(tmp_path, CASES)
    edit(folder / "campaign.toml", "primary_inertia = 3.015e-3", "primary_inertia = 2.0e-3")
    (told,) = _contradictions(folder)
    found = float(told.partition("one primary_inertia of ")[2].partition(" ")[0])
    assert found == pytest.approx(3.015e-3, rel=0.02)
    edit(folder / "campaign.toml", "primary_inertia = 2.0e-3", "primary_inertia = { value = 2.0e-3, std = 0.6e-3 }")
    assert _contradictions(folder) == []


def test_a_case_released_from_another_angle_than_declared_is_told(tmp_path: Path) -> None:
    folder = write_synthetic(tmp_path, CASES)
    edit_all(folder / "trials.csv", "6.2,9.0", "6.2,5.0")
    (told,) = _contradictions(folder)
    assert "another release than declared: case I 1." in told
    assert "case II" not in told.partition("(other cases")[0]


@pytest.mark.parametrize("quantity", ["acceleration", "velocity", "displacement"])
def test_a_secondary_that_goes_the_wrong_way_and_exchanged_channels_are_told(tmp_path: Path, quantity: str) -> None:
    """The two inertias of a rig that two springs and dashpots hold, by matrix exponentials."""
    folder = write_synthetic(tmp_path, repeats=2)
    edit(folder / "campaign.toml", '"acceleration"', f'"{quantity}"')
    edit(folder / "campaign.toml", "noise_std = 2.0\n", "")
    motion = {q: np.stack(y) for q, y in two_inertias(np.arange(1001) / 1000.0).items()}[quantity]
    names = {"acceleration": "alpha{}_rad_s2", "velocity": "omega{}_rad_s", "displacement": "theta{}_rad"}[quantity]
    for path in sorted(folder.glob("trials/*.csv")):
        _, (times, *channels) = read_table(path)
        small = 3e-4 * np.max(np.abs(motion)) * np.random.default_rng(len(path.name)).standard_normal((2, times.size))
        columns = [times, *(motion + small)[: len(channels)]]
        write_table(path, ["time_s", *(names.format(k + 1) for k in range(len(channels)))], columns)
    wiring = ("look exchanged", "goes the other way")

    def told() -> list[str]:
        found = load_campaign(folder).warnings
        return [mark for mark in wiring for w in found if mark in w and w.startswith(COUPLED)]

    assert told() == []
    alter(folder / COUPLED, lambda c: [c[0], c[1], -c[2]])
    assert told() == ["goes the other way"]
    alter(folder / COUPLED, lambda c: [c[0], c[1], -c[2]])
    for path in sorted(folder.glob("trials/*_coupled_*.csv")):
        alter(path, lambda c: [c[0], c[2], c[1]])
    assert told() == ["look exchanged"]


def two_inertias(times: np.ndarray) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Both channels of each quantity, both released at rest from 4.7 deg, by the matrix exponential."""
    J1, J2, k1, k2, c = 3.015e-3, 2.474e-3, 10.2, 1.2, 0.02
    A = np.zeros((4, 4))
    A[:2, 2:] = np.eye(2)
    A[2] = np.array([-(k1 + k2), k2, -c, c]) / J1
    A[3] = np.array([k2, -k2, c, -c]) / J2
    step, state = expm(A * (times[1] - times[0])), np.array([math.radians(4.7), math.radians(4.7), 0.0, 0.0])
    states = [state]
    for _ in times[1:]:
        states.append(step @ states[-1])
    y = np.array(states).T
    a = A @ y
    return {"displacement": (y[0], y[1]), "velocity": (y[2], y[3]), "acceleration": (a[2], a[3])}


def test_a_copied_record_is_told(folder: Path) -> None:
    """Noise never repeats itself: two trials of the same readings are one."""
    (folder / "trials" / "IV_uncoupled_2.csv").write_bytes((folder / FIRST).read_bytes())
    warnings = load_campaign(folder).warnings
    assert len(warnings) == 1
    assert "trials/IV_uncoupled_2.csv: holds the same readings as trials/IV_uncoupled_1.csv" in warnings[0]


def test_single_trials_and_caveats_are_told(tmp_path: Path) -> None:
    folder = write_synthetic(tmp_path, repeats=1)
    edit(folder / "campaign.toml", "[rig]", 'caveats = ["The clock may be 2 % off."]\n[rig]')
    campaign = load_campaign(folder)
    assert campaign.warnings[-1] == "The clock may be 2 % off.", "after what was found"
    assert any("only one trial of IV uncoupled, IV coupled" in w for w in campaign.warnings)
    assert campaign.heldout == ()
    assert "warning: The clock" in campaign.describe()


def test_translational_records_and_free_starts(tmp_path: Path) -> None:
    toml = (
        'name = "t"\n[rig]\nkind = "translational"\nprimary_inertia = 1.0\n[measurement]\nquantity = "displacement"\n'
        'start = "free"\n'
    )
    (tmp_path / "campaign.toml").write_text(toml)
    (tmp_path / "trials.csv").write_text("file,case,configuration,k1_n_per_m,trial\nr.csv,A,uncoupled,40.0,1\n")
    times = np.arange(500) / 50.0
    rng = np.random.default_rng(0)
    x = 0.03 * np.exp(-0.1 * times) * np.cos(6.3 * times) + 1e-4 * rng.standard_normal(500)
    write_table(tmp_path / "r.csv", ["time_s", "x1_m"], [times, x])
    campaign = load_campaign(tmp_path)
    assert campaign.trials[0].theta0 is None
    assert campaign.rig.bar_radius == Constant(1.0)
    write_table(tmp_path / "r.csv", ["time_s", "x1_m"], [times, 1000.0 * x])
    assert "it looks like millimetres" in faults_of(tmp_path)[0]


@pytest.mark.parametrize("sigma", [0.3, 2.0, 10.0])
def test_the_noise_floor_is_found_to_a_tenth(tmp_path: Path, sigma: float) -> None:
    folder = write_synthetic(tmp_path, noise=sigma, repeats=6)
    floors = np.concatenate([noise_floor(t) for t in load_campaign(folder).trials])
    assert np.mean(floors) == pytest.approx(sigma, rel=0.1)


@settings(max_examples=40, deadline=None)
@given(st.binary(max_size=200))
@example(b"\r\x01")
@example(b",\n,\n")
@example(b"0,1\n , \n")
@example(b'"' + b"1" * 140_000 + b'",2\n')
def test_no_content_of_a_record_escapes_as_another_error(content: bytes) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as name:
        folder = write_synthetic(Path(name), repeats=1, configurations=("uncoupled",), duration=0.3)
        (folder / FIRST).write_bytes(b"time_s,alpha1_rad_s2\n" + content)
        with pytest.raises(InputError):
            load_campaign(folder)


def test_a_description_shows_the_declared_numbers_so_that_a_wrong_unit_is_seen(folder: Path) -> None:
    line = (
        "rig: the primary 0.003015 kg m^2; the secondary 0.002474 kg m^2; faces pressed together with 100 N, the weight"
    )
    assert f"{line} of 10.2 kg, over a radius of 12.7 mm" in load_campaign(folder).describe()
    edit(folder / "campaign.toml", "magnet_pull = 100.0", "magnet_pull = 10.2")
    assert "pressed together with 10.2 N, the weight of 1.04 kg" in load_campaign(folder).describe()
    edit(folder / "campaign.toml", "magnet_radius = 0.0127\n", 'normal_force = "constant"\n')
    assert "pressed together with 10.2 N\n" in load_campaign(folder).describe()


def test_faults_of_priors_stand_beside_those_of_the_campaign(folder: Path) -> None:
    edit(folder / FIRST, "\n0", "\nnothing,0\n0")
    (folder / "priors.toml").write_text('[mu]\ndistribution = "lognormal"\nmedian = -0.1\n', encoding="utf-8")
    with pytest.raises(InputError) as caught:
        check(folder)
    said = "\n".join(caught.value.faults)
    assert "nothing" in said
    assert "priors.toml: mu" in said
    edit(folder / "campaign.toml", "[rig]", "[rig]\nkinds = 3")
    with pytest.raises(InputError, match="not read yet"):
        check(folder)
