"""The robots that files of a fit get: as good as a fit without what they lose, never worse than the nominal robot."""

import json
import pickle
import shutil
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.core.calibrating.file_robots import why_withheld
from calib.core.results.result_reading import read_content
from calib.core.robots.accuracy_of_files import Accuracy, Holds, PoseUse
from calib.core.robots.robot_files import urdf_of_origins, without_terms
from tests.exporting.read_back import held_out, in_file, tip_of, urdf_links
from tests.project import EXAMPLES, ROOT, write_table
from tests.six_axis_arm import FREE, YAML, joints, write_six_axis

SIGMA = 2e-5
MIDDLE = np.array([0.0, 0.9, -0.8, 0.0, 0.7, 0.0])
"""Where the arm's zeros were set: gears turn too far from there."""
GAIN = 0.01
FILES = {"urdf": "arm.urdf", "mjcf": "arm.xml", "drake": "arm.drake", "toolbox": "arm.yaml", "xacro": "arm.xacro",
         "dh": "dh.csv", "mdh": "mdh.csv"}  # fmt: skip
"""Formats that hold joint origins, and a file of each."""


def arm_with(folder, terms="", more=""):
    folder.mkdir(exist_ok=True)
    return calib.load(write_six_axis(folder, YAML + FREE + terms + more))


def true_tip_of(arm):
    """Where the ball is when joints are truly somewhere, by Pinocchio; origins off by a millimetre or so."""
    true = arm.with_parameters({"j2.x": 0.0512, "j3.z": 0.5991, "j4.ry": 2e-3, "j5.z": 1e-3})
    tip = tip_of(urdf_links(urdf_of_origins(true)), true)
    return lambda q: (tip(q) @ [0.05, 0.02, 0.1, 1.0])[:, :3]


@pytest.fixture(scope="module")
def true_tip(tmp_path_factory):
    return true_tip_of(arm_with(tmp_path_factory.mktemp("true")))


def measured(robot, true_tip, n, seed, *, more=0.0):
    """What the arm with its gears really reads, the fifth joint off by `more` times the first."""
    rng = np.random.default_rng(seed)
    q = MIDDLE + rng.uniform(-0.7, 0.7, (n, 6))
    actual = q + GAIN * (q - MIDDLE)
    actual[:, 4] += more * q[:, 0]
    return calib.as_measurements(robot, q, true_tip(actual) + SIGMA * rng.standard_normal((n, 3)))


@pytest.fixture(scope="module")
def fit(tmp_path_factory, true_tip):
    """A fit with a gain of every joint, and a coupling of the fifth with the first, which no table can hold."""
    terms = "  - {joint: all, term: gain, sigma: 0.01}\n  - {joint: j5, term: coupling, driven_by: j1, sigma: 0.01}\n"
    arm = arm_with(tmp_path_factory.mktemp("arm"), terms)
    train, test = (measured(arm, true_tip, n, seed, more=0.004) for n, seed in ((80, 1), (40, 2)))
    return calib.fit(arm, train, validation=test)


@pytest.fixture(scope="module")
def folder(fit, tmp_path_factory):
    """Its result, moved to where nothing else is."""
    made = tmp_path_factory.mktemp("made") / "out"
    fit.save(made, pages=False)
    return Path(shutil.move(made, tmp_path_factory.mktemp("elsewhere") / "moved"))


def rms_of(fit, tip):
    data = [(item.data.joints, item.data.points(fit.nominal)[:, 0]) for item in (fit.identification, fit.validation)]
    return held_out(tip, fit.nominal, *data)


@pytest.mark.quick(0)
def test_every_file_of_origins_is_as_good_as_a_fit_of_origins_alone(fit, folder, tmp_path):
    alone = calib.fit(fit.nominal, fit.identification.data, validation=fit.validation.data, terms="none")
    robot, expected = calib.load(folder), alone.validation.rms("after")
    dropped = rms_of(fit, tip_of(urdf_links(urdf_of_origins(without_terms(fit.robot, Holds.ORIGINS))), robot))
    nominal = rms_of(fit, tip_of(urdf_links(fit.nominal.urdf.source), robot))
    assert dropped > nominal > 1.5 * expected  # a file with the origins of the whole model would be worse than none
    for file_format, name in FILES.items():
        calib.export(robot, tmp_path / name, file_format)
        assert rms_of(fit, in_file(robot, file_format, tmp_path / name)) < 1.03 * expected
    assert rms_of(fit, tip_of(urdf_links((folder / "calibrated.urdf").read_bytes()), robot)) < 1.03 * expected


