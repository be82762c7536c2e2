"""A mechanism with loops under construction: a URDF cut open, and what closes it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from calib.core.robots.urdf.reader import Triple
from calib.core.robots.urdf.writing import joint_text

BASE = "base"
HERE: Triple = (0.0, 0.0, 0.0)
"""The origin of a link."""
_ROUND = (-2 * math.pi, 2 * math.pi)


@dataclass
class Plan:
    """Links and joints of a mechanism under construction.

    Attributes:
        axes: Directions that each closure holds.
        joints: Joints of the URDF, as text.
        links: Links of the URDF.
        motors: Joints with motors.
        home: Value of every moving joint [m or rad].
        loops: Pairs of links that coincide.
        targets: Link and point on it [m], by name.
        free: Joint origins with their free components.
    """

    axes: str
    joints: list[str] = field(default_factory=list)
    links: list[str] = field(default_factory=lambda: [BASE])
    motors: list[str] = field(default_factory=list)
    home: dict[str, float] = field(default_factory=dict)
    loops: list[tuple[str, str]] = field(default_factory=list)
    targets: dict[str, tuple[str, Triple]] = field(default_factory=dict)
    free: list[tuple[str, str]] = field(default_factory=list)

    def add_fixed_joint(
        self, name: str, parent: str, child: str, xyz: Iterable[float], free: str = "", turned: float = 0.0
    ) -> None:
        """Add a fixed joint, turned about z by `turned` [rad]; `free` names components that can be calibrated."""
        self._add(name, "fixed", parent, child, xyz, turned)
        self.free += [(name, free)] if free else []

    def hinge(
        self, name: str, parent: str, child: str, home: float, xyz: Iterable[float] = HERE, *, axis: str = "0 0 1",
        turned: float = 0.0, motor: bool = False, limits: tuple[float, float] = _ROUND,
    ) -> None:  # fmt: skip
        """Add a revolute joint with its origin turned about z by `turned` [rad]; without a motor it has no limits."""
        self._add(
            name, "revolute" if motor else "continuous", parent, child, xyz, turned, axis, limits if motor else None
        )
        self._moving(name, home, motor)

    def slider(
        self, name: str, parent: str, child: str, home: float, axis: str, limits: tuple[float, float], *, motor: bool
    ) -> None:
        """Add a sliding joint between limits [m]."""
        self._add(name, "prismatic", parent, child, HERE, 0.0, axis, limits)
        self._moving(name, home, motor)

    def _add(
        self, name: str, kind: str, parent: str, child: str, xyz: Iterable[float], turned: float = 0.0, axis: str = "",
        limits: tuple[float, float] | None = None,
    ) -> None:  # fmt: skip
        x, y, z = (float(value) for value in xyz)
        self.joints.append(joint_text(name, kind, (parent, child), (x, y, z), (0.0, 0.0, turned), axis, limits))
        self.links.append(child)

    def _moving(self, name: str, home: float, motor: bool) -> None:
        self.home[name] = float(home)
        if motor:
            self.motors.append(name)
