"""Linear deltas: printers whose nozzle hangs on three arms from carriages on vertical towers, as firmwares define them.

Tower k stands at radius R and angle alpha_k about the centre, and its carriage is E_k - q_k above the bed after moving
down by q_k from its switch. Its arm, of length L_k, ends in the nozzle (offsets of platform and carriages are in R). A
firmware states the height of the nozzle at the centre when the switch trips instead of E_k:

    E_k = endstop_k + sqrt(L_k^2 - R^2)

The parametrisation `linear_delta` has the firmwares' numbers: R, the angles of a and b (c is fixed, since turning all
towers together changes no probed height), three arms, three endstops. Origins follow:

    tower_k:  (R cos alpha_k, R sin alpha_k, E_k), turned by alpha_k about z        arm_k_end:  (0, 0, -L_k)

Expected errors: probing hardly determines arms and angles, so these are from drawings (`ARM`, `ANGLE`); it determines R
and endstops.

A distance between two places is measured after both were printed. Then the robot is there twice, `tower_a_2` and so on,
with the same parameters, and the distance is that of the two nozzles.

Reference: Klipper's documentation of delta calibration.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import DescriptionError, InputError
from calib.core.base.parameter import Parameter
from calib.core.base.units import DISPLAY_UNIT, Dimension, quantity_text
from calib.core.robots.parameters import Origin, ResultUse, twist_of_edit
from calib.shared.plan import BASE, Plan

TOWERS = ("a", "b", "c")
ANGLES = (math.radians(210), math.radians(330), math.radians(90))
"""Designed angles of the towers [rad]."""
NAME = "linear_delta"
ARM, ANGLE = 0.3e-3, math.radians(0.3)
"""Expected errors of an arm [m] and of a tower's angle [rad]."""
PARAMETERS: dict[str, tuple[Dimension, float]] = {
    "delta_radius": ("length", 2e-3),
    **{f"angle_{tower}": ("angle", ANGLE) for tower in "ab"},
    **{f"arm_{tower}": ("length", ARM) for tower in TOWERS},
    **{f"endstop_{tower}": ("length", 10e-3) for tower in TOWERS},
}
"""Dimension and expected error [m or rad] of each parameter."""
HEIGHT, DISTANCE = 0.05e-3, 0.1e-3
"""Noise of a probed height and of a distance [m]."""


@dataclass(frozen=True)
class DeltaGeometry:
    """Geometry of a linear delta as firmware has it.

    Attributes:
        radius: R [m].
        angles: Angles of towers a, b, c [rad].
        arms: Their arms [m].
        endstops: Height of the nozzle at the centre when their switches trip [m].
    """

    radius: float
    angles: tuple[float, ...]
    arms: tuple[float, ...]
    endstops: tuple[float, ...]

    @classmethod
    def from_values(cls, values: Sequence[float] | FloatArray, angle_c: float) -> DeltaGeometry:
        """Return the geometry with parameter values (9,) [m, rad], and tower c at `angle_c` [rad]."""
        radius, a, b, *lengths = map(float, values)
        return cls(radius, (a, b, angle_c), tuple(lengths[:3]), tuple(lengths[3:]))

    @property
    def values(self) -> FloatArray:
        """Values in the order of `PARAMETERS`, (9,) [m, rad]."""
        return np.array([self.radius, *self.angles[:2], *self.arms, *self.endstops])

    def __post_init__(self) -> None:
        if not 0 < self.radius < min(self.arms):
            raise InputError(
                f"arms of {quantity_text(min(self.arms), 'mm', 'g')} on towers at a radius of"
                f" {quantity_text(self.radius, 'mm', 'g')} reach nothing; correct delta_radius or arm_length"
            )

    @property
    def tops(self) -> FloatArray:
        """Places of the carriages at their switches, (3, 3) [m]: towers at R and alpha, at the heights E."""
        towers = zip(self.angles, self.arms, self.endstops, strict=True)
        R = self.radius
        return np.array(
            [(R * math.cos(angle), R * math.sin(angle), end + math.sqrt(arm**2 - R**2)) for angle, arm, end in towers]
        )

    def nozzle(self, down: FloatArray) -> FloatArray:
        """Return the nozzle's position, (n, 3) [m], after a travel of the carriages, (n, 3) [m].

        It is the lower intersection of the three arms; NaN without one.
        """
        points = np.tile(self.tops, (len(down), 1, 1))
        points[:, :, 2] -= down
        first, second, third = points[:, 0], points[:, 1] - points[:, 0], points[:, 2] - points[:, 0]
        width = np.linalg.norm(second, axis=1)
        ex = second / width[:, None]
        along = np.sum(ex * third, axis=1)
        ey = third - along[:, None] * ex
        across = np.linalg.norm(ey, axis=1)
        ey = ey / across[:, None]
        first_square, second_square, third_square = (arm**2 for arm in self.arms)
        x = (first_square - second_square + width**2) / (2 * width)
        y = (first_square - third_square + along**2 + across**2 - 2 * along * x) / (2 * across)
        with np.errstate(invalid="ignore"):
            z = np.sqrt(first_square - x**2 - y**2)
        normal = np.cross(ex, ey)
        normal *= -np.sign(normal[:, 2:])
        return np.asarray(first + x[:, None] * ex + y[:, None] * ey + z[:, None] * normal)


