"""Fitting a campaign by least squares, with everything that is uncertain about the rig and about each trial.

How to use it::

    experiment = experiment_of(campaign)              # a campaign.Campaign, or build an Experiment by hand
    problem = Problem(experiment)                     # nominal model; effect=variant adds one effect
    fit = calibrate(problem)                          # noise is learnt from the repeats on the way
    fit.parameters                                    # {"mu": (value, sd), ...}
    fit.log_evidence                                  # Laplace; comparable between Problems that share `noise`
    rival = calibrate(Problem(experiment, effect=variant, noise=fit.problem.noise), starts=[fit.q])
    predict(fit, experiment.heldout)                  # held-out trials: only their own nuisances are fitted

Every unknown has a coordinate in which its prior is a standard Gaussian: `q` holds those of the whole campaign
(nominal parameters, constants declared with a standard deviation, parameters of the effect), `eta` those of each trial
(release angle, instant of release, its own friction). With r the whitened residuals, J = dr/dq and T = dr/d eta the
cost  |r|^2 + |q|^2 + sum |eta_j|^2  is minimised by damped Gauss-Newton steps in which each trial's nuisances are
eliminated by a Schur complement,

    H_j = 1 + T_j' T_j,    S = 1 + sum_j J_j' J_j - J_j' T_j H_j^-1 T_j' J_j,
    log Z = -(cost + log |S| + sum_j log |H_j|) / 2      (Laplace, up to the constant of the noise).

All vectors of a Jacobian, of all trials that share their sample times, go through one call of Model.simulate.
"""

from __future__ import annotations

from bayes_damper.calibration.derivatives import Indices
from bayes_damper.calibration.experiment import (
    Experiment,
    TrialRecord,
    default_priors,
    experiment_of,
    fitted_to_all,
    longest_step,
    thinned,
    with_priors,
    with_rounding,
)
from bayes_damper.calibration.groups import FRICTION_SPREAD, Group, Switches
from bayes_damper.calibration.heldout import Prediction, predict, unseeing
from bayes_damper.calibration.least_squares import Calibration, calibrate, default_starts, drawn_starts, summarise
from bayes_damper.calibration.noise import Noise, rough_noise
from bayes_damper.calibration.noise_level import error_level, evenly_sampled, learn_noise, spectrum_bins, whittle
from bayes_damper.calibration.nominal import (
    as_single_releases,
    calibrate_nominal,
    explained_by_own_releases,
    gained_by_own_releases,
    grown,
    under,
    with_sizes_of_its_own,
)
from bayes_damper.calibration.normal_equations import Block, Linear, Normals
from bayes_damper.calibration.problem import Problem, simulated_once
from bayes_damper.calibration.unknowns import NOMINAL, Coordinate, coordinate_of, middle, value_and_slope

__all__ = [
    "FRICTION_SPREAD",
    "NOMINAL",
    "Block",
    "Calibration",
    "Coordinate",
    "Experiment",
    "Group",
    "Indices",
    "Linear",
    "Noise",
    "Normals",
    "Prediction",
    "Problem",
    "Switches",
    "TrialRecord",
    "as_single_releases",
    "calibrate",
    "calibrate_nominal",
    "coordinate_of",
    "default_priors",
    "default_starts",
    "drawn_starts",
    "error_level",
    "evenly_sampled",
    "experiment_of",
    "explained_by_own_releases",
    "fitted_to_all",
    "gained_by_own_releases",
    "grown",
    "learn_noise",
    "longest_step",
    "middle",
    "predict",
    "rough_noise",
    "simulated_once",
    "spectrum_bins",
    "summarise",
    "thinned",
    "under",
    "unseeing",
    "value_and_slope",
    "whittle",
    "with_priors",
    "with_rounding",
    "with_sizes_of_its_own",
]
