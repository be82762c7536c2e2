"""The viewer in a real Chromium: every control does what it says; keyboard, mouse, phone, offline, hostile names."""

import dataclasses
import itertools
import re

import numpy as np
import pytest

from tests.browser.browser_tab import OUTSIDE, Tab, slide
from tests.viz.viz_examples import exaggerated, many_poses, medrue_robot
from viz.scene import build_scene
from viz.scene_data import summary
from viz.viewer_page import scene_page


def visible_numbers(tab, selector):
    return [float(text.replace("−", "-")) for text in tab.page.locator(selector).all_inner_texts()]


def matrices(tab, which):
    rows = np.array(tab.state(f"v.stage.{which}")).reshape(-1, 3, 4)
    return np.concatenate([rows, np.tile([[[0.0, 0.0, 0.0, 1.0]]], (len(rows), 1, 1))], axis=1)


def test_it_loads_twice_without_errors_and_without_asking_anybody(show, viewer_file):
    for _ in range(2):
        tab = show(viewer_file.as_uri())
        assert tab.picture().std() > 20  # something is drawn
        assert tab.problems == []
        assert tab.requests == [viewer_file.as_uri()]


def test_the_numbers_of_the_summary_are_those_of_the_fit(tab, scene):
    validation = next(row for row in summary(scene) if row["group"] == "validation")
    shown = visible_numbers(tab, "#error-before, #error-after")
    expected = [validation[state]["rms"] for state in ("before", "after")]
    np.testing.assert_allclose(shown, expected, rtol=6e-3)  # three digits


def test_robot_and_ghost_stand_where_they_should(tab, scene):
    for pose in (0, 57, len(scene.poses) - 1):
        slide(tab, "pose", pose)
        for slider_value, factor in ((0, 1.0), (3, 10.0)):
            slide(tab, "ghost-factor", slider_value)
            solid = scene.bodies.matrices(scene.solid, pose)
            np.testing.assert_allclose(matrices(tab, "solidMatrices"), solid, atol=1e-6)
            expected = exaggerated(scene.bodies, scene.solid, scene.ghost, pose, factor)
            np.testing.assert_allclose(matrices(tab, "ghostMatrices"), expected, atol=1e-6 * (1 + factor))


def test_before_and_after_switch_colours_legend_and_lists(tab):
    tab.page.locator("#same-scale").uncheck()
    assert tab.page.locator("#legend-title").inner_text() == "Error after calibration [mm]"
    after = visible_numbers(tab, "#legend-ticks span")
    assert tab.changed(lambda: tab.page.locator("label:has(#state-before)").click()) > 0.01
    assert tab.page.locator("#legend-title").inner_text() == "Error before calibration [mm]"
    assert max(visible_numbers(tab, "#legend-ticks span")) > 20 * max(after)
    assert "before" in tab.page.locator("#worst-title").inner_text()
    assert tab.state("v.stage.marks.uniforms.state.value") == 0
    assert "before" in tab.page.locator("tr.now th").inner_text()


def test_one_scale_holds_both_states_unless_own_scales_are_asked_for(tab):
    assert tab.page.locator("#same-scale").is_checked()
    ticks = visible_numbers(tab, "#legend-ticks span")
    tab.page.locator("label:has(#state-before)").click()
    assert visible_numbers(tab, "#legend-ticks span") == ticks
    assert min(ticks) < 0.2
    assert max(ticks) >= 10
    assert tab.state("v.stage.marks.uniforms.logarithmic.value") == 1
    before = tab.state("v.stage.marks.uniforms.factor.value")
    tab.page.keyboard.press("b")
    assert tab.state("v.stage.marks.uniforms.factor.value") == before
    tab.page.locator("#same-scale").uncheck()
    assert tab.state("v.stage.marks.uniforms.factor.value") > 10 * before


def test_points_in_or_behind_the_robot_shine_through(tab):
    show = "(v.stage.marks.covered.visible = {}, v.stage.redraw())"
    assert tab.changed(tab.state, show.format("false")) > 1e-4
    tab.state(show.format("true"))


