"""What moves by itself in the viewer: only where the reader lets it, and it can be stopped."""

import pytest
from browser_tab import Tab

PART = "v.stage.marks.uniforms.state.value"


@pytest.fixture
def moving(chromium, viewer_file):
    tab = Tab(chromium, reduced_motion="no-preference").open(viewer_file.as_uri())
    yield tab
    assert tab.problems == []
    tab.context.close()


def wait(tab, condition):
    tab.page.wait_for_function(f"() => {{ const v = calibrationViewer; return {condition}; }}", timeout=10000)


def test_errors_become_those_of_the_other_state_step_by_step(moving):
    assert moving.state(PART) == 1
    passed = (
        "window.passed = []; const show = v.morph.show; v.morph.show = (part) => { passed.push(part); show(part); }"
    )
    moving.page.evaluate(f"() => {{ const v = calibrationViewer; {passed} }}")
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


@pytest.mark.parametrize(("motion", "speed"), [("reduce", "1"), ("no-preference", "5")])
def test_nothing_plays_by_itself_and_less_motion_begins_slowly(chromium, viewer_file, motion, speed):
    tab = Tab(chromium, reduced_motion=motion).open(viewer_file.as_uri())
    assert not tab.state("v.player.playing")
    assert tab.page.locator("#speed").input_value() == speed
    tab.context.close()
