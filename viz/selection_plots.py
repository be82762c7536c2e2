"""Figures of `calib check` and `calib select` as SVG files; the same input gives the same bytes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from calib.core.base.units import millimetres
from calib.planning.assessment import Assessment
from calib.planning.selection import Selection
from calib.planning.selection_problem import TASK
from viz.svg import BLUE, GREY, ORANGE, new_figure, plain_ticks, svg_file, with_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MARKS = ("-", "--", ":", "-.")


@with_style
def assessment_figures(assessment: Assessment) -> dict[str, bytes]:
    """Return singular values with the gap, correlations, and predicted accuracy against number of poses."""
    return {
        "singular_values.svg": svg_file(singular_values(assessment)),
        "correlations.svg": svg_file(correlations(assessment)),
        "accuracy.svg": svg_file(accuracy(assessment)),
    }


@with_style
def selection_figures(selection: Selection) -> dict[str, bytes]:
    """Return the index over the exchanges."""
    return {"index.svg": svg_file(index_history(selection))}


def singular_values(assessment: Assessment) -> Figure:
    """Draw the singular values of all parameters, the threshold, and the gap at the rank."""
    figure, (axes,) = new_figure(1, 1, (6.4, 3.6))
    rank = assessment.rank_all
    values = rank.singular_values
    floor = 1e-3 * min(rank.threshold, float(np.min(values[values > 0], initial=rank.threshold)))
    number = np.arange(1, len(values) + 1)
    kept = number <= rank.rank
    axes.plot(number[kept], values[kept], "o", color=BLUE, label=f"determined ({rank.rank})")
    if not np.all(kept):
        axes.plot(number[~kept], np.maximum(values[~kept], floor), "x", color=ORANGE, label="not determined")
        axes.axvspan(rank.rank + 0.25, rank.rank + 0.75, color=GREY, alpha=0.3, linewidth=0, label="gap")
    axes.axhline(rank.threshold, color=GREY, linestyle="--", linewidth=1, label="threshold")
    axes.set(yscale="log", xlabel="number", ylabel="singular value, columns of length 1")
    plain_ticks(axes.yaxis)
    axes.legend()
    return figure


def correlations(assessment: Assessment) -> Figure:
    """Draw the correlation matrix of the free parameters; undetermined entries stay white."""
    names = [parameter.name for parameter in assessment.free_parameters]
    size = max(4.0, 0.17 * len(names) + 1.8)
    figure, (axes,) = new_figure(1, 1, (size + 0.8, size))
    figure.set_layout_engine("constrained")  # for the bar of colours
    image = axes.imshow(assessment.posterior_information.correlations(), cmap="RdBu_r", vmin=-1, vmax=1)
    axes.set_xticks(range(len(names)), names, rotation=90, fontsize=7)
    axes.set_yticks(range(len(names)), names, fontsize=7)
    axes.grid(visible=False)
    figure.colorbar(image, ax=axes, label="correlation", shrink=0.8)
    return figure


def accuracy(assessment: Assessment) -> Figure:
    """Draw the predicted position error against the number of poses."""
    figure, (axes,) = new_figure(1, 1, (6.4, 3.6))
    rows = assessment.by_count
    counts = np.array([row.count for row in rows])
    inside = np.array([row.uniform is not None for row in rows])
    uniform, chosen = (
        np.array([np.nan if task is None else millimetres(task.rms) for task in tasks])
        for tasks in ([row.uniform for row in rows], [row.chosen for row in rows])
    )
    largest = np.array([np.nan if row.chosen is None else millimetres(row.chosen.maximum) for row in rows])
    axes.plot(counts[inside], uniform[inside], "s--", color=ORANGE, label="spread uniformly, RMS")
    axes.plot(counts[inside], chosen[inside], "o-", color=BLUE, label="best of these, RMS")
    axes.plot(counts[inside], largest[inside], "o:", color=BLUE, label="best of these, largest")
    last = np.append(np.flatnonzero(inside)[-1:], np.flatnonzero(~inside))
    axes.plot(counts[last], chosen[last], "-", color=GREY, label="all measured several times, RMS")
    axes.set(xscale="log", yscale="log", xlabel="number of poses", ylabel="predicted position error [mm]")
    plain_ticks(axes.xaxis, axes.yaxis)
    axes.legend()
    return figure


def index_history(selection: Selection) -> Figure:
    """Draw the index over the exchanges of each run, and the proven bound."""
    figure, (axes,) = new_figure(1, 1, (6.4, 3.6))
    scale = millimetres(1.0) if selection.index == TASK else 1.0
    for k, run in enumerate(selection.runs):
        values = scale * np.array(run.history)
        label = f"start {k + 1}: {run.start}"
        axes.plot(range(len(values)), values, _MARKS[k % len(_MARKS)], color=BLUE, label=label)
        axes.plot(run.n_paper, values[run.n_paper], "o", color=BLUE, markersize=4)
    if selection.bound is not None:
        axes.axhline(scale * selection.bound, color=GREY, linestyle="--", linewidth=1, label="no choice is beyond this")
    name = "predicted position error, RMS [mm]" if selection.index == TASK else selection.index
    axes.set(xlabel="exchange (dot: end of add-and-remove, then single swaps)", ylabel=name)
    axes.legend()
    return figure
