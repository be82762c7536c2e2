"""Answers of a report: the main error, the tolerance, the worst pose and joint, and the outliers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib import Fit
from calib.core.base.arrays import FloatArray
from calib.core.base.units import ERROR_UNIT, millimetres, quantity
from calib.core.base.words import significant
from calib.core.fitting.error_sets import STATES, ErrorSet, error_table
from calib.core.instruments.kind import Part
from calib.core.judging import findings
from calib.core.judging.error_budget import NOISE, PLACES, REST, UNEXPLAINED, CauseShare, ErrorBudget
from calib.core.judging.verdict import judge
from calib.core.results.sections.accuracy import judging_errors
from calib.core.results.sections.grid import Grid, GridColumn, GridNumber
from calib.core.results.sections.outliers import LEFT_OUT, excluded_rows, outlier_rows
from viz.pose_sources import fitted_set
from viz.poses import IDENTIFICATION, VALIDATION, PoseTable, average_poses
from viz.remarks import tolerance

MOST = 50
"""Largest number of outliers on a page."""


@dataclass(frozen=True)
class Headline:
    """The error of the headline: part, unit, set of poses and their number, values before and after."""

    part: Part
    unit: str
    group: str
    poses: int
    before: dict[str, Any]
    after: dict[str, Any]

    @staticmethod
    def from_fit(fit: Fit) -> Headline:
        """Return the headline of the main part."""
        group, errors = judging_errors(fit)
        part = errors.main_part
        before, after = (error_table(errors.errors(state, part.name), part) for state in STATES)
        return Headline(part, ERROR_UNIT[part.dimension], group, errors.data.n_poses, before, after)


@dataclass(frozen=True)
class Tolerance:
    """The answer whether the robot keeps its tolerance: tolerance, answer, grade, and reason."""

    text: str
    answer: str
    grade: str
    why: str


def tolerance_of(fit: Fit) -> Tolerance | None:
    """Compare the error that 95 of 100 poses like those measured stay below with the tolerance; None without one.

    The calibration's claim on positions decides. Without such a claim, the answer is open.
    """
    text = tolerance(fit)
    if not text:
        return None
    limit = quantity(text, "length", "tolerance")  # valid, since it was checked when the file was read
    claim = judge(fit).claim
    if claim is None or not claim.at_measured_poses.is_position or not np.isfinite(claim.at_measured_poses.limit95):
        return Tolerance(text, "not judged", "CHECK", "These measurements do not tell how far positions are off.")
    within = (
        f"95 of 100 positions are within {claim.at_measured_poses.in_unit(claim.at_measured_poses.limit95)},"
        f" {claim.region}"
    )
    if not claim.holds:
        return Tolerance(text, "not met", "FAIL", f"Poses that were not used are further off than claimed ({within}).")
    met = claim.at_measured_poses.limit95 <= limit
    return Tolerance(text, "met" if met else "not met", "PASS" if met else "FAIL", f"{within}.")


def worst(fit: Fit) -> str:
    """Return the pose with the largest error after calibration, and its place."""
    group, errors = judging_errors(fit)
    used = VALIDATION if group.startswith(VALIDATION) else IDENTIFICATION
    table = average_poses(fitted_set(fit, used, errors).table())
    length = np.linalg.norm(table.error("after"), axis=1)
    if not errors.main_part.is_position or not np.any(np.isfinite(length)):  # no points were read
        return _worst_reading(errors)
    row = int(np.nanargmax(length))
    shown = millimetres(table.measured[row])
    place = ", ".join(f"{axis} {_whole(value)}" for axis, value in zip("xyz", shown, strict=True))
    point = f", point {table.targets[row]}" if len(set(table.targets)) > 1 else ""
    outlier = " (an outlier)" if table.outlier[row] else ""
    return f"pose {table.labels[row]}{outlier}{point}, at {place} mm"


def worst_joints(budget: ErrorBudget) -> list[CauseShare]:
    """Return the joints' shares of the error before calibration, the largest first; see `findings.joint_budget`."""
    joints = [share for share in budget.shares if share.cause not in (PLACES, NOISE, UNEXPLAINED, REST)]
    return sorted(joints, key=lambda share: -share.mean_square)


