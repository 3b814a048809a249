"""The keys of an import table are the fields of the records that it becomes."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest

from bayes_damper.campaign.importing.options import READER, TRIAL, ReaderOptions, TrialOptions, checked_keys, trials_of
from bayes_damper.errors import InputError

ROW = {"source": "a.csv", "case": "A 1", "configuration": "uncoupled", "k1t": "estimate"}


def test_every_field_is_a_key_and_every_key_a_field() -> None:
    """But for the place of a trial in its table, which nobody writes."""
    assert [f.name for f in fields(ReaderOptions)] == list(READER)
    assert [f.name for f in fields(TrialOptions)] == [*READER, "where", *TRIAL]
    assert all(key.meaning and key.types for key in (TRIAL | READER).values())


def test_the_types_of_a_key_are_those_of_its_field() -> None:
    assert set(READER["offset"].types) == {str, int, float, list}
    assert set(READER["offset"].items) == {str, int, float}
    assert (READER["units"].types, READER["units"].items) == ((list,), (str,))
    assert (READER["sideways"].types, READER["every"].types, READER["every"].least) == ((bool,), (int,), 1)


def test_a_trial_takes_what_the_reader_says_and_its_own_over_it() -> None:
    table = {"reader": {"columns": ["a"], "every": 2}, "trials": [ROW, ROW | {"every": 3}, ROW | {"trial": 7}]}
    faults: list[str] = []
    trials = trials_of(table, "import", faults)
    assert not faults
    assert [(t.columns, t.every, t.trial, t.file) for t in trials] == [
        (("a",), 2, 1, "trials/A-1_uncoupled_1.csv"),
        (("a",), 3, 2, "trials/A-1_uncoupled_2.csv"),
        (("a",), 2, 7, "trials/A-1_uncoupled_7.csv"),
    ]
    assert (trials[0].offset, trials[0].release, trials[0].where) == ("none", "start", "a.csv")


def test_two_rows_with_one_number_are_a_fault_and_a_missing_key_ends_it() -> None:
    faults: list[str] = []
    trials_of({"trials": [ROW | {"trial": 1}, ROW | {"trial": 1}]}, "t.toml", faults)
    assert len(faults) == 1
    assert faults[0].startswith(
        "t.toml [[trials]] number 2: trial 1 of A 1 uncoupled is there already (t.toml [[trials]] number 1); give each"
    )
    with pytest.raises(InputError, match="number 1: key 'k1t' is missing"):
        trials_of({"trials": [{k: v for k, v in ROW.items() if k != "k1t"}]}, "t.toml", [])


@pytest.mark.parametrize(
    ("table", "faults"),
    [
        ({"delimiter": ["a"]}, 1),
        ({"units": ["g", 1]}, 1),
        ({"every": 0}, 1),
        ({"every": True}, 1),
        ({"release": 1, "wrap": [360, 0.5], "offset": ["mean", 2]}, 0),
    ],
    ids=str,
)
def test_a_value_of_another_type_is_one_fault(table: dict[str, Any], faults: int) -> None:
    assert len(checked_keys(table, READER, "here")) == faults
