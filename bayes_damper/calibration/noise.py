"""The noise of the sensors, by channel, and a first guess of it from fast content of the readings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bayes_damper.calibration.experiment import Experiment
from bayes_damper.rig.kernels import compiled

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Noise:
    """Noise of each channel: an ARMA(1, 1) process (a white one plus an AR(1) one); phi = theta = 0 is white.

    innovation: sd of the innovations, the channel's unit; total: sd of the noise itself; longer: for each channel the
    coefficients of a longer autoregression that takes the place of phi and theta, empty where there is none.
    Without repeats the noise stands for the model's own error too (`error_level`); sensor is then the sd of the
    readings' noise alone.
    """

    innovation: tuple[float, ...]
    phi: tuple[float, ...]
    theta: tuple[float, ...]
    longer: tuple[tuple[float, ...], ...] = ()
    sensor: tuple[float, ...] = ()

    @property
    def floor(self) -> tuple[float, ...]:
        """Standard deviation of what no model could explain, each channel."""
        return self.sensor or self.total

    @property
    def over_sensors(self) -> Array:
        """(channels,) the noise over that of the sensors alone: above 1 where it stands for the model's error too."""
        return np.asarray(np.array(self.total) / np.array(self.floor))

    @property
    def of_sensors(self) -> Noise:
        """White noise of the sensors alone, as if the model left nothing beside it."""
        white = (0.0,) * len(self.floor)
        return Noise(self.floor, white, white, sensor=self.floor)

    def filter(self, channel: int) -> tuple[list[float], list[float]]:
        """Numerator and denominator of the filter that turns the noise into its innovations."""
        if self.longer and self.longer[channel]:
            return [1.0, *(-a for a in self.longer[channel])], [1.0]
        return [1.0, -self.phi[channel]], [1.0, -self.theta[channel]]

    @property
    def total(self) -> tuple[float, ...]:
        """Standard deviation of the noise of each channel."""
        out = []
        for channel, (s, p, t) in enumerate(zip(self.innovation, self.phi, self.theta, strict=True)):
            if self.longer and self.longer[channel]:
                from scipy.signal import lfilter  # slow to load, and few rigs have such a noise

                impulse = np.zeros(20_000)
                impulse[0] = 1.0
                ahead, back = self.filter(channel)
                out.append(s * math.sqrt(float(np.sum(np.square(lfilter(back, ahead, impulse))))))
            else:
                out.append(s * math.sqrt((1.0 + t * t - 2.0 * p * t) / (1.0 - p * p)))
        return tuple(out)

    def density(self, channel: int, omega: Array) -> Array:
        """Spectral density at angular frequencies omega (rad per sample), the channel's unit squared."""
        ahead, back = self.filter(channel)
        z = np.exp(-1j * omega)
        gain = np.polyval(back[::-1], z) / np.polyval(ahead[::-1], z)
        return np.asarray(self.innovation[channel] ** 2 * np.abs(gain) ** 2)

    def coloured(self, channel: int) -> bool:
        """Whether the noise of a channel is correlated."""
        ahead, back = self.filter(channel)
        return any(ahead[1:]) or any(back[1:])

    def whiten(self, channel: int, r: Array, out: Array | None = None) -> Array:
        """Innovations of residuals r (..., n), in units of their standard deviation; out : where they are put."""
        if self.longer and self.longer[channel]:
            rows = np.ascontiguousarray(r).reshape(-1, r.shape[-1])
            r = _left_of(rows, np.array(self.longer[channel])).reshape(r.shape)
        elif self.coloured(channel):
            from scipy.signal import lfilter

            r = np.asarray(lfilter(*self.filter(channel), r, axis=-1))
        return np.divide(r, self.innovation[channel], out=out)

    def whitened(self, r: Array, weight: Array) -> Array:
        """Weighted innovations of residuals r (..., channels, n), of their shape; weight: (channels, n) or wider."""
        channels, n = r.shape[-2:]
        if self.longer and any(self.longer[:channels]):
            out = np.multiply(r, weight)
            for c in range(channels):
                self.whiten(c, out[..., c, :], out=out[..., c, :])
            return out
        each = np.tile(np.arange(channels), r.size // max(channels * n, 1))
        which = np.broadcast_to(np.arange(weight.size // n).reshape(weight.shape[:-1]), r.shape[:-1]).ravel()
        scale, ahead, back = (np.array(x)[each] for x in (self.innovation, self.phi, self.theta))
        out = np.empty(r.shape)
        _whiten(
            np.ascontiguousarray(r).reshape(-1, n), np.ascontiguousarray(weight).reshape(-1, n), which,
            1.0 / scale, -ahead, back, out.reshape(-1, n),
        )  # fmt: skip
        return out


@compiled()
def _whiten(
    x: Array, weight: Array, which: NDArray[np.int64], scale: Array, ahead: Array, back: Array, out: Array
) -> None:
    """Rows of x (rows, n), each times row `which` of the weights and a scale, through its filter into out.

    By fours: in each every reading waits for the one before.
    """
    rows, n = x.shape
    for a in range(0, rows, 4):
        b, c, d = min(a + 1, rows - 1), min(a + 2, rows - 1), min(a + 3, rows - 1)
        wa, wb, wc, wd = weight[which[a]], weight[which[b]], weight[which[c]], weight[which[d]]
        pa = pb = pc = pd = qa = qb = qc = qd = 0.0
        for i in range(n):
            za, zb = x[a, i] * wa[i] * scale[a], x[b, i] * wb[i] * scale[b]
            zc, zd = x[c, i] * wc[i] * scale[c], x[d, i] * wd[i] * scale[d]
            qa, qb = za + ahead[a] * pa + back[a] * qa, zb + ahead[b] * pb + back[b] * qb
            qc, qd = zc + ahead[c] * pc + back[c] * qc, zd + ahead[d] * pd + back[d] * qd
            pa, pb, pc, pd = za, zb, zc, zd
            out[a, i], out[b, i], out[c, i], out[d, i] = qa, qb, qc, qd


@compiled(fastmath={"contract"})
def _left_of(x: Array, coefficients: Array) -> Array:
    """Rows of x (rows, n) without what an autoregression predicts from the readings before each."""
    out = x.copy()
    for a in range(len(x)):
        before = x[a]
        for k in range(coefficients.size):
            left, c = out[a, k + 1 :], coefficients[k]
            for i in range(left.size):
                left[i] -= c * before[i]
    return out


def rough_noise(experiment: Experiment, trials: Sequence[int]) -> Noise:
    """White noise per channel from the fast content of the readings: for a first fit."""
    channels = 1 + int(any(experiment.trials[i].coupled for i in trials))
    sds = []
    for c in range(channels):
        pieces = []
        for i in trials:
            y = experiment.trials[i].y
            if c < y.shape[0] and y.shape[1] > 12:
                pieces.append(y[c])
        sd = fast_level(pieces)
        declared = experiment.noise_sd[min(c, len(experiment.noise_sd) - 1)] if experiment.noise_sd else 0.0
        scale = max((float(np.nanmax(np.abs(experiment.trials[i].y))) for i in trials), default=1.0)
        sds.append(max(sd if sd > 0.0 else declared, rounding(experiment, c), 1e-6 * scale, 1e-300))
    return Noise(tuple(sds), (0.0,) * channels, (0.0,) * channels)


def fast_level(series: Sequence[Array], order: int = 4, readings: Sequence[Array] | None = None) -> float:
    """Standard deviation of the white noise in series, from differences of an order; 0 where there is too little.

    The higher the order, the faster may be what is no noise, and the more readings does one event spoil. readings :
    of which the series are residuals; by default the series themselves.
    """
    kept = _differences(series, order, readings)
    return 1.4826 * float(np.median(np.abs(kept))) if kept.size else 0.0


def tails_of(series: Sequence[Array], order: int = 4, readings: Sequence[Array] | None = None) -> float:
    """Mean square of the white noise in series over its `fast_level` squared: above 1 where its tails are heavy."""
    kept, level = _differences(series, order, readings), fast_level(series, order, readings)
    return max(float(np.mean(kept**2)) / level**2, 1.0) if level > 0.0 else 1.0


def _differences(series: Sequence[Array], order: int, readings: Sequence[Array] | None) -> Array:
    """Differences of an order along each series, as large as the white noise in it.

    Where most of those of the readings are 0, as where a body stands still below the step of an encoder, the others
    show the noise.
    """

    def along(rows: Sequence[Array]) -> Array:
        fast = [np.diff(x, n=order)[4:] for x in rows if x.size > order + 8]
        return np.concatenate(fast) if fast else np.zeros(0)

    found = along(series)
    moves = found != 0.0 if readings is None else along(readings) != 0.0
    known = np.isfinite(found)
    if 0 < np.count_nonzero(moves[known]) < 0.5 * np.count_nonzero(known):
        known &= moves
    return found[known] / math.sqrt(math.comb(2 * order, order))  # the gain on white noise


def rounding(experiment: Experiment, channel: int) -> float:
    """Standard deviation of the rounding of a channel that errs by nothing else, else 0."""
    return experiment.rounding_step(channel) / math.sqrt(12.0)
