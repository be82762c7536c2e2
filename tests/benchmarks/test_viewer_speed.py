"""How long the viewer takes with 5000 poses: to build, for each step in the browser's script, and to draw a frame.

Frames are drawn here without a graphics card, by the processor (SwiftShader, in Chromium): these times are the worst
that a user can meet. A graphics card draws the same 30 000 triangles in a few milliseconds.

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
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.goto(path.as_uri())
        page.wait_for_selector("body[data-ready]")
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
    """Script only: the browser draws once afterwards, however many steps there were; see below for frames."""
    benchmark.pedantic(tab.evaluate, (f"() => {{ {script} }}",), rounds=5, warmup_rounds=1)
    assert tab.evaluate("calibrationViewer.table.n") == 5000


_FRAME = """() => { const { stage } = calibrationViewer; const gl = stage.viewer.renderer.getContext();
  %s; stage.viewer.render(); gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); }"""


@pytest.mark.parametrize(
    "step",
    [
        pytest.param("calibrationViewer.step(1)", id="frame-after-a-step"),
        pytest.param("stage.viewer.camera.position.x += 0.001", id="frame-while-turning"),
        pytest.param("stage.marks.vectors.visible = false", id="frame-without-vectors"),
    ],
)
def test_a_frame(benchmark, tab, step):
    """Move, draw, and wait until the picture is there: reading a point of it back waits for all that was drawn."""
    tab.evaluate("calibrationViewer.stage.marks.vectors.visible = true")
    benchmark.pedantic(tab.evaluate, (_FRAME % step,), rounds=15, warmup_rounds=2)
    assert tab.evaluate("calibrationViewer.stage.viewer.renderer.info.render.triangles") > 10_000