def test_the_pose_slider_moves_the_robot_and_the_panel(tab, scene):
    assert tab.changed(slide, tab, "pose", 70) > 0.01
    table = scene.poses
    rows = {
        row.locator("th").inner_text(): [text.replace("−", "-") for text in row.locator("td").all_inner_texts()]
        for row in tab.page.locator("#position tbody tr").all()
    }
    assert f"Pose {table.labels[70]}" in tab.page.locator("#pose-head").inner_text()
    assert table.group[70] in tab.page.locator("#pose-head").inner_text()
    for name, values, scale, digits in (
        ("measured", table.measured, 1e3, 3),
        ("pred. after", table.after, 1e3, 3),
        ("error after", table.error("after"), 1e3, 4),
        ("residual / σ", table.normalised_residuals(), 1, 2),
        ("pred. ± 1σ", table.spread, 1e3, 4),
    ):
        shown = [float(text) for text in rows[name][:3]]
        np.testing.assert_allclose(shown, scale * values[70], atol=0.51 * 10.0**-digits)
    assert float(rows["error after"][3]) == pytest.approx(1e3 * np.linalg.norm(table.error("after")[70]), abs=1e-4)
    joints = tab.page.locator("#joints td").all_inner_texts()
    expected = [
        f"{joint.per_si * value:.2f} {joint.unit}".replace("-", "−")
        for joint, value in zip(scene.joints, table.joints[70], strict=True)
    ]
    assert joints == expected


def test_arrow_keys_step_through_the_poses(tab, scene):
    rows = []
    for key in ("ArrowRight", "ArrowRight", "ArrowLeft", "End", "ArrowRight", "Home", "ArrowLeft"):
        tab.page.keyboard.press(key)
        rows.append(tab.state("v.row"))
    last = len(scene.poses) - 1
    assert rows == [1, 2, 1, last, last, 0, 0]


def test_arrow_keys_stay_with_the_slider_that_has_the_focus(tab):
    tab.page.locator("#ghost-factor").focus()
    before = tab.page.locator("#ghost-factor-text").inner_text()
    tab.page.keyboard.press("ArrowRight")
    assert tab.page.locator("#ghost-factor-text").inner_text() != before
    assert tab.state("v.row") == 0


def test_letters_switch_what_their_help_says(tab):
    for key, name in (("v", "show-vectors"), ("g", "show-ghost"), ("f", "show-frames")):
        before = tab.page.locator(f"#{name}").is_checked()
        tab.page.keyboard.press(key)
        assert tab.page.locator(f"#{name}").is_checked() != before
    tab.page.keyboard.press("b")
    assert tab.page.locator("#state-before").is_checked()
    tab.page.keyboard.press("b")
    assert tab.page.locator("#state-after").is_checked()


def test_buttons_step_and_the_largest_errors_lead_to_their_poses(tab, scene):
    tab.page.locator("#next").click()
    assert tab.state("v.row") == 1
    tab.page.locator("#previous").click()
    assert tab.state("v.row") == 0
    tab.page.locator("#worst button").first.click()
    assert tab.state("v.row") == int(np.argmax(np.linalg.norm(scene.poses.error("after"), axis=1)))


def test_what_is_switched_off_disappears_and_comes_back(tab):
    picture = tab.picture()
    for name in ("show-vectors", "show-ghost", "show-robot", "show-decorations", "show-frames"):
        box = tab.page.locator(f"#{name}")
        box.click()
        assert np.mean(np.abs(tab.picture() - picture).max(axis=2) > 24) > 0.002, name
        box.click()
    assert np.mean(np.abs(tab.picture() - picture).max(axis=2) > 24) < 0.001


