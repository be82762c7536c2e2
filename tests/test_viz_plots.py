"""The report's figures: vector graphics with text that can be read and selected, and that hold the numbers."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from viz.plots import all_plots, histogram, normal_plot, residual_by_joint
from viz.poses import PoseTable
from viz.scene import Joint

JOINTS = (Joint("q1", "mm", 1e3), Joint("shoulder $a_1$ <b>", "deg", 180 / np.pi))


def table(n=60, fitted=40, scale=1.0):
    generator = np.random.default_rng(4)
    measured = generator.normal(size=(n, 3))
    return PoseTable(
        generator.normal(size=(n, 2)),
        measured,
        measured + generator.normal(0, 5e-3, (n, 3)),
        measured + scale * generator.normal(0, 4e-5, (n, 3)),
        np.full(n, 4e-5),
        np.zeros((n, 3)),
        ("identification",) * fitted + ("validation",) * (n - fitted),
        np.arange(n) == 3,
        tuple(map(str, range(n))),
        ("tool",) * n,
    )


@pytest.fixture(scope="module")
def plots():
    return all_plots(table(), JOINTS)


def texts(svg):
    return ["".join(node.itertext()) for node in ElementTree.fromstring(svg).iter("{http://www.w3.org/2000/svg}text")]


def test_there_is_a_plot_for_every_question(plots):
    assert [plot.name for plot in plots] == [
        "histogram",
        "error-by-pose",
        "error-by-axis",
        "residual-by-joint",
        "normal-plot",
    ]


def test_plots_are_well_formed_with_text_as_text(plots):
    for plot in plots:
        assert plot.svg.startswith("<svg ")
        assert texts(plot.svg)
    assert "predicted minus measured [mm]" in texts(plots[2].svg)


def test_names_from_files_are_neither_mathematics_nor_markup(plots):
    assert any("shoulder $a_1$ <b> [deg]" in text for text in texts(plots[3].svg))
    assert "<b>" not in plots[3].svg


def test_identifiers_do_not_clash_and_references_hit(plots):
    found = [name for plot in plots for name in re.findall(r'\bid="([^"]+)"', plot.svg)]
    assert len(found) == len(set(found))
    for plot in plots:
        used = re.findall(r'xlink:href="#([^"]+)"|url\(#([^)]+)\)', plot.svg)
        assert used
        assert {first or second for first, second in used} <= set(found)


def test_plots_ask_nobody_and_carry_no_date(plots):
    for plot in plots:
        assert "<metadata" not in plot.svg
        assert not re.search(r'href="(?!#)', plot.svg)


def test_the_same_data_give_the_same_plot():
    assert histogram(table()).svg == histogram(table()).svg


def test_every_joint_has_its_panel_and_many_marks_are_thinned():
    few, many = (residual_by_joint(table(n), JOINTS) for n in (60, 3000))
    assert "is drawn" not in few.text
    assert "one in 5 is drawn" in many.text
    assert many.svg.count("<use ") < 2.5 * few.svg.count("<use ") * 600 / 60


def test_the_normal_plot_judges_fitted_poses_only():
    marks = normal_plot(table(60, fitted=40)).svg.count("<use ")
    # the few ticks, drawn alike, may differ
    assert marks - normal_plot(table(60, fitted=10)).svg.count("<use ") == pytest.approx(3 * 30, abs=15)


def test_exact_data_can_be_drawn():
    assert all(plot.svg for plot in all_plots(table(scale=0.0), JOINTS))
