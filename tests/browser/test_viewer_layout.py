"""The viewer on every window and with every robot: nothing covers anything else, and every number says what it is."""

import dataclasses
import itertools

import numpy as np
import pytest

from tests.browser.browser_tab import OUTSIDE, Tab, slide
from tests.viz.viz_examples import LONG_NAMES, long_named_fit
from viz.judgement import Judgement
from viz.remarks import remarks
from viz.scene import scene_of_fit
from viz.viewer_page import scene_page

SIZES = {"desktop": (1400, 900), "phone": (390, 844), "phone on its side": (844, 390), "narrow": (320, 640)}


@pytest.fixture(scope="module")
def long_named(tmp_path_factory):
    folder = tmp_path_factory.mktemp("long")
    fit = long_named_fit(folder)
    return fit, scene_page(scene_of_fit(fit)).save(folder / "viewer.html")


@pytest.fixture(scope="module", params=SIZES.values(), ids=SIZES)
def long_named_tab(chromium, long_named, request):
    with Tab(chromium, request.param) as tab:
        yield tab.open(long_named[1].as_uri())


def test_the_panel_never_scrolls_sideways_and_no_number_covers_another(long_named_tab):
    page = long_named_tab.page
    assert page.evaluate("(e => e.scrollWidth - e.clientWidth)(document.getElementById('panel'))") == 0
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") == 0
    assert page.evaluate("document.documentElement.scrollHeight - innerHeight") == 0  # the panel scrolls, not the page
    crossings = page.evaluate("""() => {
      const text = (cell) => { const range = document.createRange(); range.selectNodeContents(cell);
        return [...range.getClientRects()]; };
      const found = [];
      for (const table of document.querySelectorAll('#position, #joints, #summary table')) {
        const cells = [...table.querySelectorAll('th, td')].filter((cell) => !cell.querySelector('.hidden'))
          .map((cell) => [cell, text(cell)]);
        for (const [a, first] of cells) for (const [b, second] of cells) {
          if (a === b || a.contains(b)) continue;
          for (const p of first) for (const q of second) {
            if (p.left < q.right - 0.5 && q.left < p.right - 0.5 && p.top < q.bottom - 1.5 && q.top < p.bottom - 1.5)
              found.push([a.textContent, b.textContent]); } } }
      return found; }""")
    assert crossings == []


def test_every_joint_name_can_be_read_in_full(long_named_tab):
    assert long_named_tab.page.locator("#joints th").all_inner_texts() == list(LONG_NAMES)
    cut = "[...document.querySelectorAll('#joints th')].filter((e) => e.scrollWidth > e.clientWidth + 1).length"
    assert long_named_tab.page.evaluate(cut) == 0


def test_no_point_lies_under_the_legend_or_outside_the_first_picture(long_named_tab):
    badly_placed = long_named_tab.state("""(() => { const { stage, table } = v; const hidden = [];
      const legend = stage.legendBox(); const place = new stage.THREE.Vector3();
      stage.root.updateMatrixWorld(true);
      for (let row = 0; row < table.n; row += 1) for (const factor of [0, v.vectorFactors[v.vectorState()]]) {
        place.set(...[0, 1, 2].map((i) => table.place[3 * row + i] + factor * table.after[3 * row + i]));
        const [x, y] = stage.onScreen(stage.marks.points.localToWorld(place));
        if (x < 0 || y < 0 || x > stage.pane.clientWidth || y > stage.pane.clientHeight) hidden.push([row, x, y]);
        if (legend && x > legend[0] && x < legend[2] && y > legend[1] && y < legend[3]) hidden.push([row, x, y]);
      } return hidden; })()""")
    assert badly_placed == []


def test_the_ring_around_any_point_is_seen_whole(long_named_tab):
    cut = long_named_tab.state("""(() => { const { stage, table } = v; const cut = [];
      const { camera } = stage.viewer; const place = new stage.THREE.Vector3();
      const { size, smallest, radius } = stage.marks.uniforms; const height = stage.pane.clientHeight;
      stage.root.updateMatrixWorld(true);
      for (let row = 0; row < table.n; row += 1) {
        place.fromArray(table.place, 3 * row);
        const away = -stage.marks.points.localToWorld(place).applyMatrix4(camera.matrixWorldInverse).z;
        const wide = Math.max(smallest.value, height * camera.projectionMatrix.elements[5] * radius.value / away);
        const reach = (2.1 * size.value * wide + 10) / 2; // as the shader has it
        const [x, y] = stage.onScreen(place.applyMatrix4(camera.matrixWorld));
        if (Math.min(x, y, stage.pane.clientWidth - x, height - y) < reach) cut.push([row, x, y, reach]);
      } return cut; })()""")
    assert cut == []


def test_the_legend_leaves_the_scene_most_of_its_place(long_named_tab):
    pane = long_named_tab.page.locator("#pane").bounding_box()
    legend = long_named_tab.page.locator("#legend").bounding_box()
    covered = max(0, pane["y"] + pane["height"] - legend["y"]) * legend["width"]
    assert covered < 0.1 * pane["width"] * pane["height"]
    assert pane["height"] > 200


