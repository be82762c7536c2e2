"""The report: verdict first, every section there, numbers right, everything from files escaped."""

import base64
import dataclasses
import gzip
import hashlib
import re

import numpy as np
import pytest
from markupsafe import escape
from scipy.spatial.transform import Rotation

import calib
import viz
from calib.core.base.files import image_address
from calib.core.judging.error_budget import CauseShare
from calib.core.judging.findings import joint_budget
from calib.core.judging.next_step import next_step
from tests.project import EXAMPLES
from tests.six_axis_arm import FREE, YAML, joints, write_six_axis
from tests.small_robots import ARM_YAML, write_arm
from tests.viz.viz_examples import (
    NOON,
    five_bar_fit,
    measurements,
    medrue_fit,
    medrue_robot,
    outside_addresses,
    spoiled,
    spoiled_fit,
    undrawn,
    words_of,
)
from viz.error_charts import _cells, _views, conditions, error_charts, page_rows
from viz.joint_charts import corrections, dials
from viz.judgement import following_words, judgement_of_result, robot_to_load
from viz.pose_sources import from_fit
from viz.report_page import (
    command_line,
    decimals_of,
    millimetres,
    number,
    powers,
    report_page,
    significant,
    unbroken,
)
from viz.report_tables import worst, worst_joint, worst_joints
from viz.result_charts import joint_shares, parameters, waterfall
from viz.scene import joints_of, scene_of_fit

COMMAND = "calib fit a.yaml b.csv --out c"
OF_ALL = "(95 %) of the squared error before calibration"
EITHER = "The interval of a contains the share of b: either may be the worst"
PERHAPS_NONE = "this joint may have no error"


@pytest.fixture(scope="module")
def html(fit):
    return report_page(fit, command=COMMAND, created=NOON).html


def test_the_verdict_comes_first_and_with_the_accuracy(html, fit):
    first = words_of(html)[:700]
    after = fit.validation.table()["after"]
    assert f"Verdict: {fit.verdict.grade}" in first
    assert millimetres(after["rms"]) in first
    assert f"-> {after['rms']:.4f} " in fit.report()  # the same figure in the terminal
    assert f"47 poses (validation); 95 % of them are within {millimetres(after['p95'])} mm." in first
    assert "measured (each predicted from the others)" in first


def test_without_validation_the_report_says_so():
    html = undrawn(medrue_fit(validation=None))
    assert "No poses were kept for validation" in html
    assert "84 poses (identification)." in html  # errors of poses that were used are no claim


def test_parameters_stand_with_their_intervals_and_held_ones_without(html, fit):
    rows = {
        name: re.sub(r"<[^>]+>", " ", row).split()
        for name, row in re.findall(r'<tr><th scope="row">(\w+)</th>(<td class="left">(?:mm|deg)</td>.*?)</tr>', html)
    }
    assert set(rows) == {parameter.name for parameter in fit.nominal.parameters}
    by_name = dict(zip([p.name for p in fit.nominal.parameters], fit.robot.values, strict=True))
    value, _, std, low, high = rows["L11"][2:7]
    assert len(std.replace(".", "").lstrip("0")) == 2  # significant digits
    assert value == f"{1e3 * by_name['L11']:.{len(std.partition('.')[2])}f}"
    assert len({len(text.partition(".")[2]) for text in (value, std, low, high)}) == 1
    assert rows["d31"][-1] == "held"
    assert rows["d31"][4:7] == ["–", "–", "–"]


def test_outliers_are_listed_and_the_verdict_says_why():
    fit = spoiled_fit()
    html = undrawn(fit)
    section = html[html.index('id="outliers"') :]
    assert re.search(r'<th scope="row">50</th><td class="left">identification</td>', section)
    assert "None was left out" in section
    assert "leverage" not in html
    assert fit.verdict.grade == "CHECK"
    assert "Verdict: CHECK" in words_of(html)[:300]
    assert all(str(unbroken(reason.text)) in html for reason in fit.verdict.reasons)
    assert "Next: fit again without the outliers Robot and errors" in words_of(html)
    assert "pose 50 (an outlier), at x " in words_of(html)
    others = len(fit.verdict.reasons) - 1
    assert re.search(rf"\b{others} more reasons? below", words_of(html))


