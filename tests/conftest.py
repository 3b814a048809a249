"""Settings for all tests."""

import os
import sys
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import settings

# The same examples in every run, so that a commit is green or red and not both; FUZZ=1 looks for new ones.
settings.register_profile("fixed", derandomize=True)
if not os.environ.get("FUZZ"):
    settings.load_profile("fixed")

os.environ.setdefault("MPLBACKEND", "Agg")
HERE = Path(__file__).parent
# Helpers of tests/, e.g. campaigns.py, and test modules that lend others their campaigns.
LENDING = ("", "calibration", "diagnosis", "fit", "runs", "sampling", "validation/withheld")
sys.path[:0] = [str(HERE / folder) for folder in LENDING]

# Files whose tests, quick or slow, take longest together: they come first, or one process would be left with such a
# file when all others are done. `pytest --durations=60` shows what has grown.
LONGEST = (
    "test_entry", "test_answer", "test_integrator", "test_pipeline", "test_damage", "test_prescribed_motion",
    "test_published", "test_bench", "test_correlated_noise", "test_sites", "test_own_effect", "test_measured_inputs",
    "test_bench_parts", "test_plan", "test_compare", "test_cache_folder", "test_named", "test_examples", "test_sets",
    "test_fleet", "test_damage_of_results", "test_wiring", "test_result", "test_bridge", "test_problem", "test_check",
    "test_ensembles",
)  # fmt: skip


def pytest_collection_modifyitems(config, items):
    """Where tests run side by side, those of one file stay in one process, unless they are grouped otherwise.

    The longest files come first, then those of most tests.
    """
    if not config.pluginmanager.hasplugin("xdist"):
        return
    for item in items:
        if item.get_closest_marker("xdist_group") is None:
            item.add_marker(pytest.mark.xdist_group(item.path.stem))
    if hasattr(config, "workerinput"):
        groups = [item.get_closest_marker("xdist_group").args[0] for item in items]
        sizes = Counter(groups)
        place = {name: number for number, name in enumerate(LONGEST)}
        order = sorted(range(len(items)), key=lambda i: (place.get(groups[i], len(place)), -sizes[groups[i]]))
        items[:] = [items[i] for i in order]
