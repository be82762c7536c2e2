"""A path around the obstacles of a straight move: along known free poses, or found by OMPL; then shortened.

All stops and further free poses are the nodes of a roadmap, each with moves to its neighbours. The shortest path on it
is checked move by move; a blocked move is removed for good, until a path is free or none is left. Checked moves serve
all stops. Where the roadmap ends, OMPL's RRT-Connect searches from the nearest node that free moves reach. It only
checks points and straight moves, and never sees shapes. The path is shortened by leaving out
corners while the move past them is free.

Straight moves are checked so that no collision between checked points is missed. A move is cut in halves. In the middle
of a piece every pair has a distance; the joints bring it nearer by at most R |dq| on the way to the ends of the piece
(`calib.motion.scene`). A pair with a larger distance is proven free on the whole piece, and is not checked again there;
a piece with unproven pairs is cut again. Checked points keep the whole clearance of a pair, so that every point between
them keeps at least half of it.

Passive joints of closed loops do not move straight. Their motion from the middle of a piece to its ends is known at
these three points; twice the larger is used as bound, and the first pieces are short. This is a bound for slightly bent
paths between such points, no proof; loops that do not close at a point block the move.

Reference: bohlin2000; kuffner2000; sucan2012.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import scipy

from calib.core.base.arrays import FloatArray
from calib.core.base.errors import InputError
from calib.core.base.version import DISTRIBUTION
from calib.motion.scene import CollisionScene

_FINEST = 1e-4  # a piece is not cut again if pairs come nearer by no more than this [m]
_FIRST_PIECES = 8  # with loops
_BENDS = 2.0


@dataclass(frozen=True)
class StraightMove:
    """Result of the check of a straight move: the colliding pair that was found first, or "".

    `clearance` is the smallest distance of any pair at the checked points [m]; a lower bound for meshes far apart.
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


_SHORTCUTS = 20
_NEAREST = 25  # moves of each node of the roadmap
_TRIED = 100  # largest number of paths to check
_SAME = 1e-9  # length of a move between equal nodes
_KNOWN = 0.7  # factor on the length of a move known to be free, so that known paths are preferred


