"""From logger files to campaigns: conversions, releases, and a sentence for each malformed file."""

from __future__ import annotations

import hashlib
import math
import os
import re
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from campaigns import decay

from bayes_damper.campaign import load_campaign
from bayes_damper.campaign.importing.importer import import_records, init_campaign, records_in
from bayes_damper.cli import main
from bayes_damper.commands.check import check
from bayes_damper.errors import InputError
from bayes_damper.priors.files import campaign_priors

ROOT = Path(__file__).resolve().parents[3]
RAW = Path(os.environ.get("BAYES_DAMPER_REALDATA", ROOT.parent / "shared" / "realdata"))
TIMES = np.arange(-200, 1200) / 1000.0
OPTIONS = {
    "primary_inertia": 3.015e-3,
    "k1t": 10.2,
    "theta0": 4.7,
    "theta0_std": 0.1,
    "time": "t",
    "columns": ["a"],
    "release": "find",
}


def wave(seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal(len(TIMES))
    return decay(TIMES, math.radians(4.7), 10.2, 0.031) + noise


def logger_file(path: Path, y: np.ndarray, mark: str = ",", comma: bool = False, times: np.ndarray = TIMES) -> Path:
    rows = [f"{t + 5.0:.4f}{mark}{v:.6f}" for t, v in zip(times, y, strict=True)]
    text = "\n".join([f"t{mark}a", *(r.replace(".", ",") if comma else r for r in rows)])
    path.write_text(text + "\n", encoding="utf-8")
    return path


def fault_of(tmp_path: Path, source: Path, **options: object) -> str:
    with pytest.raises(InputError) as caught:
        init_campaign(tmp_path / "out", [source], **{**OPTIONS, **options})
    assert not (tmp_path / "out").exists()
    return str(caught.value)


def test_logger_files_become_a_campaign(tmp_path: Path) -> None:
    sources = [logger_file(tmp_path / f"run{i}.csv", wave(i)) for i in range(3)]
    campaign = load_campaign(init_campaign(tmp_path / "out", sources, **OPTIONS))
    assert [t.trial for t in campaign.trials] == [1, 2, 3]
    assert campaign.trials[0].times[0] == pytest.approx(-0.02, abs=0.002)
    assert campaign.warnings == ()
    again = import_records(tmp_path / "out" / "import.toml", tmp_path / "again")
    assert (again / "trials.csv").read_bytes() == (tmp_path / "out" / "trials.csv").read_bytes()


def test_an_acceleration_jumps_between_two_readings(tmp_path: Path) -> None:
    """The release found in a record of accelerations is the middle between the last reading at rest and the next."""
    source = logger_file(tmp_path / "run.csv", wave())
    trial = load_campaign(init_campaign(tmp_path / "out", [source], **OPTIONS)).trials[0]
    k = int(np.argmax(np.abs(trial.channels[0]) > 100.0))
    assert trial.times[k] == pytest.approx(5e-4)
    assert trial.times[k - 1] == pytest.approx(-5e-4)


@pytest.mark.parametrize("quantity", ["displacement", "velocity"])
@pytest.mark.parametrize("rate", [200.0, 1000.0])
def test_a_release_found_is_that_of_the_rig_not_of_the_first_reading_beyond_the_noise(
    tmp_path: Path, quantity: str, rate: float
) -> None:
    """Slow rigs stay within the noise for several readings; the instant is found to about one of them."""
    omega, release = 8.0, 0.4031
    times = np.arange(round(6.0 * rate)) / rate
    phase = omega * np.maximum(times - release, 0.0)
    motion = np.cos(phase) + 0.02 * np.sin(phase) if quantity == "displacement" else -omega * np.sin(phase)
    y = 0.03 * motion * np.exp(-0.02 * phase)
    for seed in range(5):
        readings = y + 0.003 * np.ptp(y) * np.random.default_rng(seed).standard_normal(y.size)
        source = logger_file(tmp_path / f"run{seed}.csv", readings, times=times)
        options = {**OPTIONS, "quantity": quantity, "theta0": 1.7, "k1t": 3.015e-3 * omega**2}
        campaign = load_campaign(init_campaign(tmp_path / str(seed), [source], **options))
        begun = campaign.trials[0].times[0] - times[0]
        kept = times.size - campaign.trials[0].times.size
        assert abs(kept / rate - begun - release) < max(1.2 / rate, 0.03 / omega)
        assert np.min(np.abs(campaign.trials[0].times)) < 1e-9, "it lies at a reading"


def test_g_at_the_mounting_radius_with_semicolons_and_decimal_commas(tmp_path: Path) -> None:
    source = logger_file(tmp_path / "run.csv", wave() * 0.1 / 9.80665, ";", True)
    options = {**OPTIONS, "decimal": ",", "units": ["g"], "mounting_radius": 0.1}
    trial = load_campaign(init_campaign(tmp_path / "out", [source], **options)).trials[0]
    assert np.max(np.abs(trial.channels)) == pytest.approx(np.max(np.abs(wave())), rel=1e-3)


def test_missing_constants_are_assumed_and_told(tmp_path: Path) -> None:
    source = logger_file(tmp_path / "run.csv", 1e-3 * decay(TIMES, 1.0, 10.2, 0.031)[200:], times=TIMES[200:])
    campaign = load_campaign(
        init_campaign(tmp_path / "out", [source], time="t", columns=["a"], quantity="displacement")
    )
    k1t = campaign.trials[0].k1t
    assert abs(k1t.value - 10.2 / 3.015e-3) < k1t.std
    assert any("per unit inertia" in w for w in campaign.warnings)
    assert any("k1t was not given" in w for w in campaign.warnings)


def test_the_uncertainty_of_the_angle_is_told_where_it_was_assumed(tmp_path: Path) -> None:
    source = logger_file(tmp_path / "run.csv", wave())
    options = {key: value for key, value in OPTIONS.items() if key != "theta0_std"}
    campaign = load_campaign(init_campaign(tmp_path / "out", [source], **options))
    assert any("0.1 deg, or 2 % of the angle" in w for w in campaign.warnings)


def test_a_unit_that_contradicts_the_file_is_told(tmp_path: Path) -> None:
    """At a mounting radius of 0.1 m, g taken for m/s^2 gives a tenth, as a missing radius does."""
    head, *body = logger_file(tmp_path / "run.csv", wave() * 0.1 / 9.80665).read_text().splitlines()
    source = tmp_path / "run.csv"
    source.write_text("\n".join([head.replace(",a", ",a [g]"), *body]) + "\n")
    told = "the file gives column 2 (a [g]) in g, 'units' in m/s^2; m/s^2 was taken."
    for unit, count in (("m/s^2", 1), ("g", 0)):
        options = {**OPTIONS, "units": [unit], "mounting_radius": 0.1}
        campaign = load_campaign(init_campaign(tmp_path / f"out {count}", [source], **options))
        assert sum(told in w for w in campaign.warnings) == count


def test_channels_of_two_kinds_are_refused_with_what_to_do(tmp_path: Path) -> None:
    """The hint on the unit of one channel would be refused for the unit of the other."""
    source = logger_file(tmp_path / "run.csv", wave())
    head, *rows = source.read_text().splitlines()
    source.write_text("\n".join([f"{head},b", *(f"{row},0.5" for row in rows)]) + "\n")
    options = {"columns": ["a", "b"], "kind": "translational", "secondary_inertia": 1.0, "units": ["mm", "g"]}
    told = fault_of(tmp_path, source, **options)
    assert "displacement (mm) and acceleration (g); a campaign has readings of one kind" in told


def test_the_time_need_not_be_named_beside_the_channels(tmp_path: Path) -> None:
    """A column that is called after the time is taken without a word, another one that rises steadily with one."""
    source = logger_file(tmp_path / "run.csv", wave())
    options = {key: value for key, value in OPTIONS.items() if key != "time"}
    campaign = load_campaign(init_campaign(tmp_path / "out", [source], **options))
    named = load_campaign(init_campaign(tmp_path / "named", [source], **OPTIONS))
    assert np.array_equal(campaign.trials[0].times, named.trials[0].times)
    assert campaign.warnings == named.warnings
    head, *body = source.read_text().splitlines()
    source.write_text("\n".join([head.replace("t,", "n,", 1), *body]) + "\n")
    guessed = load_campaign(init_campaign(tmp_path / "guessed", [source], **options))
    assert guessed.warnings == (*named.warnings, "No time column was named; used: column 1 (n).")


def in_a_terminal(monkeypatch: pytest.MonkeyPatch, answers: dict[str, str]) -> list[str]:
    """Questions that a person in a terminal is asked; answers : beginning of a question -> answer, else none."""
    asked: list[str] = []

    def reply(question: str) -> str:
        asked.append(question)
        return next((answer for key, answer in answers.items() if question.startswith(key)), "")

    monkeypatch.setattr("builtins.input", reply)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    return asked


def test_in_a_terminal_it_shows_the_columns_and_asks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source = logger_file(tmp_path / "run.csv", wave())
    answers = {"Inertia J1": "3.015e-3", "Stiffness k1t": "10.2", "Release angle": "4.7", "Release: start": "find"}
    asked = in_a_terminal(monkeypatch, answers)
    assert main(["init", str(tmp_path / "out"), str(source)]) == 0
    trial = load_campaign(tmp_path / "out").trials[0]
    assert (trial.k1t.value, trial.configuration) == (10.2, "uncoupled")
    assert trial.theta0 is not None
    assert abs(trial.times[np.argmax(np.abs(trial.channels[0]))]) < 0.005
    assert "run.csv has the columns: 1 t, 2 a" in capsys.readouterr().out
    assert len(asked) == 14


def test_init_asks_in_the_units_of_the_rig_and_keeps_the_answers_where_they_do_not_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "run.csv"
    times = np.arange(400) / 100.0
    np.savetxt(source, np.column_stack([times, np.cos(30.0 * times)]), delimiter=",", header="t,x", comments="")
    answers = {"Kind of rig": "translational", "Mass J1 in kg (": "1.2", "Stiffness k1 in N/m": "500",
               "Their units": "furlong"}  # fmt: skip
    asked = in_a_terminal(monkeypatch, answers)
    assert main(["init", str(tmp_path / "out"), str(source)]) == 2
    assert len(asked) == 12
    assert not any("N m/rad" in q or "kg m^2" in q or "axis" in q for q in asked)
    told = capsys.readouterr().err
    assert "to be given again as options: --kind translational --units furlong --primary-inertia 1.2 --k1t 500" in told


def test_a_file_that_is_not_there_is_told_before_its_name_is_read(tmp_path: Path) -> None:
    missing = tmp_path / "x.csv"
    with pytest.raises(InputError, match=r"x\.csv: there is no such file"):
        init_campaign(tmp_path / "out", [missing], pattern="{case}_{trial}", **OPTIONS)


def test_a_number_in_other_words_is_refused_once_for_all_files(tmp_path: Path) -> None:
    sources = [logger_file(tmp_path / f"run{i}.csv", wave(i)) for i in range(3)]
    with pytest.raises(InputError) as caught:
        init_campaign(tmp_path / "out", sources, **{**OPTIONS, "theta0": "4,7"})
    assert len(caught.value.faults) == 1
    assert "and 2 other files: theta0 = '4,7', which must be a number with a decimal point" in caught.value.faults[0]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"columns": ["alpha"]}, "column 'alpha' is missing, the file has t, a"),
        ({"columns": [3]}, "column 3 is missing, the file has 2"),
        ({"sha256": "0" * 64}, "expected 0000000000000000"),
        ({"units": ["deg/s^2"]}, "it looks like"),
        ({"units": ["m/s^2"]}, "give mounting_radius in metres"),
        ({"units": ["furlong"]}, "'furlong' is no unit of acceleration;"),
        ({"units": ["mm"]}, "but of displacement: for such readings give --quantity displacement"),
        ({"units": ["deg"], "kind": "translational", "quantity": "displacement"}, "of a rig that turns: for such"),
        ({"colums": ["a"]}, "option 'colums' does not exist; did you mean 'columns'?"),
        ({"release": "guess"}, "release = 'guess' is none of"),
        ({"start": 900.0}, "only 0 readings"),
        ({"release": 900.0}, "only 0 readings are left"),
        ({"release": math.nan}, "release must be finite, not nan"),
        ({"release": -1e26}, "release = -1e+26 s is longer before the first reading than the record lasts"),
        ({"every": 200}, "readings are left of the record, which runs from 4.8 to 6.199 s; correct release"),
        ({"every": 0}, "every = 0 is too small; give at least 1"),
        ({"before": -1.0}, "before = -1.0 is too small"),
        ({"skip_lines": -3}, "skip_lines = -3 is too small"),
        ({"decimal": "x"}, "decimal = 'x' is none of"),
        ({"files_per_trial": "two"}, "files_per_trial = two for 1 files"),
        ({"k1t": math.nan}, "k1t must be finite, not nan"),
    ],
)
def test_wrong_options(tmp_path: Path, options: dict, sentence: str) -> None:
    source = logger_file(tmp_path / "run.csv", wave())
    if "units" in options and options["units"] == ["deg/s^2"]:
        source = logger_file(tmp_path / "run.csv", 0.5 * wave())
    if "sha256" in options:
        spec = {
            "name": "x",
            "rig": {"primary_inertia": 1.0},
            "reader": {"columns": ["a"], "time": "t"},
            "trials": [
                {"source": str(source), "case": "A", "configuration": "uncoupled", "k1t": 1.0, "theta0": 1.0, **options}
            ],
        }
        with pytest.raises(InputError, match=sentence):
            import_records(spec, tmp_path / "out")
        return
    assert sentence in fault_of(tmp_path, source, **options)


