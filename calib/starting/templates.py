"""Robots with loops to start from: a URDF cut open, and the description that closes it, from a few lengths."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial

from calib.core.base.errors import InputError, require_known
from calib.core.base.units import quantity, quantity_text
from calib.core.robots.urdf.plan import BASE, Plan
from calib.core.robots.urdf.writing import robot_text
from calib.starting.mechanisms import Lengths, delta, five_bar, four_bar, stewart, three_rrr

_mm = partial(quantity_text, dimension="length", form=".9g")


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
