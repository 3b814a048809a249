"""Good folders for tests/damage.py to damage, and the calls that read them."""

from __future__ import annotations

import contextlib
import functools
import io
import itertools
import json
import os
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest import mock

import damage
import h5py
import numpy as np
from campaigns import decay, write_synthetic, write_table
from scipy.io import savemat

from bayes_damper.campaign.importing.importer import import_records, init_campaign
from bayes_damper.cli import _parser, main
from bayes_damper.commands import resume
from bayes_damper.commands.check import check
from bayes_damper.commands.compare import compare
from bayes_damper.errors import InputError
from bayes_damper.fit.plan import kept, plan_fit, start_run
from bayes_damper.report import report
from bayes_damper.runs.json_files import write_json
from bayes_damper.sampling import arviz_adapter
from bayes_damper.sampling.prior_sensitivity import WIDTHS
from bayes_damper.tuning import chosen_case, origin_of, posterior_draws

PRIORS = """\
name = "for damage"
description = "one entry of each kind"
mu = {unit = "1", dist = "lognormal", median = 0.01, factor = 3.0}
k2t = {unit = "N m/rad", dist = "uniform", lower = 0.1, upper = 5.0}
c2t = {unit = "N m s/rad", dist = "halfnormal", sd = 0.1}
drag = {unit = "N m", dist = "loguniform", lower = 1e-4, upper = 0.1}
nu = 60.0
c1t = {unit = "N m s/rad", dist = "normal", mean = 0.01, sd = 0.005, lower = 0.0}
c3t = "c1t"
theta0 = {level = "trial"}
"""
# Each number of these entries on a line of its own, so that each is damaged.
LONG_PRIORS = """\
[mu]
unit = "1"
dist = "lognormal"
median = 0.01
factor = 3.0
level = "campaign"
[k2t]
unit = "N m/rad"
dist = "uniform"
lower = 0.1
upper = 5.0
[c1t]
unit = "N m s/rad"
dist = "normal"
mean = 0.01
sd = 0.005
cases = { IV = { mean = 0.02, sd = 0.001 } }
[c3t]
dist = "tied"
to = "c1t"
"""
EXTRAS = """
[rig]
primary_inertia = { value = 3.015e-3, std = 3e-5 }
secondary_inertia = 2.474e-3
bar_radius = 0.10
magnet_radius = 0.0127
magnet_pull = 100.0
ground2_stiffness = 0.0
inertial_coupling = 0.0
normal_force = "linear"
restoring = "linear"

[measurement]
quantity = "acceleration"
start = "rest"
sample_rate = 250.0
noise_std = [2.0, 2.0]
sensor_range = 1000.0
sensor_bandwidth = 100.0
offset_std = 0.1
scale_std = [0.01, 0.01]
lag_std = 1e-4
every = 1
"""
IMPORT = """\
name = "imported"
description = "two logger files"
source = "made by the tests"
caveats = ["None."]

[rig]
primary_inertia = 3.015e-3
secondary_inertia = 2.474e-3

[measurement]
start = "rest"

[reader]
delimiter = ";"
decimal = ","
time = "Zeit [ms]"
time_unit = "ms"
columns = ["a1", "a2"]
units = ["m/s^2", "m/s^2"]
mounting_radius = [0.1, 0.1]
sign = [1, 1]
offset = ["none", 0.0]
every = 1
before = 0.02
release = 0.0
start = -1.0
end = 2.0
header = true

[[trials]]
source = "one.txt"
case = "IV"
configuration = "coupled"
trial = 1
k1t = 10.2
k1t_std = 0.1
theta0 = 4.7
theta0_std = 0.1
holdout = false
file = "trials/one.csv"

[[trials]]
source = "two.txt"
case = "IV"
configuration = "uncoupled"
k1t = 10.2
theta0 = 4.7
"""
OPTIONS: dict[str, Any] = {
    "delimiter": ";",
    "decimal": ",",
    "skip_lines": 2,
    "header": True,
    "time": 1,
    "time_unit": "ms",
    "sample_rate": 250.0,
    "columns": [2, 3],
    "units": ["m/s^2", "m/s^2"],
    "sensitivity": ["100 mV/g", "100 mV/g"],
    "mounting_radius": 0.1,
    "sign": [1, 1],
    "offset": "none",
    "start": -1.0,
    "end": 2.0,
    "release": 0.0,
    "before": 0.02,
    "every": 1,
    "case": "IV",
    "configuration": "coupled",
    "k1t": 10.2,
    "k1t_std": 0.1,
    "theta0": 4.7,
    "theta0_std": 0.1,
    "pattern": "{case}",
    "words": ["a=coupled"],
    "sheet": "sheet.csv",
    "files_per_trial": 1,
    "primary_inertia": 3.015e-3,
    "secondary_inertia": 2.474e-3,
    "quantity": "acceleration",
    "noise_std": 2.0,
    "kind": "torsional",
    "magnet_pull": 10.0,
    "torque": 2,
    "torque_unit": "N m",
    "holdout": False,
    "trial": 1,
    "name": "a name",
    "source_text": "x",
    "free_start": True,
}
OPTION_VALUES: tuple[Any, ...] = (
    10**400,
    -(10**400),
    10**5000,
    1e308,
    -1e308,
    1e-308,
    -1,
    0,
    1,
    2.5,
    float("nan"),
    float("inf"),
    True,
    "",
    "x",
    "1_0",
    "\u0661",
    "\x1b[31m",
    "\0",
    "x" * 5000,
    "{case}{case}",
    "{",
    "(",
    "\\",
    [],
    [""],
    ["x", "y", "z"],
    [1, 1, 1],
    [10**400],
    [1e308, 1e308],
    [float("nan")],
    [[1]],
    [None],
    ["1", 2],
    {},
    {"a": 1},
    (),
    b"x",
)