def test_the_working_directory_gives_the_campaign_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = logger_file(tmp_path / "run.csv", wave())
    (tmp_path / "bench rig").mkdir()
    monkeypatch.chdir(tmp_path / "bench rig")
    assert load_campaign(init_campaign(".", [source], **OPTIONS)).name == "bench rig"


def test_degrees_taken_for_radians(tmp_path: Path) -> None:
    source = logger_file(tmp_path / "run.csv", np.degrees(wave()))
    assert re.search("it looks like degrees taken for radians.*`init --units deg`", fault_of(tmp_path, source))


def test_decimal_commas_need_not_be_told(tmp_path: Path) -> None:
    source = logger_file(tmp_path / "run.csv", wave(), ";", True)
    trial = load_campaign(init_campaign(tmp_path / "out", [source], **OPTIONS)).trials[0]
    assert np.max(np.abs(trial.channels)) == pytest.approx(np.max(np.abs(wave())), rel=1e-3)


def odd_logger_file(path: Path, y: np.ndarray) -> Path:
    """What a German logger writes: a head of several lines in another code page, ms, words for missing readings."""
    rows = [f"{1e3 * (t + 5.0):.1f};{v:.5f}".replace(".", ",") for t, v in zip(TIMES, y, strict=True)]
    rows[300:303] = [r.split(";")[0] + ";---" for r in rows[300:303]]
    del rows[500:503]
    head = ["Me\u00dfger\u00e4t: Logger 3000", "Datum;01.02.2024", "", "Zeit [ms];Kanal 1"]
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="cp1252")
    return path


def test_heads_units_in_names_and_missing_readings_are_understood(tmp_path: Path) -> None:
    source = odd_logger_file(tmp_path / "run.csv", wave())
    options = {**OPTIONS, "time": "Zeit [ms]", "columns": ["Kanal 1"]}
    trial = load_campaign(init_campaign(tmp_path / "out", [source], **options)).trials[0]
    assert np.isfinite(trial.channels).all()
    assert np.median(np.diff(trial.times)) == pytest.approx(float(np.median(np.diff(TIMES))), rel=1e-6)
    assert np.max(np.diff(trial.times)) == pytest.approx(4.0 * float(np.median(np.diff(TIMES))), rel=1e-3)


@pytest.mark.parametrize("last", [";", ""], ids=["marks at the end", "no marks at the end"])
@pytest.mark.parametrize("where", [(0,), (150,), (0, 150, 399)], ids=str)
def test_remarks_beside_some_rows_are_left_out(tmp_path: Path, where, last) -> None:
    rows = [f"{t:.4f};{v:.4f}".replace(".", ",") + last for t, v in zip(TIMES, wave(), strict=True)]
    for k in where:
        rows[k] = rows[k].rstrip(";") + ";losgelassen?"
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["Wagen 3", "t;a;Bemerkung", *rows]) + "\n", encoding="utf-8")
    campaign = load_campaign(init_campaign(tmp_path / "out", [path], **OPTIONS))
    assert np.isfinite(campaign.trials[0].channels).all()
    assert any("column 3" in w and "holds words, no numbers, and was left out" in w for w in campaign.warnings)