def test_outliers_that_were_left_out_are_listed_and_both_results_shown():
    data = spoiled(measurements(range(0, 420, 5)))
    data = dataclasses.replace(data, labels=tuple(f"a.csv, line {int(k) + 2} (pose {k})" for k in data.names))
    fit = calib.fit(medrue_robot(), data, exclude_outliers=True)
    html = undrawn(fit)
    assert re.search(r'<th scope="row">50</th><td class="left">left out</td>.*>a\.csv, line 52</td></tr>', html)
    assert "Left out as outliers : 1 of 84 readings." in words_of(html).split("Robot and errors")[0]
    assert "fit pulled by outliers, after 84" in words_of(html)


@pytest.mark.quick(0)
def test_cross_validation_is_shown_and_judged_by():
    words = words_of(undrawn(calib.fit(medrue_robot(), measurements(range(0, 420, 5)), folds=3)))
    assert "left out in turn, after 84" in words
    assert "84 poses (left out in turn)" in words[:700]


def test_provenance_names_versions_files_command_and_seed(html, fit):
    assert hashlib.sha256(fit.nominal.urdf.source).hexdigest() in html
    for part in ("numpy", "Python", COMMAND, "no file to hash", "2026-01-02 12:00 UTC"):
        assert part in words_of(html)
    assert '<span class="option">--out</span>' in html  # not broken after its hyphens
    assert re.search(r"Seed</th><td>0, of every random choice", html)


def test_a_fit_from_python_says_so_and_has_its_seed(fit):
    html = undrawn(dataclasses.replace(fit, seed=12))
    assert "made by a program in Python" in html
    assert re.search(r"Seed</th><td>12, of every random choice of the fit</td>", html)


def test_only_the_page_s_own_scripts_run_and_nobody_is_asked(html):
    (allowed,) = re.findall(r"script-src ([^;]*);", html)
    digests = set(re.findall(r"sha256-([^']+)", allowed))
    own = re.findall(r"<script>(.*?)</script>", html, re.S)
    libraries = [unpack(html, name) for name in ("bokeh", "bokeh-api")]
    inside = re.findall(r"<script>(.*?)</script>", unpack(html, "viewer-page"), re.S)
    for script in (*own, *libraries, *inside):
        assert base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() in digests
    assert len(digests) == len(own) + len(libraries) + len(inside) == 5
    assert "default-src 'none'" in html
    assert outside_addresses(html) == []


def unpack(html, name):
    """What a page holds compressed."""
    packed = re.search(rf'<script type="text/plain" id="{name}">(.*?)</script>', html, re.S)[1]
    return gzip.decompress(base64.b64decode(packed)).decode()


def test_everything_from_files_is_escaped(fit):
    hostile = '<script>alert("x")</script>'
    data = dataclasses.replace(fit.identification.data, path=hostile)
    end = dataclasses.replace(fit.convergence, message=hostile)
    named = dataclasses.replace(fit, identification=dataclasses.replace(fit.identification, data=data), convergence=end)
    html = undrawn(named, command=hostile)
    assert "alert" not in re.sub(r"&lt;script&gt;alert\(&#34;x&#34;\)&lt;/script&gt;", "", html)
    assert "&lt;script&gt;" in html


def test_tables_have_headers_and_the_page_a_language(html):
    assert '<html lang="en">' in html
    assert html.count("<th scope=") > 40
    assert html.count("Numbers of this plot") == 9


def test_the_same_fit_gives_the_same_report_which_is_reached_from_the_package(fit, html, tmp_path):
    assert report_page(fit, command=COMMAND, created=NOON).html == html
    for _ in range(2):  # a module of the same name must not hide the function
        path = viz.report(fit).save(tmp_path / "report.html")
    assert "Calibration report: medrue" in path.read_text(encoding="utf-8")


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


