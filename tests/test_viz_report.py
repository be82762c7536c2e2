"""The report: verdict first, every section there, numbers right, everything from files escaped, no scripts."""

import dataclasses
import hashlib
import re
from datetime import UTC, datetime

import numpy as np
import pytest
from markupsafe import escape
from viz_examples import measurements, medrue_fit, medrue_robot

import calib
import viz
from viz.poses import from_fit
from viz.report_page import command_line, millimetres, number, report_page

NOON = datetime(2026, 1, 2, 12, 0, tzinfo=UTC)


@pytest.fixture(scope="module")
def fit():
    return medrue_fit()


@pytest.fixture(scope="module")
def html(fit):
    return report_page(fit, command="calib fit a.yaml b.csv --out c", seed=7, created=NOON).html


def text(html):
    return " ".join(re.sub(r"<[^>]+>", " ", re.sub(r"<(svg|style).*?</\1>", " ", html, flags=re.S)).split())


def test_the_verdict_comes_first_and_with_the_accuracy(html, fit):
    first = text(html)[:700]
    after = fit.validation.table()["after"]
    assert f"Verdict: {fit.verdict.grade}" in first
    assert millimetres(after["mean"]) in first
    assert "47 poses (validation)" in first


def test_every_section_is_there(html):
    for heading in (
        "What was calibrated, with what",
        "Accuracy before and after",
        "Parameters",
        "What could not be identified",
        "Outliers",
        "Where this comes from",
    ):
        assert heading in html
    assert html.count("<figure") == 5


def test_without_validation_the_report_says_so():
    html = report_page(medrue_fit(validation=None), created=NOON).html
    assert "No poses were kept for validation" in html
    assert "84 poses (identification)" in html


def test_parameters_stand_with_their_intervals_and_held_ones_without(html, fit):
    rows = {
        name: re.sub(r"<[^>]+>", " ", row).split()
        for name, row in re.findall(r'<tr><th scope="row">(\w+)</th>(<td class="left">(?:mm|deg)</td>.*?)</tr>', html)
    }
    assert set(rows) == {parameter.name for parameter in fit.nominal.parameters}
    by_name = dict(zip([p.name for p in fit.nominal.parameters], fit.robot.values, strict=True))
    assert rows["L11"][2] == number(1e3 * by_name["L11"])
    assert rows["d31"][-1] == "held"
    assert rows["d31"][4:7] == ["–", "–", "–"]


def test_what_is_held_is_named(html, fit):
    assert ", ".join(fit.nominal.description.held) in html


def spoiled_measurements():
    data = measurements(range(0, 420, 5))
    positions = data.positions.copy()
    positions[10, 0, 2] += 1e-3
    return dataclasses.replace(data, positions=positions)


def test_outliers_are_listed_and_the_verdict_says_why():
    fit = calib.fit(medrue_robot(), spoiled_measurements())
    html = report_page(fit, created=NOON).html
    section = html[html.index('id="outliers"') :]
    assert re.search(r'<th scope="row">50</th><td class="left">identification</td>', section)
    assert "None was left out" in section
    assert fit.verdict.grade == "CHECK"
    assert "Verdict: CHECK" in text(html)[:300]
    assert all(str(escape(reason.text)) in html for reason in fit.verdict.reasons)


def test_outliers_that_were_left_out_are_listed_and_both_results_shown():
    fit = calib.fit(medrue_robot(), spoiled_measurements(), exclude_outliers=True)
    html = report_page(fit, created=NOON).html
    assert re.search(r'<th scope="row">50</th><td class="left">left out</td>', html)
    assert "with outliers (84)" in html


def test_cross_validation_is_shown_and_judged_by():
    html = report_page(calib.fit(medrue_robot(), measurements(range(0, 420, 5)), folds=3), created=NOON).html
    assert "left out in turns (84)" in html
    assert "84 poses (left out in turns)" in text(html)[:700]


def test_provenance_names_versions_files_command_and_seed(html, fit):
    assert hashlib.sha256(fit.nominal.urdf.source).hexdigest() in html
    for part in ("numpy", "Python", "calib fit a.yaml b.csv --out c", "no file to hash", "2026-01-02 12:00 UTC"):
        assert part in html
    assert re.search(r"Seed</th><td>7</td>", html)


def test_the_report_has_no_scripts_and_asks_nobody(html):
    assert "<script" not in html
    assert "default-src 'none'" in html
    assert not re.search(r"""(?:src|href)\s*=\s*["']?(?!["']?(?:data:|#))""", html)


def test_everything_from_files_is_escaped(fit):
    hostile = '<script>alert("x")</script>'
    data = dataclasses.replace(fit.identification.data, path=hostile)
    spoiled = dataclasses.replace(
        fit, identification=dataclasses.replace(fit.identification, data=data), message=hostile
    )
    html = report_page(spoiled, command=hostile, created=NOON).html
    assert "<script" not in html
    assert "&lt;script&gt;" in html


def test_tables_have_headers_and_the_page_a_language(html):
    assert '<html lang="en">' in html
    assert html.count("<th scope=") > 40
    assert html.count('role="img" aria-label=') == 5


def test_the_same_fit_gives_the_same_report(fit):
    assert report_page(fit, created=NOON).html == report_page(fit, created=NOON).html


def test_the_report_is_reached_from_the_package(fit, tmp_path):
    for _ in range(2):  # a module of the same name must not hide the function
        path = viz.report(fit).save(tmp_path / "report.html")
    assert "Calibration report: medrue" in path.read_text(encoding="utf-8")


def test_uncertainty_of_predictions_is_stated(html, fit):
    spread = 1e3 * np.linalg.norm(from_fit(fit).spread[:84], axis=1)
    assert f"{millimetres(spread.mean())} mm on average" in text(html)


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0.01234, "0.0123"),
        (0.1234, "0.123"),
        (1.234, "1.23"),
        (-12.34, "−12.3"),
        (float("nan"), "–"),
        (float("inf"), "–"),
    ],
)
def test_lengths_show_three_digits(value, shown):
    assert millimetres(value) == shown


@pytest.mark.parametrize(
    ("arguments", "shown"),
    [
        (["/usr/bin/calib", "fit", "a b.csv"], "calib fit 'a b.csv'"),
        (["/x/calib/__main__.py", "fit"], "python -m calib fit"),
        (["/usr/lib/ipykernel_launcher.py", "-f", "secret.json"], ""),
        ([], ""),
    ],
)
def test_only_our_own_command_lines_are_printed(monkeypatch, arguments, shown):
    monkeypatch.setattr("sys.argv", arguments)
    assert command_line() == shown
