"""Exchange algorithms: choose poses by swapping one at a time, for any index.

`exchange` is the paper's (after Mitchell's DETMAX with excursions of one): add the candidate that raises the index
most, remove the pose whose removal costs least, until the added pose is also the removed one. The index rises with
every round, so the rounds end; the result depends on the start.

`swap` continues: it replaces each chosen pose in turn by the best candidate, until no single swap raises the index.

If poses must keep a distance, candidates near chosen poses are excluded at each step (`Spacing`).

Reference: mitchell1974; fedorov1972; joubair2015, section Observability and Figure 4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.errors import NotIdentifiableError
from calib.planning.selection_problem import TASK, SelectionProblem
from calib.planning.selection_scores import Scores, scores

_RISE = 1e-10
"""Least relative rise of an index; a smaller rise is rounding."""
_RIDGE = 1e-9  # added to the diagonal of K, which is the identity for all candidates
_MAX_PASSES = 20


@dataclass(frozen=True, eq=False)
class Spacing:
    """Rules on which candidates may be chosen next.

    Attributes:
        usable: Mask of the candidates that may be chosen, (n_candidates,).
        kind: Kind of each candidate, (n_candidates,); only candidates of a kind are exchanged.
        pose: Pose of each candidate, (n_candidates,); candidates of a pose need no distance.
        points: Positions of the targets at each candidate, (n_candidates, n) [m].
        distance: Least distance between chosen poses [m]; 0 for none.
    """

    usable: BoolArray
    kind: IntArray
    pose: IntArray
    points: FloatArray
    distance: float = 0.0

    @staticmethod
    def free(usable: BoolArray) -> Spacing:
        """Return rules without a distance, for usable (n_candidates,) poses of one kind."""
        n = len(usable)
        return Spacing(usable, np.broadcast_to(np.intp(0), n), np.arange(n), np.zeros((n, 0)))

    def select(self, index: IntArray) -> Spacing:
        """Return the rules for some candidates, (n,)."""
        usable, kind, pose, points = self.usable[index], self.kind[index], self.pose[index], self.points[index]
        return Spacing(usable, kind, pose, points, self.distance)

    def is_same_kind(self, candidate: int) -> BoolArray:
        """Return the mask of the candidates of the same kind, (n_candidates,)."""
        return np.asarray(self.kind == self.kind[candidate])

    def is_allowed(self, chosen: BoolArray) -> BoolArray:
        """Return the mask of the candidates that may be added to a choice, (n_candidates,)."""
        free = self.usable & ~chosen
        if self.distance > 0 and np.any(chosen):
            candidates = np.flatnonzero(free)
            nearest, _ = scipy.spatial.cKDTree(self.points[chosen]).query(self.points[candidates])
            near = (nearest < self.distance) & ~np.isin(self.pose[candidates], self.pose[chosen])
            free[candidates[near]] = False
        return free

    def select_spread(self, tried: IntArray, count: int) -> IntArray:
        """Return `count` candidates that keep the distance, first from `tried` (n,), then in file order.

        There are fewer if no more keep the distance; without a distance, they are `tried` itself.
        """
        if self.distance == 0:
            return tried
        rest = np.setdiff1d(np.flatnonzero(self.usable), tried)
        room = np.bincount(self.kind[tried], minlength=int(np.max(self.kind)) + 1)
        kept: list[int] = []
        for candidate in (*tried, *rest):
            gaps = np.linalg.norm(self.points[kept] - self.points[candidate], axis=1)
            if room[self.kind[candidate]] and np.all(
                (gaps >= self.distance) | (self.pose[kept] == self.pose[candidate])
            ):
                kept.append(int(candidate))
                room[self.kind[candidate]] -= 1
            if len(kept) == count:
                break
        return np.array(kept, dtype=np.intp)


@dataclass(frozen=True, eq=False)
class Exchange:
    """A choice and the exchanges that led to it.

    Attributes:
        chosen: Mask of the chosen candidates, (n_candidates,).
        values: Score at the start and after each exchange; NaN while the choice did not determine enough.
        history: Exchanges as (added, removed) pairs.
    """

    chosen: BoolArray
    scores: Scores
    values: tuple[float, ...]
    history: tuple[tuple[int, int], ...] = ()

    @staticmethod
    def begin(scores: Scores, chosen: BoolArray) -> Exchange:
        """Return a choice (n_candidates,) before any exchange."""
        return Exchange(chosen, scores, (scores.value,))

    def after_exchange(self, added: int, removed: int, scores: Scores) -> Exchange:
        """Return the choice with these scores after a further exchange."""
        chosen = self.chosen.copy()
        chosen[added], chosen[removed] = True, False
        return Exchange(chosen, scores, (*self.values, scores.value), (*self.history, (added, removed)))

    def exceeds(self, other: Exchange) -> bool:
        """Whether the score of this choice is larger by more than rounding."""
        return self.scores.value > other.scores.value + _RISE * abs(other.scores.value)


def uniform_start(usable: IntArray, count: int) -> IntArray:
    """Return `count` of the usable candidates (n,), evenly spread over their order, (count,)."""
    if count == 0:
        return usable[:0]
    return usable[(2 * np.arange(count) + 1) * len(usable) // (2 * count)]


def exchange(problem: SelectionProblem, index: str, start: IntArray, spacing: Spacing) -> Exchange:
    """Run the paper's exchange from a start (count,) to raise an index.

    Raises:
        NotIdentifiableError: No choice determines every direction.
    """
    chosen = np.zeros(len(problem), dtype=bool)
    chosen[start] = True
    if problem.is_determined_by(chosen):
        return _climb(Exchange.begin(scores(problem, index, chosen), chosen), spacing)
    # every index is zero here: first climb with a tiny prior
    helped = _climb(Exchange.begin(scores(problem, "O1", chosen, _RIDGE), chosen), spacing)
    if not problem.is_determined_by(helped.chosen):
        raise NotIdentifiableError(
            f"all candidates together determine {problem.pose_information.rank.rank} combinations of parameters; no"
            f" choice of {len(start)} poses was found that determines as many: choose more poses, or hold parameters"
        )
    final = _climb(Exchange.begin(scores(problem, index, helped.chosen), helped.chosen), spacing)
    nothing = -np.inf if index in ("O1", TASK) else 0.0
    unknown = (nothing, *[np.nan] * (len(helped.history) - 1)) if helped.history else ()
    return replace(final, history=helped.history + final.history, values=unknown + final.values)


def _climb(done: Exchange, spacing: Spacing) -> Exchange:
    while np.any(allowed := spacing.is_allowed(done.chosen)):
        added = done.scores.best_move(allowed, add=True)
        larger = done.scores.after_move(added, add=True)
        removable = done.chosen & spacing.is_same_kind(added)
        removable[added] = True
        removed = larger.best_move(removable, add=False)
        if removed == added:
            break
        after = done.after_exchange(added, removed, larger.after_move(removed, add=False))
        if not after.exceeds(done):
            break
        done = after
    return done


def swap(done: Exchange, spacing: Spacing) -> Exchange:
    """Improve a choice until no single swap raises the index; a pose that alone determines a direction stays."""
    for _ in range(_MAX_PASSES):
        before = done
        for removed in np.flatnonzero(done.chosen).tolist():
            if not done.scores.spares(np.array([removed]))[0]:
                continue
            smaller, rest = done.scores.after_move(removed, add=False), done.chosen.copy()
            rest[removed] = False
            # the removed candidate is allowed, so there is one
            added = smaller.best_move(spacing.is_allowed(rest) & spacing.is_same_kind(removed), add=True)
            if added != removed:
                after = done.after_exchange(added, removed, smaller.after_move(added, add=True))
                done = after if after.exceeds(done) else done
        if not done.exceeds(before):
            break
    return done