def test_page_one_says_where_it_is_worst_and_was_measured_and_the_annex_how_sure_that_is(html, fit):
    first, annex = words_of(html).split("Annex:")
    validation = fit.validation
    row = int(np.argmax(np.linalg.norm(validation.after["tool"], axis=1)))
    assert f"pose {validation.data.names[row]}, at x" in first
    assert millimetres(fit.validation_uncertainty.summary()["max"]) in annex
    spread = 1e3 * np.linalg.norm(from_fit(fit).spread[84:], axis=1)  # of the validation poses
    assert f"{millimetres(spread.mean())} mm on average" in annex
    assert f"noise of one reading {millimetres(1e3 * fit.sigma)} mm per axis (" in annex
    assert "degrees of freedom" not in first
    assert "rank" not in first.lower()
    points = 1e3 * np.concatenate([errors.data.readings["tool"].values for errors in (fit.identification, validation)])
    assert f"x {points[:, 0].min():.0f} to {points[:, 0].max():.0f}".replace("-", "−") in first


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("base", "name"),
    [
        ({}, "world"),
        ({"pose": "unknown"}, "the measurement frame"),
        ({"xyz": (0.1, 0.0, 0.0)}, "the measurement frame"),
        ({"rpy": (0.0, 0.0, 0.1)}, "the measurement frame"),
    ],
)
def test_coordinates_are_said_to_be_in_a_link_only_where_they_are(fit, base, name):
    description = fit.nominal.description
    description = description.model_copy(update={"base": description.base.model_copy(update=base)})
    nominal = dataclasses.replace(fit.nominal, description=description)
    page = words_of(undrawn(dataclasses.replace(fit, nominal=nominal)))
    assert f"mm in {name} " in page
    assert f"Measured points tool, in {name} " in page


def with_comments(fit, *comments, **context):
    """The same fit, of a file that says more about itself."""
    data = dataclasses.replace(fit.identification.data, comments=comments, context=context)
    return dataclasses.replace(fit, identification=dataclasses.replace(fit.identification, data=data))


@pytest.mark.quick(0)
def test_what_the_file_says_about_itself_stands_above_the_verdict_and_simulation_first(fit):
    lines = ("Taken on a Monday.", "Simulated measurements; <b>no real robot</b> was measured.")
    html = undrawn(with_comments(fit, *lines))
    assert 'class="remarks simulated"' in html
    shown = html[html.index('class="remarks') : html.index('class="verdict')]
    assert shown.index("Simulated measurements; &lt;b&gt;no real robot") < shown.index("Taken on a Monday")
    assert 'class="remarks"' in undrawn(with_comments(fit, "Taken on a Monday."))
    assert 'class="remarks' not in undrawn(fit)


def test_comments_without_end_do_not_bury_the_report(fit):
    html = undrawn(with_comments(fit, *(f"{k}: " + 1000 * "word " for k in range(200))))
    shown = words_of(html)
    assert "and 194 more lines" in shown
    assert shown.index("Verdict:") < 2500


def test_the_record_of_the_measurement_stands_in_the_table_and_nowhere_else(fit):
    hostile = "<i>MR-0042</i>"
    said = {"Serial number": hostile, "instrument": "tracker 7", "operator": "J. Doe", "temperature": "21 degC"}
    lines = (f"{label}: {value}" for label, value in said.items())
    html = undrawn(with_comments(fit, "simulated", *lines, "signatures: Measured by; Approved by"))
    for label, value in said.items():
        assert f'<tr><th scope="row">{label.capitalize()}</th><td>{escape(value)}</td></tr>' in html
        assert html.count(str(escape(value))) == 1
    assert re.findall(r"<p><span>(.*?)</span>", html) == ["Measured by", "Approved by"]


@pytest.mark.quick(0)
@pytest.mark.parametrize(("tolerance", "answer"), [("5 mm", "met"), ("0.001 mm", "not met")])
def test_a_tolerance_that_was_asked_is_answered_on_page_one(fit, html, tolerance, answer):
    page = words_of(undrawn(with_comments(fit, f"tolerance: {tolerance}")))
    words = f"Tolerance {tolerance}: {answer} 95 of 100 positions are within "
    assert words in page.split("What was calibrated")[0]
    assert "Asked" not in words_of(html)


