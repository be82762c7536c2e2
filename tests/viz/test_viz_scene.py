"""What a viewer shows: scenes with and without poses and results, exaggerations, and the first camera."""

import dataclasses

import numpy as np
import pytest

import calib
from medrue.workspace import target_workspace
from tests.project import EXAMPLES
from tests.urdf_trees import plain, urdf_of
from tests.viz.viz_examples import medrue_table
from viz.judgement import judgement_of_result
from viz.scene import build_scene, nice_factor
from viz.scene_data import colours
from viz.surroundings import decorations_of


@pytest.fixture(scope="module")
def table():
    return medrue_table(target_workspace().q[::30], group=("measured",) * 14)[2]


@pytest.fixture(scope="module")
def scene(robots, table):
    return build_scene(*robots, table)


def test_a_robot_alone_stands_at_home(robots):
    scene = build_scene(robots[0])
    assert scene.ghost is None
    assert scene.states == ()
    assert len(scene.poses) == 0
    drawn = scene.bodies.poses(scene.solid, 0)[scene.bodies.names.index("tool")]
    np.testing.assert_allclose(drawn, robots[0].forward(robots[0].home, "tool"), atol=1e-12)


def test_states_are_those_whose_errors_are_known(robots, table, scene):
    unknown = np.full((14, 3), np.nan)
    assert scene.states == ("before", "after")
    assert build_scene(*robots, dataclasses.replace(table, measured=unknown)).states == ()
    assert build_scene(robots[0], None, dataclasses.replace(table, after=unknown)).states == ("before",)


def test_errors_after_start_with_a_larger_exaggeration(scene):
    (factors,) = scene.vector_factors
    assert 1 <= factors["before"] < factors["after"] <= 1000


def test_the_ghost_shows_the_nominal_robot(robots, scene):
    q = scene.poses.joints[4]
    drawn = scene.bodies.poses(scene.ghost, 4)[scene.bodies.names.index("tool")]
    np.testing.assert_allclose(drawn, robots[0].forward(q, "tool"), atol=1e-12)


def test_medrues_leg_is_a_half_cylinder_through_its_poses():
    (leg,) = decorations_of("medrue")
    workspace = target_workspace()
    away = leg.vertices - workspace.p_axis
    across = away - np.outer(away @ workspace.axis, workspace.axis)
    np.testing.assert_allclose(np.linalg.norm(across, axis=1), 0.15, atol=1e-12)
    assert np.all(across @ workspace.middle > -1e-12)
    assert decorations_of("another robot") == ()


def test_the_first_camera_looks_at_the_points_from_outside_and_above(scene):
    view = scene.view
    assert np.linalg.norm(view.direction) == pytest.approx(1.0)
    assert 0.1 < view.direction[2] < 0.7
    from_robot = scene.poses.measured.mean(axis=0) - (view.low + view.high) / 2
    assert (view.upright @ from_robot)[:2] @ view.direction[:2] > 0


def test_everything_lies_inside_the_box_and_the_outline(scene):
    points = np.vstack([scene.poses.after, *(shape.corners() for shape in scene.decorations)]) @ scene.view.upright.T
    assert np.all(points >= scene.view.low - 1e-12)
    assert np.all(points <= scene.view.high + 1e-12)
    for direction in np.random.default_rng(2).normal(size=(20, 3)):
        assert np.max(points @ direction) <= np.max(scene.view.outline @ direction) + 1e-12


def test_a_hanging_robot_is_shown_as_its_root_link_stands(tmp_path):
    path = tmp_path / "hanging.yaml"
    (tmp_path / "arm.urdf").write_text(urdf_of(("a", "revolute", "root", "tip", '<origin xyz="0 0 1"/>')))
    path.write_text(
        "urdf: arm.urdf\nname_mot: [a]\nbase: {frame: root, rpy: [3.141592653589793, 0, 0]}\n"
        "targets: {tip: {frame: tip}}\nparametrisation: [{origin: a, components: [x], sigma: 1 mm}]\n"
    )
    scene = build_scene(calib.load(path))
    np.testing.assert_allclose(scene.view.upright, np.diag([1.0, -1.0, -1.0]), atol=1e-15)
    assert scene.view.high[2] > 0.9


def test_the_ghost_of_a_robot_with_unknown_base_stands_on_the_solid_base(tmp_path):
    turn = ("a", "revolute", "root", "l", '<origin xyz="0 0 1"/><axis xyz="0 1 0"/>')
    nominal = plain(tmp_path, turn, ("b", "fixed", "l", "tip", '<origin xyz="1 0 0"/>'))
    base = nominal.mechanism.origin_names[nominal.mechanism.targets[0].a - 1]
    scene = build_scene(nominal, nominal.with_parameters({f"{base}.x": 5.0, "b.x": 1.1}))
    solid, ghost = (scene.bodies.poses(robot, 0) for robot in (scene.solid, scene.ghost))
    np.testing.assert_allclose(ghost[0], solid[0], atol=1e-12)
    end = scene.bodies.names.index("tip")
    assert np.linalg.norm(ghost[end] - solid[end]) == pytest.approx(0.1)


def test_exaggerations_are_round_numbers():
    assert nice_factor(1e-3, 0.049) == 20.0
    expected = {1e-3: 50.0, 1.0: 1.0, 1e-9: 1000.0, float("nan"): 1.0, 0.0: 1.0}
    assert {typical: nice_factor(typical, 0.05) for typical in expected} == expected


@pytest.mark.parametrize("code", ["nothing_to_correct", "no_gain"])
def test_no_enlarged_ghost_stands_beside_a_robot_that_needs_no_correction(code):
    nominal = calib.load(EXAMPLES / "arm.yaml")
    moved = nominal.with_parameters({"joint_2.x": nominal.parameters["joint_2.x"].nominal_si + 1e-5})
    entry = {"grade": "CHECK", "reasons": ["why"], "grades": ["CHECK"], "codes": [code]}
    scene = build_scene(nominal, moved, verdict=judgement_of_result(entry))
    assert (scene.ghost_factor == 1.0) == (code == "nothing_to_correct")


def test_colours_are_those_of_viridis():
    from matplotlib import colormaps

    known = np.round(255 * colormaps["viridis"](np.linspace(0, 1, 256)))
    np.testing.assert_allclose(colours(), known, atol=7)  # between 17 steps
