"""The route: the order of poses, free paths between them, and poses that cannot be visited.

Order of work. Poses that are not free, or outside the joint limits, are left out. The others are put in an order of
little travel, and paths are found one after the other. Poses without a path are left out by name, and replaced by the
next best candidates, which are visited at the end.

A touch is approached and left along the normal of the touched surface: z of a plane's or socket's axes, and of a sphere
the line from its centre. The target is moved along it by the smallest change of joint values, within their limits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.errors import ComputationError, DataError, InputError
from calib.core.base.registry import load_entry
from calib.core.base.units import DISPLAY_UNIT, quantity_text
from calib.core.base.words import count_noun, listing
from calib.core.base.workers import Progress
from calib.core.data.measurements import Poses
from calib.core.instruments.kind import Readings
from calib.core.instruments.touch import Touch
from calib.core.robots.robot import Robot
from calib.core.rows.observed import predict_readings
from calib.core.rows.simulate import MET, touching_configurations
from calib.motion.planner import Planner
from calib.motion.poses import surroundings, what_hits
from calib.motion.scene import CollisionScene, exceeds_limits
from calib.motion.surroundings import FLOOR, UNCHECKED
from calib.shared.candidates import reachable_configurations

_NODES = 150  # poses of the roadmap in addition to the stops
_ROUNDS = 6  # rounds of tries with the next best candidates
_MORE = 10  # candidates of a round in place of those that could not be reached, at most
_TURNS = 3  # tried variants of a pose with joints turned by whole turns
_ROUND = 1e-9  # rounding of limits, in turns
_NO_WAY = "no free way leads there"


@dataclass(frozen=True, eq=False)
class Stop(ReadOnlyArrays):
    """A visited pose.

    Attributes:
        name: Name of the pose.
        joints: (n_actuated,) [m or rad].
        corners: Corners of the path from the stop before, without both ends, (n, n_actuated) [m or rad].
        clearance: Smallest distance of any pair at the stop [m].
        pair: Name of that pair.
        path_clearance: Smallest distance of any pair on the path [m].
    """

    name: str
    joints: FloatArray
    corners: FloatArray
    clearance: float
    pair: str
    path_clearance: float


@dataclass(frozen=True, eq=False)
class Route:
    """Stops in order, from the robot's start.

    Attributes:
        start: The robot's first joint values, (n_actuated,) [m or rad].
        left_out: Reason for each pose that is not visited, by name.
        replaced: Names of the candidates that replace them.
        remarks: Notes on unchecked shapes.
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
        poses: Poses to measure.
        start: Its first joint values, (n_actuated,) [m or rad]; default: home.
        candidates: Poses that may replace poses that cannot be visited.
        seed: Seed of all random numbers.
        progress: Called with the number of tried poses.

    Raises:
        InputError: The robot collides at the start, or cannot be there; or the description wants no checks.
        ComputationError: None of the poses can be visited.
        DescriptionError: The scene cannot be built; see `calib.motion.poses.surroundings`.
    """
    if robot.description.obstacles == UNCHECKED:
        raise InputError(
            f"{robot.path}: the description says 'obstacles: {UNCHECKED}', and nobody should drive an unchecked way;"
            f" write what is around the robot, such as 'obstacles: {FLOOR}'"
        )
    start = np.array(robot.home if start is None else start)
    scene = surroundings(robot).scene
    if excess := _excess_of_limits(robot, start):
        raise InputError(
            f"{robot.path}: the robot cannot start at {excess}; write a 'home' into the description, or give"
            " --start FILE"
        )
    if hit := scene.hits(start[None])[0]:
        raise InputError(f"{robot.path}: the robot collides where it starts ({hit}); give another start (--start FILE)")
    planner = Planner(scene, np.vstack([start, _more_free_poses(robot, scene, seed)]), robot.joint_limits, seed)
    stops, left_out = _visit(planner, start, poses, progress)
    replaced: list[Stop] = []
    candidates = poses.subset(np.zeros(0, dtype=np.intp)) if candidates is None else candidates
    if not stops:
        reasons = listing([f"{name}: {why}" for name, why in left_out.items()], "; ", 3)
        raise ComputationError(f"none of {count_noun(len(poses), 'pose')} can be visited ({reasons})")
    rest, n_tried = candidates, 0
    if left_out:  # the free ones that are none of the poses
        rest = rest.subset(np.flatnonzero(~np.isin(rest.names, poses.names)))
        rest = rest.subset(np.flatnonzero(np.array(_why_blocked(robot, rest.joints)) == ""))
    for _ in range(_ROUNDS):
        missing = len(left_out) - len(replaced)
        if not missing or not len(rest):
            break
        best = _next_best(robot, rest, stops + replaced, missing + min(n_tried - len(replaced), _MORE))
        n_tried += len(best)
        rest = rest.subset(np.flatnonzero(~np.isin(rest.names, best.names)))
        replaced += _visit(planner, (stops + replaced)[-1].joints, best, progress)[0][:missing]
    names = tuple(stop.name for stop in replaced)
    given = dict(zip((*candidates.names, *poses.names), (*candidates.joints, *poses.joints), strict=True))
    round_ = [stop.name for stop in (*stops, *replaced) if np.any(stop.joints != given[stop.name])]
    notes: list[str] = []
    if len(candidates) and (missing := len(left_out) - len(replaced)):
        notes.append(
            f"{count_noun(missing, 'pose')} left out without a replacement: {n_tried} free candidates were tried, and"
            f" {len(rest)} are left"
        )
    if round_:
        notes.append(f"some joints are a whole turn from the given values, at {listing(round_, shown=8)}")
    if robot.description.obstacles is None:
        notes.append("the description has no 'obstacles': nothing around the robot is checked, not even a floor")
    return Route(robot, start, (*stops, *replaced), left_out, names, (*scene.remarks, *notes))


def _excess_of_limits(robot: Robot, q: FloatArray) -> str:
    """The first of joint values (n_actuated,) beyond its limits, as text; "" for none."""
    outside = np.flatnonzero(exceeds_limits(robot, q)).tolist()
    if not outside:
        return ""
    name, limits = robot.joint_names[outside[0]], robot.joint_limits[outside[0]].tolist()
    value, low, high = (
        quantity_text(each, DISPLAY_UNIT[robot.mechanism.dimensions[name]], ".4g") for each in (q[outside[0]], *limits)
    )
    return f"{name} = {value}, beyond its limits ({low} to {high})"


def _why_blocked(robot: Robot, joints: FloatArray) -> tuple[str, ...]:
    """Reasons why poses cannot be visited, "" for none."""
    outside = np.any(exceeds_limits(robot, joints), axis=1)
    hits = what_hits(robot, joints)
    return tuple("outside the joint limits" if out else hit for out, hit in zip(outside, hits, strict=True))


def _more_free_poses(robot: Robot, scene: CollisionScene, seed: int) -> FloatArray:
    """Further free poses, with whole turns of joints towards home, (n, n_actuated)."""
    try:
        q = robot.sample(_NODES, seed)
    except DataError:
        return np.zeros((0, len(robot.joint_names)))
    for turned in _turned_by_full_turns(robot, robot.home, q)[:1]:
        nearer = np.sum(np.abs(turned - robot.home), axis=1) < np.sum(np.abs(q - robot.home), axis=1)
        q = np.where(nearer[:, None], turned, q)
    return q[[not hit for hit in scene.hits(q)]]


def _visit(
    planner: Planner, start: FloatArray, poses: Poses, progress: Progress | None
) -> tuple[list[Stop], dict[str, str]]:
    """Stops in order, and the reasons of the unvisited poses by name.

    A pose without a known path is tried with whole turns of joints, and then searched for.
    """
    stops: list[Stop] = []
    why = list(_why_blocked(planner.scene.robot, poses.joints))
    left = np.flatnonzero(np.array(why) == "")
    tries = [poses.joints, *_turned_by_full_turns(planner.scene.robot, planner.nodes[0], poses.joints), poses.joints]
    for number, joints in enumerate(tries):
        usable = left[np.all(np.isfinite(joints[left]), axis=1)]
        if not len(usable):
            continue
        given = replace(poses, joints=joints).subset(usable)
        added, missed = _pass(planner, (stops[-1].joints if stops else start), given, number == len(tries) - 1)
        stops += added
        for k in usable.tolist():
            why[k] = missed.get(poses.names[k], "")
        left = np.flatnonzero(np.array(why) == _NO_WAY)
        if progress is not None:
            progress(len(poses) - len(left), len(poses))
    for k in left.tolist():
        if blocking := planner.move(planner.nodes[planner.here], poses.joints[k]).hit:
            why[k] = f"{_NO_WAY}, {blocking} blocks the straight one"
    return stops, {name: reason for name, reason in zip(poses.names, why, strict=True) if reason}


def _turned_by_full_turns(robot: Robot, start: FloatArray, joints: FloatArray) -> list[FloatArray]:
    """The same poses with whole turns of joints, nearest to the start first, (n, n_actuated) each; NaN beyond limits.

    Every joint is as near as possible, or all but one.
    """
    least, most = ((robot.joint_limits[:, end] - joints) / (2 * np.pi) for end in (0, 1))
    possible = np.ceil(least - _ROUND), np.floor(most + _ROUND)
    fewest, largest = np.where(robot.mechanism.actuated_repeats, possible, 0.0)
    turns = np.clip(np.round((start - joints) / (2 * np.pi)), fewest, largest)
    further = turns + np.sign(start - joints - 2 * np.pi * turns)
    result = np.full((_TURNS, *joints.shape), np.nan)
    for k, q in enumerate(joints):
        others = np.where(np.eye(joints.shape[1], dtype=bool), further[k], turns[k])
        others = np.unique(np.vstack([turns[k], others]), axis=0)
        others = others[np.all((others >= fewest[k]) & (others <= largest[k]), axis=1) & np.any(others != 0, axis=1)]
        found = q + 2 * np.pi * others
        found = found[np.argsort(np.sum(np.abs(found - start), axis=1), kind="stable")][:_TURNS]
        result[: len(found), k] = found
    return [each for each in result if np.any(np.isfinite(each))]


def _pass(planner: Planner, start: FloatArray, poses: Poses, searched: bool) -> tuple[list[Stop], dict[str, str]]:
    """Stops of one pass through free poses, and the reasons of the other poses by name."""
    from_where = approaches(planner.scene.robot, poses)
    why = {
        poses.names[k]: _why_not_straight(planner, from_where[k], poses.joints[k])
        for k in np.flatnonzero(np.any(from_where != poses.joints, axis=1))
    }
    usable = np.array([k for k, name in enumerate(poses.names) if not why.get(name)], dtype=np.intp)
    if not len(usable):
        return [], why
    order = usable[load_entry("calib.methods", "shortest_order")(from_where[usable], planner.nodes[planner.here])]
    stops: list[Stop] = []
    for node, k in enumerate(order.tolist(), planner.add(from_where[order])):
        way = planner.free_path(planner.here, node, searched=searched)
        if way is None:
            why[poses.names[k]] = _NO_WAY
            continue
        before, planner.here = stops[-1].joints if stops else start, node
        stops.append(_stop(planner, poses.names[k], np.vstack([before, way, poses.joints[k]])))
    return stops, why


def _why_not_straight(planner: Planner, approach: FloatArray, touching: FloatArray) -> str:
    """Reason why a touch cannot be approached along its normal; "" for none."""
    if not np.all(np.isfinite(approach)):
        return "no joint values lift the tool straight off what it touches"
    hit = _why_blocked(planner.scene.robot, approach[None])[0] or planner.move(approach, touching).hit
    return f"{hit}, on its straight approach" if hit else ""


def _stop(planner: Planner, name: str, points: FloatArray) -> Stop:
    """The stop at the end of a path (n, n_actuated) from the stop before; points may repeat."""
    scene, way = planner.scene, points[np.append(True, np.any(np.diff(points, axis=0) != 0, axis=1))]
    apart = scene.distances(scene.configurations(points[-1:])[0])[0] + scene.margins
    nearest = int(np.argmin(apart)) if apart.size else -1
    moves = [planner.move(a, b).clearance for a, b in pairwise(way)]
    pair = scene.name(nearest) if apart.size else ""
    return Stop(name, points[-1], way[1:-1], float(np.min(apart, initial=np.inf)), pair, min(moves, default=np.inf))


def _next_best(robot: Robot, rest: Poses, stops: Sequence[Stop], count: int) -> Poses:
    """The poses that add most to the stops by O1."""
    if len(rest) <= count:
        return rest
    select = load_entry("calib.methods", "select")
    chosen = select(robot, rest, count, measured=np.array([stop.joints for stop in stops]), checked=False)
    return rest.subset(chosen.chosen)


_OFF = 0.05  # distance from contact at which the straight approach begins [m]


def approaches(robot: Robot, poses: Poses) -> FloatArray:
    """Return joint values from which each pose is approached, (n, n_actuated) [m or rad]; the pose itself if it touches
    nothing; NaN if there are none.
    """
    touches = [touch for touch in robot.instruments if isinstance(touch, Touch) and touch.name in poses.planned]
    if not touches:
        return poses.joints
    in_sockets = {touch.name: replace(touch, surface="socket") for touch in touches}  # a socket reads the whole offset
    touching_robot = replace(robot, instruments=tuple(in_sockets.get(each.name, each) for each in robot.instruments))
    good, configurations = reachable_configurations(robot, poses)
    off, touched = {}, np.zeros(len(poses), dtype=bool)
    for touch in touches:
        looks = poses.planned[touch.name]
        looks = looks.subset(np.flatnonzero(np.isin(looks.visits, good)))
        at = replace(looks, visits=np.searchsorted(good, looks.visits))
        offset = predict_readings(touching_robot, configurations, {touch.name: at})[touch.name].values
        sides = offset if touch.surface == "sphere" else np.tile([0.0, 0.0, 1.0], (len(offset), 1))
        sides = sides / np.maximum(np.linalg.norm(sides, axis=1, keepdims=True), MET)
        off[touch.name] = Readings(looks.visits, looks.pairs, offset + _OFF * sides, None, looks.details)
        touched[looks.visits] = True
    commands, misses = touching_configurations(touching_robot, poses, off)
    there = np.where((misses < MET)[:, None], commands, np.nan)
    return np.where(touched[:, None], there, poses.joints)
