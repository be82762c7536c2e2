"""Make docs/figures/before_after.webp: a wrong sign of a real UR10's elbow found, then its errors before and after.

    python docs/site/make_moving_picture.py FOLDER [--out FILE]

FOLDER is that of docs/site/make_poster.py. It needs Chromium and the extra `browser`.
"""

from __future__ import annotations

import argparse
import io
import tempfile
from dataclasses import replace
from pathlib import Path

from make_poster import FIGURES, fitted, poses_of
from PIL import Image
from playwright.sync_api import sync_playwright
from screenshots import chromium

import calib
from viz.scene import build_scene, scene_of_fit
from viz.viewer_page import scene_page

FIGURE = FIGURES / "before_after.webp"
_WIDTH, _HEIGHT = 720, 560  # [px]
_WRONG = "elbow_joint"  # whose readings have the wrong sign at first
_TURN = """turned => { const { stage } = calibrationViewer, [x, y, z] = calibrationViewer.scene.view.direction;
  stage.look([x * Math.cos(turned) - y * Math.sin(turned), x * Math.sin(turned) + y * Math.cos(turned), z]); }"""
_SAY = """text => { let node = document.getElementById("said");
  if (!node) { node = document.createElement("p"); node.id = "said"; document.body.append(node);
    node.style.cssText = "position: fixed; left: 0; right: 0; top: 0; margin: 0; padding: 10px 16px; font-size: 17px;"
      + "font-weight: 600; background: rgba(255, 255, 255, .88); white-space: pre-line"; }
  const stage = document.getElementById("stage");
  stage.style.cssText = "margin-top: 76px; height: calc(100% - 76px)"; // below the words
  window.dispatchEvent(new Event("resize"));
  node.textContent = text; }"""


def pages(data: Path, folder: Path) -> list[tuple[Path, list[tuple[str, str]]]]:
    """Write the viewer's pages, and return each with what is shown of it: states, and the words above them."""
    robot, train, _ = poses_of(data)
    joints = train.joints.copy()
    joints[:, robot.joint_names.index(_WRONG)] *= -1.0
    wrong = calib.fit(robot, replace(train, joints=joints)).verdict
    found = wrong.reasons[0].text.partition(". In the description")[0]
    nominal = scene_page(build_scene(robot), embedded=True).save(folder / "nominal.html")
    fit = fitted(data)
    page = scene_page(scene_of_fit(fit), embedded=True).save(folder / "fitted.html")
    first = f"A real UR10, at poses that the fit has not used. Verdict: {fit.verdict.grade}\n"
    states = [
        (state, f"{first}{state} calibration: {1e3 * fit.validation.rms(state):.2f} mm RMS")
        for state in ("before", "after")
    ]
    return [
        (nominal, [("", f"A real UR10, its elbow counted the wrong way. Verdict: {wrong.grade}\n{found}")]),
        (page, states),
    ]


def frames(shown: list[tuple[Path, list[tuple[str, str]]]]) -> list[tuple[Image.Image, int]]:
    """Return pictures and how long each stands [ms]."""
    taken = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium())
        tab = browser.new_page(
            viewport={"width": _WIDTH, "height": _HEIGHT}, reduced_motion="reduce", color_scheme="light"
        )
        for path, states in shown:
            tab.goto(path.as_uri())
            tab.wait_for_selector("body[data-ready]")
            for state, words in states:
                if state:
                    tab.evaluate(f"document.getElementById('state-{state}').click()")
                tab.evaluate(_SAY, words)
                for turned in range(6):
                    tab.evaluate(_TURN, 0.06 * turned)
                    tab.evaluate(
                        "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
                    )
                    taken.append(
                        (Image.open(io.BytesIO(tab.screenshot())).convert("RGB"), 2500 if turned == 0 else 200)
                    )
        browser.close()
    return taken


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", metavar="FILE", type=Path, default=FIGURE, help="file to write")
    parser.add_argument("folder", metavar="FOLDER", type=Path, help="folder with robot.urdf and grid.csv of the UR10")
    options = parser.parse_args()
    out = options.out
    with tempfile.TemporaryDirectory() as temporary:
        pictures, times = zip(*frames(pages(options.folder, Path(temporary))), strict=True)
    pictures[0].save(out, save_all=True, append_images=pictures[1:], duration=list(times), loop=0, quality=70, method=4)
    print(f"{out.name}: {out.stat().st_size / 1000:.0f} kB, {len(pictures)} pictures")


if __name__ == "__main__":
    main()
