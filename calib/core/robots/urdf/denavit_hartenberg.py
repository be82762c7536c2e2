"""Denavit-Hartenberg tables, and conversion of a chain of joints into a table.

A chain whose joints turn about or slide along the z axes of their frames is a product of two kinds of steps:

    Z(theta, d) = Rot_z(theta) Trans_z(d)                       along a joint's axis
    X(a, alpha, beta) = Trans_x(a) Rot_x(alpha) Rot_y(beta)     from one axis to the next

in turn, Z_0 X_0 Z_1 X_1 ... Z_n X_n Z_n+1, where joint i moves in Z_i. The two conventions differ only in the grouping:
a row of the standard convention (Denavit and Hartenberg, Paul) is Z_i X_i, a row of the modified one (Craig, Khalil) is
X_i-1 Z_i. A fixed row before the first joint holds the base, and a fixed row after the last joint holds the tool, so
that the table is exact for any chain.

The conversion. Let M_i be the fixed transforms between neighbouring joints. Each is a product M = Z X Z'. X goes along
the common normal of the two axes, and Z' turns about and slides along the next axis. Z' commutes with the motion of the
next joint, so it is multiplied onto the next M. Of the two directions of a common normal, the one with cos(theta) >= 0
is taken.

Parallel axes. If two axes meet at a small angle s, an error e of the axes moves the foot of their common normal by e/s,
and the foot may be far outside the robot; at s = 0 it is anywhere. Where the sine of the angle is below
`NEARLY_PARALLEL`, Hayati's form is used: d = 0, X goes to the point where the next axis pierces the plane z = 0, and a
turn beta about y, which is zero in other rows, gives the axis its direction. Both forms have four numbers, and Hayati's
has no singularity there.

When it fails. It never fails for a chain of rigid links. But if calibration moves axes across the limit
`NEARLY_PARALLEL`, the table has another form than the nominal table.

References: Denavit 1955; Hayati 1985.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.robots.urdf.reader import Triple
from calib.core.robots.urdf.writing import joint_text, robot_text

Convention = Literal["standard", "modified"]
Kind = Literal["revolute", "prismatic", "fixed"]
CONVENTIONS: tuple[Convention, ...] = ("standard", "modified")
KINDS: tuple[Kind, ...] = ("revolute", "prismatic", "fixed")
NEARLY_PARALLEL = 0.05
"""Hayati's form is used if the sine of the angle between two axes is less."""
_FAR_AWAY = 5.0  # distance of an origin, along the joint's axis, from the joint before it [m]
_COINCIDENT = 1e-12  # axes with a smaller distance have no common normal with a direction [m]
_ROUNDING = 1e-14  # smaller numbers are rounding errors of 0 [m or rad]
BASE_LINK, LAST_LINK = "base_link", "flange"


@dataclass(frozen=True)
class DhRow:
    """A row of a table.

    Attributes:
        name: Name of the joint.
        kind: Kind of the joint: q adds to theta, to d, or to nothing.
        theta, d, a, alpha, beta: Numbers of the module docstring, at q = 0 [rad], [m].
        sign: 1, or -1 for a joint with q in the other direction.
        lower, upper: Limits of q [rad or m]; infinite without limits.
    """

    name: str
    kind: Kind = "revolute"
    theta: float = 0.0
    d: float = 0.0
    a: float = 0.0
    alpha: float = 0.0
    beta: float = 0.0
    sign: float = 1.0
    lower: float = -math.inf
    upper: float = math.inf

    @property
    def motion_along_z(self) -> pin.SE3:
        """Z of the module docstring, at q = 0."""
        return _z_transform(self.theta, self.d)

    @property
    def motion_along_x(self) -> pin.SE3:
        """X of the module docstring."""
        return _x_transform(self.a, self.alpha, self.beta)


@dataclass(frozen=True)
class DhTable:
    """A chain of rows, from the base frame to the last frame, in the `standard` or the `modified` convention."""

    convention: Convention
    rows: tuple[DhRow, ...]

    def poses(self, q: FloatArray) -> FloatArray:
        """Return the pose of the last frame in the base frame, (n, 4, 4) [m], at joint values (n, n_moving)."""
        poses = np.tile(np.eye(4), (len(q), 1, 1))
        columns = iter(q.T)
        for row in self.rows:
            along = np.tile(row.motion_along_z.homogeneous, (len(q), 1, 1))
            if row.kind != "fixed":
                along = along @ _motions(row.kind, row.sign * next(columns))
            across = row.motion_along_x.homogeneous
            poses = poses @ along @ across if self.convention == "standard" else poses @ across @ along
        return poses


def dh_table(links: Sequence[pin.SE3], joints: Sequence[DhRow], convention: Convention) -> DhTable:
    """Return the table of a chain of joints along and about the z axes of their frames.

    Args:
        links: Transforms from the base frame to the first joint, from each joint to the next, and from the last joint
            to the last frame; one more than there are joints.
        joints: Name, kind and limits of each joint.
    """
    names = [joint.name for joint in joints]
    rows = [DhRow(_new_name("base", names), "fixed"), *joints]
    rest = pin.SE3.Identity()
    for k, link in enumerate(links):
        theta, d, a, alpha, beta = (0.0 if abs(v) < _ROUNDING else v for v in _to_next_axis(rest * link))
        rest = (_z_transform(theta, d) * _x_transform(a, alpha, beta)).inverse() * rest * link
        rows[k] = replace(rows[k], theta=theta, d=d, a=a, alpha=alpha, beta=beta)
    theta = math.atan2(rest.rotation[1, 0], rest.rotation[0, 0])
    rows.append(DhRow(_new_name("tool", names), "fixed", theta, float(rest.translation[2])))
    if convention == "modified":
        before = [DhRow(""), *rows[:-1]]
        rows = [replace(row, a=x.a, alpha=x.alpha, beta=x.beta) for row, x in zip(rows, before, strict=True)]
    return DhTable(convention, tuple(rows))


