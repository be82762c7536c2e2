"""The report's figures: vector graphics with text that can be read and selected, and that hold the numbers."""

import dataclasses
import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from calib.core.instruments.position import POSITION
from viz.part_plots import PartErrors, draw_histogram, histogram, of_positions, residual_by_joint
from viz.plots import all_plots, error_by_pose, normal_plot
from viz.poses import PoseTable
from viz.scene import Joint
from viz.svg import LONGEST_ENTRY, finished, new_figure, plain_ticks, shortened, styled

JOINTS = (Joint("q1", "mm", 1e3), Joint("shoulder $a_1$ <b>", "deg", 180 / np.pi))


def table(n=60, fitted=40, scale=1.0, place=None):
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
        np.ones(n, dtype=np.intp),
        ("file.csv",) * n,
        np.arange(n) if place is None else place,
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
    results = [name for plot in plots for name in re.findall(r'\bid="([^"]+)"', plot.svg)]
    assert len(results) == len(set(results))
    for plot in plots:
        used = re.findall(r'xlink:href="#([^"]+)"|url\(#([^)]+)\)', plot.svg)
        assert used
        assert {first or second for first, second in used} <= set(results)


def test_plots_ask_nobody_and_carry_no_date(plots):
    for plot in plots:
        assert "<metadata" not in plot.svg
        assert not re.search(r'href="(?!#)', plot.svg)


def test_the_same_data_give_the_same_plot():
    assert histogram(of_positions(table())).svg == histogram(of_positions(table())).svg


def test_every_joint_has_its_panel_and_many_marks_are_thinned():
    few, many = (residual_by_joint(of_positions(table(n)), JOINTS) for n in (60, 3000))
    assert "is drawn" not in few.text
    assert "one in 5 is drawn" in many.text
    assert many.svg.count("<use ") < 2.5 * few.svg.count("<use ") * 600 / 60


def test_the_normal_plot_judges_fitted_poses_only():
    marks = normal_plot(table(60, fitted=40)).svg.count("<use ")
    # the few ticks, drawn alike, may differ
    assert marks - normal_plot(table(60, fitted=10)).svg.count("<use ") == pytest.approx(3 * 30, abs=15)


def test_exact_data_can_be_drawn():
    assert all(plot.svg for plot in all_plots(table(scale=0.0), JOINTS))


def test_poses_stand_in_the_order_of_measurement_under_their_names():
    # rows 40 to 59, the validation, were measured first
    held_out_first = np.array([*range(20, 60), *range(20)])
    shown = dataclasses.replace(table(place=held_out_first), labels=tuple(f"P{place}" for place in held_out_first))
    plot = error_by_pose(shown)
    ticks = [text for text in texts(plot.svg) if re.fullmatch(r"P\d+", text)]
    assert ticks[:4] == ["P0", "P8", "P16", "P24"]
    assert {"identification", "validation", "outlier"} <= set(texts(plot.svg))
    assert texts(plot.svg).count("pose, in the order of measurement") == 1


def test_a_step_in_time_is_a_step_in_the_figure():
    errors = np.where(np.arange(60) < 30, 1e-5, 1e-3)[:, None] * np.array([1.0, 0.0, 0.0])
    place = np.random.default_rng(0).permutation(60)
    shown = table(place=place)
    shown = dataclasses.replace(shown, after=shown.measured + errors[place])
    svg = error_by_pose(shown).svg
    lines = [path for path in re.findall(r'<path d="([^"]+)"[^>]*stroke: #0072b2[^>]*>', svg) if path.count("L") > 50]
    heights = [float(number) for number in re.findall(r"[ML] \S+ (\S+)", lines[0])]
    assert np.ptp(heights[:30]) < 1e-6
    assert np.ptp(heights[30:]) < 1e-6
    assert heights[0] - heights[-1] > 20  # downwards in SVG: smaller errors first


def test_files_have_panels_of_their_own():
    series = ("a/first.csv (identification)",) * 40 + ("b/second.csv (validation)",) * 20
    shown = dataclasses.replace(table(place=np.array([*range(40), *range(20)])), series=series)
    result = texts(error_by_pose(shown).svg)
    assert result.count("pose, in the order of measurement") == 2
    assert {"first.csv (identification)", "second.csv (validation)"} <= set(result)