def test_a_file_of_numbers_alone_needs_no_header(tmp_path: Path) -> None:
    path = tmp_path / "run.dat"
    path.write_text("\n".join(f"{v:.5f}" for v in wave()) + "\n", encoding="utf-8")
    rate = 1.0 / float(np.median(np.diff(TIMES)))
    options = {k: v for k, v in OPTIONS.items() if k != "time"} | {"columns": [1], "sample_rate": rate}
    assert len(load_campaign(init_campaign(tmp_path / "out", [path], **options)).trials[0].times) > 300


def test_a_column_of_missing_readings_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    rows = [f"{t:.4f},{v:.4f}," for t, v in zip(TIMES, wave(), strict=True)]
    path.write_text("\n".join(["t,b,a", *rows]) + "\n", encoding="utf-8")
    assert "100 % of the readings in the chosen columns are missing" in fault_of(tmp_path, path)


@pytest.mark.parametrize(
    ("named", "told"),
    [
        ({"columns": ["a", "a"]}, "column 2 (a) is named twice in 'columns'"),
        ({"columns": ["a", 2]}, "column 2 (a) is named twice in 'columns'"),
        ({"columns": ["a", "t"]}, "column 1 (t) is named in both 'columns' and 'time'"),
        ({"columns": [1]}, "column 1 (t) is named in both 'columns' and 'time'"),
        ({"columns": ["a"], "torque": "a"}, "column 2 (a) is named in both 'columns' and 'torque'"),
        ({"columns": ["t"], "time": None, "sample_rate": 1000.0}, "column 1 (t) is a clock and stands in 'columns'"),
    ],
)
def test_a_column_is_one_thing_alone(tmp_path: Path, named: dict[str, object], told: str) -> None:
    assert told in fault_of(tmp_path, logger_file(tmp_path / "run.csv", wave()), **named)


def test_a_sample_rate_beside_a_clock_is_said_to_be_too_much(tmp_path: Path) -> None:
    source = logger_file(tmp_path / "run.csv", wave())
    options = {k: v for k, v in OPTIONS.items() if k not in ("columns", "time")}
    with pytest.raises(
        InputError, match=r"column 1 .t. is a clock and stands in 'columns'; leave out the sample rate, or"
    ):
        init_campaign(tmp_path / "out", [source], **options, sample_rate=1000.0)


TWO = {**OPTIONS, "secondary_inertia": 2.474e-3, "bar_radius": 0.1, "magnet_radius": 0.0127, "magnet_pull": 100.0}
G = 0.1 / 9.80665
"""g at 0.1 m for one rad/s^2."""


def table(head: list[str], rows: list[str], encoding: str = "utf-8", end: str = "\n") -> bytes:
    return (end.join([*head, *rows]) + end).encode(encoding)


def rows(form: str, scale: float = 1.0, at: float = 0.2) -> list[str]:
    return [form.format(t + at, scale * a, 0.3 * scale * b) for t, a, b in zip(TIMES, wave(), wave(1), strict=True)]


STAMPED = [r.replace("@", "2024-05-03 10:11:", 1) for r in rows("@{0:09.6f},{1:.4f},{2:.4f}", at=12.2)]
CLOCKED = [r.replace("@", "10:11:", 1) for r in rows("@{0:06.3f},{1:.4f},{2:.4f}", at=12.2)]
COMMAS = [r.replace(".", ",") for r in rows("{0:.4f};{1:.6f};{2:.6f};", G)]
WORDS = [f"{row}OK;" for row in COMMAS]
STYLES: dict[str, tuple[bytes, dict[str, object]]] = {
    "units in a line of their own, empty last column": (
        table(["Messung 12;;;", "", "Zeit;B 1;B 2;", "s;g;g;"], COMMAS, "cp1252", "\r\n"),
        {"time": "Zeit", "columns": ["B 1", "b 2"], "mounting_radius": 0.1},
    ),
    "no unit for a column of words, empty last column": (
        table(["Kanal 1;A", "", "Zeit;B 1;B 2;Status;", "[s];[g];[g];;"], WORDS),
        {"columns": ["B 1", "B 2"], "mounting_radius": 0.1},
    ),
    "a dash for the unit of a column of words": (
        table(["Kanal 1;A", "", "Zeit;B 1;B 2;Status;", "[s];[g];[g];-;"], WORDS),
        {"columns": ["B 1", "B 2"], "mounting_radius": 0.1},
    ),
    "lines to skip before the names, units below them": (
        table(["Kanal 1;A", "", "Zeit;B 1;B 2;Status;", "[s];[g];[g];;"], WORDS),
        {"columns": ["B 1", "B 2"], "mounting_radius": 0.1, "skip_lines": 2},
    ),
    "LabVIEW with a column of comments": (
        table(
            ["LabVIEW Measurement", "***End_of_Header***", "", "X0\t0.0\t0.0", "X_Value\tA\tB\tComment"],
            rows("{0:.6f}\t{1:.4f}\t{2:.4f}"),
        ),
        {"time": "X_Value", "columns": ["A", "B"]},
    ),
    "UTF-16": (
        table(["Time (s)\tA\tB"], rows("{0:.4f}\t{1:.4f}\t{2:.4f}"), "utf-16"),
        {"columns": ["A", "B"], "time": 1},
    ),
    "date and time of the day": (table(["When,A,B"], STAMPED), {"time": "When", "columns": ["A", "B"]}),
    "time of the day": (table(["When,A,B"], CLOCKED), {"time": "When", "columns": ["A", "B"]}),
    "quotes and decimal commas": (
        table(['"t","A","B"'], [r.replace(".", ",").replace("#", ",") for r in rows('"{0:.4f}"#"{1:.4f}"#"{2:.4f}"')]),
        {"time": "t", "columns": ["A", "B"]},
    ),
    "head of comments, blanks": (
        table(["# logger v1", "# t A B"], rows("{0:10.4f}  {1:12.4f} {2:12.4f}")),
        {"time": "t", "columns": ["A", "B"]},
    ),
    "a foot and a line cut short": (
        table(["t,A,B"], [*rows("{0:.4f},{1:.4f},{2:.4f}"), "1.4,12.", "End of measurement"]),
        {"time": "t", "columns": ["A", "B"]},
    ),
    "unit in the name, told without it": (
        table(["t [s];A [rad/s\u00b2];B [rad/s\u00b2]"], rows("{0:.4f};{1:.4f};{2:.4f}")),
        {"time": "t", "columns": ["A", "B"]},
    ),
    "volts of sensors": (
        table(["t;A [mV];B [mV]"], rows("{0:.4f};{1:.5f};{2:.5f}", 100.0 * G)),
        {"time": "t", "columns": ["A", "B"], "sensitivity": ["100 mV/g", "0.1 V/g"], "mounting_radius": 0.1},
    ),
    "nothing named": (table(["Time,A,B"], rows("{0:.4f},{1:.4f},{2:.4f}")), {}),
    "no clock": (
        table([], [r.split(" ", 1)[1] for r in rows("{0:.4f} {1:.4f} {2:.4f}")]),
        {"sample_rate": 1000.0},
    ),
}  # fmt: skip