def urdf_text(table: DhTable, name: str) -> str:
    """Return a URDF of a table: links `base_link`, `link_1`, ..., `flange`, and a joint for each row."""
    joints: list[str] = []
    links = [BASE_LINK]
    rest = pin.SE3.Identity()
    last_moves = table.rows[-1].kind != "fixed"
    for k, row in enumerate(table.rows, start=1):
        origin, rest = _origin(table.convention, rest, row)
        if row.kind == "revolute":
            origin, rest = _slide_origin(origin, rest)
        links.append(LAST_LINK if k == len(table.rows) and not last_moves else f"link_{k}")
        joints.append(_joint(row, links[-2], links[-1], origin))
    if last_moves:
        links.append(LAST_LINK)
        taken = [row.name for row in table.rows]
        joints.append(_joint(DhRow(_new_name(f"{LAST_LINK}_joint", taken), "fixed"), links[-2], LAST_LINK, rest))
    note = f"From a Denavit-Hartenberg table ({table.convention}); effort and velocity are 0: the table has none."
    return robot_text(name, note, links, joints)


def _origin(convention: Convention, rest: pin.SE3, row: DhRow) -> tuple[pin.SE3, pin.SE3]:
    """The URDF origin of a row's joint, and the transform that remains for the next row."""
    if convention == "modified":
        return rest * row.motion_along_x * row.motion_along_z, pin.SE3.Identity()
    if row.kind == "fixed":
        return rest * row.motion_along_z * row.motion_along_x, pin.SE3.Identity()
    return rest * row.motion_along_z, row.motion_along_x


def _slide_origin(origin: pin.SE3, rest: pin.SE3) -> tuple[pin.SE3, pin.SE3]:
    """The origin of a revolute joint; a far origin is moved along the axis to the height of the joint before.

    In tables with nearly parallel axes (calibrated robots of Universal Robots) d is hundreds of metres in one row, and
    as much back in the next. An origin may be anywhere on its axis: the next row moves back, and no pose changes.
    """
    away = float(origin.translation @ origin.rotation[:, 2])
    if abs(away) < _FAR_AWAY:
        return origin, rest
    return origin * _z_transform(0.0, -away), _z_transform(0.0, away) * rest


def _joint(row: DhRow, parent: str, child: str, origin: pin.SE3) -> str:
    limits = (row.lower, row.upper) if math.isfinite(row.lower) and math.isfinite(row.upper) else None
    kind = "continuous" if row.kind == "revolute" and not limits else row.kind
    xyz, rpy = (_triple(v) for v in (origin.translation, pin.rpy.matrixToRpy(origin.rotation)))
    axis = "" if row.kind == "fixed" else f"0 0 {row.sign:.0f}"
    return joint_text(row.name, kind, (parent, child), xyz, rpy, axis, limits)


def _triple(values: FloatArray) -> Triple:
    return float(values[0]), float(values[1]), float(values[2])


def _z_transform(theta: float, d: float) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, theta), np.array([0.0, 0.0, d]))


def _x_transform(a: float, alpha: float, beta: float) -> pin.SE3:
    turn = pin.rpy.rpyToMatrix(alpha, 0.0, 0.0) @ pin.rpy.rpyToMatrix(0.0, beta, 0.0)
    return pin.SE3(turn, np.array([a, 0.0, 0.0]))


def _motions(kind: Kind, values: FloatArray) -> FloatArray:
    """Transforms by the motion of a joint alone, (n, 4, 4), at values (n,)."""
    motions = np.tile(np.eye(4), (len(values), 1, 1))
    if kind == "prismatic":
        motions[:, 2, 3] = values
        return motions
    motions[:, 0, 0] = motions[:, 1, 1] = np.cos(values)
    motions[:, 1, 0] = np.sin(values)
    motions[:, 0, 1] = -motions[:, 1, 0]
    return motions


def _to_next_axis(link: pin.SE3) -> tuple[float, float, float, float, float]:
    """Theta, d, a, alpha, beta of the step from the present z axis to the z axis of `link`."""
    u, p = link.rotation[:, 2], link.translation
    sine = math.hypot(u[0], u[1])
    if sine < NEARLY_PARALLEL:
        pierced = p - p[2] / u[2] * u
        theta = _line_angle(*pierced[:2]) if math.hypot(*pierced[:2]) > _COINCIDENT else 0.0
        x = np.array([math.cos(theta), math.sin(theta), 0.0])
        y = np.array([-x[1], x[0], 0.0])
        return theta, 0.0, float(pierced @ x), math.atan2(-u @ y, u[2]), math.asin(u @ x)
    theta = _line_angle(-u[1], u[0])
    x = np.array([math.cos(theta), math.sin(theta), 0.0])
    across = np.array([x[1], -x[0], 0.0])  # x, -across and z are a right-handed frame
    along_next = (p @ across) / (u @ across)
    return theta, float(p[2] - along_next * u[2]), float(p @ x), math.atan2(u @ across, u[2]), 0.0


def _line_angle(x: float, y: float) -> float:
    """The angle of a direction or of its opposite, whichever is within a quarter turn of the x axis."""
    theta = math.atan2(y, x)
    return theta if abs(theta) <= math.pi / 2 else theta - math.copysign(math.pi, theta)


def _new_name(name: str, taken: Sequence[str]) -> str:
    while name in taken:
        name += "_row"
    return name
