"""Settings for all tests."""

import os
import sys
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


def pytest_collection_modifyitems(config, items):
    """Where tests run side by side, those of one file stay in one process, unless they are grouped otherwise."""
    if config.pluginmanager.hasplugin("xdist"):
        for item in items:
            if item.get_closest_marker("xdist_group") is None:
                item.add_marker(pytest.mark.xdist_group(item.path.stem))