def tower_angles(angle_c: float) -> tuple[float, ...]:
    """Return tower angles [rad] a third of a circle apart, with the third at `angle_c` [rad]."""
    a, b, _ = ((angle + (angle_c - ANGLES[2])) % math.tau for angle in ANGLES)
    return a, b, angle_c


class LinearDelta:
    """The parametrisation; see the module docstring."""

    result_use = ResultUse(
        "write the lines for the printer's settings (or --format marlin, duet)",
        "calib export DIR --format klipper --out settings.cfg",
        "the firmware of a delta printer holds the result itself: calib export --format klipper, marlin or duet;"
        " after that its programs need no change",
    )

    def __init__(self, origins: Mapping[str, Origin]) -> None:
        needed = [f"{part}_{tower}{end}" for tower in TOWERS for part, end in (("tower", ""), ("arm", "_end"))]
        missing = next((name for name in needed if name not in origins), None)
        if missing is not None:
            raise DescriptionError(f"parametrisation 'linear_delta': the URDF has no joint '{missing}'; see calib init")
        self._suffixes = ("", "_2") if "tower_a_2" in origins else ("",)
        places = [origins[f"tower_{tower}"] for tower in TOWERS]
        *angles, self._angle_c = (float(place.rpy[2]) for place in places)
        radius = float(np.mean([math.hypot(*place.xyz[:2]) for place in places]))
        arms = [-float(origins[f"arm_{tower}_end"].xyz[2]) for tower in TOWERS]
        ends = [float(p.xyz[2]) - math.sqrt(arm**2 - radius**2) for p, arm in zip(places, arms, strict=True)]
        self.parameters = tuple(
            Parameter(name, dimension, value, error, DISPLAY_UNIT[dimension])
            for (name, (dimension, error)), value in zip(
                PARAMETERS.items(), (radius, *angles, *arms, *ends), strict=True
            )
        )

    def placements(self, values: FloatArray) -> dict[str, pin.SE3]:
        """Return the origins; see `calib.core.robots.parameters.Parametrisation`."""
        geometry, edited = DeltaGeometry.from_values(values, self._angle_c), {}
        for k, tower in enumerate(TOWERS):
            turn = pin.rpy.rpyToMatrix(0.0, 0.0, geometry.angles[k])
            for suffix in self._suffixes:
                edited[f"tower_{tower}{suffix}"] = pin.SE3(turn, geometry.tops[k])
                edited[f"arm_{tower}{suffix}_end"] = pin.SE3(np.eye(3), np.array([0.0, 0.0, -geometry.arms[k]]))
        return edited

    def twists(self, values: FloatArray) -> dict[str, FloatArray]:
        """Return derivatives of the origins, (6, 9) each; see `calib.core.robots.parameters.Parametrisation`."""
        geometry, result = DeltaGeometry.from_values(values, self._angle_c), {}
        for k, tower in enumerate(TOWERS):
            angle, arm, n = geometry.angles[k], geometry.arms[k], len(self.parameters)
            rise = math.sqrt(arm**2 - geometry.radius**2)
            d_xyz, d_rpy, d_end = np.zeros((3, n)), np.zeros((3, n)), np.zeros((3, n))
            d_xyz[:, 0] = math.cos(angle), math.sin(angle), -geometry.radius / rise
            d_xyz[2, 3 + k], d_xyz[2, 6 + k] = arm / rise, 1.0
            if k < 2:
                d_xyz[:2, 1 + k] = -geometry.radius * math.sin(angle), geometry.radius * math.cos(angle)
                d_rpy[2, 1 + k] = 1.0
            d_end[2, 3 + k] = -1.0
            for suffix in self._suffixes:
                result[f"tower_{tower}{suffix}"] = twist_of_edit(np.array([0.0, 0.0, angle]), d_xyz, d_rpy)
                result[f"arm_{tower}{suffix}_end"] = twist_of_edit(np.zeros(3), d_end, np.zeros((3, n)))
        return result