@pytest.mark.parametrize(("name", "value", "factor"), [("vector-factor", 9, 1000), ("ghost-factor", 4, 20)])
def test_exaggeration_sliders_change_the_picture_and_say_how_much(tab, name, value, factor):
    slide(tab, name, 2)
    assert tab.page.locator(f"#{name}-text").inner_text() == "×5"
    assert tab.changed(slide, tab, name, value) > 0.005
    assert tab.page.locator(f"#{name}-text").inner_text() == f"×{factor}"
    if name == "vector-factor":
        assert f"×{factor}" in tab.page.locator("#legend-vectors").inner_text()
        assert tab.state("v.stage.marks.uniforms.factor.value") == factor


def test_groups_can_be_hidden_and_are_skipped(tab, scene):
    fitted = scene.poses.group.count("identification")
    assert tab.changed(tab.page.locator("#show-identification").click) > 0.001
    assert tab.state("v.row") == fitted
    assert tab.state("v.rows.length") == len(scene.poses) - fitted
    tab.page.locator("#show-outliers").click()
    assert 100 not in tab.state("v.rows")
    tab.page.locator("#show-validation").click()
    assert tab.state("v.rows.length") == 0
    assert tab.page.locator("#pose").is_disabled()
    tab.page.keyboard.press("ArrowRight")
    tab.page.locator("#show-validation").click()
    assert tab.state("v.rows.length") == len(scene.poses) - fitted - 1


def test_a_suspected_outlier_is_marked_in_the_panel(tab):
    slide(tab, "pose", 100)
    assert "outlier" in tab.page.locator("#pose-head").inner_text()


def test_a_click_on_a_point_goes_to_its_pose(tab, scene):
    place = """(row) => { const s = calibrationViewer.stage; const p = new s.THREE.Vector3().fromArray(
      s.marks.table.place, 3 * row); s.marks.points.localToWorld(p).project(s.viewer.camera);
      return [(p.x + 1) / 2 * s.pane.clientWidth, (1 - p.y) / 2 * s.pane.clientHeight]; }"""
    hits = 0
    for row in (5, 40, 90, 120):
        x, y = tab.page.evaluate(place, row)
        tab.page.locator("#pane").click(position={"x": x, "y": y})
        chosen = tab.state("v.row")
        x_chosen, y_chosen = tab.page.evaluate(place, chosen)
        assert np.hypot(x - x_chosen, y - y_chosen) <= 12  # another point may lie in front at the same place
        hits += chosen == row
    assert hits >= 2


def test_dragging_turns_the_camera_and_reset_brings_it_back(tab):
    row, camera = tab.state("v.row"), tab.state("v.stage.viewer.camera.position.toArray()")
    tab.page.mouse.move(400, 150)
    tab.page.mouse.down()
    tab.page.mouse.move(520, 220, steps=5)
    tab.page.mouse.up()
    turned = tab.state("v.stage.viewer.camera.position.toArray()")
    assert np.linalg.norm(np.subtract(turned, camera)) > 0.1
    assert tab.state("v.row") == row
    tab.page.locator("#reset-camera").click()
    np.testing.assert_allclose(tab.state("v.stage.viewer.camera.position.toArray()"), camera, atol=1e-9)


def test_the_views_look_from_different_sides(tab):
    seen, towards = [], "clone().sub(v.stage.viewer.controls.target).normalize().toArray()"
    for name in ("front", "side", "top"):
        tab.page.locator(f"[data-view={name}]").click()
        seen.append(tab.state(f"v.stage.viewer.camera.position.{towards}"))
    for first, second in itertools.combinations(seen, 2):
        assert abs(np.dot(first, second)) < 0.1
    assert seen[2][1] > 0.99  # meshcat's camera has y upwards


def test_the_whole_scene_is_in_the_first_picture(tab):
    assert tab.state(OUTSIDE) == 0


def test_frames_carry_their_names(tab):
    assert tab.page.locator("#labels span:visible").count() == 0
    tab.page.locator("#show-frames").click()
    tab.drawn()
    assert "carriage" in tab.page.locator("#labels span:visible").all_inner_texts()


