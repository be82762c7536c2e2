"""Tables of the measurement from both sides, and their findings in words."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray, IntArray
from calib.core.base.units import millimetres, quantity_text
from calib.core.base.words import count_noun
from medrue.both_sides import EXTENDED, PAPER, RAIL, WAYS, BothSides, Way
from medrue.ranking import standard_error
from medrue.result_tables import Cell, ResultTable, TableColumn
from medrue.study import STATISTICS, summary
from medrue.tracker import REPEATS, SIGMA

NOISE = SIGMA / np.sqrt(REPEATS)
"""Noise of a coordinate that the tracker reads, its readings averaged [m]."""
GOAL = 6e-5
"""Goal for the mean x error of the extended model [m]."""
NEAR_NOISE = 1.2
"""An error counts as noise if its root mean square is at most this many times that of the noise."""
BOTH_SIDES_NOTE = (
    "both sides: the 84 poses of O1 and all others are approached from both sides, and the rail has two small errors"
    " that no model has; first with the paper's model, then with the extended one"
)
_DECIDED = 0.5  # the data decide about a parameter if this part of its expected error, or less, is left


def both_sides_error_columns(both_sides: BothSides) -> list[TableColumn]:
    """Return Table IV's columns of the paper's poses, approached from both sides."""
    columns = []
    for header, way in (("O1, both sides", PAPER), ("O1, both sides, extended", EXTENDED)):
        draws = millimetres(summary(np.linalg.norm(both_sides.errors(way, 0), axis=2)))
        cells: list[Cell] = []
        for of_draws in draws.T[: len(STATISTICS)]:
            cells += [of_draws[0], of_draws.mean(), float(standard_error(of_draws)), None]
        columns.append(TableColumn(header, cells))
    return columns


def component_columns(both_sides: BothSides) -> list[TableColumn]:
    """Return Table V's columns of the first draw, approached from both sides."""
    columns = []
    for header, way in (("both sides", PAPER), ("both sides, extended", EXTENDED)):
        for axis, values in zip("xyz", np.abs(both_sides.errors(way, 0)[0].T), strict=True):
            ours = millimetres(summary(values))[: len(STATISTICS)]
            columns.append(TableColumn(f"{header} {axis}", [cell for value in ours for cell in (value, None)]))
    return columns


def both_sides_tables(both_sides: BothSides) -> tuple[ResultTable, ...]:
    """Return the tables of the measurement from both sides alone."""
    return pose_count_table(both_sides), extended_parameter_table(both_sides)


def pose_count_table(both_sides: BothSides) -> ResultTable:
    """Error along x that remains, by the number of poses and the way to calibrate."""
    names = (f"{len(both_sides.sets[0].chosen)}, the paper's", *(pose_set.name for pose_set in both_sides.sets[1:]))
    columns = [TableColumn("poses", names)]
    for way in WAYS:
        mean = millimetres(mean_x(both_sides, way).mean(axis=0))
        columns.append(TableColumn(f"{way.name}, mean x error [mm]", mean, 4))
    draws, rms = mean_x(both_sides, EXTENDED), component_rms(both_sides, EXTENDED).T
    if len(draws) > 1:
        columns.append(TableColumn(f"{EXTENDED.name}, its standard error [mm]", millimetres(standard_error(draws)), 4))
    for axis, values in zip("xyz", rms, strict=True):
        columns.append(TableColumn(f"{EXTENDED.name}, RMS {axis} [mm]", millimetres(values), 4))
    columns.append(TableColumn(f"{EXTENDED.name}, RMS x over the noise's", rms[0] / NOISE, 4))
    return ResultTable(
        "pose_count",
        "What remains along x after calibration, by the number of poses",
        tuple(columns),
        (
            "poses are chosen by O1 of the extended model, and for the paper's model by its own O1",
            f"simulated; {count_noun(len(both_sides.draws), 'draw')}; at all other poses from both sides, with the"
            f" tracker's noise, which alone has an RMS of {quantity_text(NOISE, 'mm', '.4f')} and a mean magnitude of"
            f" {quantity_text(NOISE * np.sqrt(2 / np.pi), 'mm', '.4f')}",
            "both sides: two visits of each pose; either side: one visit, from a side that chance decides; one side:"
            " one visit, in the positive direction; empty: too few readings for the model",
            f"{RAIL}; the last two are in no model",
        ),
    )


