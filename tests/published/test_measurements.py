"""The published numbers: complete, each once, true to their pages, and protected against change."""

import math
import shutil
from collections import Counter

import pytest

from bayes_damper.errors import InputError
from bayes_damper.inputs import shipped_path
from bayes_damper.published.measurements import FILES, load_published


@pytest.fixture(scope="module")
def published():
    return load_published()


@pytest.fixture
def copy(tmp_path):
    return shutil.copytree(shipped_path("data/thesis"), tmp_path / "thesis")


def test_each_of_the_24_measurements_is_there_once(published):
    keys = Counter((m.case, m.configuration, m.quantity) for m in published.measurements)
    assert len(keys) == 24
    assert set(keys.values()) == {1}
    assert {m.quantity for m in published.measurements} == {"log_decrement", "period", "max_acceleration"}
    assert all(m.standard_error > 0.0 and m.n == 3 for m in published.measurements)


def test_nothing_derived_is_among_the_measurements(published):
    assert {m.quantity for m in published.derived if math.isfinite(m.standard_error)} == {
        "damping_ratio",
        "natural_frequency",
        "max_acceleration",
    }
    assert not {"damping_ratio", "natural_frequency"} & {m.quantity for m in published.measurements}


def test_derived_damping_ratios_follow_from_the_decrements(published):
    """Eq. 11 (p. 12), to the last digit printed in Table 6 (p. 17)."""
    decrements = {(m.case, m.configuration): m for m in published.measurements if m.quantity == "log_decrement"}
    ratios = [m for m in published.derived if m.quantity == "damping_ratio" and m.table == "Table 6"]
    assert len(ratios) == 8
    for ratio in ratios:
        delta = decrements[ratio.case, ratio.configuration].value
        assert 1.0 / math.hypot(1.0, 2.0 * math.pi / delta) == pytest.approx(ratio.value, abs=1.6e-3)


def test_derived_frequencies_follow_from_the_periods(published):
    """Table 4 (p. 14) is Table 7 (p. 18) corrected by the damping ratio: one measurement, printed twice."""
    found = {(m.case, m.quantity): m.value for m in published.measurements if m.configuration == "uncoupled"}
    for m in published.derived:
        if m.quantity == "natural_frequency":
            delta = found[m.case, "log_decrement"]
            zeta = delta / math.hypot(delta, 2.0 * math.pi)
            assert 1.0 / found[m.case, "period"] / math.sqrt(1.0 - zeta**2) == pytest.approx(m.value, abs=0.011)


def test_values_are_in_si_units(published):
    four = {(m.configuration, m.quantity): m for m in published.of_case("IV")}
    assert four["coupled", "period"].value == pytest.approx(0.1163)
    assert four["coupled", "period"].standard_error == pytest.approx(0.0073)
    assert four["coupled", "period"].unit == "s"
    assert four["uncoupled", "max_acceleration"].value == 240.7
    assert published.cases["IV"].theta0 == pytest.approx(math.radians(4.7))
    assert published.inertia["total"] == pytest.approx(3.015e-3)


def test_the_inertia_rows_add_up_to_less_than_the_total(published):
    """Table 1 (p. 9) contradicts itself; the data keep both numbers."""
    rows = sum(value for name, value in published.inertia.items() if name != "total")
    assert rows == pytest.approx(2.923e-3)


def test_printed_digits_are_kept(published):
    energies = {p.case: p.text for p in published.printed if p.quantity == "initial_potential_energy"}
    assert energies == {"I": "30.4", "II": "49.2", "III": "11.3", "IV": "34.3"}
    fitted = {p.case: (p.text, p.page) for p in published.printed if p.quantity == "fitted_c2t"}
    assert fitted["I"] == ("0.1", 20)


def test_frequency_response_holds_table_12_and_figure_11(published):
    response = {(p.configuration, p.quantity): p.value for p in published.frequency_response}
    assert response["uncoupled", "accelerance"] == 772.1
    assert response["c2t = 0", "second_accelerance"] == 7069.2
    assert response["untuned", "insertion_loss"] == 1.0
    assert response["J2 / 8", "insertion_loss"] == 5.0


def test_every_row_names_its_table_and_page(published):
    rows = [*published.measurements, *published.derived, *published.printed, *published.frequency_response]
    assert all(row.table and 9 <= row.page <= 31 for row in rows)


def test_a_changed_number_is_refused(copy):
    path = copy / "measurements.csv"
    path.write_text(path.read_text().replace("240.7", "277.5"))
    with pytest.raises(InputError, match=r"measurements\.csv: its SHA-256 .* restore the file"):
        load_published(copy)


def test_all_missing_files_are_told_at_once(copy):
    (copy / "cases.csv").unlink()
    (copy / "printed.toml").unlink()
    with pytest.raises(InputError) as error:
        load_published(copy)
    assert len(error.value.faults) == 2


def test_an_unknown_case_names_the_four(published):
    with pytest.raises(InputError, match="its cases are I, II, III, IV"):
        published.of_case("V")


def test_each_file_is_described_column_by_column():
    for name in FILES:
        assert shipped_path(f"data/thesis/{name}.toml").is_file()


def test_shipped_path_refuses_what_is_not_shipped():
    with pytest.raises(InputError, match="reinstall"):
        shipped_path("data/thesis/nothing.csv")
