"""A scene as data for the viewer's script: names and numbers in JSON, long arrays as base64."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.units import in_unit, millimetres
from calib.core.fitting.error_sets import STATES
from viz.bodies import PosedRobot
from viz.drawing import body_path, draw
from viz.poses import COLLIDES, EXCLUDED, GROUPS, IDENTIFICATION, MEASURED, PLANNED, VALIDATION, WORST
from viz.reading_errors import ReadingErrors
from viz.scene import ViewerScene, nice_factor
from viz.workspace_map import WorkspaceMap

_COLOURS = bytes.fromhex(
    "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26828e 21918c"
    "1f9f88 27ad81 3dbc74 5cc863 81d34d aadc32 d5e21a fde725"
)
"""Viridis at even steps, red, green, blue: even in lightness, and distinct with any colour vision. To load matplotlib
for it would take a quarter of a page's time."""
_POINT_RADIUS = (0.0012, 0.008)  # of the scene's size: for crowded points, and for points with room
_SAME = 5e-4  # of the scene's size: points that are closer look like one
_POINT_PIXELS = (4.0, 7.0)  # smallest width for crowded points, and for points with room
_FEW_POINTS = 500  # number of points that have room
_MARKS = {IDENTIFICATION: "disc", VALIDATION: "diamond", MEASURED: "square", EXCLUDED: "disc", PLANNED: "disc"}
_MARKS[COLLIDES] = "alarm"
_SHORT = {IDENTIFICATION: "fit", VALIDATION: "val", MEASURED: "meas", EXCLUDED: "out"}  # suffixes of repeated names
_SHORT |= {PLANNED: "plan", COLLIDES: "hits"}
_ELLIPSOID = 0.012  # of the scene's size: length of typical enlarged half axes at first
_COLOURED = 0.95  # part of the errors that have colours of their own; larger ones share the last
_EXACT = 1e-12  # [SI]: smallest range of colours, for errors of zero
_MOST_AXES = 3  # largest number of shown components of an error


def scene_data(scene: ViewerScene, *, live: bool = False) -> dict[str, Any]:
    """Return the scene as data for the page's script; arrays as base64, with NaN for unknown numbers."""
    bodies, table, shown = scene.bodies, scene.poses, scene.shown
    n_kept, n = sum(map(len, scene.readings)), scene.n_readings
    names = [body for body, name in enumerate(bodies.names) if not name.startswith("(")]
    return {
        "title": scene.title,
        "live": live,
        "notes": [
            *scene.uncertainty_notes,
            *scene.notes,
            *_left_out_notes(len(shown), len(table)),
            *_left_out_notes(n_kept, n),
        ],
        "remarks": scene.remarks,
        "verdict": None if scene.verdict is None else scene.verdict.to_dict(),
        "groups": [{"name": name, "short": _SHORT[name], "mark": _MARKS[name]} for name in GROUPS],
        "states": list(scene.states),
        "joints": [{"name": joint.name, "unit": joint.unit, "per_si": joint.per_si} for joint in scene.joints],
        "bodies": {
            **{name: np.asarray(getattr(bodies, name)).tolist() for name in ("parents", "axes", "sliding", "columns")},
            "base": bodies.base,
        },
        "body_paths": [body_path(scene, body) for body in range(len(bodies.names))],
        "frames": [{"body": body, "name": bodies.names[body]} for body in names],
        "solid": _posed_data(scene.solid),
        "ghost": None if scene.ghost is None else _posed_data(scene.ghost),
        "drive": scene.drive,
        "commands": [base64.b64encode(command).decode() for command in draw(scene)],
        "n_decorations": len(scene.decorations),
        "ghost_factor": scene.ghost_factor,
        "view": {name: getattr(scene.view, name).tolist() for name in ("low", "high", "outline", "direction")},
        "table": _table(scene),
        "parts": _parts(scene),
        "summary": summary(scene),
        "others": [
            {name: value for name, value in other.items() if name != "instruments"}
            | {"space": mean_distances(scene, other)}
            for other in scene.others
        ],
        "certainty": certainty(scene),
        "map": None if scene.map is None else _map(scene, scene.map),
        "colours": _encode(colours()),
        "point_radius": point_radius(scene),
        "point_pixels": point_pixels(max((len(rows) for rows in scene.rows), default=0)),
    }


def summary(scene: ViewerScene) -> list[dict[str, Any]]:
    """Return number of poses, RMS and largest error [mm] of each group, before and after calibration if known."""
    rows, table = [], scene.poses
    group = np.array(table.group)
    for name in GROUPS:
        chosen = group == name
        poses = {(table.series[k], table.place[k]) for k in np.flatnonzero(chosen)}  # one may have several points
        row: dict[str, Any] = {"group": name, "poses": len(poses)}
        for state in scene.states:
            lengths = np.linalg.norm(table.error(state)[chosen], axis=1)
            known = millimetres(lengths[np.isfinite(lengths)])
            row[state] = {"rms": float(np.sqrt(np.mean(known**2))), "max": float(known.max())} if len(known) else None
        if poses and scene.states and scene.shows_poses:
            rows.append(row)
    return rows


