"""bayes_damper: calibrate a magnetically coupled mass damper and find out why the model and the rig differ.

The public names are loaded when they are first used, so that importing the package is quick and writes nothing.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayes_damper.campaign import load_campaign as load_campaign
    from bayes_damper.campaign.importing.importer import import_records as import_records
    from bayes_damper.campaign.importing.importer import init_campaign as init_campaign
    from bayes_damper.commands.check import check as check
    from bayes_damper.commands.compare import compare as compare
    from bayes_damper.commands.demo import demo as demo
    from bayes_damper.commands.diagnose import diagnose as diagnose
    from bayes_damper.commands.examples import examples as examples
    from bayes_damper.commands.fleet import diagnose_fleet as diagnose_fleet
    from bayes_damper.commands.plan import plan as plan
    from bayes_damper.commands.resume import resume as resume
    from bayes_damper.commands.simulate import simulate_record as simulate_record
    from bayes_damper.fit import fit as fit
    from bayes_damper.fit import load_fit as load_fit
    from bayes_damper.published.measurements import load_published as load_published
    from bayes_damper.report import report as report
    from bayes_damper.simulation.model import Model as Model
    from bayes_damper.thesis import recompute as recompute
    from bayes_damper.tuning import tune as tune
    from bayes_damper.validation.bench import bench as bench
    from bayes_damper.validation.withheld import withheld as withheld
    from bayes_damper.variability import variability as variability

_PLACES = {
    "Model": "simulation.model",
    "bench": "validation.bench",
    "check": "commands.check",
    "compare": "commands.compare",
    "demo": "commands.demo",
    "diagnose": "commands.diagnose",
    "diagnose_fleet": "commands.fleet",
    "examples": "commands.examples",
    "fit": "fit",
    "import_records": "campaign.importing.importer",
    "init_campaign": "campaign.importing.importer",
    "load_campaign": "campaign",
    "load_fit": "fit",
    "load_published": "published.measurements",
    "plan": "commands.plan",
    "recompute": "thesis",
    "report": "report",
    "resume": "commands.resume",
    "simulate_record": "commands.simulate",
    "tune": "tuning",
    "variability": "variability",
    "withheld": "validation.withheld",
}

__all__ = [
    "Model", "bench", "check", "compare", "demo", "diagnose", "diagnose_fleet", "examples", "fit", "import_records",
    "init_campaign", "load_campaign", "load_fit", "load_published", "plan", "recompute", "report", "resume",
    "simulate_record", "tune", "variability", "withheld",
]  # fmt: skip


class _Package(ModuleType):
    """A module in which a public function is not hidden by the submodule of the same name when that is imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _PLACES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return import_module("importlib.metadata").version("bayes-damper")
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*__all__, "__version__", *(name for name in globals() if name.startswith("__"))})


sys.modules[__name__].__class__ = _Package
