"""The content of a viewer without a viewer: robot, poses and errors as named shapes, matrices and numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from calib import Fit, Robot
from calib.core.base.arrays import FloatArray, IntArray, evenly_spread
from calib.core.base.units import DISPLAY_UNIT, ERROR_UNIT, in_unit
from calib.core.base.words import count_noun
from calib.core.fitting.error_sets import STATES
from calib.core.instruments.kind import Part
from calib.core.instruments.position import POSITION
from viz.bodies import Bodies, PosedRobot, bodies_of, posed_robot
from viz.drive import drive_data
from viz.geometry import read_shapes
from viz.instrument_shapes import instrument_shapes, wires
from viz.judgement import Judgement, judgement_of_fit
from viz.pose_sources import from_fit
from viz.poses import PoseTable, empty, rows_shown
from viz.reading_errors import ReadingErrors, reading_errors_of_fit
from viz.remarks import fit_remarks, remarks
from viz.shapes import Shape
from viz.surroundings import decorations_of, surrounding_shapes
from viz.workspace_map import WorkspaceMap

_NICE = (1.0, 2.0, 5.0)
_VECTOR_SIZE, _GHOST_SIZE = 0.025, 0.04  # of the scene: size of typical exaggerated errors at first
_LARGEST_FACTOR = 1000.0
_LOOKED_AT = 16  # poses of the robot that the first camera shows completely
_LONGEST_TIP = 0.2  # of the scene: longest part of an enlarged error vector that the first camera shows
_TURN, _RISE = 0.65, 0.33  # first camera: angle to the side of the points and above them [rad]
_FLAT, _RISE_FLAT = 0.4, 0.8  # lower scenes [part of their width] are seen from higher up: of no height, by this


@dataclass(frozen=True, eq=False)
class SceneView:
    """The first view of the scene. Its frame has the measurement frame's origin, but stands upright like the root link.

    Attributes:
        upright: Rotation from the measurement frame to the view's frame, whose z axis points upwards, (3, 3).
        low, high: Corners of the box around everything, (3,) [m].
        outline: Points around everything that must be visible, (m, 3) [m].
        direction: Unit vector from the scene to the camera, (3,).
    """

    upright: FloatArray
    low: FloatArray
    high: FloatArray
    outline: FloatArray
    direction: FloatArray

    @property
    def size(self) -> float:
        """Diagonal of the box [m]."""
        return float(np.linalg.norm(self.high - self.low))


@dataclass(frozen=True)
class ViewerJoint:
    """Name of an actuated joint in the panel, its unit, and the number of these units in one SI unit."""

    name: str
    unit: str
    per_si: float


@dataclass(frozen=True, eq=False)
class ViewerScene:
    """The content of a viewer. Lengths in m, angles in rad, points in the measurement frame.

    Attributes:
        title: The robot's name.
        joints: Actuated joints, in the order of the pose table's columns.
        shapes: Shapes of the robot, each on a link.
        decorations: Shapes at rest.
        bodies: The tree of links.
        solid: The robot as known: calibrated, or nominal without a result.
        ghost: The robot before calibration; None without a result.
        poses: The points.
        shown: Rows of these in the page, (n_shown,), at which the robots are posed; at home without rows.
        readings: Errors of readings other than positions in the page, part by part.
        pose_of_row: Index of the robots' pose of each of these rows, part by part.
        n_readings: Number of rows of all readings, in the page or not.
        vector_factors: First exaggeration of the errors of each state, of positions and of each part of `readings`.
        ghost_factor: First exaggeration of the ghost; 1 if there is nothing to correct.
        view: First camera.
        drive: Data to move the robot by hand.
        notes: Warnings about the picture.
        uncertainty_notes: Sentences on the frame of the numbers, if it could be mistaken.
        remarks: Comments of the measurement files, of `viz.remarks.remarks`.
        verdict: Verdict on the fit, or None.
        map: Uncertainty over the workspace, if requested.
        others: Entries of `other_errors`.
    """

    title: str
    joints: tuple[ViewerJoint, ...]
    shapes: tuple[Shape, ...]
    decorations: tuple[Shape, ...]
    bodies: Bodies
    solid: PosedRobot
    ghost: PosedRobot | None
    poses: PoseTable
    shown: IntArray
    readings: tuple[ReadingErrors, ...]
    pose_of_row: tuple[IntArray, ...]
    n_readings: int
    vector_factors: tuple[dict[str, float], ...]
    ghost_factor: float
    view: SceneView
    drive: dict[str, Any]
    notes: tuple[str, ...]
    uncertainty_notes: tuple[str, ...]
    remarks: dict[str, Any]
    verdict: Judgement | None = None
    map: WorkspaceMap | None = None
    others: tuple[dict[str, Any], ...] = ()

    @property
    def states(self) -> tuple[str, ...]:
        """States whose errors are known: `before`, `after`."""
        known = {
            state: [self.poses.error(state), *(errors.sizes(state) for errors in self.readings)] for state in STATES
        }
        return tuple(state for state in STATES if any(np.any(np.isfinite(errors)) for errors in known[state]))

    @property
    def shows_poses(self) -> bool:
        """Whether a page has the rows of the pose table: errors of positions, or predictions without readings."""
        return not self.readings or any(np.any(np.isfinite(self.poses.error(state))) for state in STATES)

    @property
    def n_rows(self) -> int:
        """Number of rows of a page."""
        return (len(self.poses) if self.shows_poses else 0) + sum(map(len, self.readings))

    @cached_property
    def rows(self) -> tuple[ReadingErrors, ...]:
        """Rows of the page, part by part: points first, at their measured, or else predicted, places."""
        if not self.shows_poses:
            return self.readings
        table = self.poses.subset(self.shown)
        predicted = np.where(np.isfinite(table.after), table.after, table.before)
        places = np.where(np.isfinite(table.measured), table.measured, predicted)
        before, after = table.error("before"), table.error("after")
        points = ReadingErrors(
            POSITION, False, table.joints, places, before, after, before, after, np.zeros((len(table), 0)), table.group,
            table.outlier, table.labels, table.targets, table.targets,
        )  # fmt: skip
        return (points, *self.readings)

    @property
    def factors(self) -> tuple[dict[str, float], ...]:
        """First exaggeration of the errors of each state, of each part of `rows`."""
        return self.vector_factors if self.shows_poses else self.vector_factors[1:]


def scene_of_fit(fit: Fit, judgement: Judgement | None = None) -> ViewerScene:
    """Return the scene of a fit, with a given verdict or its own."""
    return build_scene(
        fit.placed,
        fit.robot,
        from_fit(fit),
        reading_errors_of_fit(fit),
        verdict=judgement or judgement_of_fit(fit),
        uncertainty_notes=fit.reported_uncertainty.notes,
        comments=fit_remarks(fit),
        others=other_errors(fit),
    )


def build_scene(
    nominal: Robot,
    calibrated: Robot | None = None,
    poses: PoseTable | None = None,
    readings: tuple[ReadingErrors, ...] = (),
    *,
    verdict: Judgement | None = None,
    notes: tuple[str, ...] = (),
    uncertainty_notes: tuple[str, ...] = (),
    comments: dict[str, Any] | None = None,
    others: tuple[dict[str, Any], ...] = (),
) -> ViewerScene:
    """Return the scene of a robot before and, if given, after calibration, at poses (None: at home).

    `readings` are errors of readings other than positions, and `others` their sizes; `notes` come before those on the
    URDF's shapes; `uncertainty_notes` are sentences on the frame of the numbers.

    Raises:
        UnreachablePoseError: A pose cannot be assembled.
    """
    table = empty(nominal) if poses is None else poses
    rows = rows_shown(table)
    kept = tuple(errors.subset(errors.rows_shown()) for errors in readings)
    shown, pose_of_row = _shown_joints(table.joints[rows] if len(table) else nominal.home[None, :], kept)
    solid_robot = nominal if calibrated is None else calibrated
    bodies = bodies_of(solid_robot)
    solid = posed_robot(solid_robot, bodies, shown)
    ghost = None if calibrated is None else posed_robot(nominal, bodies, shown)
    if ghost is not None and nominal.description.base.pose == "unknown":
        ghost = replace(ghost, root=bodies.poses(solid, 0)[0])
    if ghost is not None:  # instruments have no nominal place, so the ghost carries them at the calibrated place
        of_instruments = np.array([name.startswith("(") for name in bodies.names[1:]]) & (
            np.arange(1, len(bodies.names)) != bodies.base
        )
        ghost = replace(ghost, placements=np.where(of_instruments[:, None, None], solid.placements, ghost.placements))
    shapes, shape_notes = read_shapes(nominal)
    shapes += instrument_shapes(solid_robot) + surrounding_shapes(solid_robot)
    decorations = (*decorations_of(nominal.name), *wires(solid_robot, bodies, solid))
    view = _view(bodies, solid, shapes, decorations, table)
    size = view.size
    every = [
        (table.measured, {state: table.error(state) for state in STATES}),
        *((errors.anchors, {state: errors.arrows(state) for state in STATES}) for errors in kept),
    ]
    factors = tuple(
        {state: nice_factor(_typical(arrows[state]), _VECTOR_SIZE * size) for state in STATES} for _, arrows in every
    )
    longest = _LONGEST_TIP * size
    tips = np.concatenate([_tips(*drawn, factor, longest) for drawn, factor in zip(every, factors, strict=True)])
    around = np.concatenate([view.outline, tips @ view.upright.T])
    moved = float("nan") if ghost is None else _typical_motion(bodies, solid, ghost)
    return ViewerScene(
        nominal.name,
        joints_of(nominal),
        shapes,
        decorations,
        bodies,
        solid,
        ghost,
        table,
        rows,
        kept,
        pose_of_row,
        sum(map(len, readings)),
        factors,
        1.0 if verdict is not None and verdict.needs_no_correction else nice_factor(moved, _GHOST_SIZE * size),
        replace(view, outline=_outline(around, *_box(around))),
        drive_data(solid_robot, bodies, shown),
        (*notes, *shape_notes),
        uncertainty_notes,
        comments or remarks(),
        verdict,
        others=others,
    )


def other_errors(fit: Fit) -> tuple[dict[str, Any], ...]:
    """Return the errors of a fit's instruments other than errors of positions.

    Each has the RMS and the largest error of each set, before and after calibration, in its own unit. If several
    instruments have the main part, and it is no position, the errors of all of them come first.
    """
    tables = {group: errors.tables() for group, errors in fit.error_sets.items()}
    read = []
    for instrument in fit.nominal.instruments:
        own = {group: table[instrument.name] for group, table in tables.items() if instrument.name in table}
        if own:
            read += [
                (instrument.name, part, {group: table[part.name] for group, table in own.items()})
                for part in instrument.parts
            ]
    others = [(name, part, errors) for name, part, errors in read if not part.is_position]
    result = [_errors_of([name], part, errors) for name, part, errors in others]
    if others and len(others) == len(read):
        main = others[0][1]
        several = [name for name, part, _ in others if part.name == main.name]
        if len(several) > 1:
            return (_errors_of(several, main, fit.errors), *result)
    return tuple(result)


def _errors_of(instruments: list[str], part: Part, errors: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {
        "instruments": instruments,
        "of": instruments[0] if len(instruments) == 1 else count_noun(len(instruments), "instrument"),
        "several": len(instruments) > 1,
        "part": part.name,
        "unit": ERROR_UNIT[part.dimension],
        "sets": [
            {"group": name, **{state: [float(off[state][size]) for size in ("rms", "max")] for state in STATES}}
            for name, off in errors.items()
        ],
    }


def joints_of(robot: Robot) -> tuple[ViewerJoint, ...]:
    """Return the names and units of the actuated joints of a robot."""
    units = {name: DISPLAY_UNIT[robot.mechanism.dimensions[name]] for name in robot.joint_names}
    return tuple(ViewerJoint(name, unit, in_unit(1.0, unit)) for name, unit in units.items())


def nice_factor(typical: float, longest: float) -> float:
    """Return 1, 2 or 5 times a power of ten, from 1 to 1000, that makes `typical` at most `longest` if possible [m]."""
    if not (typical > 0 and longest > 0):
        return 1.0
    ratio = min(max(longest / typical, 1.0), _LARGEST_FACTOR)
    decade = 10.0 ** np.floor(np.log10(ratio))
    return float(max(step * decade for step in _NICE if step * decade <= ratio * (1 + 1e-9)))


def _typical_motion(bodies: Bodies, solid: PosedRobot, ghost: PosedRobot) -> float:
    """Return the typical distance of links of two robots: median over poses of the farthest link [m]."""
    some = slice(None, None, max(1, len(solid.values) // 20))
    difference = (bodies.poses(ghost, some) - bodies.poses(solid, some))[..., :3, 3]
    apart = np.linalg.norm(difference, axis=2)[:, [not name.startswith("(") for name in bodies.names]]
    return float(np.median(np.max(apart, axis=1)))


def _typical(vectors: FloatArray) -> float:
    """Return the median length of the finite vectors; NaN if there are none."""
    lengths = np.linalg.norm(vectors, axis=1)
    known = lengths[np.isfinite(lengths)]
    return float(np.median(known)) if len(known) else float("nan")


def _shown_joints(joints: FloatArray, readings: tuple[ReadingErrors, ...]) -> tuple[FloatArray, tuple[IntArray, ...]]:
    """Joints of the robots' poses, (n, n_actuated), first of points; and the index of each reading's pose."""
    numbers: dict[bytes, int] = {}
    for number, row in enumerate(joints):
        numbers.setdefault(row.tobytes(), number)
    more: list[FloatArray] = []
    of_row = []
    for errors in readings:
        places = np.zeros(len(errors), dtype=np.intp)
        for k, row in enumerate(errors.joints):
            places[k] = numbers.setdefault(row.tobytes(), len(joints) + len(more))
            if places[k] == len(joints) + len(more):
                more.append(row)
        of_row.append(places)
    return np.concatenate([joints, np.array(more).reshape(-1, joints.shape[1])]), tuple(of_row)


def _tips(places: FloatArray, arrows: dict[str, FloatArray], factors: dict[str, float], longest: float) -> FloatArray:
    """Return the tips of the enlarged errors of both states, at most `longest` [m] away, (m, 3) [m]."""
    tips = [np.zeros((0, 3))]
    for state, factor in factors.items():
        errors = factor * arrows[state]
        length = np.linalg.norm(errors, axis=1, keepdims=True)
        known = np.isfinite(length[:, 0]) & (length[:, 0] > 0)
        shortened = errors[known] * np.minimum(1.0, longest / length[known])
        tips.append(places[known] + shortened)
    return np.concatenate(tips)


def _view(
    bodies: Bodies, solid: PosedRobot, shapes: tuple[Shape, ...], decorations: tuple[Shape, ...], table: PoseTable
) -> SceneView:
    """View from the side of the points, slightly from above, so that they stand before the robot; flat ones, higher."""
    R = bodies.poses(solid, 0)[0, :3, :3].T
    number = {name: body for body, name in enumerate(bodies.names)}
    robot = [np.zeros((0, 3))]
    corners = [(number[str(shape.body)], shape.corners()) for shape in shapes]
    for matrices in bodies.matrices(solid, evenly_spread(len(solid.values), _LOOKED_AT)):
        robot += [own @ matrices[body, :3, :3].T + matrices[body, :3, 3] for body, own in corners]
    predicted = table.before if not np.any(np.isfinite(table.after)) else table.after
    points = predicted[np.all(np.isfinite(predicted), axis=1)]
    robot_points, all_points = np.concatenate(robot) @ R.T, np.concatenate([*robot, points]) @ R.T
    still = [shape.corners() @ R.T for shape in decorations]
    everything = np.concatenate([all_points, *still])
    low, high = _box(everything)
    forward = np.array([1.0, 0.0, 0.0])
    if len(points):
        away = ((points @ R.T).mean(axis=0) - np.mean(_box(robot_points), axis=0))[:2]
        if np.linalg.norm(away) > 1e-3 * np.linalg.norm(high - low):
            forward = np.append(away / np.linalg.norm(away), 0.0)
    turned = np.cos(_TURN) * forward + np.sin(_TURN) * np.cross([0.0, 0.0, 1.0], forward)
    height = (high - low)[2] / max(float(np.max((high - low)[:2])), 1e-9)
    rise = float(np.interp(height, [0.0, _FLAT], [_RISE_FLAT, _RISE]))
    return SceneView(R, low, high, _outline(everything, low, high), np.append(np.cos(rise) * turned[:2], np.sin(rise)))


def _outline(points: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the corners of the convex hull, or of the box if all points lie in a plane."""
    try:
        corners: FloatArray = points[scipy.spatial.ConvexHull(points).vertices]
    except (scipy.spatial.QhullError, ValueError):
        corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    return corners


def _box(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    if not len(points):
        return np.full(3, -0.5), np.full(3, 0.5)
    return points.min(axis=0), points.max(axis=0)