WORDS = r"name|description|source|caveats"
SILENT = [
    (rf"(toml: ({WORDS}|case|file|reason|level) = )|(without line \d+, ({WORDS}))", "words are the user's own"),
    (r"without (line|column)", "a key or a column that may be left out"),
    (r"lines of (an old Mac|Windows)|a lone return|line separators|form feeds", "lines may end in any way"),
    (
        r"UTF-16|two marks of byte order|a byte of 0 at its end",
        "a logger's file may be so; what is left out is a caveat",
    ),
    (r"one.txt: (cut at|a line of 300 000|semicolons|bytes changed)", "a shorter recording, or a foot below it"),
    (r"trials/.*: (cut at|one row|the head|bytes changed)|priors.toml: cut at", "what is left is whole"),
    (r"trials.csv: one row", "one trial is a campaign"),
    (r"= '(1_0|true|rest)'", "TOML writes 10 so, and these words are valid"),
    (r"= '(-1|-1e-9|0|0.0|\{ value = 1.0 \})'", "within what the key may be"),
    (r"= '\[(1, 2, 3|1.0, -1.0|\"a\"|)\]'", "within what the key may be"),
    (r"row \d+, (case|trial|holdout|file) = ", "a label of the user's own"),
    (r"row \d+, \w+ = '(0|1|-1|1\.5|0x10|true|\\?\"1\\?\"|nan| )?'", "within what the column may be"),
    (r"row \d+, \w+ = '(1e-308|\"1\"|-1|0|1\.5)'", "a reading may be so"),
    (r"priors.toml: (missing|empty|blank|a link to nothing)", "a campaign needs no priors of its own"),
    (r"rows reversed|twice|renamed|no line ends|commas|column \w+ (twice|renamed)", "still says what is needed"),
    (r"bytes changed", "nobody can see which digit or letter was meant"),
    (r"priors.toml: ", "a prior is what its author holds likely"),
    (r"trials.csv: row \d+, \w+ = ", "a value of its own that the records do not contradict"),
    (r"one.h5: (a link to another file|a soft link|a group within itself|words|complex)", "left out beside readings"),
    (r"one.h5: a line of 300 000", "HDF5 knows where it ends"),
    (r"one.json: log\.\d(\.\w)? = (absent|null|NaN|\{)", "a reading may be missing"),
    (r"one.json: log\.\d\.\w = (-1|0|true)", "a reading may be so; true is 1"),
    (r"option ", "the option says what it says"),
]
"""Pattern of damages that may pass in silence, and why that is right."""


@dataclass(frozen=True)
class Target:
    """A command, a folder, the call that reads it, and all damages of its files."""

    name: str
    folder: Path
    call: Callable[[], Any]
    damages: list[damage.Damage]


