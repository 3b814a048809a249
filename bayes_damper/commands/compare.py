"""Results side by side: parameters, evidence and held-out scores of fits, verdicts of diagnoses, what cases share.

Also how far the answers of a fit hang on its priors. Nothing is fitted here: all comes from the files of the folders.
Models are compared by whole held-out pieces of data (a trial, or a published feature), never by single samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_damper import figures
from bayes_damper.errors import ExitCode, InputError, as_written
from bayes_damper.fit import published_posterior
from bayes_damper.fit.summary import groups_of
from bayes_damper.inputs import resolved
from bayes_damper.priors.distributions import to_standard
from bayes_damper.priors.files import priors_from_dict
from bayes_damper.published.sources import is_published
from bayes_damper.rig.parameters import PARAMETERS
from bayes_damper.runs.contents.comparison import ComparedCell, ComparedRows, ComparisonFile, FolderContents
from bayes_damper.runs.contents.diagnosis import DiagnosisFile
from bayes_damper.runs.contents.fit import FitFile, FitPlan, PriorEntry, WidthEntry
from bayes_damper.runs.contents.variability import VariabilityFile
from bayes_damper.runs.json_files import folder_name, read_json, write_json
from bayes_damper.runs.provenance import provenance
from bayes_damper.sampling import arviz_adapter
from bayes_damper.sampling.bridge import bridge
from bayes_damper.sampling.prior_sensitivity import of_standard_draws
from bayes_damper.text import Printable, plus_minus

Array = NDArray[np.float64]
T = TypeVar("T")
SCHEMA = "bayes-damper/comparison/1"
Kind = Literal["fit", "diagnosis", "variability"]
KINDS: dict[str, Kind] = {"summary.json": "fit", "diagnosis.json": "diagnosis", "variability.json": "variability"}
_PROPOSALS = 4000


@dataclass(frozen=True)
class Comparison(Printable):
    """Results side by side; `result` is what comparison.json holds."""

    result: ComparisonFile

    @property
    def exit_code(self) -> ExitCode:
        """Always done: whether the compared runs converged stands in the table."""
        return ExitCode.DONE

    def to_json(self) -> ComparisonFile:
        """What comparison.json holds."""
        return self.result

    def text(self) -> str:
        """Tables for the terminal."""
        r = self.result
        labels = list(r["folders"])
        width = max(22, *(len(label) + 2 for label in labels))
        lines = [f"{'':38s}" + "".join(f"{label:>{width}s}" for label in labels)]
        for case, rows in r["parameters"].items():
            lines.append(f"{'all cases together' if case == 'joint' else f'case {case}'}")
            for name, found in rows.items():
                cells = "".join(f"{_cell(found.get(label)):>{width}s}" for label in labels)
                unit = next(iter(found.values()))["unit"]
                lines.append(f"  {name:28s}{unit:8s}{cells}")
        tables: tuple[tuple[str, ComparedRows | Mapping[str, Mapping[str, float]]], ...] = (
            ("log evidence, nats", r["evidence"]), ("score of each trial left out, nats", r["heldout"]),
            ("gap and verdict", r["diagnosis"]), ("what the cases share", r["variability"]),
        )  # fmt: skip
        for title, table in tables:
            lines += [title] if table else []
            lines += [
                f"  {name:36s}" + "".join(f"{_word(row.get(label)):>{width}s}" for label in labels)
                for name, row in table.items()
            ]
        for label, cases in r["prior_sensitivity"].items():
            lines.append(
                f"{label}: shift of each mean, in standard deviations, when its own prior is half / twice as wide"
            )
            for case, priors in cases.items():
                shifts = ", ".join(f"{n} {' / '.join(map(_shift, _widths(p)))}" for n, p in priors.items())
                lines.append(f"  case {case}: {shifts}")
        return "\n".join([*lines, *r["sentences"]])


def compare(folders: Sequence[str | Path], *, out: str | Path | None = None, seed: int = 1) -> Comparison:
    """Results of two folders or more side by side; with `out`, comparison.json and a figure are written there.

    Parameters
    ----------
    folders : each holds results of `fit`, `diagnose` or `variability`, of one campaign or of several.
    seed : of the proposals of bridge sampling.

    Raises
    ------
    InputError
        if fewer than two folders are given, or one holds no results: one sentence for each.
    """
    paths = [Path(folder) for folder in folders]
    faults = [] if len(paths) > 1 else ["compare needs two folders or more; name another one"]
    for path in paths:
        if not path.is_dir():
            faults.append(f"{path}: there is no such folder; name one that bayes-damper has written")
        elif not any((path / file).exists() for file in KINDS):
            more = f"; the run in it has not ended, go on with: bayes-damper resume {path}"
            begun = (path / "run.json").is_file()
            faults.append(
                f"{path}: holds no results of fit, diagnose or variability ({', '.join(KINDS)}){more if begun else ''}"
            )
    if len({resolved(path) for path in paths}) < len(paths):
        faults.append("a folder is named twice; name different folders")
    if faults:
        raise InputError(faults)
    labels = _labels(paths)
    found = {label: _results(path) for label, path in zip(labels, paths, strict=True)}
    where = dict(zip(labels, paths, strict=True))
    for label, results in found.items():
        for file, kind in KINDS.items():
            with as_written(where[label] / file, kind):
                _read(results, kind)
    fits = {label: results["fit"] for label, results in found.items() if "fit" in results}
    pieces: dict[str, _Pieces] = {}
    for label, summary in fits.items():
        with as_written(where[label], "fit"):
            pieces[label] = _fit_pieces(where[label], summary, seed)
    with as_written(" or ".join(map(str, paths)), "fit"):
        parameters = _parameters(fits)
    result: ComparisonFile = {
        "schema": SCHEMA,
        "folders": {label: str(path) for label, path in where.items()},
        "campaigns": {label: _entry_of(results, "campaign") for label, results in found.items()},
        "campaign_sha256": {label: _entry_of(results, "campaign_sha256") for label, results in found.items()},
        "converged": {label: _converged(results) for label, results in found.items()},
        "parameters": parameters,
        "evidence": _turned({label: piece.evidence for label, piece in pieces.items()}),
        "heldout": _turned({label: piece.heldout for label, piece in pieces.items()}),
        "diagnosis": _turned({k: _diagnosis(v["diagnosis"]) for k, v in found.items() if "diagnosis" in v}),
        "variability": _turned({k: _pooling(v["variability"]) for k, v in found.items() if "variability" in v}),
        "prior_sensitivity": {label: piece.sensitivity for label, piece in pieces.items()},
        "sentences": [],
        "provenance": provenance(),
    }
    with as_written(" or ".join(map(str, paths)), "fit"):
        result["sentences"] = _sentences(result)
        Comparison(result).text()
    if out is not None:
        write_json(Path(out) / "comparison.json", result)
        if fits:
            figures.save(_figure(result), Path(out) / "comparison")
    return Comparison(result)


def _labels(paths: Sequence[Path]) -> list[str]:
    """The shortest endings of the paths that differ."""
    parts = [resolved(path).parts for path in paths]
    for count in range(1, max(len(p) for p in parts) + 1):
        labels = ["/".join(p[-count:]) for p in parts]
        if len(set(labels)) == len(labels):
            return labels
    return [str(path) for path in paths]


def _results(path: Path) -> FolderContents:
    """What a folder holds, by kind.

    Raises
    ------
    InputError
        if a file is of another schema.
    """
    out: FolderContents = {}
    for file, kind in KINDS.items():
        if not (path / file).exists():
            continue
        content = read_json(path / file)
        schema = content.get("schema", "") if isinstance(content, dict) else ""
        if not str(schema).startswith(f"bayes-damper/{kind}/"):
            raise InputError(f"{path / file}: its schema is {schema!r}, not bayes-damper/{kind}/1; run {kind} again")
        out[kind] = content
    return out


def _entry_of(results: FolderContents, key: str) -> str:
    contents = [cast("Mapping[str, object]", content) for content in results.values()]
    return next((str(content[key]) for content in contents if content.get(key)), "")


def _converged(results: FolderContents) -> bool:
    return all(bool(cast("Mapping[str, object]", content).get("converged", True)) for content in results.values())


def _parameters(fits: Mapping[str, FitFile]) -> dict[str, dict[str, dict[str, ComparedCell]]]:
    """Parameters by case, name and folder: median and interval, with the distance from the first folder."""
    out: dict[str, dict[str, dict[str, ComparedCell]]] = {}
    for label, summary in fits.items():
        for case, entry in groups_of(summary).items():
            for name, p in entry["parameters"].items():
                cell: ComparedCell = {
                    "unit": p["unit"], "median": p["median"], "mean": p["mean"], "sd": p["sd"], "hdi90": p["hdi90"],
                }  # fmt: skip
                found = out.setdefault(case, {}).setdefault(name, {})
                if found:
                    first = next(iter(found.values()))
                    spread = math.hypot(first["sd"], cell["sd"])
                    cell["distance_sd"] = (cell["mean"] - first["mean"]) / spread if spread > 0.0 else 0.0
                found[label] = cell
    return out


def _of_fit(summary: FitFile) -> list[str]:
    """Every parameter of a fit as the table shows it."""
    return [
        _cell(found) for rows in _parameters({"": summary}).values() for row in rows.values() for found in row.values()
    ]


def _turned(table: Mapping[str, Mapping[str, T]]) -> dict[str, dict[str, T]]:
    """A table by folder and row, turned into one by row and folder."""
    rows = dict.fromkeys(name for found in table.values() for name in found)
    return {name: {label: found[name] for label, found in table.items() if name in found} for name in rows}


def _diagnosis(content: DiagnosisFile) -> dict[str, float | str]:
    gap = content.get("gap")
    out: dict[str, float | str | None] = {"verdict": content["verdict"], "gap": gap.get("answer") if gap else None}
    out["probability of the verdict"] = content["probabilities"].get(content["verdict"])
    if gap:
        out |= {"size": gap.get("size"), "noise_rms": gap.get("noise_rms")}
        out |= {"nominal_rms": gap.get("nominal_rms"), "augmented_rms": gap.get("augmented_rms")}
    for effect in content.get("effects", [])[:5]:
        out[f"log evidence of {effect['name']}"] = effect.get("log_evidence")
    return {key: value for key, value in out.items() if value is not None}


def _pooling(content: VariabilityFile) -> dict[str, float | str]:
    out: dict[str, float | str] = {}
    for name, model in content["models"].items():
        out[f"{name}: log evidence"] = model["log_evidence"]
        if (score := model["heldout"]["log_score"]) is not None:
            out[f"{name}: held-out score"] = score
    return out


def _read(results: FolderContents, kind: Kind) -> None:
    """What is taken of one kind of results, so that a damaged file is found before anything is computed."""
    if kind == "fit" and "fit" in results:
        _of_fit(results["fit"])
    elif kind == "diagnosis" and "diagnosis" in results:
        _diagnosis(results["diagnosis"])
    elif kind == "variability" and "variability" in results:
        _pooling(results["variability"])


# From the draws of a fit ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Pieces:
    """Of one fit: log evidence and held-out score by row, and how far the answers of each case hang on the prior."""

    evidence: dict[str, float]
    heldout: dict[str, float]
    sensitivity: dict[str, Mapping[str, PriorEntry]]


def _fit_pieces(path: Path, summary: FitFile, seed: int) -> _Pieces:
    """Evidence and held-out score of each case, and how far its answers hang on the prior."""
    plan: FitPlan = read_json(path / "run.json")["plan"]
    evidence: dict[str, float] = {}
    heldout: dict[str, float] = {}
    sensitivity: dict[str, Mapping[str, PriorEntry]] = {}
    for case, entry in summary["cases"].items():
        row = f"case {case}"
        file = path / folder_name(case) / "posterior.nc"
        # What the fit has worked out already is not worked out again.
        if found := entry.get("log_evidence"):
            evidence[row] = float(found["value"])
        elif best := entry.get("best_fit"):
            evidence[row] = float(best["log_evidence_laplace"])
        if entry.get("prior_sensitivity"):
            sensitivity[case] = entry["prior_sensitivity"]
        if not file.exists():
            continue
        tree = arviz_adapter.read(file)
        if is_published(plan["campaign"]):
            priors = priors_from_dict(plan["priors"] or {}).for_case(case).free
            posterior = tree["posterior"]
            draws = {name: np.asarray(posterior[name].values, float) for name in priors if name in posterior}
            if row not in evidence:
                evidence[row] = _published_evidence(plan, case, posterior.attrs["walkers"], draws, tree, seed)
            if case not in sensitivity:
                points = np.stack([to_standard(priors[name], x.ravel()) for name, x in draws.items()], axis=1)
                sensitivity[case] = of_standard_draws(tuple(draws), points)
        pieces = [np.asarray(x.values, float) for x in tree["log_likelihood"].data_vars.values()]
        likelihood = np.concatenate([x.reshape(x.shape[0] * x.shape[1], -1) for x in pieces], axis=1)
        heldout[row] = float(sum(leave_out(column)[0] for column in likelihood.T))
    if evidence:
        evidence["sum over cases"] = float(sum(evidence.values()))
    if heldout:
        heldout["sum over cases"] = float(sum(heldout.values()))
    return _Pieces(evidence, heldout, sensitivity)


def _published_evidence(
    plan: FitPlan, case: str, walkers: int, draws: Mapping[str, Array], tree: Any, seed: int
) -> float:
    posterior = published_posterior(case, priors_from_dict(plan["priors"] or {}), plan["normal_force"] or "linear")
    shape = next(iter(draws.values())).shape
    points = posterior.coordinates.points({name: x.ravel() for name, x in draws.items()})
    points = points.reshape(shape[0], shape[1] // int(walkers), int(walkers), posterior.ndim)
    height = np.asarray(tree["sample_stats"]["lp"].values, float).reshape(points.shape[:3])
    return bridge(posterior, points, height, np.random.default_rng([seed, 7]), proposals=_PROPOSALS).log_z


def leave_out(log_likelihood: Array) -> tuple[float, float]:
    """Log predictive density of one piece of data left out, from draws that have seen it, and the Pareto k of it.

    log_likelihood : (n,) of that piece under the draws. The weights 1 / likelihood are cut at their mean times sqrt(n)
    (Ionides 2008, J. Comput. Graph. Stat. 17:295).
    """
    n = len(log_likelihood)
    log_weights = -log_likelihood
    k = arviz_adapter.pareto_k(np.exp(log_weights - log_weights.max()))
    top = logsumexp(log_weights) - 0.5 * math.log(n)
    log_weights = np.minimum(log_weights, top)
    return float(logsumexp(log_weights + log_likelihood) - logsumexp(log_weights)), k


# Words and figure -----------------------------------------------------------------------------------------------------


def _cell(found: ComparedCell | None) -> str:
    if found is None:
        return "-"
    return plus_minus(found["median"], found["sd"]).replace("±", "+-")


def _widths(found: PriorEntry) -> tuple[WidthEntry, WidthEntry]:
    """A prior half and twice as wide."""
    return found["half"], found["double"]


def _shift(found: WidthEntry) -> str:
    return f"{found['shift']:+.2f}" + ("" if found["reliable"] else "?")


def _word(value: float | str | None) -> str:
    if value is None:
        return "-"
    if not isinstance(value, float | int):
        return str(value)
    return f"{value:.1f}" if abs(value) >= 1000.0 else f"{value:.4g}"  # nats: differences count


def _sentences(result: ComparisonFile) -> list[str]:
    out = [f"{label}: did not converge; do not use its numbers." for label, ok in result["converged"].items() if not ok]
    named = len(set(result["campaigns"].values())) == 1
    same = named and len(set(result["campaign_sha256"].values()) - {""}) < 2
    if not same:
        which = "different states of one campaign" if named else "different campaigns"
        out.append(f"The folders belong to {which}: evidence and scores are of different data.")
    total = result["evidence"].get("sum over cases", {})
    alike = {tuple(row for row, found in result["evidence"].items() if label in found) for label in total}
    if same and len(alike) > 1:
        out.append("The folders hold different cases: compare the evidence and scores of single cases, not the sums.")
    elif same and len(total) > 1:
        best = max(total, key=lambda label: total[label])
        lead = total[best] - sorted(total.values())[-2]
        if lead < 1.0:
            out.append("The evidence does not distinguish the best two (less than 1 nat).")
        else:
            out.append(f"Evidence is highest for {best}, by {lead:.1f} nats.")
    far = [
        (abs(cell["distance_sd"]), name, case, label)
        for case, rows in result["parameters"].items()
        for name, found in rows.items()
        for label, cell in found.items()
        if "distance_sd" in cell
    ]
    if far:
        size, name, case, label = max(far)
        where = "all cases together" if case == "joint" else f"case {case}"
        out.append(f"The largest difference is {size:.1f} standard deviations: {name} of {where} in {label}.")
    for label, cases in result["prior_sensitivity"].items():
        moves = [(abs(w["shift"]), n, c) for c, rows in cases.items() for n, p in rows.items() for w in _widths(p)]
        if moves:
            size, name, case = max(moves)
            out.append(
                f"{label}: {name} of case {case} hangs most on its own prior (half or twice as wide: {size:.2f} sd)."
            )
        if any(not w["reliable"] for rows in cases.values() for p in rows.values() for w in _widths(p)):
            out.append(f"{label}: the draws are too few to be sure of shifts marked ?; fit with that prior to know.")
    return out


def _figure(result: ComparisonFile) -> Any:
    """Median and 90 % interval of the main parameters, one row for each case and folder."""
    names = ("mu", "k2t", "c2t", "drag", "c1t", "friction_torque")
    intervals: dict[str, dict[str, tuple[float, float, float]]] = {}
    for name in names:
        rows = {
            f"{case} {label}": (cell["hdi90"][0], cell["median"], cell["hdi90"][1])
            for case, table in result["parameters"].items()
            for label, cell in table.get(name, {}).items()
        }
        if rows and (not intervals or set(rows) == set(next(iter(intervals.values())))):
            intervals[name] = rows
    units = {n: cell["unit"] for rows in result["parameters"].values() for n, t in rows.items() for cell in t.values()}
    labels = {n: figures.label(PARAMETERS[n].symbol, units[n]) for n in intervals}
    return figures.forest_figure(
        intervals, labels, title="results side by side", converged=all(result["converged"].values())
    )
