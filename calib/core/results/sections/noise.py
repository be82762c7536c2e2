"""Scatter of readings: noise of each instrument, errors shared by readings of a pose, and repeats."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib.core.base.units import ERROR_UNIT, in_unit, quantity_text
from calib.core.base.words import count_noun
from calib.core.fitting.fitted import Fit
from calib.core.judging.repeatability import doubtful_repeats, repeat_table, repeatability


def instrument_blocks(fit: Fit) -> list[dict[str, object]]:
    """Return one block for each instrument, with errors and noise in the units of its parts."""
    blocks: list[dict[str, object]] = []
    sections = fit.nominal.description.instruments
    noise_of = {(noise.group.name, noise.group.part.name): noise for noise in fit.noise}
    tables = {label: errors.tables() for label, errors in fit.error_sets.items()}
    for instrument in fit.nominal.instruments:
        parts = []
        for part in instrument.parts:
            noise, unit = noise_of.get((instrument.group, part.name)), ERROR_UNIT[part.dimension]
            stated = None if noise is None or noise.stated is None else in_unit(noise.stated, unit)
            own = {
                label: table[instrument.name][part.name] for label, table in tables.items() if instrument.name in table
            }
            parts.append(
                {
                    "name": part.name,
                    "unit": unit,
                    "sigma": None if noise is None else in_unit(noise.sigma, unit),
                    "sigma_stated": stated,
                    "degrees_of_freedom": None if noise is None else noise.freedom,
                    "errors": own,
                }
            )
        n_readings = len(fit.identification.data.readings.get(instrument.name, ()))
        kind = sections[instrument.name].kind if sections else "position"  # without `instruments`, each target has one
        blocks.append({"name": instrument.name, "kind": kind, "n_readings": n_readings, "parts": parts})
    return blocks


@dataclass(frozen=True)
class NoiseFound:
    """Found noise of one reading: its quantity, unit, denominator and degrees of freedom."""

    of: str
    sigma: float
    stated: float | None
    unit: str
    per: str
    freedom: float


def noise_found(fit: Fit) -> list[NoiseFound]:
    """Return the noise of each group of rows; its quantity is named if there are several."""
    lines = []
    for noise in fit.noise:
        unit = ERROR_UNIT[noise.group.part.dimension]
        lines.append(
            NoiseFound(
                f" of {noise.group.name}, {noise.group.part.name}" if len(fit.noise) > 1 else "",
                in_unit(noise.sigma, unit),
                None if noise.stated is None else in_unit(noise.stated, unit),
                unit,
                " per axis" if len(noise.group.part.axes) > 1 else "",
                noise.freedom,
            )
        )
    return lines


def noise_lines(fit: Fit) -> list[str]:
    """Return the found noise of each group of rows, one line each."""
    lines = []
    for noise in noise_found(fit):
        stated = "none was stated" if noise.stated is None else f"stated: {noise.stated:.4g} {noise.unit}"
        lines.append(f"Noise found{noise.of}: {noise.sigma:.4g} {noise.unit}{noise.per} ({stated})")
    return lines


def scatter_lines(fit: Fit) -> list[str]:
    """Return errors shared by readings of a pose, and the test of the stated noise, one line each."""
    lines = []
    if fit.statistics.shared_scatter is not None:
        lines.append(
            "Readings of the same pose seem to share errors: poses scatter"
            f" {fit.statistics.shared_scatter.ratio:.2g} times as much as independent readings would. Intervals include"
            " it"
        )
    if fit.chi_square is not None:
        chi = fit.chi_square
        chance = f"chance of a larger value {chi.p_larger:.2g}, of a smaller one {chi.p_smaller:.2g}"
        lines.append(f"Chi-square of the stated noise: {chi.value:.1f} where {chi.freedom:.1f} is expected ({chance})")
    return lines


def repeat_lines(fit: Fit) -> list[str]:
    """Return the scatter of repeats, one line each; none without repeats."""
    lines = []
    scatter, _ = repeatability(fit.identification)
    if np.isfinite(scatter):
        lines.append(f"Scatter of the repeats: {quantity_text(scatter, 'mm', '.4g')} per axis")
    for name, errors in (("used", fit.identification), ("not used", fit.validation)):
        table = None if errors is None else repeat_table(errors)
        if errors is not None and table is not None:
            (before, after), again = table["pose_accuracy"].values(), table["pose_repeatability"]
            doubt = doubtful_repeats(errors)
            lines.append(
                f"ISO 9283-style, {count_noun(table['n_poses'], 'pose')} {name}: accuracy AP {before['mean']:.3f} mm"
                f" before, {after['mean']:.3f} after (largest {after['max']:.3f}); repeatability RP {again['mean']:.3f}"
                f" mm (largest {again['max']:.3f}){doubt and f'; {doubt}'}"
            )
    return lines
