"""Figures as SVG files: readable in any size and print, text selectable.

matplotlib is imported when a figure is drawn. Figures touch nothing global and open no window. Text is never read as
mathematics, because names come from files.
"""

from __future__ import annotations

import functools
import io
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#7F7F7F"
"""Colours that are distinct with any colour vision (Okabe and Ito), and a grey for context."""
AXES = {"x": (ORANGE, "o"), "y": (GREEN, "^"), "z": (BLUE, "s")}
"""Colour and mark of each axis."""
STATES = {"before": (GREY, "--"), "after": (BLUE, "-")}
"""Colour and line before and after calibration."""

_POINTS = 72  # dots per inch, as in SVG files
_Arguments = ParamSpec("_Arguments")
_Drawn = TypeVar("_Drawn")
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "calibration",
    "text.parse_math": False,
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.grid": True,
    "grid.alpha": 0.35,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
    "axes.titlesize": 9.5,
    "axes.formatter.useoffset": False,
}


def with_style(draw: Callable[_Arguments, _Drawn]) -> Callable[_Arguments, _Drawn]:
    """Draw and write with our style, and restore matplotlib's settings afterwards."""

    @functools.wraps(draw)
    def drawn(*args: _Arguments.args, **options: _Arguments.kwargs) -> _Drawn:
        import matplotlib

        with matplotlib.rc_context(_STYLE):
            return draw(*args, **options)

    return drawn


def new_figure(rows: int, columns: int, size: tuple[float, float], **shared: Any) -> tuple[Figure, list[Axes]]:
    """Return a figure of `size` [inch] and its panels, row by row; `shared` goes to `Figure.subplots`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=_POINTS)
    panels = figure.subplots(rows, columns, squeeze=False, **shared)
    return figure, list(panels.ravel())


def svg_file(figure: Figure) -> bytes:
    """Return a figure as an SVG file; the same figure gives the same bytes."""
    if figure.get_layout_engine() is None and all(axes.get_subplotspec() for axes in figure.axes):
        figure.set_layout_engine("constrained")  # only if no axes were placed by hand
    stream = io.BytesIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    return stream.getvalue()


def plain_ticks(*axes: Any) -> None:
    """Write the ticks of logarithmic axes as plain numbers such as 0.01, since powers would need mathematics.

    If fewer than two powers of ten are visible, 2 and 5 times as many have numbers, too.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    for axis in axes:
        low, high = getattr(axis.axes, f"get_{axis.axis_name}lim")()
        if axis.get_scale() == "log" and np.floor(np.log10(high)) - np.ceil(np.log10(low)) < 1:
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.set_major_formatter(
            FuncFormatter(lambda value, _: np.format_float_positional(value, 12, trim="-", fractional=False))
        )
        axis.set_minor_formatter(NullFormatter())
