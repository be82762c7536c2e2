"""Pinocchio: the exported URDF against the closed form and calib, and the exported MJCF with its loops."""

import numpy as np
import pinocchio as pin
import pytest
import yaml

import calib
from calib.exporting.formats import export
from tests.exporting.read_back import urdf_links
from tests.project import ROOT

ROUNDING = 1e-12
"""Poses are products of about 20 transforms of lengths up to 1 m, loops are closed to 1e-12 m."""


def test_tool_is_where_the_closed_form_says(case) -> None:
    for expected, links in zip(case.tool, case.poses, strict=True):
        assert np.abs(links["tool"][:3, 3] - expected).max() < ROUNDING


def test_the_urdf_has_exactly_the_links_of_the_robot(case) -> None:
    nominal, written = (
        {frame.name for frame in pin.buildModelFromUrdf(str(path)).frames if frame.type == pin.FrameType.BODY}
        for path in (ROOT / "urdf" / "medrue.urdf", case.folder / "robot.urdf")
    )
    assert written == nominal == set(case.robot.urdf.links)


@pytest.mark.quick(0)
def test_every_link_is_where_calib_says(case) -> None:
    for link in case.poses[0]:
        expected = [links[link] for links in case.poses]
        # calib closes the loops to 1e-12 m
        assert np.abs(case.robot.forward(case.q, link) - expected).max() < 2e-12


@pytest.mark.parametrize("file", ["robot.xml", "free.xml"])
def test_mjcf_puts_every_link_where_the_urdf_does_and_closes_the_loops(case, file: str) -> None:
    model, points, frames = pin.buildModelAndConstraintsFromMJCF(str(case.folder / file))
    assert (len(points), len(frames)) == (3, 0)
    data = model.createData()

    def pose(values: dict[str, float], link: str) -> np.ndarray:
        put(model, data, values)
        name = "world_link" if link == "world" else link
        return data.oMf[model.getFrameId(name, pin.FrameType.BODY)].homogeneous

    assert case.largest_difference(f"Pinocchio, {file}", pose) < ROUNDING
    for values in case.joints:
        put(model, data, values)
        assert max(np.abs(error).max() for error in gaps(model, data, points)) < ROUNDING


def put(model, data, values: dict[str, float]) -> None:
    """Kinematics; added slides stay at zero: MedRUE's five-bars are planar also when calibrated."""
    q = np.zeros(model.nq)
    for name, value in values.items():
        q[model.joints[model.getJointId(name)].idx_q] = value
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)


def gaps(model, data, constraints) -> list[np.ndarray]:
    """How far each constraint is from holding."""
    datas = [constraint.createData() for constraint in constraints]
    for constraint, own in zip(constraints, datas, strict=True):
        constraint.calc(model, data, own)
    return [own.constraint_position_error.copy() for own in datas]


def test_mjcf_loops_are_those_of_calib_also_where_they_are_open(case) -> None:
    """Off the assembled configurations, each gap is as wide in both: the same points are tied."""
    model, points, _ = pin.buildModelAndConstraintsFromMJCF(str(case.folder / "robot.xml"))
    data, generator = model.createData(), np.random.default_rng(6)
    links = urdf_links((case.folder / "robot.urdf").read_bytes())
    for values in case.joints[:10]:
        moved = {name: value + generator.uniform(-0.05, 0.05) for name, value in values.items()}
        put(model, data, moved)
        for gap, (a, b) in zip(gaps(model, data, points), case.robot.description.closed_loop, strict=True):
            apart = links(moved, a)[:3, 3] - links(moved, b)[:3, 3]
            assert np.linalg.norm(gap) == pytest.approx(np.linalg.norm(apart), abs=1e-12)


def test_toolbox_yaml_closes_the_same_loops(case) -> None:
    """As toolbox-parallel-robots reads it: frames of the URDF, 3d contacts, motors by joint name."""
    content = yaml.safe_load((case.folder / "robot.yaml").read_text(encoding="utf-8"))
    links = urdf_links((case.folder / content["urdf"]).read_bytes())
    assert set(content["name_mot"]) <= set(case.joints[0])
    assert content["type"] == ["3d", "3d", "3d"]
    for values in case.joints[::10]:
        for a, b in content["closed_loop"]:
            assert np.abs((links(values, a) - links(values, b))[:3, 3]).max() < 1e-12


def test_welds_of_whole_frames_are_read_and_closed(four_bar: calib.Robot, tmp_path) -> None:
    export(four_bar, tmp_path / "out.xml", "mjcf")
    model, points, frames = pin.buildModelAndConstraintsFromMJCF(str(tmp_path / "out.xml"))
    assert (len(points), len(frames)) == (0, 1)
    data = model.createData()
    for angle in (0.9, 1.2, 1.5):
        put(model, data, {"motor": angle, "a": -angle, "foot": angle, "b": -angle})
        assert np.abs(gaps(model, data, frames)).max() < 1e-14
