"""posterior.nc goes out and comes back, and ArviZ reads it."""

import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.signal import lfilter

from bayes_damper.sampling.arviz_adapter import hdi, read, results, to_arviz, write


def test_the_file_comes_back_and_arviz_opens_it(tmp_path):
    rng = np.random.default_rng(0)
    draws = rng.standard_normal((4, 20, 8))
    groups = {"observed_data": {"y": np.arange(3.0)}, "log_likelihood": {"trial": rng.standard_normal((4, 160, 2))}}
    write(results({"mu": draws}, log_prob=-draws, groups=groups, attributes={"seed": 1}), tmp_path / "posterior.nc")
    tree = read(tmp_path / "posterior.nc")
    assert set(tree.children) == {"posterior", "sample_stats", "observed_data", "log_likelihood"}
    assert tree.attrs["seed"] == 1
    assert np.array_equal(tree["posterior"]["mu"].values, draws.reshape(4, 160))
    peer = pytest.importorskip("arviz_base").convert_to_datatree(str(tmp_path / "posterior.nc"))
    assert peer["posterior"]["mu"].dims == ("chain", "draw")


def test_variables_have_the_units_that_are_known(tmp_path):
    draws = np.random.default_rng(0).standard_normal((4, 20, 8))
    known = {"r_hat": 1.0, "ess_bulk": 100.0, "ess_tail": 90.0}
    told = {"mu": known | {"unit": "1"}, "k2t": known | {"unit": "N m/rad"}, "shape": known}
    made = results(dict.fromkeys(told, draws), log_prob=-draws, diagnostics=told)
    write(made, tmp_path / "posterior.nc")
    posterior = read(tmp_path / "posterior.nc")["posterior"]
    assert (posterior["mu"].attrs["units"], posterior["k2t"].attrs["units"]) == ("1", "N m/rad")
    assert "units" not in posterior["shape"].attrs
    assert posterior["k2t"].attrs["ess_bulk"] == 100.0


def test_the_shortest_interval_of_a_normal():
    low, high = hdi(np.random.default_rng(0).standard_normal(200_000))
    assert low == pytest.approx(-1.645, abs=0.06)
    assert high == pytest.approx(1.645, abs=0.06)


def test_arviz_gives_honest_sample_sizes_for_ensembles(tmp_path):
    """Autoregressive walkers whose tau is known: (1 + phi) / (1 - phi) draws count as one."""
    rng, phi, shape = np.random.default_rng(1), 0.9, (2, 400, 32)  # ensembles, steps, walkers
    start = rng.standard_normal((shape[0], 1, shape[2]))
    steps = np.sqrt(1.0 - phi**2) * rng.standard_normal(shape)
    draws = lfilter([1.0], [1.0, -phi], np.concatenate([start, steps], axis=1), axis=1)[:, 1:]
    write(results({"mu": draws}, log_prob=-draws), tmp_path / "posterior.nc")
    found = to_arviz(tmp_path / "posterior.nc")
    posterior = found["posterior"]["mu"]
    assert posterior.dims == ("chain", "draw")
    assert posterior.shape == (64, 400)
    assert np.array_equal(posterior.values[33], draws[1, :, 1])
    import arviz

    ess = float(arviz.ess(np.asarray(posterior.values), method="bulk"))
    assert ess == pytest.approx(draws.size * (1 - phi) / (1 + phi), rel=0.2)


@pytest.mark.slow
def test_figures_are_there_where_the_cache_folder_of_the_user_cannot_be_written(tmp_path):
    """Which is how ArviZ 0.23 sees it where two processes import it at once, too."""
    (tmp_path / "cache").write_text("a file")
    code = "from bayes_damper.sampling import arviz_adapter as a; print(a.imported('corner').__name__)"
    place = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | place, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == ["corner"], done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="limits of a process")
def test_a_posterior_that_finds_no_room_is_a_sentence_and_leaves_nothing(tmp_path):
    """The system refuses to write on behind 50 kB, as a full disk does; the file of before stays."""
    path = tmp_path / "posterior.nc"
    path.write_bytes(b"of before")
    code = (
        "import resource, signal, sys, numpy as np; from bayes_damper.sampling import arviz_adapter as a;"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000));"
        "x = np.random.default_rng(1).random((2, 100, 100));"
        "found = a.results({'mu': x}, log_prob=x);\n"
        "try: a.write(found, sys.argv[1])\n"
        "except OSError as error: print(error.strerror, error.filename)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "File too large" in done.stdout
    assert [p.name for p in tmp_path.iterdir()] == ["posterior.nc"]
    assert path.read_bytes() == b"of before"
