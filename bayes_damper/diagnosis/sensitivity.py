"""How far a verdict hangs on choices: prior widths halved and doubled, one case or one trial left out.

Each model is taken as quadratic about its best fit, in its parameters and in the nuisances of each trial,

    cost(q) = (q + dq)' P (q + dq) + sum_j [c_j + 2 b_j' dq + dq' A_j dq],

with every trial's own nuisances eliminated from its A_j, b_j, c_j; so a choice costs no simulation. Only where leaving
trials out changes the verdict the fits concerned are made again. P is 1 over the square of the factor on the prior
widths; a trial left out loses its term. A formula has the evidence of its fit and the change of its quadratic, so one
whose fit failed stays behind. What each answer leaves unexplained is taken from the verdict on all trials: an answer
far ahead of the others has the same probability under every choice.
Where no trial has repeats each set of effects is weighed under what it leaves itself (sets.py), which differs from set
to set and from choice to choice, so the likely sets are fitted again without the trials that are left out.
Nothing in a diagnosis is drawn at random but the bootstrap of the interval of the share closed, so another seed gives
the same verdict.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from bayes_damper.calibration import Calibration, TrialRecord, calibrate
from bayes_damper.diagnosis.sets import SetFit, log_weight, set_fit, weighed
from bayes_damper.diagnosis.verdict import Answers
from bayes_damper.runs.contents.diagnosis import ChoiceEntry
from bayes_damper.text import counted

Array = NDArray[np.float64]

MOST_REFITS, REFIT_STEPS = 4, 12
NEGLIGIBLE = 0.01  # nats
MOST_TRIALS = 40  # beyond, only cases are left out one by one
MOST_SETS, MOST_TRIALS_REFITTED = 4, 6  # where every choice is fitted again


@dataclass(frozen=True)
class Choice:
    """A choice that could have been made otherwise, and the verdict that follows.

    probability: of that verdict; of_leading: what the verdict on all data keeps.
    """

    what: str
    verdict: str
    probability: float
    of_leading: float

    def to_json(self) -> ChoiceEntry:
        """Plain numbers."""
        return {
            "choice": self.what, "verdict": self.verdict, "probability": self.probability,
            "probability_of_the_leading_answer": self.of_leading,
        }  # fmt: skip


@dataclass(frozen=True, eq=False)
class Quadratic:
    """A fit as a quadratic in q, trial by trial: A (trials, size, size), b (trials, size), c (trials,).

    log_det (trials,): of each trial's nuisances; scaled (size,): whether a coordinate's prior may be widened, which
    constants declared with a standard deviation may not.
    """

    trials: tuple[int, ...]
    q: Array
    A: Array
    b: Array
    c: Array
    log_det: Array
    scaled: NDArray[np.bool_]

    @classmethod
    def of(cls, fit: Calibration) -> Quadratic:
        """From the linearised problem at the best fit."""
        rows: list[tuple[int, Array, Array, float, float]] = []
        p = fit.problem.size
        for block in fit.linear.blocks:
            full = block.full
            gram = np.matmul(full, full.transpose(0, 2, 1))
            m = block.eta.shape[1]
            for k, i in enumerate(block.group.trials):
                g = gram[k]
                A, b, c = g[:p, :p], g[:p, -1], float(g[-1, -1] + block.eta[k] @ block.eta[k])
                log_det = 0.0
                if m:
                    H = g[p : p + m, p : p + m] + np.eye(m)
                    own = g[p : p + m, -1] + block.eta[k]
                    solved = np.linalg.solve(H, np.column_stack([g[p : p + m, :p], own]))
                    A = A - g[p : p + m, :p].T @ solved[:, :p]
                    b = b - g[p : p + m, :p].T @ solved[:, p]
                    c -= float(own @ solved[:, p])
                    log_det = float(np.linalg.slogdet(H)[1])
                rows.append((i, A, b, c, log_det))
        return cls(
            tuple(r[0] for r in rows), fit.q, np.array([r[1] for r in rows]), np.array([r[2] for r in rows]),
            np.array([r[3] for r in rows]), np.array([r[4] for r in rows]),
            np.array([c.role in ("nominal", "effect") for c in fit.problem.coordinates]),
        )  # fmt: skip

    def log_evidence(self, without: Collection[int] = (), widths: float = 1.0) -> float:
        """Laplace evidence without some trials, under prior widths times a factor; -inf where it does not exist."""
        keep = np.array([i not in without for i in self.trials])
        precision = np.where(self.scaled, 1.0 / widths**2, 1.0)
        S = np.diag(precision) + self.A[keep].sum(axis=0)
        g = precision * self.q + self.b[keep].sum(axis=0)
        cost = float(precision @ self.q**2) + float(self.c[keep].sum())
        sign, log_det = np.linalg.slogdet(S)
        if sign <= 0 or not math.isfinite(log_det):
            return -math.inf
        cost -= float(g @ np.linalg.solve(S, g))
        total = cost + log_det - float(np.sum(np.log(precision))) + float(self.log_det[keep].sum())
        return -0.5 * total if math.isfinite(total) else -math.inf


def refitted(fit: Calibration, without: Collection[int]) -> float:
    """Laplace evidence of a fit made again without some trials."""
    return _again(fit, without).log_evidence


def _again(fit: Calibration, without: Collection[int], straight: bool = False) -> Calibration:
    problem = fit.problem.for_trials([i for i in fit.problem.trials if i not in without])
    keep = [fit.problem.names.index(n) for n in problem.names]
    eta = {i: v for i, v in fit.eta.items() if i not in without}
    return calibrate(problem, [fit.q[keep]], eta=eta, anneal=False, most=REFIT_STEPS, straight=straight)


def _other_choices(fit: Calibration, most: int) -> list[tuple[str, Collection[int], float]]:
    """What could have been chosen otherwise: words, trials left out, factor on prior widths; trials up to `most`."""
    choices: list[tuple[str, Collection[int], float]] = [
        ("prior widths halved", (), 0.5), ("prior widths doubled", (), 2.0),
    ]  # fmt: skip
    experiment, trials = fit.problem.experiment, fit.problem.trials
    cases = list(dict.fromkeys(experiment.trials[i].case for i in trials))
    of_case = {case: [i for i in trials if experiment.trials[i].case == case] for case in cases}
    if len(cases) > 1:
        choices += [(f"without case {case}", of_case[case], 1.0) for case in cases]
    if 1 < len(trials) <= most:
        # A case of one trial has been left out already.
        alone = {those[0] for those in of_case.values() if len(those) == 1} if len(cases) > 1 else set()
        choices += [(f"without {_named(experiment.trials[i])}", [i], 1.0) for i in sorted(trials) if i not in alone]
    return choices


def sensitivity_of_sets(
    nominal: Calibration, sets: Sequence[SetFit], answered: Callable[[Sequence[SetFit]], Answers], leading: str,
    offered: int,
) -> list[Choice]:  # fmt: skip
    """The verdict under every other choice, where no trial has repeats.

    sets : weighed, the nominal model among them; answered : gives the answers from weighed sets; leading : the verdict
    on all data; offered : effects that the rig can have. Where trials are left out the most probable sets are fitted
    and weighed again, without the others. Each set's evidence changes by what weighing it again among them changes.
    """
    none = next(s for s in sets if not s.members)
    possible = [s for s in sets if math.isfinite(s.evidence)]
    likely = sorted(possible, key=lambda s: -log_weight(s, offered))[:MOST_SETS]
    likely += [] if none in likely else [none]
    quadratic = [Quadratic.of(s.fit) for s in possible]
    out = []
    for what, without, widths in _other_choices(nominal, MOST_TRIALS_REFITTED):
        if without:
            changed = [set_fit(s.members, _again(s.fit, without, straight=True)) for s in likely]
        else:
            changed = [
                replace(s, plain=s.plain + (q.log_evidence(widths=widths) - q.log_evidence()))
                for s, q in zip(possible, quadratic, strict=True)
            ]
        if not all(math.isfinite(s.plain) for s in changed if not s.members):
            continue
        p = (answers := answered(_moved(likely if without else possible, changed))).probabilities
        out.append(Choice(what, answers.verdict, p[answers.verdict], p[leading]))
    return out


def _moved(sets: Sequence[SetFit], changed: Sequence[SetFit]) -> list[SetFit]:
    """The changed sets, best first, with the evidence of `sets` and what weighing them again changes."""
    known = {id(s.members): s.evidence for s in sets}
    before = {id(s.members): s.evidence for s in weighed(sets)}
    moved = [replace(s, evidence=known[id(s.members)] + (s.evidence - before[id(s.members)])) for s in weighed(changed)]
    return sorted(moved, key=lambda s: -s.evidence)


def sensitivity(
    nominal: Calibration,
    fits: Mapping[str, Sequence[Calibration]],
    judge: Callable[[Mapping[str, float], Mapping[str, float]], Answers],
    leading: str,
    evidence: Mapping[str, float],
    pairs: Mapping[str, Calibration] | None = None,
) -> list[Choice]:
    """The verdict under every other choice.

    fits : family -> its fitted formulas; pairs : label -> fit of two effects at once; judge : gives the answers from
    the change of each family's and pair's log evidence over the nominal model; leading : the verdict on all data;
    evidence : family -> log Z over the nominal model, on all data: those that may be named.
    """
    base, noise = Quadratic.of(nominal), nominal.problem.noise
    # Answers far behind keep the noise of the first fits: they stay behind, but their evidence cannot be carried over.
    known = {
        name: [
            (f, q, z) for f in each
            if f.problem.noise == noise and math.isfinite(z := (q := Quadratic.of(f)).log_evidence())
        ]
        for name, each in fits.items()
    }  # fmt: skip
    # Nor can that which a family owes to a formula that was only screened, where the fits of its others failed.
    known = {
        name: each for name, each in known.items()
        if each and logsumexp([f.log_evidence for f, _, _ in each]) > evidence[name] + nominal.log_evidence - NEGLIGIBLE
    }  # fmt: skip
    both = {label: Quadratic.of(f) for label, f in (pairs or {}).items()}
    choices = _other_choices(nominal, MOST_TRIALS)

    out = []
    again = 0
    for what, without, widths in choices:
        # Quadratics are compared with quadratics, refits with fits: of one that a bound stops the two differ.
        shift = base.log_evidence(without, widths) - base.log_evidence()
        changes = dict.fromkeys(evidence, -math.inf) if without else {}
        for name, each in known.items():
            moved = [f.log_evidence + (q.log_evidence(without, widths) - z) for f, q, z in each]
            changes[name] = float(logsumexp(moved) - logsumexp([f.log_evidence for f, _, _ in each]) - shift)
        of_pairs = {k: q.log_evidence(without, widths) - q.log_evidence() - shift for k, q in both.items()}
        answers = judge(changes, of_pairs)
        for _ in range(2):
            if answers.verdict == leading or not without or again >= MOST_REFITS:
                break
            # The quadratic may have been carried too far: ask fits that are made again without these trials.
            again += 1
            zero = refitted(nominal, without) - nominal.log_evidence
            strongest = max(changes, key=lambda name: evidence[name] + changes[name])  # which may speak for `unknown`
            for name in {leading, answers.verdict, strongest} & set(known):
                best = max((f for f, _, _ in known[name]), key=lambda f: f.log_evidence)
                changes[name] = refitted(best, without) - best.log_evidence - zero
            answers = judge(changes, of_pairs)
        p = answers.probabilities
        out.append(Choice(what, answers.verdict, p[answers.verdict], p[leading]))
    return out


def _named(trial: TrialRecord) -> str:
    configuration = "coupled" if trial.coupled else "uncoupled"
    return f"trial {trial.number} of case {trial.case}, {configuration}"


def in_a_sentence(choices: Sequence[Choice], leading: str) -> str:
    """What the choices change, for the reader of a verdict."""
    other = [c for c in choices if c.verdict != leading]
    if not choices:
        return "There is nothing to leave out, so how far the verdict depends on a single trial is not known."
    if not other:
        tried = "the one other choice" if len(choices) == 1 else f"all {len(choices)} other choices"
        return f"The verdict is the same under {tried} tried (other priors, a case or a trial left out)."
    changes = "; ".join(f"{c.what}: {c.verdict} ({c.probability:.2f})" for c in other[:4])
    more = f", and {len(other) - 4} more" if len(other) > 4 else ""
    return f"The verdict changes under {len(other)} of {counted(len(choices), 'other choice')}: {changes}{more}."
