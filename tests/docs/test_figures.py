"""Every figure of the pages is made by a command, and none is left over. Taking pictures is tested in tests/browser."""

import re

import make_figures
import make_pictures
import pytest
import screenshots
from snippets import DOCS, ROOT

from calib.core.base.errors import InputError

OF_OTHERS = {"watch_replay", "ur10", "ur10_dark", "comparison"}
"""Drawn by docs/site/watch_replay.py, make_poster.py and tests/code_comparison from measurements of others."""


def test_every_drawing_has_its_maker_and_every_picture_is_shown():
    drawings = {path.stem for path in (DOCS / "figures").glob("*.svg")}
    assert drawings == set(make_figures.FIGURE_MAKERS) | OF_OTHERS
    shown = set()
    for page in (*DOCS.rglob("*.md"), ROOT / "CONTRIBUTING.md", ROOT / "README.md"):
        shown |= set(re.findall(r"figures/([\w-]+\.\w+)", page.read_text()))
    for path in (DOCS / "figures").glob("[!.]*.*"):
        assert path.name in shown, f"{path.name} is on no page"


def test_scripts_leave_their_options_to_argparse_and_help_writes_nothing(tmp_path, monkeypatch, capsys):
    scripts = {*(ROOT / "docs" / "site").glob("*.py"), *(ROOT / "tests").rglob("*.py")}
    scripts -= {*(ROOT / "tests" / "code_comparison" / "codes").glob("*.py")}  # started by `running`, without argparse
    assert not [path.name for path in scripts if re.search(r"^[^\"']*sys\.argv\[[12]", _own(path), re.MULTILINE)]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["make_figures.py", "--help"])
    with pytest.raises(SystemExit) as ended:
        make_figures.main()
    assert ended.value.code == 0
    assert "[FOLDER]" in capsys.readouterr().out
    assert not list(tmp_path.iterdir())


def _own(path):
    """What a script does itself: the code of another one may be in a string of three quotes."""
    return re.sub(r'"""[\s\S]*?"""', "", path.read_text())


def test_pictures_are_those_that_commands_take():
    taken = {f"{name}.png" for name, *_ in (*screenshots.PICTURES, *make_pictures.PICTURES)}
    assert {path.name for path in (DOCS / "figures").glob("*.png")} <= taken


@pytest.mark.quick(1)
@pytest.mark.parametrize("name", sorted(make_figures.FIGURE_MAKERS))
def test_a_figure_is_drawn(name):
    drawn, shipped = make_figures.drawing(name).decode(), (DOCS / "figures" / f"{name}.svg").read_text()
    texts = [re.findall(r">([A-Za-z][^<>]{3,})</text>", svg) for svg in (drawn, shipped)]
    assert texts[0] == texts[1], "run docs/site/make_figures.py"
    assert "$" not in drawn, "mathematics is written out as it stands"


def test_a_folder_without_pages_is_an_error(tmp_path):
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed (extra 'browser')")
    with pytest.raises(InputError, match=r"has no viewer\.html"):
        screenshots.take(tmp_path)
    assert not (tmp_path / "out").exists()


def test_a_computer_without_chromium_is_told_what_to_install(monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(InputError, match="install the package 'chromium'"):
        screenshots.chromium()
