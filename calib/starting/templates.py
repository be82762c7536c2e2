"""Robots with loops to start from: a URDF cut open, and the description that closes it, from a few lengths.

Every mechanism here closes exactly. None of its joints spins without moving anything, as no closure could find its
value.

* Planar ones turn about z and are cut at a hinge; the closure holds x and y.
* The platform of a delta or a Stewart robot hangs on six joints without motors (x, y, z, rx, ry, rz) that only state
  its pose. Each leg ends in a point of the platform (type 3d). A leg is on a universal joint, two crossed hinges, and
  so has no spin about itself. Six legs: 6 + 12 passive joints, 18 equations.
* A parallelogram of the delta is its two rods, each of them a leg. So the platform tilts if rods differ.

Home is computed from the lengths; lengths that cannot be assembled are an error.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import InputError, require_known
from calib.core.base.units import quantity, quantity_text
from calib.core.robots.urdf.writing import robot_text
from calib.shared.plan import BASE, HERE, Plan

_DELTA = (-0.6, 1.2)  # range in which all three arms of a usual delta reach the platform [rad]
Lengths = Mapping[str, float]


def four_bar(length: Lengths) -> Plan:
    """A crank with a motor, a coupler, a rocker; home is in the middle of the crank's range.

    `InputError` if the lengths do not close.
    """
    ground, crank, coupler, rocker = (length[name] for name in ("ground", "crank", "coupler", "rocker"))
    low, high = max(abs(coupler - rocker), abs(ground - crank)), min(coupler + rocker, ground + crank)
    if low >= high:
        raise InputError("the longest link is longer than the other three together")
    across = (low + high) / 2
    angle = math.acos((crank**2 + ground**2 - across**2) / (2 * crank * ground))
    end = crank * np.array([math.cos(angle), math.sin(angle)])
    along, bend = _two_links(np.array([ground, 0.0]) - end, coupler, rocker, 1)
    plan = Plan("x, y")
    plan.hinge("crank", BASE, "crank_link", angle, motor=True)
    plan.hinge("coupler", "crank_link", "coupler_link", along - angle, (crank, 0, 0))
    plan.add_fixed_joint("coupler_end", "coupler_link", "coupler_tip", (coupler, 0, 0), "x")
    plan.hinge("rocker", BASE, "rocker_link", along + bend + math.pi, (ground, 0, 0))
    plan.add_fixed_joint("rocker_end", "rocker_link", "rocker_tip", (rocker, 0, 0), "x")
    plan.loops.append(("coupler_tip", "rocker_tip"))
    plan.targets["pin"] = ("coupler_link", (coupler / 2, 0.0, 0.0))
    plan.free += [("crank", "x, y, rz"), ("coupler", "x"), ("rocker", "x, y")]
    return plan


def five_bar(length: Lengths) -> Plan:
    """Two arms with a motor each that meet at the pen, elbows outwards; `InputError` if the lengths do not close."""
    half, proximal, distal = length["motor_distance"] / 2, length["proximal"], length["distal"]
    low, high = max(abs(proximal - distal), half), proximal + distal
    if low >= high:
        raise InputError("the two arms are too short to meet")
    tip = np.array([0.0, math.sqrt(((low + high) / 2) ** 2 - half**2)])
    plan = Plan("x, y")
    for arm, side in (("left", 1), ("right", -1)):
        _planar_arm(plan, arm, np.array([-side * half, 0.0]), tip, (proximal, distal), side)
    plan.loops.append(("left_tip", "right_tip"))
    plan.targets["pen"] = ("left_tip", HERE)
    return plan


def three_rrr(length: Lengths) -> Plan:
    """A platform in a plane on three arms of two links, motors at the base."""
    links = (length["proximal"], length["distal"])
    plan = Plan("x, y")
    anchors = [length["platform_radius"] * _direction(angle)[:2] for angle in (90, 210, 330)]
    for k, (angle, anchor) in enumerate(zip((90, 210, 330), anchors, strict=True), start=1):
        turn = _planar_arm(plan, f"arm_{k}", length["base_radius"] * _direction(angle)[:2], anchor, links, 1)
        if k == 1:
            plan.hinge("wrist", "arm_1_tip", "wrist_link", -turn)
            plan.add_fixed_joint("platform_1", "wrist_link", "platform", (*-anchor, 0), "x, y")
        else:
            plan.add_fixed_joint(f"platform_{k}", "platform", f"platform_{k}_link", (*anchor, 0), "x, y")
            plan.loops.append((f"platform_{k}_link", f"arm_{k}_tip"))
    plan.targets["reflector_1"] = ("platform", (length["platform_radius"] / 2, 0.0, 0.0))
    plan.targets["reflector_2"] = ("platform", (-length["platform_radius"] / 2, 0.0, 0.0))
    return plan


def delta(length: Lengths) -> Plan:
    """Three arms with motors; home with all of them level, the platform below (z is up, positive angles go down).

    `InputError` if the lengths do not close.
    """
    upper, rod, half = length["upper_arm"], length["rod"], length["rod_distance"] / 2
    out = length["base_radius"] + upper - length["platform_radius"]
    if rod <= abs(out):
        raise InputError("the rods are too short to reach the platform from level arms")
    plan = Plan("x, y, z")
    _platform(plan, -math.sqrt(rod**2 - out**2), 2 * (upper + rod))
    for k, angle in enumerate((0, 120, 240), start=1):
        outwards, sideways = _direction(angle), _direction(angle + 90)
        arm, place = f"arm_{k}", length["base_radius"] * outwards
        turned = math.radians(angle)
        plan.hinge(arm, BASE, f"{arm}_link", 0.0, place, axis="0 1 0", turned=turned, motor=True, limits=_DELTA)
        plan.free += [(arm, "x, y, z"), (arm, "rx, ry, rz")]
        for j, side in enumerate((-half, half), start=1):
            name = f"rod_{k}{j}"
            plan.hinge(
                f"{name}_y", f"{arm}_link", f"{name}_cross", math.asin(out / rod), (upper, side, 0), axis="0 1 0"
            )
            plan.hinge(f"{name}_x", f"{name}_cross", f"{name}_link", 0.0, axis="1 0 0")
            plan.free.append((f"{name}_y", "x, y, z"))
            plan.add_fixed_joint(f"{name}_end", f"{name}_link", f"{name}_tip", (0, 0, -rod), "z")
            _anchor(plan, name, length["platform_radius"] * outwards + side * sideways)
    plan.targets["tool"] = ("platform", HERE)
    return plan


def stewart(length: Lengths) -> Plan:
    """A 6-UPS hexapod: joints in pairs, at 0, 120 and 240 degrees below, at 60, 180 and 300 above.

    The value of a motor is the length of its leg. `InputError` if a pair is wider than its circle.
    """
    for level in ("base", "platform"):
        if length[f"{level}_pair"] >= length[f"{level}_radius"]:
            raise InputError(f"{level}_pair must be less than {level}_radius")
    below, above = (
        math.degrees(math.asin(length[f"{level}_pair"] / 2 / length[f"{level}_radius"]))
        for level in ("base", "platform")
    )
    height = length["height"]
    plan = Plan("x, y, z")
    _platform(plan, height, 3 * (height + length["base_radius"] + length["platform_radius"]))
    for k in range(6):
        centre, side = 120 * (k // 2), -1 if k % 2 == 0 else 1
        foot = length["base_radius"] * _direction(centre + side * below)
        anchor = length["platform_radius"] * _direction(centre + side * (60 - above))
        leg = anchor + np.array([0, 0, height]) - foot
        long = float(np.linalg.norm(leg))
        name = f"leg_{k + 1}"
        plan.hinge(f"{name}_x", BASE, f"{name}_cross", math.atan2(-leg[1], leg[2]), foot, axis="1 0 0")
        plan.hinge(f"{name}_y", f"{name}_cross", f"{name}_cylinder", math.asin(leg[0] / long), axis="0 1 0")
        plan.slider(name, f"{name}_cylinder", f"{name}_tip", long, "0 0 1", (0.8 * long, 1.2 * long), motor=True)
        plan.free += [(f"{name}_x", "x, y, z"), (name, "z")]
        _anchor(plan, name, anchor)
    for k, angle in enumerate((0, 120, 240), start=1):
        x, y, _ = length["platform_radius"] / 2 * _direction(angle)
        plan.targets[f"reflector_{k}"] = ("platform", (float(x), float(y), 0.0))
    return plan


def _direction(degrees: float) -> FloatArray:
    return np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees)), 0.0])


def _two_links(to: FloatArray, first: float, second: float, side: int) -> tuple[float, float]:
    """Angle of the first link and bend to the second that reach `to` (2,) [m], elbow to the left for side 1."""
    far = math.hypot(*to)
    if not abs(first - second) < far < first + second:
        shown = [quantity_text(length, "mm", ".9g") for length in (first, second, far)]
        raise InputError(f"links of {shown[0]} and {shown[1]} cannot span {shown[2]}")
    start = math.atan2(to[1], to[0]) + side * math.acos((first**2 + far**2 - second**2) / (2 * first * far))
    bend = -side * (math.pi - math.acos((first**2 + second**2 - far**2) / (2 * first * second)))
    return start, bend


def _planar_arm(
    plan: Plan, arm: str, foot: FloatArray, tip: FloatArray, links: tuple[float, float], side: int
) -> float:
    """Add motor, elbow and tip of an arm of two links; return the direction of its end at home [rad]."""
    start, bend = _two_links(tip - foot, *links, side)
    plan.hinge(
        f"{arm}_motor", BASE, f"{arm}_proximal", start, (*foot, 0), motor=True, limits=(start - 0.6, start + 0.6)
    )
    plan.hinge(f"{arm}_elbow", f"{arm}_proximal", f"{arm}_distal", bend, (links[0], 0, 0))
    plan.add_fixed_joint(f"{arm}_end", f"{arm}_distal", f"{arm}_tip", (links[1], 0, 0), "x")
    plan.free += [(f"{arm}_motor", "x, y, rz"), (f"{arm}_elbow", "x")]
    return start + bend


def _platform(plan: Plan, z: float, reach: float) -> None:
    """Add six joints without motors that state the pose of the platform."""
    parent = BASE
    for axis, name, home in (("1 0 0", "x", 0.0), ("0 1 0", "y", 0.0), ("0 0 1", "z", z)):
        plan.slider(f"platform_{name}", parent, f"platform_at_{name}", home, axis, (-reach, reach), motor=False)
        parent = f"platform_at_{name}"
    for axis, name, child in (("1 0 0", "rx", "at_rx"), ("0 1 0", "ry", "at_ry"), ("0 0 1", "rz", "")):
        link = f"platform_{child}" if child else "platform"
        plan.hinge(f"platform_{name}", parent, link, 0.0, axis=axis)
        parent = link


def _anchor(plan: Plan, leg: str, xyz: FloatArray) -> None:
    """Add the point of the platform at the end of a leg."""
    plan.add_fixed_joint(f"{leg}_anchor", "platform", f"{leg}_place", xyz, "x, y, z")
    plan.loops.append((f"{leg}_place", f"{leg}_tip"))


_mm = partial(quantity_text, unit="mm", form=".9g")


@dataclass(frozen=True)
class LoopTemplate:
    """A kind of mechanism.

    Attributes:
        name: Its name on the command line.
        what: The robot in a few words.
        lengths: Every length with its default [m].
        build: Its function.
    """

    name: str
    what: str
    lengths: Lengths
    build: Callable[[Lengths], Plan]

    def files(self, urdf: str, lengths: Lengths | None = None) -> tuple[str, str]:
        """Return the text of a URDF, and of the description that calls it `urdf`, from every length [m].

        `InputError` if nothing can be assembled from these lengths.
        """
        lengths = self.lengths if lengths is None else lengths
        lengths_text = ", ".join(f"{key} {_mm(value)}" for key, value in lengths.items())
        try:
            plan = self.build(lengths)
        except InputError as error:
            raise InputError(f"template {self.name} with {lengths_text}: {error}") from None
        text = robot_text(self.name, f"{self.what}, cut open: {lengths_text}", plan.links, plan.joints)
        return text, _description(plan, f"{self.what}: {lengths_text}", urdf)


TEMPLATES = {
    template.name: template
    for template in (
        LoopTemplate(
            "four_bar", "planar four-bar", {"ground": 0.4, "crank": 0.1, "coupler": 0.35, "rocker": 0.25}, four_bar
        ),
        LoopTemplate("five_bar", "planar five-bar", {"motor_distance": 0.2, "proximal": 0.2, "distal": 0.3}, five_bar),
        LoopTemplate(
            "3rrr",
            "planar 3-RRR",
            {"base_radius": 0.4, "platform_radius": 0.1, "proximal": 0.2, "distal": 0.25},
            three_rrr,
        ),
        LoopTemplate(
            "delta",
            "delta with a pair of rods on each arm",
            {"base_radius": 0.15, "platform_radius": 0.05, "upper_arm": 0.2, "rod": 0.5, "rod_distance": 0.1},
            delta,
        ),
        LoopTemplate(
            "stewart",
            "Stewart platform, 6-UPS",
            {"base_radius": 0.3, "platform_radius": 0.2, "base_pair": 0.1, "platform_pair": 0.08, "height": 0.4},
            stewart,
        ),
    )
}
"""Templates by their names on the command line."""


def read_lengths(name: str, given: Iterable[str]) -> dict[str, float]:
    """Return lengths [m], those of `given` (NAME=VALUE, with a unit) in place of defaults; or raise `InputError`."""
    lengths, seen = dict(TEMPLATES[name].lengths), set()
    for text in given:
        key, equals, value = (part.strip() for part in text.partition("="))
        if not equals:
            raise InputError(f"--length {text}: is not NAME=VALUE, such as {next(iter(lengths))}=200mm")
        require_known(key, lengths, f"--length {text}: template {name} has no length")
        if key in seen:
            raise InputError(f"--length {text}: '{key}' is given twice")
        seen.add(key)
        lengths[key] = quantity(value, "length", f"--length {key}")
        if lengths[key] <= 0:
            raise InputError(f"--length {text}: must be greater than 0")
    return lengths


def _description(plan: Plan, title: str, urdf: str) -> str:
    pairs = ", ".join(f"[{frame}, {other}]" for frame, other in plan.loops)
    targets = "".join(
        f"  {name}: {{frame: {frame}, xyz: [{', '.join(map(_mm, xyz))}], position: unknown, sigma: 2 mm}}\n"
        for name, (frame, xyz) in plan.targets.items()
    )
    free = "".join(
        f"  - {{origin: {origin}, components: [{part}], sigma: {'5 mrad' if part.startswith('r') else '1 mm'}}}\n"
        for origin, components in plan.free
        for part in _grouped_by_unit(components)
    )
    return f"""\