def charts_of(fit):
    """The plots of a fit's errors by name, their layers with marks, and what the page knows of its rows."""
    scene = scene_of_fit(fit)
    return {chart.name: chart for chart in error_charts(fit, scene)}, page_rows(scene)


def test_every_plot_of_errors_has_a_mark_for_each_pose_which_knows_its_row(fit):
    charts, rows = charts_of(fit)
    n = len(fit.identification.data) + len(fit.validation.data)
    assert len(rows.texts) == len(set(rows.poses)) == n
    assert list(charts) == ["errors", "order", "planes", "by-joint"]
    after = fit.validation.after["tool"]
    row = len(fit.identification.data) + int(np.argmax(np.linalg.norm(after, axis=1)))
    size = 1e3 * np.linalg.norm(after, axis=1).max()
    name = fit.validation.data.names[row - len(fit.identification.data)]
    assert rows.texts[row].startswith(f"pose {name} (validation)")
    assert f"{size:.3g} mm after" in rows.texts[row]
    for chart in charts.values():
        for panel in chart.panels:
            marks = [layer for layer in panel["layers"] if "rows" in layer]
            assert marks
            assert all(sorted(layer["rows"]) == list(range(n)) for layer in marks)
    drawn = charts["errors"].panels[0]["layers"][3]  # points after calibration
    largest = np.linalg.norm(np.vstack([fit.identification.after["tool"], after]), axis=1).max()
    assert max(drawn["x"]) == pytest.approx(1e3 * largest, rel=1e-4)  # five digits are drawn
    assert drawn["y"][-1] == 100.0


@pytest.mark.parametrize(("tilt", "more"), [(0.5, ["on the measured surface"]), (0.0, [])])
def test_places_on_a_tilted_plane_are_also_seen_in_that_plane(tilt, more):
    flat = np.random.default_rng(2).uniform(-100, 100, (40, 3)) * [3, 1, 0.01]
    tilted = flat @ Rotation.from_euler("x", tilt).as_matrix().T + [500, 0, 200]
    views = _views(tilted)
    assert [view[0] for view in views][3:] == more
    for _, _, _, along, across in views[3:]:
        apart = np.stack([along, across], axis=1)
        np.testing.assert_allclose(
            np.linalg.norm(apart[1:] - apart[0], axis=1), np.linalg.norm(flat[1:] - flat[0], axis=1), atol=0.5
        )  # as far apart as in space


@pytest.mark.quick(0)
def test_outliers_have_a_mark_of_their_own_in_every_plot():
    for options, own, words in (
        ({}, "x", "identification, outlier)"),
        ({"exclude_outliers": True}, "cross", "left out"),
    ):
        _, rows = charts_of(spoiled_fit(**options))
        (bad,) = (text for text, mark in zip(rows.texts, rows.marks, strict=True) if mark == own)
        assert bad.startswith(f"pose 50 ({words}")


def test_outliers_do_not_hide_what_is_left_at_the_joints_nor_colour_a_square():
    charts, _ = charts_of(spoiled_fit())
    for panel in charts["by-joint"].panels:
        low, high = panel["y"]["ends"]
        sizes = sorted(abs(y) for layer in panel["layers"] if layer["kind"] == "points" for y in layer["y"])
        assert panel["y"]["beyond"]
        assert -low == high
        assert sizes[-2] < high < 2 * sizes[-2] < sizes[-1]  # all but the spoiled reading, and not much more
    for panel in charts["planes"].panels:
        cells, points = panel["layers"]
        assert max(float(text.split()[3]) for text in cells["texts"]) < 0.3  # mm; the spoiled reading is 1 mm off
        assert len(points["x"]) == 84  # and is drawn


