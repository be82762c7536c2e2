"""What `calib verify` prints, and the same as data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.table import Table

from calib.identification.acceptance import Acceptance
from calib.identification.errors_found import error_table
from calib.identification.promise import FALSE_ALARM, POWER, Change
from calib.identification.repeats import CONDITIONS, IsoFigure, conditions
from calib.units import DISPLAY_UNIT, ERROR_UNIT, PER_SI, Dimension, error_scale, millimetres
from calib.words import counted, listed, plain_text

_SHOWN = 8
_SAID = {
    "agrees": "AGREES: the robot is as accurate as its calibration promised",
    "drifted": "DRIFTED: one change explains what the readings are off",
    "noisier": "NOISIER: readings of one pose scatter more than promised, which no calibration cures",
    "calibrate again": "CALIBRATE AGAIN: the readings are off, and no single change explains it",
}


def text_report(found: Acceptance, figures: Sequence[IsoFigure], missing: Sequence[str], width: int = 110) -> str:
    """Return everything as text.

    Args:
        found: The judgement.
        figures: Of ISO 9283.
        missing: What they lack.
        width: Of the tables, in characters.
    """
    data = found.errors.data
    parts: list[str | Table] = [_SAID[found.verdict], *_errors(found), *_drift(found)]
    if found.outliers:
        parts.append(f"Left out, further off than noise explains: {listed(found.outliers, '; ')}")
    parts += ["", "Changes looked for, the most significant first", _changes(found.changes)]
    if figures:
        parts += [
            "",
            "ISO 9283 with 95 % intervals; commanded is what the calibrated robot predicts",
            _iso_table(figures),
        ]
    lines = [_said_of_placing(found), *missing] if figures and found.placed else missing
    parts += [f"ISO 9283: {line}" for line in lines]
    stated = conditions(data.comments)
    parts += [f"{key}: {stated[key]}" for key in CONDITIONS if key in stated]
    return plain_text(parts, width).rstrip()


def plan_report(changes: Sequence[Change], data: str, n: int, width: int = 110) -> str:
    """Return the smallest changes that n poses of a file will show as text."""
    title = f"Smallest changes that {counted(n, 'pose')} of {data} show with a chance of {POWER:.0%}"
    return plain_text([title, _changes(changes)], width).rstrip()


def to_dict(found: Acceptance, figures: Sequence[IsoFigure], missing: Sequence[str]) -> dict[str, object]:
    """Return everything as data for JSON, in mm, deg, and mrad for angles of ISO 9283; unknown numbers are None."""
    data = found.errors.data
    return {
        "verdict": found.verdict,
        "n_poses": data.n_poses,
        "n_readings": data.n_readings,
        "degrees_of_freedom": found.freedom,
        "placed": found.placed,
        "ratio": found.ratio,
        "ratio_low95": found.low95,
        "ratio_high95": found.high95,
        "p_value": found.p_value,
        "p_drift": found.p_drift,
        "p_rest": found.p_rest,
        "promised_rms_mm": _finite(millimetres(found.promised)),
        "errors": error_table(found.errors.errors("after", found.errors.main_part.name), found.errors.main_part),
        "alike": list(found.alike),
        "outliers": list(found.outliers),
        "changes": changes_as_data(found.changes),
        "iso9283": [
            {
                "name": one.name,
                "poses": one.poses,
                "cycles": one.cycles,
                "unit": _iso_unit(one)[0],
                **{key: getattr(one.figure, key) * _iso_unit(one)[1] for key in ("value", "low95", "high95")},
            }
            for one in figures
        ],
        "iso9283_missing": list(missing),
        "conditions": conditions(data.comments),
    }


def changes_as_data(changes: Sequence[Change]) -> list[dict[str, object]]:
    """Return changes in mm and deg."""
    return [
        {
            "name": one.name,
            "unit": _unit(one)[0],
            "value": _finite(one.value * _unit(one)[1]),
            "std": one.std * _unit(one)[1],
            "z": _finite(one.z),
            "visible": one.visible * _unit(one)[1],
        }
        for one in changes
    ]


def _errors(found: Acceptance) -> list[str]:
    """What was measured beside what was promised."""
    lines = [
        f"Residuals are {found.ratio:.3f} times as large as promised; {found.low95:.3f} to {found.high95:.3f} in 95 of"
        f" 100 cases ({found.freedom} degrees of freedom, p = {found.p_value:.3g})"
    ]
    data = found.errors.data
    if np.isfinite(found.promised):
        table = error_table(found.errors.errors("after", single=True))
        lines.append(
            f"Position errors over {counted(data.n_poses, 'pose')}: {table['rms']:.4f} mm rms (promised:"
            f" {millimetres(found.promised):.4f} mm), {table['mean']:.4f} mm mean, {table['max']:.4f} mm at worst"
        )
    return lines


def _drift(found: Acceptance) -> list[str]:
    if not found.changes:
        return []
    first = found.changes[0]
    unit, scale = _unit(first)
    size = f"{first.value * scale:+.4f} {unit} (standard deviation {first.std * scale:.4f})"
    if found.p_drift >= FALSE_ALARM / 2:
        largest = f"the largest, of {first.name}, has p = {found.p_drift:.2g} ({FALSE_ALARM / 2:g} counts)"
        return [f"No change stands out: {largest}"]
    if found.verdict != "drifted":
        return [f"{first.name} alone would have changed by {size}, but of the rest p = {found.p_rest:.2g}"]
    others = [name for name in found.alike if name != first.name]
    lines = [f"{first.name} has changed by {size}; p = {found.p_drift:.2g}, of the rest {found.p_rest:.2g}"]
    if others:
        lines.append(f"These readings cannot tell it from a change of {listed(others)}")
    return lines


def _said_of_placing(found: Acceptance) -> str:
    return (
        f"base and targets were placed by these readings, which takes {found.placed} degrees of freedom out of AP;"
        " --same-setup leaves them in"
    )


def _changes(changes: Sequence[Change]) -> Table:
    table = Table()
    for header in ("change of", "unit"):
        table.add_column(header)
    for header in ("found", "std", "seen from"):
        table.add_column(header, justify="right")
    for one in changes[:_SHOWN]:
        unit, scale = _unit(one)
        numbers = [x * scale for x in (one.value, one.std, one.visible)]
        table.add_row(one.name, unit, *("" if np.isnan(x) else f"{x:.4f}" for x in numbers))
    return table


def _iso_table(figures: Sequence[IsoFigure]) -> Table:
    table = Table()
    for header in ("figure", "pose", "unit"):
        table.add_column(header)
    for header in ("cycles", "value", "low 95 %", "high 95 %"):
        table.add_column(header, justify="right")
    for one in figures:
        unit, scale = _iso_unit(one)
        numbers = (one.figure.value, one.figure.low95, one.figure.high95)
        table.add_row(one.name, one.poses, unit, str(one.cycles), *(f"{x * scale:.4f}" for x in numbers))
    return table


def _unit(one: Change) -> tuple[str, float]:
    unit = DISPLAY_UNIT[one.dimension]
    return unit, PER_SI[one.dimension][unit]


def _iso_unit(one: IsoFigure) -> tuple[str, float]:
    dimension: Dimension = "angle" if one.is_angle else "length"
    return ERROR_UNIT[dimension], error_scale(dimension)


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