# Robot description of a {title}.
urdf: {json.dumps(urdf, ensure_ascii=False)}

# Joints with a motor, in the order of every joint vector. Measurement files have one column for each.
name_mot: [{", ".join(plan.motors)}]

# The loops, cut open in the URDF: these frames coincide, in the directions that the mechanism constrains.
closed_loop: [{pairs}]
type: [{", ".join(["3d"] * len(plan.loops))}]
closed_loop_axes: [{", ".join([f"[{plan.axes}]"] * len(plan.loops))}]

# An assembled configuration [m, rad]: it decides between the ways of assembling.
home:
{"".join(f"  {name}: {value!r}" + chr(10) for name, value in plan.home.items())}
# A tracker anywhere; 'known' if measurements are in this link's frame.
base: {{frame: {BASE}, pose: unknown}}

# What is measured: columns <name>_x, <name>_y, <name>_z; about where each point is on its link.
targets:
{targets}
# What may be wrong, and by how much (sigma, one standard deviation).
parametrisation:
{free}
# Standard deviation of one measured coordinate; left out, it is found from the residuals.
# sigma: 0.04 mm
"""


def _grouped_by_unit(components: str) -> list[str]:
    """Components `x, y, rz` as `x, y` and `rz`: an entry has one sigma."""
    names = components.split(", ")
    parts = ([name for name in names if len(name) == 1], [name for name in names if len(name) > 1])
    return [", ".join(part) for part in parts if part]
