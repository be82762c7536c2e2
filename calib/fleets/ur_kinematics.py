"""A calibration of Universal Robots (`calib.shared.ur_calibration`) as a URDF.

The URDF has the names of `ur_description`, and its fixed frames: `base` (half a turn from `base_link`), `flange` and
`tool0`.

The axes of shoulder and elbow are parallel, so their origins may be metres away along them, and single numbers cannot
be compared with the type's. Instead, positions are compared at a few hundred poses, with the best base. A robot differs
from its type by 1 to 9 mm RMS; one lost sign makes more than ten times as much. A lost sign is named if the robot with
the other sign is of a known type.

References: ur_dh.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import UrdfError
from calib.core.base.sections import read_yaml
from calib.core.base.units import quantity_text
from calib.core.numerics.halton import halton
from calib.core.numerics.rigid import best_transform
from calib.core.robots.urdf.text import is_ur_kinematics
from calib.core.robots.urdf.writing import joint_text, robot_text
from calib.shared.ur_calibration import JOINTS, KEYS, LINKS

TYPES = {
    "ur3": (0.1519, -0.24365, -0.21325, 0.11235, 0.08535, 0.0819),
    "ur5": (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823),
    "ur10": (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922),
    "ur3e": (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "ur5e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "ur10e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "ur16e": (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
    "ur8long": (0.2186, -0.8989, -0.7149, 0.1824, 0.1361, 0.1434),
    "ur15": (0.2186, -0.6475, -0.5164, 0.1824, 0.1361, 0.1434),
    "ur20": (0.2363, -0.862, -0.7287, 0.201, 0.1593, 0.1543),
    "ur30": (0.2363, -0.637, -0.5037, 0.201, 0.1593, 0.1543),
}
"""The maker's d1, a2, a3, d4, d5, d6 of each type [m]."""
_FAR = 0.03  # a robot is not of a type if its RMS distance from it is larger [m]
_TOOL = np.array([0.0, 0.0, 0.1])  # compared point in the last joint's frame [m]
_POSES = 200


def nominal_origins(model: str) -> FloatArray:
    """Return the six origins of a type of `TYPES`, x y z [m] roll pitch yaw [rad], (6, 6)."""
    d1, a2, a3, d4, d5, d6 = TYPES[model]
    quarter, half = np.pi / 2, np.pi
    return np.array(
        [
            (0, 0, d1, 0, 0, 0),
            (0, 0, 0, quarter, 0, 0),
            (a2, 0, 0, 0, 0, 0),
            (a3, 0, d4, 0, 0, 0),
            (0, -d5, 0, quarter, 0, 0),
            (0, d6, 0, quarter, half, half),
        ]
    )


def points(origins: FloatArray) -> FloatArray:
    """Return a point on the last axis at many poses, (n, 3) [m]; `origins` have xyz [m] and rpy [rad], (6, 6)."""
    turn = scipy.spatial.transform.Rotation.from_euler
    q = 2 * np.pi * halton(_POSES + 1, 6)[1:] - np.pi
    p = np.tile(_TOOL, (_POSES, 1))
    for k in reversed(range(6)):
        p = turn("xyz", origins[k, 3:]).apply(turn("z", q[:, [k]]).apply(p)) + origins[k, :3]
    return np.asarray(p)


@functools.cache
def _nominal_points(model: str) -> FloatArray:
    return points(nominal_origins(model))


def _distance(p: FloatArray, q: FloatArray) -> float:
    """RMS distance between two robots' points (n, 3) [m], with the best base of the first."""
    rotation, shift = best_transform(p, q)
    return float(np.sqrt(np.mean(np.sum((p @ rotation.T + shift - q) ** 2, axis=1))))


def nearest_type(origins: FloatArray) -> tuple[str, float]:
    """Return the type nearest to a robot with these origins (6, 6), and its RMS distance [m]."""
    p = points(origins)
    away = {model: _distance(p, _nominal_points(model)) for model in TYPES}
    nearest = min(away, key=lambda model: away[model])
    return nearest, away[nearest]