def test_a_cause_that_makes_the_error_larger_has_a_bar_back(fit, monkeypatch):
    """Made up: 4 = 2 + 1.5 - 1 + 1.5 mm^2 of four causes."""
    causes = [{"cause": name, "mean_square": part, "rms": 1.0, "share": 0.1, "remark": ""}
              for name, part in zip("abcd", (2.0, 1.5, -1.0, 1.5), strict=True)]  # fmt: skip
    monkeypatch.setattr("viz.result_charts.budget_table", lambda _: {"causes": causes, "unit": "mm", "rms_before": 2.0})
    chart = waterfall(fit)
    down, up = chart.panels[0]["layers"]
    assert down["right"][0] == pytest.approx(2.0)
    assert np.square(down["right"]) - np.square(down["left"]) == pytest.approx([2.0, 1.5, 1.5], abs=1e-3)
    assert np.square(up["right"]) - np.square(up["left"]) == pytest.approx([1.0], abs=1e-3)
    assert (down["y"], up["y"]) == ([0, 1, 3], [2])
    assert down["colour"] != up["colour"]
    assert "makes the error larger" in chart.text


@pytest.mark.parametrize(
    ("grade", "start", "end"),
    [
        ("PASS", "calibrated.urdf: as accurate as the whole model; beside this page", "see calib export --help"),
        ("CHECK", "calibrated.urdf: as accurate as the whole model; beside this page", "; preliminary: see Next"),
        ("FAIL", "none: the verdict is FAIL", "(--force writes calibrated.urdf)"),
    ],
)
def test_the_page_names_the_file_to_load(fit, monkeypatch, grade, start, end):
    made = dataclasses.replace(fit.verdict, grade=grade)
    monkeypatch.setattr("viz.judgement.judge", lambda _: made)
    words = robot_to_load(fit)
    assert words.startswith(start)
    assert words.endswith(end)
    assert f"Robot to load {start}" in words_of(undrawn(fit))


def test_squares_of_the_workspace_lie_around_their_places():
    columns = [[500.0, 700.0], [100.0, 100.0], [1.0, 3.0]]
    assert [column.tolist() for column in _cells(*map(np.array, columns))[:3]] == columns


def test_causes_of_the_error_fall_from_the_error_before_to_zero(fit):
    (panel,) = waterfall(fit).panels
    (bars,) = panel["layers"]
    assert bars["left"][-1] == 0.0
    assert bars["left"][:-1] == bars["right"][1:]
    squares = np.square(bars["right"]) - np.square(bars["left"])
    assert np.sqrt(squares.sum()) == pytest.approx(bars["right"][0])


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        (((0.6, 0.1), (0.2, 0.1)), f"a 60 % ± 20 % {OF_ALL}; next b 20 % ± 20 %"),
        (((0.3, 0.1), (0.2, 0.1)), f"a 30 % ± 20 % {OF_ALL}; next b 20 % ± 20 %. {EITHER}"),  # 10 to 50 %, and 20 %
        (((0.1, 0.1), (-0.2, 0.1)), f"a 10 % ± 20 % {OF_ALL}. The interval of a contains zero: {PERHAPS_NONE}"),
        (((0.3, 0.1), (-0.2, 0.1)), f"a 30 % ± 20 % {OF_ALL}"),
    ],
)
def test_a_joint_is_worst_only_where_its_interval_lies_above_the_next(fit, monkeypatch, parts, words):
    shares = tuple(CauseShare(name, part, std) for name, (part, std) in zip("ab", parts, strict=True))
    made = dataclasses.replace(joint_budget(fit), before=1.0, shares=shares)
    monkeypatch.setattr("calib.core.judging.findings.joint_budget", lambda _: made)
    assert worst_joint(fit) == words