def worst_joint(fit: Fit) -> str:
    """Return the joint with the largest share of the error before calibration, and the next; empty without a budget.

    Where the 95 % interval of the largest share reaches down to the next, a sentence says that either may be worst.
    """
    budget = findings.joint_budget(fit)
    joints = [] if budget is None else [share for share in worst_joints(budget) if share.mean_square > 0]
    if budget is None or not joints:
        return ""
    percent = [100 * np.array([one.mean_square, 1.96 * one.std]) / budget.before for one in joints[:2]]
    words = [
        f"{one.cause} {significant(part, 2)} % ± {significant(half, 2)} %"
        for one, (part, half) in zip(joints, percent, strict=False)
    ]
    lowest, following = percent[0][0] - percent[0][1], f"; next {words[1]}" if words[1:] else ""
    doubt = ""
    if words[1:] and lowest <= percent[1][0]:
        doubt = f". The interval of {joints[0].cause} contains the share of {joints[1].cause}: either may be the worst"
    elif lowest <= 0:
        doubt = f". The interval of {joints[0].cause} contains zero: this joint may have no error"
    return f"{words[0]} (95 %) of the squared error before calibration{following}{doubt}"


def _whole(value: float) -> str:
    """A whole number with a minus sign that is no hyphen; zero has no sign."""
    return f"{round(float(value))}".replace("-", "−")


def _worst_reading(errors: ErrorSet) -> str:
    """The reading with the largest error of the main part after calibration."""
    sizes = {
        instrument.name: np.nansum(errors.after[instrument.name][:, rows] ** 2, axis=1)
        for instrument, part, rows in errors.parts()
        if part.name == errors.main_part.name
    }
    name = max(sizes, key=lambda key: float(np.max(sizes[key])))
    visit = int(errors.data.readings[name].visits[int(np.argmax(sizes[name]))])
    return f"pose {errors.data.names[visit]}{f', {name}' if len(sizes) > 1 else ''}"


def extent(table: PoseTable) -> str:
    """Return the box of measured points in words [mm]; empty without points."""
    fitted = np.isin(np.array(table.group), (IDENTIFICATION, VALIDATION))
    points: FloatArray = millimetres(table.measured[fitted & np.isfinite(table.measured).all(axis=1)])
    if not len(points):
        return ""
    ranges = zip("xyz", points.min(axis=0), points.max(axis=0), strict=True)
    return ", ".join(f"{axis} {_whole(low)} to {_whole(high)}" for axis, low, high in ranges) + " mm"


@dataclass(frozen=True)
class OutlierGrid:
    """The outliers as a table of at most `MOST`, their number, and whether all are points."""

    shown: Grid
    count: int
    points: bool


def outlier_grid(fit: Fit) -> OutlierGrid:
    """Return the outliers as a table, with those that were left out first."""
    rows = [row | {"set": LEFT_OUT} for row in excluded_rows(fit)] + outlier_rows(fit)
    points = all(part.is_position for instrument in fit.nominal.instruments for part in instrument.parts)
    columns = (
        GridColumn("pose"),
        GridColumn("set", words=True),
        GridColumn("point" if points else "instrument", words=True),
        GridColumn("distance [mm]" if points else "error"),
        GridColumn("over expected"),
        GridColumn("source", words=True),
    )
    cells = tuple(_cells(row, points) for row in rows[:MOST])
    return OutlierGrid(Grid("", "", columns, cells), len(rows), points)


def _cells(row: dict[str, Any], points: bool) -> tuple[str | GridNumber, ...]:
    together = f" (all {row['together']} readings there)" if row["together"] else ""
    of = " ".join(filter(None, (row["target"], row["looked_at"])))
    size = GridNumber(row["distance"]) if points else str(row["size"])
    source = row["where"].removesuffix(f" (pose {row['pose']})")
    over_noise = GridNumber(row["over_noise"], page_decimals=1)
    return (str(row["pose"]), row["set"], f"{of}{together}", size, over_noise, source)
