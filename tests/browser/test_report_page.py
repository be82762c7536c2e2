"""The report in a real Chromium: opens offline, asks nobody, text can be found and selected, prints."""

import json
from itertools import pairwise

import numpy as np
import pytest

import calib
import viz
from tests.browser.browser_tab import Tab
from tests.core.instruments import test_kind_pixel as pixel
from tests.fleets.fleet_figures import ROBOT, made_up, results_of
from tests.project import EXAMPLES
from tests.six_axis_arm import joints, write_six_axis
from tests.viz.viz_examples import five_bar_fit, long_named_fit, medrue_fit
from viz.comparison_page import comparison_page, fleet_page


@pytest.fixture(scope="module")
def report_file(tmp_path_factory):
    return viz.report(medrue_fit(), command="calib fit").save(tmp_path_factory.mktemp("pages") / "report.html")


@pytest.fixture(scope="module")
def kept_report(chromium, report_file):
    with Tab(chromium) as tab:
        yield tab.open(report_file.as_uri())


@pytest.fixture(scope="module")
def kept_small_report(chromium, tmp_path_factory):
    """The report of a robot of two motors, which is drawn more quickly."""
    page = viz.report(five_bar_fit()).save(tmp_path_factory.mktemp("pages") / "report.html")
    with Tab(chromium, size=(1000, 900)) as tab:
        tab.open(page.as_uri()).page.evaluate("calibrationReport.all()")
        yield tab


@pytest.fixture
def small_report(kept_small_report):
    yield kept_small_report
    assert kept_small_report.problems == []


@pytest.fixture
def report(kept_report):
    """The report in windows of any size; the tests share one page."""

    def sized(width, height, media="screen"):
        kept_report.page.emulate_media(media=media)
        if kept_report.page.viewport_size != {"width": width, "height": height}:  # every plot is drawn again
            kept_report.page.set_viewport_size({"width": width, "height": height})
        return kept_report

    yield sized
    assert kept_report.problems == []


def test_it_opens_without_errors_and_fits_the_window(report, report_file):
    for size in ((1000, 900), (390, 844)):
        tab = report(*size)
        tab.page.evaluate("calibrationReport.all()")
        assert tab.page.evaluate("document.documentElement.scrollWidth") <= size[0]
    asked = [address for address in tab.requests if not address.startswith(("about:", "blob:", "data:"))]
    assert asked == [report_file.as_uri()]
    assert tab.page.locator("section").first.get_attribute("class").startswith("verdict")


def selected(tab):
    """Rows that are selected: in the page, in each plot, and in space."""
    return tab.page.evaluate("""() => { const { selection, charts } = calibrationReport;
      const rows = selection.rows.texts.map((_, row) => row).filter((row) => selection.has(row));
      const of = (source) => source.selected.indices.map((k) => source.data.rows[k]).sort((a, b) => a - b);
      const drawn = charts.flatMap(({ sources }) => sources.map(of));
      const marks = document.getElementById("space").contentWindow.calibrationViewer.stage.marks;
      const dim = Array.from(marks.points.geometry.attributes.dim.array);
      return { rows, drawn, space: dim.flatMap((value, row) => (value ? [] : [row])) }; }""")


DRAG = """([name, x, y, x1, y1]) => { // in one go: where the machine is busy, a slow start would be a long press
  const { views } = calibrationReport.charts.find(({ node }) => node.id === name);
  const area = views[0].canvas_view.ui_event_bus.hit_area;
  const send = (type, clientX, clientY) => area.dispatchEvent(new PointerEvent(type,
    { view: window, clientX, clientY, pointerId: 1, pointerType: "mouse", isPrimary: true, buttons: 1 }));
  area.setPointerCapture = () => {}; // nobody holds a real pointer
  send("pointerdown", x, y); send("pointermove", (x + x1) / 2, (y + y1) / 2); send("pointermove", x1, y1);
  send("pointerup", x1, y1); }"""