@pytest.mark.quick(0)
def test_on_a_phone_nothing_is_cut_off_and_everything_can_be_reached(chromium, viewer_file):
    with Tab(chromium, size=(390, 844), device_scale_factor=2, has_touch=True, is_mobile=True) as tab:
        tab.open(viewer_file.as_uri())
        assert tab.page.evaluate("document.documentElement.scrollWidth") <= 390
        pane, legend = (tab.page.locator(name).bounding_box() for name in ("#pane", "#legend"))
        assert pane["height"] > 300
        assert pane["y"] + pane["height"] <= legend["y"] + 1  # the legend covers nothing
        for name in ("#next", "#show-frames", "#reset-camera"):
            tab.page.locator(name).tap()
        assert tab.state("v.row") == 1
        assert tab.picture().std() > 20


def test_every_control_has_a_name_and_is_reached_by_tab_in_the_order_of_the_page(tab):
    tab.open(tab.page.url)  # the order begins where the last focus was
    tab.page.evaluate("document.getElementById('drive-block').open = true")
    unnamed = tab.page.evaluate("""() => [...document.querySelectorAll('input, select, button')].filter((e) =>
      !e.closest('[hidden]') && !e.getAttribute('aria-label') && !e.textContent.trim()
      && ![...(e.labels || [])].some((l) => l.textContent.trim())).map((e) => e.id)""")
    assert unnamed == []
    order = tab.page.evaluate("""() => [...document.querySelectorAll('#pane, input, select, button, summary')]
      .filter((e) => e.offsetParent !== null && !e.disabled && !(e.type === 'radio' && !e.checked))
      .map((e) => e.id || e.textContent)""")
    reached = []
    for _ in order:
        tab.page.keyboard.press("Tab")
        reached.append(tab.page.evaluate("document.activeElement.id || document.activeElement.textContent"))
    assert reached == order


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_text_stands_out_from_its_background(tab, theme):
    tab.page.emulate_media(color_scheme=theme)
    tab.drawn()
    texts = tab.page.evaluate("""() => {
      const parse = (text) => text.match(/[\\d.]+/g).map(Number);
      const ground = (e) => { for (let n = e; n; n = n.parentElement) {
        const c = parse(getComputedStyle(n).backgroundColor);
        if (c.length < 4 || c[3] > 0.5) return c.slice(0, 3); } return [255, 255, 255]; };
      return [...document.querySelectorAll('#panel *, #legend *')].filter((e) => e.offsetParent !== null &&
        [...e.childNodes].some((n) => n.nodeType === 3 && n.textContent.trim())).map((e) =>
          [parse(getComputedStyle(e).color).slice(0, 3), ground(e), e.textContent]); }""")
    assert len(texts) > 30
    assert [text for colour, ground, text in texts if contrast(colour, ground) < 4.5] == []  # WCAG AA
    assert tab.state("document.documentElement.dataset.theme") == theme


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_the_ghost_stands_out_from_the_ground_in_the_colour_of_the_legend(tab, theme):
    tab.page.emulate_media(color_scheme=theme)
    tab.drawn()
    names = tab.page.evaluate("""() => {
      const style = getComputedStyle(document.documentElement);
      return ['--ghost', '--sky', '--ground'].map((name) => style.getPropertyValue(name).trim()); }""")
    ghost, *grounds = ([int(name[k : k + 2], 16) for k in (1, 3, 5)] for name in names)
    assert tab.state("v.stage.ghostMaterial.color.getHexString()") == names[0].lstrip("#")
    assert min(contrast(ghost, ground) for ground in grounds) > 3  # WCAG AA, of what is no text
    drawn = tab.page.evaluate("getComputedStyle(document.querySelector('#legend-ghost i')).borderTopColor")
    assert [int(part) for part in re.findall(r"\d+", drawn)] == ghost


def contrast(first, second):
    """Ratio of the luminances of two colours, each red, green and blue from 0 to 255, as WCAG defines it."""
    parts = np.array([first, second]) / 255
    linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
    small, large = sorted(linear @ [0.2126, 0.7152, 0.0722] + 0.05)
    return large / small


