"""Binary files of loggers, written by the packages themselves: names, units and clocks from the header, then faults."""

from __future__ import annotations

import gc
import importlib
import math
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from campaigns import decay
from scipy.io import wavfile

from bayes_damper.campaign import load_campaign
from bayes_damper.campaign.importing.importer import init_campaign
from bayes_damper.campaign.importing.logger_files import read_file
from bayes_damper.campaign.importing.options import ReaderOptions
from bayes_damper.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")  # pyuff writes so
RATE = 1000.0
TIMES = np.arange(1200) / RATE
FIRST = decay(TIMES - 0.2, math.radians(4.7), 10.2, 0.031) + np.random.default_rng(1).standard_normal(TIMES.size)
SECOND = 0.3 * FIRST + np.random.default_rng(2).standard_normal(TIMES.size)
OPTIONS = {"primary_inertia": 3.015e-3, "k1t": 10.2, "theta0": 4.7, "theta0_std": 0.1, "release": "find"}


def hdf5(path: Path) -> Path:
    with h5py.File(path, "w") as file:
        group = file.create_group("run 1")
        group.attrs["sample_rate"] = RATE
        for name, y in (("alpha1", FIRST), ("alpha2", SECOND)):
            group[name] = y
            group[name].attrs["unit"] = "rad/s²"
        group["temperature"] = np.full(3, 21.0)
    return path


def test_a_reading_that_is_no_number_in_an_odd_way_is_a_missing_one(tmp_path: Path) -> None:
    """Bytes that are damaged may be a signalling NaN, which warns wherever it is used."""
    odd = np.array([0x7FF0000000000001]).view(float)
    with h5py.File(tmp_path / "odd.h5", "w") as file:
        file["time"] = np.concatenate([TIMES, odd])
        file["a"] = np.concatenate([FIRST, odd])
        file["time"].attrs["unit"] = "ms"
    found = read_file(tmp_path / "odd.h5")
    assert np.isnan(found.table[-1]).all()
    assert not found.table[-1].tobytes().startswith(odd.tobytes())


def wav(path: Path) -> Path:
    wavfile.write(path, int(RATE), np.column_stack([FIRST, SECOND]).astype(np.float32))
    return path


def tdms(path: Path) -> Path:
    nptdms = pytest.importorskip("nptdms")
    own = {"wf_increment": 1.0 / RATE, "wf_start_offset": 0.0, "unit_string": "rad/s^2"}
    with nptdms.TdmsWriter(path) as writer:
        writer.write_segment(
            [nptdms.ChannelObject("rig", n, y, own) for n, y in (("alpha1", FIRST), ("alpha2", SECOND))]
        )
        writer.write_segment([nptdms.ChannelObject("rig", "slow", np.arange(5.0), {"wf_increment": 0.1})])
    return path


def mf4(path: Path) -> Path:
    asammdf = pytest.importorskip("asammdf")
    file = asammdf.MDF(version="4.10")
    file.append([asammdf.Signal(y, TIMES, "rad/s^2", n) for n, y in (("alpha1", FIRST), ("alpha2", SECOND))])
    file.append([asammdf.Signal(np.arange(5.0), np.arange(5.0), "degC", "slow")])
    file.save(path, overwrite=True)
    return path


def uff(path: Path, binary: int = 0) -> Path:
    pyuff = pytest.importorskip("pyuff")
    file = pyuff.UFF(str(path))
    for name, y in (("alpha1", FIRST), ("alpha2", SECOND)):
        data = pyuff.prepare_58(
            binary=binary, func_type=1, rsp_node=1, rsp_dir=1, ref_dir=1, ref_node=1, data=y, x=TIMES,
            **(dict.fromkeys(("id2", "id3", "id4", "id5", "ref_ent_name", "rsp_ent_name"), "NONE") | {"id1": name}),
            ver_num=1, abscissa_spacing=1, abscissa_min=0.0, abscissa_inc=1.0 / RATE, z_axis_value=0.0, load_case_id=0,
            ordinate_spec_data_type=12, ordinate_axis_units_lab="rad/s^2", abscissa_spec_data_type=17,
            abscissa_axis_units_lab="s", orddenom_spec_data_type=0, z_axis_spec_data_type=0,
        )  # fmt: skip
        file.write_sets(data, "add")
    return path


