"""MedRUE's extended model, and the simulated measurement from both sides that identifies it."""

import numpy as np
import pinocchio as pin
import pytest

from calib.core.robots.jacobian import linearise
from calib.core.robots.terms.term import Context
from medrue import robot_file
from medrue.both_sides import EXTENDED, PAPER, WAYS, run_both_sides
from medrue.both_sides_tables import (
    GOAL,
    NOISE,
    both_sides_findings,
    component_rms,
    extended_parameter_table,
    mean_x,
    pose_count_table,
)
from medrue.draws import PoseSet, Work
from medrue.imperfections import STRAIGHT, Imperfections, RailErrors, from_direction, imperfect_robot
from medrue.paper_tables import table3
from medrue.workspace import target_workspace

pytestmark = pytest.mark.quick(0)

EITHER, ONE = WAYS[2:]


@pytest.fixture(scope="module")
def both_sides(robot, extended):
    """One robot; 42 uniform poses, and 10 chosen ones."""
    joints = np.array(target_workspace().q)[::4]
    first, seeds = PoseSet("uniform", np.flatnonzero(np.arange(105) % 5 < 2)), np.random.SeedSequence(7).spawn(1)
    return run_both_sides(robot, extended, joints, first, (10,), Imperfections(), seeds, Work())


def cells(table):
    return {column.header: column.values for column in table.columns}


def test_the_extended_description_has_the_mechanism_of_the_paper_s(robot, extended):
    for key in ("urdf", "name_mot", "closed_loop", "type", "closed_loop_axes", "home", "base", "targets", "sigma"):
        assert getattr(extended.description, key) == getattr(robot.description, key), key
    joints = np.array(target_workspace().q[::60])
    assert np.abs(extended.positions(joints) - robot.positions(joints)).max() < 1e-12


def test_every_origin_has_six_components(extended):
    names = {parameter.name for parameter in extended.parameters}
    origins = {joint.name for joint in extended.urdf.joints}
    assert names >= {f"{name}.{part}" for name in origins for part in ("x", "y", "z", "rx", "ry", "rz")}
    assert len(names) == 6 * len(origins) + 4 > 80


def test_positions_from_both_sides_determine_54_combinations(extended):
    """The loops of the planar five-bars take no tilt of the links from A to E, but for its square."""
    q = np.array(target_workspace().q[::4])
    sides = Context.from_conditions(from_direction(np.tile([1.0, -1.0], len(q))), {})
    jacobian = linearise(extended, extended.assemble(np.repeat(q, 2, axis=0), context=sides)).jacobian
    scaled = jacobian.reshape(-1, len(extended.parameters)) * [parameter.sigma_si for parameter in extended.parameters]
    values = np.linalg.svd(scaled, compute_uv=False)
    assert values[53] > 1e5 * values[54]
    unseen = {
        p.name for p, norm in zip(extended.parameters, np.linalg.norm(scaled, axis=0), strict=True) if norm < 1e-12
    }
    links = ("q2", "B1", "E1_B_origin", "q4", "B2", "E2_B_origin")
    assert unseen > {f"{name}.{tilt}" for name in links for tilt in ("ry", "rz")}
    assert not unseen & {f"{name}.{tilt}" for name in ("q3", "D1", "q5", "D2") for tilt in ("ry", "rz")}


def test_wear_and_bend_move_the_tool_as_the_docstring_says(robot, extended):
    actual, usual = robot.with_parameters(table3().identified), Imperfections(1e-3, 0.0, 0.0)
    joints, approach = np.array(target_workspace().q[::50]), np.tile([1.0, -1.0, 1.0], 3)

    def positions(rail):
        return imperfect_robot(extended, actual, usual, np.random.default_rng(1), rail).positions(joints, approach)

    x, y, z = pin.rpy.rpyToMatrix(*table3().identified[-6:-3]).T  # the base's axes in the world
    middle = np.sin(np.pi * joints[:, 0] / 0.7)
    worn = positions(RailErrors(0.0, 0.1, 0.0)) - positions(STRAIGHT)
    assert np.abs(worn - np.outer(-0.1 * 0.5e-3 * middle * approach, x)).max() < 1e-12
    bent = positions(RailErrors(0.0, 0.0, 1e-5)) - positions(STRAIGHT)
    assert np.abs(bent - np.outer(1e-5 * middle, y + z)).max() < 1e-12
    turns = positions(RailErrors(1e-5, 0.0, 0.0)) - positions(STRAIGHT)
    assert np.abs(turns @ x).max() <= 1e-5 + 1e-12
    assert np.abs(turns - np.outer(turns @ x, x)).max() < 1e-12


def test_the_x_error_falls_to_the_noise_from_both_sides_and_only_with_the_extended_model(both_sides):
    mean, rms = mean_x(both_sides, EXTENDED)[0, 0], component_rms(both_sides, EXTENDED)[0]
    assert mean < GOAL / 2
    assert NOISE < rms[0] < 1.4 * NOISE
    assert mean_x(both_sides, PAPER)[0, 0] > 10 * mean
    assert mean_x(both_sides, ONE)[0, 0] > 10 * mean  # backlash cannot be seen from one side
    assert mean < mean_x(both_sides, EITHER)[0, 0] < 3 * mean  # half of the visits


def test_the_truth_has_what_the_extended_model_has_not(both_sides):
    """Backlash is found as it is on average over the poses: larger than at the rail's ends, where it is not worn."""
    table = cells(extended_parameter_table(both_sides))
    rows = {name: k for k, name in enumerate(table["parameter"])}
    worn = table["identified"][rows["q1.backlash"]] / table["actual"][rows["q1.backlash"]]
    assert 1.01 < worn < 1.05
    off = [
        abs(table["identified"][k] - table["actual"][k]) / table["std"][k]
        for k in rows.values()
        if k != rows["q1.backlash"]
    ]
    assert len(off) >= 8
    assert np.sqrt(np.mean(np.square(off))) < 2


def test_too_few_readings_for_the_model_leave_the_cell_empty(both_sides):
    """Ten poses from one side are 30 coordinates for 54 combinations."""
    table = pose_count_table(both_sides)
    content = cells(table)
    assert content["poses"] == ("42, the paper's", "10")
    assert content["extended, either side, mean x error [mm]"][1] is None
    assert content["extended, both sides, mean x error [mm]"][1] > 0
    assert "nan" not in table.csv()
    assert "simulated" in table.csv()
    text = " ".join(both_sides_findings(both_sides))
    assert "nan" not in text
    assert "Not even 10 are enough for" in text
    assert "extended, one side (no answer)" in text


def test_an_installed_or_checked_out_description_that_is_not_there_is_named():
    with pytest.raises(FileNotFoundError, match=r"medrue_missing\.yaml"):
        robot_file("medrue_missing")
