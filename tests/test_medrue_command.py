"""The `medrue` program: what it writes, and how it refuses."""

import csv
import json
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from calib import load, read_measurements
from calib.base.own_files import MANIFEST
from medrue import robot_file
from medrue.cli import group
from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.study import StudySize
from medrue.workspace import target_workspace


def medrue(*arguments: str) -> Result:
    return CliRunner().invoke(group, list(arguments))


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two indices and two draws, which is enough to see every file."""
    monkeypatch.setattr("medrue.study.INDICES", ("O1", "O5"))
    monkeypatch.setattr("medrue.study.QUICK", StudySize(2, 2, 1))
    monkeypatch.setattr("medrue.experiment.QUICK_DRAWS", 2)
    monkeypatch.setattr("medrue.both_sides.QUICK_COUNTS", (28,))


def test_poses_are_those_of_the_closed_form(tmp_path: Path) -> None:
    out = tmp_path / "poses.csv"
    run = medrue("poses", "--out", str(out), "--json", str(tmp_path / "facts.json"))
    assert run.exit_code == 0, run.output
    lines = [line for line in out.read_text().splitlines() if not line.startswith("#")]
    header = "pose,q1 [mm],q2 [deg],q3 [deg],q4 [deg],q5 [deg],q6 [deg],tool_x [mm],tool_y [mm],tool_z [mm]"
    assert lines[0] == header
    values = np.array([[float(cell) for cell in row] for row in csv.reader(lines[1:])])
    assert values.shape == (420, 10)
    q = np.hstack([values[:, 1:2] / 1e3, np.radians(values[:, 2:7])])
    assert np.abs(q - target_workspace().q).max() < 1e-10
    assert np.abs(values[:, 7:] / 1e3 - forward(q, table1().nominal).p_world_tool).max() < 1e-12
    facts = json.loads((tmp_path / "facts.json").read_text())
    assert facts["poses"] == 420
    assert facts["largest_difference_from_closed_form_m_rad"] < 1e-10
    assert facts["smallest_singular_value_of_the_loops"] > 0.02  # the limit of the robot description
    assert facts["different_x_and_angles"] == [28, 15]
    assert facts["positions_along_x_mm"] == pytest.approx([-100.5, 574.5])
    assert facts["positions_from_y_towards_z_deg"] == pytest.approx([56.0, 224.0])


class Checker(HTMLParser):
    """Counts tables and images, and remembers links."""

    def __init__(self) -> None:
        super().__init__()
        self.counts: dict[str, int] = {}
        self.links: list[str] = []

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.counts[tag] = self.counts.get(tag, 0) + 1
        self.links += [value for name, value in attributes if name == "href" and value]


def check_folder(folder: Path, tables: set[str], figures: set[str], data: tuple[str, ...] = ()) -> None:
    expected = {f"{name}.{kind}" for name in tables for kind in ("csv", "json")}
    expected |= {f"{name}.{kind}" for name in figures for kind in ("png", "svg")} | {"index.html", *data}
    assert {path.name for path in folder.iterdir()} - {MANIFEST} == expected
    for name in figures:
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert "<text" in (folder / f"{name}.svg").read_text()  # not outlines
    for name in tables:
        content = json.loads((folder / f"{name}.json").read_text())
        assert content["simulated"] is True
        assert content["rows"]
    text = (folder / "index.html").read_text()
    page = Checker()
    page.feed(text)
    assert page.counts["table"] == len(tables)
    assert page.counts["img"] == len(figures)
    assert set(page.links) == expected - {"index.html"}
    assert "Simulated" in text
    plain = text.replace("http://www.w3.org", "").replace("http-equiv", "")
    assert "http" not in plain  # asks nobody for anything


@pytest.mark.usefixtures("few")
def test_study_writes_every_table_and_figure_and_one_page(tmp_path: Path) -> None:
    out = tmp_path / "study"
    run = medrue("study", "--quick", "--jobs", "1", "--out", str(out), "--json", "-")
    assert run.exit_code == 0, run.output
    content = json.loads(run.stdout)
    tables = {"table1", "table2", "ranking", "floor", "observability"}
    assert set(content["tables"]) == tables
    assert content["seed"] == 1
    check_folder(out, tables, {"figure4", "figure5", "errors_over_draws"})


@pytest.mark.usefixtures("few")
def test_experiment_writes_every_table_and_figure_and_one_page(tmp_path: Path) -> None:
    out = tmp_path / "experiment"
    run = medrue("experiment", "--quick", "--jobs", "1", "--out", str(out), "--seed", "5")
    assert run.exit_code == 0, run.output
    assert "Table IV" in run.output
    assert "mostly along x" in run.output
    tables = {"table3", "table4", "ranking", "table5", "causes", "pose_count", "extended"}
    check_folder(out, tables, {"figure3", "figure7", "figure8", "causes", "pose_count"}, ("both_sides.csv",))
    page = (out / "index.html").read_text()
    assert "backlash of the rail of 0.8 mm" in page
    assert "@media print" in page
    extended = load(robot_file("medrue_extended"))
    data = read_measurements(out / "both_sides.csv", extended)
    assert len(data) == len(set(data.names)) == 840
    assert np.abs(data.approach_directions.sum(axis=0)).tolist() == [0.0] * 6  # each pose from both sides
    assert np.all(np.abs(data.approach_directions[:, 0]) == 1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("poses", "--out", "{}/missing/poses.csv"), "cannot be written"),
        (("poses",), "--out"),
        (("study", "--out", "{}/file"), "not a folder"),
        (("study", "--out", "{}/x", "--jobs", "0"), "--jobs"),
        (("study", "--out", "{}/x", "--seed", "-1"), "--seed"),
        (("study", "--out", "{}/x", "--draws", "1"), "--draws"),
        (("touch",), "--out"),
        (("touch", "--out", "{}/file"), "not a folder"),
        (("touch", "--out", "{}/x", "--jobs", "none"), "--jobs"),
        (("touch", "--out", "{}/x", "--seed", "1.5"), "--seed"),
        (("touch", "--out", "{}/x", "--draws", "1"), "--draws"),
        (("experiment", "--out", "{}/x", "--backlash-mm", "-1"), "--backlash-mm"),
        (("experiment", "--out", "{}/x", "--backlash-mm", "nan"), "--backlash-mm"),
        (("experiment", "--out", "{}/x", "--backlash-mm", "inf"), "--backlash-mm"),
        (("experiment", "--out", "{}/x", "--lead-um", "inf"), "--lead-um"),
        (("experiment", "--out", "{}/x", "--lead-um", "nan"), "--lead-um"),
        (("experiment", "--out", "{}/x", "--tilt-deg", "5"), "--tilt-deg"),
        (("experiment", "--out", "{}/x", "--tilt-deg", "nan"), "--tilt-deg"),
        (("experimnt", "--out", "{}/x"), "No such command"),
    ],
)
def test_wrong_input_is_refused_before_anything_is_computed(
    tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    (tmp_path / "file").write_text("")
    run = medrue(*(argument.format(tmp_path) for argument in arguments))
    assert run.exit_code == 2
    assert message in run.output
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