def extended_parameter_table(both_sides: BothSides) -> ResultTable:
    """Parameters that the extended model has and the paper's lacks, if the readings determine them."""
    draw, parameters, terms = both_sides.draws[0], both_sides.extended.parameters, both_sides.extended.coefficients
    expected = parameters.sigma_si
    tilts = tuple(f"{joint.name}.{tilt}" for joint in both_sides.extended.urdf.joints for tilt in ("ry", "rz"))
    lacking = [k >= terms.start or (p.name in tilts and p.name[:-3] != "base_origin") for k, p in enumerate(parameters)]
    shown = np.flatnonzero(lacking & (draw.std < _DECIDED * expected))
    numbers = {"expected error": expected, "actual": draw.actual, "identified": draw.values, "std": draw.std}
    return ResultTable(
        "extended",
        "Tilts and errors of the rail: the extended model finds them from the 84 poses of O1, reached from both sides",
        (
            TableColumn("parameter", [parameters[k].name for k in shown]),
            TableColumn("unit", [parameters[k].unit for k in shown]),
            *(TableColumn(name, (values * parameters.per_si)[shown], 4) for name, values in numbers.items()),
        ),
        (
            "simulated; first draw; only parameters whose std is less than half of the expected error: the others rest"
            " on their priors",
            "the actual value is half of the backlash at the rail's ends; a model without wear finds the average over"
            f" the stroke, which is {200 / np.pi * RAIL.wear:.1f} % larger",
        ),
    )


def both_sides_findings(both_sides: BothSides) -> tuple[str, ...]:
    """Say in words what the tables show."""
    paper, extended = (_length(mean_x(both_sides, way)[:, 0].mean()) for way in (PAPER, EXTENDED))
    rms, noise = _length(component_rms(both_sides, EXTENDED)[0, 0]), millimetres(NOISE)
    return (
        f"From both sides at the same {len(both_sides.sets[0].chosen)} poses,"
        f" {count_noun(len(both_sides.extended.parameters), 'parameter')} (geometry in all six components, and the"
        f" screw's lead, turns and backlash) leave a mean x error of {extended}; the paper's model leaves {paper}. The"
        f" tracker's noise alone is {noise * np.sqrt(2 / np.pi):.3f} mm (RMS {rms} and {noise:.3f} mm).",
        _needed_poses(both_sides),
    )


def _needed_poses(both_sides: BothSides) -> str:
    """How many poses each way needs, and which ways do not get there with any number of them."""
    counts = np.array([len(pose_set.chosen) for pose_set in both_sides.sets[1:]])
    means = {way.name: mean_x(both_sides, way)[:, 1:].mean(axis=0) for way in WAYS}
    near = {way.name: component_rms(both_sides, way)[1:, 0] <= NEAR_NOISE * NOISE for way in WAYS}
    never = [f"{name} ({_length(mean[-1])})" for name, mean in means.items() if not np.any(mean <= GOAL)]
    return (
        f"Poses needed, of the numbers tried, for a mean x error of {quantity_text(GOAL, 'mm', 'g')}:"
        f" {_least_poses(counts, {name: mean <= GOAL for name, mean in means.items()})}; for an RMS x error within"
        f" {100 * (NEAR_NOISE - 1):.0f} % of the noise: {_least_poses(counts, near)}."
        + (f" Not even {counts[-1]} are enough for {', '.join(never)}." if never else "")
    )


def _least_poses(counts: IntArray, reached: Mapping[str, BoolArray]) -> str:
    """The least number of poses that is enough, for each way that has one."""
    enough = [f"{counts[which].min()} ({name})" for name, which in reached.items() if np.any(which)]
    return ", ".join(enough) or f"more than {counts[-1]}"


def mean_x(both_sides: BothSides, way: Way) -> FloatArray:
    """Return the mean magnitude of the error along x, (n_draws, n_sets) [m]; NaN where a way is not possible."""
    return np.array([np.abs(both_sides.errors(way, s)[:, :, 0]).mean(axis=1) for s in range(len(both_sides.sets))]).T


def component_rms(both_sides: BothSides, way: Way) -> FloatArray:
    """Return the RMS error along each axis over all draws, (n_sets, 3) [m]; NaN where a way is not possible."""
    return np.array(
        [np.sqrt(np.mean(both_sides.errors(way, s) ** 2, axis=(0, 1))) for s in range(len(both_sides.sets))]
    )


def _length(value: float) -> str:
    """A length [m] in words."""
    return "no answer" if np.isnan(value) else f"{quantity_text(value, 'mm', '.3f')}"
