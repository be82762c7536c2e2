"""The package of docs/own_package, installed beside calib: its kinds and its joint terms in every command."""

import importlib
import json
import os
import subprocess
import sys
import tomllib
from dataclasses import replace

import numpy as np
import pytest
import yaml

import calib
import viz
from calib import extend
from calib.core.base.registry import Registry
from calib.core.data.measurement_files import format_measurements
from calib.core.data.measurements import directions_of_motion
from calib.core.fitting.terms.candidate_terms import candidates
from calib.core.instruments.kind import View
from calib.core.instruments.kinds import KINDS
from calib.core.judging.verdict import judge
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.file_formats import formats_that_hold
from calib.core.robots.terms.term import Context, Joint, JointTerm
from calib.core.robots.terms.terms import TERMS, parse_terms
from calib.extend import check_kind, check_term
from calib.planning.pose_sampling import visible_poses
from calib.starting.descriptions import schema_text
from tests.project import EXAMPLES, ROOT
from tests.small_robots import write_arm
from viz.scene import other_errors

PACKAGE = ROOT / "docs" / "own_package"
STATIONS = {"east": ("2.5 m, 0.2 m, 0.4 m", 0.7), "north": ("0.3 m, 2.8 m, 0.5 m", -1.9)}
"""Of each theodolite where it is said to be, and its true heading [rad]."""
THEODOLITES = "\n".join(
    f"  {name}: {{kind: theodolite, target: prism, station: {{frame: base_link, xyz: [{xyz}]}},"
    " sigma_station: 20 mm, sigma: 0.01 mrad}"
    for name, (xyz, _) in STATIONS.items()
)
BEAMS = {"low": ("0.45 m, -0.5 m, 0.3 m", "-90 deg, 0, 0"), "high": ("-0.2 m, 0.3 m, 0.55 m", "0, 90 deg, 0")}
"""Of each laser line where it begins, and its direction."""
LASER_LINES = "\n".join(
    f"  {name}: {{kind: laser_line, target: chip, beam: {{frame: base_link, xyz: [{xyz}], rpy: [{rpy}]}},"
    " sigma_beam: 2 mm, reach: [0.2 m, 0.8 m], sigma: 0.01 mm}"
    for name, (xyz, rpy) in BEAMS.items()
)
ON_THE_FLANGE = "frame: flange, xyz: [20 mm, 0 mm, 50 mm], position: unknown, sigma: 1 mm"
YAML = f"""\
urdf: arm.urdf
name_mot: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]
base: {{frame: base_link}}
targets:
  prism: {{{ON_THE_FLANGE}}}
instruments:
{THEODOLITES}
parametrisation:
  - {{origin: all, components: [x, y, z], sigma: 0.3 mm}}
  - {{origin: all, components: [rx, ry, rz], sigma: 1 mrad}}
"""
LASER_YAML = YAML.replace(THEODOLITES, LASER_LINES).replace(
    f"prism: {{{ON_THE_FLANGE}", f"chip: {{{ON_THE_FLANGE}, orientation: unknown, sigma_angle: 5 mrad"
)
GROUPS = tomllib.loads((PACKAGE / "pyproject.toml").read_text())["project"]["entry-points"]


def installed_into(folder, groups):
    """What an installer leaves of a package: its modules, and beside them what its pyproject.toml says."""
    (folder / "lab_calib").symlink_to(PACKAGE / "lab_calib")
    about = folder / "lab_calib-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-calib\nVersion: 1.0\n")
    lines = [f"[{group}]\n" + "\n".join(f"{k} = {v}" for k, v in points.items()) for group, points in groups.items()]
    (about / "entry_points.txt").write_text("\n".join(lines) + "\n")


@pytest.fixture(scope="module", autouse=True)
def _installed(tmp_path_factory):
    """The package beside calib, in this process."""
    folder = tmp_path_factory.mktemp("site")
    installed_into(folder, GROUPS)
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        patch.setattr(KINDS, "_given", {})
        patch.setattr(TERMS, "_given", {})
        yield