@pytest.mark.parametrize("style", STYLES)
def test_files_of_many_loggers_give_the_same_campaign(tmp_path: Path, style: str) -> None:
    content, options = STYLES[style]
    (tmp_path / "run.txt").write_bytes(content)
    general = {k: v for k, v in TWO.items() if k not in ("time", "columns")}
    campaign = load_campaign(init_campaign(tmp_path / "out", [tmp_path / "run.txt"], **{**general, **options}))
    found = campaign.trials[0]
    # The first reading of `find` lies within two samples of the release.
    at = int(np.argmin(np.abs(TIMES - 0.1)))
    shift = int(np.argmin(np.abs(found.times - 0.1)))
    near = [
        np.max(np.abs(found.channels[0][shift + k : shift + k + 900] - wave()[at : at + 900]))
        for k in (-2, -1, 0, 1, 2)
    ]
    assert min(near) < 0.02
    assert found.configuration == "coupled"
    told = " ".join(campaign.warnings)
    assert ("No columns were named" in told) == ("columns" not in options)
    assert ("below the numbers" in told) == ("foot" in style)


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_record_in_which_nothing_moves_is_told_as_such(tmp_path: Path, noise: float) -> None:
    rest = noise * np.random.default_rng(1).standard_normal(TIMES.size)
    first = logger_file(tmp_path / "run.csv", rest)
    told = fault_of(tmp_path, first, release="find")
    assert "the record rests throughout" in told
    assert "moves from its first reading" not in told


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("release", ["find", "start", 5.0])
def test_a_sensor_the_other_way_round_is_told_and_turned(tmp_path: Path, sign: int, release: str | float) -> None:
    held = (0.0 if release == "start" else TIMES[0]) <= TIMES
    source = logger_file(tmp_path / "run.csv", sign * wave()[held], times=TIMES[held])
    told = load_campaign(init_campaign(tmp_path / "out", [source], **{**OPTIONS, "release": release})).warnings
    assert sum("looks reversed" in w and "run it again with --sign -1" in w for w in told) == (sign == -1)
    assert sum("revers" in w or "--sign" in w for w in told) == (sign == -1), "told once"
    options = {**OPTIONS, "release": release, "sign": [sign]}
    turned = load_campaign(init_campaign(tmp_path / "turned", [source], **options))
    assert "reversed" not in " ".join(turned.warnings)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(("kept", "noise"), [(0.004, 0.1), (0.008, 1.0)])  # of a second, of which 17 ms are a radian
def test_a_sensor_the_other_way_round_is_told_after_few_readings_at_rest(
    tmp_path: Path, sign: int, kept: float, noise: float
) -> None:
    clean = decay(TIMES, math.radians(4.7), 10.2, 0.031)
    source = logger_file(
        tmp_path / "run.csv", sign * (clean + noise * np.random.default_rng(3).standard_normal(TIMES.size))
    )
    told = load_campaign(init_campaign(tmp_path / "out", [source], **OPTIONS, before=kept)).warnings
    assert sum("looks reversed" in w for w in told) == (sign == -1)


@pytest.mark.parametrize("phase", np.linspace(0.0, 2.0 * math.pi, 13))
def test_a_record_that_begins_while_it_swings_is_not_called_reversed(tmp_path: Path, phase: float) -> None:
    """Few readings near 0, at whatever place of the swing the record begins, are no rest."""
    times = np.arange(800) / 500.0
    for beat in 0.0, 0.8:  # of two modes that nearly cancel for a while
        y = np.cos(50.0 * times + phase) + beat * np.cos(61.0 * times + 2.0 * phase)
        noise = 0.01 * np.random.default_rng(1).standard_normal(times.size)
        source = logger_file(tmp_path / f"{beat}.csv", 100.0 * (y + noise), times=times)
        folder = init_campaign(tmp_path / f"out{beat}", [source], **{**OPTIONS, "release": "start"})
        assert not any("is held at rest until" in w for w in load_campaign(folder).warnings)


def test_channels_in_files_of_their_own(tmp_path: Path) -> None:
    first = logger_file(tmp_path / "run1_a.csv", wave())
    second = logger_file(tmp_path / "run1_b.csv", 0.3 * wave(1))
    options = {**TWO, "columns": ["a", "a"], "files_per_trial": 2}
    trial = load_campaign(init_campaign(tmp_path / "out", [first, second], **options)).trials[0]
    assert np.ptp(trial.channels[1]) == pytest.approx(0.3 * np.ptp(wave(1)), rel=0.02)
    again = import_records(tmp_path / "out" / "import.toml", tmp_path / "again")
    assert (again / "trials.csv").read_bytes() == (tmp_path / "out" / "trials.csv").read_bytes()
    third = logger_file(tmp_path / "late.csv", wave(1), times=TIMES + 0.3)
    with pytest.raises(InputError, match="not read at the same times"):
        init_campaign(tmp_path / "other", [first, third], **options)
    with pytest.raises(InputError, match="files_per_trial = 2 for 1 files"):
        init_campaign(tmp_path / "other", [first], **options)


def test_channels_with_clocks_of_their_own_are_brought_to_one(tmp_path: Path) -> None:
    """Another rate, another zero, another name of the time, a column of words: as two loggers have it."""
    slower = np.arange(TIMES[0] + 0.1, TIMES[-1] - 0.1, 1.6 * (TIMES[1] - TIMES[0]))
    first = logger_file(tmp_path / "run1_a.csv", wave())
    second = tmp_path / "run1_b.csv"
    rows = [f"{t + 12.5:.6f},{y:.9f},OK" for t, y in zip(slower, np.interp(slower, TIMES, 0.3 * wave(1)), strict=True)]
    second.write_text("Elapsed Time,a,Status\n" + "\n".join(rows) + "\n")
    options = {**TWO, "columns": ["a", "a"], "files_per_trial": 2, "release": 5.0}
    with pytest.raises(InputError, match=r"not read at the same times .* in steps of .* --clock"):
        init_campaign(tmp_path / "out", [first, second], **options)
    campaign = load_campaign(init_campaign(tmp_path / "out", [first, second], **{**options, "clock": [0.0, 7.5]}))
    trial = campaign.trials[0]
    np.testing.assert_allclose(np.diff(trial.times), slower[1] - slower[0], rtol=1e-4)
    clear = (trial.times > 0.02) & (trial.times < trial.times[-1] - 0.02)  # of the jump at the release
    at = np.array(trial.times)[clear]
    for channel, of in zip(trial.channels, (wave(), 0.3 * wave(1)), strict=True):
        np.testing.assert_allclose(np.array(channel)[clear], np.interp(at, TIMES, of), atol=0.02 * np.ptp(of))
    assert any("channel 1 was brought to the times of channel 2" in w for w in campaign.warnings)
    assert any("column 3 (Status) holds words, no numbers, and was left out" in w for w in campaign.warnings)
    with pytest.raises(InputError, match="never read at one time"):
        init_campaign(tmp_path / "other", [first, second], **{**options, "clock": [0.0, 700.0]})


def test_a_copied_record_is_told(tmp_path: Path) -> None:
    sources = [logger_file(tmp_path / f"run{i}.csv", wave(i % 2)) for i in range(3)]
    told = check(init_campaign(tmp_path / "out", sources, **OPTIONS))
    assert len(told.warnings) == 1
    assert "A_uncoupled_3.csv: holds the same readings as trials/A_uncoupled_1.csv" in told.text()


def test_what_many_files_have_in_common_is_told_once(tmp_path: Path) -> None:
    sources = [logger_file(tmp_path / f"run{i}.csv", wave(i)) for i in range(3)]
    for path in sources:
        path.write_text(path.read_text() + "end of file\n")
    campaign = load_campaign(init_campaign(tmp_path / "out", sources, **OPTIONS))
    assert campaign.warnings == ("run0.csv and 2 other files: the last line, below the numbers, was left out.",)


def test_a_rig_without_a_magnet_needs_no_magnet(tmp_path: Path) -> None:
    """Coupled carts: nothing presses them together, so nothing rubs; told, and undone when a pull is given."""
    sources = [logger_file(tmp_path / f"cart{i}.csv", 0.01 * (1 - 0.7 * i) * wave(i)) for i in range(2)]
    options = {"kind": "translational", "files_per_trial": 2, "columns": ["a", "a"], "time": "t", "k1t": 900.0,
               "primary_inertia": 1.9, "secondary_inertia": 0.6, "release": 5.0}  # fmt: skip
    folder = init_campaign(tmp_path / "out", sources, **options)
    campaign = load_campaign(folder)
    assert campaign.rig.magnet_pull is None
    (told,) = (w for w in campaign.warnings if "no friction between them" in w)
    assert told.startswith("No force pressing the bodies together")
    assert campaign_priors(folder / "priors.toml", campaign).fixed["mu"] == 0.0
    again = import_records(folder / "import.toml", tmp_path / "again")
    assert (again / "priors.toml").read_bytes() == (folder / "priors.toml").read_bytes()
    pressed = {**options, "magnet_pull": 1.0, "normal_force": "constant"}
    assert load_campaign(init_campaign(folder, sources, overwrite=True, **pressed)).rig.magnet_pull
    assert not (folder / "priors.toml").exists()