def read_ur(path: str, source: bytes, arguments: Mapping[str, str]) -> tuple[bytes, None]:
    """Return the URDF of a calibration; a reader of robots (`calib.core.robots.urdf.text.read_urdf`)."""
    return ur_urdf(read_origins(path)), None


def read_origins(path: Path | str) -> FloatArray:
    """Read the six origins, x y z [m] roll pitch yaw [rad], (6, 6).

    `UrdfError` if a number is missing, or the robot is of a known type only with the other sign of a number.
    """
    content = read_yaml(path)
    if not is_ur_kinematics(content):
        raise UrdfError(f"{path}: has no key 'kinematics' with the joint origins that ur_calibration writes")
    kinematics: Mapping[str, Any] = content["kinematics"]  # type: ignore[index]
    origins = np.array([[_number(kinematics, link, key, path) for key in KEYS] for link in LINKS])
    _require_sound(origins, path)
    return origins


def _number(kinematics: Mapping[str, Any], link: str, key: str, path: Path | str) -> float:
    value = kinematics[link].get(key) if isinstance(kinematics.get(link), dict) else None
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise UrdfError(f"{path}: kinematics.{link}.{key} should be a number; extract the calibration again")
    return float(value)


def _require_sound(origins: FloatArray, path: Path | str) -> None:
    """Raise `UrdfError` if the robot is of no known type, but would be with another sign of some number."""
    away = nearest_type(origins)[1]
    if away < _FAR:
        return
    tried = []
    for k, j in np.argwhere(origins):
        turned = origins.copy()
        turned[k, j] *= -1
        tried.append((*nearest_type(turned)[::-1], f"kinematics.{LINKS[k]}.{KEYS[j]}"))
    left, model, where = min(tried)
    if left < _FAR:
        as_it_is, otherwise = (quantity_text(x, "mm", form) for x, form in ((away, ".0f"), (left, ".1f")))
        raise UrdfError(
            f"{path}: is {as_it_is} RMS from every known type; with the other sign of {where} it would be a {model},"
            f" {otherwise} from nominal: a sign is lost; extract the calibration again"
        )


def ur_urdf(origins: FloatArray, name: str = "ur") -> bytes:
    """Return the URDF of six origins x y z [m] roll pitch yaw [rad], (6, 6), with the frames of `ur_description`."""
    every = ("base_link", "base", "base_link_inertia", *(f"{link}_link" for link in LINKS), "flange", "tool0")
    quarter, half = np.pi / 2, np.pi
    fixed = (
        ("base_link-base_fixed_joint", "base_link", "base", (0, 0, 0, 0, 0, half)),
        ("base_link-base_link_inertia", "base_link", "base_link_inertia", (0, 0, 0, 0, 0, half)),
        ("wrist_3-flange", "wrist_3_link", "flange", (0, 0, 0, 0, -quarter, -quarter)),
        ("flange-tool0", "flange", "tool0", (0, 0, 0, quarter, 0, quarter)),
    )
    parents = ("base_link_inertia", *(f"{link}_link" for link in LINKS))
    turning = zip(JOINTS, pairwise(parents), map(tuple, origins.tolist()), strict=True)
    joints = [_joint(joint, "fixed", (parent, child), pose) for joint, parent, child, pose in fixed]
    joints += [_joint(joint, "revolute", links, pose) for joint, links, pose in turning]
    return robot_text(name, "joint origins as calibrations of Universal Robots have them", every, joints).encode()


def _joint(name: str, kind: str, links: tuple[str, str], origin: tuple[float, ...]) -> str:
    x, y, z, roll, pitch, yaw = map(float, origin)
    axis = "" if kind == "fixed" else "0 0 1"
    return joint_text(name, kind, links, (x, y, z), (roll, pitch, yaw), axis, (-2 * np.pi, 2 * np.pi))
