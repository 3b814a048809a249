"""Parameters that differ from case to case.

Another spring brings its own losses: at the same loss factor the viscous constant goes with sqrt(k1t J1), and what
clamps it changes too. Where all trials share one c1t, an effect of the bearings or of the spring takes its place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

from bayes_damper.calibration.experiment import repeats
from bayes_damper.calibration.least_squares import Calibration, calibrate
from bayes_damper.calibration.own_values import COUPLED_ONLY, RELATIVE, nuisance
from bayes_damper.calibration.scatter import without_repeats

Array = NDArray[np.float64]

DAMPING = "c1t"
SHOWS_FROM = 3.0  # nats of evidence: odds of 20
SURE = 1e-3  # by chance, in any of the parameters that are looked at
UNUSUAL = 2.0  # times the size of a scatter that is expected, beyond which its interval shows something else


def with_own_in_each_case(fit: Calibration, name: str, target: float = -math.inf) -> Calibration | None:
    """The fit with a value of that parameter for each case; None where it is no free number that cases share.

    target : a cost that another model has reached, as in `calibrate`.
    """
    problem = fit.problem
    if name not in problem.names:
        return None
    levels = {**problem.experiment.levels, name: "case"}
    other = problem.changed(experiment=replace(problem.experiment, levels=levels))
    own = [c.parameter == name for c in other.coordinates]
    if sum(own) < 2:
        return None
    known = dict(zip(problem.names, fit.q, strict=True))
    start = np.array([known[name if c.parameter == name else c.name] for c in other.coordinates])
    # One value for all may have brought dry friction into another valley: it is sought from its usual values too.
    usual = np.where([c.role == "nominal" for c in other.coordinates], 0.0, start)
    return calibrate(other, [start, usual], eta=fit.eta, anneal=False, target=target)


def with_damping_of_each_case(fit: Calibration, target: float = -math.inf) -> Calibration | None:
    """The fit with a c1t for each case; None where cases share a spring, or c1t is no free number that cases share."""
    return with_own_in_each_case(fit, DAMPING, target) if _on_springs_of_their_own(fit) else None


def _on_springs_of_their_own(fit: Calibration) -> bool:
    trials = [fit.problem.experiment.trials[i] for i in fit.problem.trials]
    springs = {t.case: t.k1t for t in trials}
    return len(set(springs.values())) == len(springs)


def values_of_cases(fit: Calibration, name: str) -> str:
    """The values of a parameter that each case has of its own, in words; empty if they share one."""
    found = {c.case: fit.parameters[c.name][0] for c in fit.problem.coordinates if c.parameter == name and c.case}
    return ", ".join(f"{value:.3g} in case {case}" for case, value in found.items())


def damping_in_words(fit: Calibration) -> list[str]:
    """A sentence on the c1t of each case, where each has its own."""
    listed = values_of_cases(fit, DAMPING)
    said = (
        f"The damping {DAMPING} differs from case to case: {listed} (SI units). Each case, with a spring of its own, "
        "has its own value; no cause is named for it."
    )
    return [said] if listed else []


def one_damping_in_words(fit: Calibration) -> list[str]:
    """A sentence where all cases of a fit share a c1t and should not."""
    own = with_damping_of_each_case(fit, fit.cost)
    if own is None or own.log_evidence < fit.log_evidence + SHOWS_FROM:
        return []
    said = (
        f"The damping {DAMPING} differs from case to case: {values_of_cases(own, DAMPING)} (SI units). All cases "
        "together have one value here, which is right for none of them; use the fits of the cases."
    )
    return [said]


@dataclass(frozen=True)
class Apart:
    """A parameter of which the trials' own values differ from case to case.

    values : for each set of cases that share one value, case -> by what share its mean differs from theirs; within :
    standard deviation of the trials' own values that repeats of one case show; p_value : of cases alike, all parameters
    that are looked at paid for.
    """

    name: str
    values: list[dict[str, float]]
    within: float
    p_value: float


def differing_by_case(fit: Calibration) -> list[Apart]:
    """Parameters that cases share, and of which the trials' own values differ by more from case to case than within.

    Own values are fitted about one value for all, with the size that repeats of one case show. With a mean in each case
    the linearised problem gains half a chi-square; that over its degrees of freedom has the distribution F, whose
    second number is that of the contrasts among repeats. The surest parameter first, then others with its means given:
    a spring that differs also moves what is fitted beside it. Records that begin in motion show none.
    """
    if fit.problem.experiment.start != "rest":
        return []
    means = _Means.of(fit)
    found: list[Apart] = []
    while len(found) < len(means.of_cases):
        given = [apart.name for apart in found]
        p, name = min((means.tested(name, given), name) for name in means.of_cases if name not in given)
        if not p * len(means.of_cases) < SURE:
            break
        found.append(Apart(name, means.values(name, given), means.within[name], p * len(means.of_cases)))
    return found


def by_case_in_words(fit: Calibration, missing: bool = False) -> list[str]:
    """A sentence on each parameter that cases share and should not; missing : whether the model lacks a cause.

    Without repeats it is one on what differs from trial to trial by more than is usual, if no cause is missing.
    """
    if not any(rest for _, *rest in repeats([fit.problem.experiment.trials[i] for i in fit.problem.trials])):
        return [] if missing else _lone_in_words(fit)
    out = []
    for apart in differing_by_case(fit):
        shown = (
            f"repeats of one case differ by {100.0 * apart.within:.2g} %, so this is not the scatter of single trials. "
        )
        lacks = "A law that the model lacks looks so where cases swing to different amplitudes. " if missing else ""
        for values in apart.values:
            first, *others = sorted(values, key=lambda case: values[case])
            beside = ", ".join(f"{100.0 * (values[case] - values[first]):.2g} % in case {case}" for case in others)
            out.append(
                f"{apart.name} differs from case to case: above that of case {first} by {beside}; {shown}{lacks}"
                f"{_remedy(fit, apart.name, first)}"
            )
    return out


def _lone_in_words(fit: Calibration) -> list[str]:
    """A sentence on each parameter that differs from trial to trial by more than is usual where no case is repeated."""
    first, *others = (fit.problem.experiment.trials[i].case for i in fit.problem.trials)
    shared = _one_for_all(fit)
    if fit.problem.experiment.start != "rest" or not shared or all(case == first for case in others):
        return []
    return [
        f"{size.name} differs from trial to trial by {100.0 * size.sd:.2g} %, where {100.0 * size.typical:.2g} % is "
        "usual. No case is repeated, so nothing shows whether it is the cases that differ: repeat some. "
        f"{_remedy(fit, size.name, first)}"
        for size in without_repeats(fit).sizes
        if size.name in shared and size.low > UNUSUAL * size.typical
    ]


def _one_for_all(fit: Calibration) -> set[str]:
    """Parameters that scatter about a value which cases may share."""
    names = {size.name for size in fit.problem.switches.scatter.sizes} & {"k1t", *fit.problem.names}
    return names - {DAMPING} if _on_springs_of_their_own(fit) else names  # each of which may damp as it does


def _remedy(fit: Calibration, name: str, case: str) -> str:
    """What gives each case its own value of a parameter."""
    if name != "k1t":
        return f'For a value of each case, write `{name} = {{ level = "case" }}` in the file of --priors.'
    experiment = fit.problem.experiment
    declared = next(experiment.stiffnesses[t.k1t][0] for t in experiment.trials if t.case == case)
    return (
        "Cases that declare the same k1t share one spring. If these do not, give each a k1t of its own in trials.csv: "
        f"its measured value, or one slightly off ({declared:.4g} and {1.001 * declared:.4g}, say) with a standard "
        "deviation that allows for the difference."
    )


@dataclass(frozen=True)
class _Means:
    """The linearised problem, all else eliminated, by the means that the own values of a parameter have in each case.

    of_cases : parameter -> its cases, a list for each set that shares one value, as places in what follows;
    labels (n,) : the case of each place; information (n, n); slope (n,) : derivative of the cost; within : size of the
    parameter; freedom : contrasts among repeats that show it. All means are in units of that size.
    """

    of_cases: dict[str, list[list[int]]]
    labels: list[str]
    information: Array
    slope: Array
    within: dict[str, float]
    freedom: dict[str, int]

    @classmethod
    def of(cls, fit: Calibration) -> _Means:
        """From the normal equations at a fit."""
        problem, trials = fit.problem, fit.problem.experiment.trials
        one_for_all = _one_for_all(fit)
        having = {
            name: [i for i in problem.trials if trials[i].coupled or name not in COUPLED_ONLY]
            for name in RELATIVE
            if name in one_for_all
        }
        freedom = {name: sum(len(r) - 1 for r in repeats([trials[i] for i in of])) for name, of in having.items()}

        def key(name: str, i: int) -> tuple[str, int, str]:
            return name, trials[i].k1t if name == "k1t" else 0, trials[i].case

        keys = list(dict.fromkeys(key(name, i) for name, those in having.items() for i in those))
        sets: dict[tuple[str, int], list[int]] = {}
        for at, (name, shared, _) in enumerate(keys):
            sets.setdefault((name, shared), []).append(at)
        of_cases: dict[str, list[list[int]]] = {}
        for (name, _), places in sets.items():
            if len(places) > 1 and freedom[name]:
                of_cases.setdefault(name, []).append(places)
        normals = fit.linear.pinned().normal()
        S, g, inverses = normals.reduced()
        information, mixed, slope = np.zeros((len(keys),) * 2), np.zeros((len(keys), g.size)), np.zeros(len(keys))
        for (block, H, TJ, gT), inverse in zip(normals.parts, inverses, strict=True):
            own = {name: m for m, (name, _, _) in enumerate(block.group.nuisances)}
            for k, i in enumerate(block.group.trials):
                names = [name for name in having if nuisance(name) in own]
                rows = np.array([keys.index(key(name, i)) for name in names], dtype=np.intp)
                m = np.array([own[nuisance(name)] for name in names], dtype=np.intp)
                # A mean acts as own values do, but has no prior; of these and their prior this is left:
                information[rows[:, None], rows] += (np.eye(H.shape[1]) - inverse[k])[m[:, None], m]
                mixed[rows] += (inverse[k] @ TJ[k])[m]
                slope[rows] += (inverse[k] @ gT[k] - block.eta[k])[m]
        information -= mixed @ np.linalg.solve(S, mixed.T)
        slope -= mixed @ np.linalg.solve(S, g)
        sizes = {name: problem.switches.scatter.sd(name) for name in having}
        return cls(of_cases, [case for _, _, case in keys], information, slope, sizes, freedom)

    def tested(self, name: str, given: Sequence[str]) -> float:
        """p-value of the cases being alike in a parameter, the means of those that are given being free."""
        alike, apart = self._directions(given), self._directions([*given, name])
        common = np.array([np.eye(self.slope.size)[places].sum(axis=0) for places in self.of_cases[name]])
        gained = self._solved(apart)[0] - self._solved(np.concatenate([alike, common]))[0]
        freedom = sum(len(places) - 1 for places in self.of_cases[name])
        return float(fdtrc(freedom, self.freedom[name], max(gained, 0.0) / freedom))

    def values(self, name: str, given: Sequence[str]) -> list[dict[str, float]]:
        """By what share each case differs from the mean of those that share its value."""
        means = self._solved(self._directions([*given, name]))[1] * self.within[name]
        return [
            {self.labels[at]: float(means[at] - means[places].mean()) for at in places}
            for places in self.of_cases[name]
        ]

    def _directions(self, names: Sequence[str]) -> Array:
        """One for the mean of each case, (k, n)."""
        places = [at for name in names for those in self.of_cases[name] for at in those]
        return np.eye(self.slope.size)[places]

    def _solved(self, directions: Array) -> tuple[float, Array]:
        """Chi-square gained by what lies along directions (k, n), and the means (n,)."""
        if not len(directions):
            return 0.0, np.zeros(self.slope.size)
        pull = -directions @ self.slope
        matrix = directions @ self.information @ directions.T
        x = np.linalg.solve(matrix + 1e-9 * np.eye(len(pull)), pull)
        return float(pull @ x), x @ directions
