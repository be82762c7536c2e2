"""Ticks as few artists: the same numbers at the same places as matplotlib's own."""

import re

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from viz.svg import new_figure, plain_ticks, styled, svg_file
from viz.ticks import Ticks


def words(svg):
    return re.findall(r">([^<>\n]+)</text>", svg.decode())


@styled
def drawn(scale, kept, **ticks):
    figure, panels = new_figure(1, 2, (6.0, 2.0), sharey=True)
    for axes in panels:
        axes.plot([1.0, 30.0, 400.0], [-0.013, 0.2, 0.31])
        axes.set(xscale=scale, xlabel="way")
        plain_ticks(axes.xaxis)
        if ticks:
            axes.set_xticks([2.0, 200.0], ["low", "high"], **ticks)
    if kept:
        figure.set_layout_engine("constrained")
    return words(svg_file(figure)), figure


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_an_axis_has_the_numbers_that_matplotlib_gives_it(scale):
    (ours, figure), (theirs, _) = drawn(scale, False), drawn(scale, True)
    assert sorted(ours) == sorted(theirs)
    assert len(ours) > 8
    assert all(isinstance(axes.xaxis.get_major_locator(), NullLocator) for axes in figure.axes)


def test_numbers_stand_where_matplotlib_puts_them():
    figure = Figure()
    axes = figure.subplots()
    axes.plot([0.0, 7.0], [2.0, 3.0])
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    for axis in (axes.xaxis, axes.yaxis):
        low, high = sorted(axis.get_view_interval())
        shown = [label for label in axis.get_ticklabels() if low <= label.get_position()[axis is axes.yaxis] <= high]
        ticks = Ticks.of(axis)
        assert [text.get_text() for text in ticks.texts] == [label.get_text() for label in shown]
        for text, label in zip(ticks.texts, shown, strict=True):
            np.testing.assert_allclose(text.get_window_extent(renderer), label.get_window_extent(renderer), atol=1e-6)


def test_ticks_that_somebody_changed_are_left_to_matplotlib():
    _, figure = drawn("linear", False, rotation=90)
    assert not any(isinstance(axes.xaxis.get_major_locator(), NullLocator) for axes in figure.axes)
    figure = Figure()
    axes = figure.subplots()
    assert Ticks.of(axes.xaxis) is not None
    axes.tick_params(labelsize=5)
    assert Ticks.of(axes.xaxis) is None
    axes.yaxis.tick_right()
    assert Ticks.of(axes.yaxis) is None
