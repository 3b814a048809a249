"""Binary files of loggers as columns of numbers: HDF5, WAV, TDMS, MDF4, UFF-58, each by the package kept for it.

Names, units and the clock come from the file's own header. TDMS, MDF4 and UFF-58 need the extra `readers`. A file may
hold channels of several clocks: those of the longest common one are taken, or those whose name begins with the option
`group`; the notes say what was left out.
"""

from __future__ import annotations

import gc
import importlib
import io
import logging
import math
import struct
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayes_damper.errors import InputError
from bayes_damper.inputs import check_hdf5

Array = NDArray[np.float64]
_SAME_CLOCK = 1e-9
"""Share of its length by which the times of two channels may differ and still be one clock."""
_RATES = ("sample_rate", "sampling_rate", "samplerate", "rate", "fs", "frequency")
_STEPS = ("dt", "wf_increment", "sample_time", "time_step")
_UNITS = ("unit", "units", "unit_string")
_MATLAB_73 = b"MATLAB 7.3 MAT-file"


@dataclass(frozen=True, eq=False)
class Channel:
    """One channel: its name and unit, readings (n,), and times (n,) s on the file's clock, None where it has none."""

    name: str
    unit: str
    readings: Array
    times: Array | None


def form_of(raw: bytes) -> str | None:
    """Which binary form a file has by its first bytes: a key of `FORMS`; None for any other."""
    if raw[:4] in (b"RIFF", b"RIFX") and raw[8:12] == b"WAVE":
        return "WAV"
    if raw.startswith(b"TDSm"):
        return "TDMS"
    if raw.startswith((b"MDF ", b"UnFinMF")):
        return "MDF4"
    if raw.startswith((b"\x89HDF\r\n\x1a\n", _MATLAB_73)):
        return "HDF5"
    if raw.lstrip(b"\r\n")[:80].split(b"\n")[0].strip() == b"-1":
        return "UFF-58"
    return None


def channels_of(raw: bytes, name: str, form: str, group: str = "") -> tuple[list[Channel], list[str]]:
    """The channels of one clock that a file holds, and sentences about those that were left out.

    Raises
    ------
    InputError
        if the file is damaged, holds no series of numbers, or needs a package that is not installed.
    """
    why = ""
    with _quiet():
        try:
            found = [c for c in FORMS[form](raw, name) if c.readings.size > 1]
        except InputError:
            raise
        except Exception as error:  # noqa: BLE001 (whatever the package raises, the file cannot be used)
            why = " ".join(str(error).split())[:120] or type(error).__name__
            traceback.clear_frames(error.__traceback__)
    if why:
        raise InputError(f"{name}: a {form} file that is damaged or of an unknown kind ({why}); export it again")
    wanted = [c for c in found if c.name.startswith(group)]
    if group and not wanted:
        raise InputError(
            f"{name}: no channel begins with group = '{group}'; it holds {', '.join(c.name for c in found)}"
        )
    if not wanted:
        raise InputError(f"{name}: holds no series of numbers; export the channels again")
    sets: list[list[Channel]] = []
    for channel in wanted:
        for members in sets:
            if _one_clock(members[0], channel):
                members.append(channel)
                break
        else:
            sets.append([channel])
    taken = max(sets, key=lambda members: (len(members), members[0].readings.size))
    left = [c.name for c in wanted if all(c is not other for other in taken)]
    notes = [f"{name}: left out, of another clock: {', '.join(left)}; --group takes those whose names begin so."]
    return taken, notes if left else []


@contextmanager
def _quiet() -> Iterator[None]:
    """Without what packages say on the terminal of a damaged file, while they read it and when they let go of it."""
    before, level = sys.unraisablehook, logging.root.manager.disable
    sys.unraisablehook = lambda _: None
    logging.disable(logging.CRITICAL)
    gc.freeze()  # what is there already need not be gone through: a second beside compiled kernels
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
            gc.collect()
    finally:
        gc.unfreeze()
        sys.unraisablehook = before
        logging.disable(level)


def _one_clock(a: Channel, b: Channel) -> bool:
    if a.readings.size != b.readings.size:
        return False
    if a.times is None or b.times is None:
        return a.times is b.times
    return bool(np.max(np.abs(a.times - b.times)) <= _SAME_CLOCK * max(float(np.ptp(a.times)), 1e-300))