def test_records_of_the_former_campaign_are_left_and_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Only those that its trials.csv named, and only while they are there; never a file of the user's own."""
    sources = [str(logger_file(tmp_path / f"run{i}.csv", wave(i))) for i in range(3)]
    folder = tmp_path / "rig"
    options = ["--time", "t", "--columns", "a", "--primary-inertia", "3.015e-3", "--k1t", "10.2", "--theta0", "4.7",
               "--release", "find"]  # fmt: skip
    assert main(["init", str(folder), *sources, *options, "--case", "old"]) == 0
    (folder / "trials" / "notes.txt").write_text("mine")
    assert "left over" not in capsys.readouterr().out
    (folder / "trials" / "old_uncoupled_3.csv").unlink()
    assert main(["init", str(folder), sources[0], *options, "--case", "new", "--overwrite"]) == 0
    told = capsys.readouterr().out
    assert "warning: trials/old_uncoupled_1.csv, trials/old_uncoupled_2.csv: left over from the campaign" in told
    assert "notes.txt" not in told
    there = {"new_uncoupled_1.csv", "notes.txt", "old_uncoupled_1.csv", "old_uncoupled_2.csv"}
    assert {p.name for p in (folder / "trials").iterdir()} == there
    table = ["--table", str(folder / "import.toml"), "--raw", str(tmp_path)]
    assert main(["init", str(folder), *table, "--overwrite"]) == 0
    assert "left over" not in capsys.readouterr().out


BOTH = {
    "primary_inertia": 3.015e-3, "secondary_inertia": 2.474e-3, "bar_radius": 0.1, "magnet_radius": 0.0127,
    "magnet_pull": 100.0, "k1t": 10.2, "theta0": 4.7, "release": "find",
}  # fmt: skip


def mixed_files(folder: Path) -> list[Path]:
    """Two records of one channel and two of two, each with a temperature that stands still."""
    out = []
    for name, channels in (("soft_free_1", 1), ("soft_free_2", 1), ("soft_magnet_1", 2), ("soft_magnet_2", 2)):
        columns = [TIMES + 5.0, wave(len(out)), 0.3 * wave(len(out) + 9)][: 1 + channels]
        heads = ["Zeit [s]", "A1 [rad/s^2]", "A2 [rad/s^2]"][: 1 + channels]
        rows = [",".join(f"{x:.5f}" for x in row) + ",21.4" for row in zip(*columns, strict=True)]
        out.append(folder / f"{name}.csv")
        out[-1].write_text("\n".join([",".join([*heads, "Temp"]), *rows]) + "\n", encoding="utf-8")
    return out


@pytest.mark.parametrize("named", [{}, {"time": "Zeit [s]", "columns": ["A1 [rad/s^2]", "A2 [rad/s^2]"]}])
def test_a_pile_of_coupled_and_uncoupled_records_is_told_apart(tmp_path: Path, named: dict) -> None:
    campaign = load_campaign(init_campaign(tmp_path / "out", mixed_files(tmp_path), **BOTH, **named))
    assert [t.coupled for t in campaign.trials] == [False, False, True, True]
    assert [t.trial for t in campaign.trials] == [1, 2, 1, 2]
    assert any("One channel only, so taken as uncoupled: soft_free_1.csv, soft_free_2" in w for w in campaign.warnings)
    assert not any("Temp" in w for w in campaign.warnings)


def test_files_that_all_have_two_channels_are_taken_as_coupled_and_told(tmp_path: Path) -> None:
    campaign = load_campaign(init_campaign(tmp_path / "out", mixed_files(tmp_path)[2:], **BOTH))
    assert all(t.coupled for t in campaign.trials)
    assert any("all trials are taken as coupled. If that is wrong" in w for w in campaign.warnings)


def test_a_secondary_that_never_moves_is_told(tmp_path: Path) -> None:
    """Both sensors are logged in every trial, and in the uncoupled ones the second only hums."""
    sources = mixed_files(tmp_path)[2:]
    rng = np.random.default_rng(5)
    rows = np.column_stack([TIMES, wave(3), 0.02 * rng.standard_normal(TIMES.size)])
    head = "Zeit [s],A1 [rad/s^2],A2 [rad/s^2]"
    np.savetxt(sources[0], rows, delimiter=",", header=head, comments="", fmt="%.6f")
    campaign = load_campaign(init_campaign(tmp_path / "out", sources, **BOTH))
    (told,) = [w for w in campaign.warnings if "the secondary rests throughout" in w]
    assert told.startswith("trials/A_coupled_1.csv: ")
    again = load_campaign(init_campaign(tmp_path / "both", mixed_files(tmp_path)[2:], **BOTH))
    assert not any("rests throughout" in w for w in again.warnings)


def test_words_of_the_names_say_which_trials_are_coupled(tmp_path: Path) -> None:
    sources, pattern = mixed_files(tmp_path), "{case}_{configuration}_{trial}"
    words = ["free=uncoupled", "magnet=coupled"]
    campaign = load_campaign(init_campaign(tmp_path / "out", sources, **BOTH, pattern=pattern, words=words))
    assert [(t.case, t.coupled, t.trial) for t in campaign.trials] == [
        ("soft", False, 1), ("soft", False, 2), ("soft", True, 1), ("soft", True, 2)
    ]  # fmt: skip
    told = r"'free' stands where --pattern expects 'uncoupled' or 'coupled'.*--words free="
    with pytest.raises(InputError, match=told):
        init_campaign(tmp_path / "other", sources, **BOTH, pattern=pattern)
    with pytest.raises(InputError, match=r"--words \['free=loose'\]: write what the names say"):
        init_campaign(tmp_path / "other", sources, **BOTH, pattern=pattern, words=["free=loose"])


def test_files_behind_the_words_are_files(tmp_path: Path) -> None:
    sources, pattern = mixed_files(tmp_path), "{case}_{configuration}_{trial}"
    options = [word for key, value in BOTH.items() for word in (f"--{key.replace('_', '-')}", *_words(value))]
    words = ["--words", "free=uncoupled", "magnet=coupled", *map(str, sources)]
    assert main(["init", str(tmp_path / "out"), *options, "--pattern", pattern, *words]) == 0
    assert len(load_campaign(tmp_path / "out").trials) == 4


def _words(value: object) -> list[str]:
    return [str(v) for v in value] if isinstance(value, list | tuple) else [str(value)]


def test_a_fault_of_many_files_is_told_once(tmp_path: Path) -> None:
    sources = [logger_file(tmp_path / f"run{i}.csv", wave(i)) for i in range(4)]
    with pytest.raises(InputError) as caught:
        init_campaign(tmp_path / "out", sources, **{**OPTIONS, "units": ["g"]})
    assert len(caught.value.faults) == 1
    assert caught.value.faults[0].startswith("run0.csv and 3 other files: 'g' is tangential; give mounting_radius in ")


def test_a_record_that_rests_first_is_told_how_to_find_its_release(tmp_path: Path) -> None:
    options = {k: v for k, v in OPTIONS.items() if k not in ("release", "theta0")}
    source = logger_file(tmp_path / "run.csv", wave())
    warnings = load_campaign(init_campaign(tmp_path / "out", [source], **options)).warnings
    assert any("rests for its first 0.2 s: with --release find, t = 0 is the release" in w for w in warnings)


@pytest.mark.parametrize(("lift", "option"), [(1.5, "first_peak"), (0.0, "find")])
def test_init_and_check_name_the_same_option_for_a_record_that_rests_first(
    tmp_path: Path, lift: float, option: str
) -> None:
    """A hand lifts a cart for so many seconds and lets go, or strikes it."""
    t = np.arange(0.0, 12.0, 0.02)
    swing = np.cos(6.0 * (t - 1.5 - lift)) if lift else np.sin(6.0 * (t - 1.5))
    y = np.where(t < 1.5 + lift, np.clip((t - 1.5) / (lift or 1.0), 0.0, 1.0) * bool(lift), swing)
    y *= 0.05 * np.exp(-0.2 * np.maximum(t - 1.5 - lift, 0.0))
    noise = np.random.default_rng(0).normal(0.0, 2e-4, t.size)
    raw = tmp_path / "cart.csv"
    raw.write_text("time (s),x (m)\n" + "".join(f"{a:.2f},{b:.6f}\n" for a, b in zip(t, y + noise, strict=True)))
    rig = {"kind": "translational", "quantity": "displacement", "primary_inertia": 0.5, "k1t": 18.0}
    folder = init_campaign(tmp_path / "out", [raw], case="A", configuration="uncoupled", **rig)
    named = [re.findall(r"--release (\w+)", w) for w in load_campaign(folder).warnings]
    assert [found for found in named if found] == [[option], [option]]


