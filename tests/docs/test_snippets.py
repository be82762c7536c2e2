"""Every snippet of the pages runs, and prints what the page says."""

import re

import pytest
import snippets
from snippets import DOCS, ROOT, TESTED_ELSEWHERE, SnippetError, blocks, compare, refreshed, run_page, same

PAGES = snippets.all_pages()
NEEDED = {
    "docs/howto/controllers.md": "mujoco",
    "docs/howto/hand_eye.md": "cv2",
    "docs/tutorials/camera.md": "cv2",
    "docs/tutorials/ros_bag.md": "rosbags",
}
"""Modules of extras without which the snippets of a page cannot run."""


@pytest.mark.parametrize("page", PAGES, ids=[str(page.relative_to(ROOT)) for page in PAGES])
def test_the_snippets_of_a_page_run_and_print_what_it_says(page, request):
    if "report.html" in page.read_text(encoding="utf-8"):
        request.getfixturevalue("with_pages")
    module = NEEDED.get(str(page.relative_to(ROOT)))
    if module:
        pytest.importorskip(module, reason=f"needs {module}, of an extra")
    run_page(page)


README = (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.fixture
def reader(tmp_path, monkeypatch):
    """Where someone stands who reads README."""
    monkeypatch.chdir(tmp_path)
    for name in ("urdf", "docs"):
        (tmp_path / name).symlink_to(ROOT / name)


def test_the_python_of_the_readme_runs(reader):
    names = {}
    for block in blocks(README):
        if block.language == "python":
            exec(compile(block.text, "README.md", "exec"), names)
    assert names


def test_the_readme_shows_what_its_command_prints_first(reader, run_calib):
    (command,) = re.findall(r"^calib (fit docs/examples/arm\..*)$", README, re.MULTILINE)
    (shown,) = (block.text for block in blocks(README) if block.text.startswith("Calibration of example_arm"))
    compare(f"{shown}...\n", run_calib(*command.split()).out)


def test_pages_that_are_left_to_other_tests_are_named_there():
    for page, test in TESTED_ELSEWHERE.items():
        assert page.rpartition("/")[2] in (ROOT / test).read_text()


def test_nothing_that_could_run_is_left_out_without_a_reason():
    known = {"sh", "toml", "python", "yaml", "csv", "xml", "text", "json", "urdf", "gcode", "c"}
    for page in PAGES:
        for block in blocks(page.read_text(encoding="utf-8")):
            where = f"{page.relative_to(ROOT)}, line {block.line}"
            assert block.language in known, f"{where}: fence of language {block.language!r}"
            if block.language in ("yaml", "csv", "xml", "json", "urdf", "c"):
                assert block.title or block.comment, f"{where}: neither a file nor part of one"


def test_commands_that_are_not_run_here_are_targets_of_the_makefile():
    targets = set(re.findall(r"^(\w[\w-]*):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for page in PAGES:
        for word in re.findall(r"^make (\w+)|`make (\w+)`", page.read_text(encoding="utf-8"), re.MULTILINE):
            word = "".join(word)
            assert word in targets, f"{page.relative_to(ROOT)}: make {word}"


def test_scripts_that_the_makefile_runs_exist_and_have_their_options():
    lines = re.findall(r"\$\(BIN\)/python (?:-m ([\w.]+)|(\S+\.py))(.*)", (ROOT / "Makefile").read_text())
    files = [(ROOT / (path or f"{module.replace('.', '/')}.py"), options) for module, path, options in lines]
    own = [(file, options) for file, options in files if file.stem not in ("pip", "pytest")]
    assert {file.parent.name for file, _ in own} == {"tests", "benchmarks", "medrue", "site"}
    for file, options in own:
        text = file.read_text(encoding="utf-8")
        for option in re.findall(r"--\w+", options):
            assert f'"{option}"' in text, f"{file.relative_to(ROOT)}: {option}"


def test_every_figure_that_a_page_shows_exists():
    for page in DOCS.rglob("*.md"):
        for target in re.findall(r"!\[[^\]]*\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).is_file(), f"{page.relative_to(ROOT)}: {target}"


# The runner itself


@pytest.mark.parametrize(
    ("expected", "printed"),
    [
        ("mean 0.021 mm", "mean 0.021 mm"),
        ("mean 0.021 mm", "mean 0.0211 mm"),  # within the last digit
        ("mean 18.67 mm", "mean 18.60 mm"),  # within a percent
        ("84 poses, 0.208 s", "84 poses, 12.7 s"),  # durations
        ("the next 1.35e-17", "the next -8.1e-19"),  # rounding noise
        ("│ -0.0000 │", "│  0.0000 │"),
    ],
)
def test_numbers_may_differ_as_they_do_between_machines(expected, printed):
    assert same(expected, printed)


@pytest.mark.parametrize(
    ("expected", "printed"),
    [
        ("mean 0.021 mm", "mean 0.041 mm"),
        ("84 poses", "85 poses"),  # counts are exact
        ("PASS", "FAIL"),
        ("mean 0.021 mm", "mean 0.021 m"),
        ("mean 1.5 mm", "mean -1.5 mm"),
    ],
)
def test_other_differences_count(expected, printed):
    assert not same(expected, printed)


def test_dots_stand_for_any_lines():
    compare("...\nb\n...\n", "a\nb\nc\n")
    with pytest.raises(SnippetError, match="prints 'c'"):
        compare("...\nb\n", "a\nb\nc\n")
    with pytest.raises(SnippetError, match="nothing more"):
        compare("a\nb\n", "a\n")


def test_refreshing_keeps_the_dots_and_takes_the_new_numbers():
    assert refreshed("...\nmean 1.0\n...\n", "x\nmean 2.5\ny\n") == "...\nmean 2.5\n...\n"
    assert refreshed("old\n", "new\nlines\n") == "new\nlines\n"
    with pytest.raises(SnippetError, match="any more"):
        refreshed("...\ngone 1\n", "x\n")


@pytest.fixture
def page(tmp_path, monkeypatch):
    monkeypatch.setattr(snippets, "ROOT", tmp_path)
    (tmp_path / "urdf").mkdir()
    (tmp_path / "docs").mkdir()
    return tmp_path / "page.md"


def test_a_failing_snippet_is_an_error_with_page_and_line(page):
    for text, message in (
        ("# Page\n\n```python\n1 / 0\n```\n", r"page.md, line 3: fails:[\s\S]*ZeroDivisionError"),
        ("```sh\nfalse\n```\n", "page.md, line 1: `false` ended with exit code 1"),
        ('```sh\necho 1\n```\n\n```text title="Output"\n2\n```\n', "page.md, line 5: prints '1'"),
    ):
        page.write_text(text)
        with pytest.raises(SnippetError, match=message):
            run_page(page)


def test_a_refreshed_page_passes(page):
    page.write_text('```sh\necho 1\n```\n\n```text title="Output"\nold\n```\n\nEnd.\n')
    run_page(page, write=True)
    assert page.read_text() == '```sh\necho 1\n```\n\n```text title="Output"\n1\n```\n\nEnd.\n'
    run_page(page)
