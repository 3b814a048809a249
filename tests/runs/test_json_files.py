"""Files of results: the folder of a case has a name that every file system takes."""

import re

import pytest

from bayes_damper.runs.json_files import folder_name


@pytest.mark.parametrize("case", ["5.7 deg", "../IV", "", "\udcff", chr(0xD800), "IV\n", "θ0 = 4"])
def test_any_label_has_a_folder_of_its_own(case):
    """A byte of the command line that is no UTF-8 comes as a lone surrogate, and JSON may hold any of them."""
    assert re.fullmatch(r"[\w-]+", folder_name(case))
    assert folder_name(case) != folder_name(case + "'")


def test_a_plain_label_is_its_folder():
    assert folder_name("IV-b_2") == "IV-b_2"
