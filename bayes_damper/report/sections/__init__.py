"""From the JSON files of results to headlines and sections: words and tables, nothing computed anew.

One module for each kind of result; what several of them show is in `shared`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from bayes_damper.report.parts import Result
from bayes_damper.report.sections.diagnosis import diagnosis_result
from bayes_damper.report.sections.fit import fit_result
from bayes_damper.report.sections.fleet import fleet_result
from bayes_damper.report.sections.other import other_result
from bayes_damper.report.sections.plan import plan_result
from bayes_damper.report.sections.tuning import tune_result
from bayes_damper.report.sections.variability import variability_result
from bayes_damper.report.sections.withheld import withheld_result

READERS: Mapping[str, tuple[str, Callable[[Any, Path], Result]]] = {
    "fleet.json": ("bayes-damper/fleet/1", fleet_result),
    "diagnosis.json": ("bayes-damper/diagnosis/1", diagnosis_result),
    "variability.json": ("bayes-damper/variability/1", variability_result),
    "summary.json": ("bayes-damper/fit/1", fit_result),
    "tune.json": ("bayes-damper/tune/1", tune_result),
    "plan.json": ("bayes-damper/plan/1", plan_result),
    "withheld.json": ("bayes-damper/withheld/1", withheld_result),
    "comparison.json": ("bayes-damper/comparison/1", other_result("comparison", "Comparison", "Results side by side.")),
    "bench.json": (
        "bayes-damper/bench/1",
        other_result("bench", "Speed and accuracy", "Measured on the machine named below."),
    ),
}
"""File name -> (schema, reader), in the order in which they come on the page."""
