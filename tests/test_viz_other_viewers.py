"""The same scene in viser and as a recording for rerun, where these packages are installed."""

import sys

import numpy as np
import pytest
from viz_examples import five_bar_fit, medrue_fit

from calib.core.base.errors import InputError
from calib.planning.watch import Watch
from viz.drag import DraggedView
from viz.inputs import gather
from viz.pictures import live
from viz.recording import recording
from viz.scene import scene_of_fit


@pytest.mark.quick(0)
def test_a_recording_holds_every_row_and_the_errors_of_each(monkeypatch):
    rerun = pytest.importorskip("rerun", reason="extra 'rerun'")
    logged, log = [], rerun.RecordingStream.log

    def noted(stream, path, *content, **options):
        logged.append(path)
        log(stream, path, *content, **options)

    monkeypatch.setattr(rerun.RecordingStream, "log", noted)
    scene = scene_of_fit(five_bar_fit())
    content = recording(scene)
    assert content.startswith(b"RRF2")
    assert len(content) < 3e6
    for path in ("errors/position/before", "errors/position/after", "scene/robot/0"):
        assert logged.count(path) == scene.n_rows
    assert {"scene/position/read", "scene/position/before", "scene/position/after"} <= set(logged)


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
