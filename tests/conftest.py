"""Settings for all tests."""

import os
import sys
from pathlib import Path

import pytest

os.environ.setdefault("MPLBACKEND", "Agg")
sys.path.insert(0, str(Path(__file__).parent))  # helpers of tests/, e.g. campaigns.py


def pytest_collection_modifyitems(config, items):
    """Where tests run side by side, those of one file stay in one process, unless they are grouped otherwise."""
    if config.pluginmanager.hasplugin("xdist"):
        for item in items:
            if item.get_closest_marker("xdist_group") is None:
                item.add_marker(pytest.mark.xdist_group(item.path.stem))