def test_names_from_files_are_shown_as_text(show, scene, tmp_path):
    hostile = "</script><img src=x onerror=alert(1)>"
    poses = dataclasses.replace(scene.poses, labels=(hostile, *scene.poses.labels[1:]))
    bodies = dataclasses.replace(scene.bodies, names=(hostile, *scene.bodies.names[1:]))
    spoiled = dataclasses.replace(scene, title=hostile, poses=poses, notes=(hostile,), bodies=bodies)
    tab = show(scene_page(spoiled).save(tmp_path / "viewer.html").as_uri())
    tab.page.locator("#show-frames").click()
    assert tab.page.locator("#title").inner_text() == hostile
    assert hostile in tab.page.locator("#pose-head").inner_text()
    assert tab.page.locator("#notes li").inner_text() == hostile
    assert tab.page.locator("img").count() == 0


def test_a_robot_without_poses_shows_no_controls_for_them(show, tmp_path):
    tab = show(scene_page(build_scene(medrue_robot())).save(tmp_path / "viewer.html").as_uri())
    for name in ("#pose-block", "#state-block", "#legend", "#ghost-row"):
        assert not tab.page.locator(name).is_visible()
    assert tab.picture().std() > 20
    tab.page.keyboard.press("ArrowRight")
    tab.page.keyboard.press("b")


def test_without_webgl_the_numbers_still_work(chromium, viewer_file):
    tab = Tab(chromium)
    tab.page.add_init_script("""HTMLCanvasElement.prototype.getContext = ((get) => function (kind, ...rest) {
      return kind.includes('webgl') ? null : get.call(this, kind, ...rest); })
      (HTMLCanvasElement.prototype.getContext)""")
    tab.open(viewer_file.as_uri())
    assert "WebGL" in tab.page.locator(".fatal").first.inner_text()
    tab.page.locator("#next").click()
    assert tab.state("v.row") == 1
    tab.context.close()


@pytest.mark.quick(0)
def test_five_thousand_poses_load_and_can_be_stepped_through(show, tmp_path):
    nominal, calibrated, table = many_poses(5000)
    tab = show(scene_page(build_scene(nominal, calibrated, table)).save(tmp_path / "viewer.html").as_uri())
    assert tab.picture().std() > 20
    tab.page.keyboard.press("End")
    assert tab.state("v.row") == 4999
    assert tab.changed(tab.page.locator("#show-validation").click) > 0.001


@pytest.mark.quick(0)
def test_poses_without_measured_points_show_predictions_beside_those_with_errors(show, tmp_path):
    nominal, calibrated, table = many_poses(40)
    unseen = np.arange(40) < 10
    table = dataclasses.replace(
        table,
        measured=np.where(unseen[:, None], np.nan, table.measured),
        sigma=np.where(unseen, np.nan, table.sigma),
        group=("identification",) * 10 + ("validation",) * 30,
    )
    tab = show(scene_page(build_scene(nominal, calibrated, table)).save(tmp_path / "v.html").as_uri())
    slide(tab, "pose", 3)
    rows = {row.split("\t")[0]: row.split("\t")[1:4] for row in tab.page.locator("#position tr").all_inner_texts()}
    predicted = [float(number.replace("−", "-")) for number in rows["predicted"]]
    np.testing.assert_allclose(predicted, 1e3 * table.after[3], atol=6e-4)
    assert "pred. after" not in rows
    slide(tab, "pose", 20)
    assert "pred. after" in tab.page.locator("#position").inner_text()
    nothing = dataclasses.replace(table, measured=np.full((40, 3), np.nan), sigma=np.full(40, np.nan))
    show(scene_page(build_scene(nominal, calibrated, nothing)).save(tmp_path / "n.html").as_uri())
    assert "Predicted positions; no points were measured here." in tab.page.locator("#summary").inner_text()
