"""The text that `calib verify` prints, and the same content as data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.table import Table

from calib.core.base.contributions import Contributions, names_of
from calib.core.base.units import DISPLAY_UNIT, ERROR_UNIT, in_unit, millimetres, quantity_text
from calib.core.base.words import as_data, count_noun, listing, plain_text, text_table
from calib.core.fitting.error_sets import error_table
from calib.core.judging.acceptance import Acceptance
from calib.core.judging.acceptance_system import POWER, Change
from calib.core.judging.repeatability import CONDITIONS, IsoFigure, conditions
from calib.core.numerics.chances import FALSE_ALARM, UNLIKELY

_SHOWN, _WIDTH = 5, 120  # changes; characters of a line
_APART = 0.1  # a ratio and a ratio of millimetres that are nearer, on both sides of 1, do not contradict each other
_LARGER = "errors are larger than the calibration claims"
_PATTERN = "errors are no larger than the calibration claims, but have the pattern of a change of the robot"
_SENTENCES = {
    "agrees": "AGREES: the robot is as accurate as its calibration claims",
    "drifted": "DRIFTED: one change of the robot explains the readings",
    "noisier": "NOISIER: readings of one pose scatter more than expected, which no calibration can correct",
    "unlike poses": "UNLIKE POSES: {errors}. These poses lie elsewhere, where the model may be wrong although the robot"
    " has not changed; that alone could explain the readings",
    "too few readings": "TOO FEW READINGS: nothing contradicts the calibration, but only errors {detectable:.2g} times"
    " as large as expected would show (chance 90 %). Measure more poses",
    "calibrate again": "CALIBRATE AGAIN: the readings are off, and no single change explains this",
}


def text_report(
    acceptance: Acceptance, figures: Sequence[IsoFigure], missing: Sequence[str], contains: Contributions = frozenset()
) -> str:
    """Return an acceptance as text, with figures of ISO 9283 and reasons for missing ones.

    `contains` are contributions to the covariance of the calibration, as far as they are known.
    """
    data = acceptance.errors.data
    parts: list[str | Table] = [
        _SENTENCES[acceptance.verdict].format(
            detectable=acceptance.detectable, errors=_LARGER if acceptance.has_larger_errors else _PATTERN
        ),
        *_errors(acceptance),
        *_drift(acceptance),
    ]
    if acceptance.repeated_visits:
        parts.append(
            f"To settle it, measure {count_noun(len(acceptance.repeated_visits), 'pose')} of the calibration again:"
            f" {listing(acceptance.repeated_visits, ', ', len(acceptance.repeated_visits))}. A difference at these"
            " poses is a change of the robot"
        )
    if acceptance.outliers:
        parts.append(f"Left out, further off than noise explains: {listing(acceptance.outliers, '; ')}")
    parts += ["", _heading(acceptance.changes), _changes(acceptance.changes)]
    if contains:
        parts.append(
            f"Intervals count the noise of these readings; of the calibration: {', '.join(names_of(contains))}"
        )
    if figures:
        parts += [
            "",
            "ISO 9283 with 95 % intervals; commanded is what the calibrated robot predicts",
            _iso_table(figures),
        ]
    placing = (
        f"base and targets were placed by these readings, so AP has {acceptance.placed} degrees of freedom less;"
        " --same-setup keeps them"
    )
    lines = [placing, *missing] if figures and acceptance.placed else missing
    parts += [f"ISO 9283: {'; '.join(lines)}"] if lines else []
    stated = conditions(data.comments)
    parts += [f"{key}: {stated[key]}" for key in CONDITIONS if key in stated]
    return plain_text(parts, _WIDTH, wrap=True).rstrip()


def plan_report(changes: Sequence[Change], data: str, n: int) -> str:
    """Return as text the smallest changes that n poses of a file show."""
    title = f"Smallest changes that {count_noun(n, 'pose')} of {data} show with a chance of {100 * POWER:.0f} %"
    return plain_text([title, _changes(changes, with_values=False)], _WIDTH, wrap=True).rstrip()


def to_dict(
    acceptance: Acceptance, figures: Sequence[IsoFigure], missing: Sequence[str], contains: Contributions = frozenset()
) -> dict[str, object]:
    """Return an acceptance as data for JSON, in mm, deg, and mrad for angles of ISO 9283; unknown numbers are None."""
    data = acceptance.errors.data
    return as_data(
        {
            "verdict": acceptance.verdict,
            "n_poses": data.n_poses,
            "n_readings": data.n_readings,
            "degrees_of_freedom": acceptance.freedom,
            "placed": acceptance.placed,
            "ratio": acceptance.ratio,
            "ratio_low95": acceptance.low95,
            "ratio_high95": acceptance.high95,
            "ratio_detectable": acceptance.detectable,
            "p_value": acceptance.p_value,
            "p_drift": acceptance.p_drift,
            "p_rest": acceptance.p_rest,
            "promised_rms_mm": millimetres(acceptance.expected_rms),
            "promised_left_open_mm": millimetres(acceptance.calibration_rms),
            "promised_limit_mm": millimetres(acceptance.limit),
            "coverage_factor": acceptance.coverage_factor,
            "unlike_poses": acceptance.has_unlike_poses,
            "larger_errors": acceptance.has_larger_errors,
            "measure_again": list(acceptance.repeated_visits),
            "errors": error_table(
                acceptance.errors.errors("after", acceptance.errors.main_part.name), acceptance.errors.main_part
            ),
            "alike": list(acceptance.alternative_changes),
            "outliers": list(acceptance.outliers),
            "changes": changes_as_data(acceptance.changes),
            "contains": names_of(contains),
            "iso9283": list(map(_iso_as_data, figures)),
            "iso9283_missing": list(missing),
            "conditions": conditions(data.comments),
        }
    )


def changes_as_data(changes: Sequence[Change]) -> list[dict[str, object]]:
    """Return changes in mm and deg."""
    rows = []
    for change in changes:
        unit = DISPLAY_UNIT[change.dimension]
        sizes = {key: in_unit(getattr(change, key), unit) for key in ("value", "std", "visible")}
        chances = {"z": change.z, "p_value": change.p_value, "significant": change.significant}
        rows.append({"name": change.name, "unit": unit, **sizes, **chances})
    return rows


def _iso_as_data(iso: IsoFigure) -> dict[str, object]:
    unit = _iso_unit(iso)
    numbers = {key: in_unit(getattr(iso.figure, key), unit) for key in ("value", "low95", "high95")}
    return {"name": iso.name, "poses": iso.poses, "cycles": iso.cycles, "unit": unit, **numbers}


def _errors(acceptance: Acceptance) -> list[str]:
    """Lines on measured errors over expected ones: the ratio that the verdict uses, and both errors in millimetres."""
    allowance = "If the model's errors are common to these poses, r" if acceptance.has_unlike_poses else "R"
    lines = [
        f"{allowance}esiduals are {acceptance.ratio:.3f} times as large as expected, each direction weighted by its"
        " uncertainty."
        f" If the robot is unchanged, that is between {acceptance.low95:.2f} and {acceptance.high95:.2f} in 95 of 100"
        f" cases (p = {acceptance.p_value:.2g})"
    ]
    if acceptance.p_value > 1.0 - FALSE_ALARM / 2 and not acceptance.has_unlike_poses:
        lines.append(
            "That is less than chance explains: the calibration has used these readings, or they have less noise than"
            " those that it has used, or their poses lie close together and share the errors of the model"
        )
    data = acceptance.errors.data
    if np.isfinite(acceptance.expected_rms):
        table = error_table(acceptance.errors.errors("after", single=True))
        rms = table["rms"]
        assert isinstance(rms, float)
        promised, left_open = millimetres(acceptance.expected_rms), millimetres(acceptance.calibration_rms)
        noise = float(np.sqrt(max(promised**2 - left_open**2, 0.0)))
        with_it = " with such common errors" if acceptance.has_unlike_poses else ""
        lines.append(
            f"Position errors over {count_noun(data.n_poses, 'pose')}: {rms:.4f} mm RMS,"
            f" {table['max']:.4f} mm at worst; expected{with_it}: {promised:.4f} mm RMS (noise {noise:.4f} mm,"
            f" uncertainty of the calibration {left_open:.4f} mm); an unchanged robot"
            f" exceeds {quantity_text(acceptance.limit, 'mm', '.4f')} RMS in 1 of {1 / UNLIKELY:.0f} cases"
        )
        times = rms / promised
        if (times > 1.0) != (acceptance.ratio > 1.0) and abs(times - acceptance.ratio) > _APART:
            lines.append(
                "Judge by the ratio: most of this error lies in the few directions that the calibration leaves"
                " uncertain. There its size is chance, and it hides errors in the other directions"
            )
    return lines


def _drift(acceptance: Acceptance) -> list[str]:
    if not acceptance.changes:
        return []
    first = acceptance.changes[0]
    unit, half = DISPLAY_UNIT[first.dimension], acceptance.coverage_factor * first.std
    low, high = (in_unit(first.value + side * half, unit) for side in (-1.0, 1.0))
    size = f"{quantity_text(first.value, unit, '+.4f')} (standard deviation {in_unit(first.std, unit):.4f})"
    interval = f"95 %: {low:+.4f} to {high:+.4f}"
    if acceptance.p_drift >= FALSE_ALARM / 2:
        largest = f"the largest, of {first.name}, has p = {acceptance.p_drift:.2g}"
        allowance = "Allowing for these common errors, no" if acceptance.has_unlike_poses else "No"
        return [f"{allowance} change stands out: {largest} (significant below {FALSE_ALARM / 2:g})"]
    if acceptance.verdict != "drifted":
        rest = f"the rest has p = {acceptance.p_rest:.2g}"
        return [f"A change of {first.name} by {size}, {interval}, does not explain all of it: {rest}"]
    others = [name for name in acceptance.alternative_changes if name != first.name]
    chances = f"p = {acceptance.p_drift:.2g}, the rest {acceptance.p_rest:.2g}"
    lines = [f"{first.name} has changed by {size}, {interval}; {chances}"]
    if acceptance.ratio <= acceptance.high95:
        lines.append("Residuals are no larger than chance explains, but they have the pattern of this change")
    if others:
        lines.append(f"These readings cannot tell it from a change of {listing(others)}")
    return lines


def _heading(changes: Sequence[Change]) -> str:
    n = sum(change.significant for change in changes)
    which = f"{count_noun(n, 'is', 'are')} significant" if n else "none is significant"
    return f"Changes that were looked for, sorted by size over standard deviation; {which}"


def _changes(changes: Sequence[Change], *, with_values: bool = True) -> Table:
    left, heads = ("change of", "unit"), ("std", "detectable")
    table = text_table((*left, *(("found",) if with_values else ()), *heads), left, plain=True)
    for change in changes[:_SHOWN]:
        unit, sizes = DISPLAY_UNIT[change.dimension], (change.value, change.std, change.visible)
        numbers = [in_unit(x, unit) for x in (sizes if with_values else sizes[1:])]
        table.add_row(change.name, unit, *("" if np.isnan(x) else f"{x:.4f}" for x in numbers))
    return table


def _iso_table(figures: Sequence[IsoFigure]) -> Table:
    left = ("figure", "pose", "unit")
    table = text_table((*left, "cycles", "value", "low 95 %", "high 95 %"), left, plain=True)
    for iso in figures:
        unit, numbers = _iso_unit(iso), (iso.figure.value, iso.figure.low95, iso.figure.high95)
        table.add_row(iso.name, iso.poses, unit, str(iso.cycles), *(f"{in_unit(x, unit):.4f}" for x in numbers))
    return table


def _iso_unit(iso: IsoFigure) -> str:
    return ERROR_UNIT["angle" if iso.is_angle else "length"]