def _package(module: str, package: str, form: str, name: str) -> ModuleType:
    """A reader's package; a sentence where it is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(
            f"{name}: a {form} file; reading it needs {package}: pip install 'bayes-damper[readers]'"
        ) from None


def _steady(n: int, step: float, start: float = 0.0) -> Array | None:
    return start + step * np.arange(n, dtype=np.float64) if step > 0.0 and math.isfinite(step) else None


def _attribute(attributes: Mapping[str, Any], names: Sequence[str]) -> Any:
    """The attribute of one of these names, in any case of letters; None if there is none."""
    plain = {str(key).lower(): value for key, value in attributes.items()}
    value = next((plain[name] for name in names if name in plain), None)
    if isinstance(value, np.ndarray) and value.size == 1:
        value = value.ravel()[0]
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value


def _step_in(attributes: Mapping[str, Any]) -> float:
    """Sampling step (s) that attributes give, 0 for none."""
    rate, step = _attribute(attributes, _RATES), _attribute(attributes, _STEPS)
    try:
        return 1.0 / float(rate) if rate is not None else float(step) if step is not None else 0.0
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0


def _hdf5(raw: bytes, _: str) -> Iterator[Channel]:
    """Every dataset of numbers, of one column or several (along the shorter side); attributes hold unit and clock."""
    import h5py

    with h5py.File(io.BytesIO(raw), "r") as file:
        check_hdf5(file, len(raw))
        datasets: list[Any] = []
        file.visititems(lambda _, item: datasets.append(item) if isinstance(item, h5py.Dataset) else None)
        for item in datasets:
            if item.dtype.kind not in "iuf" or item.ndim not in (1, 2) or item.name.startswith("/#refs#"):
                continue
            values = np.asarray(item, float)
            values = (
                values.reshape(-1, 1) if values.ndim == 1 else values if len(values) >= values.shape[1] else values.T
            )
            above = [item, item.parent, file]
            step = next((s for place in above if (s := _step_in(place.attrs)) > 0.0), 0.0)
            unit = _attribute(item.attrs, _UNITS)
            for k, column in enumerate(values.T):
                own = item.name.strip("/") + (f" {k + 1}" if values.shape[1] > 1 else "")
                yield Channel(own, "" if unit is None else str(unit), np.array(column), _steady(column.size, step))


def _wav(raw: bytes, name: str) -> Iterator[Channel]:
    """Every channel, of whole numbers as a share of full scale."""
    from scipy.io import wavfile

    if struct.unpack("<I" if raw.startswith(b"RIFF") else ">I", raw[4:8])[0] > len(raw):
        raise InputError(f"{name}: a WAV file that is cut short; copy it again")
    rate, data = wavfile.read(io.BytesIO(raw))
    table = np.asarray(data).reshape(len(data), -1)
    values = table.astype(float)
    if table.dtype.kind == "u":
        values = values / 128.0 - 1.0
    elif table.dtype.kind == "i":
        values = values / 2.0 ** (8 * table.dtype.itemsize - 1)
    for k, column in enumerate(values.T):
        yield Channel(f"channel {k + 1}", "", np.ascontiguousarray(column), _steady(column.size, 1.0 / rate))


def _tdms(raw: bytes, name: str) -> Iterator[Channel]:
    """Every channel of numbers, named GROUP/CHANNEL where there are several groups."""
    nptdms = _package("nptdms", "npTDMS", "TDMS", name)
    file = nptdms.TdmsFile.read(io.BytesIO(raw))
    several = len(file.groups()) > 1
    for group in file.groups():
        for channel in group.channels():
            values = np.asarray(channel[:])
            if values.dtype.kind not in "iuf":
                continue
            step = _step_in(channel.properties)
            start = float(channel.properties.get("wf_start_offset", 0.0) or 0.0)
            own = f"{group.name}/{channel.name}" if several else str(channel.name)
            unit = _attribute(channel.properties, _UNITS)
            times = _steady(values.size, step, start)
            yield Channel(own, "" if unit is None else str(unit), values.astype(float), times)


def _mdf(raw: bytes, name: str) -> Iterator[Channel]:
    """Every channel of numbers with the times of its group."""
    asammdf = _package("asammdf", "asammdf", "MDF4", name)
    with asammdf.MDF(io.BytesIO(raw)) as file:
        for number, group in enumerate(file.groups):
            master = file.masters_db.get(number)
            for index in range(len(group.channels)):
                if index == master:
                    continue
                signal = file.get(group=number, index=index)
                values = np.asarray(signal.samples)
                if values.ndim == 1 and values.dtype.kind in "iuf":
                    times = np.asarray(signal.timestamps, float)
                    yield Channel(str(signal.name), str(signal.unit or ""), values.astype(float), times)


def _uff(raw: bytes, name: str) -> Iterator[Channel]:
    """Every time series of data sets 58 and 58b."""
    pyuff = _package("pyuff", "pyuff", "UFF-58", name)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "file.uff"
        path.write_bytes(raw)
        file = pyuff.UFF(str(path))
        kinds = np.atleast_1d(file.get_set_types())
        numbers = [int(i) for i in np.flatnonzero(kinds == 58)]
        sets = [file.read_sets(i) for i in numbers]
    if not sets:
        found = ", ".join(str(int(k)) for k in kinds) or "none"
        raise InputError(f"{name}: a universal file without data set 58 (it holds {found}); export time series as 58")
    for data in sets:
        values = np.asarray(data["data"])
        if np.iscomplexobj(values) or int(data.get("func_type", 1)) not in (0, 1):
            continue  # spectra and transfer functions
        label = str(data.get("id1", "")).strip()
        place = f"{data.get('rsp_node', '')} {data.get('rsp_dir', '')}".strip()
        unit = str(data.get("ordinate_axis_units_lab", "")).strip()
        yield Channel(
            label if label and label.upper() != "NONE" else f"node {place}",
            "" if unit.upper() == "NONE" else unit,
            values.astype(float),
            np.asarray(data["x"], float),
        )


FORMS: dict[str, Callable[[bytes, str], Iterator[Channel]]] = {
    "HDF5": _hdf5, "WAV": _wav, "TDMS": _tdms, "MDF4": _mdf, "UFF-58": _uff,
}  # fmt: skip
