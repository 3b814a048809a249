"""Other samplers on the same data and the same log posterior: PINTS, zeus and, with gradients, NUTS of numpyro.

The data are one coupled record of one second at 1 kHz, nu = 100. PINTS and zeus call the very posterior that our own
sampler calls. NUTS needs derivatives, so the same density is written in JAX (fixed-step Runge-Kutta, 16 steps per
sample, which keeps the error of the log density below 0.1 nats); it is held against ours before it is timed.

All start from the same fit: walkers and chains as draws of its Gaussian approximation, whose covariance also serves
NUTS and the adaptive Metropolis as their first metric. A run's effective draws are those of its worst coordinate.
"""

from __future__ import annotations

import contextlib
import io
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import reference
from numpy.typing import NDArray

from bayes_damper.calibration import Calibration, Experiment, Switches, TrialRecord, calibrate_nominal, default_priors
from bayes_damper.calibration.noise_unknowns import NOISE_PRIOR
from bayes_damper.calibration.posterior import RecordPosterior
from bayes_damper.priors.distributions import LogNormal, LogStudent
from bayes_damper.sampling import diagnose_draws, resampled_start, sample

Array = NDArray[np.float64]
TIMES = np.arange(1000) * 1e-3
CONSTANTS = {"J1": (3.015e-3, 0.0), "J2": (2.474e-3, 0.0), "R": (0.1, 0.0), "r": (0.0127, 0.0), "N0": (100.0, 0.0)}
TRUTH = {"mu": 0.006, "k2t": 1.5, "c2t": 0.05, "drag": 0.004, "nu": 100.0, "c1t": 0.01, "c3t": 0.008, "k1t": 10.2}
ANGLE = math.radians(4.7)
AT_REST = Switches(delay=False, friction=False)
"""Of the trials' own unknowns only the release angle is free: what the density in JAX knows."""


@dataclass(frozen=True)
class Run:
    """What one sampler did: draws (chains, steps, walkers, ndim) after its warm-up, CPU seconds and evaluations of the
    log density (gradients, for NUTS) of the warm-up and of these draws.
    """

    name: str
    draws: Array
    warm_up_seconds: float
    seconds: float
    evaluations: int

    @property
    def sizes(self) -> Array:
        """Effective draws of each coordinate, (ndim,)."""
        return np.array([diagnose_draws(self.draws[..., i]).ess_bulk for i in range(self.draws.shape[-1])])

    @property
    def r_hat(self) -> float:
        """The worst of all coordinates."""
        return max(diagnose_draws(self.draws[..., i]).r_hat for i in range(self.draws.shape[-1]))

    @property
    def flat(self) -> Array:
        """(n, ndim)."""
        return self.draws.reshape(-1, self.draws.shape[-1])


def measured() -> Experiment:
    """One record with 2 rad/s^2 of noise, by the tests' own solver."""
    y = reference.solve(TRUTH | {"theta0": 1.004 * ANGLE}, TIMES)[0]
    y += 2.0 * np.random.default_rng(17).standard_normal(y.shape)
    trial = TrialRecord("one", "IV", True, 1, TIMES, y, 0, ANGLE, 0.01 * ANGLE)
    experiment = Experiment(CONSTANTS, ((10.2, 0.0),), (trial,))
    tailed = {name: prior for name, prior in default_priors(experiment).items() if isinstance(prior, LogStudent)}
    # The density in JAX knows lognormal priors.
    return replace(experiment, priors={n: LogNormal(prior.median_value, prior.factor) for n, prior in tailed.items()})


def own(name: str = "bayes_damper") -> tuple[RecordPosterior, Run, dict[str, float]]:
    """Our own run from the record to the rule met, with the seconds of each stage."""
    experiment = measured()
    calibrate_nominal(experiment, switches=AT_REST)  # whatever is compiled or imported late is so now
    begun = time.process_time()
    posterior = RecordPosterior(calibrate_nominal(experiment, switches=AT_REST))
    fitted = time.process_time()
    warm = [fitted]

    def tell(stage: Any) -> None:
        if stage.phase == "warm-up":
            warm[0] = time.process_time()

    start = resampled_start(posterior, posterior.start, posterior.covariance, np.random.default_rng(1))
    sampling = sample(posterior, start, seed=2, progress=tell)
    end = time.process_time()
    drawn = sampling.evaluations - int(sampling.warm_up.sum()) * sampling.draws.shape[2]
    stages = {"fit": fitted - begun, "warm-up": warm[0] - fitted, "draws": end - warm[0], "all": end - begun}
    stages["converged"] = float(sampling.converged)
    return posterior, Run(name, sampling.draws, warm[0] - fitted, end - warm[0], drawn), stages