def small_campaign(folder: Path) -> Path:
    """Two trials of 150 readings, with every key that campaign.toml may have."""
    write_synthetic(folder, repeats=1, rate=250.0, duration=0.6)
    path = folder / "campaign.toml"
    path.write_text(path.read_text().partition("[rig]")[0] + EXTRAS, encoding="utf-8")
    rows = (folder / "trials.csv").read_text().splitlines()
    more = ["k1t_std_n_m_per_rad,theta0_std_deg,holdout", *["0.1,0.1,false"] * (len(rows) - 1)]
    (folder / "trials.csv").write_text("".join(f"{a},{b}\n" for a, b in zip(rows, more, strict=True)))
    (folder / "priors.toml").write_text(PRIORS, encoding="utf-8")
    return folder


def campaign_targets(home: Path) -> Iterator[Target]:
    """Files of a campaign, read by `check`."""
    folder = small_campaign(home / "campaign")
    record = "trials/IV_coupled_1.csv"
    text = {name: (folder / name).read_text() for name in ("campaign.toml", "trials.csv", "priors.toml", record)}
    found = [d for name, content in text.items() for d in damage.of_any_file(name, content.encode())]
    found += damage.of_toml("campaign.toml", text["campaign.toml"])
    found += damage.of_toml("priors.toml", PRIORS)
    found += damage.of_toml("priors.toml", LONG_PRIORS)
    found += damage.of_csv("trials.csv", text["trials.csv"])
    found += damage.of_csv(record, text[record], rows=(3, 70))
    yield Target("check", folder, lambda: check(folder), found)


def logger_file(path: Path, channels: int) -> None:
    """A file as German loggers write them."""
    times = np.arange(-20, 200) / 250.0
    columns = [times * 1e3, *(0.1 * decay(times, 0.082, 10.2, 0.05) for _ in range(channels))]
    write_table(path, ["Zeit [ms]", *(f"a{k + 1} [m/s^2]" for k in range(channels))], columns)
    text = path.read_text().replace(",", ";").replace(".", ",")
    path.write_text(f"Logger 7\nBeginn 12:00\n{text}", encoding="utf-8")


def import_targets(home: Path) -> Iterator[Target]:
    """An import table and its logger files, read by `init --table`."""
    home.mkdir()
    logger_file(home / "one.txt", 2)
    logger_file(home / "two.txt", 2)
    (home / "import.toml").write_text(IMPORT, encoding="utf-8")
    (home / "priors.toml").write_text("mu = 0.0\n", encoding="utf-8")
    found = [d for name in ("import.toml", "one.txt") for d in damage.of_any_file(name, (home / name).read_bytes())]
    found += damage.of_toml("import.toml", IMPORT)
    found += damage.of_csv(
        "one.txt", (home / "one.txt").read_text().partition("12:00\n")[2].replace(",", ".").replace(";", ",")
    )
    yield Target(
        "init --table", home, lambda: import_records(home / "import.toml", home / "out", overwrite=True), found
    )


def logger_targets(home: Path) -> Iterator[Target]:
    """Logger files in HDF5, MATLAB and JSON, each read by `init`."""
    home.mkdir()
    times = np.arange(-20, 200) / 250.0
    y = decay(times, 0.082, 10.2, 0.05)
    with h5py.File(home / "one.h5", "w") as file:
        file["time"], file["a"] = times, y
    savemat(home / "one.mat", {"t": times, "log": {"a": y}}, do_compression=True)
    (home / "one.json").write_text(
        json.dumps({"log": [{"t": a, "a": b} for a, b in zip(times.tolist(), y.tolist(), strict=True)]})
    )
    read = {
        "one.h5": {"time": "time", "columns": ["a"]},
        "one.mat": {"matlab_time": ["t"], "matlab_data": ["log.a"], "time": 1, "columns": [2]},
        "one.json": {"time": "t", "columns": ["a"]},
    }
    own = {
        "one.h5": of_hdf5("one.h5", home),
        "one.mat": of_matlab("one.mat"),
        "one.json": damage.of_json("one.json", (home / "one.json").read_text()),
    }
    good = {key: OPTIONS[key] for key in ("k1t", "theta0", "case", "primary_inertia")} | {"units": ["rad/s^2"]}
    good |= {"configuration": "uncoupled", "release": 0.0}
    for name, options in read.items():

        def call(name: str = name, options: Mapping[str, Any] = good | options) -> object:
            return init_campaign(home / "out", [home / name], overwrite=True, **options)

        yield Target(f"init {name}", home, call, [*damage.of_any_file(name, (home / name).read_bytes()), *own[name]])


