"""Denavit-Hartenberg tables: capabilities make robots of them, and them of robots.

A chain whose joints turn about or slide along the z axes of their frames is a product of two kinds of steps:

    Z(theta, d) = Rot_z(theta) Trans_z(d)                       along a joint's axis
    X(a, alpha, beta) = Trans_x(a) Rot_x(alpha) Rot_y(beta)     from one axis to the next

in turn, Z_0 X_0 Z_1 X_1 ... Z_n X_n Z_n+1, where joint i moves in Z_i. The two conventions differ only in the grouping:
a row of the standard convention (Denavit and Hartenberg, Paul) is Z_i X_i, a row of the modified one (Craig, Khalil) is
X_i-1 Z_i. A fixed row before the first joint holds the base, and a fixed row after the last joint holds the tool, so
that the table is exact for any chain. beta is zero but in Hayati's form, for nearly parallel axes.

References: Denavit 1955; Hayati 1985.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pinocchio as pin

from calib.core.base.units import Dimension

Convention = Literal["standard", "modified"]
Kind = Literal["revolute", "prismatic", "fixed"]
CONVENTIONS: tuple[Convention, ...] = ("standard", "modified")
KINDS: tuple[Kind, ...] = ("revolute", "prismatic", "fixed")
NUMBERS: dict[str, Dimension] = {"theta": "angle", "d": "length", "a": "length", "alpha": "angle", "beta": "angle"}
"""Numbers of a row, and their dimensions."""
CONVENTION_MARK = "convention:"
"""Beginning of the comment of a file that says which convention its rows follow."""


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


@dataclass(frozen=True)
class DhTable:
    """A chain of rows, from the base frame to the last frame, in the `standard` or the `modified` convention."""

    convention: Convention
    rows: tuple[DhRow, ...]


def z_transform(theta: float, d: float) -> pin.SE3:
    """Return Z of the module docstring."""
    return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, theta), np.array([0.0, 0.0, d]))


def x_transform(a: float, alpha: float, beta: float) -> pin.SE3:
    """Return X of the module docstring."""
    turn = pin.rpy.rpyToMatrix(alpha, 0.0, 0.0) @ pin.rpy.rpyToMatrix(0.0, beta, 0.0)
    return pin.SE3(turn, np.array([a, 0.0, 0.0]))


def new_name(name: str, taken: Sequence[str]) -> str:
    """Return a name for a row that is not taken yet."""
    while name in taken:
        name += "_row"
    return name
