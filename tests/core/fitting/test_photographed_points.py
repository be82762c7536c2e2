"""Signs and zeros of joints, named from photographs alone: the place of the camera is unknown."""

import numpy as np
import pytest

import calib
from calib.core.fitting.likely_mistakes import likely_mistake, photographed_points
from tests.project import EXAMPLES

URDF = EXAMPLES / "hobby_arm.urdf"
JOINTS = ["shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll"]
DESCRIPTION = """
urdf: {urdf}
name_mot: [{joints}]
base: {{frame: base_link}}
targets:
  marks: {{frame: {target}, xyz: {xyz}, position: unknown, orientation: unknown}}
instruments:
  phone:
    kind: pixel
    target: marks
    points: {{a: [0, 0, 0], b: [100 mm, 0, 0], c: [0, 80 mm, 0], d: [100 mm, 80 mm, 0], e: [50 mm, 30 mm, 20 mm]}}
    camera: {{frame: {camera}, xyz: {from}, rpy: {rpy}, pose: unknown}}
    intrinsics: {{fx: 3100, fy: 3100, cx: 2000, cy: 1500}}
    sigma: 1
parametrisation:
  - {{origin: all, components: [rz], sigma: 5 deg}}
"""


@pytest.fixture(params=["on a tripod", "on the gripper"])
def robot(request, tmp_path):
    """The arm with a camera that sees five points, from outside or from its gripper."""
    places = {"target": "gripper_frame_link", "xyz": [0, 0, 0], "camera": "base_link"}
    places |= {"from": [1.0, 0.0, 0.2], "rpy": ["-90 deg", 0, "90 deg"]}
    if request.param == "on the gripper":
        ahead = calib.load(URDF).forward(np.zeros(5), "gripper_frame_link") @ [0.0, 0.0, 0.6, 1.0]
        places = {"target": "base_link", "xyz": ahead[:3].round(4).tolist()}
        places |= {"camera": "gripper_frame_link", "from": [0, 0, 0], "rpy": [0, 0, 0]}
    (tmp_path / "arm.yaml").write_text(DESCRIPTION.format(urdf=URDF, joints=", ".join(JOINTS), **places))
    return calib.load(tmp_path / "arm.yaml")


@pytest.mark.quick(0)
@pytest.mark.parametrize("robot", ["on a tripod"], indirect=True)
def test_signs_and_zeros_are_named_from_photographs_alone(robot):
    rng = np.random.default_rng(2)
    joints = rng.uniform(-1.0, 1.0, (16, 5))
    seen = calib.simulate(robot, joints, None, rng)
    assert likely_mistake(robot, seen) == ""
    logged = joints * [1, 1, -1, 1, 1] + [0, 0, 0, np.pi / 2, 0]
    words = likely_mistake(robot, calib.as_measurements(robot, logged, dict(seen.readings)))
    assert "joint elbow_flex has the wrong sign" in words
    assert 'elbow_flex: "-elbow_flex [rad]"' in words
    assert "wrist_flex counted from another zero (wrist_flex -90 deg would be right)" in words


def test_positions_are_those_of_the_points_in_the_camera(robot):
    rng = np.random.default_rng(3)
    joints = rng.uniform(-0.3, 0.3, (6, 5))
    seen = calib.simulate(robot, joints, None, rng)
    positioned, points = photographed_points(robot, seen)
    camera = robot.description.instruments["phone"].camera
    T = robot.forward(joints, camera.frame), robot.forward(joints, robot.description.targets["marks"].frame)
    ends = np.linalg.inv(T[0]) @ T[1] @ [*robot.description.targets["marks"].xyz, 1.0]
    expected = np.linalg.norm(ends[:, :3] - [0.0, 0.0, 0.0] - np.array(camera.xyz), axis=1)
    # a pixel over a hundred millimetres, a metre away: the depth is seen to a per cent
    assert np.allclose(np.linalg.norm(points.points(positioned)[:, 0], axis=1), expected, rtol=0.05)
