"""The same scene in viser and as a recording for rerun, where these packages are installed."""

import sys

import numpy as np
import pytest

import calib
from calib.core.base.errors import InputError
from calib.planning.watch import Watch
from tests.core.instruments import test_kind_pixel as pixel
from tests.six_axis_arm import joints, write_six_axis
from tests.viz.viz_examples import five_bar_fit, medrue_fit
from viz.drag import DraggedView
from viz.inputs import gather
from viz.pictures import live
from viz.recording import recording
from viz.scene import scene_of_fit


def recorded(scene, folder):
    """The columns of each entity of a recording, as rerun itself reads them."""
    pytest.importorskip("rerun", reason="extra 'rerun'")
    chunks = pytest.importorskip("rerun.chunk", reason="a rerun that reads recordings")
    path = folder / "scene.rrd"
    path.write_bytes(recording(scene))
    assert path.stat().st_size < 3e6
    read: dict[str, dict[str, list]] = {}
    for chunk in chunks.RrdReader(str(path)).stream():
        table, columns = chunk.to_record_batch(), read.setdefault(chunk.entity_path, {})
        for name in set(table.schema.names) - {"log_time"}:
            columns.setdefault(name, []).extend(table[name].to_pylist())
    return read


def test_a_recording_holds_the_points_of_every_image_and_arrows_to_where_they_are_predicted(tmp_path):
    robot, q = calib.load(write_six_axis(tmp_path, pixel.YAML)), joints(12, 3)
    table = pixel.photographs(robot.with_parameters(pixel.TRUTH), q, *pixel.places(1))
    fit = calib.fit(robot, pixel.data_of(robot, q, table, pixel.SIGMA, 2))
    read = recorded(scene_of_fit(fit), tmp_path)
    for name, readings in fit.identification.data.readings.items():
        points = [np.array(image) for image in read[f"/images/{name}"]["Points2D:positions"]]
        visits = [readings.visits == visit for visit in np.unique(readings.visits)]
        assert len(points) == len(visits)
        for image, own in zip(points, visits, strict=True):
            np.testing.assert_allclose(image, readings.values[own], atol=1e-3)
        for state, residuals in (("before", fit.identification.before), ("after", fit.identification.after)):
            arrows = np.concatenate(read[f"/images/{name}/{state}"]["Arrows2D:vectors"])
            off = np.concatenate([residuals[name][own] for own in visits])
            factor = np.sum(arrows * off) / np.sum(off**2)
            assert factor >= 1
            np.testing.assert_allclose(arrows, factor * off, atol=1e-3)


def test_a_recording_holds_the_robot_and_the_errors_of_every_row(tmp_path):
    """Links as `forward` has them, stretched to their calibrated lengths, and the residuals."""
    fit = five_bar_fit()
    scene = scene_of_fit(fit)
    read = recorded(scene, tmp_path)
    rows = scene.poses.subset(scene.shown)
    predicted = fit.robot.forward(rows.joints)[:, :3, 3]
    for number, name in enumerate(scene.bodies.names):
        drawn = read[f"/scene/robot/{number}"]
        assert drawn["row"] == list(range(scene.n_rows))
        if name in fit.robot.urdf.links:
            M = np.tile(np.eye(4), (scene.n_rows, 1, 1))
            M[:, :3, :3] = np.reshape(drawn["Transform3D:mat3x3"], (-1, 3, 3)).swapaxes(1, 2)  # column by column
            M[:, :3, 3] = np.reshape(drawn["Transform3D:translation"], (-1, 3))
            expected = fit.robot.forward(rows.joints, name) @ scene.solid.stretches[number]
            np.testing.assert_allclose(M, expected, atol=2e-6)  # of single precision
    arrows, factor = read["/scene/position/after"], scene.vector_factors[0]["after"]
    np.testing.assert_allclose(np.array(arrows["Arrows3D:origins"][0]), rows.measured, atol=1e-6)
    np.testing.assert_allclose(np.array(arrows["Arrows3D:vectors"][0]) / factor, predicted - rows.measured, atol=1e-9)
    errors = read["/errors/position/after"]
    assert errors["row"] == list(range(scene.n_rows))
    sizes = 1e3 * np.linalg.norm(predicted - rows.measured, axis=1)
    np.testing.assert_allclose(np.ravel(errors["Scalars:scalars"]), sizes, atol=1e-7)  # [mm]


def test_a_target_that_is_dragged_brings_the_robot_there():
    pytest.importorskip("viser", reason="extra 'viser'")
    fit = medrue_fit()
    robot = fit.robot
    with DraggedView(gather(fit.nominal, fit)) as view:
        assert view.url.startswith("http://127.0.0.1:")
        start = robot.positions(view.joints[None, :])[0, 0]
        goal = start + np.array([0.01, 0.0, 0.005])
        view.reach(goal)
        np.testing.assert_allclose(robot.positions(view.joints[None, :])[0, 0], goal, atol=1e-6)
        held = view.joints.copy()
        view.reach(start + 50.0)  # out of reach: it stays
        np.testing.assert_array_equal(view.joints, held)
        assert "not reached" in view.note.content


def test_the_first_view_holds_the_arm_and_its_target_wherever_they_are_led(robot):
    pytest.importorskip("viser", reason="extra 'viser'")
    shown = gather(robot)
    with DraggedView(shown) as view:
        camera = view.server.initial_camera
        ahead = np.asarray(camera.look_at) - camera.position
        for joints in robot.sample(20, seed=9):
            view.move(joints)
            places = np.array([view._target.position, *(frame.position for frame in view._frames)])
            seen = places @ shown.scene.view.upright.T - camera.position
            along = seen @ ahead / np.linalg.norm(ahead)
            across = np.linalg.norm(seen - np.outer(along, ahead / np.linalg.norm(ahead)), axis=1)
            assert np.all(np.arctan2(across, along) < camera.fov / 2)


def test_while_measuring_the_robot_stands_at_the_next_pose_beside_the_words_of_the_terminal(capsys):
    pytest.importorskip("viser", reason="extra 'viser'")
    fit = five_bar_fit()
    progress = Watch(fit.nominal, 1e-6).update(fit.identification.data)
    view = live(fit.nominal, dragged=True)
    try:
        assert view.words.content == ""
        view.show(progress)
        np.testing.assert_array_equal(view.joints, progress.next_pose.joints)
        for line in progress.report().splitlines():
            assert line.strip() in view.words.content
    finally:
        view.close()
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("package", "distribution", "view"),
    [("rerun", "rerun-sdk", lambda shown: recording(shown.scene)), ("viser", "viser", DraggedView)],
)
def test_without_the_package_one_line_says_what_to_install(package, distribution, view, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    shown = gather(five_bar_fit().nominal)
    with pytest.raises(InputError, match=f"pip install {distribution}"):
        view(shown)
