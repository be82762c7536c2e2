"""Straight moves of the joints, checked so that no collision between checked points is missed.

A move is cut in halves. In the middle of a piece every pair has a distance; the joints bring it nearer by at most R
|dq| on the way to the ends of the piece (`calib.motion.scene`). A pair with a larger distance is proven free on the
whole piece, and is not checked again there; a piece with unproven pairs is cut again. Checked points keep the whole
clearance of a pair, so that every point between them keeps at least half of it.

Passive joints of closed loops do not move straight. Their motion from the middle of a piece to its ends is known at
these three points; twice the larger is used as bound, and the first pieces are short. This is a bound for slightly bent
paths between such points, no proof; loops that do not close at a point block the move.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.motion.scene import CollisionScene

_FINEST = 1e-4  # a piece is not cut again if pairs come nearer by no more than this [m]
_FIRST_PIECES = 8  # with loops
_BENDS = 2.0


@dataclass(frozen=True)
class StraightMove:
    """Result of the check of a straight move.

    Attributes:
        hit: The first colliding pair in the order of checking, or "".
        clearance: Smallest distance of any pair at the checked points [m]; a lower bound for meshes far apart.
    """

    hit: str
    clearance: float


def check_move(scene: CollisionScene, start: FloatArray, end: FloatArray) -> StraightMove:
    """Check the straight move between two commands, (n_actuated,) [m or rad] each, whose ends are free."""
    mechanism = scene.robot.mechanism
    parts = np.linspace(0.0, 1.0, (_FIRST_PIECES if mechanism.loops else 1) + 1)
    corners, ok = scene.configurations(start + parts[:, None] * (end - start))
    if not np.all(ok):
        return StraightMove("loops that do not close", 0.0)
    reach = scene.reach(1.1 * np.max(np.abs(corners), axis=0))
    bends = np.where(np.any(mechanism.select_passive != 0, axis=1), _BENDS, 1.0)
    # of each piece: both ends on the way, 0 to 1; all joints there; pairs that may hit
    ends, joints = (np.stack([each[:-1], each[1:]], axis=1) for each in (parts, corners))
    pairs = np.ones((len(ends), len(scene.pairs)), dtype=bool)
    least = np.inf
    while len(ends):
        middle = ends.mean(axis=1)
        at_middle, ok = scene.configurations(start + middle[:, None] * (end - start))
        if not np.all(ok):
            return StraightMove("loops that do not close", 0.0)
        excursions = bends * np.max(np.abs(joints - at_middle[:, None]), axis=1)
        nearer = excursions @ reach.T - scene.margins / 2
        apart = scene.distances(at_middle, pairs, thorough=False)
        least = min(least, float(np.min(apart + scene.margins, initial=np.inf)))
        if np.any(apart <= 0):
            return StraightMove(scene.name(int(np.argmin(np.min(apart, axis=0)))), least)
        unproven = pairs & (apart <= nearer)
        too_short = unproven & (nearer + scene.margins / 2 < _FINEST)
        if np.any(too_short):
            return StraightMove(scene.name(int(np.flatnonzero(np.any(too_short, axis=0))[0])), least)
        left = np.any(unproven, axis=1)
        ends, joints = _halves(ends[left], middle[left]), _halves(joints[left], at_middle[left])
        pairs = np.tile(unproven[left], (2, 1))
    return StraightMove("", least)


def _halves(ends: FloatArray, middle: FloatArray) -> FloatArray:
    """Ends of both halves of pieces, (2 n, 2, ...), from their ends (n, 2, ...) and middles (n, ...)."""
    return np.concatenate([np.stack([ends[:, 0], middle], axis=1), np.stack([middle, ends[:, 1]], axis=1)])
