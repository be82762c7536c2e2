"""Plots of the results of a fit: its parameters, the causes of the error, and the errors of files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from calib import Fit
from calib.core.base.arrays import FloatArray
from calib.core.fitting.estimates import Estimate
from calib.core.judging import findings
from calib.core.results.sections.budget import budget_table
from calib.core.results.sections.files_held import files_grid
from calib.core.results.sections.grid import GridNumber
from viz.charts import COLOURS, Chart, axis, layer, panel
from viz.report_tables import worst_joints

_LINE, _LINES = 20, 19  # height of a line with a name [px], and most lines: half a page of paper


def forest(
    names: Sequence[str],
    groups: Sequence[tuple[str, str, Any, Any, list[str]]],
    label: str,
    band: tuple[str, float] | None = None,
) -> tuple[dict[str, Any], ...]:
    """Return panels with a line for each name: marks with intervals, on the same scale in all.

    Args:
        names: Names, the first at the top.
        groups: For each set of marks its label, its colour, values (n,), half intervals (n,), NaN if unknown, and
            hover texts.
        label: Label of the axis of values.
        band: Legend and half width of a band around zero, or None.
    """
    reach = max(np.nanmax(np.abs(values) + np.nan_to_num(half), initial=0.0) for _, _, values, half, _ in groups)
    end = 1.05 * max(float(reach), band[1] if band else 0.0, 1e-9)
    most = max(1, _LINES // max(1, (len(groups) + 1) // 2))
    each = -(-len(names) // -(-len(names) // most)) if names else 1  # pieces of about one size
    pieces = [slice(first, first + each) for first in range(0, len(names), each)]
    return tuple(_piece(names[piece], [
        (called, colour, values[piece], half[piece], texts[piece]) for called, colour, values, half, texts in groups
    ], axis(label, ends=[-end, end]), band) for piece in pieces)  # fmt: skip


def _piece(names: Sequence[str], groups: Sequence[Any], x: Any, band: tuple[str, float] | None) -> dict[str, Any]:
    layers = [] if band is None else [layer("band", band[0], COLOURS["before"], left=[-band[1]], right=[band[1]])]
    layers.append(layer("line", x=[0.0, 0.0], y=[-0.5, len(names) - 0.5]))
    room = max(1, (len(groups) + 1) // 2)  # of a name, in lines
    thick = 0.12 / room
    for k, (label, colour, values, half, texts) in enumerate(groups):
        at = np.arange(len(names)) + (0.7 * ((k + 0.5) / len(groups) - 0.5) if len(groups) > 1 else 0.0)
        layers.append(
            layer("bars", "", colour, y=at, left=values - half, right=values + half, thick=thick, texts=texts)
        )
        layers.append(layer("points", label, colour, x=values, y=at, texts=texts))
    height = 90 + _LINE * room * len(names)
    return panel(x, axis("", names=names), layers, height=height)


def relative_changes(fit: Fit) -> tuple[list[Estimate], FloatArray, FloatArray]:
    """Return the robot's own free parameters, their changes and half intervals in sigmas of their priors, (n,) each."""
    free = [p for p in fit.nominal.parameters if p.name in fit.free_names and not p.placement]
    found, sigma = [fit.parameters[p.name] for p in free], np.array([p.sigma for p in free])
    change = np.array([one.value - one.nominal for one in found])
    return found, change / sigma, np.array([one.high95 - one.value for one in found]) / sigma


def parameters(fit: Fit) -> Chart | None:
    """Return the change of every free parameter of the robot with its interval, in expected sigmas, largest first.

    The coefficients of curves are left out: hundreds, of which none says anything alone.
    """
    free, change, half = relative_changes(fit)
    own = np.flatnonzero([not one.family for one in free])
    if not len(own):
        return None
    order = own[np.argsort(-np.abs(change[own]), kind="stable")]
    found = [free[k] for k in order]
    prior = {parameter.name: parameter.sigma for parameter in fit.nominal.parameters}
    texts = [
        f"{one.name}: {one.nominal:.4f} → {one.value:.4f} {one.unit}, 95 % from {one.low95:.4f} to {one.high95:.4f};"
        f" prior ± {prior[one.name]:.3g} {one.unit}; {one.status}"
        for one in found
    ]
    drawn = forest(
        [one.name for one in found],
        [("change", COLOURS["after"], change[order], half[order], texts)],
        "change [sigma of the prior]",
        ("expected beforehand (95 %)", 2.0),
    )
    return Chart(
        "forest",
        "Parameters: change, 95 % interval, and what was expected",
        "The robot's own, without base and targets; the largest change is at the top. Beyond the band, the robot is"
        " further from nominal than expected; an interval that is as wide as the band says that the measurements"
        " determined little."
        + (" Coefficients of curves are left out: see the errors of the joints." if len(own) < len(free) else ""),
        drawn,
        440,
    )


