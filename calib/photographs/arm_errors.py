"""Motion of a tool by errors of the arm's lengths and angles, where only poses of the tool are known.

Problem. Errors of lengths and angles move an arm in the same way at similar poses. The part of this motion that is
common to all images is absorbed by camera and board and leaves no residual: an error of the last link's length moves
the camera on it. The other part shows in residuals. It gives the size of the errors, and hence the uncertainty of
camera and board from the hidden part. This needs the motion of the tool by each error at each pose. Joint values would
give it; poses of the tool do not.

Model. The poses are assumed to be those of a typical arm. Its first axis is upright through the origin of the base.
Shoulder and elbow turn about level axes at right angles to the plane of the arm. Both links are 5/8 of the largest
reach, and the elbow is up. The three axes of the wrist meet in the tool, the last along its z. Each of six joints
has two angles and two lengths with errors (Denavit and Hartenberg): about and along its own axis, and about and along
the common normal with the next axis. An error d of an angle about a line through c with direction a, or of a length
along it, moves the tool at p by

    d (a x (p - c), a)    and    d (a, 0)

(translation, rotation), here in the axes of the tool. If all 24 errors are independent with one size t, in m and rad,
their covariance is t^2 sum of N N^T, with N the motion by one error.

Why. The alternative is a smooth random function of the pose. Its correlation length would decide how much stays
hidden: from half to three times the true spread. With the arm above, intervals are nearly those with the true arm.

When it fails. Poses in a frame far from the robot's base have other levers. Where the wrist is straight or the tool is
above the base, joints of this arm turn by much, and those of the real arm may not.
"""

from __future__ import annotations

import numpy as np

from calib.core.base.arrays import FloatArray

_LINK = 5 / 8  # length of a link, over the largest reach


def arm_twists(tool: FloatArray) -> FloatArray:
    """Return the motion of the tool, in its axes, by 24 errors of the arm, (n, 6, 24), at poses (n, 4, 4) [m]."""
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
    """Unit vectors; zero for zero vectors."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 1e-9)
