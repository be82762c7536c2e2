"""Table I as the paper prints it, in SI units."""

import csv
from pathlib import Path

import numpy as np
import pytest

import medrue
from medrue.paper_tables import PARAMETERS, table1

CSV = Path(medrue.__file__).parent / "paper" / "table1.csv"


def test_table_has_the_36_parameters_once_each_with_si_units() -> None:
    table = table1()
    assert table.names == PARAMETERS
    assert len(set(PARAMETERS)) == 36
    angles = {name for name, unit in zip(table.names, table.units, strict=True) if unit == "rad"}
    assert angles == {"dq2", "dq3", "dq4", "dq5", "dq6", "phi_bx", "phi_by", "phi_bz"}


def test_values_are_the_printed_ones() -> None:
    table = table1()
    with CSV.open(encoding="utf-8") as file:
        for index, row in enumerate(csv.DictReader(file)):
            factor = 1000.0 if row["unit"] == "mm" else 180.0 / np.pi
            for column in ("nominal", "nominal_as_printed", "actual", "identified_with_noise"):
                assert getattr(table, column)[index] * factor == pytest.approx(float(row[column]), rel=1e-14)


def test_lengths_are_the_floats_of_their_decimal_text() -> None:
    table = table1()
    assert table.nominal[PARAMETERS.index("d31")] == 0.1668
    assert table.nominal[PARAMETERS.index("A1y")] == -0.233


def test_redundant_parameters_are_the_papers_eight() -> None:
    assert set(table1().redundant) == {"A2y", "A2z", "d31", "d32", "d41", "d5", "xb", "zb"}


def test_arrays_are_read_only() -> None:
    with pytest.raises(ValueError):
        table1().nominal[0] = 0.0
