import pytest
from rich.table import Table

from calib.core.base.words import count_noun, distinct_names, listing, plain_text


def test_brackets_and_colons_are_no_markup():
    table = Table(title="Error [mm] :smile:", title_justify="left")
    table.add_column("x [deg]")
    table.add_row("[left]_arm :100:")
    text = plain_text(["line [m] :smile:", table], width=80)
    for words in ("line [m] :smile:", "Error [mm] :smile:", "x [deg]", "[left]_arm :100:"):
        assert words in text


def test_lines_are_broken_only_if_asked_for():
    line = " ".join(["word"] * 20)
    assert plain_text([line], width=40) == line + "\n"
    assert max(map(len, plain_text([line], width=40, wrap=True).splitlines())) <= 40


def test_numbers_have_the_right_noun():
    assert count_noun(0, "pose") == "0 poses"
    assert count_noun(1, "other minimum explains", "other minima explain") == "1 other minimum explains"
    assert count_noun(2, "other minimum explains", "other minima explain") == "2 other minima explain"


def test_long_lists_are_cut():
    assert listing(["a", "b"], "; ") == "a; b"
    assert listing(list("abcdefg")) == "a, b, c, d, e, and 2 more"


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