def place_of(tab, chart, layer, mark):
    """Where a mark of a chart is on the page [px]."""
    return tab.page.evaluate(
        """([name, layer, mark]) => { const chart = calibrationReport.charts.find(({ node }) => node.id === name);
        chart.node.scrollIntoView({ block: "center" });
        const { data } = chart.sources[layer];
        const { frame, el } = chart.views[0];
        const box = chart.grid.children[0].firstElementChild.getBoundingClientRect();
        return [box.left + frame.x_scale.compute(data.x[mark]), box.top + frame.y_scale.compute(data.y[mark]),
                data.rows[mark]]; }""",
        [chart, layer, mark],
    )


def test_the_legends_have_marks_of_their_own(report):
    """No diamond of validation beside "before", whatever pose has the smallest error; and the ring of the viewer."""
    tab = report(1000, 900)
    tab.page.evaluate("calibrationReport.all()")
    marks = tab.page.evaluate("""calibrationReport.charts.flatMap(({ views }) => views.flatMap(({ model }) =>
      model.legend.items.map(({ index, renderers: [first] }) => [first.data_source.data.mark, index])))""")
    shown = [of_rows[index] for of_rows, index in marks if of_rows]
    assert len(shown) > 4
    assert set(shown) == {"circle"}
    legend = tab.page.frame_locator("#space").locator("#legend-marks")
    assert "chosen pose" in legend.inner_text()
    assert legend.locator("path").last.evaluate("(path) => getComputedStyle(path).stroke") == "rgb(204, 13, 89)"


ORDER = """if (window !== top) {
  let drawn = 0;
  const { clear } = WebGL2RenderingContext.prototype;
  WebGL2RenderingContext.prototype.clear = function counted(mask) { drawn += 1; clear.call(this, mask); };
  new MutationObserver(() => {
    const plots = top.document.querySelectorAll("[data-drawn]");
    if (!top.atFirst && document.body?.dataset.shown) top.atFirst = [drawn, plots.length];
  }).observe(document, { subtree: true, attributes: true });
}"""


def test_the_robot_is_drawn_once_and_seen_with_the_plots_of_the_window(chromium, report_file):
    """Without a graphics card each picture takes a tenth of a second, in which plots would wait."""
    with Tab(chromium, size=(1400, 900)) as tab:
        tab.page.add_init_script(ORDER)
        pictures, plots = tab.open(report_file.as_uri()).page.evaluate("window.atFirst")
    assert pictures == 1
    assert plots >= 1


def test_the_band_of_what_was_expected_is_in_the_legend(small_report):
    labels = """calibrationReport.charts.find(({ node }) => node.id === "forest").views[0].model.legend.items
      .map(({ label }) => label.value)"""
    assert small_report.page.evaluate(labels) == ["expected beforehand (95 %)", "change"]


def test_on_paper_the_legend_is_large_and_covers_nothing_of_the_robot(report):
    tab = report(1240, 900)
    found = (
        tab.page.frame_locator("#space")
        .locator("body")
        .evaluate("""(body) => { body.classList.add("paper");
        const [legend, pane] = ["legend", "pane"].map((id) => document.getElementById(id).getBoundingClientRect());
        body.classList.remove("paper");
        const larger = legend.height / document.getElementById("legend").getBoundingClientRect().height;
        return { right: legend.right - window.innerWidth, over: pane.bottom - legend.top, larger }; }""")
    )
    assert found["right"] <= 0
    assert found["over"] <= 0
    assert found["larger"] > 1.4


def test_nothing_of_a_plot_is_cut(report):
    tab = report(390, 844)
    tab.page.evaluate("calibrationReport.all()")
    over = "[...document.querySelectorAll('.panel, .panels, figure')].map((e) => e.scrollWidth - e.clientWidth)"
    assert max(tab.page.evaluate(over)) <= 0


