"""Placing unknown measurement frames and unknown targets before anything else is fitted.

The place of the tracker, and of the reflector on the flange, are often unknown. Both follow from the measured points
and the robot with its other parameters, by one fit over all targets (`calib.core.numerics.placement`). The stated sigma
of a target counts, with the noise of the residuals. What the measurements leave open keeps its value. Where
orientations were measured too, the unknown orientation of a target is their mean. In later setups, a frame or target
that was moved follows from the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import scipy

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.errors import DataError
from calib.core.base.sections import ANGLE_COMPONENTS, COMPONENTS, LENGTH_COMPONENTS, Component
from calib.core.data.measurements import Measurements
from calib.core.instruments.kind import FrameInstrument, Guess, JointInstrument, Scene
from calib.core.numerics.placement import MovingPoint, Placement, place
from calib.core.robots.described_instruments import MEASUREMENT_FRAME, pair_names
from calib.core.robots.jacobian import relative_poses
from calib.core.robots.mechanism import RelativeFrame
from calib.core.robots.robot import Robot
from calib.core.rows.observed import observe, views_of_instruments

_SQUARED_ROUNDING = 1e-30  # squares below are rounding


def register(robot: Robot, data: Measurements, *, rough_beyond: float = np.inf) -> Robot:
    """Return the robot with unknown base and targets placed by its measurements.

    All other parameters, and held ones of base and targets, keep their values. Without enough measured points, all
    parameters do.

    Args:
        rough_beyond: As in `calib.core.numerics.placement.place` [m].

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
        DataError: Measurements that are not finite.
    """
    by_points: set[str] = set()
    for setup in range(max(len(robot.description.setups), 1)):
        for seen in _seen_targets(robot, data, setup):
            values = _places_by_points(robot, data, seen, rough_beyond)
            by_points |= values.keys()
            robot = _with_values(robot, values)
            robot = _with_values(robot, _orientations(robot, data, seen))
    placed: list[str] = []
    for instrument in robot.instruments:
        if instrument.name in data.readings:
            placed.append(instrument.name)
            if isinstance(instrument, FrameInstrument):
                robot = _guess(robot, data, instrument, placed, by_points)
            elif isinstance(instrument, JointInstrument):
                robot = _guess_joint_numbers(robot, data, instrument)
    return robot


def registration(
    robot: Robot, data: Measurements, *, frame_known: bool, targets_known: bool = True
) -> tuple[Placement, tuple[str, ...]]:
    """Return the measurement frame and targets of the first setup by the measurements, and the names of these targets.

    Args:
        robot: The robot; components that the measurements do not determine stay near its current values.
        frame_known: Whether the measurement frame counts as known, against the description.
        targets_known: Whether targets that the description calls known count as known.

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
        DataError: No points were measured, or measurements that are not finite.
    """
    groups = _seen_targets(robot, data, 0)
    if not groups:
        raise DataError(f"{data.path}: no points were measured, so that the measurement frame cannot be placed")
    placement = _registration(robot, data, groups[0], frame_known=frame_known, targets_known=targets_known)
    return placement, groups[0].names


@dataclass(frozen=True)
class _SeenTargets:
    """Targets whose points were measured together in a setup.

    Attributes:
        names: The targets.
        is_seen: Mask of the visits at which all of them were, (n,).
        pairs: Measurement frame and target of each target of this setup, seen or not.
        base: Origin of the measurement frame.
        origins: Origin of each target.
    """

    names: tuple[str, ...]
    is_seen: BoolArray
    pairs: dict[str, RelativeFrame]
    base: str
    origins: dict[str, str]


def _seen_targets(robot: Robot, data: Measurements, setup: int) -> list[_SeenTargets]:
    """Targets of a setup whose points were measured: all together, or else each alone, most visits first."""
    mechanism, n_setups = robot.mechanism, max(len(robot.description.setups), 1)
    pairs: dict[str, RelativeFrame] = {}
    in_setup = np.zeros(len(data), dtype=bool)
    for instrument in robot.instruments:
        all_pairs, readings = robot.pairs[instrument.name], data.readings.get(instrument.name)
        if isinstance(instrument, FrameInstrument) and all_pairs[0].a == mechanism.targets[0].a:
            pairs.setdefault(instrument.target, all_pairs[setup * len(all_pairs) // n_setups])
        if readings is not None and instrument.points(readings.values[:1]) is not None:
            in_setup[readings.visits[readings.pairs * n_setups // len(all_pairs) == setup]] = True
    seen = np.isfinite(data.points(robot)).all(axis=2) & in_setup[:, None]
    targets = [t for t in range(seen.shape[1]) if np.any(seen[:, t])]
    if not targets:
        return []
    groups = [targets]
    if np.sum(np.all(seen[:, targets], axis=1)) < 3:
        groups = [[t] for t in sorted(targets, key=lambda t: -int(np.sum(seen[:, t])))]
    base = mechanism.origin_names[next(iter(pairs.values())).a - 1]
    origins = {name: mechanism.origin_names[pair.b - 1] for name, pair in pairs.items()}
    return [
        _SeenTargets(tuple(robot.target_names[t] for t in own), np.all(seen[:, own], axis=1), pairs, base, origins)
        for own in groups
    ]


def _places_by_points(robot: Robot, data: Measurements, seen: _SeenTargets, rough_beyond: float) -> dict[str, float]:
    """Values [m or rad] of the unknown measurement frame and targets, by the measured points."""
    frame_known = robot.description.base.pose == "known"
    placement = _registration(robot, data, seen, frame_known=frame_known, rough_beyond=rough_beyond)
    values: dict[str, float] = {}
    for target, point in zip(seen.names, placement.points, strict=True):
        if robot.description.targets[target].position == "unknown":
            values |= _values_at(robot, seen.origins[target], pin.SE3(np.eye(3), point), LENGTH_COMPONENTS)
    if not frame_known:
        values |= _values_at(robot, seen.base, placement.T_base_measurement, COMPONENTS, reversed_frame=True)
    return values


def _values_at(
    robot: Robot, origin: str, pose: pin.SE3, components: tuple[str, ...], *, reversed_frame: bool = False
) -> dict[str, float]:
    """Values of components of an origin at a pose in its link; of a measurement frame, the link's pose in it."""
    nominal = robot.nominal.placement(origin)
    if reversed_frame:
        pose, nominal = pose.inverse(), nominal.inverse()
    numbers = np.concatenate([pose.translation, pin.log3(nominal.rotation.T @ pose.rotation)]).tolist()
    return {f"{origin}.{name}": number for name, number in zip(COMPONENTS, numbers, strict=True) if name in components}