def test_names_and_a_sheet_tell_the_trials_apart(tmp_path: Path) -> None:
    sources = []
    for case, k1t, theta0 in (("I", 6.2, 5.7), ("IV", 10.2, 4.7)):
        for trial in (1, 2):
            y = decay(TIMES, math.radians(theta0), k1t, 0.031) + np.random.default_rng(trial).standard_normal(
                len(TIMES)
            )
            sources.append(logger_file(tmp_path / f"case{case}_uncoupled_{trial}.csv", y))
    sheet = tmp_path / "sheet.csv"
    sheet.write_text("case;k1t;theta0\nI;6,2;5,7\nIV;10,2;4,7\n", encoding="utf-8")
    options = {k: v for k, v in OPTIONS.items() if k not in ("k1t", "theta0")} | {"sheet": str(sheet)}
    pattern = "case{case}_{configuration}_{trial}"
    campaign = load_campaign(init_campaign(tmp_path / "out", sources, pattern=pattern, **options))
    assert [(t.case, t.trial, t.k1t.value) for t in campaign.trials] == [
        ("I", 1, 6.2), ("I", 2, 6.2), ("IV", 1, 10.2), ("IV", 2, 10.2)
    ]  # fmt: skip
    assert math.degrees(campaign.trials[0].theta0.value) == pytest.approx(5.7)
    for wrong, sentence in (
        ({"pattern": "run{trial}"}, r"does not follow --pattern 'run\{trial\}': \{trial\} stands for digits"),
        ({"pattern": "{colour}"}, r"write each of \{case\}"),
        ({"pattern": pattern, "sheet": str(tmp_path / "none.csv")}, "cannot be read"),
        ({"pattern": "case{case}_uncoupled_1"}, "does not follow"),
    ):
        with pytest.raises(InputError, match=sentence):
            init_campaign(tmp_path / "wrong", sources, **(options | wrong))
    sheet.write_text("case,k1t,theta0\nI,6.2,5.7\nIV,10.2,\nII,7.9,5.0\n", encoding="utf-8")
    lacking = r"theta0 is given for some trials and missing for caseIV_uncoupled_1.csv, caseIV_uncoupled_2.csv; give it"
    with pytest.raises(InputError, match=lacking):  # no trial becomes a free start without a word
        init_campaign(tmp_path / "wrong", sources, pattern=pattern, **options)
    sheet.write_text("case,k1t,theta0\nI,6.2,5.7\nIV,10.2,4.7\nII,7.9,5.0\n", encoding="utf-8")
    extra = init_campaign(tmp_path / "extra", sources, pattern=pattern, **options)
    assert "sheet.csv: II describes none of the files" in (extra / "campaign.toml").read_text()
    sheet.write_text("case,kt1\nI,6.2\n", encoding="utf-8")
    with pytest.raises(InputError, match="unknown column 'kt1'"):
        init_campaign(tmp_path / "wrong", sources, **options)
    sheet.write_text("file,case,trial,k1t,theta0\ncaseI_uncoupled_1.csv,I,1,6.2,5.7\n", encoding="utf-8")
    assert len(load_campaign(init_campaign(tmp_path / "sheet", [], **options)).trials) == 1


@pytest.mark.parametrize("named", [True, False])
def test_rows_of_a_sheet_take_trials_side_by_side_from_one_file(tmp_path: Path, named: bool) -> None:
    """As a teaching logger exports its runs: one table, a column for each."""
    runs = [wave() * size for size in (1.0, 0.8, 0.6)]
    lines = [",".join(f"{x:.6f}" for x in row) for row in zip(TIMES, *runs, strict=True)]
    source = tmp_path / "runs.csv"
    source.write_text('Time (s),"Angle, Run 1","Angle, Run 2","Angle, Run 3"\n' + "\n".join(lines), encoding="utf-8")
    sheet = tmp_path / "sheet.csv"
    sheet.write_text("file;columns;offset\nruns.csv;2;0,1\nruns.csv;Angle, Run 2;none\nruns.csv;4;\n", encoding="utf-8")
    options = {"time": "Time (s)", "sheet": str(sheet), "k1t": 10.2, "primary_inertia": 0.003}
    folder = init_campaign(tmp_path / "out", [source] if named else [], **options)
    trials = load_campaign(folder).trials
    assert [t.trial for t in trials] == [1, 2, 3]
    for trial, run, offset in zip(trials, runs, (0.1, 0.0, 0.0), strict=True):
        assert trial.configuration == "uncoupled"
        np.testing.assert_allclose(trial.channels[0], run - offset, atol=1e-6)


def test_a_fault_of_readings_without_a_unit_comes_with_what_they_were_taken_for(tmp_path: Path) -> None:
    """Positions of a slow pendulum, taken as accelerations, are a swing of many turns."""
    times = np.arange(400) / 20.0
    source = logger_file(tmp_path / "x.txt", 30.0 * np.cos(0.6 * times), times=times)
    said = fault_of(tmp_path, source, release="start", k1t=0.36, theta0=None, theta0_std=None, primary_inertia=1.0)
    assert "the readings imply a swing of" in said
    assert "taken as accelerations in rad/s^2; for angles or speeds give --quantity" in said


def test_a_clock_that_begins_anew_is_said_to_do_so(tmp_path: Path) -> None:
    """A logger whose file begins with the end of the last run, and with lines of zeros until its clock is set."""
    source = logger_file(tmp_path / "run.csv", wave())
    head, *lines = source.read_text().splitlines()
    source.write_text("\n".join([head, "9.1,0.2", "9.2,0.1", *["0,0"] * 20, *lines]) + "\n", encoding="utf-8")
    assert "after 9.2 s; it does from reading 22 of 1422 on: if the logger began anew there, skip_lines" in fault_of(
        tmp_path, source
    )
    source.write_text("\n".join([*lines[:1300], *lines[1200:]]) + "\n", encoding="utf-8")
    assert fault_of(tmp_path, source, time=1, columns=[2]).endswith("; sort the rows, or give sample_rate")


def test_a_sheet_gives_each_file_its_release(tmp_path: Path) -> None:
    for name in ("one.csv", "two.csv"):
        logger_file(tmp_path / name, wave())
    sheet = tmp_path / "sheet.csv"
    options = OPTIONS | {"sheet": str(sheet)}
    del options["theta0"]
    sheet.write_text("file;release\none.csv;5,25\ntwo.csv;first_peak\n", encoding="utf-8")
    spec = tomllib.loads((init_campaign(tmp_path / "out", [], **options) / "import.toml").read_text())
    assert [trial["release"] for trial in spec["trials"]] == [5.25, "first_peak"]
    sheet.write_text("file;release\none.csv;1x\n", encoding="utf-8")
    with pytest.raises(InputError, match="line 2, column 'release': '1x' is not a number"):
        init_campaign(tmp_path / "wrong", [], **options)


def test_raw_says_where_the_files_lie_that_a_sheet_names(tmp_path: Path) -> None:
    (tmp_path / "raw").mkdir()
    logger_file(tmp_path / "raw" / "one.csv", wave())
    sheet = tmp_path / "sheet.csv"
    sheet.write_text("file,case,k1t,theta0,theta0_std\none.csv,IV,10.2,4.7,0.1\n", encoding="utf-8")
    options = ["--time", "t", "--columns", "a", "--release", "find", "--primary-inertia", "3.015e-3"]
    folder, raw = str(tmp_path / "out"), str(tmp_path / "raw")
    assert main(["init", folder, "--sheet", str(sheet), "--raw", raw, *options]) == 0
    assert load_campaign(folder).trials[0].case == "IV"
    assert main(["init", str(tmp_path / "other"), "--sheet", str(sheet), *options]) == 2