WORDS = """async () => { // where each text of each plot is drawn [px]: [plot, text, left, right, top, bottom]
  const found = [];
  const { fillText } = CanvasRenderingContext2D.prototype;
  CanvasRenderingContext2D.prototype.fillText = function (text, x, y) {
    const { a, b, c, d, e, f } = this.getTransform();
    const width = this.measureText(text).width;
    const shift = { left: 0, start: 0, center: -width / 2, right: -width, end: -width }[this.textAlign];
    const at = [x + shift, x + shift + width].map((u) => [a * u + c * y + e, b * u + d * y + f]);
    if (text.trim()) found.push([this.canvas, text, at]);
    return fillText.apply(this, arguments);
  };
  calibrationReport.charts.forEach(({ views }) => views.forEach((view) => view.invalidate_layout()));
  for (let n = -1; n < found.length;) { n = found.length; await new Promise((next) => setTimeout(next, 300)); }
  CanvasRenderingContext2D.prototype.fillText = fillText;
  const canvases = [...new Set(found.map(([canvas]) => canvas))];
  return found.map(([canvas, text, at]) => [canvases.indexOf(canvas), text, at, canvas.width, canvas.height]); }"""


@pytest.mark.quick(0)
@pytest.mark.parametrize("size", [(1000, 900), (390, 844)])
def test_texts_of_plots_are_whole_and_numbers_at_an_axis_do_not_touch(show, size, tmp_path_factory):
    """An arm whose joints have the names of real ones, and turn by 360 degrees both ways."""
    folder = tmp_path_factory.getbasetemp() / "long_names"
    if not folder.exists():
        folder.mkdir()
        viz.report(long_named_fit(folder, repeats=1)).save(folder / "report.html")
    tab = show((folder / "report.html").as_uri(), size=size)
    tab.page.evaluate("calibrationReport.all()")
    words = tab.page.evaluate(WORDS)
    assert len({plot for plot, *_ in words}) > 20
    for plot, text, places, width, height in words:
        for x, y in places:
            assert -2 <= x <= width + 2, (plot, text, places)
            assert -2 <= y <= height + 2, (plot, text, places)
    lines = {}
    for plot, text, ((x, y), (x1, y1)), _, _ in words:
        if abs(y1 - y) < 1e-6:
            lines.setdefault((plot, round(y)), []).append((x, x1, text))
    for texts in lines.values():
        apart = sorted(set(texts))
        for (_, end, one), (begin, _, two) in pairwise(apart):
            assert begin > end + 2, (plot, one, two)


def test_words_in_the_first_column_are_not_broken_on_a_phone(report):
    tab = report(320, 640)
    heights = """[...document.querySelectorAll('.facts th')].filter((e) => !e.textContent.includes(' '))
      .map((e) => e.getBoundingClientRect().height / parseFloat(getComputedStyle(e).lineHeight))"""
    assert max(tab.page.evaluate(heights)) < 1.5


def test_rows_after_calibration_are_bold_and_headers_stand_above_their_numbers(report):
    tab = report(320, 640)
    weights = "[...document.querySelectorAll('.numbers .after > *')].map((e) => getComputedStyle(e).fontWeight)"
    assert set(tab.page.evaluate(weights)) == {"600"}
    heads = "[...document.querySelectorAll('.numbers thead th:not(.left):not(:first-child)')]"
    aligned = heads + ".map((e) => getComputedStyle(e).textAlign)"
    assert set(tab.page.evaluate(aligned)) == {"right"}


@pytest.mark.quick(0)
def test_it_prints(report):
    tab = report(1200, 800)
    document = tab.page.pdf(prefer_css_page_size=True)
    assert document.startswith(b"%PDF")
    report(688, 1000, "print")  # what A4 leaves between the margins
    assert tab.page.evaluate("Math.max(...[...document.querySelectorAll('table')].map((t) => t.scrollWidth))") <= 688
    assert 3 <= sum(map(document.count, (b"/Type /Page\n", b"/Type/Page ", b"/Type /Page "))) <= 12


