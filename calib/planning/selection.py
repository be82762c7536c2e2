"""Choosing the poses to measure, with the index of the choice and a bound on the best possible index.

Order of work. Candidates are assembled and linearised at the robot's present values. The paper's exchange runs from
each start, then single swaps until none helps. For O1 and the task index the concave relaxation gives a bound on every
possible choice, and its weights give one more start. Last, the poses are put in an order of short travel. Among very
many candidates the exchanges search a promising subset.

Priors and measured poses are information before the first choice; the measurement noise is the weight between priors
and poses. Every index, O1 included, is about the directions that all candidates and the measured poses together
determine, with the others eliminated (`calib.planning.selection_problem`): directions that no pose can determine play
no part, and a direction with a strong prior attracts no poses. Without priors the noise plays no part and the indices
are the published ones.

Very many candidates. Each move of an exchange updates the small matrices of every candidate, so its time grows with
their number, while good choices use few of them. Let g_k be the slope of the concave relaxation
(`calib.planning.selection_bound`). A candidate whose g at the best weights is below that of every weighted candidate is
in no best weighted choice; a candidate far below is hardly ever in a good choice. So:

1. g at equal weights ranks all candidates. The best of each kind, and the starts, are searched.
2. The relaxation over all candidates, from that result, gives weights, a bound on every choice and a better g.
3. The best by that g are searched again, from the result and from the weights.

The bound is over all candidates, so the efficiency limits the loss. Up to `SCREENED` candidates, none is left out.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calib.core.base.arrays import FloatArray, IntArray, random_numbers
from calib.core.base.errors import InputError
from calib.core.base.threads import one_blas_thread
from calib.core.base.units import quantity_text, sigma_in_si
from calib.core.base.workers import Progress, Workers, results_in_order
from calib.core.data.in_memory import PosesLike, as_poses
from calib.core.robots.loading import RobotLike, as_robot
from calib.planning.exchange import Exchange, Spacing, exchange, swap
from calib.planning.instrument_choice import ALL, groups_of
from calib.planning.measurement_order import order_in_blocks, travel
from calib.planning.selection_bound import CERTIFIED, gathered_by, largest, log_phi, relax, slopes
from calib.planning.selection_problem import TASK, SelectionProblem, index_values, observability_of
from calib.planning.selection_result import Run, Selection
from calib.planning.selection_setting import SelectionSetting, prepare, require_count
from calib.shared.candidates import WHITENED
from calib.shared.pose_check import PoseCheck, check_poses

SCREENED = 20_000
"""Above this number, candidates are screened, if the index has a bound and no least distance is set."""
_SEARCHED = 4096  # searched candidates
_FOR_EACH = 8  # searched candidates per requested candidate, if that is more


@dataclass(frozen=True, eq=False)
class CandidateSubset:
    """The candidates that exchanges search: their indices, ascending, (n,), and the problem and rules of these alone.

    `n_all` is the number of all candidates.
    """

    index: IntArray
    problem: SelectionProblem
    space: Spacing
    n_all: int

    def with_all_numbers(self, result: Exchange) -> Exchange:
        """Return an exchange in this subset with the indices of all candidates."""
        chosen = np.zeros(self.n_all, dtype=bool)
        chosen[self.index[result.chosen]] = True
        history = tuple((int(self.index[a]), int(self.index[b])) for a, b in result.history)
        return replace(result, chosen=chosen, history=history)


def best_candidates(setting: SelectionSetting, gathered: FloatArray, kept: IntArray) -> CandidateSubset:
    """Return the candidates with the largest slopes at K (r, r), and the kept ones (n,); all if not screened."""
    problem, space, counts = setting.problem, setting.space, setting.counts
    n_all = len(problem)
    if setting.index not in CERTIFIED or space.distance > 0 or n_all <= SCREENED:
        return CandidateSubset(np.arange(n_all), problem, space, n_all)
    ranked = np.where(space.usable, slopes(problem, setting.index, gathered), -np.inf)
    best = largest(ranked, space.kind, np.maximum(_SEARCHED // len(counts), _FOR_EACH * counts))
    index = np.union1d(np.concatenate(best), kept).astype(np.intp)
    return CandidateSubset(index, replace(problem, rows=problem.rows[index]), space.select(index), n_all)


__all__ = ["Run", "Selection", "select"]


@one_blas_thread
def select(
    robot: RobotLike,
    candidates: PosesLike,
    count: int | Mapping[str, int],
    index: str = "O1",
    *,
    instruments: str | Sequence[str] = ALL,
    measured: PosesLike | None = None,
    task: PosesLike | None = None,
    exclude: Sequence[int] = (),
    minimum_distance: float = 0.0,
    random_start: bool = False,
    starts: int = 1,
    seed: int = 0,
    skip_unreachable: bool = False,
    checked: bool = True,
    sigma: float | str | None = None,
    executor: Executor | int | None = None,
    progress: Progress | None = None,
) -> Selection:
    """Choose the poses that determine the parameters best.

    Args:
        robot: The robot, linearised at its present values.
        candidates: Poses to choose from, (n, n_actuated) [m or rad], or from a file.
        count: Number of poses; or a number by instrument (names joined by `+` read together).
        index: Index to optimise: O1 to O5, or `task`, the predicted position error over the task poses.
        instruments: `all`: every instrument reads at every chosen pose. `each`: one instrument is chosen with every
            pose. Or a list to choose from; `+` joins instruments that read together. A pose may be chosen with several.
        measured: Measured poses, which the chosen poses complement.
        task: Poses whose accuracy counts in the task index; default: the candidates.
        exclude: Indices of candidates, from 0, that are not chosen.
        minimum_distance: Least distance between the targets of two poses (root mean square over targets) [m].
        random_start: Start from a random choice instead of a uniform one.
        starts: Number of starts; all but the first are random.
        seed: Seed of all random numbers.
        skip_unreachable: Leave out candidates that cannot be assembled, instead of an error.
        checked: Leave out candidates at which the robot hits something or a target is hidden.
        sigma: Noise of one position reading per axis [m], or text such as `0.04 mm`; default: the description's.
        executor: Executor of the starts; as in `calib.fit`.
        progress: Called with the number of finished starts and of all.

    Raises:
        InputError: An argument is wrong; count above the candidates, or too small for the parameters.
        DataError: No candidates, or two are equal.
        UnreachablePoseError: Candidates cannot be assembled.
        NotIdentifiableError: No choice determines the directions of the index.
    """
    robot, sigma = as_robot(robot), sigma_in_si(sigma)
    started = time.perf_counter()
    rng = random_numbers(seed)
    groups = groups_of(robot, instruments, count)
    total = sum(count.values()) if isinstance(count, Mapping) else count
    candidates = as_poses(robot, candidates)
    check = check_poses(robot, candidates.joints) if checked else PoseCheck(("",) * len(candidates))
    blocked = np.flatnonzero(~check.is_free).tolist()
    n_free = len(candidates) - len(blocked)
    if blocked and n_free < (1 if isinstance(count, Mapping) else total):
        few = f"only {n_free} of the candidates are free, and {total} are to be chosen" if n_free else ""
        raise InputError(f"{candidates.path}: {few or 'none of the candidates is free'}: {check.summary()}")
    if starts < 1:
        raise InputError(f"{starts} starts: at least one is needed")
    kinds = ["random" if random_start else "uniform", *["random"] * (starts - 1)]
    prepare_without = partial(
        prepare, robot, candidates, index, total, groups, measured, task, minimum_distance, skip_unreachable, sigma
    )
    with Workers(executor, starts) as workers:
        setting = prepare_without((*exclude, *blocked))
        require_count(setting)
        prepared = time.perf_counter()
        runs, best, efficiency, bound = _best_choice(setting, kinds, rng, workers, progress)
    unobstructed = None
    if blocked:
        everywhere = prepare_without(exclude)
        free_or_not = _best_choice(everywhere, kinds[:1], random_numbers(seed))[1]
        unobstructed = index_values(everywhere.problem, free_or_not.chosen, everywhere.sigma)
    chosen = np.flatnonzero(best.chosen)
    pose, joints = setting.pairs.pose[chosen], setting.poses.joints[setting.pairs.pose[chosen]]
    order = order_in_blocks(joints, robot.home, _blocks(setting, chosen))
    uniform = np.isin(np.arange(len(setting.problem)), setting.uniform())
    nothing = np.zeros(len(setting.problem), dtype=bool)
    return Selection(
        index=index,
        chosen=pose[order],
        instruments=tuple(groups.names[g] for g in setting.pairs.group[chosen[order]] if groups.chosen),
        groups=groups.names if groups.chosen else (),
        joints=joints[order],
        positions=setting.pose_rows.positions[pose[order]],
        before=index_values(setting.problem, uniform, setting.sigma),
        after=index_values(setting.problem, best.chosen, setting.sigma),
        raw=_raw(setting, setting.problem.rows[chosen]),
        measured_only=index_values(setting.problem, nothing, setting.sigma) if setting.problem.n_before else None,
        efficiency=efficiency,
        bound=bound,
        distance=minimum_distance,
        runs=runs,
        travel=(travel(joints, robot.home), travel(joints[order], robot.home)),
        rank=setting.problem.rank,
        rank_of_poses=setting.problem.pose_information.rank,
        sigma=setting.sigma,
        sigma_assumed=setting.sigma_assumed,
        skipped=setting.pose_rows.skipped,
        already_measured=setting.already_measured,
        seed=seed,
        seconds=time.perf_counter() - started,
        selecting_seconds=time.perf_counter() - prepared,
        check=check,
        unobstructed=unobstructed,
    )


def _best_choice(
    setting: SelectionSetting,
    kinds: Sequence[str],
    rng: np.random.Generator,
    workers: Executor | None = None,
    progress: Progress | None = None,
) -> tuple[tuple[Run, ...], Exchange, float | None, float | None]:
    """The runs from each start and the best choice; for an index with a bound, its efficiency and the bound."""
    starts = [(kind, setting.uniform() if kind == "uniform" else setting.random(rng)) for kind in kinds]
    # without priors, K of all candidates is the identity
    alike = setting.count / len(setting.problem) * np.eye(len(setting.problem.strengths))
    kept = np.concatenate([start for _, start in starts])
    searched = best_candidates(setting, setting.problem.before + alike, kept)
    results, runs = zip(*_run(setting, searched, starts, workers, progress), strict=True)
    best = max(results, key=lambda exchange: exchange.scores.value)
    return _certify(setting, runs, best) if setting.index in CERTIFIED else (runs, best, None, None)


def _run(
    setting: SelectionSetting,
    searched: CandidateSubset,
    starts: Sequence[tuple[str, IntArray]],
    workers: Executor | None = None,
    progress: Progress | None = None,
) -> list[tuple[Exchange, Run]]:
    """Run the exchange from each of the named starts."""
    inside = (np.searchsorted(searched.index, start) for _, start in starts)
    spread = [searched.space.select_spread(start, setting.count) for start in inside]
    fewest = min(map(len, spread))
    if fewest < setting.count:
        raise InputError(
            f"only {fewest} of {setting.count} poses can be chosen if they keep"
            f" {quantity_text(setting.space.distance, 'mm', 'g')} from each other; give a smaller distance or count"
        )
    runs = []
    search = partial(_search, searched.problem, setting.index, searched.space)
    for (kind, _), (found, n_paper) in zip(starts, results_in_order(search, spread, workers, progress), strict=True):
        result = searched.with_all_numbers(found)
        runs.append((result, Run(kind, result.history, tuple(map(setting.index_of_score, result.values)), n_paper)))
    return runs


@one_blas_thread
def _search(problem: SelectionProblem, index: str, space: Spacing, start: IntArray) -> tuple[Exchange, int]:
    """The exchange and the following swaps from one start, and the number of exchanges before the swaps."""
    paper = exchange(problem, index, start, space)
    return swap(paper, space), len(paper.history)


def _certify(
    setting: SelectionSetting, runs: tuple[Run, ...], best: Exchange
) -> tuple[tuple[Run, ...], Exchange, float, float]:
    """Bound all choices, start once more from the relaxed weights, and compare the best choice with the bound."""
    problem, index, usable = setting.problem, setting.index, setting.space.usable
    log_bound, weights = relax(problem, index, best.chosen, setting.space)
    heaviest = np.concatenate(largest(np.where(usable, weights, -1.0), setting.space.kind, setting.counts))
    searched = best_candidates(setting, gathered_by(problem, weights), np.flatnonzero(best.chosen | (weights > 0)))
    starts = [("relaxed", np.sort(heaviest)), ("best", np.flatnonzero(best.chosen))]
    screened = len(searched.index) < searched.n_all
    for more, run in _run(setting, searched, starts if screened else starts[:1]):
        best, runs = max(best, more, key=lambda exchange: exchange.scores.value), (*runs, run)
    log_phis = log_bound, log_phi(problem, index, problem.information_of(best.chosen.astype(float)))
    # scores by log phi: minus trace(W K^-1), log det K
    scores = (-float(np.exp(-each)) if index == TASK else len(problem.strengths) * each for each in log_phis)
    bound, value = map(setting.index_of_score, scores)
    return runs, best, min(1.0, bound / value if index == TASK else value / bound), bound


def _blocks(setting: SelectionSetting, chosen: IntArray) -> IntArray:
    """Block of each candidate, (n,): candidates of one setup and one group are measured without a change by hand."""
    setups = setting.poses.setups
    pose, group = setting.pairs.pose[chosen], setting.pairs.group[chosen]
    return group if setups is None else setups[pose] * len(setting.groups.members) + group


def _raw(setting: SelectionSetting, rows: FloatArray) -> dict[str, float]:
    """O1 to O5 of whitened rows, (n_poses, 3 n_targets, r), on raw columns."""
    known, robot = setting.problem.pose_information, setting.robot
    scaled = setting.sigma * (rows * known.strengths) @ known.directions.T
    kept = [p for p, free in zip(robot.parameters, robot.is_free, strict=True) if free and not p.family]
    return observability_of(scaled, kept, len(rows), lengths=setting.sigma != WHITENED)[1]