def of_hdf5(file: str, home: Path) -> Iterator[damage.Damage]:
    """What an HDF5 file of a logger can hold that leads elsewhere or fills the memory."""
    if hasattr(os, "mkfifo"):
        os.mkfifo(home / "pipe")

    def elsewhere(f: h5py.File) -> object:
        layout = h5py.VirtualLayout((10,), "f8")
        layout[:] = h5py.VirtualSource(str(home / "one.h5"), "a", (10,))
        return f.create_virtual_dataset("b", layout)

    changes: dict[str, Callable[[h5py.File], Any]] = {
        "readings in a pipe": lambda f: f.create_dataset("b", (10,), "f8", external=[(str(home / "pipe"), 0, 80)]),
        "readings in a device": lambda f: f.create_dataset("b", (10,), "f8", external=[("/dev/zero", 0, 80)]),
        "readings of another file": elsewhere,
        "a link to another file": lambda f: f.__setitem__("b", h5py.ExternalLink("/dev/zero", "/")),
        "a soft link": lambda f: f.__setitem__("b", h5py.SoftLink("/nowhere")),
        "a group within itself": lambda f: f.__setitem__("again", f["/"]),
        "a petabyte of nothing": lambda f: f.create_dataset("b", (10**7, 10**7), "f8", chunks=(1000, 1000)),
        "a gigabyte of nothing": lambda f: f.create_dataset("b", (2, 10**8), "f8", chunks=(2, 10**6), compression=9),
        "words": lambda f: f.__setitem__("b", ["x"] * 220),
        "complex": lambda f: f.__setitem__("b", np.zeros(220, complex)),
        "no readings": lambda f: f.__delitem__("a"),
        "readings nan": lambda f: f["a"].__setitem__(..., np.nan),
        "readings 1e308": lambda f: f["a"].__setitem__(..., 1e308),
    }
    for name, change in changes.items():
        yield damage.Damage(file, name, edited(change))


def of_matlab(file: str) -> Iterator[damage.Damage]:
    """What a MATLAB file can hold that none of a logger does."""

    def bomb(path: Path) -> None:
        n = 10**8
        head = struct.pack("<6I2i", 6, 8, 6, 0, 5, 8, n, 1) + struct.pack("<2I8s", 1, 1, b"a")
        zeros, pack = bytes(8 * 10**6), zlib.compressobj()
        packed = pack.compress(struct.pack("<2I", 14, len(head) + 8 + 8 * n) + head + struct.pack("<2I", 9, 8 * n))
        packed += b"".join(pack.compress(zeros) for _ in range(100)) + pack.flush()
        start = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H2s", 0x0100, b"IM")
        path.write_bytes(start + struct.pack("<2I", 15, len(packed)) + packed)

    yield damage.Damage(file, "a gigabyte of nothing", bomb)
    odd: dict[str, Any] = {
        "words": {"t": "x", "log": {"a": "y"}},
        "a number": {"t": 1.0, "log": {"a": 2.0}},
        "no structure": {"t": np.arange(9.0), "log": np.arange(9.0)},
        "cells": {"t": np.array([np.arange(9.0), "x"], object), "log": {"a": np.array([{}, []], object)}},
        "complex": {"t": np.arange(9) * 1j, "log": {"a": np.arange(9.0)}},
        "three dimensions": {"t": np.zeros((9, 1)), "log": {"a": np.zeros((3, 3, 3))}},
        "other lengths": {"t": np.arange(9.0), "log": {"a": np.arange(8.0)}},
        "1e308": {"t": np.arange(9.0), "log": {"a": np.full(9, 1e308)}},
        "nan": {"t": np.full(9, np.nan), "log": {"a": np.arange(9.0)}},
    }
    for name, content in odd.items():
        yield damage.Damage(file, name, lambda path, content=content: savemat(path, content))


COMMAND_LINE = (
    "1.5", "-1", "0", "1e308", "1e400", "1e-308", "nan", "1_0", "\u0661\u0660", "\u00b2", "9" * 5000, "", "x", "{", "=",
    "\udcff", "\x1b[31m", "/dev/zero", "..", "module:function",
)  # fmt: skip


def command_line(home: Path) -> list[str]:
    """Words of a good `init` of one logger file, which is made."""
    home.mkdir()
    logger_file(home / "one.txt", 2)
    good = ["init", str(home / "out"), str(home / "one.txt"), "--case", "A", "--k1t", "10.2"]
    good += ["--theta0", "4.7", "--configuration", "coupled", "--mounting-radius", "0.1", "--overwrite"]
    return [*good, "--primary-inertia", "3.015e-3", "--secondary-inertia", "2.474e-3"]