def certainty(scene: ViewerScene) -> dict[str, Any]:
    """Return the uncertainty of the numbers [mm]; None where unknown.

    Returns:
        `noise`: standard deviation of one reading per axis. `means`: smallest and largest standard deviation per axis
        of measured positions, which are means of readings. `readings`: smallest and largest number of these readings.
        `predicted`: standard deviation of predicted positions, all axes together, on average and at worst.
    """
    table, noise = scene.poses, scene.poses.sigma_of_reading()
    known = np.isfinite(noise)
    spread = np.linalg.norm(table.spread, axis=1)
    spread = spread[np.isfinite(spread) & np.any(spread > _EXACT)]
    predicted = [millimetres(float(length)) for length in (spread.mean(), spread.max())] if len(spread) else None
    if not np.any(known):
        return {"noise": None, "means": None, "readings": None, "predicted": predicted}
    return {
        "noise": millimetres(float(np.median(noise[known]))),
        "means": [millimetres(float(pick(table.sigma[known]))) for pick in (np.min, np.max)],
        "readings": [int(pick(table.readings[known])) for pick in (np.min, np.max)],
        "predicted": predicted,
    }


def ranges(sizes: Mapping[str, FloatArray], outlier: BoolArray) -> dict[str, list[float]]:
    """Return the errors [SI] at both ends of the colours: of each state (from zero), and of all (logarithmic).

    The colours end at the 95 % quantile without outliers; larger errors have the last colour. If all rows are outliers,
    it is theirs.

    Args:
        sizes: Sizes of the errors of each state, (n,) [SI]; NaN where unknown.
        outlier: Mask of outliers, (n,).
    """
    result, known = {}, []
    for state, lengths in sizes.items():
        if not np.any(np.isfinite(lengths)):
            continue
        usual = lengths[np.isfinite(lengths) & ~outlier]
        known.append(usual if len(usual) else lengths[np.isfinite(lengths)])
        result[state] = [0.0, max(float(np.quantile(known[-1], _COLOURED)), _EXACT)]
    if known:
        everything = np.concatenate(known)
        high = max(high for _, high in result.values())
        positive = everything[everything > high * 1e-4]
        low = float(positive.min()) if len(positive) else high
        result["both"] = [low if low < high else high / 10, high]
    return result


def colours() -> NDArray[np.uint8]:
    """Return 256 colours from small to large errors, (256, 4)."""
    steps = np.frombuffer(_COLOURS, dtype=np.uint8).reshape(-1, 3)
    at = np.linspace(0, len(steps) - 1, 256)
    parts = [np.interp(at, np.arange(len(steps)), part) for part in steps.T]
    table: NDArray[np.uint8] = np.round(np.column_stack([*parts, np.full(256, 255.0)])).astype(np.uint8)
    return table


def point_radius(scene: ViewerScene) -> float:
    """Return a radius [m] at which points are easy to see and rarely hide each other."""
    size = scene.view.size
    anchors = np.concatenate([rows.anchors for rows in scene.rows])
    grid = max(_SAME * size, 1e-6)  # points of several instruments at one place count once
    points = grid * np.unique(np.round(anchors[np.isfinite(anchors).all(axis=1)] / grid), axis=0)
    if len(points) < 2:
        return _POINT_RADIUS[1] * size
    gaps = scipy.spatial.cKDTree(points).query(points, k=2)[0][:, 1]
    return float(np.clip(0.42 * np.median(gaps), _POINT_RADIUS[0] * size, _POINT_RADIUS[1] * size))


def point_pixels(count: int) -> float:
    """Return the smallest width [px] of `count` drawn points: smaller for many, which would hide the robot."""
    return float(np.clip(_POINT_PIXELS[1] * np.sqrt(_FEW_POINTS / max(count, 1)), *_POINT_PIXELS))


def _left_out_notes(shown: int, n: int) -> list[str]:
    if shown == n:
        return []
    return [
        f"{shown} of {n} rows are in this page: outliers, the {WORST} largest errors before and after, others evenly"
        " spread; counts, means and largest errors are of all rows, and residuals.csv has them all"
    ]


def _parts(scene: ViewerScene) -> list[dict[str, Any]]:
    """Parts of errors in the page: names, units, colour limits in these units, first enlargements."""
    parts = []
    for rows, enlargements in zip(scene.rows, scene.factors, strict=True):
        is_position = rows.part.is_position
        every = {state: scene.poses.error(state) for state in STATES} if is_position else {}
        sizes = {state: np.linalg.norm(errors, axis=1) for state, errors in every.items()}
        sizes = sizes or {state: rows.sizes(state) for state in STATES}
        limits = ranges(sizes, scene.poses.outlier if is_position else rows.outlier)
        parts.append(
            {
                "name": rows.part.name,
                "unit": rows.unit,
                "axes": list(rows.part.axes),
                "position": is_position,
                "turns": rows.turns,
                "vector_factors": enlargements,
                "range": {state: [in_unit(end, rows.unit) for end in ends] for state, ends in limits.items()},
            }
        )
    return parts


