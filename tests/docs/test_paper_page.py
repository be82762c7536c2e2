"""The page about the paper is filled, from files that carry the paper's printed values, and is not out of date."""

import csv
import io
import re

import make_paper_page
import numpy as np
import pytest
from matplotlib import image
from snippets import DOCS, ROOT

from calib import load
from calib.planning.selection import select
from medrue import robot_file
from medrue.closed_form import forward
from medrue.error_before import base_placed, differences, errors_of
from medrue.paper_tables import error_table, table1, table3
from medrue.plots import exchange_figure, figure_files, workspace_figure
from medrue.poses import pose_facts, target_poses
from medrue.study import COUNT, SIGMA
from medrue.workspace import target_workspace

FIGURES = DOCS / "figures" / "paper"
PAGE = (DOCS / "paper.md").read_text(encoding="utf-8")


def _place(source: str) -> str:
    return re.search(rf"<!-- begin {source} -->\n(.*?)<!-- end -->", PAGE, re.DOTALL)[1]


def _rows(source: str) -> dict[str, dict[str, str]]:
    """Rows of a table of the page, by their first cell."""
    header, _, *lines = [
        [cell.strip() for cell in line.split("|")[1:-1]] for line in _place(source).strip().splitlines()
    ]
    return {line[0]: dict(zip(header, line, strict=True)) for line in lines}


def test_every_place_is_filled():
    places = re.findall(r"<!-- begin (\S+) -->\n(.*?)<!-- end -->", PAGE, re.DOTALL)
    assert len(places) >= 6
    for source, content in places:
        assert content.count("\n") > 3, source


@pytest.mark.parametrize(("place", "number"), [("study/table2.csv", 2), ("experiment/table4.csv", 4)])
def test_the_rows_of_the_paper_have_its_printed_values(place, number):
    with (ROOT / "medrue" / "paper" / f"table{number}.csv").open() as file:
        printed = {row["error_mm"]: row for row in csv.DictReader(file)}
    for kind, values in printed.items():
        (row,) = (row for name, row in _rows(place).items() if name.startswith(f"{kind}, paper"))
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


def test_the_workspace_is_told_as_it_is():
    robot = load(robot_file())
    facts = pose_facts(robot, target_poses(robot))
    assert _place("poses.json").strip() == make_paper_page.workspace(facts).strip()


def test_percentages_of_the_text_are_those_of_table_2():
    for statistic, words in (("mean", "the worst mean error is {} % above"), ("max", "the worst largest error {} %")):
        row = _rows("study/table2.csv")[f"{statistic}, mean over 200 draws of noise"]
        means = [float(cell) for name, cell in row.items() if name not in ("error [mm]", "before")]
        assert words.format(round(100 * (max(means) / min(means) - 1))) in " ".join(PAGE.split())


def test_figures_about_the_error_before_are_those_of_the_closed_form():
    q, (nominal_case, three) = np.array(target_workspace().q), (table1(), table3())
    errors = errors_of(differences(three.identified, q))
    nominal, true = (forward(q, parameters).p_world_tool for parameters in (nominal_case.nominal, three.identified))
    placed = errors_of(base_placed(nominal, true)).mean
    text = PAGE[PAGE.index("**The error before calibration") :]
    for value in (errors.smallest, errors.largest, errors.mean, placed):
        assert f"{value:.2f}" in text[:500]
    mean = errors_of(differences(nominal_case.actual, q)).mean
    ratio = mean / error_table(2)["before"]["mean"]
    assert f"over all 420 poses, {mean:.2f} mm, is {ratio:.2f} times the paper's" in PAGE


def numbers_and_rest(svg: str) -> tuple[np.ndarray, str]:
    number = r"-?\d+\.\d+"
    return np.array([float(item) for item in re.findall(number, svg)]), re.sub(number, "#", svg)


@pytest.mark.quick(0)
def test_figure_4_is_what_the_program_draws_now():
    robot = load(robot_file())
    selection = select(robot, np.array(target_workspace().q), COUNT, "O1", sigma=SIGMA)
    drawn = figure_files(exchange_figure(selection), "figure4")["figure4.svg"].decode()
    kept = (FIGURES / "study-figure4.svg").read_text(encoding="utf-8")
    (now, rest), (then, rest_then) = numbers_and_rest(drawn), numbers_and_rest(kept)
    assert rest == rest_then
    assert np.abs(now - then).max() < 0.01  # points of a page


def test_figure_3_is_what_the_program_draws_now():
    drawn = io.BytesIO(figure_files(workspace_figure(target_workspace()), "figure3")["figure3.png"])
    now, then = (image.imread(source) for source in (drawn, FIGURES / "experiment-figure3.png"))
    assert now.shape == then.shape
    assert np.mean(np.abs(now - then) > 0.2) < 1e-3  # edges may be smoothed otherwise elsewhere


@pytest.mark.parametrize(
    ("figure", "table", "names"),
    [
        ("study-figure5", "study/table2.csv", ("before", "O1")),
        ("experiment-figure7", "experiment/table4.csv", ("before", "O1")),
    ],
)
def test_figures_of_errors_are_from_the_same_run_as_the_tables(figure, table, names):
    """A figure's legend is kept with it as text."""
    text = (FIGURES / f"{figure}.png").read_bytes()[:2000].decode("latin-1")
    shown = re.findall(r"mean ([\d.]+) mm; largest ([\d.]+) mm", text)
    for name, values in zip(names, shown, strict=True):
        for statistic, value in zip(("mean", "max"), values, strict=True):
            assert float(value) == pytest.approx(float(_rows(table)[f"{statistic}, single draw"][name]), abs=6e-4)


def test_figure_8_is_from_the_same_run_as_table_5():
    text = (FIGURES / "experiment-figure8.png").read_bytes()[:2000].decode("latin-1")
    row = _rows("experiment/table5.csv")["mean, simulated"]
    expected = [float(row[f"{when} {axis}"]) for when in ("before", "after") for axis in "xyz"]
    assert [float(mean) for mean in re.findall(r"[xyz]: mean ([\d.]+)", text)] == pytest.approx(expected, abs=6e-4)