def waterfall(fit: Fit) -> Chart | None:
    """Return the reduction of the error before calibration by each cause, and the rest."""
    budget = budget_table(fit)
    if budget is None:
        return None
    causes, unit = budget["causes"], budget["unit"]
    squares = np.array([row["mean_square"] for row in causes])
    ends = np.sqrt(np.maximum(np.cumsum(squares[::-1])[::-1], 0.0))  # the error before each cause is removed
    starts = np.append(ends[1:], 0.0)
    texts = [
        f"{row['cause']}: {row['rms']:.3g} {unit} RMS, {100 * row['share']:.2g} % of the mean square"
        if np.isfinite(row["rms"])
        else f"{row['cause']}: {row['remark']}"
        for row in causes
    ]
    names = [row["cause"] for row in causes]
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)

    def bars(colour: str, which: Any) -> Any:
        sides = {"y": which, "left": low[which], "right": high[which], "texts": [texts[k] for k in which]}
        return layer("bars", "", colour, **sides, thick=0.7)

    bad = starts > ends
    layers = [bars(COLOURS[name], np.flatnonzero(k)) for name, k in (("after", ~bad), ("x", bad)) if k.any()]
    larger = " A cause with an orange bar makes the error larger." if bad.any() else ""
    return Chart(
        "waterfall",
        "Causes of the error before calibration",
        f"From {budget['rms_before']:.3g} {unit} at the top, each cause is subtracted (squares add up).{larger}",
        (
            panel(
                axis(f"RMS error [{unit}]", ends=[0, 1.03 * max(ends)]),
                axis("", names=names),
                layers,
                height=90 + 30 * len(names),
            ),
        ),
        600,
    )


def joint_shares(fit: Fit) -> Chart | None:
    """Return each joint's share of the squared error before calibration, largest first."""
    budget = findings.joint_budget(fit)
    shares = [] if budget is None else worst_joints(budget)
    if budget is None or not (shares and budget.before > 0):  # a robot may have only instruments to calibrate
        return None
    percent, half = (100 / budget.before * np.array(v) for v in zip(
        *((one.mean_square, 1.96 * one.std) for one in shares), strict=True))  # fmt: skip
    names = [one.cause for one in shares]
    texts = [f"{name}: {p:.3g} % ± {h:.2g} %" for name, p, h in zip(names, percent, half, strict=True)]
    return Chart(
        "joints",
        "Which joint makes the error",
        "Part of the squared error before calibration that each joint explains, with its 95 % interval. Below zero:"
        " its correction makes these readings worse. Wide interval: other joints can explain the same error.",
        forest(names, [("", COLOURS["after"], percent, half, texts)], "part of the squared error [%]"),
        440,
    )


def file_worth_chart(fit: Fit) -> Chart | None:
    """Return the errors of each kind of file: RMS and 95 % limit."""
    grid = files_grid(fit)
    if grid is None:
        return None
    unit = grid.title.split(", ")[1].split(" ")[0]
    names = [str(row[0]) for row in grid.rows]

    def numbers(column: int) -> Any:
        cells = [row[column] for row in grid.rows]
        return np.array([cell.value if isinstance(cell, GridNumber) else np.nan for cell in cells])

    rms, limit = numbers(1), numbers(2)
    texts = [f"{n}: RMS {r:.3g} {unit}" + (f", 95 % limit {m:.3g} {unit}" if np.isfinite(m) else "")
             for n, r, m in zip(names, rms, limit, strict=True)]  # fmt: skip
    places = np.arange(len(names))
    layers = [
        layer("bars", "95 % limit", COLOURS["before"], y=places, left=0 * rms, right=limit, thick=0.4, texts=texts),
        layer("bars", "RMS", COLOURS["after"], y=places, left=0 * rms, right=rms, thick=0.7, texts=texts),
    ]
    most = 1.05 * max(np.nanmax(rms), np.nanmax(limit, initial=0.0))
    shown = panel(axis(f"error [{unit}]", ends=[0, most]), axis("", names=names), layers, height=90 + 34 * len(names))
    return Chart("worth", "What files are worth", "The shorter, the better.", (shown,), 600)
