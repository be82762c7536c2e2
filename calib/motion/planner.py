"""A path around the obstacles of a straight move: along known free poses, or found by OMPL; then shortened.

All stops and further free poses are the nodes of a roadmap, each with moves to its neighbours. The shortest path on it
is checked move by move; a blocked move is removed for good, until a path is free or none is left. Checked moves serve
all stops. Where the roadmap ends, OMPL's RRT-Connect searches from the nearest node that free moves reach. It only
checks points and straight moves (`calib.motion.moves`), and never sees shapes. The path is shortened by leaving out
corners while the move past them is free.

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
from calib.motion.moves import StraightMove, check_move
from calib.motion.scene import CollisionScene

_MOST_CHECKS = 150  # largest number of moves that OMPL may check
_SHORTCUTS = 20
_NEAREST = 25  # moves of each node of the roadmap
_TRIED = 100  # largest number of paths to check
_SAME = 1e-9  # length of a move between equal nodes
_KNOWN = 0.7  # factor on the length of a move known to be free, so that known paths are preferred


@dataclass(eq=False)
class Planner:
    """Finds paths in a scene.

    Attributes:
        scene: The scene.
        nodes: Free poses of the roadmap, all different, (n, n_actuated) [m or rad].
        limits: Limits of the joints, (n_actuated, 2) [m or rad].
        seed: Seed of random numbers.
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

        Args:
            start, end: Indices of the nodes.
            searched: Whether OMPL searches where the roadmap ends, which is slow.

        Raises:
            InputError: OMPL is needed, and not installed.
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
            _MOST_CHECKS,
        )
        before = self.nodes[[start]] if near == start else self._roadmap_path(start, near)
        return None if found is None or before is None else np.vstack([before[:-1], found])

    def _shorten(self, corners: FloatArray) -> FloatArray:
        """A shorter path with fewer corners."""
        generator = np.random.default_rng(self.seed)
        corners = self._straighten(corners)
        for _ in range(_SHORTCUTS if len(corners) > 2 else 0):
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
        if len(corners) < 3:
            return None
        k = int(generator.integers(1, len(corners) - 1))
        before, behind = generator.uniform(0.2, 0.9, 2)
        one = corners[k] + before * (corners[k - 1] - corners[k])
        other = corners[k] + behind * (corners[k + 1] - corners[k])
        if self.move(one, other).hit or self.move(corners[k - 1], one).hit or self.move(other, corners[k + 1]).hit:
            return None
        return np.vstack([corners[:k], one, other, corners[k + 1 :]])
