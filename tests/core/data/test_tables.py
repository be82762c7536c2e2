"""CSV tables: what is read, and every mistake with its file, line and column."""

import csv
import io
import math
import tracemalloc

import numpy as np
import pytest

from calib.core.base.errors import DataError
from calib.core.base.units import check_plausible
from calib.core.data.layouts import cells_of
from calib.core.data.table_writing import format_table
from calib.core.data.tables import read_table


@pytest.fixture
def table_of(tmp_path):
    """Write a file and read it as a table."""

    def read(content, renamed=None):
        path = tmp_path / "table.csv"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_table(path, renamed)

    return read


def complaint(function, *arguments):
    with pytest.raises(DataError) as caught:
        function(*arguments)
    return str(caught.value)


def test_names_units_comments_and_lines_are_told_apart(table_of):
    table = table_of("# first\nq1 [mm], q2,note\n\n1, 2,a\n # in between\n,,\n3,4,b\n")
    assert table.names == ("q1", "q2", "note")
    assert table.units == ("mm", None, None)
    assert table.comments == ("first", "in between")
    assert tuple(table.lines) == (4, 7)
    assert table.text("note") == ["a", "b"]
    assert table.column("q1", "length").tolist() == [0.001, 0.003]
    assert table.column("q2", "angle").tolist() == [2.0, 4.0]


@pytest.mark.parametrize("ends", ["\n", "\r\n", "\r"])
def test_line_ends_of_every_system_are_read_and_odd_ones_inside_a_cell_are_none(table_of, ends):
    table = table_of("\ufeff" + ends.join(['note, "b, c [mm]"', "for\x0cm\x85\u2028,2", 'größer, "4"']))
    assert [row[0] for row in table.rows] == ["for\x0cm\x85\u2028", "größer"]
    assert table.column("b, c", "length").tolist() == [0.002, 0.004]
    assert tuple(table.lines) == (2, 3)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is empty; expected a header line and rows of numbers"),
        ("# only a comment\n\n,,\n", "is empty; expected a header line and rows of numbers"),
        ("a,b\n", "has a header but no rows"),
        ("a;b\n1;2\n3;4;5\n", "line 3: 3 cells for 2 columns"),
        ("a,b,a [mm]\n1,2,3\n", "column 'a' appears twice; names must be unique"),
        ("a,,b\n1,2,3\n", "column 2 has no name in the header; name it, or remove it"),
        ("a,b\n1,2\n3\n", "line 3: 1 cells for 2 columns"),
        ("Monday\na,b\nc,d\n", "line 2: 2 cells for 1 columns; if line 1 is not the header, begin it with #"),
        (
            "a,b\n1,5,2,5\n",
            "line 2: 4 cells for 2 columns; write decimals with a point, or separate columns by semicolons",
        ),
        ('# exported\na;b\n;;\n1;"2\n3";4\n', "line 4: is not CSV (unexpected end of data)"),
        (b"\xff\xfea\x00,\x00", "column 2 has no name in the header; name it, or remove it"),
        ("a,b\n1,2\n".encode("utf-16-le"), "is not UTF-8 text; give a CSV file in UTF-8"),
        ("a,b\n1,2\n".encode("utf-16-be"), "is not UTF-8 text; give a CSV file in UTF-8"),
        (bytes(range(128, 256)), "is not UTF-8 text; give a CSV file in UTF-8"),
    ],
)
def test_a_file_that_is_no_table_is_an_error_that_says_where(table_of, tmp_path, content, message):
    assert complaint(table_of, content).removeprefix(f"{tmp_path / 'table.csv'}").lstrip(":, ") == message


@pytest.mark.parametrize("mark", [";", "\t"])
def test_semicolons_and_tabs_part_columns_and_leave_the_comma_for_decimals(table_of, mark):
    text = "# Export, from there\npose;q1 [mm];q2;x\nA, left;1,5;-,25;2\nB;-1;2,5e-1;4.25e0\n;;;\nC;2,;3;1.5\n"
    table = table_of(text.replace(";", mark))
    assert table.text("pose") == ["A, left", "B", "C"]  # text keeps its commas
    assert tuple(table.lines) == (3, 4, 6)
    assert table.column("q1", "length").tolist() == [0.0015, -0.001, 0.002]
    assert table.column("q2", "angle").tolist() == [-0.25, 0.25, 3.0]
    assert table.column("x", "length").tolist() == [2.0, 4.25, 1.5]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (("1,5", "1.234,5"), "line 3, column 'b': '1.234,5' is not a number; write thousands without a mark"),
        (("1,5", "1,234,567"), "line 3, column 'b': '1,234,567' is not a number; write thousands without a mark"),
        (("2.5", "1,234"), "line 3, column 'b': '1,234', but '2.5' in line 2; write all decimals of a column one way"),
        (("1,5", "fast, too"), "line 3, column 'b': 'fast, too' is not a number"),
    ],
)
def test_commas_that_may_mean_something_else_are_errors_with_line_and_column(table_of, tmp_path, rows, message):
    table = table_of("a;b\n" + "".join(f"0;{cell}\n" for cell in rows))
    assert complaint(table.column, "b", "length") == f"{tmp_path / 'table.csv'}, {message}"


