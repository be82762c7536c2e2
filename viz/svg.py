"""Figures as SVG text: readable in any size and print, text selectable, safe to put into a page.

matplotlib is imported where a figure is drawn. Figures are objects of their own: nothing global is touched and no
window can open. Text is never read as mathematics, because names come from files.
"""

from __future__ import annotations

import functools
import html
import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

from viz.ticks import Ticks, draw_small

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#7F7F7F"
"""Colours that are told apart with any colour vision (Okabe and Ito), and a grey for what is only beside them."""
AXES = {"x": (ORANGE, "o"), "y": (GREEN, "^"), "z": (BLUE, "s")}
"""Colour and mark of what belongs to an axis."""
STATES = {"before": (GREY, "--"), "after": (BLUE, "-")}
"""Colour and line of what was before calibration, and after."""

LONGEST_ENTRY = 24
"""Letters of a name in a legend of three columns."""
_WIDEST_LABEL = 34  # letters under one of three panels
_POINTS, _GAP = 72, 4.0  # to an inch, as in SVG files; between neighbours [points]
_MOST_MARKS = 600  # drawn one by one; more would make the file large and the figure black
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
    "axes.titley": 1.0,  # else it is looked for, and all ticks measured once more
    "axes.formatter.useoffset": False,
}


@dataclass(frozen=True)
class Plot:
    """A finished figure.

    Attributes:
        name: Short name, unique in the report.
        title: What it shows.
        text: How to read it.
        svg: The drawing.
    """

    name: str
    title: str
    text: str
    svg: str


def styled(draw: Callable[_Arguments, _Drawn]) -> Callable[_Arguments, _Drawn]:
    """Draw and write with our style, and put matplotlib's settings back afterwards."""

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


def finished(name: str, title: str, text: str, figure: Figure) -> Plot:
    """Return a figure as a `Plot`."""
    return Plot(name, title, text, svg_text(figure, name, title))


def svg_file(figure: Figure) -> bytes:
    """Return a figure as an SVG file; the same figure gives the same bytes."""
    draw_small(figure)
    if figure.get_layout_engine() is None and all(axes.get_subplotspec() for axes in figure.axes):
        _lay_out(figure)  # axes that were placed by hand stay
    stream = io.BytesIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None, "Format": None, "Type": None})
    return stream.getvalue()


def svg_text(figure: Figure, name: str, title: str) -> str:
    """Return a figure as an SVG element to put into a page, whose background and colour of text it takes.

    Its identifiers begin with `name`, so that none clash.
    """
    figure.patch.set_visible(False)
    for axes in figure.axes:
        axes.patch.set_visible(False)
    svg = svg_file(figure).decode().replace("#000000", "currentColor")
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r'\bid="([^"]+)"', rf'id="{name}-\1"', svg)
    svg = re.sub(r'(xlink:href="#|url\(#)', rf"\g<1>{name}-", svg)
    return svg.replace("<svg ", f'<svg role="img" aria-label="{html.escape(title)}" ', 1)


