"""How long the viewer takes with 5000 poses: to build, and for each step through the poses in the browser.

python -m pytest tests/benchmarks/test_viewer_speed.py --benchmark-enable
"""

import sys
from pathlib import Path

import pytest

from viz.scene import build_scene
from viz.viewer_page import scene_page

sys.path.insert(0, str(Path(__file__).parents[1]))
from viz_examples import many_poses

CHROMIUM = Path("/usr/bin/chromium")


@pytest.fixture(scope="module")
def robots_and_poses():
    return many_poses(5000)


@pytest.fixture(scope="module")
def tab(robots_and_poses, tmp_path_factory):
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed (extra 'browser')")
    if not CHROMIUM.exists():
        pytest.skip(f"{CHROMIUM} is missing (Debian package 'chromium')")
    path = scene_page(build_scene(*robots_and_poses)).save(tmp_path_factory.mktemp("pages") / "viewer.html")
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=str(CHROMIUM))
        page = browser.new_page()
        page.goto(path.as_uri())
        page.wait_for_selector("body[data-ready]")
        page.evaluate("calibrationViewer.stage.viewer.render = () => {}")
        yield page
        browser.close()


def test_building_the_scene(benchmark, robots_and_poses):
    scene = benchmark.pedantic(build_scene, robots_and_poses, rounds=3, warmup_rounds=0)
    assert len(scene.poses) == 5000


def test_building_the_page(benchmark, robots_and_poses):
    page = benchmark.pedantic(scene_page, (build_scene(*robots_and_poses),), rounds=3, warmup_rounds=0)
    assert len(page.html) < 4e6


@pytest.mark.parametrize(
    "script",
    [
        pytest.param("for (let i = 0; i < 100; i += 1) calibrationViewer.go(37 * i % 5000)", id="100-steps"),
        pytest.param(
            "for (let i = 0; i < 100; i += 1) calibrationViewer.stage.showPose(37 * i % 5000)", id="100-robot-moves"
        ),
        pytest.param("for (let i = 0; i < 10; i += 1) calibrationViewer.applyState()", id="10-switches-before-after"),
        pytest.param("for (let i = 0; i < 10; i += 1) calibrationViewer.filter()", id="10-group-switches"),
    ],
)
def test_the_page_in_the_browser(benchmark, tab, script):
    """Script only, without drawing, which depends on the graphics card."""
    benchmark.pedantic(tab.evaluate, (f"() => {{ {script} }}",), rounds=5, warmup_rounds=1)
    assert tab.evaluate("calibrationViewer.table.n") == 5000