def test_the_page_alone_answers_ten_questions(fit, html):
    shown, worst = words_of(html), worst_joints(joint_budget(fit))
    biggest = max(fit.validation.after["tool"].tolist(), key=np.linalg.norm)
    at = np.linalg.norm(fit.validation.after["tool"], axis=1).argmax()
    claim = fit.verdict.claim.at_measured_poses
    answers = {
        "is it good enough": rf"Verdict: {fit.verdict.grade} .*? within {claim.in_unit(claim.limit95)} of where",
        "how far off, before and after": r"[\d.]+ → [\d.]+ mm Position error \(RMS\) before and after calibration",
        "which joint is worst": rf"Worst joint {worst[0].cause} [\d.]+ % ± [\d.]+ % .*;"
        rf" next {worst[1].cause}",
        "where is it worst": rf"Largest error \(validation\) {millimetres(1e3 * np.linalg.norm(biggest))} mm: pose"
        rf" {fit.validation.data.names[at]}, at",
        "which reading is wrong": r"Outliers None: no point lies further off than noise explains",
        "what is next": rf"Next: {re.escape(following_words(fit, COMMAND))}",
        "where was it measured": r"Where it was measured x .* mm in",
        "how sure is that": r"predicted positions are known to [\d.]+ mm on average, [\d.]+ mm at worst",
        "which file is to be loaded": r"Robot to load calibrated\.urdf",
        "what is left, and why": r"not explained [\d.]+ .* The rest is no larger than the stated noise",
        "what is not known": r"What could not be identified .*? held at nominal .*?\bd31\b",
    }
    assert {question for question, words in answers.items() if not re.search(words, shown)} == set()


def test_joints_are_ranked_by_what_they_make_of_the_error(fit):
    names = [name for panel in joint_shares(fit).panels for name in panel["y"]["names"]]
    assert names == [share.cause for share in worst_joints(joint_budget(fit))]
    assert {"q2", "q3", "q4", "q5", "q6"} <= set(names)


def test_readings_show_the_error_that_was_fitted_to_a_joint(tmp_path):
    """Simulated: a gain alone. The curve is the true one, and what readings show scatters about it."""
    fit = fit_with_term(tmp_path, "gain, sigma: 2 mrad", gain=2e-3)
    (panel,) = corrections(fit, joints_of(fit.nominal)).panels
    shown, fitted = panel["layers"]
    assert (shown["kind"], fitted["kind"]) == ("points", "line")
    expected = 2e-3 * np.array(fitted["x"])  # [deg], of a command in deg
    offset = np.mean(np.array(fitted["y"]) - expected)  # what an offset of the joint takes up
    np.testing.assert_allclose(fitted["y"], expected + offset, atol=2e-2)
    known = np.array([y is not None for y in shown["y"]])
    apart = np.array([y for y in shown["y"] if y is not None]) - np.array(fitted["y"])[known]
    assert 0 < np.abs(apart).max() < 0.05


def test_the_few_largest_errors_do_not_stretch_the_colours_over_the_workspace(fit):
    chart = charts_of(fit)[0]["planes"]
    sizes = 1e3 * np.linalg.norm(np.vstack([fit.identification.after["tool"], fit.validation.after["tool"]]), axis=1)
    assert f"({np.quantile(sizes, 0.95):.3g} mm and more)" in chart.text
    painted = [layer["colours"] for panel in chart.panels for layer in panel["layers"] if layer["kind"] == "points"]
    assert all(colours.count("#fde725") == np.sum(sizes > np.quantile(sizes, 0.95)) for colours in painted)


def test_offsets_of_joints_are_dials_and_say_their_interval():
    fit = five_bar_fit()
    drawn = dials(fit)
    for panel in drawn.panels:
        name = panel["title"].split()[0]
        estimate = fit.parameters[name]
        (needle,) = (layer for layer in panel["layers"] if layer["kind"] == "points")
        assert needle["texts"][0].startswith(f"{name}: {estimate.value - estimate.nominal:+.4f}")
        assert panel["bare"]
        assert estimate.status not in ("prior", "held")
    assert 'Offsets of status "prior" or "held" have no dial' in drawn.text
    assert {panel["title"].split()[0] for panel in drawn.panels} >= {"left_motor.rz", "right_motor.rz"}