def linear_delta_plan(geometry: DeltaGeometry, copies: int = 1) -> Plan:
    """Return the printer, cut open where the arms meet the platform; home is 20 mm high. Distances need two copies."""
    plan, height = Plan("x, y, z"), 0.02
    for suffix in ("", "_2")[:copies]:
        parent, reach = BASE, 2 * max(geometry.arms)
        for axis, name, home in (("1 0 0", "x", 0.0), ("0 1 0", "y", 0.0), ("0 0 1", "z", height)):
            child = "platform" + suffix if name == "z" else f"platform_at_{name}{suffix}"
            limits = (-reach, max(reach, 2 * max(geometry.endstops)))
            plan.slider(f"platform_{name}{suffix}", parent, child, home, axis, limits, motor=False)
            parent = child
        for k, tower in enumerate(TOWERS):
            angle, arm, carriage = geometry.angles[k], geometry.arms[k], f"carriage_{tower}{suffix}"
            name = f"arm_{tower}{suffix}"
            top = geometry.tops[k]
            plan.add_fixed_joint(f"tower_{tower}{suffix}", BASE, f"top_{tower}{suffix}", top, turned=angle)
            down, room = geometry.endstops[k] - height, (-0.01, float(top[2]))
            plan.slider(f"{tower}{suffix[1:]}", f"top_{tower}{suffix}", carriage, down, "0 0 -1", room, motor=True)
            lean = math.asin(geometry.radius / arm)
            plan.hinge(f"{name}_y", carriage, f"{name}_cross", lean, axis="0 1 0")
            plan.hinge(f"{name}_x", f"{name}_cross", f"{name}_link", 0.0, axis="1 0 0")
            plan.add_fixed_joint(f"{name}_end", f"{name}_link", f"{name}_tip", (0.0, 0.0, -arm))
            plan.loops.append((f"platform{suffix}", f"{name}_tip"))
    plan.targets["nozzle"] = ("platform", (0.0, 0.0, 0.0))
    return plan


def linear_delta_description(plan: Plan, title: str, urdf: str, n_rows: int, saved: DeltaGeometry) -> str:
    """Return the text of a delta's description; arms are held if there are no more rows than parameters."""
    twice = "platform_2" in plan.links
    sigma = quantity_text(DISTANCE, "mm", "g")
    caliper = f"  caliper: {{kind: distance, target: nozzle, end: {{frame: platform_2}}, sigma: {sigma}}}\n"
    pairs = ", ".join(f"[{frame}, {other}]" for frame, other in plan.loops)
    return f"""\
# Robot description of a linear delta: {title}.
urdf: {json.dumps(urdf, ensure_ascii=False)}

# How far each carriage has come down from its switch{", at both ends of a measured distance" if twice else ""}.
name_mot: [{", ".join(plan.motors)}]

# The arms, cut open in the URDF where they meet the platform.
closed_loop: [{pairs}]
type: [{", ".join(["3d"] * len(plan.loops))}]

# The nozzle over the centre, 20 mm high [m, rad].
home:
{"".join(f"  {name}: {value!r}" + chr(10) for name, value in plan.home.items())}
# The bed is the plane z = 0.
base: {{frame: {BASE}, pose: known}}
targets:
  nozzle: {{frame: platform}}

# What is measured: heights over the bed, distances of a printed object.
instruments:
  probe: {{kind: height, target: nozzle, sigma: {quantity_text(HEIGHT, "mm", "g")}}}
{caliper if twice else ""}
# delta_radius, angles of towers, arms and endstops as firmwares have them. Probing hardly shows arms and angles: they
# are expected to be as designed, within {quantity_text(ARM, "mm", "g")} and {quantity_text(ANGLE, "deg", "g")}.
parametrisation: {NAME}
{_in_use(saved) if n_rows else ""}{_HELD if 0 < n_rows <= len(PARAMETERS) else ""}"""


def _in_use(saved: DeltaGeometry) -> str:
    texts: dict[Dimension, list[str]] = {"length": [], "angle": []}
    for (name, (dimension, _)), value in zip(PARAMETERS.items(), saved.values, strict=True):
        texts[dimension].append(f"{name}: {quantity_text(value, DISPLAY_UNIT[dimension], '.6f')}")
    entries = ", ".join([*texts["length"], *texts["angle"]])
    return f"\n# What the firmware uses now. It was computed from the same rows.\nin_use: {{{entries}}}\n"


_HELD = """\

# With so few rows, free arms would leave no degrees of freedom to judge a fit. So the arms are held.
held: [arm_a, arm_b, arm_c]
"""
