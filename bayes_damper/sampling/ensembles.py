"""Runs several independent emcee ensembles until a rule is satisfied, with saved states, on one or more processes.

An ensemble goes through two phases. Warm-up: rounds of growing length until two rounds in succession look alike; after
each a mixture of Student t distributions is fitted to the draws of all ensembles, which from then on serves as an
independence proposal, as often as its acceptance earns it. Drawing: proposals are frozen and all steps count. Every
ensemble has its own generator spawned from the seed, and works in blocks that depend on nothing but its own state, so
results are the same for any number of processes, and a run that goes on from a saved state gives bit for bit what it
would have given without the stop.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import signal
import sys
import threading
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bayes_damper.errors import InputError, Interrupted
from bayes_damper.runs.checkpoint import Checkpoint
from bayes_damper.sampling.convergence import StoppingRule, Verdict, autocorrelation_time, judge, stranded_walkers
from bayes_damper.sampling.local_mixture import Nearby
from bayes_damper.sampling.moves import DifferentialEvolution, HalvesMove, Independence, Snooker, fit_mixture
from bayes_damper.sampling.normal_scores import InScores, NormalScores, normal_scores
from bayes_damper.sampling.start import Start, cloud

Array = NDArray[np.float64]

_FIRST_ROUND = 50  # steps
_LONGEST_WARM_UP = 4000  # steps
_TUNING = 200  # steps of warm-up after an annealed start
_TAUS = 6  # of the latest round, that such a warm-up takes at least: a sample may have too much or too little of a mode
_BLOCK = 25  # stored steps between two states
_FEWEST_STORED = 75
_CLOSE = 10.0  # autocorrelation time, steps, from which draws follow each other too closely for a good proposal
_FEW = 0.75  # of the autocorrelation times that a rule asks for, up to which it pays to begin anew
_LEARNT_FROM = 8000  # draws of a round, of all ensembles together
_OF_EACH = 2000  # of these
_EARNED = ((0.45, 0.9), (0.1, 0.7), (0.05, 0.45), (0.02, 0.15), (0.0, 0.03))
"""Weight of the learnt mixture in the mix of moves, by the least share of its draws that is accepted. Where nearly half
are, two draws of it are worth more than two steps of any other move: all but a tenth are then drawn from it.
"""
_ALL_BUT_SURE = 0.8  # weight of draws from the mixture from which on nothing else is needed
_MEMORY = 96e6  # bytes of draws kept before every second stored step is dropped


class Target(Protocol):
    """A log density of points (n, ndim) -> (n,), each value independent of which points come with it.

    A target may count how its simulations end, in a Counter `outcomes`.
    """

    @property
    def names(self) -> tuple[str, ...]:
        """One name for each coordinate."""

    @property
    def ndim(self) -> int:
        """Number of coordinates."""

    def __call__(self, points: Array) -> Array:
        """Log density of each point."""


@dataclass(frozen=True)
class Progress:
    """What a progress display gets: phase "warm-up" or "drawing", steps of each ensemble so far, part done of the
    phase (0..1), seconds since the start of this process's work, the latest verdict; and what is known before the
    first: tau, the autocorrelation time in steps that the warm-up lets expect (0 during it), and least, the steps after
    which that verdict comes.
    """

    phase: str
    steps: int
    part: float
    seconds: float
    verdict: Verdict | None
    tau: float = 0.0
    least: int = 0


@dataclass(frozen=True)
class Sampling:
    """Draws of independent ensembles and the verdict on them.

    draws : (ensembles, stored steps, walkers, ndim); log_prob : (ensembles, stored steps, walkers);
    acceptance : (ensembles,) share of accepted proposals; thin : steps for each stored one;
    warm_up : (ensembles,) steps; evaluations : of the target; undefined : how many of them were NaN (such points are
    never accepted);
    reseated : walkers that were stranded in the warm-up and moved to a better place; outcomes : how the target's
    simulations ended, where it says so, and how often.
    """

    names: tuple[str, ...]
    draws: Array
    log_prob: Array
    acceptance: Array
    thin: int
    warm_up: NDArray[np.int64]
    evaluations: int
    undefined: int
    reseated: int
    seed: int
    verdict: Verdict
    outcomes: Mapping[str, int] = field(default_factory=dict)

    @property
    def converged(self) -> bool:
        """Whether the stopping rule was met."""
        return self.verdict.converged

    def flat(self, count: int | None = None) -> Array:
        """All draws as (n, ndim), or `count` of them spread evenly over ensembles, steps and walkers."""
        points = self.draws.reshape(-1, self.draws.shape[-1])
        if count is None or count >= len(points):
            return points
        return points[np.linspace(0, len(points) - 1, count).round().astype(np.intp)]


@dataclass(frozen=True)
class _Ensemble:
    """State of one ensemble between two blocks."""

    coords: Array
    log_prob: Array
    random: dict[str, Any]
    steps: int = 0  # of the warm-up
    length: int = _FIRST_ROUND
    warm: bool = False
    weight: float = 0.0  # of the independence proposal
    annealed: bool = False  # began as a sample of the posterior: little to forget, proposals to tune
    shares: Array = field(default_factory=lambda: np.empty(0))  # of the mixture that was learnt
    centres: Array = field(default_factory=lambda: np.empty(0))
    spreads: Array = field(default_factory=lambda: np.empty(0))
    knots: Array = field(default_factory=lambda: np.empty(0))  # of the coordinates that it was learnt in, if others
    tau: float = 1.0  # what is to be expected of the draws
    last: Array = field(default_factory=lambda: np.empty(0))  # (2, ndim + 1): mean and standard deviation last round
    rounds: int = 0
    anew: int = 0  # draws that counted as warm-up when the mixture was last learnt from all of them, steps
    latest: Array = field(default_factory=lambda: np.empty(0))  # (n, ndim): draws of the last round of warm-up
    tried: int = 0
    taken: int = 0
    undefined: int = 0
    reseated: int = 0
    drawn: int = 0
    outcomes: dict[str, int] = field(default_factory=dict)  # of the target's simulations


_Advance = Callable[[list[tuple[_Ensemble, int]]], Iterable[Any]]
"""Takes ensembles on, each by a round (0) or by 25 stored steps of so many each; gives them one by one as they end."""


def sample(
    target: Target,
    start: Start,
    *,
    seed: int,
    ensembles: int = 4,
    walkers: int = 64,
    rule: StoppingRule | None = None,
    checkpoint: Checkpoint | None = None,
    progress: Callable[[Progress], None] | None = None,
    workers: int | Callable[[], int] = 1,
    monitor: Callable[[Array], Array] | None = None,
) -> Sampling:
    """Draws from `target` by emcee until the rule holds or its budget is spent; the verdict says which.

    walkers : of each ensemble, even, at least twice the number of coordinates (64 and 256 fill the kernel's lanes).
    checkpoint : goes on from the state it holds, if any, and saves into it every few seconds; rule, workers and
    progress may differ from those of the stopped run. workers : processes, the ensembles being their tasks; a function
    is asked before each block how many may be used now.

    Raises InputError for unusable arguments or another run's state, Interrupted after Ctrl-C (the state is saved).
    """
    rule = rule or StoppingRule()
    _check(target, start, ensembles, walkers)
    if checkpoint is not None:
        checkpoint = checkpoint.bound_to(_fingerprint(target, start, seed, ensembles, walkers))
    run = _Run(target, start, seed, ensembles, walkers, rule, checkpoint, progress, monitor)
    with _workers(target, workers if callable(workers) else lambda: workers, ensembles) as advance:
        try:
            run.warm_up(advance)
            run.draw(advance)
        except KeyboardInterrupt:
            run.save()
            where = f" in {checkpoint.folder}" if checkpoint is not None else ""
            raise Interrupted(
                f"Stopped by the user; the state is saved{where}."
                if where
                else "Stopped by the user; nothing is saved."
            ) from None
    return run.result()


class _Run:
    """The ensembles of one call of `sample`, their draws, and when to save and to stop."""

    def __init__(
        self,
        target: Target,
        start: Start,
        seed: int,
        ensembles: int,
        walkers: int,
        rule: StoppingRule,
        checkpoint: Checkpoint | None,
        progress: Callable[[Progress], None] | None,
        monitor: Callable[[Array], Array] | None,
    ) -> None:
        self.target, self.seed, self.rule = target, seed, rule
        self.monitor = monitor
        self.checkpoint, self.progress = checkpoint, progress
        self.walkers = walkers
        self.population = start.population.reshape(-1, target.ndim)
        self.thin = 0
        self.judged = 0
        self.verdict: Verdict | None = None
        self.begun = time.monotonic()
        self.done_here = 0
        self.capacity = 4 * _BLOCK * max(2, int(_MEMORY / (8 * ensembles * walkers * (target.ndim + 1)) / (4 * _BLOCK)))
        saved = checkpoint.load() if checkpoint is not None else None
        if saved is None:
            learnt = _learnt(start.population) if len(start.population) else {}
            self.states = [_begin(target, start, seed, e, walkers, learnt) for e in range(ensembles)]
            self.draws = np.empty((ensembles, 0, walkers, target.ndim))
            self.log_prob = np.empty((ensembles, 0, walkers))
        else:
            self._restore(*saved)

    def warm_up(self, advance: _Advance) -> None:
        """Runs warm-up rounds, each ensemble its own number, until all are warm; then fixes the common thinning."""
        while not all(s.warm for s in self.states):
            cold = [i for i, s in enumerate(self.states) if not s.warm]
            least = min(self.states[i].rounds for i in cold)
            if all(s.rounds <= least for s in self.states):
                self._share()
            else:  # a stopped run goes on in the midst of a round
                cold = [i for i in cold if self.states[i].rounds == least]
            for i, (state, _, _) in zip(cold, advance([(self.states[i], 0) for i in cold]), strict=True):
                self.states[i] = state
                ahead = sum(_warm_up_ahead(s) for s in self.states)
                done = sum(s.steps for s in self.states)
                self._announce("warm-up", max(s.steps for s in self.states), done / (done + ahead))
                self._save_if_due()
        if self.thin == 0:
            self._share()
            most = max(s.weight for s in self.states)
            self.states = [replace(s, weight=most, latest=np.empty(0)) for s in self.states]
            # The fewest draws that can be judged come no later than the rule asks for draws.
            share = min(1.0 / 8.0, self.rule.taus / _FEWEST_STORED)
            self.thin = max(1, int(share * max(s.tau for s in self.states)))

    def _share(self) -> None:
        """Gives all ensembles the mixture that the start's sample and the latest draws of all together show.

        What one of them has not found yet, or knows by few draws, another one may know: a proposal that is seldom made
        where the target is high leaves walkers there for long.
        """
        latest = [s.latest for s in self.states if s.latest.size]
        if latest:
            self._learn(np.concatenate([self.population, *latest]))

    def _learn(self, draws: Array) -> None:
        """Gives all ensembles the mixture that draws (n, ndim) show."""
        learnt = _learnt(draws[:: max(1, len(draws) // _LEARNT_FROM)])
        self.states = [replace(s, **learnt) for s in self.states]

    def _begin_anew(self) -> None:
        """Counts the draws so far, which are far from enough, as warm-up: their proposal knew less than they do."""
        every = max(1, self.draws[0, ..., 0].size // _OF_EACH)
        self._learn(self.draws[:, ::every].reshape(-1, self.target.ndim))
        self.states = [
            replace(s, steps=s.steps + s.drawn, drawn=0, tried=0, taken=0, anew=s.drawn) for s in self.states
        ]
        self.draws, self.log_prob = self.draws[:, :0], self.log_prob[:, :0]
        self.thin, self.judged, self.verdict = 1, 0, None

    def _drawn_poorly(self) -> bool:
        """Whether the draws, just judged, follow each other closely and are fewer than a rule asks for.

        They must be twice as many as those from which the mixture was learnt, so that it has more to learn. All that
        count as warm-up in the end are then at most twice those of the last time, and half of the steps allowed.
        """
        verdict = self.verdict
        if verdict is None or self.judged != self.draws.shape[1] * self.thin or verdict.steps < 2 * self.states[0].anew:
            return False
        tau = float(verdict.tau.max())
        return tau >= _CLOSE and verdict.steps <= min(_FEW * self.rule.taus * tau, self.rule.max_steps / 4)

    def draw(self, advance: _Advance) -> None:
        """Draws block by block until the rule holds or the budget is spent."""
        if self.judged > 0 and self.judged == self.draws.shape[1] * self.thin:
            self._judge()  # finished, perhaps under a new rule; elsewhere an early look would change the end
        while not self._finished():
            if self._drawn_poorly():
                self._begin_anew()
            parts = list(advance([(s, self.thin) for s in self.states]))
            self.states = [p[0] for p in parts]
            self.draws = np.concatenate([self.draws, np.stack([p[1] for p in parts])], axis=1)
            self.log_prob = np.concatenate([self.log_prob, np.stack([p[2] for p in parts])], axis=1)
            self.done_here += _BLOCK * self.thin
            if self.draws.shape[1] >= self.capacity:
                self.draws, self.log_prob = self.draws[:, 1::2].copy(), self.log_prob[:, 1::2].copy()
                self.thin *= 2
            steps = self.draws.shape[1] * self.thin
            if self.draws.shape[1] >= _FEWEST_STORED and steps >= 1.2 * self.judged:
                self._judge()
            self._announce("drawing", steps, min(1.0, self._part()))
            self._save_if_due()
        if self.verdict is None or self.judged != self.draws.shape[1] * self.thin:
            self._judge()
        self.save()

    def save(self) -> None:
        """Writes the state, where a checkpoint was asked for."""
        if self.checkpoint is None:
            return
        arrays: dict[str, NDArray[Any]] = {"draws": self.draws, "log_prob": self.log_prob}
        records = []
        for i, state in enumerate(self.states):
            record = {}
            for name, value in vars(state).items():
                if isinstance(value, np.ndarray):
                    arrays[f"{i}.{name}"] = value
                elif name == "random":
                    arrays[f"{i}.random"] = value["key"]
                    record["random"] = {k: v for k, v in value.items() if k != "key"}
                else:
                    record[name] = value
            records.append(record)
        self.checkpoint.save(arrays, {"thin": self.thin, "judged": self.judged, "ensembles": records})

    def result(self) -> Sampling:
        """What was drawn, with the verdict."""
        assert self.verdict is not None
        tried = np.array([s.tried for s in self.states])
        taken = np.array([s.taken for s in self.states])
        verdict = self.verdict
        undefined = sum(s.undefined for s in self.states)
        if undefined:
            more = f"At {undefined} of the points tried the posterior was not a number; none was accepted."
            verdict = replace(verdict, sentences=(*verdict.sentences, more))
        return Sampling(
            names=tuple(self.target.names),
            draws=self.draws,
            log_prob=self.log_prob,
            acceptance=taken / np.maximum(tried, 1),
            thin=self.thin,
            warm_up=np.array([s.steps for s in self.states]),
            evaluations=sum((s.steps + s.drawn) * self.walkers for s in self.states),
            undefined=undefined,
            reseated=sum(s.reseated for s in self.states),
            seed=self.seed,
            verdict=verdict,
            outcomes=dict(sum((Counter(s.outcomes) for s in self.states), Counter())),
        )

    def _restore(self, arrays: dict[str, NDArray[Any]], record: dict[str, Any]) -> None:
        self.thin, self.judged = int(record["thin"]), int(record["judged"])
        self.draws, self.log_prob = arrays["draws"], arrays["log_prob"]
        self.states = []
        for i, values in enumerate(record["ensembles"]):
            own: dict[str, Any] = {n.split(".", 1)[1]: a for n, a in arrays.items() if n.startswith(f"{i}.")}
            random = {**values.pop("random"), "key": own.pop("random")}
            self.states.append(_Ensemble(**values, **own, random=random))

    def _judge(self) -> None:
        pace = (time.monotonic() - self.begun) / self.done_here if self.done_here else 0.0
        draws = self.draws
        if self.monitor is not None:
            draws = self.monitor(draws.reshape(-1, self.target.ndim)).reshape(draws.shape)
        self.verdict = judge(tuple(self.target.names), draws, self.log_prob, self.thin, self.rule, pace)
        self.judged = self.draws.shape[1] * self.thin

    def _finished(self) -> bool:
        if self.verdict is not None and self.verdict.converged:
            return True
        if self.draws.shape[1] < _FEWEST_STORED:
            return False  # too few to judge, whatever the budget
        if self.draws.shape[1] * self.thin >= self.rule.max_steps:
            return True
        limit = self.rule.max_seconds
        return limit is not None and time.monotonic() - self.begun > limit

    def _part(self) -> float:
        verdict, rule = self.verdict, self.rule
        if verdict is None or not np.all(np.isfinite(verdict.tau)):
            return 0.0
        least = min(verdict.ess_bulk.min(), verdict.ess_tail.min()) / rule.ess
        return float(min(least, verdict.steps / (rule.taus * verdict.tau.max())))

    def _announce(self, phase: str, steps: int, part: float) -> None:
        if self.progress is not None:
            tau = max(s.tau for s in self.states) if self.thin else 0.0
            seconds = time.monotonic() - self.begun
            self.progress(Progress(phase, steps, part, seconds, self.verdict, tau, self.thin * _FEWEST_STORED))

    def _save_if_due(self) -> None:
        if self.checkpoint is not None and self.checkpoint.due():
            self.save()


def _learnt(draws: Array) -> dict[str, Any]:
    """What a state holds of the mixture that draws (n, ndim) show, in normal scores where that is worth it."""
    through = normal_scores(draws)
    shares, centres, spreads = fit_mixture(draws if through is None else through.scores(draws)[0])
    spreads = spreads + np.eye(draws.shape[1]) * 1e-300
    knots = np.empty(0) if through is None else through.knots
    return {"shares": shares, "centres": centres, "spreads": spreads, "knots": knots}


def _begin(target: Target, start: Start, seed: int, ensemble: int, walkers: int, learnt: dict[str, Any]) -> _Ensemble:
    """An ensemble at its start, with a generator of its own; `learnt`: of a mixture like the target, if any."""
    child = np.random.SeedSequence(seed).spawn(ensemble + 1)[ensemble]
    coords, log_prob = cloud(target, start, walkers, np.random.default_rng(child))
    random = np.random.RandomState(np.random.MT19937(child.spawn(1)[0])).get_state(legacy=True)
    state = _Ensemble(coords, log_prob, _packed(random))
    return replace(state, annealed=True, weight=0.3, **learnt) if learnt else state


def _advance(target: Target, state: _Ensemble, thin: int) -> tuple[_Ensemble, Array, Array]:
    """One block of an ensemble: a round of warm-up (thin = 0) or 25 stored steps, with the draws of the latter."""
    moves = _moves(state)
    before = Counter(getattr(target, "outcomes", {}))
    import emcee  # slow to load, and a diagnosis draws nothing

    sampler = emcee.EnsembleSampler(len(state.coords), target.ndim, target, moves=moves, vectorize=True)
    sampler.log_prob_fn = target  # emcee's own wrapper prints all points when Ctrl-C comes
    begin = emcee.State(state.coords, log_prob=state.log_prob, random_state=_unpacked(state.random))
    steps = _BLOCK if thin else state.length
    end = sampler.run_mcmc(begin, steps, thin_by=max(thin, 1), skip_initial_state_check=True)
    chain, heights = sampler.get_chain(), sampler.get_log_prob()
    counts = [m for m, _ in moves]
    ended = Counter(getattr(target, "outcomes", {})) - before + Counter(state.outcomes)
    state = replace(
        state,
        outcomes=dict(sorted(ended.items())),
        coords=end.coords,
        log_prob=end.log_prob,
        random=_packed(end.random_state),
        undefined=state.undefined + sum(m.undefined for m in counts),
    )
    if thin:
        tried, taken = sum(m.tried for m in counts), sum(m.taken for m in counts)
        return (
            replace(state, tried=state.tried + tried, taken=state.taken + taken, drawn=state.drawn + steps * thin),
            chain,
            heights,
        )
    return _after_round(state, chain, heights, counts), chain[:0], heights[:0]


def _after_round(state: _Ensemble, chain: Array, heights: Array, moves: list[HalvesMove]) -> _Ensemble:
    """What a round of warm-up shows: stranded walkers, what the proposal is worth, whether it was the last round."""
    ndim = chain.shape[2]
    steps = state.steps + len(chain)
    coords, log_prob = state.coords.copy(), state.log_prob.copy()
    lost = [w for _, w in stranded_walkers(heights[None, len(heights) // 2 :])]
    fine = np.setdiff1d(np.arange(len(coords)), lost)
    for walker, other in zip(lost, fine, strict=False):
        coords[walker], log_prob[walker] = coords[other], log_prob[other]
    flat = np.column_stack([chain[:, fine].reshape(-1, ndim), heights[:, fine].reshape(-1)])
    figures = np.stack([flat.mean(axis=0), flat.std(axis=0)])
    tau = max(float(np.nanmax(autocorrelation_time(chain[None, ..., i]))) for i in range(ndim))
    weight, ahead = state.weight, tau
    if weight > 0:
        own = moves[-1]
        share = own.taken / max(own.tried, 1)
        weight = next(given for least, given in _EARNED if share >= least)
        if weight > _ALL_BUT_SURE:  # most of this round's steps were of the other moves, which take longer
            ahead = min(tau, 3.0 / share)
    elif state.last.size:
        weight = 0.3
    alike = state.last.size > 0 and _alike(state.last, figures)
    settled = steps >= max(_tuning(weight), _TAUS * ahead) if state.annealed else alike and len(chain) >= 3 * tau
    warm = (settled and state.weight > 0 and not lost) or steps >= _LONGEST_WARM_UP
    if state.annealed:  # beside its independent members draws count by what they are worth
        latest = flat[:: math.ceil(tau), :ndim]
    else:  # all walkers, at steps far apart: every fourth or sixteenth of all draws would be of the same few walkers
        latest = chain[:: -max(1, len(flat) // _OF_EACH), fine].reshape(-1, ndim)
    return replace(
        state,
        coords=coords,
        log_prob=log_prob,
        steps=steps,
        length=max(_FIRST_ROUND, steps // 2),
        warm=bool(warm),
        weight=weight,
        tau=ahead,
        last=figures,
        rounds=state.rounds + 1,
        latest=latest,
        reseated=state.reseated + len(lost),
    )


def _tuning(weight: float) -> float:
    """Steps of warm-up of an ensemble that began as a sample: a proposal often accepted has no more to learn."""
    return _TUNING / 4 if weight >= 0.7 else _TUNING


def _warm_up_ahead(state: _Ensemble) -> float:
    """Steps of warm-up that an ensemble still has before it, as far as can be foreseen: a round or more."""
    if state.warm:
        return 0.0
    if state.annealed:
        return max(state.length, _tuning(state.weight if state.steps else 1.0) - state.steps)
    return max(state.length, 3 * _FIRST_ROUND - state.steps)  # two alike, and one with what they taught


def _alike(before: Array, after: Array) -> bool:
    """Whether means and spreads of two rounds differ by less than they would by chance in a short round."""
    width = np.maximum(np.maximum(before[1], after[1]), 1e-300)
    return bool(
        np.all(np.abs(after[0] - before[0]) < 0.3 * width) and np.all(np.abs(after[1] - before[1]) < 0.3 * width)
    )


def _moves(state: _Ensemble) -> list[tuple[HalvesMove, float]]:
    """The mix of moves: differential evolution, its mode-jumping variant, snooker, and what was learnt.

    Draws of the learnt mixture come last; where they are seldom accepted, half of their weight goes to steps within it.
    """
    rest = 1.0 - state.weight
    mix: list[tuple[HalvesMove, float]] = [
        (DifferentialEvolution(spread=0.3), 0.7 * rest),
        (DifferentialEvolution(1.0, spread=1e-3), 0.1 * rest),
        (Snooker(), 0.2 * rest),
    ]
    if state.weight > 0:
        learnt = (state.shares, state.centres, state.spreads)
        near = 0.0 if state.weight > _ALL_BUT_SURE else 0.5 * state.weight
        of_mixture: list[tuple[HalvesMove, float]] = [(Nearby(*learnt), near)] if near > 0 else []
        of_mixture.append((Independence(*learnt), state.weight - near))
        if state.knots.size:
            through = NormalScores(state.knots)
            of_mixture = [(InScores(move, through), share) for move, share in of_mixture]
        mix += of_mixture
    return mix


def _packed(state: Any) -> dict[str, Any]:  # numpy's legacy tuple
    """The legacy state tuple with plain Python numbers, so that it goes through JSON unharmed."""
    return {"key": state[1].copy(), "position": int(state[2]), "has_gauss": int(state[3]), "gauss": float(state[4])}


def _unpacked(random: dict[str, Any]) -> tuple[str, NDArray[np.uint32], int, int, float]:
    return ("MT19937", random["key"], random["position"], random["has_gauss"], random["gauss"])


def _check(target: Target, start: Start, ensembles: int, walkers: int) -> None:
    faults = []
    if walkers % 2 or walkers < 2 * target.ndim or walkers < 8:
        least = max(8, 2 * target.ndim)
        faults.append(
            f"{walkers} walkers: an ensemble in {target.ndim} dimensions needs an even number, at least {least}."
        )
    if ensembles < 1:
        faults.append(f"{ensembles} ensembles: at least one is needed, and two or more for R-hat.")
    if len(start.point) != target.ndim:
        faults.append(f"The start has {len(start.point)} coordinates, the posterior {target.ndim}.")
    if faults:
        raise InputError(faults)


def _fingerprint(target: Target, start: Start, seed: int, ensembles: int, walkers: int) -> dict[str, str]:
    import hashlib

    shape = np.concatenate([start.point, start.covariance.ravel()])
    return {
        "parameters": ", ".join(target.names),
        "seed": str(seed),
        "ensembles": str(ensembles),
        "walkers": str(walkers),
        "starting point": hashlib.sha256(np.ascontiguousarray(shape).tobytes()).hexdigest()[:16],
    }


# --- processes ------------------------------------------------------------------------------------------------------

_TARGET: list[Target] = []  # in a worker process: the target, received once


@contextmanager
def _workers(target: Target, count: Callable[[], int], most: int) -> Iterator[_Advance]:
    """A function that advances ensembles, in this process or, as soon as `count` allows several, spread over others, as
    many as are allowed then, `most` at most.
    """
    pools: list[ProcessPoolExecutor] = []

    def advance(tasks: list[tuple[_Ensemble, int]]) -> Iterator[Any]:
        # The workers of a cluster are daemons and may have no children.
        processes = 1 if multiprocessing.current_process().daemon else min(count(), most)
        if not pools and processes > 1:
            # A fork hands compiled kernels over as they are; where there is none the target has to be picklable.
            context = multiprocessing.get_context("fork" if sys.platform.startswith("linux") else "spawn")
            given = (target, os.getpid())
            pools.append(ProcessPoolExecutor(processes, mp_context=context, initializer=_receive, initargs=given))
        if not pools:
            return (_advance(target, state, thin) for state, thin in tasks)
        with warnings.catch_warnings():
            # Threads beside us only wait for a signal or for the end of a process: they hold no lock.
            warnings.filterwarnings("ignore", ".*fork.*", DeprecationWarning)
            return pools[0].map(_advance_here, tasks)

    try:
        yield advance
    finally:
        for pool in pools:
            pool.shutdown(cancel_futures=True)


def _receive(target: Target, parent: int) -> None:
    """In a worker: Ctrl-C and the like are the parent's business; when that is gone, so is the worker."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    _TARGET[:] = [target]


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def _advance_here(task: tuple[_Ensemble, int]) -> tuple[_Ensemble, Array, Array]:
    return _advance(_TARGET[0], *task)
