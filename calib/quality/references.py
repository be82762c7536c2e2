"""References of the qualification: four regressions of NIST, and eight robots.

The regressions are of higher difficulty in NIST's Statistical Reference Datasets, each from both starting points, with
certified answers of eleven digits. Data and certified values are a work of the United States government and in the
public domain. The robots are three arms in round numbers (with an elbow, a selective compliance arm, one of five axes)
by Denavit-Hartenberg tables, and the five templates with loops.

Reference: nist_strd.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.registry import load_entry
from calib.core.robots.loading import load, robot
from calib.core.robots.robot import Robot

Model = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True, eq=False)
class ReferenceProblem:
    """A regression.

    Attributes:
        name: NIST's name.
        model: Values (m,) and derivatives (m, n) at parameters (n,) and predictors (m,).
        starts: Both starting points, (2, n).
        certified: Certified parameters, (n,).
        std: Their certified standard deviations, (n,).
        y, x: Response and predictor, (m,).
    """

    name: str
    model: Model
    starts: FloatArray
    certified: FloatArray
    std: FloatArray
    y: FloatArray
    x: FloatArray


def _boxbod(b: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    decay = np.exp(-b[1] * x)
    return b[0] * (1 - decay), np.stack([1 - decay, b[0] * x * decay], axis=1)


def _mgh09(b: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    top, bottom = x**2 + x * b[1], x**2 + x * b[2] + b[3]
    value = b[0] * top / bottom
    return value, np.stack([top / bottom, b[0] * x / bottom, -value * x / bottom, -value / bottom], axis=1)


def _mgh10(b: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    power = np.exp(b[1] / (x + b[2]))
    slope = b[0] * power / (x + b[2])
    return b[0] * power, np.stack([power, slope, -slope * b[1] / (x + b[2])], axis=1)


def _rat42(b: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    growth = np.exp(b[1] - b[2] * x)
    slope = b[0] * growth / (1 + growth) ** 2
    return b[0] / (1 + growth), np.stack([1 / (1 + growth), -slope, x * slope], axis=1)


def _problem(name: str, model: Model, table: str, y: str, x: str) -> ReferenceProblem:
    """A problem from lines of start 1, start 2, certified value and standard deviation of each parameter."""
    numbers = np.array([[float(cell) for cell in line.split()] for line in table.strip().splitlines()])
    response, predictor = (np.array([float(cell) for cell in text.split()]) for text in (y, x))
    return ReferenceProblem(name, model, numbers[:, :2].T, numbers[:, 2], numbers[:, 3], response, predictor)


PROBLEMS = (
    _problem(
        "BoxBOD",
        _boxbod,
        """1 100 2.1380940889E+02 1.2354515176E+01
           1 0.75 5.4723748542E-01 1.0455993237E-01""",
        "109 149 149 191 213 224",
        "1 2 3 5 7 10",
    ),
    _problem(
        "MGH09",
        _mgh09,
        """25 0.25 1.9280693458E-01 1.1435312227E-02
           39 0.39 1.9128232873E-01 1.9633220911E-01
           41.5 0.415 1.2305650693E-01 8.0842031232E-02
           39 0.39 1.3606233068E-01 9.0025542308E-02""",
        "0.1957 0.1947 0.1735 0.16 0.0844 0.0627 0.0456 0.0342 0.0323 0.0235 0.0246",
        "4 2 1 0.5 0.25 0.167 0.125 0.1 0.0833 0.0714 0.0625",
    ),
    _problem(
        "MGH10",
        _mgh10,
        """2 0.02 5.6096364710E-03 1.5687892471E-04
           400000 4000 6.1813463463E+03 2.3309021107E+01
           25000 250 3.4522363462E+02 7.8486103508E-01""",
        "34780 28610 23650 19630 16370 13720 11540 9744 8261 7030 6005 5147 4427 3820 3307 2872",
        "50 55 60 65 70 75 80 85 90 95 100 105 110 115 120 125",
    ),
    _problem(
        "Rat42",
        _rat42,
        """100 75 7.2462237576E+01 1.7340283401E+00
           1 2.5 2.6180768402E+00 8.8295217536E-02
           0.1 0.07 6.7359200066E-02 3.4465663377E-03""",
        "8.93 10.8 18.59 22.33 39.35 56.11 61.73 64.62 67.08",
        "9 14 21 28 42 57 63 70 79",
    ),
)


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
        urdf.write_text(load_entry("calib.methods", "urdf_of_table")(table), encoding="utf-8")
        tool = {"tool": {"frame": "flange", "xyz": ["30 mm", "20 mm", "50 mm"], "position": "unknown", "sigma": "2 mm"}}
        base = {"frame": "base_link", "pose": "unknown"}
        motors = [line.split(",")[0] for line in rows.splitlines()]
        yield name, robot(urdf, motors=motors, target=tool, base=base, sigma=NOISE)
    for name, template in load_entry("calib.methods", "templates").items():
        urdf, description = folder / f"{name}.urdf", folder / f"{name}.yaml"
        texts = template.files(urdf.name)
        urdf.write_text(texts[0], encoding="utf-8")
        description.write_text(texts[1] + f"\nsigma: {NOISE}\n", encoding="utf-8")
        yield template.what, load(description)