def _with_values(robot: Robot, values: dict[str, float]) -> Robot:
    free = {name: value for name, value in values.items() if name not in robot.description.held}
    return robot.with_parameters(free) if free else robot


def _registration(
    robot: Robot,
    data: Measurements,
    seen: _SeenTargets,
    *,
    frame_known: bool,
    targets_known: bool = True,
    rough_beyond: float = np.inf,
) -> Placement:
    chosen = np.flatnonzero(seen.is_seen)
    points = data.points(robot)[chosen]
    carriers = _carriers(robot, data, chosen, [seen.pairs[target] for target in seen.names])
    moving = [
        MovingPoint(
            poses,
            points[:, robot.target_names.index(target)],
            *_expected_place(robot, target, seen.origins[target], known=targets_known),
        )
        for target, poses in zip(seen.names, carriers, strict=True)
    ]
    T_base_measurement, ones = robot.mechanism.placement(seen.base), np.ones(len(chosen))
    return place(moving, ones, T_base_measurement, frame_known=frame_known, rough_beyond=rough_beyond)


def _guess(
    robot: Robot, data: Measurements, instrument: FrameInstrument, placed: list[str], by_points: set[str]
) -> Robot:
    """Return the robot with the first guess of an instrument; what measured points placed (`by_points`) stays.

    Of several guesses, the best for the readings of this instrument and of those placed before is taken: two cameras
    may look at one body.
    """
    if type(instrument).first_values is FrameInstrument.first_values:  # the kind has no guess
        return robot
    readings = data.readings[instrument.name]
    names = pair_names(robot.description, instrument)
    mechanism, pairs = robot.mechanism, robot.pairs[instrument.name]
    places = {name: mechanism.placement(mechanism.origin(name)) for pair in names for name in pair}
    known = {name: pose.homogeneous for name, pose in places.items()}
    unknown = {name: _open_components(robot, name, by_points) for name in places}
    links = np.tile(np.eye(4), (len(readings), 1, 1))
    for number, pair in enumerate(pairs):
        chosen = np.flatnonzero(readings.pairs == number)
        if len(chosen):
            links[chosen] = _carriers(robot, data, readings.visits[chosen], [pair])[0]
    values = robot.values[robot.unknowns[instrument.name]]
    guesses = instrument.first_values(Scene(readings, links, names, known, unknown, values))
    tried = [_with_guess(robot, instrument, guess, unknown) for guess in guesses]
    if len(tried) < 2:
        return tried[0] if tried else robot
    configurations = robot.assemble(data.joints, labels=data.labels, context=data.conditions)

    def miss(candidate: Robot) -> float:
        observed = observe(candidate, configurations, {name: data.readings[name] for name in placed})
        return sum(
            len(each.residuals) * np.log(np.nanmean(each.residuals**2) + _SQUARED_ROUNDING)
            for each in observed.values()
        )

    return min(tried, key=miss)


