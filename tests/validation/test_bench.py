"""`bench`: its own parts are right, and its result says what it measured."""

from __future__ import annotations

import json
from importlib import import_module

import numpy as np
import pytest

module = import_module("bayes_damper.validation.bench")  # the package itself offers the function of that name


def test_fixed_steps_converge_to_our_kernel():
    from bayes_damper.simulation.model import Model

    call, out = module.fixed_step(100.0, 64)
    call()
    y = Model().simulate(module.vectors(100.0, 16), module.TIMES, tolerance=0.1).y
    assert np.abs(y - out).max() < 1e-5 * np.abs(out).max()


def test_the_first_vectors_are_the_same_however_many_are_asked_for():
    np.testing.assert_array_equal(module.vectors(10.0, 16)["mu"], module.vectors(10.0, 64)["mu"][:16])


def test_a_target_is_kept_missed_or_unknown():
    assert module.Target("a", 2.0, 3.0).kept
    assert module.Target("a", 2.0, 1.0).kept is False
    assert module.Target("a", 2.0, 1.0, at_most=True).kept
    assert module.Target("a", 2.0, None).kept is None


def test_forced_records_are_held_against_what_is_true_of_them():
    """The row of forced records has the error of the simulation, not of its yardstick, and is among the targets."""
    from bayes_damper.rig.inputs import Inputs
    from bayes_damper.simulation.model import Model

    times = module.TIMES[:61]
    table = module.vectors(100.0, 1)
    truth = module.bench_peers.forced(table, 1, times, module._SWEEP[:61])
    y = Model().simulate(table, times, inputs=Inputs.measured(times, module._SWEEP[:61])).y
    assert 0.0 < module._error(y, truth) < 1e-4
    assert module._error(Model().simulate(table, times).y, truth) > 0.01
    names = [("bayes_damper", 1e-5), ("kernel alone", 1e-5), ("kernel, one fixed tolerance", 1e-5)]
    rows = [module.Row(name, nu, 1.0, error) for nu in module.SHARPNESS for name, error in names]
    rows += [module.Row("bayes_damper, swept torque", nu, 1.0, 3e-4) for nu in module.SHARPNESS]
    missed = [
        t.name for t in module._targets(tuple(rows), [], 1.0, 1.0) if t.at_most and "error" in t.name and not t.kept
    ]
    assert missed == ["largest error of forced records, share of the peak"]


@pytest.mark.slow
def test_bench_without_peers(tmp_path):
    result = module.bench(repeats=2, peers=False)
    assert result.accurate
    assert {row.name for row in result.rows} >= {
        "bayes_damper",
        "bayes_damper, swept torque",
        "RK4 in lanes",
        "same source, libm tanh",
    }
    assert all(row.error < 1e-4 for row in result.rows)
    # LLVM vectorises our kernel: sixteen lanes cost far less than the same source on libm's tanh.
    spent = {(row.name, row.nu): row.microseconds for row in result.rows}
    assert spent["same source, libm tanh", 100.0] > 2.0 * spent["kernel alone", 100.0]
    files = module.save(result, tmp_path / "proof")
    assert {path.name for path in files} >= {"bench.json", "bench.md", "bench.svg"}
    body = json.loads((tmp_path / "proof" / "bench.json").read_text())
    assert body["schema"] == "bayes-damper/bench/1"
    assert 0.05 < body["kernel_gflops"] / body["peak_gflops"] < 1.0
