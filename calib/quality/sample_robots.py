"""Eight robots for qualification: three arms by Denavit-Hartenberg tables, and the five templates with loops.

The arms are a six-axis arm with an elbow, a selective compliance arm and a five-axis arm, in round numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

from calib.core.data.dh_files import read_dh
from calib.core.robots.loading import load, robot
from calib.core.robots.robot import Robot
from calib.core.robots.templates import TEMPLATES, loop_files
from calib.core.robots.urdf.denavit_hartenberg import urdf_text

_HEAD = "joint,type,theta [deg],d [mm],a [mm],alpha [deg],lower,upper\n"
_ARMS = {
    "six-axis arm": """\
a1,revolute,0,400,25,-90,-120 deg,120 deg
a2,revolute,0,0,455,0,-100 deg,10 deg
a3,revolute,0,0,35,-90,-60 deg,90 deg
a4,revolute,0,420,0,90,-150 deg,150 deg
a5,revolute,0,0,0,-90,-110 deg,110 deg
a6,revolute,0,80,0,0,-170 deg,170 deg
""",
    "SCARA": """\
s1,revolute,0,350,325,0,-120 deg,120 deg
s2,revolute,0,0,225,180,-130 deg,130 deg
s3,prismatic,0,0,0,0,50 mm,200 mm
s4,revolute,0,60,0,0,-170 deg,170 deg
""",
    "five-axis arm": """\
f1,revolute,0,250,60,90,-150 deg,150 deg
f2,revolute,0,0,280,0,-20 deg,140 deg
f3,revolute,0,0,300,0,-130 deg,-20 deg
f4,revolute,0,0,0,90,-80 deg,80 deg
f5,revolute,0,120,0,0,-170 deg,170 deg
""",
}
NOISE = "0.05 mm"
"""Noise of a simulated tracker, one standard deviation along each axis."""


def sample_robots() -> Iterator[tuple[str, Robot]]:
    """Yield the robots by their names."""
    with TemporaryDirectory() as folder:
        yield from _sample_robots(Path(folder))


def _sample_robots(folder: Path) -> Iterator[tuple[str, Robot]]:
    for name, rows in _ARMS.items():
        stem = name.replace(" ", "_")
        table, urdf = folder / f"{stem}.csv", folder / f"{stem}.urdf"
        table.write_text("# convention: standard\n" + _HEAD + rows, encoding="utf-8")
        urdf.write_text(urdf_text(read_dh(table), stem), encoding="utf-8")
        tool = {"tool": {"frame": "flange", "xyz": ["30 mm", "20 mm", "50 mm"], "position": "unknown", "sigma": "2 mm"}}
        base = {"frame": "base_link", "pose": "unknown"}
        motors = [line.split(",")[0] for line in rows.splitlines()]
        yield name, robot(urdf, motors=motors, target=tool, base=base, sigma=NOISE)
    for name, template in TEMPLATES.items():
        urdf, description = folder / f"{name}.urdf", folder / f"{name}.yaml"
        texts = loop_files(name, template.lengths, urdf.name)
        urdf.write_text(texts[0], encoding="utf-8")
        description.write_text(texts[1] + f"\nsigma: {NOISE}\n", encoding="utf-8")
        yield template.what, load(description)
