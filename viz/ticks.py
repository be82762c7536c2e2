"""Ticks of axes as few artists: matplotlib makes five of each tick, which take longer than all else in a figure."""

from __future__ import annotations

from typing import Any

import numpy as np

from calib.core.base.arrays import FloatArray

_ROUNDING = 1e-10  # of the length of an axis, by which a tick may lie beyond its end
_SIDES = {"x": ("bottom", "top"), "y": ("left", "right")}


def draw_small(figure: Any) -> None:
    """Draw the small ticks of all axes as marks, and take them from matplotlib."""
    from matplotlib.ticker import NullLocator

    axes = [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]
    places_of = {axis: np.asarray(axis.get_minorticklocs()) for axis in axes}  # before any is taken away: some share
    for axis, places in places_of.items():
        axis.set_minor_locator(NullLocator())
        _mark(axis, places[_in_sight(axis, places)], "minor")


class Ticks:
    """The large ticks of an axis and their numbers, as matplotlib would draw them.

    Args:
        axis: The x axis or y axis, as it will be drawn.
    """

    def __init__(self, axis: Any) -> None:
        places = np.asarray(axis.get_majorticklocs())
        labels = axis.major.formatter.format_ticks(places)
        inside = _in_sight(axis, places)
        has_labels = axis.get_tick_params()[f"label{_SIDES[axis.axis_name][0]}"]
        named = [(place, label) for place, label, seen in zip(places, labels, inside, strict=True) if seen and label]
        self._axis, self.places = axis, places[inside]
        self.texts = [_text(axis, *entry) for entry in named if has_labels]

    @staticmethod
    def of(axis: Any) -> Ticks | None:
        """Return the ticks of an axis; None where matplotlib has to draw them, because they are not as usual."""
        told, (side, other) = axis.get_tick_params(), _SIDES[axis.axis_name]
        usual = {side: True, other: False, f"label{other}": False}
        if not (axis.get_visible() and axis.axes.axison) or told.keys() != usual.keys() | {f"label{side}", "gridOn"}:
            return None
        label, plain = axis.get_major_ticks(1)[0].label1, _text(axis, 0.0, "")
        same = label.get_rotation() == 0.0 and label.get_fontsize() == plain.get_fontsize()
        if not same or any(told[name] != value for name, value in usual.items()):
            return None
        ticks = Ticks(axis)
        return None if axis.major.formatter.get_offset() else ticks

    def extent(self, renderer: Any) -> Any:
        """Return what the numbers cover, a `Bbox` [points]; None without any."""
        from matplotlib.transforms import Bbox

        return Bbox.union([text.get_window_extent(renderer) for text in self.texts]) if self.texts else None

    def draw(self) -> None:
        """Put them into the axes, and take them from matplotlib."""
        import matplotlib
        from matplotlib.lines import Line2D
        from matplotlib.ticker import NullLocator

        style: Any = matplotlib.rcParams
        axis, axes, along_x = self._axis, self._axis.axes, self._axis.axis_name == "x"
        if axis.get_tick_params()["gridOn"]:
            way, across = np.repeat(self.places, 3), np.tile([0.0, 1.0, np.nan], len(self.places))
            axes.add_artist(
                Line2D(
                    *((way, across) if along_x else (across, way)),
                    color=style["grid.color"],
                    linestyle=style["grid.linestyle"],
                    linewidth=style["grid.linewidth"],
                    alpha=style["grid.alpha"],
                    transform=axes.get_xaxis_transform("grid") if along_x else axes.get_yaxis_transform("grid"),
                    zorder=axis.get_zorder(),
                )
            )
        _mark(axis, self.places, "major")
        for text in self.texts:
            axes.add_artist(text)
        axis.set_major_locator(NullLocator())


def _in_sight(axis: Any, places: FloatArray) -> Any:
    """Which places are in sight, (n,)."""
    low, high = sorted(axis.get_transform().transform(axis.get_view_interval()))
    way, beyond = axis.get_transform().transform(places), _ROUNDING * (high - low)
    return (way >= low - beyond) & (way <= high + beyond)


def _text(axis: Any, place: float, label: str) -> Any:
    """The number of a tick, not yet drawn."""
    import matplotlib
    from matplotlib.text import Text

    style: Any = matplotlib.rcParams
    name, along_x = f"{axis.axis_name}tick", axis.axis_name == "x"
    away = style[f"{name}.major.size"] + style[f"{name}.major.pad"]
    where = axis.axes.get_xaxis_text1_transform(away) if along_x else axis.axes.get_yaxis_text1_transform(away)
    transform, vertical, horizontal = where
    text = Text(
        *((place, 0.0) if along_x else (0.0, place)),
        label,
        fontsize=style[f"{name}.labelsize"],
        color=style[f"{name}.color"],
        verticalalignment=vertical,
        horizontalalignment=horizontal,
        transform=transform,
        clip_on=False,
        zorder=axis.get_zorder(),
    )
    text.set_figure(axis.axes.figure)
    return text


def _mark(axis: Any, places: FloatArray, size: str) -> None:
    """Draw ticks of a size, `major` or `minor`, as the marks of one line."""
    import matplotlib
    from matplotlib.lines import Line2D
    from matplotlib.markers import TICKDOWN, TICKLEFT

    if not len(places):
        return
    style: Any = matplotlib.rcParams
    name, along_x, edge = f"{axis.axis_name}tick", axis.axis_name == "x", np.zeros(len(places))
    mark: Any = TICKDOWN if along_x else TICKLEFT
    axis.axes.add_artist(
        Line2D(
            *((places, edge) if along_x else (edge, places)),
            linestyle="none",
            marker=mark,
            color=style[f"{name}.color"],
            markersize=style[f"{name}.{size}.size"],
            markeredgewidth=style[f"{name}.{size}.width"],
            transform=axis.axes.get_xaxis_transform() if along_x else axis.axes.get_yaxis_transform(),
            clip_on=False,
            zorder=axis.get_zorder(),
        )
    )
