"""The page about the paper is filled, from files that carry the paper's printed values."""

import csv
import re

import make_paper_page
import pytest
from snippets import DOCS, ROOT

PAGE = (DOCS / "paper.md").read_text(encoding="utf-8")


def test_every_place_is_filled():
    places = re.findall(r"<!-- begin (\S+) -->\n(.*?)<!-- end -->", PAGE, re.DOTALL)
    assert len(places) >= 6
    for source, content in places:
        assert content.count("\n") > 3, source


@pytest.mark.parametrize(("place", "number"), [("study/table2.csv", 2), ("experiment/table4.csv", 4)])
def test_the_rows_of_the_paper_have_its_printed_values(place, number):
    content = re.search(rf"<!-- begin {place} -->(.*?)<!-- end -->", PAGE, re.DOTALL)[1]
    with (ROOT / "medrue" / "paper" / f"table{number}.csv").open() as file:
        printed = {row["error_mm"]: row for row in csv.DictReader(file)}
    header = [cell.strip() for cell in content.strip().splitlines()[0].split("|")[1:-1]]
    for kind, values in printed.items():
        line = next(line for line in content.splitlines() if line.startswith(f"| {kind}, paper"))
        row = dict(zip(header, (cell.strip() for cell in line.split("|")[1:-1]), strict=True))
        for name, value in values.items():
            if name != "error_mm":
                assert float(row[name]) == pytest.approx(float(value), abs=5e-4), (kind, name)


def test_figures_of_the_page_are_there_and_no_others():
    shown = set(re.findall(r"figures/paper/([\w.-]+)\)", PAGE))
    assert shown == {path.name for path in (DOCS / "figures" / "paper").iterdir()}


def test_a_csv_becomes_a_table(tmp_path):
    (tmp_path / "t.csv").write_text('# comment\nerror [mm],before,O1\n"mean, paper",11.474,0.014\nn,84,\n')
    assert make_paper_page.table(tmp_path / "t.csv") == (
        "| error [mm] | before | O1 |\n|---|---:|---:|\n| mean, paper | 11.474 | 0.0140 |\n| n | 84 |  |\n"
    )
