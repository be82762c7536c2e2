"""First values of places that are touched, from where a robot's links are in every pose.

Sockets s_j and the ball t on its link are linear in R_k t + t_k = s_j. How far t leaves where it is believed to be
counts a little, so that a link that hardly turns does not send it away. Rotations that carry points onto points are
those of least squares; where one component of the rotation vector must stay zero, e_k . w = 0, w lies in the plane
across e_k, and the one such turn that carries u to v is about e_k x (u - v).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from calib.arrays import BoolArray, FloatArray, IntArray
from calib.numerics.multilateration import centre, centre_of_sphere
from calib.numerics.rigid import best_transform

_STAY = 0.03  # weight of leaving the believed place by 1 m, against 1 m of a touch
_FLAT = 1e-3  # width over length below which points lie on one line


@dataclass(frozen=True, eq=False)
class Points:
    """Points of links.

    Attributes:
        xyz: Where they are, or are believed to be, (m, 3) [m].
        unknown: Which coordinates are not known, (m, 3).
    """

    xyz: FloatArray
    unknown: BoolArray


def sockets_and_targets(
    links: FloatArray, socket: IntArray, target: IntArray, sockets: Points, targets: Points
) -> tuple[FloatArray, FloatArray]:
    """Return where sockets and targets are, (m, 3) each [m].

    Args:
        links: Link of the target seen from the link of the socket at each touch, (n, 4, 4) [m].
        socket, target: Which of them touched, (n,).
        sockets, targets: What is believed of them.
    """
    n_targets, n_sockets = int(targets.unknown.sum()), int(sockets.unknown.sum())
    target_column = np.cumsum(targets.unknown.ravel()).reshape(-1, 3) - 1
    socket_column = n_targets + np.cumsum(sockets.unknown.ravel()).reshape(-1, 3) - 1
    rotation = links[:, :3, :3]
    gap = np.einsum("nij,nj->ni", rotation, targets.xyz[target]) + links[:, :3, 3] - sockets.xyz[socket]
    rows = np.zeros((len(links), 3, n_targets + n_sockets))
    for axis in range(3):
        k = np.flatnonzero(targets.unknown[target, axis])
        rows[k, :, target_column[target[k], axis]] = rotation[k, :, axis]
        k = np.flatnonzero(sockets.unknown[socket, axis])
        rows[k, axis, socket_column[socket[k], axis]] = -1.0
    stay = _STAY * np.eye(n_targets, n_targets + n_sockets)
    both = np.vstack([rows.reshape(-1, n_targets + n_sockets), stay])
    change = np.linalg.lstsq(both, np.append(-gap.ravel(), np.zeros(n_targets)))[0]
    found_sockets, found_targets = sockets.xyz.copy(), targets.xyz.copy()
    found_targets[targets.unknown] += change[:n_targets]
    found_sockets[sockets.unknown] += change[n_targets:]
    return found_sockets, found_targets


def posed_artefact(points: FloatArray, seen: FloatArray, now: FloatArray, held: int | None) -> FloatArray:
    """Return the pose of an artefact, (4, 4) [m], from where its points are.

    Args:
        points: In the artefact, (m, 3) [m].
        seen: In the link that carries it, (m, 3) [m].
        now: Pose that it is believed to have, which stands for what the points do not tell, (4, 4) [m].
        held: Component of the rotation vector from `now` that stays zero where the points lie on a line.
    """
    result = now.copy()
    from_centre, seen_from_centre = points - points.mean(axis=0), seen - seen.mean(axis=0)
    _, sizes, directions = np.linalg.svd(np.vstack([from_centre, np.zeros((2, 3))]))
    if sizes[1] > _FLAT * sizes[0]:
        result[:3, :3] = best_transform(points, seen)[0]
    elif sizes[0] > 0:
        line = directions[0]
        there = now[:3, :3].T @ (seen_from_centre.T @ (from_centre @ line))
        axis = int(np.argmax(np.abs(line))) if held is None else held
        result[:3, :3] = now[:3, :3] @ _turn(line, there / np.linalg.norm(there), axis)
    result[:3, 3] = seen.mean(axis=0) - result[:3, :3] @ points.mean(axis=0)
    return result


def _turn(u: FloatArray, v: FloatArray, k: int) -> FloatArray:
    """The rotation (3, 3) that carries u to v, whose rotation vector has no component k."""
    across = np.eye(3)[k]
    axis = np.cross(across, u - v)
    if np.linalg.norm(axis) < 1e-12:  # nothing to turn, or half a turn about the part of u across e_k
        axis = u - across * u[k]
        axis = axis if np.linalg.norm(axis) > 1e-12 else np.eye(3)[k - 1]
    axis /= np.linalg.norm(axis)
    angle = np.arctan2(axis @ np.cross(u, v), u @ v - (axis @ u) * (axis @ v))
    result: FloatArray = scipy.spatial.transform.Rotation.from_rotvec(angle * axis).as_matrix()
    return result


def plane_through(points: FloatArray, now: FloatArray, radius: float, along: int | None, *, turns: bool) -> FloatArray:
    """Return the pose of a plane that balls lie on, (4, 4) [m].

    Args:
        points: Their centres in the link of the plane, (n, 3) [m].
        now: Pose that it is believed to have; its z axis points to the side of the balls, (4, 4) [m].
        radius: Of the balls [m].
        along: Axis of the link along which the plane may move; None: it stays.
        turns: Whether its normal is to be found.
    """
    result, middle = now.copy(), points.mean(axis=0)
    _, sizes, directions = np.linalg.svd(np.vstack([points - middle, np.zeros((2, 3))]))
    if turns and sizes[1] > _FLAT * sizes[0]:
        normal = now[:3, :3].T @ directions[2]
        result[:3, :3] = now[:3, :3] @ _turn(np.eye(3)[2], normal * (1.0 if normal[2] >= 0 else -1.0), 2)
    normal = result[:3, 2]
    if along is not None and abs(normal[along]) > _FLAT:
        result[along, 3] += (normal @ (middle - result[:3, 3]) - radius) / normal[along]
    return result


def sphere_through(points: FloatArray, near: FloatArray, length: float | None) -> tuple[FloatArray, float]:
    """Return centre (3,) and radius of the sphere that points (n, 3) lie on [m].

    Args:
        points: The points.
        near: Where its centre is believed to be, (3,) [m].
        length: Its radius, if known [m].
    """
    if length is None:
        return centre_of_sphere(points, near)
    return centre(points, np.full(len(points), length), near), length
