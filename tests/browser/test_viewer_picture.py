"""The viewer in the dark, the picture it saves, and the way to the report and back."""

import io
import re

import numpy as np
import pytest
from PIL import Image

from tests.browser.browser_tab import Tab
from tests.viz.viz_examples import five_bar_fit
from viz.pictures import pages


@pytest.fixture(scope="module")
def result_pages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("result")
    for name, content in pages(five_bar_fit()).items():
        (folder / name).write_bytes(content)
    return folder


def brightness(tab):
    return float(tab.picture().mean())


@pytest.mark.quick(0)
def test_the_theme_is_the_systems_until_the_reader_decides(tab):
    box = tab.page.locator("#dark")
    light = brightness(tab)
    tab.page.emulate_media(color_scheme="dark")
    tab.drawn()
    assert box.is_checked()
    assert brightness(tab) < 0.7 * light
    box.uncheck()
    assert brightness(tab) == pytest.approx(light, abs=1)
    tab.page.keyboard.press("d")
    for theme in ("light", "dark", "light"):
        tab.page.emulate_media(color_scheme=theme)
        tab.drawn()
    assert box.is_checked()  # the reader's choice stays


def test_the_saved_picture_is_what_is_seen_with_its_legend(tab):
    tab.page.emulate_media(color_scheme="dark")
    tab.drawn()
    with tab.page.expect_download() as download:
        tab.page.locator("#save-picture").click()
    assert download.value.suggested_filename.startswith("medrue-after-")
    assert download.value.suggested_filename.endswith(".png")
    with Image.open(download.value.path()) as picture:
        saved = np.asarray(picture.convert("RGB")).astype(int)
    with Image.open(io.BytesIO(tab.page.locator("#stage").screenshot())) as picture:
        seen = np.asarray(picture.convert("RGB")).astype(int)
    assert saved.shape == seen.shape
    different = np.abs(saved - seen).max(axis=2) > 40
    assert different.mean() < 0.02
    legend = tab.page.locator("#legend").bounding_box()
    x, y, wide, high = (round(legend[key]) for key in ("x", "y", "width", "height"))
    assert different[y : y + high, x : x + wide].mean() < 0.1  # letters may be set a little differently
    assert np.ptp(saved[y : y + high, x : x + wide].mean(axis=2)) > 100


def test_the_key_saves_too_and_names_of_files_are_harmless(tab):
    tab.page.evaluate("calibrationViewer.scene.title = '../a b/<c>'")
    with tab.page.expect_download() as download:
        tab.page.keyboard.press("s")
    assert not set("/<> ") & set(download.value.suggested_filename)


@pytest.mark.quick(0)
def test_report_and_viewer_of_a_result_lead_to_each_other(show, result_pages):
    tab = show((result_pages / "viewer.html").as_uri())
    tab.page.get_by_role("link", name="Report").click()
    tab.page.wait_for_url("**/report.html")
    assert "Calibration report" in tab.page.locator("h1").inner_text()
    tab.page.get_by_role("link", name="Viewer").click()
    tab.page.wait_for_selector("body[data-ready]", state="attached")


def test_a_page_that_stands_alone_has_no_link(tab):
    assert tab.page.get_by_role("link").count() == 0


BRIGHTNESS = """async (where) => { // of a picture on white: its middle value and its darkest
  const image = document.querySelector(where);
  await image.decode();
  const canvas = new OffscreenCanvas(image.naturalWidth, image.naturalHeight);
  const context = canvas.getContext("2d");
  context.fillStyle = "white";
  context.fillRect(0, 0, canvas.width, canvas.height);
  context.drawImage(image, 0, 0);
  const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
  const green = Array.from({ length: data.length / 4 }, (_, k) => data[4 * k + 1]).sort((a, b) => a - b);
  return [green[Math.floor(green.length / 2)], green[0]]; }"""


@pytest.mark.quick(0)
def test_the_report_is_dark_where_the_system_is_but_not_on_paper(chromium, result_pages):
    ground = "getComputedStyle(document.body).backgroundColor"
    with Tab(chromium, color_scheme="dark") as tab:
        tab.open((result_pages / "report.html").as_uri())
        tab.page.evaluate("calibrationReport.all()")
        assert tab.page.evaluate(ground) == "rgb(22, 28, 35)"
        red, green, blue = grade_colour(tab)
        assert green > 1.2 * max(red, blue)  # PASS is green
        ink = tab.page.evaluate("calibrationReport.charts[0].ink")
        assert min(int(ink[k : k + 2], 16) for k in (1, 3, 5)) > 180  # light text on the page's own ground
        tab.page.evaluate("window.dispatchEvent(new Event('beforeprint'))")
        shown = "calibrationReport.charts[0].views[0].model.below[0].major_label_text_color"
        assert tab.page.evaluate(shown) in (ink, {"value": ink})  # as before
        for picture in (".panel > img", "#still"):
            middle, darkest = tab.page.evaluate(BRIGHTNESS, picture)
            assert middle > 200  # paper
            assert darkest < 60  # dark text on it
        tab.page.emulate_media(media="print", color_scheme="dark")
        assert tab.page.evaluate(ground) == "rgb(255, 255, 255)"
        red, green, blue = grade_colour(tab)
        assert green > 1.2 * max(red, blue)
        assert not tab.page.locator("#space").is_visible()


def grade_colour(tab):
    """Red, green and blue of the verdict's word, 0 to 255, where it says PASS."""
    tab.page.evaluate("document.querySelector('.verdict').className = 'verdict PASS'")
    shown = tab.page.evaluate("getComputedStyle(document.querySelector('.verdict .grade')).color")
    return [int(part) for part in re.findall(r"\d+", shown)[:3]]
