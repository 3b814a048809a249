"""Saved states come back bit for bit, survive damage, and refuse another run."""

import numpy as np
import pytest

from bayes_damper.errors import InputError
from bayes_damper.runs.checkpoint import Checkpoint


def test_arrays_and_record_come_back_bit_for_bit(tmp_path):
    arrays = {"a": np.random.default_rng(0).standard_normal((3, 4)), "b": np.arange(5, dtype=np.uint32)}
    record = {"x": 0.1 + 0.2, "n": [1, 2], "text": "mu"}
    Checkpoint(tmp_path, {"seed": "1"}).save(arrays, record)
    loaded, known = Checkpoint(tmp_path, {"seed": "1"}).load()
    assert known == record
    for name, value in arrays.items():
        assert loaded[name].dtype == value.dtype
        assert loaded[name].tobytes() == value.tobytes()


def test_two_states_are_kept_and_a_damaged_newest_falls_back(tmp_path):
    store = Checkpoint(tmp_path, {})
    for k in range(5):
        store.save({"k": np.array([k])}, {"k": k})
    states = sorted(tmp_path.glob("state-*.npz"))
    assert len(states) == 2
    states[-1].write_bytes(states[-1].read_bytes()[:-7])
    assert store.load()[1] == {"k": 3}
    states[0].write_bytes(b"")
    with pytest.raises(InputError, match="none of the saved states"):
        store.load()


def test_another_fingerprint_is_refused_with_each_difference(tmp_path):
    Checkpoint(tmp_path, {"seed": "1", "prior": "ab"}).save({}, {})
    with pytest.raises(InputError) as caught:
        Checkpoint(tmp_path, {"seed": "2", "prior": "cd"}).load()
    assert len(caught.value.faults) == 2
    assert "seed was 1" in str(caught.value)
    assert "is cd now" in str(caught.value)


def test_an_empty_folder_holds_no_state(tmp_path):
    assert Checkpoint(tmp_path / "none", {}).load() is None
