"""The drawn robot moves as the calculated one does, and its loops stay closed at every exaggeration."""

import numpy as np
import pytest

from medrue.workspace import target_workspace
from tests.urdf_trees import plain
from tests.viz.viz_examples import exaggerated
from viz.bodies import bodies_of, posed_robot

LOOPS = (("E1_B", "E1_D"), ("E2_B", "E2_D"), ("G2_E", "G2_slide"))


@pytest.fixture(scope="module")
def posed(robots):
    bodies = bodies_of(robots[0])
    q = target_workspace().q[::20]
    return bodies, q, *(posed_robot(robot, bodies, q) for robot in robots)


def test_poses_agree_with_pinocchio_for_every_link(robots, posed):
    bodies, q, *both = posed
    for robot, posed_one in zip(robots, both, strict=True):
        for link in ("carriage", "distal_B1", "E1_D", "G2_slide", "F6", "tool", "base"):
            expected = robot.forward(q, link)
            drawn = [bodies.poses(posed_one, pose)[bodies.names.index(link)] for pose in range(len(q))]
            together = bodies.poses(posed_one, slice(None))[:, bodies.names.index(link)]
            np.testing.assert_allclose(together, drawn, atol=1e-14)  # rounding
            np.testing.assert_allclose(drawn, expected, atol=1e-12)


def test_loops_are_closed_at_every_pose_and_exaggeration(posed):
    bodies, q, ghost, solid = posed
    for pose in range(len(q)):
        for factor in (0.0, 1.0, 10.0, 100.0):
            matrices = exaggerated(bodies, solid, ghost, pose, factor)
            for first, second in LOOPS:
                a, b = (matrices[bodies.names.index(name)][:3, 3] for name in (first, second))
                # a planar loop leaves x to its bearings: the axes of the two robots differ by the base's rotation
                apart = np.linalg.norm(a - b) if first == "G2_E" else np.linalg.norm((a - b)[1:])
                assert apart < 1e-9 * (1 + factor)


def test_links_meet_at_every_joint_at_every_exaggeration(robots, posed):
    bodies, _, ghost, solid = posed
    nominal = robots[0].nominal
    in_urdf = [not name.startswith("(") for name in bodies.names[1:]]
    for factor in (0.0, 1.0, 30.0):
        matrices = exaggerated(bodies, solid, ghost, 3, factor)
        for i in np.flatnonzero(in_urdf & ~np.array(bodies.sliding)):  # a slide's own motion lies between
            parent = bodies.parents[i]
            on_parent = matrices[parent] @ np.append(nominal.model.jointPlacements[int(i) + 1].translation, 1.0)
            families = [sum((bodies.parents == body) & in_urdf) for body in (parent, i + 1)]
            # with errors up to 2 mm, the carriage's four motors and the support's two children cannot all be met
            limit = 1e-9 if max(families) <= 1 else 1e-3
            assert np.linalg.norm(on_parent[:3] - matrices[i + 1][:3, 3]) < limit * (1 + factor)


def test_nominal_shapes_are_not_stretched(posed):
    _, _, ghost, solid = posed
    np.testing.assert_array_equal(ghost.stretches, np.tile(np.eye(4), (len(ghost.stretches), 1, 1)))
    assert np.abs(solid.stretches - np.eye(4)).max() > 1e-4


def test_names_are_unique_although_the_measurement_frame_may_share_a_link_name(posed):
    names = posed[0].names
    assert len(set(names)) == len(names)
    assert "base" in names
    assert "(base)" in names


def test_a_follower_joint_moves_with_its_leader(tmp_path):
    up, twice = '<axis xyz="0 0 1"/>', '<mimic joint="j" multiplier="2"/>'
    finger = ("l", "fixed", "b", "c", '<origin xyz="1 0 0"/>')
    robot = plain(tmp_path, ("j", "prismatic", "r", "a", up), ("k", "revolute", "a", "b", up + twice), finger)
    bodies = bodies_of(robot)
    q = np.array([[0.3]])
    drawn = bodies.poses(posed_robot(robot, bodies, q), 0)[bodies.names.index("c")]
    np.testing.assert_allclose(drawn, robot.forward(q, "c")[0], atol=1e-14)
    np.testing.assert_allclose(drawn[:3, 3], [np.cos(0.6), np.sin(0.6), 0.3], atol=1e-14)