def mean_distances(scene: ViewerScene, other: Mapping[str, Any]) -> list[float] | None:
    """Return the RMS distance [mm] of observed points before and after, for readings in another unit.

    Validation readings count if there are any; None for readings without a distance.
    """
    if sum(map(len, scene.readings)) != scene.n_readings or other["unit"] in ("mm", "mrad"):
        return None
    group = VALIDATION if VALIDATION in (one["group"] for one in other["sets"]) else IDENTIFICATION
    for errors in scene.readings:
        chosen = np.array(
            [
                target.split(" ")[0] in other["instruments"] and of == group
                for target, of in zip(errors.targets, errors.group, strict=True)
            ]
        )
        if errors.part.name == other["part"] and not errors.turns and np.any(chosen):
            squares = (np.sum(errors.arrows(state)[chosen] ** 2, axis=1) for state in STATES)
            return [millimetres(float(np.sqrt(np.nanmean(square)))) for square in squares]
    return None


def _table(scene: ViewerScene) -> dict[str, Any]:
    """All rows of the page, points first, with arrows in m or rad.

    Readings other than positions also have sizes and components of errors, in the unit of their part.
    """
    parts, shown = scene.rows, scene.shown
    points = scene.poses.subset(shown if scene.shows_poses else shown[:0])
    n_others = sum(map(len, scene.readings))
    codes = [
        GROUPS.index(name) + len(GROUPS) * bad
        for rows in parts
        for name, bad in zip(rows.group, rows.outlier, strict=True)
    ]
    arrays = {
        "joints": [rows.joints for rows in parts],
        "measured": [points.measured, np.full((n_others, 3), np.nan)],
        "place": [rows.anchors for rows in parts],
        "before": [rows.before for rows in parts],
        "after": [rows.after for rows in parts],
        "sigma": [points.sigma, np.full(n_others, np.nan)],
        "spread": [points.spread, np.full((n_others, 3), np.nan)],
        **{f"size_{state}": [in_unit(rows.sizes(state), rows.unit) for rows in scene.readings] for state in STATES},
        **{f"residual_{state}": [_components(errors, state) for errors in scene.readings] for state in STATES},
    }
    return {
        "n": len(codes),
        "n_points": len(points),
        "labels": [label for rows in parts for label in rows.labels],
        "targets": [target for rows in parts for target in rows.targets],
        "readings": [*points.readings.tolist(), *[1] * n_others],
        "group": _encode(np.array(codes, dtype=np.uint8)),
        "part": _encode(np.repeat(np.arange(len(parts)), [len(rows) for rows in parts]).astype(np.uint8)),
        "pose": _encode(np.concatenate([np.arange(len(points)), *scene.pose_of_row]).astype("<u4")),
        **{name: _encode(np.concatenate([np.zeros(0), *map(np.ravel, pieces)])) for name, pieces in arrays.items()},
    }


def _components(errors: ReadingErrors, state: str) -> FloatArray:
    """The first components of errors, in the unit of the part, (n, _MOST_AXES); NaN for missing ones."""
    components = np.full((len(errors), _MOST_AXES), np.nan)
    kept = in_unit(errors.residuals(state)[:, :_MOST_AXES], errors.unit)
    components[:, : kept.shape[1]] = kept
    return components


def _map(scene: ViewerScene, known: WorkspaceMap) -> dict[str, Any]:
    """The map, with a first enlargement that makes typical ellipsoids visible."""
    size = scene.view.size
    longest = np.linalg.norm(known.half_axes, axis=1).max(axis=1, initial=0.0)
    typical = float(np.median(longest)) if len(longest) else float("nan")
    return {
        "n": len(known.places),
        "beyond": int(np.sum(~known.is_inside)),
        "places": _encode(known.places.astype("<f4")),
        "error": _encode(known.error.astype("<f4")),
        "std": _encode(known.std.astype("<f4")),
        "within": _encode(known.is_inside.astype(np.uint8)),
        "ranges": {name: _span(values) for name, values in (("error", known.error), ("std", known.std))},
        "hull": _encode(known.hull.astype("<f4")),
        "centres": known.centres.tolist(),
        "half_axes": known.half_axes.tolist(),
        "factor": nice_factor(typical, _ELLIPSOID * size),
    }


def _span(values: FloatArray) -> list[float]:
    known = values[np.isfinite(values)]
    return [float(known.min()), max(float(known.max()), _EXACT)] if len(known) else [0.0, _EXACT]


def _posed_data(robot: PosedRobot) -> dict[str, Any]:
    return {
        "placements": robot.placements[:, :3].reshape(-1, 12).tolist(),
        "stretches": robot.stretches[:, :3].reshape(-1, 12).tolist(),
        "width": robot.values.shape[1],
        "values": _encode(robot.values.astype("<f4")),
        "root": None if robot.root is None else robot.root[:3].ravel().tolist(),
    }


def _encode(values: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()