def test_noise_of_a_reading_and_of_a_mean_stand_side_by_side(show, long_named):
    fit, path = long_named
    tab = show(path.as_uri())
    sigma = 1e3 * fit.sigma
    noise = tab.page.locator("#noise").inner_text()
    assert f"one reading: {sigma:.4f} mm" in noise
    assert f"the mean of 5 readings: {sigma / np.sqrt(5):.4f} mm" in noise
    assert "mean of 5 readings" in tab.page.locator("#pose-head").inner_text()
    assert tab.page.locator("#sigma-note").inner_text() == f"σ = {sigma / np.sqrt(5):.4f} mm, of a mean of 5 readings"
    mean = fit.identification.after["flange"][:5, 0].mean()
    ratio = tab.page.locator("#position tr", has_text="residual").locator("td").first.inner_text().replace("−", "-")
    assert float(ratio) == pytest.approx(mean * 1e3 / (sigma / np.sqrt(5)), abs=6e-3)


def test_the_legend_says_how_many_times_the_ghost_is_displaced(tab):
    note = tab.page.locator("#legend-ghost")
    slide(tab, "ghost-factor", 4)
    assert "displacement ×20" in note.inner_text()
    slide(tab, "ghost-factor", 0)
    assert "true to scale (×1)" in note.inner_text()
    tab.page.locator("#show-ghost").click()
    assert not note.is_visible()


def test_both_sliders_are_seen_at_once_and_line_up(tab):
    tab.page.set_viewport_size({"width": 1400, "height": 900})
    vectors, ghost = (tab.page.locator(f"#{name}").bounding_box() for name in ("vector-factor", "ghost-factor"))
    assert (vectors["x"], vectors["width"]) == (ghost["x"], ghost["width"])
    assert ghost["y"] + ghost["height"] <= 900
    assert 0 < ghost["y"] - vectors["y"] < 40


def test_names_of_frames_do_not_cover_each_other_and_the_hidden_ones_appear_where_one_points(tab, scene):
    tab.page.locator("#show-frames").click()
    tab.drawn()
    boxes = [span.bounding_box() for span in tab.page.locator("#labels span:visible").all()]
    assert len(boxes) > 10
    for a, b in itertools.combinations(boxes, 2):
        apart = a["x"] + a["width"] <= b["x"] + 0.5 or b["x"] + b["width"] <= a["x"] + 0.5
        assert apart or a["y"] + a["height"] <= b["y"] + 0.5 or b["y"] + b["height"] <= a["y"] + 0.5
    x, y, _ = tab.state("""(() => { const { stage, scene } = v;
      const k = scene.frames.findIndex((f) => f.name === 'E1_D');
      const place = new stage.THREE.Vector3();
      return stage.onScreen(place.setFromMatrixPosition(stage.frames[k].triad.matrixWorld)); })()""")
    tab.page.mouse.move(x, y)
    assert {"E1_B", "E1_D"} <= set(tab.page.locator("#labels .pointed").inner_text().split("\n"))
    tab.page.mouse.move(5, 5)
    assert tab.page.locator("#labels .pointed").count() == 1
    assert not tab.page.locator("#labels .pointed").is_visible()


def test_the_focus_stays_in_the_list_of_largest_errors(tab):
    tab.page.locator("#worst button").nth(2).focus()
    tab.page.keyboard.press("b")
    assert tab.page.evaluate("document.activeElement.closest('#worst') !== null")
    assert "before" in tab.page.locator("#worst-title").inner_text()
    tab.page.keyboard.press("Enter")
    assert tab.state("v.row") == tab.state("v.table.largest(v.rows, 'before', 3)[2]")


def test_the_row_of_the_shown_state_is_bold_all_along(tab):
    weights = "[...document.querySelectorAll('tr.now > *')].map((e) => getComputedStyle(e).fontWeight)"
    assert set(tab.page.evaluate(weights)) == {"600"}


def test_points_can_be_made_smaller_and_larger(tab):
    assert tab.changed(slide, tab, "point-size", 0) > 0.005
    assert tab.page.locator("#point-size-text").inner_text() == "×0.25"
    assert tab.changed(slide, tab, "point-size", 7) > 0.01


@pytest.mark.quick(0)
def test_nothing_is_drawn_while_nothing_changes(tab):
    frames = "v.stage.viewer.renderer.info.render.frame"
    tab.drawn()
    before = tab.state(frames)
    tab.page.wait_for_timeout(500)
    assert tab.state(frames) == before
    tab.page.keyboard.press("ArrowRight")
    tab.drawn()
    assert tab.state(frames) > before


def test_each_reason_has_its_grade_and_remarks_of_the_file_are_shown(show, scene, tmp_path):
    verdict = Judgement("FAIL", (("FAIL", "first"), ("CHECK", "second"), ("", "third")))
    said = remarks(("Simulated <i>measurements</i>", "second line"))
    changed = dataclasses.replace(scene, verdict=verdict, remarks=said)
    tab = show(scene_page(changed).save(tmp_path / "viewer.html").as_uri())
    tab.page.locator("#summary summary").click()
    assert tab.page.locator("#summary li").all_inner_texts() == ["CHECK: second", "third"]
    assert "From the file: Simulated <i>measurements</i>" in tab.page.locator("#remarks").inner_text()
    assert tab.page.locator("#remarks.simulated").is_visible()
    tab.page.locator("#remarks summary").click()
    assert tab.page.get_by_text("second line").is_visible()


@pytest.mark.quick(0)
def test_a_turned_phone_shows_the_whole_scene_again(show, viewer_file):
    tab = show(viewer_file.as_uri(), size=(844, 390))
    tab.page.set_viewport_size({"width": 390, "height": 844})
    tab.drawn()
    tab.drawn()
    assert tab.state(OUTSIDE) == 0
