"""The live viewer from Python: messages in the right form, input checked, notebooks, no leftovers."""

import dataclasses
import json
import queue
import time

import numpy as np
import pytest

import calib
import viz
from calib.core.base.errors import DataError, UnreachablePoseError
from calib.planning.next_pose import NextPose
from calib.planning.predicted_error import RootMeanSquare
from tests.viz.viz_examples import measurements, medrue_fit, medrue_robot


@pytest.fixture(scope="module")
def fit():
    return medrue_fit(validation=None)


def progress(fit, n_poses, high=1.5e-4):
    """What a watch tells after so many poses, of a goal of 0.1 mm."""
    robot = medrue_robot()
    known = (*(RootMeanSquare(1e-4, 5e-5, high),) * 2, RootMeanSquare(1.2e-4, 1e-4, high))
    following = NextPose(7, "7", robot.home, 1e-4, 9e-5, 0.1)
    obstacle = None if fit is not None else DataError("too few poses")
    return calib.Progress(robot, 1e-4, n_poses, 300, fit, obstacle, *known, 20, 12, following, 0.1)


@pytest.fixture
def viewer(fit):
    with viz.show(medrue_robot(), fit) as shown:
        yield shown


@pytest.fixture
def messages(viewer):
    """Messages that a browser would get."""
    browser = queue.Queue()
    viewer._server._browsers.add(browser)

    def read(of=None, saying=""):
        """The next message; the next of an event that says something."""
        while True:
            event, data = browser.get(timeout=2).decode().strip().split("\n")
            event, data = event.removeprefix("event: "), data.removeprefix("data: ")
            if of in (None, event) and saying in data:
                return event, data

    return read


def test_a_pose_is_shown_by_its_row(viewer, messages):
    viewer.show_pose(7)
    assert messages() == ("pose", "7")
    with pytest.raises(DataError, match="no pose 84"):
        viewer.show_pose(84)
    with pytest.raises(DataError, match="no pose -1"):
        viewer.show_pose(-1)
    viewer.show_pose(np.int64(8))
    assert messages() == ("pose", "8")
    for wrong in (1.5, "3", None):
        with pytest.raises(DataError, match="whole number"):
            viewer.show_pose(wrong)


def test_joint_values_are_shown_with_their_loops_closed(viewer, messages, fit):
    q = fit.identification.data.joints[3]
    viewer.display(q)
    event, data = messages()
    assert event == "joints"
    sent = json.loads(data)
    scene = viewer._shown.scene
    np.testing.assert_allclose(sent["solid"], scene.solid.values[3], atol=1e-12)
    np.testing.assert_allclose(sent["ghost"], scene.ghost.values[3], atol=1e-12)
    np.testing.assert_allclose(sent["joints"], q)
    np.testing.assert_allclose(sent["predicted"]["before"], fit.placed.positions(q)[0])
    np.testing.assert_allclose(sent["predicted"]["after"], fit.robot.positions(q)[0])
    with pytest.raises(DataError):
        viewer.display([1.0, 2.0])
    with pytest.raises(DataError, match="one pose at a time"):
        viewer.display([q, q])
    with pytest.raises(UnreachablePoseError):
        viewer.display([0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_showing_works_without_any_browser_and_at_once(viewer):
    started = time.monotonic()
    for row in range(80):
        viewer.show_pose(row)
    assert not viewer.wait_for_browser(0.01)
    assert time.monotonic() - started < 2


def test_a_notebook_shows_the_address(viewer):
    assert f'<iframe src="{viewer.url}"' in viewer._repr_html_()


def test_other_measurements_can_be_shown_with_a_fit(fit):
    data = measurements([1, 2, 3], seed=9)
    page = viz.page(medrue_robot(), fit, data=data)
    assert '"measured"' in page.html
    with viz.show(medrue_robot(), fit, data=data) as shown:
        assert len(shown._shown.scene.poses) == 3
        np.testing.assert_allclose(shown._shown.scene.poses.after, fit.robot.positions(data.joints)[:, 0], atol=1e-12)


def test_another_fit_is_shown_with_what_is_told(viewer, messages, fit):
    before = viewer._server._page
    viewer.show(progress(fit, 40))
    event, data = messages()
    told = json.loads(data)
    assert event == "told"
    assert (told["poses"], told["stop"], told["next"]["pose"], told["poses_left"]) == (40, False, "7", 60)
    (row,) = told["history"]
    assert row[:3] == [40, pytest.approx(0.1), pytest.approx(0.12)]
    assert row[4] == pytest.approx(1e3 * progress(fit, 40).predicted.high95)  # the upper end of its interval
    assert told["seconds_left"] is None  # one state tells no pace
    assert "goal 0.1 mm: not yet" in told["words"]
    assert messages() == ("reload", "now")
    assert messages()[0] == "joints"
    viewer.show(progress(None, 50))
    told = json.loads(messages()[1])
    assert (len(told["history"]), told["poses_left"], told["seconds_left"]) == (2, None, None)
    viewer.show(progress(fit, 50, high=9e-5))
    told = json.loads(messages("told")[1])
    assert (told["stop"], told["poses_left"], [row[0] for row in told["history"]]) == (True, 0, [40, 50])
    assert set(viewer._server._state) == {"told"}
    assert viewer._server._page == before  # of the same fit


def test_the_curve_begins_with_what_was_remembered_and_the_last_pose_says_what_it_changed(viewer, messages, fit):
    viewer.remember(progress(fit, 20))
    viewer.show(progress(fit, 40))
    told = json.loads(messages()[1])
    assert [row[0] for row in told["history"]] == [20, 40]
    assert "Changed most" not in told["words"]  # nothing to compare with
    name = next(name for name in fit.free_names if fit.parameters[name].std > 0)
    position = [parameter.name for parameter in fit.robot.parameters].index(name)
    moved = fit.robot.values.copy()
    moved[position] += 2.5 * fit.parameters[name].std_si
    viewer.show(progress(dataclasses.replace(fit, robot=fit.robot.with_parameters(moved)), 41))
    words = json.loads(messages("told", "Changed most")[1])["words"]
    assert f"Changed most by the last pose: {name}" in words
    assert "(2.5 standard deviations)" in words
