"""Errors of the robot before and after a fit, part by part and set by set: as numbers and as text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
from rich.table import Table

from calib.core.base.units import ERROR_UNIT, in_unit
from calib.core.base.words import text_table
from calib.core.fitting.error_sets import STATES, ErrorSet, error_table
from calib.core.fitting.fit import errors_on
from calib.core.fitting.fitted import Fit
from calib.core.fitting.unseen_errors import validation_errors
from calib.core.instruments.kind import Part
from calib.core.judging.claim import Claim
from calib.core.results.sections.grid import Grid, GridColumn, GridNumber
from calib.core.robots.parametrisation import robot_in_use

NAMES = {"cross_validation": "left out in turn"}
"""Display names of sets of poses."""
_PLACED_ANEW = "validation, frame placed anew"
_JUDGED_BY = (_PLACED_ANEW, "validation", "left out in turn", "identification")


def shown_sets(fit: Fit) -> list[tuple[str, ErrorSet]]:
    """Return the sets by their display names.

    Validation poses whose frame moved have it placed anew. Where a description has the settings in use, the errors
    before are theirs. They were computed from the poses used, so the verdict compares with the last set: as designed.
    """
    placed = validation_errors(fit)
    sets = [
        (_PLACED_ANEW, placed)
        if errors is fit.validation and placed is not None and placed is not errors
        else (NAMES.get(name, name), errors)
        for name, errors in fit.error_sets.items()
    ]
    if fit.nominal.description.in_use:
        sets = [(name, before_in_use(fit, errors)) for name, errors in sets]
        sets.append(("as designed", fit.identification))
    return sets


def before_in_use(fit: Fit, errors: ErrorSet) -> ErrorSet:
    """Return a set of poses whose errors before are those of the settings in use, where a description has any."""
    if not fit.nominal.description.in_use:
        return errors
    return replace(errors, before=errors_on(robot_in_use(fit.placed), fit.robot, errors.data).before)


def judging_errors(fit: Fit) -> tuple[str, ErrorSet]:
    """Return the decisive errors, at unused poses if there are any, and the name of their poses."""
    sets = dict(shown_sets(fit))
    name = next(name for name in _JUDGED_BY if name in sets)
    return name, sets[name]


def accuracy_grids(fit: Fit) -> list[Grid]:
    """Return a table for each part that was read: each set before and after calibration."""
    sets: list[tuple[str, ErrorSet, Sequence[str]]]
    sets = [(name, error_set, STATES) for name, error_set in shown_sets(fit)]
    if fit.with_all is not None:
        sets.append(("fit pulled by outliers", fit.with_all.identification, STATES[1:]))
    parts = dict.fromkeys(part for _, error_set, _ in sets for _, part, _ in error_set.parts())
    return [_grid(part, sets) for part in parts]


def _grid(part: Part, sets: Sequence[tuple[str, ErrorSet, Sequence[str]]]) -> Grid:
    axes = part.axes if len(part.axes) > 1 else ()
    name, unit = part.name.capitalize(), ERROR_UNIT[part.dimension]
    columns = [GridColumn("", "poses", words=True), GridColumn("poses", "number")]
    columns += [GridColumn(head) for head in ("mean", "max", "RMS", "std", "95 %")]
    for axis in axes:
        columns += [GridColumn(f"|{axis}|", f"{axis} mean"), GridColumn(f"{axis} max", only_page=True)]
    rows, counting = list[tuple[str | GridNumber, ...]](), list[int]()
    for group, error_set, states in sets:
        for state in states:
            errors = error_set.errors(state, part.name)
            if len(errors):
                table: dict[str, Any] = error_table(errors, part)
                numbers = [table[key] for key in ("mean", "max", "rms", "std", "p95")]
                numbers += [table.get(axis, {}).get(key, np.nan) for axis in axes for key in ("mean", "max")]
                counting += [len(rows)] if state == "after" else []
                rows.append((f"{group}, {state}", str(error_set.data.n_poses), *map(GridNumber, numbers)))
    of_axes = f" ({', '.join(f'|{axis}|' for axis in axes)}: mean)" if axes else ""
    caption = f"{name} error [{unit}]" + ("; for each axis: mean and largest absolute value" if axes else "")
    return Grid(f"{name} error, {unit}{of_axes}", caption, tuple(columns), tuple(rows), tuple(counting))


def change_text(fit: Fit, claim: Claim | None) -> Table:
    """Return the error (RMS) before and after: a line for each part of each set of poses, and the claim of the fit."""
    heading = "error before -> after"
    table = text_table((heading, "poses", "RMS", "95 %", "largest"), (heading,), plain=True)
    parts = dict.fromkeys(part for _, errors in shown_sets(fit) for _, part, _ in errors.parts())
    for part in parts:
        for label, error_set in shown_sets(fit):
            errors = [error_set.errors(state, part.name) for state in STATES]
            if not all(len(sizes) for sizes in errors):
                continue
            tables = [error_table(sizes, part) for sizes in errors]
            pairs = [[cast(float, summary[key]) for summary in tables] for key in ("rms", "p95", "max")]
            cells = [" -> ".join(f"{value:.4f}" for value in pair) for pair in pairs]
            name = f"{part.name} [{ERROR_UNIT[part.dimension]}], {label}"
            table.add_row(name, str(error_set.data.n_poses), *cells)
    if claim is not None and np.isfinite(claim.at_measured_poses.limit95):
        measured, unit = claim.at_measured_poses, ERROR_UNIT[claim.at_measured_poses.dimension]
        sizes = (measured.before, measured.rms, measured.limit95)
        before, rms, limit95 = (f"{in_unit(size, unit):.4f}" for size in sizes)
        change = f"{before} -> {rms}" if np.isfinite(measured.before) else rms
        table.add_row(f"{measured.part} [{unit}], expected", "", change, limit95, "")
    return table
