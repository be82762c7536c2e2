"""The map of the workspace in a real Chromium: colours, slices, ellipsoids, legend."""

import numpy as np
import pytest

import calib
import viz
from tests.browser.browser_tab import slide


@pytest.fixture(scope="module")
def map_file(tmp_path_factory):
    robot = calib.load("docs/examples/arm.yaml")
    fit = calib.fit(robot, calib.read_measurements("docs/examples/arm_simulated.csv", robot))
    return viz.page(robot, fit, mapped=400).save(tmp_path_factory.mktemp("map") / "viewer.html")


@pytest.fixture
def mapped(kept, map_file):
    return kept("map").like_new(map_file.as_uri())


def choose(tab, name, value):
    tab.page.locator(f"#{name}").select_option(value)


def test_colours_are_of_what_is_chosen_and_can_be_put_away(mapped):
    assert "1σ" in mapped.page.locator("#legend-map-title").inner_text()
    assert mapped.changed(choose, mapped, "map-kind", "error") > 0.002
    assert "nominal robot" in mapped.page.locator("#legend-map-title").inner_text()
    low, high = mapped.state("[v.stage.map.uniforms.low.value, v.stage.map.uniforms.high.value]")
    error = np.array(mapped.state("Array.from(v.stage.map.values.error)"))
    assert high == pytest.approx(error.max())
    assert low == pytest.approx(error.min())
    assert mapped.changed(choose, mapped, "map-kind", "") > 0.005
    assert mapped.page.locator("#legend-map").is_hidden()
    assert not mapped.state("v.stage.map.hull.visible")


def test_a_slice_shows_a_part_and_moves(mapped):
    assert mapped.page.locator("#map-slice-row").is_hidden()
    assert mapped.changed(choose, mapped, "map-axis", "2") > 0.005
    assert mapped.changed(slide, mapped, "map-slice", 0.1) > 0.0005
    height = float(mapped.page.locator("#map-slice-text").inner_text().removesuffix(" mm").replace("−", "-"))
    assert mapped.state("v.stage.map.uniforms.middle.value") == pytest.approx(height / 1e3, abs=1e-3)


def test_ellipsoids_appear_when_asked_for_and_grow(mapped):
    assert mapped.page.locator("#legend-ellipsoids").inner_text() == ""
    assert mapped.changed(mapped.page.locator("#show-ellipsoids").check) > 0.0005
    assert "95 %" in mapped.page.locator("#legend-ellipsoids").inner_text()
    assert mapped.changed(slide, mapped, "ellipsoid-factor", 9) > 0.002
    assert "×1000" in mapped.page.locator("#legend-ellipsoids").inner_text()


def test_the_legend_says_what_lies_beyond_the_measured_region(mapped):
    assert "beyond" in mapped.page.locator("#legend-map").inner_text()
    assert mapped.state("v.stage.map.data.beyond") > 50


def test_without_a_map_there_are_no_controls_for_it(tab):
    assert tab.page.locator("#map-block").is_hidden()
    assert tab.page.locator("#legend-map").is_hidden()
