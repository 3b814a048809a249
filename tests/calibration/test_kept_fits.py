"""Fits that a run has made are found again, bit for bit, by the same run alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bayes_damper.calibration import Noise, calibrate, least_squares
from bayes_damper.calibration.kept_fits import fits_kept_in
from bayes_damper.effects import EFFECTS
from bayes_damper.runs.checkpoint import read_whole, write_whole

from .test_least_squares import problem  # noqa: F401 (a fixture)

CUBIC = EFFECTS["spring_cubic"].variants


def no_descent(*_, **__):
    raise AssertionError("fitted once more")


def test_a_fit_is_made_once(problem, tmp_path, monkeypatch):  # noqa: F811
    starts = [problem.prior_mean(), 0.1 + problem.prior_mean()]
    alone = calibrate(problem, starts)
    with fits_kept_in(tmp_path):
        first = calibrate(problem, starts)
        monkeypatch.setattr(least_squares, "_descend", no_descent)
        again = calibrate(problem, starts)
        for found in (first, again):
            assert np.array_equal(found.q, alone.q)
            assert all(np.array_equal(found.eta[i], v) for i, v in alone.eta.items())
            assert (found.log_evidence, found.cost, found.converged) == (
                alone.log_evidence, alone.cost, alone.converged
            )  # fmt: skip
            assert np.array_equal(found.covariance, alone.covariance)
    with pytest.raises(AssertionError, match="fitted once more"):
        calibrate(problem, starts)  # kept nowhere


@pytest.mark.parametrize(
    "other",
    [
        lambda p: p.with_noise(Noise((2.1,), (0.3,), (0.1,))),
        lambda p: p.with_effect(CUBIC[0]),
        lambda p: p.with_effect(replace(CUBIC[0], starts=CUBIC[0].starts[:1], torque=CUBIC[-1].torque)),
        lambda p: p.for_trials((0,)),
        lambda p: p.reweighted({0: np.full((1, 300), 0.5)}),
        lambda p: p.changed(switches=replace(p.switches, delay=False)),
    ],
)
def test_another_problem_is_fitted_itself(problem, tmp_path, monkeypatch, other):  # noqa: F811
    with fits_kept_in(tmp_path):
        calibrate(problem, most=1, finish=False)
        changed = other(problem)
        monkeypatch.setattr(least_squares, "_descend", no_descent)
        with pytest.raises(AssertionError, match="fitted once more"):
            calibrate(changed, [changed.prior_mean()], most=1, finish=False)


def test_a_damaged_file_is_no_fit(problem, tmp_path):  # noqa: F811
    with fits_kept_in(tmp_path):
        first = calibrate(problem, most=2, finish=False)
        (file,) = tmp_path.glob("*.npz")
        whole = file.read_bytes()
        for damaged in (whole[:-1], b"", whole[:40] + b"x" + whole[41:]):
            file.write_bytes(damaged)
            assert calibrate(problem, most=2, finish=False).log_evidence == first.log_evidence
            assert file.read_bytes() == whole
        arrays, record = read_whole(file)
        for odd in ({"iterations": "many"}, {"iterations": None}):
            write_whole(file, arrays, record | odd)
            assert calibrate(problem, most=2, finish=False).log_evidence == first.log_evidence
        for odd in ({"q": arrays["q"][:-1]}, {"q": arrays["q"].astype(str)}, {"eta0": arrays["eta0"][None]}):
            write_whole(file, arrays | odd, record)
            assert calibrate(problem, most=2, finish=False).log_evidence == first.log_evidence
    assert [p.name for p in tmp_path.iterdir()] == [file.name]
