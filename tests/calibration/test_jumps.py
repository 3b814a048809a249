"""Evidence where a reading lies in the jump of a release."""

import pytest
from test_scatter import laboratory

from bayes_damper.calibration import Problem, Switches
from bayes_damper.calibration.jumps import beside_jumps
from bayes_damper.calibration.least_squares import calibrate, summarise
from bayes_damper.calibration.own_values import RELEASE
from bayes_damper.calibration.scatter import usual_releases


def test_a_microsecond_of_an_instant_is_no_evidence():
    """The release at a reading, and 4 microseconds before it, out of the jump: two trials, 17 nats apart without."""
    drawn = laboratory(3, {}, repeats=2, n=200, noise=2.0)
    problem = usual_releases(Problem(drawn, switches=Switches(friction=False)))
    fit = calibrate(problem)
    places = {i: (g, k) for g in problem.groups for k, i in enumerate(g.trials)}
    at, beside = dict(fit.eta), dict(fit.eta)
    for i, (group, k) in places.items():
        names = [name for name, _, _ in group.nuisances]
        d, r = names.index("delay"), names.index(RELEASE)
        _, middle, half = group.nuisances[d]
        for eta, instant in ((at, 0.0), (beside, -4e-6)):
            eta[i] = eta[i].copy()
            eta[i][d] = (instant - middle[k]) / half[k]
            eta[i][r] = group.lower[k, r]  # none
    found = [summarise(problem, fit.q, eta, True, 1) for eta in (at, beside)]
    plain = [f.log_evidence - beside_jumps(problem, f.linear.normal()) for f in found]
    assert plain[1] - plain[0] > 15.0
    assert found[1].log_evidence - found[0].log_evidence == pytest.approx(0.0, abs=1.5)
