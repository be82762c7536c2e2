"""The result of a selection: the poses, their indices, a bound on these, and the exchanges."""

from __future__ import annotations

from dataclasses import dataclass

from calib.core.base.arrays import FloatArray, IntArray, ReadOnlyArrays
from calib.core.base.words import html_with_title
from calib.core.numerics.identifiability import Rank
from calib.shared.pose_check import PoseCheck


@dataclass(frozen=True, eq=False)
class Run:
    """One run of the exchange.

    Attributes:
        start: `uniform`, `random`, `relaxed`, or `best`: the best earlier choice, among other candidates.
        exchanges: (added, removed) candidate of each exchange.
        history: Index at the start and after each exchange (Figure 4 of the paper).
        n_paper: Number of the paper's exchanges; single swaps follow.
    """

    start: str
    exchanges: tuple[tuple[int, int], ...]
    history: tuple[float, ...]
    n_paper: int


@dataclass(frozen=True, eq=False, repr=False)
class Selection(ReadOnlyArrays):
    """Chosen poses, in the order of measurement.

    Attributes:
        index: Optimised index: O1 to O5 or `task`.
        chosen: Indices of the chosen candidates, (count,).
        instruments: Instruments that read at each, joined by `+`, (count,); empty if all read at every pose.
        groups: Instruments to choose from; empty if all read at every pose. Candidate numbers in `runs` run through the
            poses with the first group, then with the next.
        joints: Poses to measure, (count, n_actuated) [m or rad].
        positions: Positions of the targets there, (count, n_targets, 3) [m].
        before: All indices of the uniform choice; the task index in m.
        after: All indices of these poses.
        raw: O1 to O5 of these poses alone, without priors, on raw columns: mm per unit of table, or noise of a reading
            per unit if nothing measures lengths.
        measured_only: All indices of the measured poses, or None; 0 where they determine too little.
        efficiency: Index of these poses over a proven bound for all such choices; None without a bound.
        bound: The bound, as a value of the index; None if it was not computed.
        distance: Distance that the targets of any two poses keep [m]; 0 if none was requested.
        runs: The runs of the exchange.
        travel: Length of the path in the candidates' order and in this order [joint ranges].
        rank: Rank of all candidates, measured poses and priors.
        rank_of_poses: Rank of all candidates and measured poses; the indices are about these directions.
        sigma: Noise of one reading per axis [m].
        sigma_assumed: Whether the noise is an assumption.
        skipped: Unusable candidates, with reasons.
        already_measured: Number of candidates left out because they are measured.
        seed: Seed of all random numbers.
        seconds: Duration.
        selecting_seconds: Duration after assembly and Jacobians of the candidates.
        check: Check for collisions at the candidates.
        unobstructed: All indices of the best choice from all candidates, free or not; None if all are free.
    """

    index: str
    chosen: IntArray
    instruments: tuple[str, ...]
    groups: tuple[str, ...]
    joints: FloatArray
    positions: FloatArray
    before: dict[str, float]
    after: dict[str, float]
    raw: dict[str, float]
    measured_only: dict[str, float] | None
    efficiency: float | None
    bound: float | None
    distance: float
    runs: tuple[Run, ...]
    travel: tuple[float, float]
    rank: Rank
    rank_of_poses: Rank
    sigma: float
    sigma_assumed: bool
    skipped: tuple[str, ...]
    already_measured: int
    seed: int
    seconds: float
    selecting_seconds: float
    check: PoseCheck
    unobstructed: dict[str, float] | None

    def __len__(self) -> int:
        return len(self.joints)

    def __repr__(self) -> str:
        before, after = self.before[self.index], self.after[self.index]
        return f"<Selection of {len(self)} poses by {self.index}: {before:.4g} before, {after:.4g} after>"

    def __str__(self) -> str:
        proven = "" if self.efficiency is None else f"; {100 * self.efficiency:.4g} % of what any choice can reach"
        before, after = self.before[self.index], self.after[self.index]
        return (
            f"{len(self)} poses, chosen by {self.index}: {after:.4g}, beside {before:.4g} of a uniform choice{proven}\n"
            f"Inside: joints {self.joints.shape} [m or rad], in the order of measurement; chosen, their places among"
            " the candidates; after and before, all indices of these poses and of a uniform choice\n"
            "Next: measure these poses, then calib.fit(robot, data); calib.check(robot, selection.joints) says what"
            " they determine"
        )

    def _repr_html_(self) -> str:
        rows = ("uniform choice", self.before), ("these poses", self.after)
        table: list[dict[str, object]] = [{"choice": name, **values} for name, values in rows]
        return html_with_title("Selection", (repr(self)[1:-1],), table)
