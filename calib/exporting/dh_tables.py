"""Denavit-Hartenberg tables of chains of joints (`calib.shared.denavit_hartenberg`), as CSV files.

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
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray
from calib.core.base.units import DISPLAY_UNIT, in_unit
from calib.core.data.table_writing import format_table
from calib.shared.denavit_hartenberg import (
    CONVENTION_MARK,
    NUMBERS,
    Convention,
    DhRow,
    DhTable,
    Kind,
    new_name,
    x_transform,
    z_transform,
)

NEARLY_PARALLEL = 0.05
"""Hayati's form is used if the sine of the angle between two axes is less."""
_COINCIDENT = 1e-12  # axes with a smaller distance have no common normal with a direction [m]
_ROUNDING = 1e-14  # smaller numbers are rounding errors of 0 [m or rad]


def dh_table(links: Sequence[pin.SE3], joints: Sequence[DhRow], convention: Convention) -> DhTable:
    """Return the table of a chain of joints along and about the z axes of their frames.

    Args:
        links: Transforms from the base frame to the first joint, from each joint to the next, and from the last joint
            to the last frame; one more than there are joints.
        joints: Name, kind and limits of each joint.
    """
    names = [joint.name for joint in joints]
    rows = [DhRow(new_name("base", names), "fixed"), *joints]
    rest = pin.SE3.Identity()
    for k, link in enumerate(links):
        theta, d, a, alpha, beta = (0.0 if abs(v) < _ROUNDING else v for v in _to_next_axis(rest * link))
        rest = (z_transform(theta, d) * x_transform(a, alpha, beta)).inverse() * rest * link
        rows[k] = replace(rows[k], theta=theta, d=d, a=a, alpha=alpha, beta=beta)
    theta = math.atan2(rest.rotation[1, 0], rest.rotation[0, 0])
    rows.append(DhRow(new_name("tool", names), "fixed", theta, float(rest.translation[2])))
    if convention == "modified":
        before = [DhRow(""), *rows[:-1]]
        rows = [replace(row, a=x.a, alpha=x.alpha, beta=x.beta) for row, x in zip(rows, before, strict=True)]
    return DhTable(convention, tuple(rows))


def table_poses(table: DhTable, q: FloatArray) -> FloatArray:
    """Return the pose of the last frame in the base frame, (n, 4, 4) [m], at joint values (n, n_moving)."""
    poses = np.tile(np.eye(4), (len(q), 1, 1))
    columns = iter(q.T)
    for row in table.rows:
        along = np.tile(z_transform(row.theta, row.d).homogeneous, (len(q), 1, 1))
        if row.kind != "fixed":
            along = along @ _motions(row.kind, row.sign * next(columns))
        across = x_transform(row.a, row.alpha, row.beta).homogeneous
        poses = poses @ along @ across if table.convention == "standard" else poses @ across @ along
    return poses


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


def format_dh(table: DhTable, comments: Sequence[str] = ()) -> str:
    """Return CSV text in mm and degrees, after comments; reading it gives the same table to all digits."""
    columns: list[tuple[str, Sequence[object]]] = [
        ("joint", [row.name for row in table.rows]),
        ("type", [row.kind for row in table.rows]),
    ]
    for name, dimension in NUMBERS.items():
        unit = DISPLAY_UNIT[dimension]
        values = [in_unit(getattr(row, name), unit) for row in table.rows]
        columns.append((f"{name} [{unit}]", values))
    columns.append(("sign", [f"{row.sign:.0f}" for row in table.rows]))
    for name in ("lower", "upper"):
        columns.append((name, [_limit(row, getattr(row, name)) for row in table.rows]))
    return format_table(columns, [f"{CONVENTION_MARK} {table.convention}", *comments])


def _limit(row: DhRow, value: float) -> str:
    if not math.isfinite(value):
        return ""
    unit = DISPLAY_UNIT[NUMBERS["d" if row.kind == "prismatic" else "theta"]]
    return f"{in_unit(value, unit)!r} {unit}"
