"""Pinocchio: the exported URDF against the closed form and calib, and the exported MJCF with its loops."""

import numpy as np
import pinocchio as pin
import pytest
import yaml

import calib
from calib.exporting.formats import export

ROUNDING = 1e-12
"""Poses are products of about 20 transforms of lengths up to 1 m, loops are closed to 1e-12 m."""


def test_tool_is_where_the_closed_form_says(case) -> None:
    for expected, links in zip(case.tool, case.poses, strict=True):
        assert np.abs(links["tool"][:3, 3] - expected).max() < ROUNDING


@pytest.mark.quick(0)
def test_every_link_is_where_calib_says(case) -> None:
    robot, q = case.robot, np.empty(6)

    def put(values: dict[str, float]) -> None:
        q[:] = [values[name] for name in robot.joint_names]

    largest = case.largest_difference("calib, URDF and description", put, lambda link: robot.forward(q, link))
    assert largest < 2e-12  # calib closes the loops to 1e-12 m


@pytest.mark.parametrize("file", ["robot.xml", "free.xml"])
def test_mjcf_puts_every_link_where_the_urdf_does_and_closes_the_loops(case, file: str) -> None:
    model, points, frames = pin.buildModelAndConstraintsFromMJCF(str(case.folder / file))
    assert (len(points), len(frames)) == (3, 0)
    data = model.createData()
    datas = [point.createData() for point in points]
    open_by = 0.0

    def move(values: dict[str, float]) -> None:
        nonlocal open_by
        put(model, data, values)
        for point, point_data in zip(points, datas, strict=True):
            point.calc(model, data, point_data)
            open_by = max(open_by, float(np.abs(point_data.constraint_position_error).max()))

    def pose(link: str):
        name = "world_link" if link == "world" else link
        return data.oMf[model.getFrameId(name, pin.FrameType.BODY)].homogeneous

    assert case.largest_difference(f"Pinocchio, {file}", move, pose) < ROUNDING
    assert open_by < ROUNDING


def put(model, data, values: dict[str, float]) -> np.ndarray:
    """Joint vector and kinematics; added slides stay at zero: MedRUE's five-bars are planar also when calibrated."""
    q = np.zeros(model.nq)
    for name, value in values.items():
        q[model.joints[model.getJointId(name)].idx_q] = value
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    return q


def test_mjcf_loops_are_those_of_calib_also_where_they_are_open(case) -> None:
    """Off the assembled configurations, each gap is as wide in both: the same points are tied."""
    model, points, _ = pin.buildModelAndConstraintsFromMJCF(str(case.folder / "robot.xml"))
    data = model.createData()
    urdf = pin.buildModelFromUrdf(str(case.folder / "robot.urdf"))
    urdf_data = urdf.createData()
    generator = np.random.default_rng(6)
    for values in case.joints[:10]:
        moved = {name: value + generator.uniform(-0.05, 0.05) for name, value in values.items()}
        put(model, data, moved)
        pin.framesForwardKinematics(urdf, urdf_data, np.array([moved[name] for name in urdf.names[1:]]))
        for point, (a, b) in zip(points, case.robot.description.closed_loop, strict=True):
            point_data = point.createData()
            point.calc(model, data, point_data)
            first, second = (urdf_data.oMf[urdf.getFrameId(frame)].translation for frame in (a, b))
            assert np.linalg.norm(point_data.constraint_position_error) == pytest.approx(
                np.linalg.norm(second - first), abs=1e-12
            )


def test_toolbox_yaml_closes_the_same_loops(case) -> None:
    """As toolbox-parallel-robots reads it: frames of the URDF, 3d contacts, motors by joint name."""
    content = yaml.safe_load((case.folder / "robot.yaml").read_text(encoding="utf-8"))
    model = pin.buildModelFromUrdf(str(case.folder / content["urdf"]))
    assert set(content["name_mot"]) <= set(model.names)
    assert content["type"] == ["3d", "3d", "3d"]
    data = model.createData()
    for values in case.joints[::10]:
        pin.framesForwardKinematics(model, data, np.array([values[name] for name in model.names[1:]]))
        for pair in content["closed_loop"]:
            assert all(model.existFrame(frame) for frame in pair)
            first, second = (data.oMf[model.getFrameId(frame)].translation for frame in pair)
            assert np.abs(first - second).max() < 1e-12


def test_welds_of_whole_frames_are_read_and_closed(four_bar: calib.Robot, tmp_path) -> None:
    export(four_bar, tmp_path / "out.xml", "mjcf")
    model, points, frames = pin.buildModelAndConstraintsFromMJCF(str(tmp_path / "out.xml"))
    assert (len(points), len(frames)) == (0, 1)
    data = model.createData()
    for angle in (0.9, 1.2, 1.5):
        put(model, data, {"motor": angle, "a": -angle, "foot": angle, "b": -angle})
        frame_data = frames[0].createData()
        frames[0].calc(model, data, frame_data)
        assert np.abs(frame_data.constraint_position_error).max() < 1e-14
