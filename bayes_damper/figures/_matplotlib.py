"""Imports matplotlib without the settings of the folder in which a command runs."""

from __future__ import annotations

from bayes_damper.runs.surroundings import unsteered

unsteered("matplotlib")
