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

from calib.core.base.arrays import BoolArray, FloatArray
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
    n = _FIRST_PIECES if scene.robot.mechanism.loops else 1
    parts = np.linspace(0.0, 1.0, n + 1)
    ends, ok = scene.configurations(start + parts[:, None] * (end - start))
    if not np.all(ok):
        return StraightMove("loops that do not close", 0.0)
    reach = scene.reach(1.1 * np.max(np.abs(ends), axis=0))
    pieces = _Pieces(parts[:-1], parts[1:], ends[:-1], ends[1:], np.ones((n, len(scene.pairs)), dtype=bool))
    least = np.inf
    while len(pieces):
        middles, ok = scene.configurations(start + pieces.middle[:, None] * (end - start))
        if not np.all(ok):
            return StraightMove("loops that do not close", 0.0)
        nearer = pieces.excursions(middles, scene) @ reach.T - scene.margins / 2
        apart = scene.distances(middles, pieces.pairs, thorough=False)
        least = min(least, float(np.min(apart + scene.margins, initial=np.inf)))
        if np.any(apart <= 0):
            return StraightMove(scene.name(int(np.argmin(np.min(apart, axis=0)))), least)
        unproven = pieces.pairs & (apart <= nearer)
        too_short = unproven & (nearer + scene.margins / 2 < _FINEST)
        if np.any(too_short):
            return StraightMove(scene.name(int(np.flatnonzero(np.any(too_short, axis=0))[0])), least)
        pieces = pieces.halve(middles, unproven)
    return StraightMove("", least)


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Pieces of a move: first and last part of the way, 0 to 1; all joints there; pairs that may hit on each piece."""

    first: FloatArray
    last: FloatArray
    first_joints: FloatArray
    last_joints: FloatArray
    pairs: BoolArray

    def __len__(self) -> int:
        return len(self.first)

    @property
    def middle(self) -> FloatArray:
        """Middle of each piece, (n,)."""
        result: FloatArray = (self.first + self.last) / 2
        return result

    def excursions(self, middles: FloatArray, scene: CollisionScene) -> FloatArray:
        """Largest motion of joints on a piece, from its middle, (n, n_joints) [m or rad]."""
        moved: FloatArray = np.maximum(np.abs(self.first_joints - middles), np.abs(self.last_joints - middles))
        passive = np.any(scene.robot.mechanism.select_passive != 0, axis=1)
        return np.where(passive, _BENDS, 1.0) * moved

    def halve(self, middles: FloatArray, unproven: BoolArray) -> _Pieces:
        """Return the halves of the pieces with unproven pairs."""
        open_ = np.any(unproven, axis=1)
        middle, at_middle = self.middle[open_], middles[open_]
        return _Pieces(
            np.concatenate([self.first[open_], middle]),
            np.concatenate([middle, self.last[open_]]),
            np.concatenate([self.first_joints[open_], at_middle]),
            np.concatenate([at_middle, self.last_joints[open_]]),
            np.concatenate([unproven[open_], unproven[open_]]),
        )
