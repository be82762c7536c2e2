"""A table of corrections: right at its nodes, and its error between them is what a controller would have."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import interpn

import calib
from calib.programs.languages.correction_grid import correction_grid
from calib.programs.reaching.inverse import solve
from tests.six_axis_arm import write_six_axis

GANTRY = (
    '<robot name="gantry"><link name="l0"/>'
    + "".join(
        f'<link name="l{k}"/><joint name="{name}" type="prismatic"><parent link="l{k - 1}"/><child link="l{k}"/>'
        f'<axis xyz="{axis}"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for k, (name, axis) in enumerate((("x", "1 0 0"), ("y", "0 1 0"), ("z", "0 0 1")), start=1)
    )
    + "</robot>"
)
YAML = """urdf: gantry.urdf
name_mot: [x, y, z]
base: {frame: l0}
targets: {nozzle: {frame: l3}}
parametrisation:
  - {origin: y, components: [rz], sigma: 5 mrad}
  - {joint: x, term: gain, sigma: 2.0e-3}
"""


def gantry(folder, more=""):
    """Three slides whose squareness in the plane and scale along x are free, and more."""
    (folder / "gantry.urdf").write_text(GANTRY)
    (folder / "gantry.yaml").write_text(YAML + more)
    return calib.load(folder / "gantry.yaml")


def test_a_gantry_gets_the_corrections_of_its_scale_and_squareness(tmp_path):
    """It stands at 1.001 x - sin(a) y, cos(a) y, z; so it must be told ((x + tan(a) y) / 1.001, y / cos(a), z)."""
    a = 2e-3
    robot = gantry(tmp_path).with_parameters({"y.rz": a, "x.gain": 1e-3})
    corners = calib.Goals(np.array([[-0.3, -0.2, 0.1], [0.5, 0.4, 0.1]]))
    grid = correction_grid(robot, corners, (3, 4, 1))
    x, y, z = grid.nodes.T
    told = np.stack([(x + np.tan(a) * y) / 1.001, y / np.cos(a), z], axis=1)
    assert len(grid.nodes) == 12
    assert np.abs(grid.nodes + grid.shift - told).max() < 1e-9
    assert grid.position_errors.max() < 1e-9  # linear in the position
    assert not grid.turn.any()


def test_an_arm_with_the_table_stands_where_the_table_says(tmp_path):
    free = "  - {origin: all, components: [x, y, z], sigma: 1 mm}\n"
    yaml = "urdf: arm.urdf\nname_mot: [j1, j2, j3, j4, j5, j6]\nbase: {frame: l0}\ntargets:\n"
    robot = calib.load(write_six_axis(tmp_path, f"{yaml}  ball: {{frame: l6}}\nparametrisation:\n{free}"))
    rng = np.random.default_rng(0)
    truth = robot.with_parameters({p.name: p.nominal_si + p.sigma_si * rng.standard_normal() for p in robot.parameters})
    R = pin.rpy.rpyToMatrix(0.2, 0.4, 0.1)
    box = calib.Goals(np.array([[0.5, -0.1, 0.6], [0.7, 0.1, 0.8]]), np.tile(R, (2, 1, 1)))
    grid = correction_grid(truth, box, (5, 5, 5))
    assert grid.angle_errors.max() < 1e-3
    axes = [np.unique(grid.nodes[:, k]) for k in range(3)]
    goals = rng.uniform([0.5, -0.1, 0.6], [0.7, 0.1, 0.8], (30, 3))
    table = np.hstack([grid.shift, grid.turn]).reshape(5, 5, 5, 6)
    add = np.stack([interpn(axes, table[..., k], goals) for k in range(6)], axis=1)
    turned = np.array([pin.exp3(turn) @ R for turn in add[:, 3:]])
    q = solve(robot, calib.Goals(goals + add[:, :3], turned)).q  # what the nominal controller makes of it
    off = np.linalg.norm(truth.positions(q)[:, 0] - goals, axis=1)
    plain = solve(robot, calib.Goals(goals, np.tile(R, (30, 1, 1)))).q
    before = np.linalg.norm(truth.positions(plain)[:, 0] - goals, axis=1)
    assert off.max() < 1.5 * grid.position_errors.max()
    assert off.max() < 0.05 * before.max()


@pytest.mark.parametrize(
    ("positions", "counts", "message"),
    [
        ([[0, 0, 0], [0.5, 0.5, 0.5]], (1, 3, 3), "1 node along x, where the program extends"),
        ([[0, 0, 0], [0.5, 0, 0.5]], (2, 2, 2), "2 nodes along y, where the program does not extend"),
        ([[0, 0, 0], [0.5, 0.5, 0.5]], (2, 0, 2), "0 nodes along y"),
        ([[0, 0, 0], [0.5, 0.5, 0.5]], (99, 99, 99), "more than 100000 nodes"),
        ([[0, 0, 0]], (1, 1, 1), "a single position"),
        ([[0, 0, 0], [1.5, 0.5, 0.5]], (2, 2, 2), "of the grid cannot be reached"),
    ],
)
def test_what_makes_no_grid_is_refused(tmp_path, positions, counts, message):
    with pytest.raises(calib.CalibrationError, match=message):
        correction_grid(gantry(tmp_path), calib.Goals(np.array(positions, dtype=float)), counts)


def test_several_orientations_or_none_are_refused(tmp_path):
    (tmp_path / "arm").mkdir()
    robot = calib.load(write_six_axis(tmp_path / "arm"))
    two = np.array([[0.5, -0.1, 0.6], [0.7, 0.1, 0.8]])
    with pytest.raises(calib.DataError, match="depends on the orientation; give ball_rx"):
        correction_grid(robot, calib.Goals(two, target="ball"), (2, 2, 2))
    rotations = np.array([np.eye(3), pin.rpy.rpyToMatrix(0, 0, 0.1)])
    with pytest.raises(calib.DataError, match="goal 2: has another orientation"):
        correction_grid(robot, calib.Goals(two, rotations, target="ball"), (2, 2, 2))