@pytest.mark.parametrize("unit", ["mNm", "mN·m", "mN*m", "mN m", "mN.m"])
def test_a_torque_has_its_unit_however_it_is_written(tmp_path: Path, unit: str) -> None:
    """A line of units stays one where one of them is unknown, and that one is named."""
    rows = "\n".join(f"{0.01 * i:.2f};{math.sin(0.1 * i):.5f};{2.0 * math.cos(i):.3f};21.5" for i in range(400))
    (tmp_path / "bench.txt").write_text(f"# bench\nt;gyro;torque;temp\ns;rad/s;{unit};degC\n{rows}\n")
    options = {"quantity": "velocity", "primary_inertia": 0.021, "k1t": 0.92, "columns": ["gyro"], "torque": "torque"}
    options |= {"configuration": "uncoupled"}
    campaign = load_campaign(init_campaign(tmp_path / "out", [tmp_path / "bench.txt"], time="t", **options))
    assert np.abs(campaign.trials[0].torque).max() == pytest.approx(2e-3, rel=0.01)
    assert any("the unit 'degC' of temp is not known" in w for w in campaign.warnings)
    assert not any("no unit is named" in w for w in campaign.warnings)
    (tmp_path / "bare.txt").write_text(f"t;gyro;torque\n{rows.replace(';21.5', '')}\n")
    options |= {"torque_unit": unit}
    campaign = load_campaign(init_campaign(tmp_path / "bare", [tmp_path / "bare.txt"], time="t", **options))
    assert np.abs(campaign.trials[0].torque).max() == pytest.approx(2e-3, rel=0.01)
    assert any("no unit is named, so the readings were taken as velocities in rad/s" in w for w in campaign.warnings)


def test_positions_are_not_silently_taken_as_accelerations(tmp_path: Path) -> None:
    """A column whose name or unit says a length asks for --quantity; where nothing says what it is, a caveat does."""
    y = 12.0 * decay(TIMES, 1.0, 10.2, 0.031)[200:] / 3383.0  # mm
    source = logger_file(tmp_path / "cart.csv", y, times=TIMES[200:])
    kind = {"kind": "translational", "primary_inertia": 1.0, "k1t": 3383.0, "columns": [2]}
    campaign = load_campaign(init_campaign(tmp_path / "out", [source], **kind))
    assert any("no unit is named" in w and "--quantity" in w for w in campaign.warnings)
    source.write_text(source.read_text().replace("t,a", "t,x_mm"))
    with pytest.raises(InputError, match="give --quantity displacement"):
        init_campaign(tmp_path / "named", [source], **kind)
    campaign = load_campaign(init_campaign(tmp_path / "named", [source], quantity="displacement", **kind))
    assert np.abs(campaign.trials[0].channels).max() == pytest.approx(1e-3 * np.abs(y).max())
    assert not any("no unit" in w for w in campaign.warnings)


@pytest.mark.parametrize(
    ("pattern", "names", "cases"),
    [
        ("k{k1t}_{trial}", ("k6.2_1", "k6.2_2", "k10.2_1"), ["k1t 6.2", "k1t 6.2", "k1t 10.2"]),
        ("rel{theta0}_{trial}", ("rel5_1", "rel4_1", "rel4_2"), ["5 deg", "4 deg", "4 deg"]),
        ("run{theta0}", ("run4.71", "run4.68"), ["A", "A"]),  # angles as they were measured, trial by trial
    ],
)
def test_springs_and_angles_in_the_names_tell_the_cases(
    tmp_path: Path, pattern: str, names: tuple[str, ...], cases: list[str]
) -> None:
    sources = [logger_file(tmp_path / f"{name}.csv", wave(i)) for i, name in enumerate(names)]
    options = {k: v for k, v in OPTIONS.items() if "{" + k + "}" not in pattern}
    campaign = load_campaign(init_campaign(tmp_path / "out", sources, pattern=pattern, **options))
    assert [t.case for t in campaign.trials] == cases


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (b"PK\x03\x04" + bytes(range(200)), "an Excel workbook or another archive; save it as CSV"),
        (bytes(range(256)) * 20, "this is no text"),
        (b"hello\nworld\nfoo\nbar\n", "holds no row of numbers"),
        (
            table(["t,a"], ["0.0,1.0"] * 3 + ["0.1,bad"] + ["0.2,1.0"] * 9),
            "line 5: 'bad' is no number; where a reading",
        ),
        (table(["t,a"], ["0.0,1.0"] * 9 + ["pause,off"] + ["0.2,1.0"] * 9), "'pause,off' is not a row of numbers"),
        (table(["t;a"], ["0,1;2,5"] * 9 + ["0,2;OVER"] + ["0,3;2,5"] * 9), "line 11: 'OVER' is no number; where"),
        (table(["t;a"], ["0.1;2.5"] * 9 + ["0.2;1,987.2"] + ["0.3;2.5"] * 9), "'1,987.2' has a mark between thousands"),
        (table(["t,a,a"], ["0.0,1.0,2.0"] * 30), "2 columns are called 'a'; give their numbers"),
        (table(["t,a"], ["0,0,1,5"] * 30), "4 columns"),
        (table(["t,a [mV]"], [f"{i / 1e3:.3f},1.5" for i in range(99)]), "give the sensitivity of each sensor"),
    ],
)
def test_what_cannot_be_read_is_told_in_one_sentence(tmp_path: Path, content: bytes, sentence: str) -> None:
    (tmp_path / "run.csv").write_bytes(content)
    assert sentence in fault_of(tmp_path, tmp_path / "run.csv", release="start")


def test_a_record_that_starts_in_the_middle(tmp_path: Path) -> None:
    source = logger_file(tmp_path / "run.csv", wave()[270:], times=TIMES[270:])
    assert "it starts in the middle" in fault_of(tmp_path, source)


def test_one_unit_serves_both_channels_and_a_fault_names_the_file(tmp_path: Path) -> None:
    times = np.arange(400) * 1e-2
    x = 40.0 * np.exp(-0.1 * times) * np.cos(6.0 * times)
    for name, columns in (("free_1", (times, x)), ("damped_1", (times, x, 0.5 * x))):
        np.savetxt(
            tmp_path / f"{name}.csv", np.column_stack(columns), "%.6g", ",", header="t,a,b"[: 2 * len(columns) - 1]
        )
    given = {
        "pattern": "{configuration}_{trial}", "words": ["free=uncoupled", "damped=coupled"], "k1t": 43.0,
        "kind": "translational", "quantity": "displacement", "primary_inertia": 1.2, "secondary_inertia": 1.0,
        "units": ["mm"],
    }  # fmt: skip
    init_campaign(tmp_path / "c", [tmp_path / "free_1.csv", tmp_path / "damped_1.csv"], **given)
    found = {t.configuration: t.channels for t in load_campaign(tmp_path / "c").trials}
    assert found["coupled"] == pytest.approx(found["uncoupled"] * [[1.0], [0.5]], abs=1e-7)
    with pytest.raises(InputError, match=r"^damped_1.csv: 'sign' has 1 entries for 2 channels"):
        init_campaign(tmp_path / "d", [tmp_path / "free_1.csv", tmp_path / "damped_1.csv"], **given, sign=[1])


@pytest.mark.parametrize("name", ["rotary_pendulum", "tuned_mass_damper", "double_pendulum"])
def test_real_rigs_come_out_as_shipped(tmp_path: Path, name: str) -> None:
    if not (RAW / name).is_dir():
        pytest.skip(f"the raw files of {name} are not here; set BAYES_DAMPER_REALDATA to their folder")
    shipped = ROOT / "data" / "real" / name
    folder = import_records(shipped / "import.toml", tmp_path / "out", RAW / name)
    for file in ("campaign.toml", "trials.csv"):
        digests = [hashlib.sha256((f / file).read_bytes()).hexdigest() for f in (folder, shipped)]
        assert digests[0] == digests[1]
    assert load_campaign(folder).training


def test_declared_numbers_are_written_as_a_person_writes_them(tmp_path: Path) -> None:
    for theta0 in (4.7, 5.0, 20.0, 0.5):
        source = logger_file(tmp_path / "run.csv", theta0 / 4.7 * wave())
        folder = init_campaign(tmp_path / f"out{theta0}", [source], **{**OPTIONS, "theta0": theta0, "theta0_std": 0.1})
        assert f",{theta0:g},0.1," in (folder / "trials.csv").read_text().splitlines()[1]