def _cloud(posterior: RecordPosterior, count: int, seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return rng.multivariate_normal(posterior.start, 0.5 * posterior.covariance, size=count)


def zeus(posterior: RecordPosterior, steps: int = 450, warm_up: int = 150, walkers: int = 64) -> Run:
    """Ensemble slice sampling, whole ensembles at once."""
    import zeus as package

    calls = [0]

    def log_density(points: Array) -> Array:
        calls[0] += len(np.atleast_2d(points))
        return posterior(points)

    np.random.seed(3)  # noqa: NPY002 (zeus draws from numpy's global state)
    sampler = package.EnsembleSampler(walkers, posterior.ndim, log_density, vectorize=True, verbose=False)
    begun = time.process_time()
    with contextlib.redirect_stderr(io.StringIO()):
        sampler.run_mcmc(_cloud(posterior, walkers, 3), warm_up, progress=False)
        warm, counted = time.process_time(), calls[0]
        last = sampler.get_last_sample()
        sampler.reset()
        sampler.run_mcmc(last, steps, progress=False)
    end = time.process_time()
    return Run("zeus", np.asarray(sampler.get_chain())[None], warm - begun, end - warm, calls[0] - counted)


def pints(posterior: RecordPosterior, method: str, chains: int, steps: int, warm_up: int) -> Run:
    """One of PINTS' samplers; it calls one vector at a time."""
    import pints as package

    calls = [0]

    class Density(package.LogPDF):  # type: ignore[misc]
        def n_parameters(self) -> int:
            return posterior.ndim

        def __call__(self, x: Array) -> float:
            calls[0] += 1
            return float(posterior(np.asarray(x)[None])[0])

    np.random.seed(4)  # noqa: NPY002 (PINTS draws from numpy's global state)
    controller = package.MCMCController(
        Density(), chains, list(_cloud(posterior, chains, 4)), sigma0=posterior.covariance,
        method=getattr(package, method),
    )  # fmt: skip
    controller.set_max_iterations(warm_up + steps)
    controller.set_log_to_screen(False)
    marks: list[tuple[float, int]] = []

    original = Density.__call__

    def marked(self: Any, x: Array) -> float:
        if calls[0] == warm_up * chains:
            marks.append((time.process_time(), calls[0]))
        return original(self, x)

    Density.__call__ = marked  # type: ignore[method-assign]
    begun = time.process_time()
    drawn = np.asarray(controller.run())[:, warm_up:]
    end = time.process_time()
    warm, counted = marks[0]
    # Chains that learn from one another (DE) are walkers of one ensemble, the others are independent chains.
    draws = drawn.transpose(1, 0, 2)[None] if method.startswith("Differential") else drawn[:, :, None]
    return Run(f"PINTS {method}", draws, warm - begun, end - warm, calls[0] - counted)


def jax_density(posterior: RecordPosterior, substeps: int = 16) -> Callable[[Any], Any]:
    """The same log density in JAX, for one point (ndim,)."""
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    fit: Calibration = posterior.fit
    problem = fit.problem
    (part,) = posterior.parts
    (group,) = problem.groups
    assert tuple(name for name, _, _ in group.nuisances) == ("theta0",)
    assert problem.noise.phi == (0.0, 0.0) == problem.noise.theta
    priors = [c.prior for c in problem.coordinates]
    assert all(isinstance(prior, LogNormal) for prior in priors)
    base = jnp.log(jnp.array([prior.median_value for prior in priors]))
    factor = jnp.log(jnp.array([prior.factor for prior in priors]))
    index = {name: i for i, name in enumerate(problem.names)}
    centre, spread = float(group.nuisances[0][1][0]), float(group.nuisances[0][2][0])
    y, weight = jnp.array(group.y[0]), jnp.array(group.weight[0] / np.array(problem.noise.innovation)[:, None])
    T, TT = jnp.array(part.T[0]), jnp.array(part.TT[0])
    readings = jnp.array(part.readings[0])
    best, follow, at = jnp.array(part.eta[0]), jnp.array(part.follow[0]), jnp.array(fit.q)
    rig = {name: value for name, (value, _) in CONSTANTS.items()}
    h = 1e-3 / substeps

    def log_density(z: Any) -> Any:
        p = jnp.exp(base + factor * z[: len(priors)])
        eta = best + follow @ (z[: len(priors)] - at)
        theta0 = centre + spread * eta[0]
        mu, k2, c2, drag, nu, c1, c3 = (p[index[n]] for n in ("mu", "k2t", "c2t", "drag", "nu", "c1t", "c3t"))
        friction, slope, k1 = mu * rig["N0"] * rig["R"], rig["R"] / (2.0 * rig["r"]), TRUTH["k1t"]

        def rates(x: Any) -> Any:
            phi, slip = x[0] - x[1], x[2] - x[3]
            pull = friction * jnp.maximum(0.0, 1.0 - slope * jnp.abs(phi))
            torque = k2 * phi + c2 * slip + pull * jnp.tanh(nu * slip)
            a1 = (-c1 * x[2] - k1 * x[0] - drag * jnp.tanh(nu * x[2]) - torque) / rig["J1"]
            a2 = (torque - c3 * x[3] - drag * jnp.tanh(nu * x[3])) / rig["J2"]
            return jnp.array([x[2], x[3], a1, a2])

        def step(x: Any, _: Any) -> Any:
            f1 = rates(x)
            f2 = rates(x + 0.5 * h * f1)
            f3 = rates(x + 0.5 * h * f2)
            f4 = rates(x + h * f3)
            return x + h / 6.0 * (f1 + 2.0 * f2 + 2.0 * f3 + f4), None

        def sampled(x: Any, _: Any) -> Any:
            reading = rates(x)[2:]
            x, _ = jax.lax.scan(step, x, None, length=substeps)
            return x, reading

        _, readings_ = jax.lax.scan(sampled, jnp.array([theta0, theta0, 0.0, 0.0]), None, length=TIMES.size)
        w = (readings_.T - y) * weight
        s = jnp.exp(math.log(NOISE_PRIOR.median_value) + math.log(NOISE_PRIOR.factor) * z[len(priors) :])
        A = jnp.eye(T.shape[1]) + jnp.einsum("c,cij->ij", s**-2, TT)
        b = eta + jnp.einsum("c,cms,cs->m", s**-2, T, w)
        quadratic = jnp.sum(jnp.sum(w**2, axis=1) / s**2) + eta @ eta - b @ jnp.linalg.solve(A, b)
        like = -0.5 * (quadratic + jnp.linalg.slogdet(A)[1]) - readings @ jnp.log(s)
        return like - 0.5 * (z @ z + posterior.ndim * math.log(2.0 * math.pi))

    return log_density


def jax_gap(posterior: RecordPosterior) -> float:
    """Largest difference of the log density in JAX from ours over 32 points, after a common constant, nats."""
    import jax

    points = _cloud(posterior, 32, 6)
    gap = np.asarray(jax.jit(jax.vmap(jax_density(posterior)))(points)) - posterior(points)
    return float(np.abs(gap - np.median(gap)).max())


def nuts(posterior: RecordPosterior, chains: int = 8, steps: int = 40, warm_up: int = 30) -> Run:
    """NUTS with a dense metric and forward-mode derivatives (cheaper here than backward)."""
    import jax
    from numpyro.infer import MCMC, NUTS

    log_density = jax_density(posterior)
    kernel = NUTS(
        potential_fn=lambda z: -log_density(z),
        dense_mass=True,
        inverse_mass_matrix=posterior.covariance,
        forward_mode_differentiation=True,
    )
    mcmc = MCMC(kernel, num_warmup=warm_up, num_samples=steps, num_chains=chains, chain_method="vectorized",
                progress_bar=False)  # fmt: skip
    begun = time.process_time()
    mcmc.warmup(jax.random.PRNGKey(5), init_params=_cloud(posterior, chains, 5), extra_fields=("num_steps",))
    warm = time.process_time()
    # The first call compiles; only the second is timed.
    mcmc.run(jax.random.PRNGKey(6), extra_fields=("num_steps",))
    mcmc.post_warmup_state = mcmc.last_state
    start = time.process_time()
    mcmc.run(jax.random.PRNGKey(7), extra_fields=("num_steps",))
    end = time.process_time()
    draws = np.asarray(mcmc.get_samples(group_by_chain=True))[:, :, None]
    gradients = int(np.asarray(mcmc.get_extra_fields(group_by_chain=True)["num_steps"]).sum())
    return Run("numpyro NUTS (JAX Runge-Kutta)", draws, warm - begun, end - start, gradients)


def agreement(one: Run, other: Run) -> tuple[float, float]:
    """Largest difference of means over its Monte-Carlo error, and largest ratio of standard deviations."""
    a, b = one.flat, other.flat
    error = np.sqrt(a.var(axis=0) / one.sizes + b.var(axis=0) / other.sizes)
    ratio = a.std(axis=0) / b.std(axis=0)
    return float(np.abs((a.mean(axis=0) - b.mean(axis=0)) / error).max()), float(np.maximum(ratio, 1 / ratio).max())
