"""A way around what blocks a straight move: along free poses that are known, or found by OMPL; then shortened.

All stops and some more free poses are the nodes of a roadmap, each with moves to those near it. The shortest way on it
is checked move by move; a move that hits is taken out, until a way is free or none is left. What was checked for one
stop serves the next. Where the map ends, OMPL's RRT-Connect searches, whose edges are proven free, too: it asks whether
a point is free, and whether a straight move is (`calib.motion.moves`), and never sees shapes. The way is shortened by
leaving out corners while the move past them is free.

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
from calib.motion.moves import Move, check_move
from calib.motion.scene import Scene

_MOST_ASKED = 150  # times that OMPL may ask for a move
_SHORTCUTS = 20
_NEAREST = 25  # moves of each node of the roadmap
_TRIED = 100  # moves that are checked on it for one way


@dataclass(eq=False)
class Planner:
    """Finds ways in a scene.

    Attributes:
        scene: The scene.
        nodes: Free poses of the roadmap, (n, n_actuated) [m or rad].
        limits: Of the joints, (n_actuated, 2) [m or rad].
        seed: Of random numbers.
        known: Moves that were checked, by their ends.
    """

    scene: Scene
    nodes: FloatArray
    limits: FloatArray
    seed: int
    known: dict[bytes, Move] = field(default_factory=dict)

    def move(self, start: FloatArray, end: FloatArray) -> Move:
        """Return what the straight move between two commands, (n_actuated,) each, is worth, both ways alike."""
        key = b"".join(sorted((start.tobytes(), end.tobytes())))
        if key not in self.known:
            self.known[key] = check_move(self.scene, start, end)
        return self.known[key]

    def way(self, start: FloatArray, end: FloatArray, *, searched: bool = True) -> FloatArray | None:
        """Return the corners of a free way between two free commands, both included, (n, n_actuated); None: none found.

        Args:
            start, end: (n_actuated,) each [m or rad].
            searched: Whether OMPL searches where the roadmap ends, which takes long.

        Raises:
            InputError: OMPL is needed, and not installed.
        """
        if not self.move(start, end).hit:
            return np.array([start, end])
        found = self._on_roadmap(start, end)
        if found is None and searched:
            found = self._searched(start, end)
        return None if found is None else self._shortened(found)

    def _on_roadmap(self, start: FloatArray, end: FloatArray) -> FloatArray | None:
        """The shortest way along the nodes whose moves are free."""
        points = np.vstack([start, end, self.nodes])
        width = np.maximum(np.ptp(points, axis=0), 1e-9)
        gaps = np.max(np.abs(points[:, None] - points[None]) / width, axis=2)
        near = np.argsort(gaps, axis=1, kind="stable")[:, 1 : _NEAREST + 1]
        weights = np.zeros_like(gaps)  # 0: no move
        rows = np.repeat(np.arange(len(points)), near.shape[1])
        weights[rows, near.ravel()] = np.maximum(gaps[rows, near.ravel()], 1e-9)
        weights = np.maximum(weights, weights.T)
        for _ in range(_TRIED):
            length, before = scipy.sparse.csgraph.dijkstra(weights, indices=0, return_predecessors=True)
            if not np.isfinite(length[1]):
                return None
            way = [1]
            while way[-1] != 0:
                way.append(int(before[way[-1]]))
            blocked = next(((a, b) for a, b in pairwise(way) if self.move(points[a], points[b]).hit), None)
            if blocked is None:
                return points[way[::-1]]
            weights[blocked] = weights[blocked[::-1]] = 0.0
        return None

    def _searched(self, start: FloatArray, end: FloatArray) -> FloatArray | None:
        try:
            from calib.motion.ompl_search import search
        except ImportError:
            raise InputError(
                f"a straight move is blocked ({self.move(start, end).hit}), and a way around it needs OMPL; install"
                f" it: pip install '{DISTRIBUTION}[motion]'"
            ) from None
        return search(
            start,
            end,
            self.limits,
            lambda q: not self.scene.hits(q[None])[0],
            lambda one, other: not self.move(one, other).hit,
            _MOST_ASKED,
        )

    def _shortened(self, corners: FloatArray) -> FloatArray:
        """A way with fewer corners, and shorter ones."""
        generator = np.random.default_rng(self.seed)
        corners = self._straightened(corners)
        for _ in range(_SHORTCUTS if len(corners) > 2 else 0):
            cut = self._cut_off(corners, generator)
            if cut is not None:
                corners = self._straightened(cut)
        return corners

    def _straightened(self, corners: FloatArray) -> FloatArray:
        """The way without the corners that it can pass by, from the farthest on."""
        kept = [0]
        while kept[-1] < len(corners) - 1:
            here = kept[-1]
            ahead = range(len(corners) - 1, here + 1, -1)
            kept.append(next((k for k in ahead if not self.move(corners[here], corners[k]).hit), here + 1))
        return corners[kept]

    def _cut_off(self, corners: FloatArray, generator: np.random.Generator) -> FloatArray | None:
        """The way past a corner, from somewhere before it to somewhere behind; None where that is blocked."""
        if len(corners) < 3:
            return None
        k = int(generator.integers(1, len(corners) - 1))
        before, behind = generator.uniform(0.2, 0.9, 2)
        one = corners[k] + before * (corners[k - 1] - corners[k])
        other = corners[k] + behind * (corners[k + 1] - corners[k])
        if self.move(one, other).hit or self.move(corners[k - 1], one).hit or self.move(other, corners[k + 1]).hit:
            return None
        return np.vstack([corners[:k], one, other, corners[k + 1 :]])
