import pytest
from rich.table import Table

from calib.core.base.words import distinct_names, plain_text


def test_brackets_and_colons_are_no_markup():
    table = Table(title="Error [mm] :smile:", title_justify="left")
    table.add_column("x [deg]")
    table.add_row("[left]_arm :100:")
    text = plain_text(["line [m] :smile:", table], width=80)
    for words in ("line [m] :smile:", "Error [mm] :smile:", "x [deg]", "[left]_arm :100:"):
        assert words in text


def test_lines_are_broken_only_if_asked_for_and_go_on_two_places_further_in():
    lines = ["  CHECK: one two three", "a\nb"]
    assert plain_text(lines, 16) == "  CHECK: one two three\na\nb\n"
    assert plain_text(lines, 16, wrap=True) == "  CHECK: one two\n    three\na\nb\n"


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
