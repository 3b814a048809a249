"""Reads `data/thesis`: the published measurements, and apart from them everything else that the thesis prints.

Each CSV has a TOML beside it with units, pages and the checksum that is verified here. The thesis published no
records, so its 24 measurements (three features, two configurations, four cases) are all the data there are.
"""

from __future__ import annotations

import csv
import hashlib
import math
from dataclasses import dataclass
from pathlib import Path

from bayes_damper.errors import InputError
from bayes_damper.inputs import file_bytes, shipped_path, toml_file

FILES = ("cases", "measurements", "derived", "inertia", "printed", "frequency_response")
_TO_SI = {"ms": (1e3, "s"), "kg mm^2": (1e6, "kg m^2")}  # printed unit -> divisor, SI unit


@dataclass(frozen=True)
class Case:
    """Nominal set-up of one case (Table 2, p. 11); k1t in N m/rad, theta0 in rad. No uncertainties are printed."""

    name: str
    k1t: float
    theta0: float


@dataclass(frozen=True)
class Measurement:
    """Median of n trials and its standard error sd/sqrt(n), in SI units (the period in s), with where it is printed."""

    case: str
    configuration: str
    quantity: str
    value: float
    standard_error: float
    unit: str
    n: int
    table: str
    page: int


@dataclass(frozen=True)
class Printed:
    """A printed number that is no measurement of its own; `text` keeps the digits as printed, value is in `unit`."""

    case: str
    configuration: str
    quantity: str
    text: str
    unit: str
    table: str
    page: int

    @property
    def value(self) -> float:
        """The number."""
        return float(self.text)


@dataclass(frozen=True)
class Published:
    """All that the thesis prints.

    cases : name -> Case; measurements : the 24 data; derived : what follows from them or repeats them; printed :
    fitted values, model results and design numbers; frequency_response : Table 12 and Figure 11, its `configuration`
    being the state of the model; inertia : component -> kg m^2 (Table 1); checksum : SHA-256 over all files.
    """

    cases: dict[str, Case]
    measurements: tuple[Measurement, ...]
    derived: tuple[Measurement, ...]
    printed: tuple[Printed, ...]
    frequency_response: tuple[Printed, ...]
    inertia: dict[str, float]
    checksum: str

    def of_case(self, case: str) -> tuple[Measurement, ...]:
        """The measurements of one case.

        Raises
        ------
        InputError
            if there is no such case.
        """
        if case not in self.cases:
            raise InputError(f"case {case!r}: the thesis has no such case; its cases are {', '.join(self.cases)}")
        return tuple(m for m in self.measurements if m.case == case)


def load_published(folder: Path | str | None = None) -> Published:
    """The published numbers, from the shipped `data/thesis` or from a folder of the same form.

    Raises
    ------
    InputError
        if a file is missing, differs from its checksum or holds what is no number: one sentence for each.
    """
    root = shipped_path("data/thesis") if folder is None else Path(folder)
    faults: list[str] = []
    tables = {name: _table(root, name, faults) for name in FILES}
    if faults:
        raise InputError(faults)
    measurements = _measurements(root, "measurements", tables["measurements"], faults)
    derived = _measurements(root, "derived", tables["derived"], faults)
    cases = {
        row["case"]: Case(
            row["case"],
            _number(root, "cases", i, row, "k1t_n_m_per_rad", faults),
            math.radians(_number(root, "cases", i, row, "theta0_deg", faults)),
        )
        for i, row in enumerate(tables["cases"], start=2)
    }
    inertia = {
        row["component"]: _number(root, "inertia", i, row, "value", faults) / _TO_SI[row["unit"]][0]
        for i, row in enumerate(tables["inertia"], start=2)
    }
    printed = _printed(root, "printed", tables["printed"], faults)
    response = _printed(root, "frequency_response", tables["frequency_response"], faults)
    if faults:
        raise InputError(faults)
    digest = hashlib.sha256(b"".join((root / f"{name}.csv").read_bytes() for name in FILES)).hexdigest()
    return Published(cases, measurements, derived, printed, response, inertia, digest)


def published_rows(name: str) -> list[dict[str, str]]:
    """The rows of one shipped table, as text by column; InputError if it is missing or was changed."""
    faults: list[str] = []
    rows = _table(shipped_path("data/thesis"), name, faults)
    if faults:
        raise InputError(faults)
    return rows


def _table(root: Path, name: str, faults: list[str]) -> list[dict[str, str]]:
    """The rows of one CSV, after comparing it with its TOML."""
    path, about_path = root / f"{name}.csv", root / f"{name}.toml"
    missing = [p for p in (path, about_path) if not p.is_file()]
    if missing:
        faults.extend(f"{p}: this file of published numbers is missing; reinstall the package" for p in missing)
        return []
    try:
        about = toml_file(about_path, "reinstall the package")
        content = file_bytes(path)
    except InputError as error:
        faults.extend(error.faults)
        return []
    found = hashlib.sha256(content).hexdigest()
    if found != about.get("sha256"):
        faults.append(
            f"{path}: its SHA-256 is {found[:12]}..., {about_path.name} says {str(about.get('sha256'))[:12]}...; "
            "the published numbers were changed: restore the file, or put data of your own into a campaign"
        )
        return []
    rows = list(csv.DictReader(content.decode("utf-8").splitlines()))
    if not rows or set(rows[0]) != set(about["columns"]):
        faults.append(f"{path}: its columns are not those that {about_path.name} describes")
        return []
    return rows


def _number(root: Path, name: str, line: int, row: dict[str, str], column: str, faults: list[str]) -> float:
    try:
        return float(row[column])
    except ValueError:
        faults.append(f"{root / name}.csv, line {line}, column {column}: {row[column]!r} is no number")
        return math.nan


def _measurements(root: Path, name: str, rows: list[dict[str, str]], faults: list[str]) -> tuple[Measurement, ...]:
    """Rows as measurements in SI units; a standard error that is not printed is nan."""
    result = []
    for line, row in enumerate(rows, start=2):
        scale, unit = _TO_SI.get(row["unit"], (1.0, row["unit"]))
        error = _number(root, name, line, row, "standard_error", faults) if row["standard_error"] else math.nan
        result.append(
            Measurement(
                row["case"],
                row["configuration"],
                row["quantity"],
                _number(root, name, line, row, "value", faults) / scale,
                error / scale,
                unit,
                int(row["n"]),
                row["table"],
                int(row["page"]),
            )
        )
    return tuple(result)


def _printed(root: Path, name: str, rows: list[dict[str, str]], faults: list[str]) -> tuple[Printed, ...]:
    """Rows as printed numbers."""
    for line, row in enumerate(rows, start=2):
        _number(root, name, line, row, "value", faults)
    return tuple(
        Printed(
            row.get("case", "IV"),
            row.get("configuration", row.get("condition", "")),
            row["quantity"],
            row["value"],
            row["unit"],
            row["table"],
            int(row["page"]),
        )
        for row in rows
    )