@pytest.mark.parametrize("swap", [",.", ".,"])
def test_thousands_are_told_from_decimals_by_the_other_columns(table_of, swap):
    def table(other):
        return table_of(f"pose;q [deg];x [mm]\n1{swap[1]}5;{other};1{swap[0]}793\n2;20;-919\n")

    doubt = f"'1{swap[0]}793', but another column has '10{swap[1]}5'; write all decimals one way, and thousands without"
    assert doubt in complaint(table(f"10{swap[1]}5").column, "x", "length")
    for other in (f"10{swap[0]}5", "10"):
        assert table(other).column("x", "length") == pytest.approx([0.001793, -0.919])


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        ("", "is empty; fill it in, or remove the row"),
        ("nan", "'nan' is not finite; remove the row"),
        ("1e999", "'1e999' is not finite; remove the row"),
        ("fast", "'fast' is not a number"),
        ("12 mm", "'12 mm' is not a number"),
        ("1_000", "'1_000' is not a number"),  # Python's float() would read 1000
        ('"1,5"', "'1,5' is not a number; write decimals with a point"),
    ],
)
def test_a_cell_that_is_no_number_is_an_error_with_line_and_column(table_of, tmp_path, cell, message):
    table = table_of(f"# comment\na,b\n1,2\n3,{cell}\n")
    assert complaint(table.column, "b", "length") == f"{tmp_path / 'table.csv'}, line 4, column 'b': {message}"


def test_an_unknown_column_names_the_one_that_begins_alike(table_of):
    table = table_of("shoulder_pan [deg],shoulder_lift_joint [deg]\n1,2\n")
    nearest = "; did you mean 'shoulder_pan'? The file has shoulder_pan, shoulder_lift_joint"
    assert complaint(table.column, "shoulder_pan_joint", "angle").endswith(nearest)


def test_numbers_without_a_unit_that_cannot_be_si_are_refused(table_of):
    table = table_of("q,x,far [m]\n1.0,0.3,300\n-90,412.7,400\n")
    words = "line 3, column '{}': {} is not plausible; write the unit into the header: {} if it is right"
    assert complaint(table.column, "q", "angle").endswith(words.format("q", "-90 rad", "deg, or rad"))
    assert complaint(table.column, "x", "length").endswith(words.format("x", "412.7 m", "mm, or m"))
    assert table.column("far", "length").tolist() == [300.0, 400.0]
    check_plausible(4 * math.pi, "angle", "here", "there")  # a last joint of two turns either way
    check_plausible(50.0, "length", "here", "there")  # a tracker across a hall


def test_foreign_columns_are_renamed_and_their_own_unit_counts(table_of):
    renamed = {"x1": "tool_x [mm]", "j 1": "q1"}
    table = table_of("x1,j 1 [deg]\n5,180\n", renamed)
    assert table.names == ("tool_x", "q1")
    assert table.column("tool_x", "length").tolist() == [0.005]
    assert table.column("q1", "angle").tolist() == [math.pi]
    assert table_of("x1 [um]\n5\n", renamed).column("tool_x", "length").tolist() == [5e-6]
    text = complaint(table_of, "x1,tool_x\n1,2\n", renamed)
    assert text.endswith("column 'tool_x' appears twice; names must be unique")


def test_what_is_written_reads_back_exactly(tmp_path):
    generator = np.random.default_rng(1)
    numbers = np.concatenate([generator.normal(size=50) * 10.0 ** generator.integers(-12, 2, 50), [0.0, -0.0, 1 / 3]])
    names = ["plain", "with, comma", 'with "quotes"', "#1", " # 2", "[a]"] + [f"n{k}" for k in range(len(numbers) - 6)]
    text = format_table([("name, odd", names), ("x [m]", list(numbers))], ("a comment",))
    path = tmp_path / "written.csv"
    path.write_text(text)
    table = read_table(path)
    assert table.comments == ("a comment",)
    assert table.text("name, odd") == [name.strip() for name in names]
    assert table.column("x", "length").tolist() == numbers.tolist()


@pytest.mark.parametrize(
    "name",
    ["=1+1", "+SUM(A1)", "-cmd|' /C calc'!A0", "@x", "'=1", "''=1", "'-5", "-5", "+1.5e3", "-", "'", "'quoted'",
     "\uff1d1", "a=1", "#=1", "1-2", "=,=", '="', "-1_000", "''", "'+"],
)  # fmt: skip
def test_no_name_is_a_formula_to_a_spreadsheet_and_every_name_reads_back(tmp_path, name):
    path = tmp_path / "table.csv"
    path.write_text(format_table([("pose", ["A", name]), (name, [-1.5, 2.0])], (f"truth,{name}",)))
    table = read_table(path)
    assert table.text("pose") == ["A", name]
    assert table.names == ("pose", name)
    assert table.column(name, None).tolist() == [-1.5, 2.0]
    for row in csv.reader(path.read_text().splitlines()):
        for cell in row:
            try:
                float(cell)
            except ValueError:
                assert cell[:1] not in ("=", "+", "-", "@", "\uff1d")
    assert format_table([("pose", table.text("pose")), (name, [-1.5, 2.0])], table.comments) == path.read_text()


