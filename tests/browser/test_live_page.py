"""The live viewer in a real Chromium: it follows the program, and survives its end."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest

import viz
from tests.browser.browser_tab import Tab, wait
from tests.viz.test_viz_live import progress
from tests.viz.viz_examples import five_bar_fit, medrue_fit, medrue_robot


@pytest.fixture(scope="module")
def fit():
    return medrue_fit(validation=None)


@contextlib.contextmanager
def followed(chromium, robot, fit=None, **size):
    with viz.show(robot, fit) as viewer, Tab(chromium, **size) as tab:
        tab.context.set_offline(False)  # this computer counts as a network
        tab.open(viewer.url)
        assert viewer.wait_for_browser(10)
        yield viewer, tab, fit


@pytest.fixture(scope="module")
def kept_live(chromium, fit):
    with followed(chromium, medrue_robot(), fit) as kept:
        yield kept


@pytest.fixture
def live(kept_live):
    """A program that goes on: the tests share it and its page, which takes seconds to load."""
    viewer, tab, _ = kept_live
    viewer.show_pose(0)
    wait(tab, "v.row === 0 && v.live === null")
    assert tab.page.locator("#state-after").is_checked()
    return kept_live


@pytest.fixture
def ending(chromium, fit):
    """A program that ends."""
    with followed(chromium, medrue_robot(), fit, size=(1200, 800)) as fresh:
        yield fresh


def test_the_page_follows_the_program(live):
    viewer, tab, fit = live
    viewer.show_pose(12)
    wait(tab, "v.row === 12")
    q = fit.identification.data.joints[30]
    viewer.display(q)
    wait(tab, "v.stage.live !== null")
    tool = viewer._shown.scene.bodies.names.index("tool")
    drawn = np.array(tab.state("v.stage.solidMatrices"))[tool].reshape(3, 4)
    np.testing.assert_allclose(drawn[:, 3], fit.robot.forward(q, "tool")[:3, 3], atol=1e-9)
    tab.page.keyboard.press("ArrowRight")
    assert tab.state("v.stage.live") is None
    assert tab.problems == []


@pytest.mark.quick(0)
def test_the_camera_holds_the_robot_and_not_the_measurement_frame_far_away(chromium):
    fit = five_bar_fit()
    with followed(chromium, fit.nominal, fit) as (viewer, tab, _):
        viewer.display(fit.identification.data.joints[3])
        wait(tab, "v.stage.live !== null")
        far, size = tab.page.evaluate("""() => { const { stage } = calibrationViewer; const places = stage.livePlaces();
          return [Math.max(...places.map((place) => place.distanceTo(places[0]))), stage.size]; }""")
    assert np.linalg.norm(fit.identification.data.readings["pen"].values[0]) > 1.5 * size
    assert far < size


def test_only_this_computer_is_asked(live):
    viewer, tab, _ = live
    assert [url for url in tab.requests if not url.startswith((viewer.url, "data:", "blob:"))] == []


@pytest.mark.quick(0)
def test_a_browser_that_comes_later_sees_the_present_pose_and_does_not_hold_the_program_up_when_closed(live, chromium):
    viewer, tab, _ = live
    viewer.show_pose(33)
    with Tab(chromium) as later:
        later.context.set_offline(False)
        wait(later.open(viewer.url), "v.row === 33")
    for row in range(84):
        viewer.show_pose(row)
    wait(tab, "v.row === 83")


def test_a_live_configuration_shows_its_own_numbers_and_no_errors_of_a_pose(live):
    viewer, tab, fit = live
    q = fit.identification.data.joints[30] + 1e-3
    viewer.display(q)
    wait(tab, "v.live !== null")
    panel = tab.page.locator("#pose-block").inner_text()
    assert "Live configuration" in panel
    assert "not measured" in panel
    assert "error" not in panel
    assert "σ" not in panel
    assert "Pose 0" not in panel
    shown = [text.replace("−", "-") for text in tab.page.locator("#joints td").all_inner_texts()]
    joints = viewer._shown.scene.joints
    assert shown == [f"{joint.per_si * value:.2f} {joint.unit}" for joint, value in zip(joints, q, strict=True)]
    rows = tab.page.locator("#position tbody tr").all_inner_texts()
    assert [row.split("\t")[0] for row in rows] == ["pred. before", "pred. after"]
    after = [float(cell.replace("−", "-")) for cell in rows[1].split("\t")[1:4]]
    np.testing.assert_allclose(after, 1e3 * fit.robot.positions(q)[0, 0], atol=6e-4)
    assert not tab.state("v.stage.marks.ring.visible")


def test_a_live_configuration_stays_until_a_pose_is_asked_for(live):
    viewer, tab, fit = live
    viewer.show_pose(5)
    wait(tab, "v.row === 5")
    viewer.display(fit.identification.data.joints[30])
    wait(tab, "v.live !== null")
    for _ in range(2):
        tab.page.keyboard.press("b")
        tab.page.locator("#show-identification").click()
    assert "Live configuration" in tab.page.locator("#pose-head").inner_text()
    tab.page.locator("#next").click()
    assert tab.state("v.row") == 5
    assert "Live configuration" not in tab.page.locator("#pose-head").inner_text()
    assert "error after" in tab.page.locator("#position").inner_text()


def test_a_robot_without_poses_shows_the_joint_values_that_a_program_displays(chromium):
    robot = medrue_robot()
    with followed(chromium, robot) as (viewer, tab, _):
        assert not tab.page.locator("#pose-block").is_visible()
        viewer.display(robot.home)
        wait(tab, "v.live !== null")
        assert "Live configuration" in tab.page.locator("#pose-block").inner_text()
        assert len(tab.page.locator("#joints td").all()) == 6
        assert [row.split("\t")[0] for row in tab.page.locator("#position tbody tr").all_inner_texts()] == ["predicted"]
        assert not tab.page.locator("#stepper").is_visible()


@pytest.mark.quick(0)
def test_the_cockpit_stands_above_the_picture_another_fit_replaces_it_and_both_outlive_the_program(ending):
    viewer, tab, fit = ending
    tab.page.evaluate("window.loadedBefore = true")
    tab.page.evaluate("calibrationViewer.scene.title = 'before'")
    viewer.show(progress(fit, 40))
    wait(tab, "v.scene.title !== 'before' && v.live !== null")
    assert tab.page.evaluate("window.loadedBefore")
    cockpit, pane = tab.page.locator("#cockpit").bounding_box(), tab.page.locator("#pane").bounding_box()
    assert cockpit["y"] + cockpit["height"] <= pane["y"] + 1  # nothing over the robot
    assert pane["height"] > 400
    usual = tab.page.viewport_size
    for width in (1600, 1400, 1200, 1000):
        tab.page.set_viewport_size({"width": width, "height": 900})
        assert tab.page.locator("#told").bounding_box()["width"] > 300  # sentences, no column of single words
    tab.page.set_viewport_size(usual)
    signal = tab.page.locator("#signal")
    assert signal.inner_text() == "GO"
    assert signal.bounding_box()["height"] > 80  # [px]: letters of 2 cm on a usual screen
    assert tab.page.locator("#count").inner_text() == "40 poses measured; about 60 more"
    assert tab.page.locator("#next-pose tr").count() == 6
    assert "goal 0.1 mm: not yet" in tab.page.locator("#judged").inner_text()
    viewer.show(replace(progress(fit, 45), next_pose=None))
    tab.page.wait_for_function("() => document.getElementById('signal').textContent === 'STOP'", timeout=5000)
    assert tab.page.locator("#signal-why").inner_text() == "every candidate is measured"
    viewer.show(progress(fit, 46))
    tab.page.wait_for_function("() => document.getElementById('signal').textContent === 'GO'", timeout=5000)
    wait(tab, "v.live !== null")
    tab.page.evaluate("calibrationViewer.stage.direction = null")  # as if turned by hand
    camera = tab.state("v.stage.viewer.camera.position.toArray()")
    viewer.show(progress(fit, 50, high=9e-5))
    tab.page.wait_for_function("() => document.getElementById('signal').textContent === 'STOP'", timeout=5000)
    wait(tab, "v.live === null")
    assert tab.state("v.stage.viewer.camera.position.toArray()") == pytest.approx(camera, rel=1e-6)
    assert tab.page.locator("#curve polyline").count() == 2
    assert not tab.page.locator("#next-pose").is_visible()
    tab.page.set_viewport_size({"width": 390, "height": 844})
    assert tab.page.evaluate("document.documentElement.scrollWidth") <= 390
    assert tab.problems == []
    viewer.close()
    tab.page.wait_for_selector("#banner:not([hidden])", timeout=10000)
    assert "has ended" in tab.page.locator("#banner").inner_text()
    tab.page.keyboard.press("ArrowRight")  # the picture stays
    assert tab.state("v.row") == 1
    assert tab.picture().std() > 20
