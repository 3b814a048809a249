"""Files of loggers as columns: JSON, MATLAB, and columns found by their names."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from campaigns import decay
from scipy.io import savemat

from bayes_damper.campaign.importing import logger_files
from bayes_damper.campaign.importing.logger_columns import LoggerFile
from bayes_damper.campaign.importing.logger_files import read_file
from bayes_damper.campaign.importing.options import ReaderOptions
from bayes_damper.errors import InputError

TIMES = np.arange(-200, 1200) / 1000.0


def wave(seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal(len(TIMES))
    return decay(TIMES, math.radians(4.7), 10.2, 0.031) + noise


def test_readings_of_a_json_file_become_columns(tmp_path: Path) -> None:
    rows = [
        {"time": t, "angle": a, "on": i > 3, "note": "x"} for i, (t, a) in enumerate(zip(TIMES, wave(), strict=True))
    ]
    path = tmp_path / "log.json"
    path.write_text(json.dumps({"mass": 0.49, "entries": rows}), encoding="utf-8")
    found = read_file(path)
    assert found.names == ("time", "angle", "on")
    np.testing.assert_array_equal(found.table[:, 1], wave())


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{", "not valid JSON .*line 1"),
        ('{"a": 1}', "holds 0 lists of readings"),
        ('[{"a": "x"}, {"a": "y"}]', "hold no numbers"),
        ('[{"a": 1}, {"a": "y"}]', "a reading is no number"),
    ],
)
def test_a_json_file_without_readings_is_refused(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "log.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=told):
        read_file(path)


def test_a_field_of_a_matlab_structure_is_a_variable(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    savemat(path, {"th": {"time": TIMES[:, None], "signals": {"values": wave()[:, None]}}})
    option = ReaderOptions(matlab_time=("th.time",), matlab_data=("th.signals.values",))
    np.testing.assert_array_equal(read_file(path, option).table, np.stack([TIMES, wave()], axis=1))
    with pytest.raises(InputError, match=r"no variable 'th\.signal'; it holds th\.time \(1400 x 1\), th\.sig"):
        read_file(path, replace(option, matlab_data=("th.signal",)))


@pytest.mark.parametrize(
    ("option", "sentence"),
    [
        (
            {},
            r"It holds t \(1400 x 1\), th\.a \(1 x 1400\), few .*: name them with --matlab-data, and the time's",
        ),
        ({"matlab_time": ["t"], "matlab_data": ["few"]}, "names 1400 readings and matlab_data 5; the file holds t"),
        ({"matlab_data": ["words"]}, r"'words' holds no numbers; it holds .*th\.a"),
        ({"matlab_data": ["th.a", "few", "square"]}, "'square' has 3 columns, those before it 1"),
    ],
)
def test_the_arrays_of_a_matlab_file_are_listed(tmp_path: Path, option: dict[str, list[str]], sentence: str) -> None:
    path = tmp_path / "log.mat"
    content = {"t": TIMES[:, None], "th": {"a": wave()}, "few": np.arange(5), "words": "Run 1", "square": np.eye(3)}
    savemat(path, content)
    with pytest.raises(InputError, match=sentence):
        read_file(path, ReaderOptions.of(option))


@pytest.mark.parametrize("word", ["zeit", "Zeit_MS", "messung.ziet_ms", "zeitms", "messung.t.zeit"])
def test_an_array_that_is_misspelt_or_abbreviated_is_found(tmp_path: Path, word: str) -> None:
    path = tmp_path / "log.mat"
    savemat(path, {"messung": {"weg_mm": wave(), "zeit_ms": TIMES}, "rate": 100.0})
    listed = r"it holds messung\.weg_mm \(1 x 1400\), messung\.zeit_ms \(1 x 1400\)"
    with pytest.raises(InputError, match=rf"no variable '{word}'; {listed}: did you mean 'messung\.zeit_ms'\?"):
        read_file(path, ReaderOptions(matlab_time=(word,)))
    with pytest.raises(InputError, match="columns without names; give its number from 1"):
        read_file(path, ReaderOptions(matlab_data=("messung.weg_mm",))).index(word, "log.mat")
    with pytest.raises(InputError, match=r"did you mean 'messung\.zeit_ms'"):
        LoggerFile(("messung.weg_mm", "messung.zeit_ms"), np.zeros((9, 2))).index(word, "log.csv")


def test_a_matlab_file_may_hold_each_channel_in_an_array_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "log.mat"
    savemat(path, {"daq": {"t": TIMES, "enc1": wave(), "enc2": 0.3 * wave(), "both": np.stack([wave(), wave()])}})
    read = partial(read_file, path)
    table = read(ReaderOptions(matlab_time=("daq.t",), matlab_data=("daq.enc1", "daq.enc2"))).table
    np.testing.assert_array_equal(table, np.column_stack([TIMES, wave(), 0.3 * wave()]))
    more = read(ReaderOptions(matlab_time=("daq.t",), matlab_data=("daq.enc1", "daq.both"))).table
    assert more.shape == (TIMES.size, 4)
    twice = read(ReaderOptions(matlab_time=("daq.t", "daq.t"), matlab_data=("daq.enc1", "daq.enc2"))).table
    assert twice.shape == (2 * TIMES.size, 2)
    assert read(ReaderOptions(matlab_data=("daq.enc1", "daq.enc2"))).table.shape == (2 * TIMES.size, 1)


@pytest.mark.parametrize("place", [176, 177])
def test_a_matlab_file_that_crashes_its_reader_is_refused(tmp_path: Path, place: int) -> None:
    """SciPy looks the type of numbers up in a table and past its end, which ends the process with a signal."""
    path = tmp_path / "log.mat"
    savemat(path, {"t": TIMES[:6]})
    raw = bytearray(path.read_bytes())
    raw[place] = 0xFF
    path.write_bytes(raw)
    with pytest.raises(InputError, match=r"log\.mat: not a MATLAB file that can be read .*; copy it again, or save it"):
        read_file(path, ReaderOptions(matlab_data=("t",)))


def test_a_small_matlab_file_has_less_time_and_memory_to_be_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """Some damaged ones fill the memory until they are stopped."""
    given: list[dict[str, float]] = []
    monkeypatch.setattr(logger_files, "apart", lambda _, __, **most: given.append(most) or {"t": TIMES[:, None]})
    for size in (1000, 1_000_000):
        logger_files._read_matlab(bytes(size), "log.mat", ReaderOptions(matlab_data=("t",)))
    assert [most["seconds"] for most in given] == pytest.approx([15.0, 15.2], abs=0.01)
    assert [most["memory"] for most in given] == pytest.approx([5e8, 5.2e8], rel=1e-3)


def test_names_stand_above_units_of_pixels_with_none_for_the_frame(tmp_path: Path) -> None:
    path = tmp_path / "clip.txt"
    rows = "".join(f"{i}\t{i / 60:.4f}\t{600 + i}\t{500 - i}\n" for i in range(40))
    path.write_text("# Tracker export\nframe\tt\tx\ty\n\ts\tpx\tpx\n" + rows, encoding="utf-8")
    found = read_file(path)
    assert found.names == ("frame", "t", "x", "y")
    assert found.units == ("", "s", "px", "px")


def test_a_column_is_found_by_what_its_name_begins_with(tmp_path: Path) -> None:
    """Some loggers put unit and run behind the name of a column."""
    path = tmp_path / "run.csv"
    rows = np.column_stack([np.arange(50) / 100.0, np.cos(np.arange(50)), np.sin(np.arange(50))])
    head = "Time (s) Run #1,Position (m) Run #1,Positioner (m) Run #1"
    np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt="%.6f")
    found = read_file(path)
    assert (found.index("Position", "here"), found.index("time", "here")) == (1, 0)
    with pytest.raises(InputError, match="here"):
        found.index("Posi", "here")


@pytest.mark.parametrize(("name", "unit"), [
    ("x_mm", "mm"), ("alpha1_rad_s2", "rad/s^2"), ("v_m_s", "m/s"), ("torque1_n_m", "N m"), ("t_ms", "ms"),
    ("x1_m", "m"), ("position", None), ("x_px", None), ("gram", None), ("_mm", None), ("Weg [mm]", "mm"),
    ("s1 / mm", "mm"), ("a / m/s²", "m/s^2"), ("a / (m/s^2)", "m/s^2"), ("Position, mm", "mm"), ("Zeit in ms", "ms"),
    ("Angle/rad", "rad"), ("v/m/s", "m/s"), ("s/m", "m"), ("AngVel/rad/s", "rad/s"), ("m/s", None),
    ("Speed m/s", None), ("left/right", None), ("/s", None), ("sensor in use", None), ("rev/s", None),
    ("in mm", None), ("left, right", None), ("Position (cm) Run #1", "cm"), ("Zeit [ms] Lauf 2", "ms"),
    ("Run (a) #1", None), ("Force (N) (left)", None),
])  # fmt: skip
def test_the_end_of_a_name_is_its_unit(name: str, unit: str | None) -> None:
    assert LoggerFile((name,), np.zeros((3, 1))).unit(0) == unit


def test_a_foot_of_as_many_words_as_the_rows_have_cells_hides_no_column_of_words(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    rows = "".join(f"{i / 100:.2f};{0.5 * i:.1f};OK\n".replace(".", ",") for i in range(40))
    path.write_text(f"t [s];x [mm];status\n{rows}Ende;der Messung;x\n", encoding="utf-8")
    found = read_file(path)
    assert found.table[-1, :2].tolist() == [0.39, 19.5]
    assert "column 3 (status) holds words" in " ".join(found.notes)