def test_what_is_no_text_or_number_is_written_as_what_it_is():
    assert format_table([("limit", ["-170.0 deg", "-1 cmd|"])]) == "limit\n-170.0 deg\n'-1 cmd|\n"
    assert format_table([("x", np.array([1.5, np.nan, -np.inf])), ("n", ["a", "#b", 3])]) == "x,n\n1.5,a\n,#b\n,3\n"
    with pytest.raises(ValueError):
        format_table([("a", [1.0]), ("b", [1.0, 2.0])])


def test_a_long_table_may_quote_some_of_its_cells_and_have_blanks_before_others(table_of):
    cells = [f'"p,{k}", {k}.5' if k % 300 == 7 else f'p{k},  "{k}.5"' if k % 2 else f"p{k},{k}.5" for k in range(900)]
    table = table_of("pose,x [mm]\n" + "\n".join(cells) + "\n")
    assert table.text("pose") == [f"p,{k}" if k % 300 == 7 else f"p{k}" for k in range(900)]
    np.testing.assert_allclose(1e3 * table.column("x", "length"), np.arange(900) + 0.5, rtol=1e-15)
    assert [tuple(row) for row in table.rows[306:308]] == [("p306", "306.5"), ("p,307", "307.5")]


@pytest.mark.parametrize(
    "line",
    ["1,2,3", " 1,  2 ,3", "a, b c ,", ",,", '"a,b",2,3', ' "a b", "c ""d""",3', "\t1,\x0c,2", "é,\U0001f916,ü"],
)
def test_cells_are_those_of_csv(line):
    assert cells_of(line, ",") == tuple(next(csv.reader([line], skipinitialspace=True, strict=True)))


def test_the_text_of_a_column_keeps_no_memory_of_the_other_cells(table_of):
    """Python takes the memory of many short texts in blocks, which one text of each keeps."""
    table = table_of("pose,q1\nfirst,0.5\nsecond,0.25\n")
    assert table.text("pose") == ["first", "second"]
    assert all(text is not cells[0] for text, cells in zip(table.text("pose"), table.rows, strict=True))


def test_a_long_table_is_written_without_all_its_cells_in_memory():
    columns = [(f"q{k}", np.random.default_rng(k).standard_normal(30_000)) for k in range(6)]
    columns.append(("pose", [f"P{k}" for k in range(30_000)]))
    tracemalloc.start()
    text = format_table(columns)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5 * len(text)  # lines, their join, and cells of a part; all cells take as much as the rest


def test_lines_are_those_of_the_csv_writer_with_the_digits_of_repr():
    generator = np.random.default_rng(2)
    numbers = generator.normal(size=500) * 10.0 ** generator.integers(-20, 20, 500)
    exact = [0.0, -0.0, 1e-4, np.nextafter(1e-4, 0.0), 1e16, np.nextafter(1e16, 0.0), 5e-324, 2.0**-10, 1e22, 123.0]
    numbers = np.concatenate([numbers, exact])
    words = [("", "a,b", 'with "quotes"', "line\nbreak", " plain ")[k % 5] for k in range(len(numbers))]
    for columns in ([numbers], [words], [words, numbers], [words, words, numbers, -numbers, words], [numbers, words]):
        expected = io.StringIO()
        texts = [list(map(repr, column.tolist())) if isinstance(column, np.ndarray) else column for column in columns]
        names = [f"c{k}" for k in range(len(columns))]
        csv.writer(expected, lineterminator="\n").writerows([names, *zip(*texts, strict=True)])
        assert format_table(list(zip(names, columns, strict=True))) == expected.getvalue()


def test_files_are_read_alike_in_pieces_of_any_size(tmp_path, monkeypatch):
    """Pieces end between the bytes of a letter and between those of a line's end."""
    content = "\ufeff# größer\r\npose,q1 [mm]\r\n" + "".join(f"Ü{k},{k}.5\r\n" for k in range(600)) + "# Ende\r\nlast,7"
    (tmp_path / "table.csv").write_bytes(content.encode())
    for size in (1, 2, 3, 1 << 20):
        monkeypatch.setattr("calib.core.base.files._PIECE", size)
        table = read_table(tmp_path / "table.csv")
        assert table.comments == ("größer", "Ende")
        assert table.text("pose") == [f"Ü{k}" for k in range(600)] + ["last"]
        assert tuple(table.lines) == (*range(3, 603), 604)
        assert table.rows[-2:] == (("Ü599", "599.5"), ("last", "7"))
        np.testing.assert_allclose(1e3 * table.column("q1", "length"), [*np.arange(600) + 0.5, 7.0])