FILES = {
    "a.h5": hdf5, "a.wav": wav, "a.tdms": tdms, "a.mf4": mf4, "a.uff": uff, "b.uff": lambda path: uff(path, 1),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_a_record_comes_back_with_its_clock_names_and_units(tmp_path: Path, name: str) -> None:
    found = read_file(FILES[name](tmp_path / name))
    assert found.names[0] == "time"
    np.testing.assert_allclose(found.table[:, 0], TIMES, atol=1e-6)
    np.testing.assert_allclose(found.table[:, 1], FIRST, atol=1e-4)
    np.testing.assert_allclose(found.table[:, 2], SECOND, atol=1e-4)
    if name != "a.wav":
        assert [n.rpartition("/")[2].strip() for n in found.names[1:]] == ["alpha1", "alpha2"]
        assert [found.unit(k) for k in range(3)] == ["s", "rad/s^2", "rad/s^2"]
    if name in ("a.h5", "a.tdms", "a.mf4"):
        assert "left out, of another clock" in found.notes[0]


@pytest.mark.parametrize("name", FILES)
def test_one_command_makes_a_campaign(tmp_path: Path, name: str) -> None:
    source = FILES[name](tmp_path / name)
    extra = {"secondary_inertia": 2.474e-3}
    init_campaign(tmp_path / "out", [source], **OPTIONS, **extra)
    trial = load_campaign(tmp_path / "out").trials[0]
    assert trial.coupled
    assert abs(trial.times[np.argmax(np.abs(trial.channels[0]) > 0.5 * np.max(np.abs(FIRST)))]) < 2e-3
    np.testing.assert_allclose(np.max(np.abs(trial.channels[1])), np.max(np.abs(SECOND)), rtol=1e-4)


def fault_of(path: Path) -> str:
    """The sentence in which reading ends; nothing where what is left of a file is one."""
    try:
        assert read_file(path).table.ndim == 2
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("keep", [0.02, 0.4, 0.9])
def test_a_file_that_is_cut_short_ends_in_a_sentence(tmp_path: Path, name: str, keep: float) -> None:
    path = FILES[name](tmp_path / name)
    raw = path.read_bytes()
    path.write_bytes(raw[: int(keep * len(raw))])
    fault = fault_of(path)
    # What is left of a file that is written piece by piece may be whole.
    assert name in fault or (not fault and name in ("a.tdms", "a.uff", "b.uff"))


@pytest.mark.parametrize("name", FILES)
def test_damaged_bytes_end_in_a_sentence(tmp_path: Path, name: str) -> None:
    path = FILES[name](tmp_path / name)
    raw = path.read_bytes()
    rng = np.random.default_rng(3)
    faults = []
    for _ in range(12):
        damaged = bytearray(raw)
        for place in rng.integers(16, min(len(raw), 3000), 40):
            damaged[place] = rng.integers(256)
        path.write_bytes(bytes(damaged))
        faults.append(fault_of(path))
    assert all(name in fault for fault in faults if fault)


def test_what_is_there_before_a_file_is_read_is_not_gone_through(tmp_path: Path) -> None:
    """Beside compiled kernels, millions of objects, that took a second for each file."""
    path = FILES["a.h5"](tmp_path / "a.h5")
    seen: list[int] = []

    def look(phase: str, info: dict[str, int]) -> None:
        if phase == "start" and info["generation"] == 2:
            seen.append(len(gc.get_objects()))

    before = len(gc.get_objects())
    gc.callbacks.append(look)
    try:
        read_file(path)
    finally:
        gc.callbacks.remove(look)
    assert seen
    assert max(seen) < 0.5 * before
    assert gc.get_freeze_count() == 0


@pytest.mark.parametrize(("name", "module", "package"), [
    ("a.tdms", "nptdms", "npTDMS"), ("a.mf4", "asammdf", "asammdf"), ("a.uff", "pyuff", "pyuff"),
])  # fmt: skip
def test_a_package_that_is_not_there_is_named_with_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, module: str, package: str
) -> None:
    path = FILES[name](tmp_path / name)
    found = importlib.import_module

    def absent(wanted: str, *args: object) -> object:
        if wanted == module:
            raise ImportError(wanted)
        return found(wanted, *args)

    monkeypatch.setattr(importlib, "import_module", absent)
    with pytest.raises(InputError, match=rf"needs {package}: pip install 'bayes-damper\[readers\]'"):
        read_file(path)


def test_a_group_chooses_among_clocks(tmp_path: Path) -> None:
    assert read_file(tdms(tmp_path / "a.tdms"), ReaderOptions(group="slow")).table.shape == (5, 2)
    with pytest.raises(InputError, match="it holds alpha1, alpha2, slow"):
        read_file(tmp_path / "a.tdms", ReaderOptions(group="fast"))


def test_matlab_7_3_is_read_as_the_hdf5_that_it_is(tmp_path: Path) -> None:
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"], file["alpha1"] = TIMES[None], FIRST[None]
    raw = bytearray(path.read_bytes())
    raw[:19] = b"MATLAB 7.3 MAT-file"
    path.write_bytes(bytes(raw))
    found = read_file(path)
    np.testing.assert_array_equal(found.table[:, found.index("alpha1", "a.mat")], FIRST)
    np.testing.assert_array_equal(found.table[:, found.time_column()], TIMES)


def track(tmp_path: Path, form: Callable[[np.ndarray], np.ndarray]) -> tuple[Path, np.ndarray, dict[str, object]]:
    """A logger's file of a decaying swing in raw numbers, the angle in rad, and the options of its import."""
    times = np.arange(0.0, 2.0, 2e-3)
    omega = math.sqrt(10.2 / 3.015e-3)
    angle = math.radians(20.0) * np.exp(-0.5 * times) * np.cos(omega * times)
    path = tmp_path / "track.csv"
    path.write_text("t,raw\n" + "\n".join(f"{t:.4f},{x:.10g}" for t, x in zip(times, form(angle), strict=True)))
    given = {"primary_inertia": 3.015e-3, "k1t": 10.2, "time": "t", "columns": ["raw"], "quantity": "displacement"}
    return path, angle, given


