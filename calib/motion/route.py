"""The route: in which order a robot visits poses, on which free ways, and which poses it cannot visit.

Order of work. Poses that are not free, or outside the joint limits, are left out. The others are put in an order of
little travel. Ways are found one after the other; a pose that no way reaches from the one before is tried again at the
end, from there. What remains is left out by name, and replaced by the next best of the candidates, which are visited at
the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.errors import ComputationError, DataError, InputError
from calib.core.base.registry import brought
from calib.core.base.words import counted, listed
from calib.core.base.workers import Progress
from calib.core.data.measurements import Poses
from calib.core.robots.robot import Robot
from calib.motion.planner import Planner
from calib.motion.poses import surroundings, what_hits
from calib.motion.scene import Scene

_NODES = 150  # poses of the roadmap beside the stops


@dataclass(frozen=True, eq=False)
class Stop(ReadOnlyArrays):
    """A pose that is visited.

    Attributes:
        name: Of the pose.
        joints: (n_actuated,) [m or rad].
        corners: Of the way from the stop before, without both ends, (n, n_actuated).
        clearance: Smallest distance of any pair at the stop [m].
        pair: Which pair that is.
        on_the_way: Smallest distance on the way there [m].
    """

    name: str
    joints: FloatArray
    corners: FloatArray
    clearance: float
    pair: str
    on_the_way: float


@dataclass(frozen=True, eq=False)
class Route:
    """Stops in order, from where the robot stands.

    Attributes:
        robot: The robot.
        start: Where it stands first, (n_actuated,) [m or rad].
        stops: The stops.
        left_out: Names of poses that are not visited, and why.
        replaced: Names of those that stand in for them.
        remarks: What was not checked.
    """

    robot: Robot
    start: FloatArray
    stops: tuple[Stop, ...]
    left_out: dict[str, str]
    replaced: tuple[str, ...]
    remarks: tuple[str, ...]

    @property
    def joints(self) -> FloatArray:
        """Commands of the stops, (n_stops, n_actuated) [m or rad]."""
        return np.array([stop.joints for stop in self.stops])

    def corners(self) -> FloatArray:
        """All points between which the robot moves straight, from the start on, (n, n_actuated) [m or rad]."""
        return np.vstack([self.start, *(np.vstack([stop.corners, stop.joints]) for stop in self.stops)])


def plan_route(
    robot: Robot,
    poses: Poses,
    *,
    start: FloatArray | None = None,
    candidates: Poses | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> Route:
    """Plan a route through poses.

    Args:
        robot: The robot at its present values.
        poses: Where to measure.
        start: Where it stands first, (n_actuated,) [m or rad]; home if not given.
        candidates: Poses that may stand in for those that cannot be visited.
        seed: Of everything random.
        progress: Called with how many poses were tried.

    Raises:
        InputError: The robot collides where it stands.
        ComputationError: None of the poses can be visited.
        DescriptionError: The scene cannot be; see `calib.motion.poses.surroundings`.
    """
    start = np.array(robot.home if start is None else start)
    scene = surroundings(robot).scene
    if hit := scene.hits(start[None])[0]:
        raise InputError(f"{robot.path}: the robot collides where it starts ({hit}); give another start (--start FILE)")
    left_out = {name: why for name, why in zip(poses.names, _blocked(robot, poses.joints), strict=True) if why}
    free = poses.subset(np.array([k for k, name in enumerate(poses.names) if name not in left_out], dtype=np.intp))
    planner = Planner(scene, np.vstack([start, free.joints, _more(robot, scene, seed)]), robot.joint_limits, seed)
    stops, unreached = _visit(planner, start, free, progress)
    left_out |= dict.fromkeys(unreached, "no free way leads there")
    replaced: tuple[str, ...] = ()
    if left_out and candidates is not None and stops:
        here = stops[-1].joints
        more, _ = _visit(planner, here, _next_best(robot, candidates, poses, stops, len(left_out)), progress)
        stops, replaced = stops + more, tuple(stop.name for stop in more)
    if not stops:
        reasons = listed([f"{name}: {why}" for name, why in left_out.items()], "; ", 3)
        raise ComputationError(f"none of {counted(len(poses), 'pose')} can be visited ({reasons})")
    return Route(robot, start, tuple(stops), left_out, replaced, scene.remarks)


def _blocked(robot: Robot, joints: FloatArray) -> tuple[str, ...]:
    """Why poses cannot be visited, "" where they may be."""
    low, high = robot.joint_limits.T
    outside = np.any((joints < low - 1e-9) | (joints > high + 1e-9), axis=1)
    hits = what_hits(robot, joints)
    return tuple("outside the joint limits" if out else hit for out, hit in zip(outside, hits, strict=True))


def _more(robot: Robot, scene: Scene, seed: int) -> FloatArray:
    """Further free poses, (n, n_actuated)."""
    try:
        q = robot.sample(_NODES, seed)
    except DataError:
        return np.zeros((0, len(robot.joint_names)))
    return q[[not hit for hit in scene.hits(q)]]


def _visit(
    planner: Planner, start: FloatArray, poses: Poses, progress: Progress | None
) -> tuple[list[Stop], list[str]]:
    """Stops in order, and names of those that no way reaches."""
    shortest = brought("calib.methods", "shortest_order")
    stops: list[Stop] = []
    waiting, first = list(range(len(poses))), True
    while waiting:
        here = stops[-1].joints if stops else start
        order = [waiting[k] for k in shortest(poses.joints[waiting], here)]
        waiting, before = [], len(stops)
        for number, k in enumerate(order):
            here = stops[-1].joints if stops else start
            way = planner.way(here, poses.joints[k], searched=first)
            if way is None:
                waiting.append(k)
            else:
                stops.append(_stop(planner, poses.names[k], way))
            if progress is not None:
                progress(number + 1, len(order))
        first = False
        if len(stops) == before:
            break
    return stops, [poses.names[k] for k in waiting]


def _stop(planner: Planner, name: str, way: FloatArray) -> Stop:
    scene = planner.scene
    apart = scene.distances(scene.configurations(way[-1:])[0])[0] + scene.margins
    nearest = int(np.argmin(apart)) if apart.size else -1
    moves = [planner.move(a, b).clearance for a, b in pairwise(way)]
    pair = scene.name(nearest) if apart.size else ""
    return Stop(name, way[-1], way[1:-1], float(np.min(apart, initial=np.inf)), pair, min(moves))


def _next_best(robot: Robot, candidates: Poses, poses: Poses, stops: Sequence[Stop], count: int) -> Poses:
    """The candidates that help most beside the stops, by O1, of those that are free."""
    taken = set(poses.names)
    hits = _blocked(robot, candidates.joints)
    usable = [k for k, name in enumerate(candidates.names) if name not in taken and not hits[k]]
    rest = candidates.subset(np.array(usable, dtype=np.intp))
    if len(rest) <= count:
        return rest
    select = brought("calib.methods", "select")
    chosen = select(robot, rest, count, measured=np.array([stop.joints for stop in stops]), checked=False)
    return rest.subset(chosen.chosen)