def test_of_several_points_the_largest_error_is_drawn():
    shown = dataclasses.replace(table(), targets=("a", "b") * 30, place=np.arange(60) // 2)
    assert "Of several points" in error_by_pose(shown).text


def test_long_joint_names_do_not_reach_into_their_neighbours_panel():
    name = "the_joint_whose_name_nobody_wanted_to_shorten_although_it_is_so_long_that_no_page_is_wide_enough"
    joints = (Joint(name, "deg", 1.0), Joint("the_joint_whose_name_takes_two_lines_at_least", "deg", 1.0))
    shown = dataclasses.replace(table(), joints=np.zeros((60, 2)))
    result = texts(residual_by_joint(of_positions(shown), joints).svg)
    assert max(len(text) for text in result) <= 36
    assert any("…" in text for text in result)


def test_a_joint_that_stands_has_few_digits_on_its_axis():
    shown = dataclasses.replace(table(), joints=np.full((60, 1), 3.1e-5))
    result = texts(residual_by_joint(of_positions(shown), (Joint("still", "deg", 180 / np.pi),)).svg)
    assert max(len(text) for text in result[: result.index("still [deg]")]) <= len("−0.25")


def test_long_names_lose_their_middle():
    assert shortened("short") == "short"
    assert shortened("abcdefghij", 5) == "ab…ij"


def test_the_legend_of_the_histogram_stands_above_all_bars():
    parts = {part.get("id", ""): part for part in ElementTree.fromstring(histogram(of_positions(table())).svg).iter()}

    def heights(name, clipped):
        paths = [
            part for part in parts[name].iter() if part.get("d") and (part.get("clip-path") is not None) == clipped
        ]
        return [float(y) for path in paths for y in re.findall(r"[ML] \S+ (\S+)", path.get("d"))]

    legend, bars = heights("histogram-legend_1", clipped=False), heights("histogram-axes_1", clipped=True)
    assert len(legend) > 2
    assert len(bars) > 40
    assert max(legend) < min(bars)  # y downwards


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
    errors = np.full((n, 3), 1e-4)
    _, (axes,) = new_figure(1, 1, (8.9, 2.6))
    draw_histogram(axes, PartErrors(POSITION, np.zeros((n, 2)), errors, errors))
    ticks = axes.get_yticks()
    assert list(ticks) == list(np.round(ticks))


@styled
def test_long_names_of_many_results_stay_inside_the_figure():
    figure, (axes,) = new_figure(1, 1, (8.9, 2.6))
    for k in range(7):
        axes.plot([0, 1], label=shortened(f"{'wide' * 20} {k}", LONGEST_ENTRY) + " (unlike)")
    box = figure.legend(loc="upper center", ncols=3).get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= figure.bbox.x1


def test_no_name_leaves_its_place_in_a_picture():
    hostile = '"><script>alert(1)</script></svg><img src=x>-->'
    figure, (axes,) = new_figure(1, 1, (12, 6))
    axes.set_title(hostile)
    svg = finished("one", hostile, "text", figure).svg
    root = ElementTree.fromstring(svg)
    assert root.get("aria-label") == hostile
    assert not {"script", "img"} & {element.tag.split("}")[-1] for element in root.iter()}
    assert "<script" not in re.sub("<!--.*?-->", "", svg, flags=re.DOTALL)


def test_labels_of_axes_stand_beside_them_inside_the_picture(plots):
    for plot in plots:
        drawing = ElementTree.fromstring(plot.svg)
        *_, width, height = map(float, drawing.attrib["viewBox"].split())
        written = [text for text in drawing.iter() if text.tag.endswith("text")]
        assert any("[" in str(text.text) for text in written), "labels have units"
        for text in written:
            x, y = (float(text.attrib[name]) for name in "xy")
            assert 0.0 <= x <= width, (plot.name, text.text)
            assert 0.0 <= y <= height, (plot.name, text.text)
