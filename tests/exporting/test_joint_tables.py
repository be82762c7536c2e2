"""Joint correction tables: the Python and the C that are written with them agree with the engine."""

import numpy as np
import pytest

import calib
from calib.core.robots.joint_errors import actual_joints, term_columns
from calib.core.robots.terms.term import Context
from calib.exporting.joint_tables import joint_table_files, joint_tables, lost_by_tables
from tests.exporting.read_back import table_rows
from tests.small_robots import ARM_YAML, write_arm

TERMS = """\
  - {joint: all, term: gain}
  - {joint: turn, term: curve, orders: 40, sigma: 0.5 mrad}
  - {joint: slide, term: harmonics, period: 5 mm, orders: [1, 2], sigma: 30 um}
  - {joint: wrist, term: harmonics, orders: [1, 51], sigma: 0.5 mrad}
"""
BEYOND = """  - {joint: slide, term: backlash}
  - {joint: turn, term: drift}
  - {joint: wrist, term: coupling, driven_by: turn}
  - {joint: all, term: temperature}
"""


def robot_with(folder, terms=TERMS):
    nominal = calib.load(write_arm(folder, ARM_YAML + terms))
    generator = np.random.default_rng(3)
    return nominal.with_parameters(nominal.values + [p.sigma_si * generator.normal() for p in nominal.parameters])


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    return robot_with(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def folder(robot, tmp_path_factory):
    """The files of its tables."""
    path = tmp_path_factory.mktemp("tables")
    for name, content in joint_table_files(robot).items():
        (path / name).write_bytes(content)
    return path


@pytest.fixture(scope="module")
def commands():
    """Commands over the joints' whole ranges, their limits included."""
    inside = np.random.default_rng(4).uniform([-3, 0, -6.28], [3, 1, 6.28], (3000, 3))
    return np.vstack([inside, [[-3, 0, -2 * np.pi], [3, 1, 2 * np.pi]]])


def table_of(folder, joint):
    """Commanded and actual values of a joint."""
    own = [row for row in table_rows(folder / "joint_tables.csv") if row["joint"] == joint]
    return [np.array([float(row[key]) for row in own]) for key in ("commanded", "actual")]


def test_the_tables_agree_with_the_engine_both_ways(robot, folder, commands):
    actual, told = actual_joints(robot, commands, term_columns(robot, commands)), np.empty_like(commands)
    assert np.abs(actual - commands).max() > 1e-4  # there is something to correct
    for j, joint in enumerate(robot.joint_names):
        table = table_of(folder, joint)
        assert np.abs(np.interp(commands[:, j], *table) - actual[:, j]).max() < 1e-6
        told[:, j] = np.interp(commands[:, j], *table[::-1])
        assert table[1][0] <= commands[:, j].min()
        assert table[1][-1] >= commands[:, j].max()
    assert np.abs(actual_joints(robot, told, term_columns(robot, told)) - commands).max() < 1e-6


def test_the_csv_holds_the_same_numbers(robot, folder):
    assert lost_by_tables(robot) == []
    for table in joint_tables(robot):
        np.testing.assert_array_equal(table_of(folder, table.joint), [table.commands, table.actual])
        units = {row["unit"] for row in table_rows(folder / "joint_tables.csv") if row["joint"] == table.joint}
        assert units == {"m" if table.joint == "slide" else "rad"}


def test_a_bound_of_the_curvature_holds_and_is_no_guess(robot):
    q = np.zeros((20001, 3))
    for term, values in robot.term_values():
        j = robot.joint_names.index(term.joint)
        q[:, j] = np.linspace(-0.5, 0.5, len(q))
        error = term.columns(q, j, Context.neutral(*q.shape)) @ values
        second = np.diff(error, 2) / (q[1, j] - q[0, j]) ** 2
        bound = term.curvature(values)
        assert np.abs(second).max() <= bound * 1.001 + 1e-3
        assert bound < 20 * np.abs(second).max() + 1e-3


def test_what_depends_on_more_is_left_out_and_said_with_its_size(tmp_path, run_calib, robot):
    sizes = {"slide.backlash": -2e-4, "turn.drift": 1e-4, "wrist.by_turn": 3e-4}
    more = robot_with(tmp_path, TERMS + BEYOND).with_parameters(sizes)
    left = lost_by_tables(more)
    assert "slide: backlash is not in the table, because it depends on the direction of approach: 0.2 mm" in left[0]
    assert "turn: drift is not in the table, because it depends on time: 0.1 mrad per hour remains" in left[1]
    per_radian = "0.3 mrad per rad or m of it remains"
    assert f"wrist: coupling is not in the table, because it depends on another joint: {per_radian}" in left[2]
    assert len(left) == 6
    for table, same in zip(joint_tables(more), joint_tables(robot), strict=True):
        assert np.array_equal(table.actual, same.actual)
    (tmp_path / "values.csv").write_text("parameter,value,unit\nslide.backlash,0.2,mm\nturn.gain,1,mrad\n")
    arguments = ("--parameters", "values.csv", "--format", "joint-tables", "--out", "tables")
    run = run_calib("export", "arm.yaml", *arguments, cwd=tmp_path)
    assert (run.code, run.err.count("\n")) == (3, 1)  # these tables may belong to the backlash
    assert "loses the joint terms of slide" in run.err
    run = run_calib("export", "arm.yaml", *arguments, "--force", cwd=tmp_path)
    assert run.code == 0, run.err
    assert "note: slide: backlash is not in the table" in run.err
    assert "slide: backlash is not in the table" in (tmp_path / "tables" / "joint_tables.csv").read_text()
    assert np.interp(2.0, *table_of(tmp_path / "tables", "turn")) == pytest.approx(2.002, abs=1e-12)


@pytest.mark.parametrize(
    ("terms", "urdf", "message"),
    [
        ("", ("", ""), "has no joint terms that depend on the joint's own value alone"),
        ("  - {joint: slide, term: backlash}\n", ("", ""), "nothing to put into a table"),
        ("  - {joint: slide, term: gain}\n", ('lower="0" upper="1" ', ""), "slides without limits"),
        ("  - {joint: slide, term: harmonics, period: 1 um}\n", ("", ""), "would need"),
    ],
)
def test_what_gives_no_table_is_one_clear_line(tmp_path, run_calib, terms, urdf, message):
    path = write_arm(tmp_path, ARM_YAML + terms)
    (tmp_path / "arm.urdf").write_text((tmp_path / "arm.urdf").read_text().replace(*urdf))
    value = "slide.sin1,0.1,mm" if "period" in terms else "slide.x,251,mm"
    (tmp_path / "values.csv").write_text(f"parameter,value,unit\n{value}\n")
    arguments = ("--parameters", "values.csv", "--format", "joint-tables", "--out", "t")
    assert message in run_calib("export", path, *arguments, cwd=tmp_path).refusal()
    assert not (tmp_path / "t").exists()
