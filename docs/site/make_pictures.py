"""Take docs/figures/kind-*.png and print-*.png: the example arm, measured by every kind of instrument, simulated.

The first are of the viewer, the others of the first page that the report prints.

    python docs/site/make_pictures.py [--out FOLDER]

It needs Chromium and the extra `browser`. Errors of the arm are drawn at random, from a fixed seed.
"""

from __future__ import annotations

import argparse
import contextlib
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from screenshots import PAPER, small, take

import calib
from calib.core.base.files import write_folder
from viz.report_page import report_page
from viz.scene import scene_of_fit
from viz.viewer_page import scene_page

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
FIGURES = EXAMPLES.parent / "figures"
_ARM = """\
urdf: {urdf}
name_mot: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]
base: {{frame: base_link}}
targets: {{ball: {{frame: flange, {target}}}}}
instruments:
  {instruments}
parametrisation:
  - {{origin: all, components: [x, y, z], sigma: 1 mm}}
  - {{origin: all, components: [rx, ry, rz], sigma: 3 mrad}}
"""
_AT = "xyz: [20 mm, 0 mm, 50 mm]"
_PLATE = (
    "{frame: base_link, xyz: [0.5, 0.1, 0.35], pose: unknown, points: {a: [0, 0, 0], b: [0.2, 0, 0], c: [0, 0.15, 0]}}"
)
_ENDS = {"wire_a": [1.5, 0.9, 0.0], "wire_b": [1.5, -0.9, 0.0], "wire_c": [1.6, 0.0, 1.4]}
_WIRES = (
    f"{name}: {{kind: distance, target: ball, end: {{frame: base_link, xyz: {end}}}" for name, end in _ENDS.items()
)
_EYE = """\
eye: {kind: pixel, target: ball, image: [2000, 1600], intrinsics: {fx: 2200, fy: 2200, cx: 1000, cy: 800}, sigma: 0.1,
    camera: {frame: base_link, xyz: [2.2, 0.0, 0.9], rpy: [-1.5708, 0, 1.5708]},
    board: {kind: chessboard, columns: 8, rows: 5, square: 20 mm}}"""
KINDS = {
    "position": (_AT, "tracker: {kind: position, target: ball, sigma: 0.03 mm}"),
    "pose": (_AT, "tracker: {kind: pose, target: ball, sigma: 0.03 mm, sigma_angle: 0.1 mrad}"),
    "orientation": (_AT, "level: {kind: orientation, target: ball, axes: gravity, sigma: 0.05 mrad}"),
    "joint_reading": (
        _AT,
        "tracker: {kind: position, target: ball, sigma: 0.03 mm}\n"
        "  encoder: {kind: joint_reading, joint: joint_3, sigma: 0.1 mrad}",
    ),
    "pixel": ("xyz: [-60 mm, -45 mm, 40 mm]", _EYE),
    "distance": (_AT, "\n  ".join(f"{wire}, sigma: 0.03 mm}}" for wire in _WIRES)),
    "touch": (
        "position: unknown, sigma: 20 mm",
        f"probe: {{kind: touch, target: ball, sigma: 0.03 mm, artefact: {_PLATE}}}",
    ),
}
"""Where the ball is on the flange, and the instruments of each kind, in the words of a robot description."""
_PART = "const part = document.getElementById('part'); part.value = 1; part.dispatchEvent(new Event('change'));"
_OWN_SCALE = "document.getElementById('same-scale').click();"
_DARK = "document.getElementById('dark').click();"
_TOUCHES = EXAMPLES / "arm_touches_simulated.csv"
_DESKTOP, _PHONE = {"width": 1000, "height": 600}, {"width": 390, "height": 844}
PICTURES = tuple(
    (f"kind-{kind}", f"{kind}.html", _PHONE if kind == "orientation" else _DESKTOP, _OWN_SCALE + action)
    for kind, action in {
        "position": "",
        "pose": _PART,
        "orientation": "",
        "joint_reading": _PART,
        "pixel": _DARK,
        "distance": "",
        "touch": "",
    }.items()
) + tuple((f"print-{kind}", f"print-{kind}.html", PAPER, "") for kind in ("pixel", "distance", "touch"))
"""As `screenshots.PICTURES`: each kind with its colours for the errors after calibration, and printed reports."""
_LOW, _HIGH = np.radians([[-80, -40, -10, -120, -90, -170], [80, 80, 100, 120, 90, 170]])
_POSES, _SEED = 60, 7
_SEEN = 4  # times as many, of which the camera sees some


def pages(kind: str) -> dict[str, str]:
    """Return viewer page and report of the arm, calibrated with simulated readings of a kind, by their file names.

    Writes into the present folder, so that the report names its files without a path.
    """
    target, instruments = KINDS[kind]
    path = Path(f"{kind}.yaml")
    path.write_text(_ARM.format(urdf=EXAMPLES / "arm.urdf", target=target, instruments=instruments))
    robot, rng = calib.load(path), np.random.default_rng(_SEED)
    if kind == "touch":
        data = calib.read_measurements(shutil.copy(_TOUCHES, "."), robot)
    else:
        sigma = np.array([parameter.sigma_si for parameter in robot.parameters])
        actual = robot.with_parameters(robot.values + 0.3 * sigma * rng.standard_normal(len(sigma)))
        q = rng.uniform(_LOW, _HIGH, (_POSES * (_SEEN if kind == "pixel" else 1), 6))
        data = calib.simulate(actual, q, None, rng)
        data = replace(data, comments=(f"simulated readings of the example arm, kind {kind}",))
    fit = calib.fit(robot, data, validation=0.25)
    scene = scene_of_fit(fit)
    return {f"{kind}.html": scene_page(scene).html, f"print-{kind}.html": report_page(fit, scene=scene).html}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", metavar="FOLDER", type=Path, default=FIGURES, help="folder for the PNG files")
    out = parser.parse_args().out.resolve()
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        with contextlib.chdir(folder):
            for name, html in (entry for kind in KINDS for entry in pages(kind).items()):
                Path(name).write_text(html, encoding="utf-8")
        taken = take(folder, PICTURES)
    write_folder(out, {name: small(picture) for name, picture in taken.items()}, force=True)
    print("\n".join(f"{name}: {(out / name).stat().st_size / 1000:.0f} kB" for name in taken))


if __name__ == "__main__":
    main()