@pytest.mark.parametrize(
    ("form", "options"),
    [
        # an encoder of 4096 counts to a turn behind a 16-bit counter that overflows
        (lambda angle: np.mod(np.round(angle / (2 * np.pi) * 4096) + 65500, 65536),
         {"wrap": [65536], "scale": [360.0 / 4096], "units": ["deg"], "offset": [-36 * 360.0 / 4096]}),
        (lambda angle: np.mod(np.degrees(angle) + 358.0, 360.0), {"wrap": [360], "units": ["deg"], "offset": [-2.0]}),
        # a video track, half a degree to the pixel
        (lambda angle: np.round(np.degrees(angle) / 0.05, 1) + 640.0,
         {"scale": [0.05], "units": ["deg"], "offset": [32.0]}),
    ],
)  # fmt: skip
def test_counts_pixels_and_angles_that_begin_again(tmp_path: Path, form: object, options: dict) -> None:
    path, angle, given = track(tmp_path, form)
    init_campaign(tmp_path / "out", [path], free_start=True, **given, **options)
    y = load_campaign(tmp_path / "out").trials[0].channels[0]
    np.testing.assert_allclose(y, angle, atol=2.0 * math.pi / 4096)


def test_measured_inputs_are_imported(tmp_path: Path) -> None:
    path = tmp_path / "shaken.csv"
    rows = np.column_stack([TIMES, FIRST, SECOND, np.sin(40 * TIMES), np.cos(40 * TIMES), 0.1 * np.sin(3 * TIMES)])
    np.savetxt(path, rows, delimiter=",", header="t,a,b,t1 [N mm],t2 [N mm],ground [g]", comments="")
    given = {"time": "t", "columns": ["a", "b"], "torque": 4, "torque2": 5, "ground": 6, "torque_unit": "N mm"}
    rig = {"kind": "translational", "primary_inertia": 1.0, "secondary_inertia": 0.5, "k1t": 100.0}
    with pytest.raises(InputError, match="torque_unit 'N mm' is none of N, kN, mN"):
        init_campaign(tmp_path / "bad", [path], free_start=True, **given, **rig)
    init_campaign(tmp_path / "out", [path], free_start=True, **(given | {"torque_unit": "mN"}), **rig, frame="ground")
    campaign = load_campaign(tmp_path / "out")
    trial = campaign.trials[0]
    np.testing.assert_allclose(trial.torque, 1e-3 * np.sin(40 * TIMES), atol=1e-12)
    np.testing.assert_allclose(trial.torque2, 1e-3 * np.cos(40 * TIMES), atol=1e-12)
    np.testing.assert_allclose(trial.ground_acceleration, 0.980665 * np.sin(3 * TIMES), atol=1e-9)
    assert campaign.measurement.frame == "ground"
    with pytest.raises(InputError, match="thins the readings alone"):
        init_campaign(tmp_path / "bad", [path], free_start=True, every=2, **(given | {"torque_unit": "mN"}), **rig)


@pytest.mark.parametrize(
    ("form", "options", "named"),
    [
        (lambda angle: np.mod(np.round(angle / (2 * np.pi) * 4096) + 65500, 65536),
         {"scale": [360.0 / 4096], "units": ["deg"]}, "--wrap 65536"),
        (lambda angle: np.mod(np.degrees(angle) + 358.0, 360.0), {"units": ["deg"]}, "--wrap 360"),
        (lambda angle: np.mod(angle / (2 * np.pi) * 4000 + 1995, 2000), {"scale": [0.09], "units": ["deg"]},
         "--wrap 2000"),
        (np.degrees, {"units": ["deg"]}, ""),
        # spikes, and a track that is lost and found elsewhere
        (lambda angle: np.degrees(angle) + 300.0 * (np.arange(1000) % 90 == 20), {"units": ["deg"]}, ""),
        (lambda angle: np.degrees(angle) + 300.0 * (np.arange(1000) > 500), {"units": ["deg"]}, ""),
    ],
)  # fmt: skip
def test_readings_that_begin_again_are_noticed_with_the_option_that_joins_them(
    tmp_path: Path, form: object, options: dict, named: str
) -> None:
    path, _, given = track(tmp_path, form)
    if not named:
        init_campaign(tmp_path / "out", [path], free_start=True, **given, **options)
        return
    with pytest.raises(InputError, match=f"begins again do: give {named} "):
        init_campaign(tmp_path / "out", [path], free_start=True, **given, **options)
    init_campaign(tmp_path / "out", [path], free_start=True, **given, **options, wrap=[float(named.split()[1])])
    assert np.ptp(load_campaign(tmp_path / "out").trials[0].channels[0]) < 0.7
