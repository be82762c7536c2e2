"""The `medrue` program: what it writes, and how it refuses."""

import csv
import json

import numpy as np
import pytest
from click.testing import CliRunner

from medrue.cli import group
from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.study import StudySize
from medrue.workspace import target_workspace
from tests.medrue.medrue_folders import check_folder


def medrue(*arguments):
    return CliRunner().invoke(group, list(arguments))


@pytest.fixture
def few(monkeypatch):
    """Two indices and two draws, which is enough to see every file."""
    monkeypatch.setattr("medrue.study.INDICES", ("O1", "O5"))
    monkeypatch.setattr("medrue.study.QUICK", StudySize(2, 2, 1))


@pytest.mark.quick(0)
def test_poses_are_those_of_the_closed_form(tmp_path):
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


@pytest.mark.amount(0, 1)
@pytest.mark.usefixtures("few")
def test_study_writes_every_table_and_figure_and_one_page(tmp_path):
    out = tmp_path / "study"
    run = medrue("study", "--quick", "--jobs", "1", "--out", str(out), "--json", "-")
    assert run.exit_code == 0, run.output
    content = json.loads(run.stdout)
    tables = {"table1", "table2", "ranking", "floor", "observability"}
    assert set(content["tables"]) == tables
    assert content["seed"] == 1
    check_folder(out, tables, {"figure4", "figure5", "errors_over_draws"})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("poses", "--out", "{}/missing/poses.csv"), "cannot be written"),
        (("poses",), "--out"),
        (("study", "--out", "{}/file"), "not a folder"),
        (("study", "--out", "{}/x", "--jobs", "0"), "--jobs"),
        (("study", "--out", "{}/x", "--seed", "-1"), "--seed"),
        (("study", "--out", "{}/x", "--draws", "1"), "--draws"),
        (("touch", "--out", "{}/x", "--draws", "1"), "--draws"),
        (("experiment", "--out", "{}/x", "--backlash-mm", "-1"), "--backlash-mm"),
        (("experiment", "--out", "{}/x", "--backlash-mm", "nan"), "--backlash-mm"),
        (("experiment", "--out", "{}/x", "--lead-um", "inf"), "--lead-um"),
        (("experiment", "--out", "{}/x", "--tilt-deg", "nan"), "--tilt-deg"),
        (("experimnt", "--out", "{}/x"), "No such command"),
    ],
)
def test_wrong_input_is_refused_before_anything_is_computed(tmp_path, arguments, message):
    (tmp_path / "file").write_text("")
    run = medrue(*(argument.format(tmp_path) for argument in arguments))
    assert run.exit_code == 2
    assert message in run.output
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
