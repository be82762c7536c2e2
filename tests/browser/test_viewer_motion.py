"""What moves by itself in the viewer: only where the reader lets it, and it can be stopped."""

import numpy as np
import pinocchio as pin
import pytest

import calib
import viz
from tests.browser.browser_tab import slide, wait
from tests.project import EXAMPLES, copied
from tests.viz.viz_examples import medrue_fit
from viz.bodies import posed_robot
from viz.scene import build_scene
from viz.viewer_page import scene_page

PART = "v.stage.marks.uniforms.state.value"


@pytest.fixture
def moving(kept, viewer_file):
    return kept("moving", reduced_motion="no-preference").like_new(viewer_file.as_uri())


def test_errors_become_those_of_the_other_state_step_by_step(moving):
    assert moving.state(PART) == 1
    moving.page.evaluate("""() => { window.passed = []; const { morph } = calibrationViewer; const { show } = morph;
      morph.show = (part) => { passed.push(part); show.call(morph, part); } }""")
    moving.page.keyboard.press("b")
    wait(moving, f"{PART} === 0")
    parts = moving.page.evaluate("passed")
    assert len(parts) > 2
    assert parts == sorted(parts, reverse=True)
    assert any(0.05 < part < 0.95 for part in parts)
    assert moving.page.locator("#legend-title").inner_text() == "Error before calibration [mm]"


def test_half_way_the_picture_is_that_of_neither_state(moving):
    pictures = []
    for part in (0, 0.5, 1):
        moving.state(f"v.morph.to({part}, false)")
        pictures.append(moving.picture())
    before, half, after = pictures
    assert abs(half - before).max() > 24
    assert abs(half - after).max() > 24


def test_a_change_back_on_the_way_starts_where_it_was(moving):
    moving.page.keyboard.press("b")
    wait(moving, f"{PART} < 1")
    moving.page.keyboard.press("b")
    wait(moving, f"{PART} === 1")
    assert moving.page.locator("#state-after").is_checked()


def test_on_scales_of_their_own_nothing_stands_between_the_states(moving):
    moving.page.locator("#same-scale").uncheck()
    moving.page.keyboard.press("b")
    assert moving.state(PART) == 0


def test_less_motion_changes_the_state_at_once(tab):
    tab.page.keyboard.press("b")
    assert tab.state(PART) == 0


@pytest.mark.quick(0)
def test_poses_play_at_the_speed_asked_for_until_paused(moving):
    moving.page.locator("#speed").select_option("20")
    moving.page.locator("#play").click()
    assert moving.page.locator("#play").get_attribute("aria-label") == "Pause"
    assert moving.page.locator("#pose-head").get_attribute("aria-live") == "off"
    wait(moving, "v.row >= 4")
    moving.page.locator("#play").click()
    row = moving.state("v.row")
    moving.page.wait_for_timeout(200)
    assert moving.state("v.row") == row == int(moving.page.locator("#pose").input_value())
    assert moving.page.locator("#play").get_attribute("aria-label") == "Play the poses"
    assert moving.page.locator("#pose-head").get_attribute("aria-live") == "polite"


def test_after_the_last_pose_comes_the_first_and_hidden_ones_are_skipped(moving, scene):
    fitted = scene.poses.group.count("identification")
    moving.page.locator("#show-identification").uncheck()
    moving.page.keyboard.press("End")
    moving.page.keyboard.press("p")
    wait(moving, f"v.row === {fitted}")
    assert moving.state("v.player.playing")


@pytest.mark.parametrize("action", ["p", "ArrowRight", "Home"])
def test_keys_pause_what_plays(moving, action):
    moving.page.keyboard.press("p")
    assert moving.state("v.player.playing")
    moving.page.keyboard.press(action)
    assert not moving.state("v.player.playing")


def test_nothing_plays_where_no_pose_is_shown(moving):
    moving.page.keyboard.press("p")
    for name in ("identification", "validation"):
        moving.page.locator(f"#show-{name}").uncheck()
    assert not moving.state("v.player.playing")
    moving.page.keyboard.press("p")
    assert not moving.state("v.player.playing")
    assert moving.page.locator("#play").is_disabled()