def test_the_first_printed_page_has_the_robot_and_no_page_is_half_empty(report):
    tab = report(688, 1000, "print")  # what A4 leaves between the margins
    page = 1000
    bottom = tab.page.locator(".robot img").evaluate("(image) => image.getBoundingClientRect().bottom + scrollY")
    assert bottom < page
    assert tab.page.locator(".robot img").evaluate("(image) => image.naturalWidth") > 300
    blocks = """[...document.querySelectorAll('figure.robot, .panel, .whole, .verdict')]
      .map((e) => e.getBoundingClientRect().height)"""
    assert max(tab.page.evaluate(blocks)) < page / 2  # what may not be broken leaves at most so much empty


CLICKED = """() => { // a point in space that nothing covers, in the middle of the picture: [x, y, row]
  const { stage } = document.getElementById("space").contentWindow.calibrationViewer;
  const box = document.getElementById("space").getBoundingClientRect();
  const { marks, pane, viewer } = stage;
  stage.root.updateMatrixWorld(true);
  const rows = Array.from({ length: marks.table.n }, (_, row) => {
    const point = new stage.THREE.Vector3().fromArray(marks.table.place, 3 * row);
    return [...stage.onScreen(marks.points.localToWorld(point)).slice(0, 2), row];
  });
  const [width, height] = [pane.clientWidth, pane.clientHeight];
  const far = ([x, y]) => Math.hypot(x - width / 2, y - height / 3);
  const isSeen = ([x, y, row]) => marks.pick(viewer.camera, x, y, width, height, 1) === row;
  const [x, y, row] = rows.sort((a, b) => far(a) - far(b)).find(isSeen);
  return [box.left + x, box.top + y, row]; }"""


def test_hover_a_box_in_a_plot_a_line_of_a_table_and_a_click_in_space_mean_the_same_poses(small_report):
    drive(small_report, "mm after")


REPORTED = {"arm": "mm after", "camera": "px after", "stewart": "mm after"}


def reported(name, folder):
    """A fit of a robot without meshes: of an arm, of an arm that a camera sees, of a Stewart platform."""
    if name != "camera":
        robot = calib.load(EXAMPLES / f"{name}.yaml")
        return calib.fit(robot, EXAMPLES / f"{name}_simulated.csv", validation=0.25)
    robot, q = calib.load(write_six_axis(folder, pixel.YAML)), joints(30, 3)
    camera, body = pixel.places(1)
    table = pixel.photographs(robot.with_parameters(pixel.TRUTH), q, camera, body)
    return calib.fit(robot, pixel.data_of(robot, q, table, pixel.SIGMA, 2))


@pytest.mark.quick(0)
@pytest.mark.parametrize("name", REPORTED)
def test_the_same_poses_are_meant_everywhere_for_every_robot(show, name, tmp_path):
    tab = show(viz.report(reported(name, tmp_path)).save(tmp_path / "report.html").as_uri(), size=(1000, 900))
    tab.page.evaluate("calibrationReport.all()")
    drive(tab, REPORTED[name])


