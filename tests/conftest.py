"""Settings for all tests."""

import os
import re
import sys
from collections import Counter
from importlib import import_module
from pathlib import Path

import pytest
from hypothesis import settings

# The same examples in every run, so that a commit is green or red and not both; FUZZ=1 looks for new ones.
settings.register_profile("fixed", derandomize=True)
if not os.environ.get("FUZZ"):
    settings.load_profile("fixed")

os.environ.setdefault("MPLBACKEND", "Agg")
os.environ.setdefault("OMP_NUM_THREADS", "1")  # as all commands have it
HERE = Path(__file__).parent
# Helpers of tests/, e.g. campaigns.py, and test modules that lend others their campaigns.
LENDING = ("", "calibration", "diagnosis", "fit", "runs", "sampling", "validation/withheld")
sys.path[:0] = [str(HERE / folder) for folder in LENDING]
sys.path.append(str(HERE.parent))  # the programs of validation/

# Files whose tests, quick or slow, take longest together: they come first, or one process would be left with such a
# file when all others are done. `pytest --durations=60` shows what has grown.
LONGEST = (
    "test_published", "test_damage", "test_answer", "test_entry", "test_pipeline", "test_damage_of_results",
    "test_correlated_noise", "test_plan", "test_gap", "test_integrator", "test_kinds", "test_scatter", "test_law",
    "test_bench", "test_sites", "test_wiring", "test_rigs", "test_problem", "test_sets", "test_parallel_map",
    "test_fleet", "test_result", "test_compare", "test_nominal", "test_logger_formats", "test_laboratories",
    "test_own_effect", "test_input_noise", "test_simulator", "test_moves", "test_examples", "test_ensembles",
    "test_named", "test_prescribed_motion", "test_check", "test_bench_parts", "test_simulator_reserved", "test_wheel",
    "test_scenarios", "test_unlearnt", "test_diagnose_stopped", "test_cache_folder", "test_execution",
)  # fmt: skip


DRAWING = (
    ("fit.recorded", "draw_case"), ("fit.recorded", "draw_records"), ("fit.result", "draw_overview"),
    ("commands.diagnose", "_draw"),
)  # fmt: skip


@pytest.fixture
def undrawn(monkeypatch):
    """Fits and diagnoses of this process draw no figures, a quarter of the time that a short one takes."""
    for module, name in DRAWING:
        monkeypatch.setattr(import_module(f"bayes_damper.{module}"), name, lambda *_, **__: None)


def together(nodeid):
    """Which tests are run by one process, so that what a file prepares is made once, and each kernel is compiled once:
    those of a file; of test_effects.py those of a formula.
    """
    formula = re.search(r"test_effects\.py::.*\[(\w+/\w+)\]$", nodeid)
    return formula[1] if formula else nodeid.partition("::")[0]


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """With --dist loadfile: as `together` says. (The marks of --dist loadgroup are not seen with pytest 9.2.)"""
    if config.getvalue("dist") != "loadfile":
        return None
    from xdist.scheduler import LoadFileScheduling

    class Together(LoadFileScheduling):
        def _split_scope(self, nodeid):
            return together(nodeid)

    return Together(config, log)


def pytest_collection_modifyitems(config, items):
    """Where tests run side by side, those of the longest files come first, then those of most tests."""
    if hasattr(config, "workerinput"):
        sizes = Counter(item.path.stem for item in items)
        place = {name: number for number, name in enumerate(LONGEST)}
        items.sort(key=lambda item: (place.get(item.path.stem, len(place)), -sizes[item.path.stem], item.path.stem))
