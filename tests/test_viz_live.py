"""The live viewer from Python: messages in the right form, input checked, notebooks, no leftovers."""

import base64
import json
import queue
import time

import numpy as np
import pytest
import umsgpack
from viz_examples import measurements, medrue_fit, medrue_robot

import viz
from calib.base.errors import DataError, UnreachablePoseError
from viz.drawing import load_meshcat


@pytest.fixture(scope="module")
def fit():
    return medrue_fit(validation=None)


@pytest.fixture
def viewer(fit):
    with viz.show(medrue_robot(), fit) as shown:
        yield shown


@pytest.fixture
def messages(viewer):
    """Messages that a browser would get."""
    browser = queue.Queue()
    viewer._server._browsers.add(browser)

    def read():
        event, data = browser.get(timeout=2).decode().strip().split("\n")
        return event.removeprefix("event: "), data.removeprefix("data: ")

    return read


def test_the_address_is_on_this_computer(viewer):
    assert viewer.url.startswith("http://127.0.0.1:")


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


def test_meshcat_draws_into_the_page_and_later_browsers_get_the_last_state(viewer, messages):
    meshcat = load_meshcat()
    viewer.meshcat["box"].set_object(meshcat.geometry.Box([0.1, 0.2, 0.3]))
    event, data = messages()
    command = umsgpack.unpackb(base64.b64decode(data))
    assert (event, command["type"], command["path"]) == ("command", "set_object", "/meshcat/box")
    viewer.meshcat["box"].set_transform(np.eye(4))
    viewer.meshcat["box"].set_transform(2 * np.eye(4))
    assert len(viewer._server._state) == 2
    viewer.meshcat["box"].delete()
    assert viewer._server._state == {}


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
    viewer.show("12 poses\nnot yet", fit, fit.robot.home)
    assert messages() == ("told", json.dumps("12 poses\nnot yet"))
    assert messages() == ("reload", "now")
    assert messages()[0] == "joints"
    viewer.show("start here", None, None)
    assert [messages()[0] for _ in range(2)] == ["told", "reload"]
    assert set(viewer._server._state) == {"told"}
    assert viewer._server._page == before