@dataclass(eq=False)
class Planner:
    """Finds paths in a scene.

    Attributes:
        nodes: Free poses of the roadmap, all different, (n, n_actuated) [m or rad].
        limits: Limits of the joints, (n_actuated, 2) [m or rad].
        checked_moves: Checked moves by their ends.
        here: The robot's present node.
    """

    scene: CollisionScene
    nodes: FloatArray
    limits: FloatArray
    seed: int
    checked_moves: dict[bytes, StraightMove] = field(default_factory=dict)
    here: int = 0

    def __post_init__(self) -> None:
        """Compute the lengths of the roadmap's moves, (n, n), 0 for none, and mark those known to be free."""
        n, width = len(self.nodes), np.maximum(np.ptp(self.limits, axis=1), 1e-9)
        self._scaled = self.nodes / np.where(np.isfinite(width), width, 2 * np.pi)
        gaps = np.max(np.abs(self._scaled[:, None] - self._scaled[None]), axis=2)
        near = gaps <= np.sort(gaps, axis=1)[:, [min(_NEAREST, n - 1)]]
        self._lengths = np.where(near | near.T, np.maximum(gaps, _SAME), 0.0)
        self._free = np.zeros((n, n), dtype=bool)
        number = {node.tobytes(): k for k, node in enumerate(self.nodes)}
        for key, move in self.checked_moves.items():
            start, end = (number.get(half) for half in (key[: len(key) // 2], key[len(key) // 2 :]))
            if start is not None and end is not None:
                self._mark(start, end, free=not move.hit)

    def add(self, nodes: FloatArray) -> int:
        """Add nodes (n, n_actuated) [m or rad] and return the number of the first."""
        first = len(self.nodes)
        self.nodes = np.vstack([self.nodes, nodes])
        self.__post_init__()
        return first

    def move(self, start: FloatArray, end: FloatArray) -> StraightMove:
        """Return the check of the straight move between two commands, (n_actuated,) each, in either direction."""
        key = b"".join(sorted((start.tobytes(), end.tobytes())))
        if key not in self.checked_moves:
            self.checked_moves[key] = check_move(self.scene, start, end)
        return self.checked_moves[key]

    def free_path(self, start: int, end: int, *, searched: bool = True) -> FloatArray | None:
        """Return the corners of a free path between two nodes, including both, (n, n_actuated); None: none found.

        Where the roadmap ends, OMPL searches if that is wanted, which is slow; if it is not installed, that is an
        `InputError`.
        """
        if self._is_free(start, end):
            return self.nodes[[start, end]]
        found = self._roadmap_path(start, end)
        if found is None and searched:
            found = self._find_path(start, end)
        return None if found is None else self._shorten(found)

    def _is_free(self, a: int, b: int) -> bool:
        """Whether the move between two nodes is free; the roadmap keeps the answer."""
        free = not self.move(self.nodes[a], self.nodes[b]).hit
        self._mark(a, b, free=free)
        return free

    def _mark(self, a: int, b: int, *, free: bool) -> None:
        length = max(float(np.max(np.abs(self._scaled[a] - self._scaled[b]))), _SAME)
        self._free[a, b] = self._free[b, a] = free
        self._lengths[a, b] = self._lengths[b, a] = _KNOWN * length if free else 0.0

    def _roadmap_path(self, start: int, end: int) -> FloatArray | None:
        """The shortest path along the nodes whose moves are free."""
        for _ in range(_TRIED):
            length, before = scipy.sparse.csgraph.dijkstra(self._lengths, indices=start, return_predecessors=True)
            if not np.isfinite(length[end]):
                return None
            way = [end]
            while way[-1] != start:
                way.append(int(before[way[-1]]))
            if all(self._is_free(a, b) for a, b in pairwise(way)):
                return self.nodes[way[::-1]]
        return None

    def _find_path(self, start: int, end: int) -> FloatArray | None:
        try:
            from calib.motion.ompl_search import search
        except ImportError:
            raise InputError(
                f"a straight move is blocked ({self.move(self.nodes[start], self.nodes[end]).hit}), and a way around it"
                f" needs OMPL; install it: pip install '{DISTRIBUTION}[motion]'"
            ) from None
        reached = scipy.sparse.csgraph.connected_components(self._free)[1]
        gaps = np.max(np.abs(self._scaled - self._scaled[end]), axis=1)
        gaps[end] = np.inf
        near = int(np.argmin(np.where(reached == reached[start], gaps, np.inf)))
        found = search(
            self.nodes[near],
            self.nodes[end],
            self.limits,
            lambda q: not self.scene.hits(q[None])[0],
            lambda one, other: not self.move(one, other).hit,
        )
        before = self.nodes[[start]] if near == start else self._roadmap_path(start, near)
        return None if found is None or before is None else np.vstack([before[:-1], found])

    def _shorten(self, corners: FloatArray) -> FloatArray:
        """A shorter path with fewer corners."""
        generator = np.random.default_rng(self.seed)
        corners = self._straighten(corners)
        for _ in range(_SHORTCUTS):
            if len(corners) < 3:
                break
            cut = self._cut_corner(corners, generator)
            if cut is not None:
                corners = self._straighten(cut)
        return corners

    def _straighten(self, corners: FloatArray) -> FloatArray:
        """The path without avoidable corners, skipping as many as possible at a time."""
        kept = [0]
        while kept[-1] < len(corners) - 1:
            here = kept[-1]
            ahead = range(len(corners) - 1, here + 1, -1)
            kept.append(next((k for k in ahead if not self.move(corners[here], corners[k]).hit), here + 1))
        return corners[kept]

    def _cut_corner(self, corners: FloatArray, generator: np.random.Generator) -> FloatArray | None:
        """The path with a corner cut off at random points before and behind it; None if that is blocked."""
        k = int(generator.integers(1, len(corners) - 1))
        before, behind = generator.uniform(0.2, 0.9, 2)
        one = corners[k] + before * (corners[k - 1] - corners[k])
        other = corners[k] + behind * (corners[k + 1] - corners[k])
        moves = (one, other), (corners[k - 1], one), (other, corners[k + 1])
        free = not any(self.move(*move).hit for move in moves)
        return np.vstack([corners[:k], one, other, corners[k + 1 :]]) if free else None
