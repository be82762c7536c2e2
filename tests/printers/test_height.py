"""Heights above a plane, as the page on kinds of measurement describes them."""

import re

import numpy as np
from scipy.spatial.transform import Rotation

import calib
from tests.project import ROOT
from tests.six_axis_arm import HEAD, joints, write_six_axis

FREE = """\
parametrisation:
  - {origin: j3, components: [ry], sigma: 5 mrad}
  - {origin: j5, components: [ry], sigma: 5 mrad}
"""


def test_the_gauge_of_the_page_finds_angles_of_an_arm_and_how_the_plate_lies(tmp_path):
    page = (ROOT / "docs" / "howto" / "measure.md").read_text(encoding="utf-8")
    (excerpt,) = re.findall(r"```yaml\n(targets: [^`]*kind: height[^`]*)```", page)
    described = excerpt.replace("flange", "l6").replace("base_link", "l0")
    robot = calib.load(write_six_axis(tmp_path, f"{HEAD}base: {{frame: l0}}\n{described}{FREE}"))
    angles, q = {"j3.ry": 4e-3, "j5.ry": -6e-3}, joints(60)
    normal = Rotation.from_euler("xyz", [0.03, -0.02, 0]).apply([0, 0, 1])
    above = robot.with_parameters(angles).positions(q)[:, 0] - np.array([0.4, 0, 0.052])
    heights = above @ normal + 1e-5 * np.random.default_rng(2).standard_normal(60)
    fit = calib.fit(robot, calib.as_measurements(robot, q, {"gauge": heights[:, None]}))
    assert fit.verdict.grade == "PASS"
    for name, value in (angles | {"gauge_plane.rx": 0.03, "gauge_plane.ry": -0.02}).items():
        estimate = fit.parameters[name]
        assert estimate.low95 < np.degrees(value) < estimate.high95, name
        assert estimate.std < 0.05, name  # deg: stated to 0.3 and 3
