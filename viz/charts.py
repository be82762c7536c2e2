"""Plots of pages as data for the script that draws them (`charts.js`).

A chart is a row of panels, a panel a stack of layers. A layer has columns of numbers, and the row of the page's table
of each mark, so that hover and selection mean the same pose in every plot, in space and in tables. Marks without a row
have texts of their own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from viz.svg import AXES, STATES

_DIGITS = 5  # digits of a number in a plot
COLOURS = {"before": STATES["before"][0], "after": STATES["after"][0], **{name: look[0] for name, look in AXES.items()}}
"""Colours of states and axes."""
MANY = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#7F7F7F")
"""Colours of results and robots in one picture."""


@dataclass(frozen=True)
class Chart:
    """One plot of a page.

    Attributes:
        name: Short name, unique on the page.
        title: Title.
        text: How to read the plot.
        panels: Results of `panel`, side by side if there is room.
        wide: Smallest width of a panel [px].
    """

    name: str
    title: str
    text: str
    panels: tuple[dict[str, Any], ...]
    wide: int = 300


def axis(
    label: str,
    *,
    log: bool = False,
    ends: Sequence[float] | None = None,
    names: Sequence[str] = (),
    beyond: bool = False,
) -> Any:
    """Return an axis with a quantity and unit; by default, its ends are the range of the marks.

    `names` are categories in place of numbers, the first at the top or on the left. `beyond`: marks beyond the ends of
    an upright axis are drawn at these.
    """
    shown = None if ends is None else list(map(float, ends))
    return {"label": label, "log": log, "ends": shown, "names": list(names), "beyond": beyond}


def panel(
    x: Any,
    y: Any,
    layers: Sequence[Any],
    *,
    title: str = "",
    height: int = 300,
    equal: bool = False,
    bare: bool = False,
) -> Any:
    """Return a panel; `equal`: units are equally long on both axes; `bare`: without axes."""
    content = {"x": x, "y": y, "layers": list(layers)}
    return content | {"title": title, "height": height, "equal": equal, "bare": bare}


def layer(kind: str, label: str = "", colour: str = "", **columns: Any) -> dict[str, Any]:
    """Return a layer: `points`, `line`, `bars` (left, right, y), `cells` (x, y, width, height, colours) or `band`.

    Its label is its entry in the legend, if any; without a colour, it has that of the page's text. Columns are numbers,
    rows, texts, or colours of its marks.
    """
    shown = {name: json_values(values) for name, values in columns.items()}
    return {"kind": kind, "label": label, "colour": colour, **shown}


def json_values(values: ArrayLike) -> Any:
    """Return values (n,) for JSON: numbers with few digits, None for NaN and infinity; other values unchanged."""
    array = np.asarray(values)
    if array.dtype.kind != "f":
        return array.tolist()
    return [float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else None for value in array.ravel().tolist()]


@dataclass(frozen=True)
class PageRows:
    """Data of the page for each row of its table.

    Attributes:
        texts: Texts on hover.
        poses: Number of each row's pose; rows of one pose are selected together.
        marks: Name of each row's mark in Bokeh.
    """

    texts: tuple[str, ...] = ()
    poses: tuple[int, ...] = ()
    marks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Charts:
    """The plots of a page by its parts, and the rows of its table."""

    by_place: Mapping[str, tuple[Chart, ...]]
    rows: PageRows = field(default_factory=PageRows)

    def to_dict(self) -> dict[str, Any]:
        """Return the data for the page's script."""
        charts = [chart for part in self.by_place.values() for chart in part]
        return {
            "rows": vars(self.rows),
            "charts": {chart.name: {"panels": chart.panels, "wide": chart.wide} for chart in charts},
        }
