"""The result of a fit as text for a terminal."""

from __future__ import annotations

import io

import numpy as np
from rich.console import Console
from rich.table import Table

from calib.fit import Fit
from calib.results import parameter_rows
from calib.validation import format_error


def text_report(fit: Fit, width: int = 110) -> str:
    """Return accuracy before and after, the parameters with their 95 % intervals, and what to know about them."""
    console = Console(file=io.StringIO(), width=width, color_system=None)
    console.print(f"Calibration of {fit.nominal.name} ({fit.nominal.path})", highlight=False)
    console.print(_accuracy(fit))
    console.print(_parameters(fit))
    for line in notes(fit):
        console.print(line, highlight=False, markup=False)
    stream = console.file
    assert isinstance(stream, io.StringIO)
    return stream.getvalue()


def notes(fit: Fit) -> list[str]:
    """Return what a reader must know beside the tables, one line each."""
    data = fit.identification.data
    sigma = 1e3 * fit.statistics.sigma
    lines = [
        f"{len(data)} poses, {data.n_rows} readings, {fit.statistics.freedom:.1f} degrees of freedom,"
        f" {fit.seconds:.3f} s",
        f"Noise found: {sigma:.4g} mm per axis"
        + (f" (stated: {1e3 * fit.sigma_stated:.4g} mm)" if fit.sigma_stated is not None else " (none was stated)"),
        f"All {fit.rank_all.n_columns} parameters: {fit.rank_all}",
        f"The {fit.rank.n_columns} free ones: {fit.rank}",
        "Observability (scaled columns): "
        + ", ".join(f"{name} {value:.3g}" for name, value in fit.observability.items()),
    ]
    if np.isfinite(data.repeatability()):
        lines.append(f"Repeatability of the repeats: {1e3 * data.repeatability():.4g} mm per axis")
    if fit.nominal.description.held:
        lines.append(f"Held at nominal: {', '.join(fit.nominal.description.held)}")
    if any(p.placement for p in fit.nominal.parameters):
        lines.append("'before' is with the base and the targets placed alone, the robot at nominal")
    limit = fit.nominal.description.singularity_limit
    sets = [fit.identification] + ([fit.validation] if fit.validation is not None else [])
    near = [found.data.labels[k] for found in sets for k in np.flatnonzero(found.singular_value < limit)]
    if near:
        lines.append(
            f"Warning: {len(near)} poses are near a singularity of the loops (smallest singular value below"
            f" {limit:g}): {', '.join(near[:5])}"
        )
    if data.ignored:
        lines.append(f"Columns that were not used: {', '.join(data.ignored)}")
    return lines


def _accuracy(fit: Fit) -> Table:
    table = Table(title="Position error [mm]", title_justify="left")
    for header in ("", "poses", "mean", "max", "rms", "std", "mean |x|", "mean |y|", "mean |z|"):
        table.add_column(header, justify="left" if not header else "right")
    sets = [("identification", fit.identification)]
    if fit.validation is not None:
        sets.append(("validation", fit.validation))
    for label, found in sets:
        for state, errors in found.table().items():
            table.add_row(f"{label}, {state}", str(len(found.data)), *format_error(errors))
    return table


def _parameters(fit: Fit) -> Table:
    table = Table(title="Parameters (value with 95 % interval)", title_justify="left")
    for header in ("name", "unit", "nominal", "value", "std", "low 95 %", "high 95 %", "status"):
        table.add_column(header, justify="left" if header in ("name", "unit", "status") else "right")
    for row in parameter_rows(fit):
        numbers = [
            f"{row[key]:.4f}" if np.isfinite(row[key]) else "-"  # type: ignore[call-overload]
            for key in ("nominal", "value", "std", "low95", "high95")
        ]
        table.add_row(str(row["name"]), str(row["unit"]), *numbers, str(row["status"]))
    return table
