"""The figures for notebooks and papers: text stays text, numbers are plain, ticks whole."""

import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from tests.viz.viz_examples import pose_table
from viz.fit_plots import draw_course, draw_histogram, draw_normal, draw_residuals
from viz.scene import ViewerJoint
from viz.svg import new_figure, plain_ticks, svg_file, with_style

JOINTS = (ViewerJoint("q1", "mm", 1e3), ViewerJoint("shoulder $a_1$ <b>", "deg", 180 / np.pi))


def table(n=60, fitted=40, scale=1.0):
    generator = np.random.default_rng(4)
    q, measured = generator.normal(size=(n, 2)), generator.normal(size=(n, 3))
    before, after = (measured + size * generator.normal(size=(n, 3)) for size in (5e-3, 4e-5 * scale))
    group = ("identification",) * fitted + ("validation",) * (n - fitted)
    return pose_table(q, measured, before, after, spread=np.zeros((n, 3)), group=group, outlier=np.arange(n) == 3)


@with_style
def drawn(draw, *arguments):
    figure, (axes,) = new_figure(1, 1, (8.9, 2.6))
    draw(axes, *arguments)
    return svg_file(figure)


FIGURES = (
    (draw_histogram, (table(),)),
    (draw_course, (table(),)),
    (draw_residuals, (table(), JOINTS[1], 1)),
    (draw_normal, (table(),)),
)


@pytest.mark.quick(1)
@pytest.mark.parametrize(("draw", "arguments"), FIGURES)
def test_figures_are_well_formed_the_same_each_time_and_labelled_inside(draw, arguments):
    svg = drawn(draw, *arguments)
    assert svg == drawn(draw, *arguments)
    root = ElementTree.fromstring(svg)
    *_, width, height = map(float, root.attrib["viewBox"].split())
    written = [text for text in root.iter() if text.tag.endswith("text")]
    assert any("[" in "".join(text.itertext()) for text in written), "labels have units"
    for text in written:
        x, y = (float(text.attrib.get(name, 0.0)) for name in "xy")
        assert 0.0 <= x <= width
        assert 0.0 <= y <= height


def test_names_from_files_are_neither_mathematics_nor_markup():
    svg = drawn(draw_residuals, table(), JOINTS[1], 1).decode()
    assert "shoulder $a_1$ &lt;b&gt; [deg]" in svg
    assert "<b>" not in svg


def test_exact_data_can_be_drawn():
    assert drawn(draw_histogram, table(scale=0.0))


@pytest.mark.parametrize(("low", "high"), [(1e-6, 30.0), (0.02, 0.09), (3e3, 4e6)])
def test_ticks_are_plain_numbers(low, high):
    figure, (axes,) = new_figure(1, 1, (8.9, 2.6))
    axes.set(xscale="log", xlim=(low, high))
    plain_ticks(axes.xaxis)
    figure.draw_without_rendering()
    ticks = [(tick.get_loc(), tick.label1.get_text()) for tick in axes.xaxis.get_major_ticks()]
    assert len(ticks) > 1
    assert [float(text) for _, text in ticks] == pytest.approx([place for place, _ in ticks])
    assert not any("e" in text for _, text in ticks)


@pytest.mark.parametrize("n", [2, 5, 12])
def test_numbers_of_readings_are_whole(n):
    _, (axes,) = new_figure(1, 1, (8.9, 2.6))
    draw_histogram(axes, table(n, fitted=n))
    ticks = axes.get_yticks()
    assert list(ticks) == list(np.round(ticks))
