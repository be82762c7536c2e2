"""How lengths and angles of an arm that are off move its tool, where only poses of the tool are known.

Problem. An arm whose lengths and angles are off errs alike at similar poses. Part of that moves all images as one, so
it goes into camera and board and leaves no residual: the length of the last link is that of the camera on it. What it
does to residuals at other poses says how large such errors are, and so how far camera and board may be off unseen. For
that it must be known how an error moves the tool at each pose. Joint values say it, and poses of the tool do not.

Model. The poses are taken by an arm as most are: its first axis is upright through the origin of the base, shoulder
and elbow turn about level axes at right angles to the plane of the arm, both links are 5/8 of the largest reach, the
elbow is up, and the three axes of the wrist meet in the tool, the last one along its z. Each of six joints has two
angles and two lengths that may be off (Denavit and Hartenberg): about and along its own axis, and about and along the
normal that it shares with the next one. An angle d about a line through c with direction a, and a length d along it,
move the tool at p by

    d (a x (p - c), a)    and    d (a, 0)

(translation, rotation), here in the axes of the tool. Independent errors of one size t for all 24, in m and in rad,
give the covariance t^2 sum of N N^T.

Why. A smooth random function of the pose has no such thing as lengths, and its range decides how much of it is unseen:
from half to three times the true spread. With the arm above, intervals are nearly those with the true one.

When it fails. Poses in a frame far from the robot's base have other levers. Where the wrist is straight or the tool
above the base, the arm above turns joints by much that a real one may not.
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray

_LINK = 5 / 8  # of the largest reach


def arm_twists(tool: FloatArray) -> FloatArray:
    """Return how the tool moves with each of 24 errors of the arm, in its own axes, (n, 6, 24).

    Args:
        tool: Tool in the robot's base at each image, (n, 4, 4) [m].
    """
    p, axes, o = tool[:, :3, 3], tool[:, :3, :3], np.zeros((len(tool), 3))
    upright = np.tile([0.0, 0.0, 1.0], (len(tool), 1))
    level = _unit(np.cross(upright, p))
    reach = np.linalg.norm(p, axis=1, keepdims=True)
    height = np.sqrt((_LINK * np.max(reach)) ** 2 - reach**2 / 4)
    elbow = p / 2 + height * _unit(np.cross(p, level))
    forearm, last = _unit(p - elbow), axes[:, :, 2]
    bend = _unit(np.cross(forearm, last))
    lines = [
        (upright, o), (level, o), (level, elbow), (forearm, p), (bend, p), (last, p),
        (np.cross(level, upright), o), (_unit(elbow), o), (np.cross(forearm, level), elbow),
        (np.cross(bend, forearm), p), (np.cross(bend, last), p), (axes[:, :, 0], p),
    ]  # fmt: skip
    turned = [np.stack([np.cross(along, p - through), along], axis=1) for along, through in lines]
    moved = [np.stack([along, o], axis=1) for along, _ in lines]
    in_base = np.stack(turned + moved, axis=3)  # (n, 2, 3, 24)
    return np.einsum("nba,nkbc->nkac", axes, in_base).reshape(len(tool), 6, -1)


def _unit(vectors: FloatArray) -> FloatArray:
    """Vectors of length one; zero where there is no direction."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 1e-9)