def measured(folder, run_calib, text, known, validate):
    """A robot with this description, and the true one, beside the files of its simulated measurements and their fit."""
    (folder / "arm.urdf").write_bytes((EXAMPLES / "arm.urdf").read_bytes())
    (folder / "arm.yaml").write_text(text)
    robot, rng = calib.load(folder / "arm.yaml"), np.random.default_rng(0)
    truth = {p.name: p.nominal_si + 0.5 * p.sigma_si * rng.standard_normal() for p in robot.parameters} | known
    lines = [f"{p.name},{truth[p.name]!r},{'m' if p.dimension == 'length' else 'rad'}" for p in robot.parameters]
    (folder / "truth.csv").write_text("\n".join(["parameter,value,unit", *lines]) + "\n")
    for words in (
        "sample arm.yaml --count 60 --seed 1 --out poses.csv",
        "simulate arm.yaml poses.csv --parameters truth.csv --seed 2 --out data.csv",
        f"fit arm.yaml data.csv --validate {validate} --out fit",
    ):
        run = run_calib(*words.split(), cwd=folder)
        assert run.code == 0, run.err
    return folder, robot, robot.with_parameters(truth)


@pytest.fixture(scope="module")
def lab(tmp_path_factory, run_calib):
    """An arm that two theodolites look at."""
    headings = {f"{name}_station.rz": heading for name, (_, heading) in STATIONS.items()}
    return measured(tmp_path_factory.mktemp("lab"), run_calib, YAML, headings, 0.8)


@pytest.fixture(scope="module")
def lines(tmp_path_factory, run_calib):
    """An arm with a chip that meets two laser lines."""
    return measured(tmp_path_factory.mktemp("lines"), run_calib, LASER_YAML, {}, 0.2)


SEEN = View(np.tile(np.eye(3), (3, 1, 1)), np.array([[2.0, 1.0, 0.5], [-1.0, 0.3, -2.0], [-3.0, -1e-3, 0.1]]))


def test_a_theodolite_keeps_what_a_kind_promises():
    check_kind(KINDS["theodolite"].from_section("t", KINDS["theodolite"].section.model_validate(_entry())), SEEN)


def _slope_of_the_wrong_sign(kind, self, view, unknowns, readings):
    right = kind.compare(self, view, unknowns, readings)
    return replace(right, by_twist=right.by_twist * [1, 1, -1, 1, 1, 1])


def _off(kind, self, view, unknowns, readings):
    right = kind.compare(self, view, unknowns, readings)
    return replace(right, residuals=right.residuals + 0.1)


def _one_row(kind, self, view, unknowns, readings):
    right = kind.compare(self, view, unknowns, readings)
    return replace(right, residuals=right.residuals[:, :1])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"compare": _slope_of_the_wrong_sign}, "derivative by dp_z, row direction.elevation, is .* at view"),
        ({"compare": _one_row}, r"compare\(\): residuals of shape \(3, 1\), not \(3, 2\)"),
        ({"compare": _off}, "residuals of its own predictions are not zero"),
        ({"predict": lambda kind, *seen: kind.predict(*seen) * np.nan}, "numbers that are not finite"),
        (
            {"with_errors": lambda kind, self, values, change: values - change},
            r"with_errors\(\) does not change row direction.azimuth",
        ),
        ({"cells": lambda kind, self, values: {"t_azimuth": values[:, 0]}}, r"cells\(\) returns columns"),
    ],
    ids=["derivative", "shape", "zero", "not a number", "noise", "cells"],
)
def test_a_kind_that_does_not_keep_what_it_promises_is_told_where(changes, said):
    kind = KINDS["theodolite"]
    methods = {name: lambda self, *given, of=of: of(kind, self, *given) for name, of in changes.items()}
    wrong = type("Wrong", (kind,), methods).from_section("t", kind.section.model_validate(_entry()))
    with pytest.raises(calib.ComputationError, match=said):
        check_kind(wrong, SEEN)


def test_its_package_imports_nothing_but_what_is_there_for_others():
    for path in PACKAGE.rglob("*.py"):
        of_calib = [line for line in path.read_text().splitlines() if "calib" in line and "import" in line.split()]
        assert all(line.startswith("from calib.extend import ") for line in of_calib), path
    assert sorted(extend.__all__) == sorted(
        name for name in vars(extend) if not name.startswith("_") and name != "calib"
    )


