"""The door for files of others: every kind of damage is a sentence, and nothing hangs or fills the memory."""

from __future__ import annotations

import gzip
import os
import resource
from pathlib import Path

import pytest
from campaigns import write_synthetic

from bayes_damper import inputs, load_campaign
from bayes_damper.errors import InputError


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_synthetic(tmp_path_factory.mktemp("sound") / "campaign", repeats=1, rate=500.0)


@pytest.fixture
def campaign(sound: Path, tmp_path: Path) -> Path:
    """A sound campaign of two short records, to be damaged."""
    folder = tmp_path / "campaign"
    for path in sorted(sound.rglob("*")):
        if path.is_file():
            (folder / path.relative_to(sound)).parent.mkdir(parents=True, exist_ok=True)
            (folder / path.relative_to(sound)).write_bytes(path.read_bytes())
    return folder


def faults(folder: Path) -> tuple[str, ...]:
    with pytest.raises(InputError) as caught:
        load_campaign(folder)
    return caught.value.faults


def edited(path: Path, old: str, new: str) -> None:
    text = path.read_bytes().decode()
    assert old in text
    path.write_bytes(text.replace(old, new, 1).encode())


TOML = [
    ("primary_inertia = 3.015e-3", f"primary_inertia = 1{'0' * 400}", "a whole number of about 40"),
    ("primary_inertia = 3.015e-3", f"primary_inertia = {'9' * 5000}", "thousands of digits"),
    ("primary_inertia = 3.015e-3", f"primary_inertia = 0x{'F' * 5000}", "a whole number of about 6021 digits"),
    ("primary_inertia = 3.015e-3", "primary_inertia = 1e-308", "less than 1e-30"),
    ("secondary_inertia = 2.474e-3", "secondary_inertia = 1e308", "more than 1e+30"),
    ("noise_std = 2.0", f"noise_std = [1{'0' * 400}, 1.0]", "a whole number of about 40"),
    ("noise_std = 2.0", f"noise_std = {'[' * 2000}{']' * 2000}", "nested more than"),
    ("noise_std = 2.0", f"{'.'.join('a' * 200)} = 1", "nested more than"),
    ('quantity = "acceleration"', "quantity = []", "quantity = [] is not one of"),
    ('name = "synthetic"', "name = 1979-02-30", "Invalid date"),
    ("secondary_inertia = 2.474e-3", "secondary_inertia = 1e12", "one cannot show the other"),
    ("magnet_pull = 100.0", "magnet_pull = 100.0\nground2_stiffness = 1e12", "the secondary could not move"),
    ("noise_std = 2.0", "noise_std = 1e12", "times the largest reading"),
]


@pytest.mark.parametrize(("old", "new", "sentence"), TOML, ids=range(len(TOML)))
def test_numbers_and_depth_of_campaign_toml(campaign, old, new, sentence):
    edited(campaign / "campaign.toml", old, new)
    assert any(sentence in fault for fault in faults(campaign)), faults(campaign)


TRIALS = [
    (",10.2,", ",1_0,", "'1_0' is not a number"),
    (",10.2,", ",\u0661\u0660,", "is not a number"),
    (",10.2,", ",\uff11\uff10,", "is not a number"),
    (",10.2,", f",1{'0' * 400},", "is not finite"),
    (",10.2,", ",1e200,", "beyond reason"),
    (",10.2,", f",{'x' * 140_000},", "more than 131072 characters in one line"),
    (",10.2,", ',"10.2,', "a quote is opened and never closed"),
    (",10.2,", ",10.2\r,", "4 fields where the header has 6"),
    ("trials/IV_coupled_1.csv", ".", ". leaves the campaign's folder, or is too long"),
]


@pytest.mark.parametrize(("old", "new", "sentence"), TRIALS, ids=range(len(TRIALS)))
def test_cells_of_trials_csv(campaign, old, new, sentence):
    edited(campaign / "trials.csv", old, new)
    assert any(sentence in fault for fault in faults(campaign)), faults(campaign)


def test_a_nul_anywhere_is_no_text(campaign):
    path = campaign / "trials.csv"
    path.write_bytes(path.read_bytes() + b"\n" * 5000 + b"\0")
    assert any("bytes of 0" in fault for fault in faults(campaign))