def test_pixels_and_counts_are_refused_with_what_describes_them(tmp_path: Path) -> None:
    source = logger_file(tmp_path / "run.csv", wave())
    told = fault_of(tmp_path, source, units=["px"], quantity="displacement", kind="translational")
    assert "'px' is no unit of displacement: give --units m and, as --scale, how many m one of them is" in told
    told = fault_of(tmp_path, source, units=["px"], quantity="displacement", kind="torsional")
    assert "(a video: --units m, --scale, --mounting-radius of the marker, and --sideways)" in told
    told = fault_of(tmp_path, source, units=["counts"], quantity="acceleration", kind="torsional")
    assert "(counts of an encoder: --quantity displacement --units rad)" in told


def test_what_a_sensor_reads_before_the_release_is_taken_off(tmp_path: Path) -> None:
    source = logger_file(tmp_path / "run.csv", wave() + 20.0)
    trial = load_campaign(init_campaign(tmp_path / "out", [source], **OPTIONS, offset="head")).trials[0]
    true = load_campaign(init_campaign(tmp_path / "true", [source], **OPTIONS, offset=20.0)).trials[0]
    np.testing.assert_allclose(trial.channels, true.channels, atol=4.0 / math.sqrt(200))
    early = {**OPTIONS, "release": "start", "offset": "head"}
    assert "wants at least 8 readings before the release, the record has 0" in fault_of(tmp_path / "a", source, **early)
    moved = {**OPTIONS, "quantity": "displacement", "offset": "head"}
    assert "a displacement does not begin at 0: use 'tail'" in fault_of(tmp_path / "b", source, **moved)
    free = {key: value for key, value in OPTIONS.items() if not key.startswith("theta0")} | {"offset": "head"}
    begun = load_campaign(init_campaign(tmp_path / "free", [source], **free | {"release": "find"}))
    assert begun.measurement.start == "free"
    moving = trial.channels[0, trial.times > 0.0]
    np.testing.assert_allclose(begun.trials[0].channels[0, 1:51], moving[1:51], atol=1e-6)
    told = fault_of(tmp_path / "c", source, **free | {"release": "start"})
    assert "wants at least 8 readings before the release, the record has 0: use --release find" in told


def test_a_tail_that_holds_too_little_of_a_swing_is_noted(tmp_path: Path) -> None:
    """The mean of two periods is the middle of the swing within a twentieth of it; of one it is anything.

    More than the last quarter of a record is taken where that holds too few.
    """
    for end, noted in ((1.0, False), (0.4, False), (0.2, True)):
        source = logger_file(tmp_path / f"{end}.csv", wave() + 40.0)
        folder = init_campaign(tmp_path / f"out{end}", [source], **OPTIONS, offset="tail", end=5.0 + end)
        campaign = load_campaign(folder)
        assert any("still swings and holds" in w for w in campaign.warnings) == noted, campaign.warnings
        held = campaign.trials[0].channels[0][:19]
        assert noted or abs(float(np.mean(held))) < 3.0, "of 40, under a swing of 280"


def test_truth_values_of_an_import_table_are_no_numbers(tmp_path: Path) -> None:
    source = logger_file(tmp_path / "run.csv", wave())
    folder = init_campaign(tmp_path / "made", [source], **OPTIONS, header=True, holdout=False)
    again = import_records(folder / "import.toml", tmp_path / "again")
    assert load_campaign(again).trials[0].holdout is False


@pytest.mark.parametrize("file", ["../out.csv", "/tmp/out.csv", "x" * 300, ".", "C:/out.csv"])
def test_an_import_table_writes_nothing_outside_its_campaign(tmp_path: Path, file: str) -> None:
    folder = init_campaign(tmp_path / "made", [logger_file(tmp_path / "run.csv", wave())], **OPTIONS)
    table = tmp_path / "table.toml"
    table.write_text(f'{(folder / "import.toml").read_text()}file = "{file}"\n', encoding="utf-8")
    with pytest.raises(InputError, match="leaves the campaign's folder, or is too long"):
        import_records(table, tmp_path / "out")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["made", "run.csv", "table.toml"]


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_named_pipes_beside_a_campaign_do_not_hang_an_import(tmp_path: Path) -> None:
    source = logger_file(tmp_path / "run.csv", wave())
    folder = init_campaign(tmp_path / "made", [source], **OPTIONS)
    os.mkfifo(folder / "priors.toml")
    for call in (
        lambda: import_records(folder / "import.toml", tmp_path / "out"),
        lambda: init_campaign(folder, [source], overwrite=True, **OPTIONS),
    ):
        with pytest.raises(InputError, match="a named pipe, not a file"):
            call()
    (folder / "trials.csv").unlink()
    os.mkfifo(folder / "trials.csv")
    assert records_in(folder) == ()


def _turning_far(folder: Path, column: str, lengths: tuple[float, float], **reader: object) -> tuple[str, ...]:
    """Remarks on two stretches of a disk that turns by 4.7 rad about its rest, in a column of that name."""
    times = np.arange(0.0, 40.0, 0.05)
    y = 4.7 * np.exp(-0.02 * times) * np.cos(3.0 * times) + 1e-3 * np.random.default_rng(1).standard_normal(times.size)
    folder.mkdir()
    rows = (f"{t:.2f},{v:.6f}" for t, v in zip(times, y, strict=True))
    (folder / "disk.csv").write_text("\n".join([f"t,{column}", *rows]) + "\n")
    ends = [{"end": lengths[0]}, {"start": 20.0, "end": 20.0 + lengths[1]}] if lengths else [{}]
    trial = {"source": "disk.csv", "columns": [2], "case": "A", "configuration": "uncoupled", "k1t": 9.0}
    table = {
        "name": "disk", "rig": {"primary_inertia": 1.0},
        "measurement": {"start": "free", "quantity": "displacement"}, "reader": {"time": "t", **reader},
        "trials": [trial | end for end in ends],
    }  # fmt: skip
    return load_campaign(import_records(table, folder / "out", folder)).warnings


def test_a_swing_of_more_than_half_a_turn_is_not_doubted_where_its_unit_was_declared(tmp_path: Path) -> None:
    def doubts(name: str, *given: object, **reader: object) -> bool:
        return any("degrees" in w for w in _turning_far(tmp_path / name, *given, **reader))

    assert doubts("nowhere", "angle", ())
    assert not doubts("file", "angle (rad)", ())
    assert not doubts("user", "angle", (), units=["rad"])
    text = (tmp_path / "nowhere" / "out" / "campaign.toml").read_text()
    (tmp_path / "nowhere" / "out" / "campaign.toml").write_text(
        text.replace('start = "free"', 'units = "declared"\nstart = "free"')
    )
    assert not any("degrees" in w for w in load_campaign(tmp_path / "nowhere" / "out").warnings)
    with pytest.raises(InputError, match="degrees taken for radians"):
        _turning_far(tmp_path / "impossible", "angle (rad)", (), units=["rad"], scale=[57.3])


def test_stretches_that_the_table_cuts_are_not_taken_for_records_that_were_cut_off(tmp_path: Path) -> None:
    assert not any("cut off" in w for w in _turning_far(tmp_path / "table", "angle (rad)", (19.0, 9.0)))
    trials = tmp_path / "table" / "out" / "trials.csv"
    trials.write_text(trials.read_text().replace("true", "false"))
    assert any("cut off" in w for w in load_campaign(trials.parent).warnings)


def test_a_time_without_a_unit_that_would_be_slow_in_seconds_is_remarked_on(tmp_path: Path) -> None:
    options = {"columns": ["a"], "quantity": "displacement", "primary_inertia": 1.0}
    source = logger_file(tmp_path / "run.csv", 1e-3 * wave(), times=1000.0 * TIMES)
    found = load_campaign(init_campaign(tmp_path / "out", [source], **options)).warnings
    assert any("no unit is named for the time, so it was taken in seconds, and readings come every" in w for w in found)
    found = load_campaign(init_campaign(tmp_path / "ms", [source], **options, time_unit="ms")).warnings
    assert not any("unit is named for the time" in w for w in found)