def test_a_robot_file_of_its_own_is_read_where_a_urdf_is(tmp_path, run_calib):
    chain = tmp_path / "arm.chain"
    chain.write_text("turn 0 0 300 0 0 1\nlift 100 0 0 0 1 0\nbend 400 0 0 0 1 0\n")
    robot = calib.load(chain)
    assert robot.joint_names == ("turn", "lift", "bend")
    np.testing.assert_allclose(robot.forward([0.0, np.pi / 2, 0.0], "link_3")[:3, 3], [0.1, 0, -0.1], atol=1e-12)
    run = run_calib("init", chain, "--out", tmp_path / "arm.yaml")
    assert run.code == 0, run.err
    assert "states no limits of joints" in run.out + run.err
    chain.write_text("turn 0 0\n")
    for wrong, message in (
        ("turn 0 0\n", r", line 1: expected NAME"),
        ("\xff\n", ", line 1: expected"),
        ("", ": is empty"),
    ):
        chain.write_text(wrong, encoding="latin-1")
        with pytest.raises(calib.UrdfError, match=rf"arm\.chain{message}"):
            calib.load(chain)


def _entry(**changes):
    entry = {"kind": "theodolite", "target": "prism", "station": {"frame": "base_link"}, "sigma_station": "20 mm"}
    return entry | changes


@pytest.mark.quick(0)
def test_a_fit_by_directions_finds_stations_and_the_robot(lab):
    folder, robot, true = lab
    loaded = calib.load(folder / "fit")
    q = calib.sample(robot, 30, 5).joints
    off, before = (np.abs(turn.positions(q) - true.positions(q)).max() for turn in (loaded, robot))
    assert off < 0.6 * before  # directions alone leave the scale to what is expected of lengths
    content = json.loads((folder / "fit" / "result.json").read_text())
    assert content["verdict"]["grade"] != "FAIL"
    row = {turn["name"]: turn for turn in content["parameters"]}
    for name, (_, heading) in STATIONS.items():
        first = row[f"{name}_station.rz"]
        assert abs(first["value"] - np.degrees(heading)) < 4 * first["std"]
    assert {part["name"] for turn in content["instruments"] for part in turn["parts"]} == {"direction"}
    report = viz.report(calib.load_result(folder / "fit").fit).html
    assert "azimuth" in report
    assert "elevation" in report


def test_its_reason_is_one_of_the_verdict_where_it_is_true(robot, data):
    fit = calib.fit(robot, data)
    codes = {}
    for change in (4.0, 8.0):
        data = fit.identification.data
        warm = replace(data, context={**data.context, "temperature": np.linspace(20.0, 20.0 + change, len(data))})
        verdict = judge(replace(fit, identification=replace(fit.identification, data=warm)))
        codes[change] = {reason.code: reason.text for reason in verdict.reasons}
    assert "warmed_up" not in codes[4.0]
    assert codes[8.0]["warmed_up"] == "the temperature changed by 8.0 K; measure at an even one"


COMMANDS = {
    "check arm.yaml data.csv": "60 poses",
    "select arm.yaml poses.csv --count 25 --out chosen.csv": "Written to chosen.csv",
    "predict fit poses.csv --out predicted.csv": "60 poses written",
    "verify fit data.csv": "",
    "export fit --format urdf --out calibrated.urdf": "written to calibrated.urdf",
    "view fit --html view.html": "Written to view.html",
    "watch arm.yaml data.csv --once --goal 5mm": "as far as readings show positions",
}


@pytest.mark.quick(1)
@pytest.mark.parametrize("words", COMMANDS)
@pytest.mark.parametrize("kind", ["lab", "lines"])
def test_a_kind_works_in_every_command(request, run_calib, kind, words):
    run = run_calib(*words.split(), cwd=request.getfixturevalue(kind)[0])
    assert run.code == 0, run.err
    assert COMMANDS[words] in run.out


@pytest.mark.quick(0)
def test_poses_are_shared_out_among_laser_lines_and_both_are_found(lines, run_calib, with_pages):
    folder, robot, true = lines
    data = calib.read_measurements(folder / "data.csv", robot)
    assert min(map(len, data.readings.values())) > 18  # of 30 each; not every place on a line is within reach
    run = run_calib("fit", "arm.yaml", "data.csv", "--out", "pages", cwd=folder)
    assert run.out.splitlines()[1] == "Verdict: PASS"
    q = calib.sample(robot, 30, 5).joints
    off, before = (
        np.abs(turn.positions(q) - true.positions(q)).max() for turn in (calib.load(folder / "pages"), robot)
    )
    assert off < 0.4 * before
    assert "Spots are within" in viz.report(calib.load_result(folder / "pages").fit).html
    assert (folder / "pages" / "viewer.html").is_file()


