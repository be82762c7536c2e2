"""The page of results side by side: the numbers of the comparison, real differences marked, everything escaped."""

import dataclasses
import re

import numpy as np
import pytest

from calib.fleets.comparison_report import ComparedResult, Difference, Pair, ResultComparison
from tests.viz.viz_examples import NOON, outside_addresses
from viz.comparison_page import comparison_page, intervals

NAME = "out/<b>first</b>"


def row(value, half, status="identified"):
    std, low, high = 3 * [None] if half is None else (half / 2, value - half, value + half)
    return {"unit": "mm", "value": value, "std": std, "low95": low, "high95": high, "status": status}


@pytest.fixture
def comparison():
    on = "the same 3 readings not used"
    first = ComparedResult(NAME, f"/data/{NAME}", "PASS", 40, 0.05123, "mm", on, np.array([0.04, 0.05, 0.06]))
    second = ComparedResult("out/second", None, "CHECK", 50, 0.2, "mm", on, np.array([0.1, 0.2, 0.3]))
    return ResultComparison(
        (first, second),
        (
            Difference("elbow.x", (row(100.0, 0.02), row(100.5, 0.03)), (1e-6,)),
            Difference("wrist.x", (row(7.0, 0.02), row(7.001, 0.03)), (0.8,)),
            Difference("held.x", (row(3.0, None, "held"), None), (np.nan,)),
        ),
        (Pair((NAME, "out/second"), ("elbow.x",), (), 1e-5),),
        ("noise is independent",),
    )


def test_real_differences_are_marked_and_others_are_not(comparison):
    html = comparison_page(comparison, created=NOON).html
    rows = dict(re.findall(r'<tr[^>]*><th scope="row">([\w.]+)</th>(.*?)</tr>', html))
    assert rows["elbow.x"].count(" *") == 1
    assert "100.500 ± 0.030 *" in rows["elbow.x"]
    assert "*" not in rows["wrist.x"]
    assert "held" in rows["held.x"]
    assert "–" in rows["held.x"]
    assert "out/&lt;b&gt;first&lt;/b&gt; and out/second: 1 parameter of the robot differs, elbow.x (all" in html
    assert "noise is independent" in html


def test_without_a_test_the_page_has_no_answer_but_the_note(comparison):
    differences = tuple(dataclasses.replace(each, p_values=(np.nan,)) for each in comparison.differences)
    pairs = (Pair(comparison.names, (), (), np.nan, tested=False),)
    untested = dataclasses.replace(comparison, differences=differences, pairs=pairs)
    html = comparison_page(untested, created=NOON).html
    (answer,) = re.findall(r'<h2 id="answer">(.*?)</section>', html, re.S)
    assert re.findall(r"<p.*?>(.*?)</p>", answer) == ["noise is independent"]
    assert "marks" not in intervals(untested, untested.rank_differences()).text


def test_errors_on_the_same_readings_are_drawn_where_there_are_any(comparison):
    html = comparison_page(comparison, created=NOON).html
    assert 'id="same-rows"' in html
    assert 'id="intervals"' in html
    own = {"on": "readings that it did not use", "sizes": np.zeros(0)}
    results = tuple(dataclasses.replace(each, **own) for each in comparison.results)
    html = comparison_page(dataclasses.replace(comparison, results=results), created=NOON).html
    assert 'id="same-rows"' not in html
    assert "readings that it did not use" in html
    held = dataclasses.replace(comparison, differences=comparison.differences[2:])
    assert 'id="intervals"' not in comparison_page(held, created=NOON).html


def test_a_base_put_elsewhere_does_not_hide_differences_of_the_robot(comparison):
    moved = Difference("base.x", (row(0.0, 0.02), row(500.0, 0.03)), (1e-9,), is_place=True)
    both = dataclasses.replace(comparison, differences=(*comparison.differences, moved))
    alone, shown = (intervals(one, one.rank_differences()) for one in (comparison, both))
    assert shown.panels == alone.panels
    places = dataclasses.replace(comparison, differences=(moved,))
    assert intervals(places, [moved]).panels[0]["y"]["names"] == ["base.x *"]


def test_it_asks_nobody_and_escapes_names(comparison):
    html = comparison_page(comparison, created=NOON, command="calib compare '<script>'").html
    assert "'<script>'" not in html
    assert "<b>first" not in html
    assert outside_addresses(html) == []
    assert html == comparison_page(comparison, created=NOON, command="calib compare '<script>'").html


def test_three_results_have_three_columns(comparison):
    old = comparison.differences
    differences = tuple(Difference(each.name, (*each.rows, each.rows[0]), (*each.p_values, 0.9)) for each in old)
    pairs = (*comparison.pairs, Pair(comparison.names, (), (), 0.5))
    three = ResultComparison((*comparison.results, comparison.results[-1]), differences, pairs, ())
    html = comparison_page(three, created=NOON).html
    assert "&lt;0.0001, 0.9" in html
    assert html.count('<th scope="col">out/second</th>') == 2