def test_the_forest_has_every_free_parameter_and_its_interval_in_expected_deviations(fit):
    shown = {}
    for panel in parameters(fit).panels:
        points = next(layer for layer in panel["layers"] if layer["kind"] == "points")
        shown |= dict(zip(panel["y"]["names"], points["x"], strict=True))
    sigma = {p.name: p.sigma for p in fit.nominal.parameters}
    estimate = fit.parameters["L11"]
    assert shown["L11"] == pytest.approx((estimate.value - estimate.nominal) / sigma["L11"], rel=1e-4)
    assert len({tuple(panel["x"]["ends"]) for panel in parameters(fit).panels}) == 1  # one scale
    assert "d31" not in shown  # held


def fit_with_term(folder, term, **truth):
    """A fit of the small arm with a term of its first joint, whose true coefficients are these."""
    robot = calib.load(write_arm(folder, f"{ARM_YAML}  - {{joint: turn, term: {term}}}\nsigma: 20 um\n"))
    true = robot.with_parameters({f"turn.{name}": value for name, value in truth.items()})
    q = np.random.default_rng(3).uniform([-1.5, 0, -1.5], [1.5, 0.5, 1.5], (80, 3))
    noise = np.random.default_rng(4).normal(0, 2e-5, (80, 1, 3))
    return calib.fit(robot, calib.as_measurements(robot, q, true.positions(q) + noise))


def test_coefficients_of_curves_are_no_lines_of_the_forest(tmp_path):
    fit = fit_with_term(tmp_path, "curve, sigma: 1 mrad")
    names = [name for panel in parameters(fit).panels for name in panel["y"]["names"]]
    assert any(name.startswith("turn.curve") for name in fit.free_names)
    assert not any("curve" in name for name in names)
    assert "Coefficients of curves are left out" in parameters(fit).text


def test_times_since_1970_are_drawn_from_the_first_pose_on(fit):
    n = len(fit.identification.data)
    timed = with_comments(fit, time=1.7e9 + 30.0 * np.arange(n))
    (panel,) = conditions(timed, scene_of_fit(timed)).panels
    assert panel["y"]["label"] == "time [min]"
    np.testing.assert_allclose(panel["layers"][0]["y"], 0.5 * np.arange(n))


@pytest.mark.quick(0)
def test_a_column_of_temperatures_is_the_record_where_nothing_else_is_said(fit):
    n = len(fit.identification.data)
    html = undrawn(with_comments(fit, temperature=np.linspace(20.04, 22.3, n)))
    assert "20.0 to 22.3 degC" in html
    assert 'class="signatures"' not in html


@pytest.mark.quick(0)
def test_what_files_are_worth_stands_in_the_verdict_where_they_hold_less(tmp_path, html):
    arm = calib.load(write_six_axis(tmp_path, YAML + FREE + "  - {joint: all, term: gain, sigma: 0.01}\n"))
    noise = 2e-5 * np.random.default_rng(1).standard_normal((60, 1, 3))
    fit = calib.fit(arm, joints(60), arm.with_terms(()).positions(1.01 * joints(60)) + noise)
    page = words_of(undrawn(fit))
    start, table = page.index("What files are worth"), page.index("Accuracy before and after")
    assert page.index("Annex:") < start < table
    for holds, words in ((calib.Holds.ORIGINS, "joint origins"), (calib.Holds.EVERYTHING, "the whole model")):
        worth = fit.robot.files[holds].accuracy
        assert f"{words} {millimetres(1e3 * worth.rms)} {millimetres(1e3 * worth.limit95)}" in page[start:table]
    assert "60 poses left out one by one" in page[start:table]
    assert f"Robot to load calibrated.urdf: {fit.robot.files[calib.Holds.ORIGINS].accuracy.words}; beside" in page
    assert "What files are worth" not in words_of(html)  # whose files hold all


def test_nothing_is_told_twice(html):
    shown = re.sub(r"<svg.*?</svg>", "", html, flags=re.S)
    lines = re.findall(r"<(?:p|li|dd|td)[^>]*>(.*?)</(?:p|li|dd|td)>", shown, re.S)
    for words in ("positions are known", "Noise found", "poses alone", "more modelling"):
        told = [line for line in lines if words.lower() in line.lower()]
        assert len(told) <= 1, words
    assert sum("All 36 parameters, poses alone" in line for line in lines) == 1
    assert sum("no more than noise" in line or "more modelling" in line for line in lines) == 1