def _guess_joint_numbers(robot: Robot, data: Measurements, instrument: JointInstrument) -> Robot:
    readings = data.readings[instrument.name]
    configurations = robot.assemble(data.joints, labels=data.labels, context=data.conditions)
    seen = np.asarray(views_of_instruments(robot, configurations, {instrument.name: readings})[instrument.name])
    first = instrument.first_unknowns(seen, robot.values[robot.unknowns[instrument.name]], readings)
    return _with_values(robot, {p.name: float(value) for p, value in zip(instrument.unknowns, first, strict=True)})


def _open_components(robot: Robot, place: str, by_points: set[str]) -> tuple[Component, ...]:
    """Components of a place that a fit may change, and that points did not place."""
    origin = robot.mechanism.origin(place)
    free = {p.name for p, use in zip(robot.parameters, robot.is_free, strict=True) if use and p.placement} - by_points
    return tuple(component for component in COMPONENTS if f"{origin}.{component}" in free)


def _with_guess(
    robot: Robot, instrument: FrameInstrument, guess: Guess, unknown: Mapping[str, tuple[Component, ...]]
) -> Robot:
    values: dict[str, float] = {}
    for name, pose in guess.places.items():
        origin, is_frame = robot.mechanism.origin(name), name.startswith(MEASUREMENT_FRAME)
        values |= _values_at(robot, origin, pin.SE3(pose), unknown.get(name, ()), reversed_frame=is_frame)
    if guess.unknowns is not None:
        values |= {p.name: float(number) for p, number in zip(instrument.unknowns, guess.unknowns, strict=True)}
    return _with_values(robot, values)


def _orientations(robot: Robot, data: Measurements, seen: _SeenTargets) -> dict[str, float]:
    values: dict[str, float] = {}
    for name, readings in data.readings.items():
        instrument = robot.instrument(name)
        turned = instrument.orientations(readings.values)
        if turned is None or not isinstance(instrument, FrameInstrument):
            continue
        if robot.description.targets[instrument.target].orientation == "known":
            continue
        chosen = seen.is_seen[readings.visits] & np.isfinite(turned).all(axis=(1, 2))
        if not np.any(chosen):
            continue
        carriers = _carriers(robot, data, readings.visits[chosen], [seen.pairs[instrument.target]])[0][:, :3, :3]
        base = robot.mechanism.placement(seen.base).rotation
        turns = scipy.spatial.transform.Rotation.from_matrix(carriers.transpose(0, 2, 1) @ base @ turned[chosen])
        mean = pin.SE3(turns.mean().as_matrix(), np.zeros(3))
        values |= _values_at(robot, seen.origins[instrument.target], mean, ANGLE_COMPONENTS)
    return values


def _expected_place(robot: Robot, target: str, origin: str, *, known: bool) -> tuple[FloatArray, FloatArray]:
    """Expected position of a target in its link, and its sigma, (3,) each [m], as in `MovingPoint`."""
    point, sigma = robot.mechanism.placement(origin).translation.copy(), np.zeros(3)
    if robot.description.targets[target].position == "known":
        return point, sigma if known else np.full(3, np.inf)
    for k, axis in enumerate("xyz"):
        parameter = robot.parameters[f"{origin}.{axis}"]
        if parameter.name not in robot.description.held:
            sigma[k] = parameter.sigma_si if parameter.prior else np.inf
            point[k] = parameter.expected_si if parameter.prior else point[k]
    return point, sigma


def _carriers(robot: Robot, data: Measurements, chosen: IntArray, looked: list[RelativeFrame]) -> list[FloatArray]:
    """Poses of the link that carries each target, in the link of the measurement frame, (n, 4, 4) [m] each."""
    mechanism = robot.mechanism
    parents = mechanism.model.parents
    pairs = tuple(RelativeFrame(pair.name, parents[pair.a], parents[pair.b], True, ()) for pair in looked)
    labels = [data.labels[k] for k in chosen]
    configurations = robot.assemble(data.joints[chosen], None, labels, data.conditions.select(chosen))
    return list(relative_poses(mechanism, configurations, pairs))