def test_nothing_plays_by_itself_and_less_motion_begins_slowly(tab, moving):
    for loaded, speed in ((tab, "1"), (moving, "5")):
        assert loaded.page.evaluate("firstPlaying") is False
        assert loaded.page.evaluate("firstControls.find(([control]) => control.id === 'speed')[1]") == speed


@pytest.fixture(scope="module")
def robots():
    fit = medrue_fit()
    return {"solid": fit.robot, "ghost": fit.placed}


def test_joints_moved_by_hand_take_the_loops_along_as_the_engine_closes_them(tab, scene, robots):
    tab.page.locator("#drive-block summary").click()
    for number, (joint, share) in enumerate(((1, 0.4), (2, 0.6), (4, 0.45), (0, 0.9), (5, 0.2))):
        slider = tab.page.locator(f"#drive-{joint}")
        low, high = (float(slider.get_attribute(end)) for end in ("min", "max"))
        now = float(slider.input_value())
        slide(tab, f"drive-{joint}", now + 0.3 * (low + share * (high - low) - now))
        assert tab.state("v.live.byHand") is True, number
        q = np.array(tab.state("v.live.joints"))
        for name, state in (("solid", "after"), ("ghost", "before")):
            expected = posed_robot(robots[name], scene.bodies, q[None])
            shown = np.array(tab.state(f"v.live.{name}"))
            np.testing.assert_allclose(shown, expected.values[0], atol=1e-8)
            position = np.array(tab.state(f"v.live.predicted.{state}"))[0]
            np.testing.assert_allclose(position, robots[name].positions(q)[0, 0], atol=1e-8)  # asked for: 1e-6 m
    assert "Moved by hand" in tab.page.locator("#pose-head").inner_text()
    assert "error" not in tab.page.locator("#position").inner_text()
    tab.page.locator("#drive-back").click()
    assert "Pose 0" in tab.page.locator("#pose-head").inner_text()
    assert tab.state("v.live") is None


def test_where_the_loops_do_not_close_the_robot_stays_and_the_page_says_so(tab, scene, robots):
    tab.page.locator("#drive-block summary").click()
    slider = tab.page.locator("#drive-1")
    assert tab.page.locator("#drive-note").inner_text() == ""
    slide(tab, "drive-1", slider.get_attribute("max"))
    assert "do not close beyond here" in tab.page.locator("#drive-note").inner_text()
    q = np.array(tab.state("v.live.joints"))
    assert float(slider.input_value()) < float(slider.get_attribute("max"))
    beyond = q.copy()
    beyond[1] += 0.05
    assert np.all(np.isfinite(posed_robot(robots["solid"], scene.bodies, q[None]).values))
    closes = [robot.close(beyond[None]).ok[0] for robot in robots.values()]
    assert not all(closes)
    slide(tab, "drive-1", float(slider.input_value()) - 5)
    assert tab.page.locator("#drive-note").inner_text() == ""


def test_the_sliders_follow_the_pose_and_keep_the_joint_limits(tab, scene):
    slide(tab, "pose", 40)
    for joint, value, kind in zip(scene.joints, scene.poses.joints[40], range(6), strict=True):
        shown = tab.page.locator(f"#drive-{kind}")
        assert float(shown.input_value()) == pytest.approx(joint.per_si * value, rel=2e-3, abs=0.2)
    low, high = scene.drive["range"]
    assert np.all(low <= scene.poses.joints.min(axis=0))
    assert np.all(high >= scene.poses.joints.max(axis=0))