def test_the_logo_is_in_the_page_and_only_images_are_taken(fit, tmp_path):
    (tmp_path / "logo.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg"><script>alert(1)</script></svg>')
    html = undrawn(fit, logo=image_address(tmp_path / "logo.svg"))
    assert '<img class="logo" src="data:image/svg+xml;base64,' in html
    assert "<script" not in html
    for name, content, words in (
        ("a.png", b"GIF89a", "is not an image that a page can show"),
        ("a.svg", b"<?xml version='1.0'?><robot/>", "is not an image that a page can show"),
        ("b.png", b"\x89PNG\r\n\x1a\n" + bytes(2**20), "of at most 512 kB"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(calib.InputError, match=words):
            image_address(tmp_path / name)
    with pytest.raises(calib.InputError, match="no such file"):
        image_address(tmp_path / "none.png")


@pytest.mark.quick(0)
def test_what_to_type_next_names_the_files_of_the_command_line(fit):
    data = dataclasses.replace(fit.identification.data, path="my data.csv")
    named = dataclasses.replace(fit, identification=dataclasses.replace(fit.identification, data=data))
    command = f"calib fit {fit.nominal.path} 'my data.csv' --out out/mine"
    page = words_of(undrawn(named, command=command)).split("Next:")[1].split("Converged")[0]
    assert "out/mine" in page
    assert not re.search(r"\b(ROBOT|DATA|DIR)\b", page)


NAN = float("nan")
LENGTHS = [0.01234, 0.1234, 1.234, -12.34, NAN, float("inf"), -1e-9, 0.0]
PRINTED = [
    (decimals_of, [0.0123, 0.5, 1.0, 12.0, 4000.0, 1e-15, 0.0, NAN], [3, 2, 1, 0, 0, 9, 4, 4]),  # two digits, or four
    (millimetres, LENGTHS, ["0.0123", "0.123", "1.23", "−12.3", "–", "–", "0.0000", "0.0000"]),
    (number, [-1e-6, 0.0, -0.0, -0.00006], ["0.0000", "0.0000", "0.0000", "−0.0001"]),  # no zero has a sign
    (lambda value: significant(value, NAN), [31.0, 166.8, 1 / 3, NAN], ["31", "166.8", "0.3333", "–"]),
    (lambda value: significant(value, 0.02), [-0.0, 1.23456], ["0.000", "1.235"]),
    (lambda value: significant(value, 14.0), [409.018], ["409"]),
    (powers, ["O5 7.1e-05, a re-fit, 3e+02, joint_2-3"], ["O5 7.1e−05, a re-fit, 3e+02, joint_2-3"]),
]


@pytest.mark.parametrize(("printed", "values", "shown"), PRINTED)
def test_numbers_have_the_digits_that_their_standard_deviation_leaves_them(printed, values, shown):
    assert [printed(value) for value in values] == shown


def test_a_fit_made_in_python_has_no_command_with_placeholders(fit):
    step, said = next_step(fit), following_words(fit, "")
    assert "DIR" in str(step)
    assert said == step.aim.replace("DIR/", "")
    assert f"Next: {said} Robot and errors" in words_of(undrawn(fit))
    stored = judgement_of_result({"grade": "PASS", "reasons": []}, str(step))
    assert stored.following == said  # in the viewer of a result folder


def test_the_worst_pose_is_named_where_positions_show_no_points(monkeypatch):
    robot = calib.load(EXAMPLES / "arm.yaml")
    monkeypatch.setattr(type(robot.instruments[0]), "points", lambda self, values: None)
    fit = calib.fit(robot, EXAMPLES / "arm_simulated.csv")
    off = np.linalg.norm(fit.identification.after["reflector"], axis=1)
    assert worst(fit) == f"pose {fit.identification.data.names[np.argmax(off)]}"