def test_a_laser_line_reads_where_a_tilted_chip_cuts_it():
    entry = {"kind": "laser_line", "target": "chip", "beam": {"frame": "base"}, "sigma_beam": "2 mm"}
    kind = KINDS["laser_line"].from_section(
        "low", KINDS["laser_line"].section.model_validate(entry | {"reach": ["0.2 m", "0.8 m"]})
    )
    slope = np.radians(30)  # about the chip's x axis, which faces the beam: lengths along y grow by 1 / cos
    tilted = np.array([[1, 0, 0], [0, -np.cos(slope), np.sin(slope)], [0, -np.sin(slope), -np.cos(slope)]])
    view = View(np.tile(tilted, (3, 1, 1)), np.array([[1e-3, 2e-3, 0.5], [-3e-3, 0.0, 0.3], [0.02, 0.0, 0.4]]))
    read = kind.predict(view, np.zeros(0), np.zeros((3, 0)))
    assert np.allclose(read[:2], [[-1e-3, 2e-3 / np.cos(slope)], [3e-3, 0.0]], rtol=0, atol=1e-15)
    assert np.isnan(read[2]).all()  # beside the chip
    check_kind(kind, kind.sights(5, np.random.default_rng(1)))
    assert len((PACKAGE / "lab_calib" / "laser_line.py").read_text().splitlines()) <= 80


@pytest.mark.quick(0)
def test_errors_that_the_model_leaves_out_show_while_a_robot_is_watched_by_directions(lab):
    folder, robot, true = lab
    data = calib.read_measurements(folder / "data.csv", robot)
    bent = data.joints + 2e-3 * np.sin(3 * data.joints)  # gears that no free parameter describes
    readings = calib.simulate(true, bent, seed=4).readings
    bad = replace(data, readings=readings)
    told = calib.Watch(robot, "1 mm", candidates=calib.sample(robot, 20, 3)).update(bad)
    off = told.fit.robot.positions(data.joints[-20:]) - true.positions(bent[-20:])
    rms = np.sqrt(np.mean(np.sum(off**2, axis=-1)))  # of poses that were fitted: what was not is a little further off
    assert 0.7 * rms < told.unseen.value < 2.5 * rms
    assert not told.stop


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"kind": "theodolit"}, "unknown kind 'theodolit'; did you mean 'theodolite'?"),
        ({"statoin": {"frame": "base_link"}}, "unknown key 'instruments.east.statoin'; did you mean 'station'?"),
        ({"station": {"frame": "base_link", "xzy": 1}}, "unknown key 'instruments.east.station.xzy'; did you mean"),
        ({"station": {"frame": "bas_link"}}, "'bas_link'"),
    ],
)
def test_mistakes_in_its_entry_are_told_as_those_of_other_kinds(lab, tmp_path, run_calib, changes, said):
    entry = json.dumps(_entry(**changes))
    (tmp_path / "arm.urdf").write_bytes((lab[0] / "arm.urdf").read_bytes())
    (tmp_path / "arm.yaml").write_text(YAML.replace(THEODOLITES, f"  east: {entry}"))
    run = run_calib("check", "arm.yaml", cwd=tmp_path)
    assert said in run.refusal()
    assert run.err.count("\n") == 1


def test_an_elevation_beyond_straight_up_is_none(lab):
    data = calib.read_measurements(lab[0] / "data.csv", lab[1])
    east = lab[1].instrument("east")
    cells = east.cells(data.readings["east"].values)
    cells["east_elevation"] = np.where(np.arange(len(data)) == 2, np.radians(100), 0.0)
    with pytest.raises(calib.DataError, match="'east', reading 3: elevation of 100 deg is impossible"):
        east.values(cells)


HALF_PLAY = 4e-4