def drive(tab, unit):
    """Hover, select in a plot, in a table and in space, and find the same poses everywhere."""
    poses = tab.page.evaluate("calibrationReport.selection.rows.poses")

    def of_one_pose(row):
        return [other for other, pose in enumerate(poses) if pose == poses[row]]

    def same(rows, others):
        return {poses[row] for row in rows} == {poses[row] for row in others}

    names = tab.page.evaluate("calibrationReport.charts.map(({ node }) => node.id)")
    order, table = (next(name for name in names if name.endswith(part)) for part in ("order", "errors"))
    x, y, row = place_of(tab, order, 1, 20)
    tab.page.mouse.move(x, y)
    tab.page.wait_for_timeout(300)
    text = tab.page.evaluate("calibrationReport.selection.rows.texts")[row]
    assert unit in text
    assert tab.page.get_by_text(text, exact=True).count() >= 1  # hover
    tab.page.evaluate(DRAG, [order, x - 14, y - 14, x + 14, y + 14])
    tab.page.wait_for_timeout(300)
    shown = selected(tab)
    assert set(of_one_pose(row)) <= set(shown["rows"])
    assert all(same(rows, shown["rows"]) for rows in shown["drawn"])
    assert shown["space"] == shown["rows"]
    assert text in tab.page.locator("#selected").inner_text() or len(shown["rows"]) > 3
    tab.page.locator("#unselect").click()
    assert selected(tab)["rows"] == []
    tab.page.locator(f"#{table} summary").click()
    line = tab.page.locator(f"#{table} tr[data-row]").nth(5)
    chosen = of_one_pose(int(line.get_attribute("data-row")))
    line.click()
    assert selected(tab)["rows"] == chosen
    assert tab.page.locator(f"#{table} tr.chosen").count() == 2 * len(chosen)  # before and after
    assert selected(tab)["space"] == chosen
    tab.page.locator("#space").scroll_into_view_if_needed()
    tab.page.evaluate("document.getElementById('space').scrollIntoView({ block: 'center' })")
    x, y, row = tab.page.evaluate(CLICKED)
    tab.page.mouse.click(x, y)
    shown = selected(tab)
    assert shown["rows"] == of_one_pose(row)
    assert shown["space"] == shown["rows"]
    assert all(same(rows, shown["rows"]) for rows in shown["drawn"])
    tab.page.locator("#unselect").click()
    assert selected(tab)["space"] == list(range(len(poses)))  # all again


def test_a_plot_drawn_after_a_selection_shows_it_and_has_its_tools_under_the_pointer(small_report):
    page = small_report.page
    buttons = "calibrationReport.charts[0].views[0].model.toolbar.buttons"
    assert selected(small_report)["rows"] == []
    page.evaluate("calibrationReport.selection.choose([3]); calibrationReport.charts[0].again()")
    shown = selected(small_report)
    assert 3 in shown["rows"]
    assert shown["drawn"][0] == shown["rows"]
    assert page.evaluate(buttons) == []
    page.locator(".panel").first.hover()
    assert page.evaluate(buttons) == "auto"
    page.locator(".panel").first.locator(".bk-tool-icon-box-select").wait_for()
    page.locator("#unselect").click()


def test_plots_are_laid_out_anew_for_paper(small_report):
    """A browser that prints lays no plot out anew: one as wide as the screen would be cut."""
    tab = small_report
    wide = "calibrationReport.charts.flatMap(({ views }) => views.map(({ bbox }) => bbox.width))"
    before = tab.page.evaluate(wide)
    tab.page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
    tab.page.emulate_media(media="print")
    tab.page.set_viewport_size({"width": 688, "height": 1000})
    pictures = tab.page.evaluate("""Promise.all([...document.querySelectorAll('.panel > img')].map(async (image) => {
      await image.decode();
      return [image.naturalWidth, image.clientWidth, image.parentElement.clientWidth]; }))""")
    beside = "[...document.querySelectorAll('{} > .chart')].map((chart) => chart.checkVisibility() && chart.id)"
    of_paper = tab.page.evaluate(beside.format("#on-paper"))
    assert len(of_paper) == 2  # errors before and after, and in the order of measurement
    assert all(of_paper)
    tab.page.emulate_media(media="screen")
    tab.page.evaluate("window.dispatchEvent(new Event('afterprint'))")
    assert tab.page.evaluate(beside.format(".halves")) == of_paper  # beside the robot again
    tab.page.set_viewport_size({"width": 1000, "height": 900})
    tab.page.wait_for_function(f"() => JSON.stringify({wide}) == '{json.dumps(before, separators=(',', ':'))}'")
    seen = [picture for picture in pictures if picture[1]]
    assert len(seen) > 5
    for natural, shown, room in seen:
        assert natural == pytest.approx(shown, abs=2)  # letters of their size
        assert shown <= room