@pytest.mark.parametrize("end", [b"\r", b"\r\n"])
def test_lines_may_end_as_on_any_system(campaign, sound, end):
    for name in ("trials.csv", "trials/IV_coupled_1.csv"):
        (campaign / name).write_bytes((campaign / name).read_bytes().replace(b"\n", end))
    expected = load_campaign(sound)
    for read, other in zip(load_campaign(campaign).trials, expected.trials, strict=True):
        assert read.key == other.key
        assert (read.channels == other.channels).all()


@pytest.mark.parametrize("cell", ["1_0", "\u0661", "0x10", "1,5"])
def test_a_reading_is_written_in_plain_digits(campaign, cell):
    path = campaign / "trials/IV_uncoupled_1.csv"
    lines = path.read_text().splitlines()
    lines[5] = f"{lines[5].split(',')[0]},{cell}"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert any("line 6" in fault for fault in faults(campaign)), faults(campaign)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
@pytest.mark.parametrize("name", ["trials/IV_uncoupled_1.csv", "campaign.toml", "trials.csv", "priors.toml"])
def test_a_named_pipe_is_refused_and_does_not_hang(campaign, name):
    from bayes_damper.commands.check import check

    (campaign / name).unlink(missing_ok=True)
    os.mkfifo(campaign / name)
    with pytest.raises(InputError, match="a named pipe, not a file"):
        check(campaign)


def test_a_device_and_a_folder_are_refused(tmp_path):
    with pytest.raises(InputError, match="a folder, not a file"):
        inputs.file_bytes(tmp_path)
    if Path("/dev/zero").exists():
        with pytest.raises(InputError, match="a device, not a file"):
            inputs.file_bytes(Path("/dev/zero"))


def test_a_file_of_more_than_the_limit_is_not_read(tmp_path):
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(1 << 40)  # no block of it is on the disk
    with pytest.raises(InputError, match="1099512 MB, more than the 537 MB"):
        inputs.file_bytes(path)


def test_a_gzip_bomb_is_not_unpacked(campaign):
    """200 MB of line ends in 0.2 MB; what is unpacked stays below the limit."""
    record = campaign / "trials/IV_uncoupled_1.csv"
    packed = record.with_suffix(".csv.gz")
    with gzip.open(packed, "wb") as file:
        for _ in range(200):
            file.write(b"\n" * 1_000_000)
    record.unlink()
    edited(campaign / "trials.csv", record.name, packed.name)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert any("unpack to more than 67 MB" in fault for fault in faults(campaign))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # kB
    packed.write_bytes(packed.read_bytes()[:-9])
    assert any("not a whole gzip file" in fault or "unpack" in fault for fault in faults(campaign))


def test_thousands_of_unknown_keys_are_no_thousand_sentences(campaign):
    path = campaign / "campaign.toml"
    path.write_text(path.read_text() + "".join(f"key{i} = 1\n" for i in range(20_000)))
    assert len(faults(campaign)) < 30


def test_what_a_file_says_cannot_steer_the_terminal(campaign):
    edited(campaign / "campaign.toml", "noise_std = 2.0", '"\\u001b[31mred" = 1')
    assert any("\\x1b[31mred" in fault for fault in faults(campaign))
    assert not any("\x1b" in fault for fault in faults(campaign))


@pytest.mark.parametrize("text", ["[" * 100_000, '{"a": ' + "9" * 5000 + "}", '{"a": 1', "\ufeff\ufeff{}"])
def test_json_that_is_none(text):
    with pytest.raises(InputError, match="not valid JSON"):
        inputs.json_of(text, "x.json", "write it again")


@pytest.mark.parametrize(
    ("cell", "value"), [("1", 1.0), (" -1.5e-3 ", -1.5e-3), (".5", 0.5), ("5.", 5.0), ("+2E3", 2000.0)]
)
def test_numbers_in_cells(cell, value):
    assert inputs.number_in(cell) == value


@pytest.mark.parametrize("cell", ["", "1_0", "\u0661", "\uff11", "1e", "0x1", "1 2", "--1", "1,5", "\u22121"])
def test_what_is_no_number(cell):
    with pytest.raises(ValueError, match="not a number"):
        inputs.number_in(cell)