def read_by_tracker(folder, seed, off):
    """A small arm, and what a tracker reads of it: the nominal arm, its first joint off by `off(q)` [rad]."""
    robot, rng = calib.load(write_arm(folder)), np.random.default_rng(seed)
    q = rng.uniform([-1.5, 0.1, -1.5], [1.5, 0.9, 1.5], (60, 3))
    actual = q + np.outer(off(q), [1, 0, 0])
    return robot, calib.as_measurements(robot, q, robot.positions(actual) + 1e-5 * rng.standard_normal((60, 1, 3)))


@pytest.fixture(scope="module")
def lagging(tmp_path_factory):
    """A small arm whose first joint lags, and its measurements without and with the direction of approach."""

    def off(q):
        return HALF_PLAY * directions_of_motion(q)[:, 0] * np.sin(q[:, 0])

    robot, data = read_by_tracker(tmp_path_factory.mktemp("lagging"), 3, off)
    return robot, data, replace(data, approach=directions_of_motion(data.joints))


def test_hysteresis_is_found_where_the_direction_of_approach_is_stated(lagging):
    robot, _, stated = lagging
    fit = calib.fit(robot, stated, terms="auto")
    told = {trial.term: trial for trial in fit.terms.trials}
    assert told["hysteresis"].added
    values = {name: fit.parameters[f"turn.hysteresis_{name}"] for name in ("sin", "cos")}
    assert abs(values["sin"].value * 1e-3 - HALF_PLAY) < 1e-4 * HALF_PLAY + 4e-3 * values["sin"].std
    assert abs(values["cos"].value) < 4 * values["cos"].std
    assert "hysteresis" in {share.cause for share in fit.budget.shares}


def test_hysteresis_without_a_stated_direction_is_doubted_as_backlash_is(lagging):
    robot, unstated, stated = lagging
    doubts, none = ({term.term: term.refusal for term in candidates(robot, data)} for data in (unstated, stated))
    assert doubts["hysteresis"] == doubts["backlash"]
    assert doubts["backlash"] == "the data do not state the direction of approach (columns approach_JOINT)"
    assert none["hysteresis"] == none["backlash"] == ""


def test_hysteresis_asks_no_joint_that_slides_or_came_from_one_side(lagging):
    robot, data, stated = lagging
    tried = {term.term: term for term in candidates(robot, stated)}
    assert [section.joint for section in tried["hysteresis"].sections] == ["turn", "wrist"]
    one_side = replace(data, approach=np.ones_like(data.joints))
    refused = {term.term: term.refusal for term in candidates(robot, one_side)}
    assert refused["hysteresis"] == refused["backlash"] == "no joint was approached from both sides"
    with pytest.raises(calib.DescriptionError, match="'slide': it repeats with the turn of a joint"):
        robot.with_terms(parse_terms("slide=hysteresis"))


def test_a_term_by_name_that_the_measurements_cannot_show_is_told(lagging):
    robot, _, stated = lagging
    told = "Joint terms that these measurements cannot show: temperature (the data have no column 'temperature' that"
    for terms, says in (("turn=temperature,turn=hysteresis", True), ("turn=hysteresis", False)):
        fit = calib.fit(robot, stated, terms=terms)
        for text in (fit.report(), fit.report(verbose=True)):
            assert (told in " ".join(text.split())) == says


def test_hysteresis_by_name_is_kept_by_the_result_and_left_out_of_files_that_cannot_hold_it(
    lagging, tmp_path, run_calib
):
    robot, _, stated = lagging
    calib.fit(robot, stated, terms="turn=hysteresis").save(tmp_path / "fit", pages=False)
    again = calib.load(tmp_path / "fit")
    assert [type(term).__name__ for term in again.terms] == ["Hysteresis"]
    run = run_calib("export", "fit", "--format", "urdf", "--out", "arm.urdf", cwd=tmp_path)
    assert run.code == 0, run.err
    run = run_calib("export", "fit", "--format", "numpy", "--out", "arm.py", cwd=tmp_path)
    assert "'turn.hysteresis_sin' (Hysteresis) gives no formula" in run.refusal()
    run = run_calib("fit", tmp_path / "fit", "no.csv", "--terms", "histeresis", "--out", "x", cwd=tmp_path)
    assert run.code == 2