def _lay_out(figure: Any) -> None:
    """Place panels of equal size so that their labels, and a legend above them, have room.

    matplotlib's own layout can do more, but measures every text several times, which takes longer than drawing it.
    """
    from matplotlib.backends.backend_svg import RendererSVG
    from matplotlib.text import Text
    from matplotlib.transforms import Bbox

    width, height = figure.bbox.size
    renderer = RendererSVG(width, height, io.StringIO(), image_dpi=_POINTS)  # type: ignore[no-untyped-call]
    figure.subplots_adjust(60 / width, 40 / height, 1 - 10 / width, 1 - 25 / height)  # nearly; ticks depend on it
    above = _GAP + sum(legend.get_window_extent(renderer).height for legend in figure.legends)
    panels = [axes for axes in figure.axes if axes.get_visible()]
    grid = panels[0].get_gridspec()
    left, right, below, over = np.zeros(grid.ncols), np.zeros(grid.ncols), np.zeros(grid.nrows), np.zeros(grid.nrows)
    for axes in panels:
        axes.apply_aspect()
    ticks = {axis: Ticks.of(axis) for axes in panels for axis in (axes.xaxis, axes.yaxis)}
    labels = []
    for axes in panels:
        inner, place = axes.bbox.frozen(), axes.get_subplotspec()
        ways = [axis.label.get_transform() for axis in (axes.xaxis, axes.yaxis)]
        for axis in (axes.xaxis, axes.yaxis):  # labels in the middle: their own places would have ticks measured twice
            axis.set_label_coords(0.5, 0.5)
        x_ticks, y_ticks = (
            (axis.get_tightbbox(renderer) if own is None else own.extent(renderer)) or inner
            for axis, own in ((axis, ticks[axis]) for axis in (axes.xaxis, axes.yaxis))
        )
        x_label, y_label = (axis.label.get_window_extent(renderer) for axis in (axes.xaxis, axes.yaxis))
        down = max(inner.y0 - x_ticks.y0, axes.xaxis.get_tick_padding())  # to where ticks and their numbers end
        out = max(inner.x0 - y_ticks.x0, axes.yaxis.get_tick_padding())
        under, aside = down + axes.xaxis.labelpad, out + axes.yaxis.labelpad
        labels.append((axes, under, aside, *ways))
        texts = (text.get_window_extent(renderer) for text in axes.get_children() if isinstance(text, Text))
        outer = Bbox.union([inner, x_ticks, y_ticks, *(text for text in texts if text.width > 0.0)])
        column, row = place.colspan.start, place.rowspan.start
        left[column] = max(left[column], inner.x0 - outer.x0, out, y_label.width and aside + y_label.width)
        right[column] = max(right[column], outer.x1 - inner.x1)
        below[row] = max(below[row], inner.y0 - outer.y0, down, x_label.height and under + x_label.height)
        over[row] = max(over[row], outer.y1 - inner.y1)
    beside = _GAP + np.max(right[:-1] + left[1:], initial=0.0)
    between = _GAP + np.max(below[:-1] + over[1:], initial=0.0)
    figure.subplots_adjust(
        left=(_GAP + left[0]) / width,
        right=1 - (_GAP + right[-1]) / width,
        bottom=(_GAP + below[-1]) / height,
        top=1 - (above + over[0]) / height,
        wspace=beside * grid.ncols / (width - left[0] - right[-1] - 2 * _GAP - (grid.ncols - 1) * beside),
        hspace=between * grid.nrows / (height - below[-1] - over[0] - above - _GAP - (grid.nrows - 1) * between),
    )
    for axes, under, aside, below_x, beside_y in labels:  # they stay there, and need not be measured again
        axes.xaxis.set_label_coords(0.5, axes.bbox.y0 - under, below_x)
        axes.yaxis.set_label_coords(axes.bbox.x0 - aside, 0.5, beside_y)
    for own in ticks.values():  # after all are known: some share theirs
        if own is not None:
            own.draw()


def plain_ticks(*axes: Any) -> None:
    """Write the ticks of logarithmic axes as plain numbers such as 0.01: powers would need mathematics to print.

    Where fewer than two powers of ten are in sight, 2 and 5 times as many have numbers, too.
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


def shortened(name: str, longest: int = 60) -> str:
    """Return a name with its middle left out where it is too long for its place."""
    if len(name) <= longest:
        return name
    return f"{name[: longest // 2]}…{name[len(name) - (longest - longest // 2 - 1) :]}"


def in_lines(label: str) -> str:
    """Return a label as one or two lines that fit under one of three panels."""
    if len(label) <= _WIDEST_LABEL:
        return label
    text = shortened(label, 2 * _WIDEST_LABEL - 8)
    cut = max(text.rfind(mark, 8, _WIDEST_LABEL) for mark in " _") + 1 or _WIDEST_LABEL
    return f"{text[:cut].rstrip()}\n{text[cut:]}"


def thinned(count: int) -> tuple[slice, str]:
    """Return which of `count` marks to draw, and what the caption says about the others."""
    step = max(1, -(-count // _MOST_MARKS))
    return slice(None, None, step), "" if step == 1 else f" Of {count} marks, one in {step} is drawn."
