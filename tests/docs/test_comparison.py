"""The pages of public data: their tables have makers, and numbers of this project are found again where data are."""

import re

import pytest
from snippets import DOCS

import calib
from tests import public_data
from tests.public_data import markdown, written


def test_the_page_has_what_a_fit_gives(shared_data):
    """The line of this project is found again, by another reading of the same files, with the priors of the page."""
    priors = ("2 mm}", "1 mm}"), ("5 mrad}", "3 mrad}")
    robot, train, test = public_data.motoman(shared_data / "motoman_right", *priors)
    validation = calib.fit(robot, train, validation=test).validation
    page = (DOCS / "comparison.md").read_text()
    starts = ("| RMS of", "| Motoman: the owners")
    names, cells = (next(line.split(" | ") for line in page.splitlines() if line.startswith(start)) for start in starts)
    row = dict(zip(names, cells, strict=True))
    for column, state in (("nominal robot, placed", "before"), ("this project", "after")):
        rms = re.match(r"[* ]*([\d.]+)", row[column])[1]
        assert float(rms) == pytest.approx(1e3 * validation.rms(state), abs=0.0011)  # printed to 0.001 mm


def test_tables_of_public_data_are_written_between_their_marks(tmp_path):
    page = DOCS / "benchmarks.md"
    makers = {name.removeprefix("tables_") for name in vars(public_data) if name.startswith("tables_")}
    assert set(re.findall(r"<!-- begin (\w+) -->", page.read_text())) == makers | {"files"}
    copy = tmp_path / "page.md"
    copy.write_text("Before.\n<!-- begin arm -->\nold\n<!-- end arm -->\nAfter.\n")
    for _ in range(2):  # written again, it stays as it is
        written(copy, "arm", markdown(["", "mm"], [["origins", 0.5]]))
        assert copy.read_text() == (
            "Before.\n<!-- begin arm -->\n\n|  | mm |\n|---|---:|\n| origins | 0.5 |\n\n<!-- end arm -->\nAfter.\n"
        )
    with pytest.raises(SystemExit, match="has no place for leg"):
        written(copy, "leg", "")
