"""Bugs planted in the fit, never in the campaign: each must show in the ranks.

A bug is a context in which the fit runs (`fault`), or what the fit takes the campaign for (`mistake`). The fits are
those without allowance for release and reversals, whose likelihood is that of the campaigns (calibrated.py).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
from calibrated import recorded, without_allowance
from synthetic import FAINT

from bayes_damper.calibration import Experiment, Problem
from bayes_damper.calibration.posterior import RecordPosterior
from bayes_damper.sampling import ensembles
from bayes_damper.sampling.moves import Snooker

Fault = Callable[[], AbstractContextManager[Any]]


@dataclass(frozen=True)
class Bug:
    """One planted bug; kind : of the campaigns on which it is looked for."""

    name: str
    kind: str
    fault: Fault = nullcontext
    mistake: Callable[[Experiment], Experiment] = lambda e: e

    weights: bool = True
    """Whether draws by weights will do; a bug of the sampler shows in its own draws only."""

    @property
    def task(self) -> Callable[[int], dict[str, Any]]:
        """One campaign, fitted with the bug: by number, its ranks."""
        return partial(recorded, self.kind, fault=self.planted, mistake=self.mistake, weights=self.weights)

    @contextmanager
    def planted(self) -> Iterator[None]:
        """The fit with the bug, and without allowance."""
        with ExitStack() as stack:
            stack.enter_context(without_allowance())
            stack.enter_context(self.fault())
            yield


def _rig(change: Callable[[dict[str, Any]], dict[str, Any]]) -> Fault:
    """The fit simulates a rig whose parameters are changed on the way to the simulation."""
    genuine = Problem._inputs

    def inputs(self, *arguments):
        rig, effect = genuine(self, *arguments)
        return rig | change(rig), effect

    return lambda: mock.patch.object(Problem, "_inputs", inputs)


@contextmanager
def _readings_halved() -> Iterator[None]:
    genuine = RecordPosterior.__init__

    def init(self, *arguments, **named):
        genuine(self, *arguments, **named)
        self.parts = tuple(replace(part, readings=0.5 * part.readings) for part in self.parts)

    with mock.patch.object(RecordPosterior, "__init__", init):
        yield


@contextmanager
def _prior_twice() -> Iterator[None]:
    genuine = RecordPosterior.log_prior
    with mock.patch.object(RecordPosterior, "log_prior", lambda self, points: 2.0 * genuine(self, points)):
        yield


@contextmanager
def _nothing_learnt() -> Iterator[None]:
    """The moves of a sampler that has learnt no proposals yet: a fifth of them are snooker moves, not one in fifty."""
    moves = ensembles._moves(SimpleNamespace(weight=0.0))
    with mock.patch.object(ensembles, "_moves", return_value=moves):
        yield


@contextmanager
def _snooker_without_its_factor() -> Iterator[None]:
    genuine = Snooker.proposal
    with _nothing_learnt(), mock.patch.object(Snooker, "proposal", lambda self, *a: (genuine(self, *a)[0], 0.0)):
        yield


def _angles(factor: float) -> Callable[[Experiment], Experiment]:
    """Standard uncertainties of the release angles times a factor."""
    return lambda e: replace(e, trials=tuple(replace(t, theta0_sd=factor * t.theta0_sd) for t in e.trials))


def _without_the_last(e: Experiment) -> Experiment:
    return replace(e, trials=(*e.trials[:-1], replace(e.trials[-1], heldout=True)))


def _swapped(e: Experiment) -> Experiment:
    return replace(e, trials=tuple(replace(t, y=t.y[::-1].copy()) for t in e.trials))


BUGS = (
    Bug("wrong sign of the drag", "lone", _rig(lambda rig: {"drag": -rig["drag"]})),
    Bug("R in place of r in the pull", "lone", _rig(lambda rig: {"r": rig["R"]})),
    Bug("friction torque without the lever R", "lone", _rig(lambda rig: {"mu": rig["mu"] / 0.1})),
    Bug("constant pull in place of the linear law", "lone", mistake=lambda e: replace(e, normal_force="constant")),
    Bug("c1t and c3t swapped", "lone", _rig(lambda rig: {"c1t": rig["c3t"], "c3t": rig["c1t"]})),
    Bug("k1t of another case", "lone", mistake=lambda e: replace(e, stiffnesses=((6.2, 0.1),))),
    Bug("noise normalisation: half of the readings counted", "lone", _readings_halved),
    Bug("prior counted twice", FAINT, _prior_twice),
    Bug("snooker move without its volume factor, nothing learnt", "lone", _snooker_without_its_factor, weights=False),
    Bug("a trial lost", "repeats", mistake=_without_the_last),
    Bug("channels swapped", "repeats", mistake=_swapped),
    Bug("wrong sign of the delay", "repeats", _rig(lambda rig: {"delay": -np.asarray(rig["delay"])})),
    Bug("release angle taken as exact", "repeats", mistake=_angles(1e-9)),
    Bug("degrees for radians in the angle's uncertainty", FAINT, mistake=_angles(180.0 / math.pi)),
)
SOUND = (
    *(Bug(f"none, {kind}", kind) for kind in ("lone", FAINT, "repeats")),
    Bug("none, nothing learnt", "lone", _nothing_learnt, weights=False),
)
