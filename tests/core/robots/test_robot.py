"""The robot: immutability, pickling, frames by name, and joint values that cannot be."""

import pickle
import re

import numpy as np
import pytest

import calib
from calib.core.base.errors import DataError, DescriptionError, UnreachablePoseError
from calib.core.robots.configurations import near_singularities
from tests.small_robots import ARM_URDF, ARM_YAML, small_arm, write_arm, write_parallelogram


def snapshot(robot):
    return (
        robot.values.tobytes(),
        robot.calibrated_urdf(),
        [placement.homogeneous.tobytes() for placement in list(robot.mechanism.model.jointPlacements)],
        robot.positions(robot.home).tobytes(),
    )


def test_with_parameters_leaves_the_old_robot_as_it_was(tmp_path, medrue):
    for robot in (medrue, small_arm(tmp_path)):
        before = snapshot(robot)
        changed = robot.with_parameters(robot.values + 1e-3)
        assert snapshot(robot) == before
        assert snapshot(changed) != before
        assert snapshot(changed.with_parameters(robot.values)) == before
        assert changed.with_parameters({}).values.tolist() == changed.values.tolist()

        values = robot.values.copy()
        copied = robot.with_parameters(values)
        values[:] = 7.0
        assert copied.values.tolist() == robot.values.tolist()


def test_nothing_of_a_robot_can_be_written_to(medrue):
    for robot in (medrue, medrue.with_parameters(medrue.values), pickle.loads(pickle.dumps(medrue))):
        mechanism = robot.mechanism
        names = ("support", "select_actuated", "select_passive", "constant", "lower", "upper")
        arrays = [robot.values, robot.home, robot.assemble(robot.home).actuated]
        mode = (
            robot.mode.actuated,
            robot.mode.passive,
            robot.mode.signs,
            *robot.mode.block_rows,
            *robot.mode.block_columns,
        )
        for array in (*arrays, *mode, *(getattr(mechanism, name) for name in names)):
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0.0
    with pytest.raises(AttributeError):
        medrue.values = np.zeros(36)
    with pytest.raises(AttributeError):
        medrue.mechanism.length = 1.0


def test_forward_takes_one_pose_or_many_and_any_frame(tmp_path):
    robot = small_arm(tmp_path)
    q = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    both = robot.forward(q, "tip")
    assert both.shape == (2, 4, 4)
    assert np.array_equal(robot.forward(q[1], "tip"), both[1])
    assert np.array_equal(robot.forward(q), both)  # the first target
    assert np.array_equal(robot.forward(q, "flange"), robot.forward(q, "tool"))  # a joint's frame is its child's
    assert np.array_equal(robot.forward(q, "ground"), np.tile(np.eye(4), (2, 1, 1)))
    assert np.abs(robot.positions(q)[:, 0] - both[:, :3, 3]).max() < 1e-15
    tool = robot.forward(q, "tool")
    assert np.abs(tool[:, :3, :3] @ [0.01, 0.02, 0.03] + tool[:, :3, 3] - both[:, :3, 3]).max() < 1e-15


def test_no_poses_at_all_are_no_error(medrue, tmp_path):
    for robot in (medrue, small_arm(tmp_path)):
        assert robot.positions(np.zeros((0, len(robot.home)))).shape == (0, 1, 3)


@pytest.mark.parametrize(
    ("q", "message"),
    [
        ([0.0, 0.0], r"joint values of shape \(2,\); expected \(n, 3\) in the order turn, slide, wrist"),
        (np.zeros((1, 1, 3)), r"joint values of shape \(1, 1, 3\)"),
        (0.0, r"joint values of shape \(\); expected"),
        ([[0, 0, 0], [0, np.nan, 0]], "pose 1: joint 'slide' is not finite"),
        ([0.1, 1e300, 0.2], "pose 0: joint 'slide' is .* m or rad, which no robot reaches"),
    ],
)
def test_joint_values_that_cannot_be_are_errors(tmp_path, q, message):
    with pytest.raises(DataError, match=message):
        small_arm(tmp_path).positions(q)


