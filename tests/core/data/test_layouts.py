"""Where tables begin in files of other programs: lines above the header, rows of units, worksheets."""

import sys

import pytest

from calib.core.base.errors import DataError
from calib.core.data.tables import read_table

ROWS = "P1,10.5,20,1793.127\nP2,11.5,21,1790.000\n"


@pytest.fixture
def read(tmp_path):
    def reading(text):
        path = tmp_path / "export.csv"
        path.write_text(text)
        return read_table(path)

    return reading


@pytest.fixture
def workbook(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")

    def written(*sheets):
        book = openpyxl.Workbook()
        book.remove(book.active)
        for number, rows in enumerate(sheets):
            sheet = book.create_sheet(f"sheet {number}")
            for row in rows:
                sheet.append(row)
        path = tmp_path / "export.xlsx"
        book.save(path)
        book.close()
        return path

    return written


def is_the_table(table, lines):
    assert table.names == ("Point", "J1", "J2", "X")
    assert table.column("X", "length").tolist() == [1.793127, 1.79]
    return tuple(table.lines) == lines


@pytest.mark.parametrize(
    ("above", "comments", "told"),
    [
        ("// SpatialAnalyzer 2023.1\n// Working frame: A::World\n", 2, 0),
        ("PolyWorks|Inspector\nOperator;J. Doe\nDate,2024-01-01\nTemperature,20.1\n\n", 4, 1),
        ('"Leica AT960"\t"serial 7"\n# a comment\nUnits: mm, degrees\n', 3, 1),
    ],
)
def test_lines_above_the_header_are_comments_and_that_is_told(read, caplog, above, comments, told):
    table = read(f"{above}Point,J1 (deg),J2 (deg),X (mm)\n{ROWS}")
    first = above.count("\n") + 2
    assert is_the_table(table, (first, first + 1))
    assert len(table.comments) == comments
    assert caplog.text.count(f"took line {first - 1} for the header") == len(caplog.records) == told


@pytest.mark.parametrize("units", [",deg,deg,mm", ",[deg],[deg],[mm]", ",(°), (deg) ,mm"])
def test_a_row_of_units_below_the_header_says_the_units(read, caplog, units):
    assert is_the_table(read(f"Report\nPoint,J1,J2,X\n{units}\n{ROWS}"), (4, 5))
    assert "the line below the header for units" in caplog.text


def test_units_in_both_places_are_no_row_of_units(read):
    table = read(f"Point,J1,J2,X [mm]\n,deg,deg,um\n{ROWS}")
    with pytest.raises(DataError, match="line 2, column 'X': 'um' is not a number"):
        table.column("X", "length")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (f"note\nPoint,J1,J2,X\n{ROWS}Point,J1,J2,X\n{ROWS}", "lines 2 and 5 both look like the header"),
        ("P1,10.5,20,1793.127\n3,x,,\n4,y,,\n", "line 1: numbers where the header should be; write a line with the"),
        (f"// a program\n{ROWS}", "rows without names of columns, .*: write a line with the names"),
    ],
)
def test_what_could_be_read_in_two_ways_is_refused(read, text, said):
    with pytest.raises(DataError, match=said):
        read(text)


def test_a_row_without_numbers_in_a_table_is_no_second_header(read):
    assert len(read(f"Point,J1,J2,X\nP0,,,\n{ROWS}").rows) == 3


def test_a_worksheet_is_read_like_a_file(workbook):
    rows = [["Leica AT960"], ["Operator", "Doe, J."], [], ["Point", "J1 [deg]", "J2 [deg]", "X [mm]"]]
    table = read_table(workbook([*rows, ["P1", 10.5, 20, 1793.127], ["P2", 11.5, 21, 1790]], []))
    assert is_the_table(table, (5, 6))
    assert table.comments == ("Leica AT960", 'Operator,"Doe, J."')


@pytest.mark.parametrize(
    ("sheets", "said"),
    [
        (([["a", "b"], [1, 2]], [["a"]]), "several sheets have data: 'sheet 0', 'sheet 1'"),
        (([],), "has no data"),
        (([["a", "b"], ["#N/A", 2]],), "sheet 'sheet 0', row 2: a formula ended in #N/A"),
    ],
)
def test_a_workbook_that_cannot_be_read_is_an_error_that_says_why(workbook, sheets, said):
    with pytest.raises(DataError, match=said):
        read_table(workbook(*sheets))


def test_a_file_that_only_has_the_name_of_a_workbook_is_an_error(tmp_path, monkeypatch):
    path = tmp_path / "a.xlsx"
    path.write_text("a,b\n1,2\n")
    if sys.modules.get("openpyxl") is not None:
        with pytest.raises(DataError, match="not a workbook that can be read"):
            read_table(path)
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(DataError, match="is not installed: pip install openpyxl"):
        read_table(path)
    with pytest.raises(DataError, match=r"old.xls: spreadsheets are read as .xlsx or CSV"):
        read_table(tmp_path / "old.xls")
