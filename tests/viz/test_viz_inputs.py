"""From a robot, a fit or its folder, and measurements to a scene."""

import dataclasses

import numpy as np
import pytest

import calib
from calib.core.base.errors import DataError, InputError
from tests.project import ROOT
from tests.urdf_trees import plain
from tests.viz.viz_examples import assert_saved_alike, five_bar_fit, measurements, medrue_robot, saved_scene
from viz.inputs import gather
from viz.judgement import judgement_of_result

ARM = (
    ("a", "revolute", "root", "l1", '<origin xyz="0 0 0.3"/><axis xyz="0 0 1"/>'),
    ("b", "revolute", "l1", "l2", '<origin xyz="0.5 0 0"/><axis xyz="0 1 0"/>'),
    ("c", "fixed", "l2", "tip", '<origin xyz="0.4 0 0.1"/>'),
)


def test_a_folder_shows_the_same_as_the_fit_that_was_saved(fit, tmp_path):
    a, b = gather(medrue_robot(), fit).scene, assert_saved_alike(fit, tmp_path)
    np.testing.assert_allclose(b.solid.values, a.solid.values, atol=1e-9)
    np.testing.assert_allclose(b.ghost.values, a.ghost.values, atol=1e-9)
    assert a.verdict.following == b.verdict.following != ""


def test_measurements_alone_show_the_nominal_errors():
    data = measurements(range(0, 420, 60))
    shown = gather(medrue_robot(), None, data)
    assert shown.scene.states == ("before",)
    assert shown.ghost is None
    np.testing.assert_allclose(shown.scene.poses.sigma, 4e-5)  # the description states it


def test_a_robot_whose_base_is_unknown_is_placed_before_it_is_judged(tmp_path):
    robot = plain(tmp_path, *ARM)
    base = robot.mechanism.origin_names[robot.mechanism.targets[0].a - 1]
    moved = robot.with_parameters({f"{base}.x": 3.0, f"{base}.rz": 0.7})
    q = np.random.default_rng(0).uniform(-1, 1, (12, 2))
    data = calib.as_measurements(robot, q, moved.positions(q))
    scene = gather(robot, None, data).scene
    np.testing.assert_allclose(scene.poses.error("before"), 0.0, atol=1e-9)


def test_a_folder_without_a_result_and_a_fit_of_another_robot_are_refused(fit, tmp_path):
    with pytest.raises(DataError, match="holds no result"):
        gather(medrue_robot(), tmp_path)
    arm = plain(tmp_path, *ARM)
    with pytest.raises(InputError, match="another robot"):
        gather(arm, fit)
    fit.save(str(tmp_path / "out"), pages=False)
    with pytest.raises(DataError, match="another robot"):
        gather(arm, tmp_path / "out")


@pytest.mark.quick(0)
def test_a_failed_result_can_be_looked_at_and_says_that_it_failed(tmp_path):
    robot = five_bar_fit().nominal
    data = five_bar_fit().identification.data
    points = data.points(robot) + np.random.default_rng(1).normal(scale=0.005, size=(len(data), 1, 3))
    fit = calib.fit(robot, calib.as_measurements(robot, data.joints, points), sigma=4e-5)
    assert fit.verdict.grade == "FAIL"
    for scene in (gather(robot, fit).scene, saved_scene(fit, tmp_path)):
        assert scene.verdict.grade == "FAIL"
        assert "noise" in scene.verdict.reasons[0][1]


@pytest.mark.quick(0)
def test_what_a_file_says_about_itself_is_shown_with_its_data(fit, tmp_path):
    data = dataclasses.replace(measurements(range(0, 420, 60)), comments=("Simulated measurements",))
    for scene in (gather(medrue_robot(), None, data).scene, gather(medrue_robot(), fit, data).scene):
        assert scene.remarks["lines"] == ["Simulated measurements"]
        assert scene.remarks["simulated"]
    assert gather(medrue_robot(), fit).scene.remarks["lines"] == []
    said = dataclasses.replace(fit.identification.data, comments=("Simulated measurements",))
    identification = dataclasses.replace(fit.identification, data=said)
    scene = saved_scene(dataclasses.replace(fit, identification=identification), tmp_path)
    assert scene.remarks["lines"] == ["Simulated measurements"]


def test_a_reason_has_its_own_grade_or_none_where_it_is_not_known():
    entry = {"grade": "FAIL", "reasons": ["a", "b"], "codes": ["x", "y"]}
    assert judgement_of_result(entry).reasons == (("FAIL", "a"), ("", "b"))
    assert judgement_of_result(entry | {"grade": "CHECK"}).reasons == (("CHECK", "a"), ("CHECK", "b"))
    assert judgement_of_result(entry | {"grades": ["FAIL", "CHECK"]}).reasons == (("FAIL", "a"), ("CHECK", "b"))


def test_a_folder_of_an_earlier_version_says_that_it_has_no_readings():
    folder = ROOT / "tests" / "version_1"
    scene = gather(calib.load(folder / "nominal.yaml"), folder).scene
    assert "readings are not shown" in scene.notes[0]
    assert scene.verdict.grade == "PASS"