def valued_options() -> list[str]:
    """Options of `init` that take words."""
    options = next(a.choices for a in _parser()._actions if a.dest == "command")["init"]._actions
    return [option.option_strings[-1] for option in options if option.option_strings and option.nargs != 0]


def spoken(words: Sequence[str]) -> None:
    """A command line; raises the sentence that is printed, as the public function does."""
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
            code = main(words)
    except SystemExit as ended:
        code = ended.code
    if code:
        raise InputError(said.getvalue() if code == 2 else "")


def command_line_calls(home: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """Every option of `init` at each of many words, columns named or not: name of the case, call."""
    good = command_line(home)
    for option, word in itertools.product(valued_options(), COMMAND_LINE):
        for more in [], ["--time", "1", "--columns", "2", "3"]:
            name = f"option {option[2:]} = {damage_name(word)}{', with columns' if more else ''}"
            yield name, functools.partial(spoken, [*good, *more, option, word])


def option_calls(home: Path) -> Iterator[tuple[str, Callable[[], Any]]]:
    """`init` with each option at each of many values: name of the case, call."""
    home.mkdir()
    logger_file(home / "one.txt", 2)
    (home / "sheet.csv").write_text("file,case,theta0\none.txt,IV,4.7\n")
    good = {
        key: OPTIONS[key]
        for key in ("columns", "time", "time_unit", "units", "mounting_radius", "k1t", "theta0", "configuration")
    } | {"release": 0.0}
    for key in OPTIONS:
        for value in OPTION_VALUES:
            options = good | {key: value}
            shown = damage_name(value)

            def call(options: Mapping[str, Any] = options) -> object:
                return init_campaign(home / "out", [home / "one.txt"], overwrite=True, **options)

            yield f"option {key} = {shown}", call


def damage_name(value: object) -> str:
    """A value as the name of a case."""
    if isinstance(value, list):
        return f"[{', '.join(map(damage_name, value))}]"
    if isinstance(value, int) and abs(value) > 10**20:
        return f"{'-' if value < 0 else ''}an integer of {value.bit_length()} bits"
    return ascii(value)[:30]


def results_folder(folder: Path, campaign: Path, rng: np.random.Generator) -> Path:
    """What a fit and a diagnosis of a campaign leave, with draws of a Gaussian in place of a posterior."""
    plan = plan_fit(
        str(campaign), cases=None, priors=None, normal_force=None, seed=1, thorough=False, most_steps=None, joint=False
    )
    start_run(folder, {"command": "fit", "plan": kept(plan), "workers": 1})
    middle = {
        "mu": 0.006,
        "k2t": 1.2,
        "c2t": 0.06,
        "drag": 0.005,
        "nu": 60.0,
        "c1t": 0.011,
        "c3t": 0.009,
        "J1": 3.015e-3,
    }
    draws = {name: value * np.exp(0.05 * rng.standard_normal((2, 8, 16))) for name, value in middle.items()}
    entry = {
        "converged": True,
        "sentences": ["Sound."],
        "log_evidence": {"value": -1.0, "error": 0.1, "health": 0.9},
        "parameters": {
            name: {
                "unit": "1",
                "mean": float(x.mean()),
                "sd": float(x.std()),
                "median": float(np.median(x)),
                "hdi90": [float(x.min()), float(x.max())],
                "r_hat": 1.0,
                "ess_bulk": 900.0,
                "ess_tail": 800.0,
                "prior_share": 0.1,
            }
            for name, x in draws.items()
        },
        "prior_sensitivity": {
            "mu": {
                width: {"shift": 0.1, "shift_of_that": 0.1, "moves_most": "mu", "reliable": True} for width in WIDTHS
            }
        },
    }
    summary = {
        "schema": "bayes-damper/fit/1",
        "campaign": plan["name"],
        "campaign_sha256": plan["campaign_sha256"],
        "seed": 1,
        "converged": True,
        "warnings": ["A remark."],
        "cases": {"IV": entry},
        "provenance": {"bayes_damper": "0"},
    }
    write_json(folder / "summary.json", summary)
    content = arviz_adapter.results(
        draws,
        log_prob=rng.standard_normal((2, 8, 16)),
        groups={"log_likelihood": {"trials": rng.standard_normal((2, 128, 2))}},
    )
    (folder / "IV").mkdir()
    arviz_adapter.write(content, folder / "IV" / "posterior.nc")
    return folder


def results_targets(home: Path) -> Iterator[Target]:
    """Folders of results, read by each command that reads them."""
    campaign = small_campaign(home / "campaign")
    rng = np.random.default_rng(1)
    good = results_folder(home / "good", campaign, rng)
    folder = results_folder(home / "results", campaign, rng)
    text = {name: (folder / name).read_text() for name in ("summary.json", "run.json")}
    small = [d for name in text for d in damage.of_any_file(name, text[name].encode())]
    small += [d for name in text for d in damage.of_json(name, text[name])]
    draws = "IV/posterior.nc"
    large = [*damage.of_any_file(draws, (folder / draws).read_bytes()), *of_netcdf(draws)]

    def tune() -> object:
        case = chosen_case(folder, None)
        origin = origin_of(folder, case)
        return posterior_draws(folder, case, 50, np.random.default_rng(1), origin.constants)

    def go_on() -> object:
        with mock.patch.object(resume, "finish_fit"):
            return resume.resume(folder)

    yield Target("compare", folder, lambda: compare([folder, good]).text(), small + large)
    yield Target("tune", folder, tune, small + large)
    yield Target("report", folder, lambda: report(folder, out=home / "page.html"), small[::3] + large[::3])
    yield Target("resume", folder, go_on, [d for d in small if d.file == "run.json"])


def edited(change: Callable[[h5py.File], Any]) -> Callable[[Path], None]:
    """A damage that changes a file of HDF5."""

    def apply(path: Path) -> None:
        with h5py.File(path, "r+") as content:
            change(content)

    return apply


def of_netcdf(file: str) -> Iterator[damage.Damage]:
    """What a file of HDF5 can hold that none of ours does."""
    changes: dict[str, Callable[[h5py.File], Any]] = {
        "no posterior": lambda f: f.pop("posterior"),
        "no log_likelihood": lambda f: f.pop("log_likelihood"),
        "mu missing": lambda f: f["posterior"].pop("mu"),
        "mu a text": lambda f: _replaced(f["posterior"], "mu", np.array([b"x", b"y"])),
        "mu a scalar": lambda f: _replaced(f["posterior"], "mu", np.float64(1.0)),
        "mu empty": lambda f: _replaced(f["posterior"], "mu", np.zeros(0)),
        "mu of another shape": lambda f: _replaced(f["posterior"], "mu", np.zeros((3, 5, 7))),
        "mu nan": lambda f: f["posterior/mu"].__setitem__(..., np.nan),
        "mu inf": lambda f: f["posterior/mu"].__setitem__(..., np.inf),
        "mu 1e308": lambda f: f["posterior/mu"].__setitem__(..., 1e308),
        "mu negative": lambda f: f["posterior/mu"].__setitem__(..., -1.0),
        "complex": lambda f: _replaced(f["posterior"], "mu", np.zeros((2, 128), complex)),
        "a table": lambda f: _replaced(f["posterior"], "mu", np.zeros(3, [("a", "f8"), ("b", "i4")])),
        "a group in place of mu": lambda f: (f["posterior"].pop("mu"), f["posterior"].create_group("mu")),
        "a link to another file": lambda f: _linked(f, h5py.ExternalLink("/dev/zero", "/")),
        "a soft link": lambda f: _linked(f, h5py.SoftLink("/nowhere")),
        "a group within itself": lambda f: f["posterior"].__setitem__("again", f["/"]),
        "a petabyte of nothing": lambda f: f["posterior"].create_dataset(
            "bomb", (10**7, 10**7), "f8", chunks=(1000, 1000)
        ),
        "a gigabyte of nothing": lambda f: f["posterior"].create_dataset(
            "bomb", (2, 10**8), "f8", chunks=(2, 10**6), compression=9
        ),
        "readings elsewhere": lambda f: f.create_dataset("far", (10,), "f8", external=[("/dev/zero", 0, 80)]),
        "no attributes": lambda f: [f.attrs.pop(key, None) for key in list(f.attrs)],
        "log_likelihood nan": lambda f: f["log_likelihood/trials"].__setitem__(..., np.nan),
        "log_likelihood empty": lambda f: _replaced(f["log_likelihood"], "trials", np.zeros((2, 0, 2))),
    }
    for name, change in changes.items():
        yield damage.Damage(file, name, edited(change))


def _replaced(group: Any, name: str, values: Any) -> None:
    del group[name]
    group[name] = values


def _linked(file: Any, link: Any) -> None:
    del file["posterior/mu"]
    file["posterior/mu"] = link
