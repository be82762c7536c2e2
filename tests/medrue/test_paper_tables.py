"""Table I as the paper prints it, in SI units."""

import csv
from pathlib import Path

import numpy as np
import pytest

import medrue
from medrue.paper_tables import PARAMETERS, error_table, table1, table3

CSV = Path(medrue.__file__).parent / "paper" / "table1.csv"


def test_table_has_the_36_parameters_once_each_with_si_units():
    table = table1()
    assert table.names == PARAMETERS
    assert len(set(PARAMETERS)) == 36
    angles = {name for name, unit in zip(table.names, table.units, strict=True) if unit == "rad"}
    assert (table.reach == np.where([name in angles for name in PARAMETERS], np.radians(1.5), 2e-3)).all()
    assert angles == {"dq2", "dq3", "dq4", "dq5", "dq6", "phi_bx", "phi_by", "phi_bz"}


def test_values_are_the_printed_ones():
    table = table1()
    with CSV.open(encoding="utf-8") as file:
        for index, row in enumerate(csv.DictReader(file)):
            factor = 1000.0 if row["unit"] == "mm" else 180.0 / np.pi
            for column in ("nominal", "nominal_as_printed", "actual", "identified_with_noise"):
                assert getattr(table, column)[index] * factor == pytest.approx(float(row[column]), rel=1e-14)


def test_lengths_are_the_floats_of_their_decimal_text():
    table = table1()
    assert table.nominal[PARAMETERS.index("d31")] == 0.1668
    assert table.nominal[PARAMETERS.index("A1y")] == -0.233


def test_redundant_parameters_are_the_papers_eight():
    assert set(table1().redundant) == {"A2y", "A2z", "d31", "d32", "d41", "d5", "xb", "zb"}


def test_arrays_are_read_only():
    with pytest.raises(ValueError):
        table1().nominal[0] = 0.0


def test_table_3_has_the_same_parameters_and_keeps_the_redundant_ones_nominal():
    table = table3()
    assert table.nominal == pytest.approx(table1().nominal, abs=1e-15)
    assert table.identified[PARAMETERS.index("A1y")] == -0.224895
    assert table.identified[PARAMETERS.index("dq6")] == pytest.approx(np.radians(5.727), rel=1e-14)
    for name in table1().redundant:
        assert table.identified[PARAMETERS.index(name)] == table.nominal[PARAMETERS.index(name)]


@pytest.mark.parametrize(
    ("number", "column", "values"),
    [
        (2, "uniform", (0.048, 0.166, 0.040)),
        (4, "before", (3.992, 5.957, 0.639)),
        (5, "after_x", (0.340, 0.819, 0.186)),
    ],
)
def test_error_tables_are_the_printed_ones(number, column, values):
    assert tuple(error_table(number)[column][row] for row in ("mean", "max", "std")) == values
