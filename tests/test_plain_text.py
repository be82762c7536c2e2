import io

import pytest
from rich.console import Console
from rich.table import Table

from calib.base.words import TextTable, counted, distinct_names, listed, plain_text


def test_brackets_and_colons_are_no_markup():
    table = TextTable(["x [deg]"], title="Error [mm] :smile:")
    table.add_row("[left]_arm :100:")
    text = plain_text(["line [m] :smile:", table], width=80)
    for words in ("line [m] :smile:", "Error [mm] :smile:", "x [deg]", "[left]_arm :100:"):
        assert words in text


def test_lines_are_broken_only_if_asked_for():
    line = " ".join(["word"] * 20)
    assert plain_text([line], width=40) == line + "\n"
    assert max(map(len, plain_text([line], width=40, wrap=True).splitlines())) <= 40


def test_numbers_have_the_right_noun():
    assert counted(0, "pose") == "0 poses"
    assert counted(1, "other minimum explains", "other minima explain") == "1 other minimum explains"
    assert counted(2, "other minimum explains", "other minima explain") == "2 other minima explain"


def test_long_lists_are_cut():
    assert listed(["a", "b"], "; ") == "a; b"
    assert listed(list("abcdefg")) == "a, b, c, d, e, and 2 more"


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["/a/one", "/a/two/"], ("one", "two")),
        (["/a/one/out", "/a/two/out"], ("one", "two")),
        (["/a/x/one/out", "/b/x/two/out"], ("a/x/one", "b/x/two")),
        (["/a/out", "/a/out/again"], ("out", "out/again")),
        (["here/../one", "two"], ("one", "two")),
        (["/a/one"], ("one",)),
        ([], ()),
    ],
)
def test_folders_are_named_by_what_differs(paths, names):
    assert distinct_names(paths) == names


def test_a_line_that_is_broken_goes_on_two_places_further_in():
    text = plain_text(["  CHECK: one two three", "a\nb"], 16, wrap=True)
    assert text == "  CHECK: one two\n    three\na\nb\n"


def by_rich(parts, width, **style):
    stream = io.StringIO()
    console = Console(file=stream, width=width, color_system=None, markup=False, emoji=False, highlight=False)
    for part in parts:
        console.print(part, soft_wrap=isinstance(part, str))
    return stream.getvalue()


@pytest.mark.parametrize("title", [None, "Errors", "a title that is longer than all of its table, or nearly so"])
@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize("width", [120, 30])
@pytest.mark.parametrize(
    "rows", [[], [("mean", "0.0123"), ("95 % µ ±", "-> 7 "), ("名前 is wide", ""), ("two\nlines", "1")]]
)
def test_tables_are_those_of_rich(title, plain, width, rows):
    style = {"box": None, "pad_edge": False} if plain else {}
    theirs = Table(title=title, title_justify="left", **style)
    for header, justify in (("", "left"), ("after [mm]", "right")):
        theirs.add_column(header, justify=justify)
    for count in range(len(rows) + 1):
        ours = TextTable(("", "after [mm]"), title=title, plain=plain)
        for row in rows[:count]:
            ours.add_row(*row)
        assert plain_text([ours], width) == by_rich([theirs], width)
        if count < len(rows):
            theirs.add_row(*rows[count])


def test_lines_are_those_of_rich():
    for text in ("a line", "", "tabs\there\tand there", "bell \a and return \r", "one\ntwo  ", "é 名"):
        assert plain_text([text], 80) == by_rich([text], 80)