def test_an_unknown_frame_names_the_nearest(tmp_path):
    with pytest.raises(DescriptionError, match="no link or joint 'tol'; did you mean 'tool'"):
        small_arm(tmp_path).forward([0, 0, 0], "tol")


def test_a_pose_that_cannot_be_assembled_is_an_error_that_says_by_how_much(tmp_path):
    """Crank 0.5, coupler 1, rocker 0.25, ground 1 m: at a = 180 deg, 1.5 m are to be spanned with 1.25 m."""
    yaml = write_parallelogram(tmp_path)
    urdf = yaml.with_suffix(".urdf")
    urdf.write_text(re.sub('(rocker_end"/> <origin xyz=")0.5', r"\g<1>0.25", urdf.read_text()))
    b, c = four_bar(np.radians(75), 0.5, 1.0, 0.25)
    yaml.write_text(re.sub("home: .*", f"home: {{a: 75 deg, b: {b!r}, c: {c!r}}}", yaml.read_text()))
    with pytest.raises(UnreachablePoseError) as caught:
        calib.load(yaml).positions([[np.radians(80)], [np.pi], [np.pi]])
    assert str(caught.value) == (
        "pose 1 (and 1 more poses): loop rocker_end-coupler_end stays open by 250.000 mm at best;"
        " check these joint values, or leave the pose out"
    )


def four_bar(a, crank, coupler, rocker):
    """Passive joints of a four-bar with ground (1, 0), elbow down, from the intersection of two circles."""
    B = crank * np.exp(1j * a)
    d = abs(1 - B)
    along = (coupler**2 - rocker**2 + d**2) / (2 * d)
    E = B + (1 - B) / d * (along + 1j * np.sqrt(coupler**2 - along**2))
    return float(np.angle(E - B) - a), float(np.angle(E - 1))


def test_a_robot_prints_as_one_short_line(medrue):
    assert len(repr(medrue)) < 200
    assert "36 parameters" in repr(medrue)


def test_a_urdf_elsewhere_is_found_from_its_description_whatever_the_suffix_and_kind_of_path(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "urdfs").mkdir()
    (tmp_path / "urdfs" / "arm.urdf").write_text(ARM_URDF)
    (tmp_path / "sub" / "ARM.YML").write_text(ARM_YAML.replace("arm.urdf", "../urdfs/arm.urdf"))
    assert calib.load(str(tmp_path / "sub" / "ARM.YML")).name == "small arm"


def test_a_name_of_target_and_link_means_the_link_and_no_name_the_target(tmp_path):
    """A plain URDF's target is called like its last link, and may be calibrated to lie elsewhere on it."""
    urdf = write_arm(tmp_path).with_suffix(".urdf")
    robot = calib.load(urdf)
    (target,) = robot.target_names
    moved = robot.with_parameters({f"{target}.x": 0.05})
    q = np.array([0.1, 0.2, 0.3])
    assert np.allclose(moved.forward(q)[:3, 3], moved.positions(q)[0, 0], atol=1e-15)
    assert np.array_equal(moved.forward(q, target), robot.forward(q, target))
    assert np.linalg.norm(moved.forward(q)[:3, 3] - moved.forward(q, target)[:3, 3]) == pytest.approx(0.05)


def test_poses_near_a_singularity_of_the_loops_are_named(tmp_path):
    """The parallelogram is flat, and singular, at 0 and 180 degrees."""
    robot = calib.load(write_parallelogram(tmp_path))
    q = np.radians([[90.0], [1.0]])
    (remark,) = near_singularities(robot, robot.assemble(q), ["far", "near"])
    assert remark.startswith("near: ")
    assert remark.endswith("from a singularity of the loops (limit 0.02)")