def test_files_that_hold_more_get_more(fit, folder, tmp_path):
    """Tables get a fit with the gains; joint zeros what the nominal robot makes of zeros alone."""
    robot, errors = calib.load(folder), {}
    for file_format in ("joint-tables", "joint-offsets"):
        calib.export(robot, tmp_path / file_format, file_format)
        errors[file_format] = rms_of(fit, in_file(robot, file_format, tmp_path / file_format))
    known = {holds: file.accuracy.rms for holds, file in robot.files.items()}
    assert errors["joint-tables"] == pytest.approx(known[Holds.TABLES], rel=0.03)
    assert errors["joint-offsets"] == pytest.approx(known[Holds.ZEROS], rel=0.03)
    assert known[Holds.EVERYTHING] < known[Holds.TABLES] < known[Holds.ORIGINS] < known[Holds.ZEROS]
    assert known[Holds.EVERYTHING] < 3 * SIGMA
    assert "j5: coupling is not in the table" in (tmp_path / "joint-tables" / "joint_tables.csv").read_text()
    assert known[Holds.ZEROS] < fit.validation.rms("before")


def test_from_python_the_same_files_come_out(fit, folder, tmp_path):
    for robot, name in ((fit.robot, "a"), (calib.load(folder), "b"), (pickle.loads(pickle.dumps(fit.robot)), "c")):
        calib.export(robot, tmp_path / f"{name}.urdf", "urdf")
        calib.export(robot, tmp_path / f"{name}.csv", "joint-offsets")
    contents = [_numbers_of((tmp_path / f"{name}.urdf").read_bytes()) for name in "abc"]
    np.testing.assert_allclose(contents[1], contents[0], rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(contents[2], contents[0], rtol=1e-12, atol=1e-15)
    assert _numbers_of(fit.robot.calibrated_urdf()) == contents[0]


def _numbers_of(source):
    pose, zero = urdf_links(source), dict.fromkeys((f"j{k}" for k in range(1, 7)), 0.1)
    return pose(zero, "l6").ravel().tolist()


def test_the_result_holds_these_robots_and_how_sure_they_are(fit, folder):
    loaded = calib.load_result(folder)
    for holds, n_terms in ((Holds.ORIGINS, 0), (Holds.TABLES, 6)):
        robot, uncertainty = loaded.held_by(holds)
        own = fit.reduced[holds]
        assert len(robot.terms) == n_terms
        np.testing.assert_allclose(robot.values, own.robot.values, rtol=1e-14, atol=1e-16)
        std = np.sqrt(np.diag(own.covariance.values))
        np.testing.assert_allclose(uncertainty.covariance, own.covariance.values, atol=1e-12 * np.max(std) ** 2)
        assert uncertainty.coverage_factor == pytest.approx(own.statistics.coverage_factor, rel=1e-12)
    told = [Holds[entry["holds"].upper()] for entry in read_content(folder)["files"]]
    assert list(loaded.robot.files) == told == [holds for holds in Holds if holds is not Holds.TO_LAST_AXIS]
    for holds, file in loaded.robot.files.items():
        stated, result = file.accuracy, fit.robot.files[holds].accuracy
        assert (stated.poses, stated.n_poses, stated.part) == (PoseUse.VALIDATION, 40, "position")
        assert (stated.rms, stated.limit95, stated.before) == pytest.approx((result.rms, result.limit95, result.before))
        np.testing.assert_allclose(file.offsets, fit.robot.files[holds].offsets, rtol=1e-14, atol=1e-17)


def test_files_report_and_verdict_say_what_they_are_worth(fit, folder):
    origins, whole = (fit.robot.files[holds].accuracy for holds in (Holds.ORIGINS, Holds.EVERYTHING))
    urdf = (folder / "calibrated.urdf").read_text()
    assert "fitted without the joint terms of j1, j2, j3, j4, j5, and 1 more" in urdf
    assert f"{1e3 * origins.rms:.4f} mm RMS, 95 % within {1e3 * origins.limit95:.4f} mm (40 validation poses)" in urdf
    assert f"the whole model {1e3 * whole.rms:.4f} mm" in urdf
    report = fit.report(verbose=True)
    row = next(line for line in report.splitlines() if "│ joint origins " in line)
    expected = [1e3 * origins.rms, 1e3 * origins.limit95]
    assert [float(cell) for cell in row.split("│")[2:4]] == pytest.approx(expected, abs=6e-5)
    said = next(reason for reason in fit.verdict.reasons if reason.code == "file_holds_less")
    assert f"{1e3 * origins.rms:.4f} mm RMS" in said.text


def test_the_whole_model_stays_what_predictions_use(fit, folder):
    q = joints(5)
    np.testing.assert_allclose(calib.load(folder).positions(q), fit.robot.positions(q), atol=1e-14)
    assert np.abs(fit.robot.held_by(Holds.ORIGINS).positions(q) - fit.robot.positions(q)).max() > 1e-3
    assert fit.robot.held_by(Holds.EVERYTHING).terms == fit.robot.terms


@pytest.mark.quick(0)
def test_a_fit_without_terms_follows_the_choices_of_the_one_with_them(tmp_path, true_tip):
    arm = arm_with(tmp_path, "  - {joint: all, term: gain, sigma: 0.01}\n")
    data = measured(arm, true_tip, 60, 3)
    points = data.points(arm)
    points[7] += 0.05
    data = calib.as_measurements(arm, data.joints, points)
    fit = calib.fit(arm, data, sigma=3e-5, loss="huber", exclude_outliers=True, starts=2, folds=3, seed=4)
    own = fit.reduced[Holds.ORIGINS]
    assert (own.loss, own.sigma_given, own.seed, own.starts.total, own.folds.count) == ("huber", 3e-5, 4, 2, 3)
    assert own.identification.data.names == fit.identification.data.names
    assert "7" not in own.identification.data.names
    accuracy = fit.robot.files[Holds.ORIGINS].accuracy
    assert (accuracy.poses, accuracy.n_poses) == (PoseUse.FOLDS, own.identification.data.n_poses)


@pytest.mark.parametrize(
    ("signs", "zeros"), [([1] * 6, [2e-3, -1e-3, 3e-3, 0.0, -2e-3, 1e-3]), ([1, 1, 1, 1, 1, -1], [0, 0, 0, 0, 0, 0.01])]
)
def test_a_robot_whose_joints_are_only_off_by_zeros_and_signs_gets_them_back(tmp_path, signs, zeros):
    arm = arm_with(tmp_path, "  - {joint: j6, term: gain, sigma: 1}\n" if min(signs) < 0 else "")
    if min(signs) < 0:
        arm = arm.with_parameters({"j6.gain": -2.0})  # where a search begins
    q, noise = joints(60), 1e-6 * np.random.default_rng(6).standard_normal((60, 3))
    points = (tip_of(urdf_links(arm.urdf.source), arm)(q * signs + zeros) @ [0.05, 0.02, 0.1, 1.0])[:, :3]
    held = calib.fit(arm, calib.as_measurements(arm, q, points + noise), sigma=1e-6).robot.files[Holds.ZEROS]
    assert held.signs.tolist() == signs
    np.testing.assert_allclose(held.offsets, zeros, atol=2e-6)
    assert held.accuracy.rms < 3e-6


@pytest.mark.quick(0)
def test_what_a_format_has_no_place_for_is_fitted_as_it_is(tmp_path):
    """A known target on a flange that is off: the best six origins, not those of a robot with the flange moved."""
    from tests.exporting.test_controllers import ur_robot

    nominal = ur_robot(tmp_path)
    off = {"left_tool_mount.x": 3e-3, "left_elbow_joint.x": 2e-3, "left_wrist_2_joint.z": -1e-3}
    true = nominal.with_parameters({name: nominal.parameters[name].nominal_si + value for name, value in off.items()})
    rng = np.random.default_rng(8)
    train, test = (rng.uniform(-2.5, 2.5, (n, 6)) for n in (40, 30))
    points = [true.positions(q) + 1e-5 * rng.standard_normal((len(q), 1, 3)) for q in (train, test)]
    fit = calib.fit(nominal, train, points[0], validation=calib.as_measurements(nominal, test, points[1]))
    fit.save(tmp_path / "out", pages=False)
    robot = calib.load(tmp_path / "out")
    held = robot.held_by(Holds.TO_LAST_AXIS)
    behind = [p.name for p in held.parameters if p.name.startswith(("left_tool_mount", "left_wrist_3-flange"))]
    values = dict(zip((p.name for p in held.parameters), held.values, strict=True))
    assert [values[name] for name in behind] == [held.parameters[name].nominal_si for name in behind]
    calib.export(robot, tmp_path / "kinematics.yaml", "ur-kinematics")
    q = test[:5]
    result = in_file(nominal, "ur-kinematics", tmp_path / "kinematics.yaml")(q)
    base = nominal.description.base.frame
    expected = np.linalg.inv(held.forward(q, base)) @ held.forward(q, "left_tool")
    np.testing.assert_allclose(result, expected, atol=1e-9)
    dropped = fit.robot.with_parameters({name: nominal.parameters[name].nominal_si for name in behind})
    left = np.sqrt(np.mean(np.sum((dropped.positions(test) - true.positions(test)) ** 2, axis=2)))
    assert robot.files[Holds.TO_LAST_AXIS].accuracy.rms < 0.9 * left


def warm_and_cold(folder, true_tip):
    """Measured warm, used cold: zeros that follow the temperature, which origins take for their own."""
    arm = arm_with(folder, "  - {joint: all, term: temperature, sigma: 0.2 mrad}\n")
    rng = np.random.default_rng(9)
    rows = {}
    for name, n, warm in (("train", 60, (8.0, 12.0)), ("test", 40, (-1.0, 1.0))):
        q = MIDDLE + rng.uniform(-0.7, 0.7, (n, 6))
        above = rng.uniform(*warm, (n, 1))
        points = true_tip(q + 1e-3 * above * [1, -1, 1, 1, -1, 1]) + SIGMA * rng.standard_normal((n, 3))
        header = "j1,j2,j3,j4,j5,j6,temperature,ball_x,ball_y,ball_z"
        path = write_table(folder / f"{name}.csv", header, q, 20.0 + above, points)
        rows[name] = calib.read_measurements(path, arm)
    return arm, rows["train"], rows["test"]


@pytest.fixture(scope="module")
def withheld(tmp_path_factory, true_tip):
    folder = tmp_path_factory.mktemp("warm")
    return folder, *warm_and_cold(folder, true_tip)


@pytest.mark.quick(0)
def test_a_file_that_is_worse_than_the_nominal_robot_is_not_written(withheld, run_calib, tmp_path):
    folder, *_ = withheld
    arguments = ("fit", folder / "arm.yaml", folder / "train.csv", "--validate", folder / "test.csv", "--no-pages",
                 "--out", tmp_path / "out")  # fmt: skip
    run = run_calib(*arguments, "--force")
    assert run.code == 0, run.err
    assert "exported by force: it is worse than" in (tmp_path / "out" / "calibrated.urdf").read_text()
    assert "was not written" not in run.err
    run = run_calib(*arguments)
    assert run.code == 0, run.err
    assert "calibrated.urdf was not written: it is worse than the nominal robot:" in run.err
    assert "file_withheld" in json.loads((tmp_path / "out" / "result.json").read_text())["verdict"]["codes"]
    assert "(--force writes it)" in run.err
    assert "withheld: urdf" in run.out
    left = {path.name for path in (tmp_path / "out").iterdir()}
    assert "calibrated.urdf" not in left
    assert {"result.json", "parameters.csv", "residuals.csv", "fit.npz"} <= left
    loaded = calib.load(tmp_path / "out")  # the whole model is good
    assert loaded.files[Holds.EVERYTHING].accuracy.rms < 0.2 * loaded.files[Holds.ORIGINS].accuracy.rms
    for file_format in ("urdf", "mjcf", "dh", "toolbox"):
        out = tmp_path / f"x-{file_format}.yaml"
        run = run_calib("export", tmp_path / "out", "--format", file_format, "--out", out)
        assert (run.code, run.err.count("\n")) == (3, 1)
        assert f"format '{file_format}' holds joint origins" in run.err
        assert "--force writes it all the same" in run.err
        assert not out.exists()
    run = run_calib("export", tmp_path / "out", "--format", "urdf", "--force", "--out", tmp_path / "forced.urdf")
    assert run.code == 0, run.err
    assert "exported by force: it is worse than the nominal robot" in (tmp_path / "forced.urdf").read_text()


def test_it_is_the_robot_in_the_file_that_is_worse(withheld, tmp_path):
    _, arm, train, test = withheld
    fit = calib.fit(arm, train, validation=test)
    with pytest.raises(calib.ComputationError, match="such a file is not written: it is worse than the nominal robot"):
        calib.export(fit.robot, tmp_path / "x.urdf", "urdf")
    calib.export(fit.robot, tmp_path / "x.urdf", "urdf", force=True)
    tip = in_file(arm, "urdf", tmp_path / "x.urdf")
    both, points = (tip, tip_of(urdf_links(arm.urdf.source), arm)), test.points(arm)[:, 0]
    off = [(item(test.joints) @ [0.05, 0.02, 0.1, 1])[:, :3] - points for item in both]
    file, nominal = np.sqrt(np.mean(np.sum(np.square(off), axis=2), axis=1))
    accuracy = fit.robot.files[Holds.ORIGINS].accuracy
    assert (accuracy.rms, accuracy.before) == pytest.approx((file, nominal), rel=1e-6)
    assert file > nominal


def test_a_larger_error_is_enough_and_rounding_is_not():
    def judgement(rms, before):
        return Accuracy(PoseUse.VALIDATION, 20, "position", "length", before, rms, np.nan)

    assert why_withheld(judgement(1.01e-4, 1e-4)).startswith("it is worse than the nominal robot: 0.1010 mm RMS")
    assert why_withheld(judgement(1e-4, 1e-4)) == why_withheld(judgement(1e-4 * (1 + 1e-9), 1e-4)) == ""
    assert why_withheld(judgement(1e-12, 0.0)) == ""  # computed without noise


def test_a_result_of_an_earlier_version_loads_and_says_what_it_lacks(run_calib, tmp_path):
    old = tmp_path / "old"
    shutil.copytree(ROOT / "tests" / "version_1", old)
    content = json.loads((old / "result.json").read_text())
    del content["files"]  # as the first ones were
    (old / "result.json").write_text(json.dumps(content))
    run = run_calib("export", old, "--format", "urdf", "--out", tmp_path / "x.urdf")
    assert (run.code, run.err.count("\n")) == (3, 1)
    assert "loses the joint terms of turn, slide" in run.err
    assert "fit again if an earlier version wrote it" in run.err
    assert run_calib("export", old, "--format", "urdf", "--force", "--out", tmp_path / "x.urdf").code == 0
    assert "exported by force: these values need joint terms" in (tmp_path / "x.urdf").read_text()
    assert run_calib("export", old, "--format", "joint-offsets", "--out", tmp_path / "zeros.csv").code == 0


def test_files_do_not_stay_beside_a_result_that_has_none(fit, tmp_path):
    fit.save(tmp_path / "out", pages=False)
    for name in ("without_terms.csv", "with_tables_covariance.csv", "undecided_terms.csv"):  # of version 1
        (tmp_path / "out" / name).write_text("")
    plain = calib.fit(fit.nominal, fit.identification.data, terms="none")
    plain.save(tmp_path / "out", pages=False)
    left = {path.name for path in (tmp_path / "out").iterdir()}
    assert not {name for name in left if "terms" in name or "with_tables" in name}
    assert b"<!--" not in (tmp_path / "out" / "calibrated.urdf").read_bytes()  # nothing is lost, nothing to say


def test_values_of_terms_that_no_fit_has_are_refused_unless_forced(fit, tmp_path):
    robot = fit.nominal.with_parameters({"j2.gain": 1e-3})
    with pytest.raises(calib.ComputationError, match="A fit also finds the best origins without them"):
        robot.calibrated_urdf()
    with pytest.raises(calib.ComputationError, match=r"format 'dh': .* loses the joint terms of j2"):
        calib.export(robot, tmp_path / "x.csv", "dh")
    assert fit.nominal.calibrated_urdf() == fit.nominal.urdf.source
    assert fit.robot.with_parameters({"j2.x": 0.05}).files == {}


def test_terms_that_stay_at_zero_are_no_loss(tmp_path, true_tip):
    arm = arm_with(tmp_path, "  - {joint: j2, term: gain}\n", "held: [j2.gain]\n")
    fit = calib.fit(arm, measured(arm, true_tip, 40, 7))
    fit.save(tmp_path / "out", pages=False)
    robot = calib.load(tmp_path / "out")
    assert fit.reduced == {}
    written = (tmp_path / "out" / "calibrated.urdf").read_bytes()
    assert b"<!--" not in written
    np.testing.assert_allclose(_numbers_of(robot.calibrated_urdf()), _numbers_of(written))
    calib.export(robot, tmp_path / "robot.yaml", "toolbox")
    calib.load(tmp_path / "robot.yaml")  # which holds no term that is not there


def test_a_fit_that_starts_from_a_result_is_held_against_the_nominal_robot(fit, folder):
    again = calib.fit(calib.load(folder), fit.identification.data, validation=fit.validation.data)
    assert again.validation.rms("before") < 3 * SIGMA  # the robot of the result
    accuracy = again.robot.files[Holds.ORIGINS].accuracy
    assert accuracy.before == pytest.approx(fit.validation.rms("before"), rel=1e-6)
    assert accuracy.rms == pytest.approx(fit.robot.files[Holds.ORIGINS].accuracy.rms, rel=1e-3)


@pytest.mark.quick(0)
def test_a_loop_with_terms_and_a_named_parametrisation(tmp_path, medrue):
    """MedRUE, whose parameters are a plugin's, with a gain of one motor stated in `joint_terms`."""
    text = (ROOT / "urdf" / "medrue.yaml").read_text()
    shutil.copy(ROOT / "urdf" / "medrue.urdf", tmp_path)
    (tmp_path / "medrue.yaml").write_text(text + "\njoint_terms:\n  - {joint: q2, term: gain, sigma: 0.01}\n")
    robot = calib.load(tmp_path / "medrue.yaml")
    data = calib.read_measurements(EXAMPLES / "medrue_simulated.csv", medrue)
    joints_read = data.joints.copy()
    j = medrue.joint_names.index("q2")
    joints_read[:, j] = joints_read[:, j] / 1.01  # told less than it is
    told = calib.as_measurements(robot, joints_read, data.points(medrue))
    train, test = told.split(validation=0.7, seed=1)
    fit = calib.fit(robot, train, validation=test)
    fit.save(tmp_path / "out", pages=False)
    alone = calib.fit(medrue, train, validation=test)
    by_name = {holds: file.accuracy.rms for holds, file in calib.load(tmp_path / "out").files.items()}
    assert by_name[Holds.ORIGINS] == pytest.approx(alone.validation.rms("after"), rel=1e-4)
    assert by_name[Holds.EVERYTHING] < by_name[Holds.ORIGINS] < by_name[Holds.ZEROS]
    (tmp_path / "again").mkdir()
    shutil.copy(tmp_path / "out" / "calibrated.urdf", tmp_path / "again" / "medrue.urdf")
    (tmp_path / "again" / "medrue.yaml").write_text(text)
    again = calib.load(tmp_path / "again" / "medrue.yaml")
    q = test.joints[:10]
    np.testing.assert_allclose(again.forward(q, "tool"), alone.robot.forward(q, "tool"), atol=2e-6)


def test_a_robot_that_is_taken_as_it_is_is_no_worse_than_itself(tmp_path, true_tip):
    """The robot before has its places from all poses; each pose left out is placed by the others."""
    yaml = YAML.replace("{frame: l0}", "{frame: l0, pose: unknown}").replace("parametrisation:", "parametrisation: []")
    placed = calib.load(write_six_axis(tmp_path, yaml))
    fit = calib.fit(placed, measured(placed, true_tip, 40, 7))
    assert "before" not in fit.verdict.claim.words
    assert fit.verdict.to_dict()["claim"]["rms_before"] is None
    assert "file_withheld" not in fit.verdict.to_dict()["codes"]
    fit.save(tmp_path / "out", pages=False)
    assert (tmp_path / "out" / "calibrated.urdf").read_bytes() == placed.urdf.source