@pytest.mark.quick(0)
def test_a_robot_without_poses_can_be_moved(show, tmp_path):
    robot = calib.load("docs/examples/five_bar.yaml")
    tab = show(viz.page(robot).save(tmp_path / "viewer.html").as_uri())
    assert tab.page.locator("#pose-block").is_hidden()
    tab.page.locator("#drive-block summary").click()
    now = float(tab.page.locator("#drive-0").input_value())
    assert tab.changed(slide, tab, "drive-0", now + 15) > 0.001
    q = np.array(tab.state("v.live.joints"))
    assert q[0] == pytest.approx(np.radians(now + 15), abs=2e-3)
    position = np.array(tab.state("v.live.predicted.before"))
    np.testing.assert_allclose(position, robot.positions(q)[0], atol=1e-8)


def with_terms(folder, name, terms, generator):
    """An example robot, and the same one with joint terms of random size."""
    more = "\n".join(["joint_terms:", *(f"  - {{{term}}}" for term in terms)])
    robot = calib.load(copied(folder, EXAMPLES / f"{name}.yaml", more=more))
    values = robot.values.copy()
    sigma = [parameter.sigma_si for parameter in robot.parameters[robot.coefficients]]
    values[robot.coefficients] = generator.normal(scale=sigma)
    return robot, robot.with_parameters(values)


@pytest.mark.quick(0)
@pytest.mark.parametrize(
    ("name", "terms", "remark"),
    [
        (
            "arm",
            (
                "joint: all, term: curve",
                "joint: joint_2, term: harmonics, orders: [1, 40]",
                "joint: joint_4, term: coupling, driven_by: joint_3",
                "joint: joint_5, term: backlash",
                "joint: joint_6, term: temperature",
            ),
            "Not known here, and taken as neutral: temperature, the direction of approach.",
        ),
        ("five_bar", ("joint: all, term: gain", "joint: all, term: harmonics, orders: [1, 17]"), ""),
    ],
)
def test_motors_moved_by_hand_are_off_as_the_calibrated_robot_is(show, tmp_path, name, terms, remark):
    generator = np.random.default_rng(3)
    nominal, calibrated = with_terms(tmp_path, name, terms, generator)
    page = scene_page(build_scene(nominal, calibrated)).save(tmp_path / "viewer.html")
    tab = show(page.as_uri())
    tab.page.locator("#drive-block summary").click()
    assert tab.page.locator("#drive-terms").inner_text() == remark
    for joint in generator.integers(len(nominal.joint_names), size=12):
        now = float(tab.page.locator(f"#drive-{joint}").input_value())
        slide(tab, f"drive-{joint}", now + generator.uniform(-20, 20))
        q = np.array(tab.state("v.live.joints"))
        for robot, state in ((nominal, "before"), (calibrated, "after")):
            position = np.array(tab.state(f"v.live.predicted.{state}"))[0]
            np.testing.assert_allclose(position, robot.positions(q)[0, 0], atol=1e-6)
    assert np.linalg.norm(calibrated.positions(q) - nominal.positions(q)) > 1e-4


def test_what_the_page_leaves_out_is_said_and_no_position_is_claimed(show, tmp_path):
    robots = with_terms(tmp_path, "arm", ("joint: joint_2, term: compliance",), np.random.default_rng(3))
    tab = show(scene_page(build_scene(*robots)).save(tmp_path / "viewer.html").as_uri())
    tab.page.locator("#drive-block summary").click()
    assert tab.page.locator("#drive-terms").inner_text() == "Left out here: bending by gravity in joint_2."
    slide(tab, "drive-0", float(tab.page.locator("#drive-0").input_value()) + 1)
    assert tab.state("v.live.predicted.after") is None
    assert "pred. after" not in tab.page.locator("#position").inner_text()


def test_the_logarithm_of_a_pose_is_pinocchios(tab):
    rng = np.random.default_rng(4)
    for size in (1e-9, 1e-3, 1.0, 2.5):
        direction = rng.normal(size=3)
        motion = np.append(rng.normal(size=3), size * direction / np.linalg.norm(direction))
        matrix = pin.exp6(motion).homogeneous[:3].ravel().tolist()
        np.testing.assert_allclose(tab.page.evaluate(f"logarithm({matrix})"), motion, atol=1e-7)
