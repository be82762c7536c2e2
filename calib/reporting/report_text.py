"""The result of a fit as text for a terminal, verdict first."""

from __future__ import annotations

import numpy as np
from rich.table import Table

from calib.data.repeats import repeats
from calib.identification.fitted import Fit
from calib.identification.reasons import Verdict
from calib.identification.validation import format_error
from calib.reporting.plain_text import plain_text
from calib.reporting.result_content import correlated, error_sets, parameter_rows
from calib.words import counted, listed, sentence


def text_report(fit: Fit, width: int = 120) -> str:
    """Return verdict, accuracy before and after, parameters with their 95 % intervals, and what to know about them."""
    parts: list[str | Table] = [
        f"Calibration of {fit.nominal.name} ({fit.nominal.path})",
        *verdict_lines(fit.verdict),
        _accuracy(fit),
        _parameters(fit),
        *notes(fit),
    ]
    return plain_text(parts, width, wrap=True)


def verdict_lines(verdict: Verdict) -> list[str]:
    """Return the verdict and its reasons, one line each."""
    if not verdict.reasons:
        return [f"Verdict: {verdict.grade}"]
    return [f"Verdict: {verdict.grade}", *(f"  {reason.grade}: {reason.text}" for reason in verdict.reasons)]


def notes(fit: Fit) -> list[str]:
    """Return what a reader must know beside the tables, one line each."""
    lines = [*_noise(fit), *_identifiability(fit), *_positions(fit), *_repeats(fit), *_options(fit)]
    if any(p.placement for p in fit.nominal.parameters):
        lines.append("'before' is with the base and the targets placed alone, the robot at nominal")
    if fit.identification.data.ignored:
        lines.append(f"Columns that were not used: {', '.join(fit.identification.data.ignored)}")
    return lines


def _noise(fit: Fit) -> list[str]:
    data, found = fit.identification.data, fit.statistics
    lines = [
        f"{counted(len(data), 'pose')}, {counted(data.n_rows, 'reading')}, {found.freedom:.1f} degrees of freedom,"
        f" {fit.seconds:.3f} s",
        f"Noise found: {1e3 * found.sigma:.4g} mm per axis"
        + (f" (stated: {1e3 * fit.sigma_stated:.4g} mm)" if fit.sigma_stated is not None else " (none was stated)"),
    ]
    if fit.chi_square is not None:
        chi = fit.chi_square
        chance = f"{chi.p_larger:.2g} of a larger, {chi.p_smaller:.2g} of a smaller value"
        lines.append(f"Chi-square of the stated noise: {chi.value:.1f} where {chi.freedom:.1f} is expected ({chance})")
    return lines


def _identifiability(fit: Fit) -> list[str]:
    lines = [
        *fit.determination.lines(),
        sentence(fit.determination.words()),
        "Observability (scaled columns): "
        + ", ".join(f"{name} {value:.3g}" for name, value in fit.observability.items()),
    ]
    pairs = [f"{row['a']} and {row['b']} ({row['correlation']:+.3f})" for row in correlated(fit)]
    if pairs:
        lines.append(f"Estimates that move together ({counted(len(pairs), 'pair')}): {listed(pairs)}")
    if fit.nominal.description.held:
        lines.append(f"Held at nominal: {', '.join(fit.nominal.description.held)}")
    return lines


def _positions(fit: Fit) -> list[str]:
    lines = []
    sets = [("poses used", fit.identification, fit.identification_uncertainty)]
    if fit.validation is not None and fit.validation_uncertainty is not None:
        sets.append(("poses not used", fit.validation, fit.validation_uncertainty))
    for name, errors, found in sets:
        summary = found.summary()
        lines.append(
            f"Predicted positions are known to {summary['mean']:.4f} mm on average, {summary['max']:.4f} mm at worst"
            f" (pose {errors.data.names[found.worst]}), over the {name}; from noise alone"
        )
    return lines


def _repeats(fit: Fit) -> list[str]:
    lines = []
    scatter = fit.identification.data.repeatability()
    if np.isfinite(scatter):
        lines.append(f"Scatter of the repeats: {1e3 * scatter:.4g} mm per axis")
    for name, errors in (("used", fit.identification), ("not used", fit.validation)):
        found = None if errors is None else repeats(errors.data, errors.before, errors.after)
        if found is not None:
            before, after, again = (
                1e3 * values for values in (found.accuracy_before, found.accuracy_after, found.repeatability)
            )
            lines.append(
                f"ISO 9283-style, {counted(len(found.poses), 'pose')} {name}: accuracy AP {before.mean():.3f} mm"
                f" before, {after.mean():.3f} after (largest {after.max():.3f}); repeatability RP {again.mean():.3f} mm"
                f" (largest {again.max():.3f})"
            )
    return lines


def _options(fit: Fit) -> list[str]:
    lines = []
    if fit.loss != "none":
        low = int(np.sum(fit.weights < 0.5))
        lines.append(
            f"Robust loss {fit.loss}: {low} of {fit.weights.size} points"
            f" {'counts' if low == 1 else 'count'} less than half"
        )
    if fit.with_all is not None:
        before = fit.with_all.identification.table()["after"]["rms"]
        after = fit.identification.table()["after"]["rms"]
        lines.append(
            f"Outliers left out: {listed([str(outlier) for outlier in fit.excluded], '; ')}. With them: RMS"
            f" {before:.4f} mm, noise {1e3 * fit.with_all.statistics.sigma:.4g} mm; without: RMS {after:.4f} mm"
        )
    if fit.starts is not None:
        minima = [f"RMS {1e3 * m.rms:.4f} mm from {m.count}" for m in fit.starts.minima]
        failed = f", {fit.starts.failed} failed" if fit.starts.failed else ""
        lines.append(f"{counted(fit.starts.total, 'start')} (seed {fit.starts.seed}): {listed(minima, '; ')}{failed}")
    if fit.folds is not None:
        rms = ", ".join(f"{1e3 * value:.4f}" for value in fit.folds.rms)
        lines.append(f"Cross-validation in {fit.folds.count} folds (seed {fit.folds.seed}): RMS of each {rms} mm")
    return lines


def _accuracy(fit: Fit) -> Table:
    table = Table(title="Position error, mm (|x|, |y|, |z|: mean)", title_justify="left")
    for header in ("", "poses", "mean", "max", "rms", "std", "95 %", "|x|", "|y|", "|z|"):
        table.add_column(header, justify="left" if not header else "right")
    names = {"cross_validation": "left out in turns"}
    for label, found in error_sets(fit):
        for state, errors in found.table().items():
            table.add_row(f"{names.get(label, label)}, {state}", str(len(found.data)), *format_error(errors))
    if fit.with_all is not None:
        errors = fit.with_all.identification.table()["after"]
        table.add_row("with outliers, after", str(len(fit.with_all.identification.data)), *format_error(errors))
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