LAG = 3e-3


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """A small arm whose first joint lags by its speed, and a file of what a tracker reads, with a column of speeds."""
    folder, speed = tmp_path_factory.mktemp("quick"), np.random.default_rng(5).uniform(0.1, 1.0, 60)
    robot, data = read_by_tracker(folder, 4, lambda q: LAG * speed)
    (folder / "data.csv").write_text(format_measurements(robot, replace(data, context={"speed": speed})))
    return folder, robot


@pytest.mark.quick(0)
def test_a_term_with_a_column_of_its_own_is_found_reported_and_predicted_with(quick, run_calib, with_pages):
    folder, robot = quick
    assert "speed" in (folder / "data.csv").read_text().splitlines()[0].split(",")
    run = run_calib("fit", "arm.yaml", "data.csv", "--terms", "auto", "--out", "out", cwd=folder)
    assert run.code == 0, run.err
    content = json.loads((folder / "out" / "result.json").read_text())
    row = next(row for row in content["parameters"] if row["name"] == "turn.lag")
    assert abs(row["value"] - 1e3 * LAG) < 4 * row["std"]
    assert "turn.lag" in (folder / "out" / "report.html").read_text()
    run = run_calib("predict", "out", "data.csv", "--out", "predicted.csv", cwd=folder)
    assert run.code == 0, run.err
    data, loaded = calib.read_measurements(folder / "data.csv", robot), calib.load(folder / "out")
    still = replace(data, context={"speed": np.zeros(60)})
    off = [np.linalg.norm(loaded.positions(d.joints, d.conditions) - data.points(robot), axis=2) for d in (data, still)]
    assert np.sqrt(np.mean(off[0] ** 2)) < 5e-5 < 0.2 * np.sqrt(np.mean(off[1] ** 2))


def test_a_file_without_its_column_cannot_show_a_term(quick):
    folder, robot = quick
    data = calib.read_measurements(folder / "data.csv", robot)
    refused = {term.term: term.refusal for term in candidates(robot, replace(data, context={}))}
    assert refused["lag"] == "the data have no column 'speed' that changes"
    gap = np.where(np.arange(60) == 3, np.nan, data.context["speed"])
    with pytest.raises(calib.DataError, match=r"says no speed, which 'turn\.lag' depends on"):
        calib.fit(robot, replace(data, context={"speed": gap}), terms="turn=lag")


def test_terms_keep_what_a_term_promises(quick):
    rng = np.random.default_rng(1)
    q, joint = rng.uniform(-1, 1, (5, 3)), Joint("turn", "angle", ("turn", "slide", "wrist"))
    context = replace(Context.neutral(5, 3), approach=np.ones((5, 3)), others={"speed": rng.uniform(0.1, 1, 5)})
    for name in ("hysteresis", "lag", "gain"):
        check_term(TERMS[name].from_section(joint, None, None), q, 0, context)
    still = type("Still", (TERMS["lag"],), {"columns": lambda self, q, j, context: np.ones((len(q), 1))})
    with pytest.raises(
        calib.ComputationError, match=r"Still: says that it depends on the speed, but columns\(\) ignores it"
    ):
        check_term(still.from_section(joint, None, None), q, 0, context)
    wide = type("Wide", (TERMS["lag"],), {"columns": lambda self, q, j, context: np.ones((len(q), 2))})
    with pytest.raises(calib.ComputationError, match=r"Wide: columns\(\) returns shape \(5, 2\), not \(5, 1\)"):
        check_term(wide.from_section(joint, None, None), q, 0, context)


class Keyhole(KINDS["position"]):
    """Positions, but of a target within 5 mm of one place, as a small sensor in the cell reads them."""

    may_see_nothing = True
    there = np.array([0.3, 0.2, 0.35])

    def predict(self, view, unknowns, details):
        near = np.linalg.norm(view.translation - self.there, axis=1, keepdims=True) < 5e-3
        return np.where(near, super().predict(view, unknowns, details), np.nan)

    def sights(self, count, generator):
        return View(np.full((count, 3, 3), np.nan), self.there + generator.uniform(-2e-3, 2e-3, (count, 3)))


