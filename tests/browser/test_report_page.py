"""The report in a real Chromium: opens offline, asks nobody, text can be found and selected, prints."""

import numpy as np
import pytest
from browser_tab import Tab
from fleet_figures import ROBOT, made_up, results_of


@pytest.fixture(scope="module")
def report_file(tmp_path_factory):
    from viz_examples import medrue_fit

    import viz

    return viz.report(medrue_fit(), command="calib fit").save(tmp_path_factory.mktemp("pages") / "report.html")


@pytest.fixture(scope="module")
def kept_report(chromium, report_file):
    tab = Tab(chromium).open(report_file.as_uri(), "main")
    yield tab
    tab.context.close()


@pytest.fixture
def report(kept_report):
    """The report in windows of any size; the tests share one page."""

    def sized(width, height, media="screen"):
        kept_report.page.emulate_media(media=media)
        kept_report.page.set_viewport_size({"width": width, "height": height})
        return kept_report

    yield sized
    assert kept_report.problems == []


@pytest.mark.parametrize("size", [(1000, 900), (390, 844)])
def test_it_opens_without_errors_and_fits_the_window(show, report_file, size):
    tab = show(report_file.as_uri(), "main", size)
    assert tab.requests == [report_file.as_uri()]
    assert tab.page.evaluate("document.documentElement.scrollWidth") <= size[0]
    assert tab.page.locator("section").first.get_attribute("class").startswith("verdict")


def test_text_of_plots_can_be_found_and_selected(report):
    tab = report(1200, 800)
    assert tab.page.evaluate("window.find('predicted minus measured')")
    assert "predicted minus measured" in tab.page.evaluate("getSelection().toString()")


def test_it_prints(report):
    tab = report(1200, 800)
    document = tab.page.pdf(prefer_css_page_size=True)
    assert document.startswith(b"%PDF")
    report(688, 1000, "print")  # what A4 leaves between the margins
    assert tab.page.evaluate("Math.max(...[...document.querySelectorAll('table')].map((t) => t.scrollWidth))") <= 688
    assert (
        3 <= document.count(b"/Type /Page\n") + document.count(b"/Type/Page ") + document.count(b"/Type /Page ") <= 12
    )


@pytest.mark.parametrize("size", [(1000, 900), (390, 844), (320, 640)])
def test_text_in_figures_stays_large_enough_to_read_and_wide_things_scroll_in_their_boxes(report, size):
    tab = report(*size)
    assert tab.page.evaluate("document.documentElement.scrollWidth") <= size[0]
    scales = """[...document.querySelectorAll('.drawing svg')].map((drawing) =>
      drawing.getBoundingClientRect().width / drawing.viewBox.baseVal.width)"""
    assert min(tab.page.evaluate(scales)) * 8 > 9  # px of the smallest letters, drawn with 8
    captions = "[...document.querySelectorAll('.caption, figcaption')].map((e) => e.getBoundingClientRect().right)"
    assert max(tab.page.evaluate(captions)) <= size[0]


def test_rows_after_calibration_are_bold_and_headers_stand_above_their_numbers(report):
    tab = report(1200, 800)
    weights = "[...document.querySelectorAll('.numbers .after > *')].map((e) => getComputedStyle(e).fontWeight)"
    assert set(tab.page.evaluate(weights)) == {"600"}
    aligned = (
        "[...document.querySelectorAll('.numbers thead tr:nth-child(2) th')].map((e) => getComputedStyle(e).textAlign)"
    )
    assert set(tab.page.evaluate(aligned)) == {"right"}


def test_words_in_the_first_column_are_not_broken_on_a_phone(report):
    tab = report(320, 640)
    heights = """[...document.querySelectorAll('.facts th')].filter((e) => !e.textContent.includes(' '))
      .map((e) => e.getBoundingClientRect().height / parseFloat(getComputedStyle(e).lineHeight))"""
    assert max(tab.page.evaluate(heights)) < 1.5


def test_the_first_printed_page_has_the_robot_and_no_page_is_half_empty(report):
    tab = report(688, 1000, "print")  # what A4 leaves between the margins
    page = 1000
    bottom = tab.page.locator(".robot img").evaluate("(image) => image.getBoundingClientRect().bottom + scrollY")
    assert bottom < page
    assert tab.page.locator(".robot img").evaluate("(image) => image.naturalWidth") == 600
    blocks = "[...document.querySelectorAll('figure, .whole, .verdict')].map((e) => e.getBoundingClientRect().height)"
    assert max(tab.page.evaluate(blocks)) < page / 2  # what may not be broken leaves at most so much empty


def test_compared_results_fit_the_window_and_print(show, tmp_path):
    from viz_examples import medrue_fit

    import calib
    from viz.comparison_page import comparison_page

    fits = [medrue_fit(range(start, 420, 5), range(3, 420, 9)) for start in (0, 1)]
    page = comparison_page(calib.compare(*fits)).save(tmp_path / "compared.html")
    for size in ((1000, 900), (390, 844)):
        tab = show(page.as_uri(), "main", size)
        assert tab.page.evaluate("document.documentElement.scrollWidth") <= size[0]
        assert tab.page.locator("#intervals svg").count() == 1
        assert tab.page.locator("#same-rows svg").count() == 1
        for box in tab.page.locator(".drawing").all():
            assert box.evaluate("(e) => e.scrollWidth - e.clientWidth") == 0


def test_drawings_take_the_colours_of_a_dark_page(report):
    tab = report(1000, 900)
    ink = "getComputedStyle(document.body).color"
    texts = "[...document.querySelectorAll('.drawing text')].map((e) => getComputedStyle(e).fill)"
    filled = """[...document.querySelectorAll('.drawing path')].filter((e) => {
      const { fill } = getComputedStyle(e), box = e.getBoundingClientRect();
      return fill === 'rgb(255, 255, 255)' && box.width > 50 && box.height > 50; }).length"""
    inks = []
    for scheme in ("dark", "light"):
        tab.page.emulate_media(color_scheme=scheme)
        inks.append(tab.page.evaluate(ink))
        assert tab.page.evaluate(texts).count(inks[-1]) > 20
        assert tab.page.evaluate(filled) == 0
    assert inks[0] != inks[1]


def test_a_fleet_in_folders_far_down_fits_the_window(show, tmp_path):
    """Nothing has to be scrolled to, and folders are named by what differs."""
    import calib
    from viz.fleet_page import fleet_page

    robot, rng = calib.load(ROBOT), np.random.default_rng(5)
    folder = tmp_path / "calibrations" / "of hall three" / "in november"
    folder.mkdir(parents=True)
    folders = results_of(robot, folder, 4, rng, made_up(robot, rng), wrong=True)
    page = fleet_page(calib.fleet(*folders)).save(tmp_path / "fleet.html")
    tab = show(page.as_uri(), "main", (1000, 900))
    assert tab.page.locator("thead th", has_text="robot_1").count() == 1
    assert tab.page.locator("td.words", has_text="UNLIKE").count() == 1
    for box in tab.page.locator(".wide, .drawing").all():
        assert box.evaluate("(e) => e.scrollWidth - e.clientWidth") == 0
    assert str(tmp_path) not in tab.page.locator("main").inner_text()