@pytest.mark.quick(0)
def test_compared_results_fit_the_window_and_print(show, tmp_path):
    fits = [medrue_fit(range(start, 420, 5), range(3, 420, 9)) for start in (0, 1)]
    page = comparison_page(calib.compare(*fits)).save(tmp_path / "compared.html")
    tab = show(page.as_uri())
    for size in ((1000, 900), (390, 844)):
        tab.page.set_viewport_size({"width": size[0], "height": size[1]})
        tab.page.evaluate("calibrationReport.all()")
        assert tab.page.evaluate("document.documentElement.scrollWidth") <= size[0]
        assert tab.page.locator("#intervals[data-drawn]").count() == 1
        assert tab.page.locator("#same-rows[data-drawn]").count() == 1


def test_small_numbers_of_a_logarithmic_axis_are_not_rounded_to_zero(small_report):
    shown = small_report.page.evaluate("""() => {
      const { views } = calibrationReport.charts.find(({ node }) => node.id === "errors");
      return views[0].model.below[0].formatter.doFormat([1e-6, 1e-4, 0.1 * 7, 1000], {}); }""")
    assert shown == ["0.000001", "0.0001", "0.7", "1000"]


def test_numbers_of_an_upright_logarithmic_axis_do_not_touch(small_report):
    """Over less than a decade too, as with errors from 0.3 to 6 mm."""
    room, low, high = 150, 0.25, 6.5
    ticks = small_report.page.evaluate(f"logarithmicTicks({low}, {high}, {room}, () => 9)")
    assert len(ticks) > 3
    assert min(np.diff(room * np.log(np.array(ticks) / low) / np.log(high / low))) > 18
    fixed = small_report.page.evaluate("""() => {
      const { views } = calibrationReport.charts.find(({ node }) => node.id === "order");
      const [{ ticker }] = views[0].model.left;
      return [views[0].model.y_range.start, views[0].model.y_range.end, ticker.ticks]; }""")
    assert len(fixed[2]) > 1
    assert all(fixed[0] <= tick <= fixed[1] for tick in fixed[2])


@pytest.mark.quick(0)
def test_plots_take_the_colours_of_a_dark_page(small_report):
    tab, inks = small_report, []
    for scheme in ("dark", "light"):
        tab.page.emulate_media(color_scheme=scheme)
        tab.page.wait_for_timeout(500)
        tab.page.evaluate("calibrationReport.all()")
        inks.append(tab.page.evaluate("calibrationReport.charts[0].ink"))
        ink = "getComputedStyle(document.documentElement).getPropertyValue('--ink').trim()"
        theme = "document.getElementById('space').contentDocument.documentElement.dataset.theme"
        assert [tab.page.evaluate(shown) for shown in (ink, theme)] == [inks[-1], scheme]
    assert inks[0] != inks[1]


@pytest.mark.quick(0)
def test_a_fleet_in_folders_far_down_fits_the_window(show, tmp_path):
    """Nothing has to be scrolled to, and folders are named by what differs."""
    robot, rng = calib.load(ROBOT), np.random.default_rng(5)
    folder = tmp_path / "calibrations" / "of hall three" / "in november"
    folder.mkdir(parents=True)
    folders = results_of(robot, folder, 4, rng, made_up(robot, rng), wrong=True)
    page = fleet_page(calib.fleet(*folders)).save(tmp_path / "fleet.html")
    tab = show(page.as_uri(), size=(1000, 900))
    tab.page.evaluate("calibrationReport.all()")
    assert tab.page.locator("thead th", has_text="robot_1").count() == 1
    assert tab.page.locator("td.words", has_text="UNLIKE").count() == 1
    for box in tab.page.locator(".wide").all():
        assert box.evaluate("(e) => e.scrollWidth - e.clientWidth") <= 0  # below: folded
    assert str(tmp_path) not in tab.page.locator("main").inner_text()
    tab = show(page.as_uri(), size=(390, 844))  # a phone: labels and the legend have two lines
    tab.page.evaluate("calibrationReport.all()")
    assert tab.page.evaluate("document.documentElement.scrollWidth") <= 390