@pytest.mark.quick(0)
def test_poses_are_brought_to_where_a_kind_reads_something(tmp_path, monkeypatch):
    monkeypatch.setattr(KINDS, "_given", {"keyhole": Keyhole})
    for name in ("arm.urdf", "arm.yaml"):
        (tmp_path / name).write_bytes((EXAMPLES / name).read_bytes())
    with (tmp_path / "arm.yaml").open("a") as file:
        file.write("instruments:\n  reflector: {kind: keyhole, target: reflector}\n")
    robot = calib.load(tmp_path / "arm.yaml")
    Keyhole.there = robot.positions(robot.sample(1, 0))[0, 0]
    assert visible_poses(robot, calib.sample(robot, 20, 1))["reflector"].sum() >= 15
    monkeypatch.setattr(Keyhole, "sights", lambda self, count, generator: None)
    assert visible_poses(robot, calib.sample(robot, 20, 1))["reflector"].sum() < 5


def test_a_term_that_nobody_installed_is_named_with_the_nearest_one():
    with pytest.raises(calib.InputError, match="no term 'histeresis'; did you mean 'hysteresis'"):
        parse_terms("histeresis")


def test_a_package_that_cannot_be_loaded_is_said_and_disturbs_nobody_else(tmp_path, monkeypatch, lagging):
    installed_into(tmp_path, {"calib.terms": {"broken": "lab_calib.nothing:There", "wrong": "lab_calib:__name__"}})
    monkeypatch.syspath_prepend(tmp_path)
    refused = {term.term: term.refusal for term in candidates(lagging[0], lagging[2])}
    assert "'broken' (lab_calib.nothing:There) cannot be loaded: ModuleNotFoundError" in refused["broken"]
    assert "'wrong' (lab_calib:__name__): is not derived from JointTerm" in refused["wrong"]
    assert refused["gain"] == ""
    with pytest.raises(calib.DescriptionError, match="cannot be loaded"):
        parse_terms("broken")


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("group", "words"),
    [
        ("calib.readers", "fit arm.yaml arm_simulated.csv --no-pages"),
        ("calib.formats", "export arm.yaml --format urdf --out robot.urdf"),
        ("calib.first_descriptions", "init arm.urdf --out new.yaml"),
    ],
)
def test_what_else_cannot_be_loaded_is_named_and_the_command_goes_on(tmp_path, group, words):
    """Each of these stopped commands that did not need it; a process of its own, as `init` loads with its module."""
    site = tmp_path / "site"
    site.mkdir()
    installed_into(site, {group: {"broken": "lab_calib.nothing:There"}})
    for name in ("arm.yaml", "arm.urdf", "arm_simulated.csv"):
        (tmp_path / name).write_bytes((EXAMPLES / name).read_bytes())
    path = os.pathsep.join([str(site), str(ROOT)])
    run = subprocess.run(
        [sys.executable, "-m", "calib", *words.split()],
        cwd=tmp_path, env=os.environ | {"PYTHONPATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert "Traceback" not in run.stderr
    assert "'broken' (lab_calib.nothing:There) cannot be loaded: ModuleNotFoundError" in run.stderr


def test_a_name_that_is_taken_is_refused(tmp_path, monkeypatch):
    installed_into(tmp_path, {"calib.terms": {"gain": "lab_calib.hysteresis:Hysteresis"}})
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(
        calib.DescriptionError, match=r"'gain' \(lab_calib.hysteresis:Hysteresis\): another package has"
    ):
        list(TERMS)


def test_classes_are_registered_in_python_too():
    module = importlib.import_module("lab_calib.hysteresis")
    registry = Registry("joint term", "calib.none", JointTerm, {"gain": TERMS["gain"]})
    registry.register("mine", module.Hysteresis)
    assert registry["mine"] is module.Hysteresis
    assert list(registry) == ["gain", "mine"]
    with pytest.raises(calib.DescriptionError, match="'gain': there is one already"):
        registry.register("gain", module.Hysteresis)
    with pytest.raises(calib.DescriptionError, match="does not define from_section"):
        registry.register("half", type("Half", (JointTerm,), {}))


def test_a_term_that_says_nothing_of_its_columns_is_named():
    silent = type("Silent", (JointTerm,), {"from_section": classmethod(lambda cls, joint, section, sigma: cls())})
    with pytest.raises(NotImplementedError, match="Silent gives neither columns nor a formula"):
        silent.from_section(None, None, None).columns(np.zeros((1, 1)), 0, None)
    with pytest.raises(calib.DescriptionError, match=r"joint term 'silent' .*: defines neither columns nor formula"):
        TERMS.register("silent", silent)
    assert "silent" not in TERMS


class Squeezed(JointTerm):
    """An error that grows with the square of the torque: no formula has that."""

    needs_torque = True
    from_section = classmethod(lambda cls, joint, section, sigma: cls())

    def columns(self, q, j, context):
        return context.torque[:, [j]] ** 2


def test_a_term_of_the_torque_without_a_formula_has_its_own_derivative():
    rng = np.random.default_rng(0)
    torque, rate = 30 * rng.standard_normal((2, 8, 3))
    context = replace(Context.neutral(8, 3), torque=torque)
    slope = Squeezed.from_section(None, None, None).torque_derivative(np.zeros((8, 3)), 1, context, rate)
    np.testing.assert_allclose(slope[:, 0], 2 * torque[:, 1] * rate[:, 1], rtol=1e-6, atol=1e-6)  # rounding / 1e-4
    none = Squeezed.from_section(None, None, None).torque_derivative(np.zeros((8, 3)), 1, context, np.zeros((8, 3)))
    assert not np.any(none)


def test_editors_know_its_keys(lab):
    jsonschema = pytest.importorskip("jsonschema")
    validator = jsonschema.Draft202012Validator(json.loads(schema_text()))
    said = yaml.safe_load(YAML) | {"joint_terms": [{"joint": "joint_2", "term": "hysteresis"}]}
    assert list(validator.iter_errors(said)) == []
    assert list(validator.iter_errors(said | {"instruments": {"east": _entry(statoin=1)}}))
    assert list(
        validator.iter_errors(said | {"joint_terms": [{"joint": "joint_2", "term": "hysteresis", "orders": 1}]})
    )


@pytest.mark.quick(0)
def test_it_is_installed_by_pip_as_any_package(tmp_path):
    pytest.importorskip("hatchling", reason="hatchling (dev extra) builds the wheel")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--no-build-isolation"]
    subprocess.run([*pip, "--target", str(tmp_path), str(PACKAGE)], check=True, timeout=120)
    points = (tmp_path / "lab_calib-1.0.dist-info" / "entry_points.txt").read_text()
    assert "theodolite = lab_calib.theodolite:Theodolite" in points
    assert "hysteresis = lab_calib.hysteresis:Hysteresis" in points


class Points(KINDS["position"]):
    """Positions of a target, under another name."""

    parts = (replace(KINDS["position"].parts[0], name="point"),)


@pytest.mark.quick(0)
def test_positions_are_those_of_a_kind_that_calls_them_otherwise(tmp_path, run_calib, monkeypatch, with_pages):
    monkeypatch.setattr(KINDS, "_given", {"cloud": Points})
    examples = EXAMPLES
    for name in ("arm.urdf", "arm_simulated.csv"):
        (tmp_path / name).write_bytes((examples / name).read_bytes())
    instruments = "instruments:\n  reflector: {kind: cloud, target: reflector}\n"
    (tmp_path / "arm.yaml").write_text((examples / "arm.yaml").read_text() + instruments)
    assert (
        run_calib(*["fit", "arm.yaml", "arm_simulated.csv", "--validate", "0.5", "--out", "fit"], cwd=tmp_path).code
        == 0
    )
    content = json.loads((tmp_path / "fit" / "result.json").read_text())
    assert [block["kind"] for block in content["instruments"]] == ["cloud"]
    assert content["verdict"]["claim"]["part"] == "point"
    assert "Point: " not in (tmp_path / "fit" / "report.html").read_text()  # figures of positions have them
    assert other_errors(calib.load_result(tmp_path / "fit").fit) == ()
    predicted = run_calib("predict", "fit", "arm_simulated.csv", "--out", "predicted.csv", cwd=tmp_path)
    assert "The real tool is within" in predicted.out


def test_functions_are_not_named_for_a_robot_with_a_term_that_has_no_formula(lagging):
    robot = lagging[0]
    assert "numpy" in formats_that_hold(Holds.EVERYTHING, robot.with_terms(parse_terms("turn=backlash")))
    assert formats_that_hold(Holds.EVERYTHING, robot.with_terms(parse_terms("turn=hysteresis"))) == []
