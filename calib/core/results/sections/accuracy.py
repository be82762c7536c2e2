"""How far off the robot is before and after a fit, part by part and set by set: the numbers, and as text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
from rich.table import Table

from calib.core.base.units import ERROR_UNIT, error_scale
from calib.core.base.words import text_table
from calib.core.fitting.error_sets import STATES, ErrorSet, error_table, format_error
from calib.core.fitting.fitted import Fit
from calib.core.instruments.kind import Part
from calib.core.judging.claim import Claim

NAMES = {"cross_validation": "left out in turn"}
"""Sets of poses that people know by another name."""


@dataclass(frozen=True)
class AccuracyLine:
    """One line of an accuracy table; numbers as `error_table` gives them."""

    group: str
    state: str
    poses: int
    errors: dict[str, object]


@dataclass(frozen=True)
class AccuracyTable:
    """Errors of one part of the readings, in its unit of errors.

    Attributes:
        part: The part.
        unit: Unit of all numbers.
        lines: Each set before and after calibration.
    """

    part: Part
    unit: str
    lines: tuple[AccuracyLine, ...]


def error_sets(fit: Fit) -> list[tuple[str, ErrorSet]]:
    """Return every set of poses with errors, by name."""
    sets = [("identification", fit.identification)]
    if fit.validation is not None:
        sets.append(("validation", fit.validation))
    if fit.folds is not None:
        sets.append(("cross_validation", fit.folds.errors))
    return sets


def accuracy(fit: Fit) -> list[AccuracyTable]:
    """Return a table for each part that was read: each set before and after calibration."""
    sets: list[tuple[str, ErrorSet, tuple[str, ...]]]
    sets = [(NAMES.get(name, name), error_set, STATES) for name, error_set in error_sets(fit)]
    if fit.with_all is not None:
        sets.append(("with outliers", fit.with_all.identification, STATES[1:]))
    parts = dict.fromkeys(part for _, error_set, _ in sets for _, part, _ in error_set.parts())
    tables = []
    for part in parts:
        lines = []
        for group, error_set, states in sets:
            for state in states:
                errors = error_set.errors(state, part.name)
                if len(errors):
                    lines.append(AccuracyLine(group, state, error_set.data.n_poses, error_table(errors, part)))
        tables.append(AccuracyTable(part, ERROR_UNIT[part.dimension], tuple(lines)))
    return tables


def accuracy_text(fit: Fit) -> list[Table]:
    """Return one table for each part that was read."""
    tables = []
    for part_accuracy in accuracy(fit):
        axes = [f"|{axis}|" for axis in part_accuracy.part.axes]
        title = f"{part_accuracy.part.name.capitalize()} error, {part_accuracy.unit} ({', '.join(axes)}: mean)"
        table = text_table(("", "poses", "mean", "max", "rms", "std", "95 %", *axes), title=title)
        for line in part_accuracy.lines:
            table.add_row(f"{line.group}, {line.state}", str(line.poses), *format_error(line.errors))
        tables.append(table)
    return tables


def change_text(fit: Fit, claim: Claim | None) -> Table:
    """Return the error (RMS) before and after: a line for each part of each set of poses, and what the fit claims."""
    heading = "error before -> after"
    table = text_table((heading, "poses", "RMS", "95 %", "largest"), (heading,), plain=True)
    parts = dict.fromkeys(part for _, errors in error_sets(fit) for _, part, _ in errors.parts())
    for part in parts:
        for label, error_set in error_sets(fit):
            errors = [error_set.errors(state, part.name) for state in STATES]
            if not all(len(sizes) for sizes in errors):
                continue
            tables = [error_table(sizes, part) for sizes in errors]
            pairs = [[cast(float, summary[key]) for summary in tables] for key in ("rms", "p95", "max")]
            cells = [" -> ".join(f"{value:.4f}" for value in pair) for pair in pairs]
            name = f"{part.name} [{ERROR_UNIT[part.dimension]}], {NAMES.get(label, label)}"
            table.add_row(name, str(error_set.data.n_poses), *cells)
    if claim is not None and np.isfinite(claim.told.limit95):
        told, scale = claim.told, error_scale(claim.told.dimension)
        before = f"{scale * told.before:.4f} -> " if np.isfinite(told.before) else ""
        name = f"{told.part} [{ERROR_UNIT[told.dimension]}], expected"
        table.add_row(name, "", f"{before}{scale * told.rms:.4f}", f"{scale * told.limit95:.4f}", "")
    return table
