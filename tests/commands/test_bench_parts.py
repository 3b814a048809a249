"""`bench --command`: each second counts once, for the innermost part, and nothing stays wrapped."""

import time

import pytest
from campaigns import write_synthetic

from bayes_damper.commands import bench_parts
from bayes_damper.diagnosis import judgement, sites


def spend(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def test_of_nested_parts_the_innermost_counts():
    watch = bench_parts.Stopwatch()
    inner = watch.timed("inner", lambda: spend(0.04))

    def both():
        spend(0.02)
        inner()

    watch.timed("outer", both)()
    seconds = watch.stop()
    assert seconds["inner"] == pytest.approx(0.04, abs=0.015)
    assert seconds["outer"] == pytest.approx(0.02, abs=0.015)


def test_what_is_spent_before_the_start_does_not_count():
    watch = bench_parts.Stopwatch()
    spend(0.05)
    watch.start()
    assert sum(watch.stop().values()) < 0.02


def test_functions_are_timed_wherever_they_are_used_and_only_then():
    given = sites.site_map
    watch = bench_parts.Stopwatch()
    with bench_parts.timed(watch, {"map": ("diagnosis.sites.site_map",)}):
        assert judgement.site_map is sites.site_map is not given
        assert judgement.site_map.__wrapped__ is given
    assert judgement.site_map is sites.site_map is given


@pytest.mark.parametrize(
    "name", [n for parts in (bench_parts.STEPS, bench_parts.WORK) for ns in parts.values() for n in ns]
)
def test_every_part_is_a_function_that_exists(name):
    owner, attribute, function = bench_parts._found(name)
    assert callable(function)
    assert getattr(owner, attribute) is function


@pytest.mark.slow
def test_the_parts_of_a_diagnosis_add_up(tmp_path):
    assert bench_parts.shipped_path(bench_parts.SHIPPED).is_dir()
    campaign = write_synthetic(tmp_path / "rig", repeats=2, rate=200.0, configurations=("uncoupled",))
    found = bench_parts.diagnose_by_parts(campaign)
    assert sum(found.steps.values()) == pytest.approx(found.seconds, rel=0.05)
    assert sum(found.work.values()) == pytest.approx(found.seconds, rel=0.05)
    assert found.steps["map the sites"] > 0.0
    assert found.work["integrate records"] > 0.0
    files = bench_parts.save(found, tmp_path)
    assert "| map the sites |" in files[1].read_text()
