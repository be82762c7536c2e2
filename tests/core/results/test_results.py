"""The result folder: what is written is true, reads back, and is never half overwritten."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.core.base.errors import CalibrationError, ComputationError, DataError
from calib.core.data.tables import read_table
from calib.core.results.result_reading import load_result, read_content
from calib.core.results.results import save
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.description import description_yaml, read_description
from tests.project import EXAMPLES, ROOT, copied, write_table
from tests.saved_results import with_verdict
from tests.signed_files import read_plain
from tests.small_robots import ARM_YAML, PARALLELOGRAM_YAML, write_arm, write_parallelogram

CONTRACT = ("version", "robot", "converged", "message", "seconds", "n_poses", "n_rows", "n_parameters", "rank",
            "redundant", "sigma", "observability", "parameters", "errors")  # fmt: skip
SIGMA = 20e-6
EVERYTHING = """\
urdf: arm.urdf
name_mot: [turn, slide, wrist]
base: {frame: ground, xyz: [1 mm, 0.1, 0], rpy: [0, 90 deg, 0], pose: unknown}
targets:
  tip: {frame: tool, xyz: [10 mm, 20 mm, 30 mm], position: unknown, sigma: 3 mm}
  "on": {frame: tool, orientation: unknown, sigma_angle: 3 mrad}
instruments:
  tracker: {kind: position, target: tip, sigma: {range: 10 um, angle: 0.01 mrad}}
  camera: {kind: pose, target: "on", rotation: quaternion, sigma: [1 mm, 2 mm, 0.003], sigma_angle: 1e-3}
  eye: {kind: pixel, target: "on", camera: {frame: ground}, intrinsics: {fx: 1e3, fy: 1000, cx: 5, cy: 6},
    points_file: points.csv, unknown_intrinsics: {fx: 2}}
  ball: {kind: touch, target: tip, surface: sphere, radius: 2 mm, places: {
    a: {frame: ground, radius: unknown}, b: {frame: ground, radius: 3 mm},
    c: {frame: ground, position: unknown, radius: {value: 4 mm, sigma: 0.1 mm}}}}
  wrist_reader: {kind: joint_reading, joint: wrist}
setups: {first: [], second: [base, tip]}
parametrisation:
  - {origin: all, components: [x, y], sigma: 2 mm}
  - {joint: all, term: curve, orders: 7, stroke: 1 m}
  - {joint: slide, term: harmonics, period: 5 mm, sigma: 10 um}
held: [turn.x]
priors: false
columns: {"T": "turn [deg]"}
"""


def measured(robot, n_poses, seed):
    generator = np.random.default_rng(seed)
    q = generator.uniform([-1.5, 0, -1.5], [1.5, 0.5, 1.5], (n_poses, 3))
    labels = tuple(f"pose {k}" for k in range(n_poses))
    return calib.simulate(robot, calib.Poses(q, labels, labels, "simulated", ()), SIGMA, generator)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    """A fit of the small arm, one parameter held."""
    yaml = ARM_YAML + "held: [turn.x]\nsigma: 20 um\n"
    arm = calib.load(write_arm(tmp_path_factory.mktemp("arm"), yaml))
    generator = np.random.default_rng(21)
    off = np.array([parameter.sigma_si * generator.normal() for parameter in arm.parameters])
    truth = arm.with_parameters(arm.values + off * arm.is_free)
    return calib.fit(arm, measured(truth, 30, 22), validation=measured(truth, 12, 23))


@pytest.fixture(scope="module")
def folder(fitted, tmp_path_factory):
    path = tmp_path_factory.mktemp("results") / "out"
    save(fitted, path)
    return path


def test_result_json_says_what_the_contract_asks(folder, fitted):
    content = json.loads((folder / "result.json").read_text(), parse_constant=pytest.fail)  # neither NaN nor Infinity
    assert set(CONTRACT) <= set(content)
    assert content == read_content(folder)
    assert content["converged"] is True
    assert content["robot"] == fitted.nominal.path
    assert (content["n_poses"], content["n_rows"], content["n_parameters"]) == (30, 30, 23)
    assert content["redundant"] == ["turn.x"]
    assert 0 < content["sigma"] < 1e-3  # metres
    assert 0 < content["seconds"] < 60
    assert set(content["observability"]) == {"O1", "O2", "O3", "O4", "O5"}


def test_parameters_are_listed_in_mm_and_deg_and_a_held_one_has_no_uncertainty(folder, fitted):
    rows = read_content(folder)["parameters"]
    for row, parameter, value, free in zip(
        rows, fitted.robot.parameters, fitted.robot.values, fitted.free, strict=True
    ):
        assert list(row)[:8] == ["name", "unit", "nominal", "value", "std", "low95", "high95", "status"]
        scale = 1e3 if parameter.dimension == "length" else 180 / np.pi
        assert (row["name"], row["unit"]) == (parameter.name, "mm" if parameter.dimension == "length" else "deg")
        assert row["nominal"] == pytest.approx(parameter.nominal_si * scale, rel=1e-15)
        assert row["value"] == pytest.approx(value * scale, rel=1e-15)
        if free:
            assert row["low95"] < row["value"] < row["high95"]
            assert 0 < row["std"] <= parameter.sigma_si * scale * (1 + 1e-9)  # never wider than its prior
            assert row["status"] != "held"
        else:
            assert list(row.values())[4:8] == [None, None, None, "held"]


@pytest.mark.parametrize("state", ["before", "after"])
@pytest.mark.parametrize("name", ["identification", "validation"])
def test_the_error_tables_are_those_of_the_robots(folder, fitted, name, state):
    data = getattr(fitted, name).data
    robot = {"before": fitted.nominal, "after": fitted.robot}[state]
    error = 1e3 * (robot.positions(data.joints) - data.points(robot))[:, 0]
    distance = np.linalg.norm(error, axis=1)
    table = read_content(folder)["errors"][name][state]
    expected = [distance.mean(), distance.max(), np.sqrt((distance**2).mean()), distance.std(ddof=1)]
    assert [table[key] for key in ("mean", "max", "rms", "std")] == pytest.approx(expected, rel=1e-9)
    for axis, values in zip("xyz", error.T, strict=True):
        assert table[axis]["max"] == pytest.approx(np.abs(values).max(), rel=1e-6)  # of one component: more cancels
        assert table[axis]["mean"] == pytest.approx(np.abs(values).mean(), rel=1e-6)


def test_the_calibrated_urdf_differs_in_origins_only_and_gives_the_same_robot(folder, fitted, tmp_path):
    written = (folder / "calibrated.urdf").read_bytes()
    blank = re.compile(rb"<origin[^>]*>")
    assert blank.sub(b"", written) == blank.sub(b"", fitted.nominal.urdf.source)
    path = write_arm(tmp_path)
    (tmp_path / "arm.urdf").write_bytes(written)
    q = fitted.identification.data.joints
    assert np.abs(calib.load(path).positions(q) - fitted.robot.positions(q)).max() < 1e-12


def test_residuals_are_predicted_minus_measured_of_every_pose(folder, fitted):
    table = read_table(folder / "residuals.csv")
    assert table.text("set") == ["identification"] * 30 + ["validation"] * 12
    dimensions = {"turn": "angle", "slide": "length", "wrist": "angle"}
    joints = np.stack([table.column(*column) for column in dimensions.items()], 1)
    measured_at = np.stack([table.column(f"measured_{axis}", "length") for axis in "xyz"], 1)
    for state, robot in (("before", fitted.nominal), ("after", fitted.robot)):
        error = np.stack([table.column(f"error_{state}_{axis}", "length") for axis in "xyz"], 1)
        assert np.abs(robot.positions(joints)[:, 0] - measured_at - error).max() < 1e-12


def test_where_a_reading_has_no_number_its_cell_is_empty(folder):
    table = read_table(folder / "residuals.csv")
    assert all(table.text("leverage")[:30])
    for column in ("leverage", "studentised", "weight"):
        assert table.text(column)[30:] == [""] * 12  # of readings that were not fitted
    assert table.text("loop_singular_value") == [""] * 42  # the arm has no loops


def test_saving_twice_gives_the_same_bytes(fitted, folder, tmp_path):
    save(fitted, tmp_path / "again")
    for name in ("result.json", "calibrated.urdf", "parameters.csv", "residuals.csv"):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "holds no result (no result.json); give the folder that `calib fit --out` wrote"),
        ("", "cannot be read"),
        ("{", "cannot be read"),
        ('{"a":' * 100_000, "cannot be read"),
        ("[1, 2]", "is not a result of format version 1"),
        ('{"version": 999}', "is not a result of format version"),
        (b"\xff\xfe\x00", "is not UTF-8 text"),
        ('{"version": 1, "robot"', "cannot be read"),
        ('{"version": 1, "robot": ""}', "is a damaged result of format version 1"),
        ('{"version": 2}', "fit.npz of a later one is missing"),
    ],
)
def test_a_folder_without_a_result_is_an_error(tmp_path, content, message):
    if content is not None:
        (tmp_path / "result.json").write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(DataError) as caught:
        read_content(tmp_path)
    assert message in str(caught.value)
    assert str(tmp_path) in str(caught.value)
    for name in ("result.json", "absent"):  # a file, or nothing, in the place of the folder
        with pytest.raises(DataError, match=name):
            read_content(tmp_path / name)


def test_the_result_of_another_robot_is_refused(folder, tmp_path):
    other = calib.load(write_parallelogram(tmp_path, PARALLELOGRAM_YAML))
    with pytest.raises(DataError, match=r"is the result of another robot \(.*arm\.yaml\); its parameters differ"):
        load_result(folder, other)


def test_the_result_of_another_model_of_the_same_joints_is_refused(folder, tmp_path):
    own = calib.load(folder)
    text = (folder / "nominal.urdf").read_text()
    joint = next(joint for joint in own.urdf.joints if any(joint.xyz))
    shift = text.replace(" ".join(f"{x:g}" for x in joint.xyz), " ".join(f"{x + 0.1:g}" for x in joint.xyz), 1)
    assert shift != text
    (tmp_path / "nominal.urdf").write_text(shift)
    shutil.copy(folder / "nominal.yaml", tmp_path)
    with pytest.raises(DataError, match=f"whose joint '{joint.name}' has another origin or axis in its URDF"):
        load_result(folder, calib.load(tmp_path / "nominal.yaml"))


def test_a_damaged_result_is_an_error_and_never_another_robot(fitted, folder, tmp_path):
    """Bits at random, and ends, of what is read back."""
    shutil.copytree(folder, tmp_path / "out")
    path, whole, rng = tmp_path / "out" / "fit.npz", (folder / "fit.npz").read_bytes(), np.random.default_rng(5)
    damaged = [whole[:end] for end in range(0, len(whole), len(whole) // 30)]
    for place in rng.integers(0, len(whole), 80):
        damaged.append(whole[:place] + bytes([whole[place] ^ (1 << int(rng.integers(8)))]) + whole[place + 1 :])
    errors = []
    for content in damaged:
        path.write_bytes(content)
        try:
            loaded = load_result(tmp_path / "out")
        except DataError as error:
            errors.append(str(error))
        else:  # what was hit says nothing, such as a date in the zip
            np.testing.assert_array_equal(loaded.robot.values, fitted.robot.values)
            assert loaded.content == json.loads((folder / "result.json").read_text())
    assert len(errors) > 0.8 * len(damaged)
    assert all(re.fullmatch(r"[^\n]*fit\.npz: cannot be read [^\n]*; run the fit again", error) for error in errors)


def test_arrays_that_do_not_belong_together_are_an_error(folder, tmp_path):
    """As another program could write them back: the zip's check sums are right."""
    shutil.copytree(folder, tmp_path / "out")
    arrays = dict(np.load(folder / "fit.npz"))
    visits = next(name for name, array in arrays.items() if array.dtype.kind == "i" and array.size)
    arrays[visits] = arrays[visits] + 10**6
    np.savez(tmp_path / "out" / "fit.npz", **arrays)
    with pytest.raises(ComputationError, match="cannot evaluate the fit"):
        _ = load_result(tmp_path / "out").fit


def test_what_people_read_may_be_edited_or_lost(fitted, folder, tmp_path):
    out = tmp_path / "out"
    shutil.copytree(folder, out)
    for name in ("parameters.csv", "covariance.csv", "residuals.csv", "calibrated.urdf", ".written-by-calib.json"):
        (out / name).unlink()
    (out / "result.json").write_text("{}")
    loaded = load_result(out)
    np.testing.assert_array_equal(loaded.robot.values, fitted.robot.values)
    np.testing.assert_allclose(loaded.covariance, fitted.covariance, rtol=1e-12)
    assert (loaded.verdict.grade, loaded.rms) == (fitted.verdict.grade, pytest.approx(fitted.rms, rel=1e-9))


def test_a_fit_comes_back_whole(tmp_path):
    """Its residuals, intervals and noise, with outliers left out, folds, a robust loss and unknown noise."""
    arm = calib.load(write_arm(tmp_path, ARM_YAML))
    data = measured(arm, 40, 3)
    values = data.readings["tip"].values.copy()
    values[7] += 0.004
    data = replace(data, readings={"tip": replace(data.readings["tip"], values=values)})
    for number, options in enumerate(({"exclude_outliers": True, "folds": 4}, {"loss": "huber"})):
        fit = calib.fit(arm, data, **options)
        save(fit, tmp_path / f"out{number}", force=True)
        again = load_result(tmp_path / f"out{number}", failed_too=True).fit
        assert (again.excluded, again.loss, again.convergence) == (fit.excluded, fit.loss, fit.convergence)
        assert again.errors.keys() == fit.errors.keys()
        np.testing.assert_allclose(again.residuals["tip"], fit.residuals["tip"], rtol=0, atol=1e-12)
        ours, theirs = fit.covariance.values, again.covariance.values
        std = np.sqrt(np.diag(ours))  # an entry near zero is the rest of large ones
        assert np.all(np.abs(theirs - ours) <= 1e-9 * np.outer(std, std))
        np.testing.assert_array_equal(again.weights, fit.weights)
        assert again.sigma == pytest.approx(fit.sigma, rel=1e-9)
        assert again.rms == pytest.approx(fit.rms, rel=1e-9)
        for name, estimate in fit.parameters.items():
            assert again.parameters[name].interval == pytest.approx(estimate.interval, rel=1e-7, abs=1e-9, nan_ok=True)


def test_a_folder_of_version_1_is_still_read(run_calib, tmp_path):
    """One that version 0.1.0 wrote, with what it predicted then."""
    old = ROOT / "tests" / "version_1"
    content, loaded = json.loads((old / "result.json").read_text()), calib.load_result(old)
    assert (loaded.verdict.grade, loaded.sigma) == (content["verdict"]["grade"], content["sigma"])
    for row in content["parameters"]:
        assert loaded.parameters[row["name"]].value == pytest.approx(row["value"], rel=1e-12, abs=1e-15)
    predicted, table = tmp_path / "p.csv", read_table(old / "predicted.csv")
    assert run_calib("predict", old, old / "predicted.csv", "--out", predicted).code == 0
    for column in table.names[4:]:
        again = read_table(predicted).text(column)
        np.testing.assert_allclose(list(map(float, again)), list(map(float, table.text(column))), rtol=1e-9)
    robot, uncertainty = loaded.held_by(Holds.ORIGINS)
    assert not robot.terms
    assert len(uncertainty.covariance) == int(np.sum(uncertainty.free))
    assert loaded.promise.freedom == content["degrees_of_freedom"]
    assert (len(loaded.joints), *map(len, loaded.readings().values())) == (30, 30, 10)
    assert run_calib("verify", old, old / "residuals.csv").code == 2  # no measurements: what it needs is named


@pytest.mark.parametrize(
    ("name", "edit"),
    [
        ("result.json", lambda text: text.replace('"parameters": [', '"parameters": [3, ')),
        ("result.json", lambda text: text.replace('"grade": "PASS"', '"grade": "GOOD"')),
        ("result.json", lambda text: text.replace('"files": [', '"files": [7, ')),
        ("result.json", lambda text: text.replace('"sha256": {', '"sha": {')),
        ("result.json", lambda text: text[:-40]),
        ("parameters.csv", lambda text: text.replace("turn.x", "turn.q")),
        ("covariance.csv", lambda text: text + "1"),
        ("without_terms.csv", lambda text: ""),
        ("nominal.urdf", lambda text: text.replace("0", "1")),
    ],
)
def test_a_damaged_folder_of_version_1_is_one_clear_line(run_calib, tmp_path, name, edit):
    shutil.copytree(ROOT / "tests" / "version_1", tmp_path / "old")
    (tmp_path / "old" / name).write_text(edit((tmp_path / "old" / name).read_text()))
    run = run_calib("predict", tmp_path / "old", tmp_path / "old" / "predicted.csv", "--out", tmp_path / "p.csv")
    assert (run.code, run.err.count("\n")) == (2, 1)
    assert "run the fit again" in run.err


def test_tables_for_spreadsheets_have_what_result_json_has_in_the_same_units(fitted, folder):
    rows = json.loads((folder / "result.json").read_text())["parameters"]
    table = read_table(folder / "parameters.csv")
    assert table.names == ("parameter", "nominal", "value", "std", "low95", "high95", "unit", "status")
    for key in ("nominal", "value", "std", "low95", "high95"):
        numbers = [float(cell) for cell in table.text(key)]
        np.testing.assert_array_equal(numbers, [np.nan if row[key] is None else row[key] for row in rows])
    assert table.text("status") == [row["status"] for row in rows]
    assert {row["unit"] for row in rows} == {"mm", "deg"}
    covariance = read_table(folder / "covariance.csv")
    values = np.array([[float(cell) for cell in row[2:]] for row in covariance.rows])
    std = [row["std"] for row in rows if row["name"] in covariance.text("parameter")]
    np.testing.assert_allclose(np.sqrt(np.diag(values)), std, rtol=1e-12)  # one product and one root
    np.testing.assert_allclose(load_result(folder).covariance, fitted.covariance, rtol=1e-12)


@pytest.mark.parametrize("name", ["arm", "five_bar", "motoman_right", "medrue", "everything"])
def test_a_description_is_written_so_that_it_reads_back_the_same(tmp_path, name):
    path = ROOT / "urdf" / "medrue.yaml" if name == "medrue" else EXAMPLES / f"{name}.yaml"
    if name == "everything":
        (tmp_path / "points.csv").write_text("point,x [mm],y,z\np1,1,2,3\np2,0.1,0,1e-5\n")
        (path := tmp_path / "all.yaml").write_text(EVERYTHING)
    before = read_description(path)
    (tmp_path / "elsewhere").mkdir()
    written = tmp_path / "elsewhere" / "again.yaml"
    written.write_text(description_yaml(before), encoding="utf-8")
    after = read_description(written)
    assert after == before
    assert str(after.model_dump()) == str(before.model_dump())  # to the last digit
    assert description_yaml(after) == description_yaml(before)


@pytest.mark.quick(0)
@pytest.mark.parametrize(("name", "joint"), [("arm", "joint_2"), ("five_bar", "left_motor")])
def test_a_folder_that_was_moved_loads_as_the_calibrated_robot(tmp_path, name, joint):
    generator = np.random.default_rng(5)
    gain = ("parametrisation:\n", "parametrisation:\n  - {joint: all, term: gain}\n")
    more = f"\njoint_terms: [{{joint: {joint}, term: harmonics, orders: [1, 3]}}, {{joint: {joint}, term: backlash}}]"
    nominal = calib.load(copied(tmp_path, EXAMPLES / f"{name}.yaml", gain, more=more))
    q = nominal.home + generator.uniform(-0.08, 0.08, (90, len(nominal.joint_names)))
    truth = nominal.with_parameters(nominal.values + [p.sigma_si * generator.normal() for p in nominal.parameters])
    fit = calib.fit(nominal, calib.simulate(truth, calib.as_poses(nominal, q), SIGMA, generator))
    assert np.all(fit.robot.values[fit.robot.coefficients][:2] != 0.0)
    fit.save(tmp_path / "out", force=True)
    shutil.move(tmp_path / "out", tmp_path / "moved")
    Path(nominal.path).unlink()
    robot = calib.load(tmp_path / "moved")
    assert robot.path == str(tmp_path / "moved")
    for frame in (None, *robot.urdf.links):
        assert np.abs(robot.forward(q, frame) - fit.robot.forward(q, frame)).max() < 1e-12
    assert robot.parameters == fit.nominal.parameters


def test_a_plain_urdf_and_its_meshes_are_in_the_folder(tmp_path):
    write_arm(tmp_path)
    text = (tmp_path / "arm.urdf").read_text()
    mesh = '<link name="hand"><visual><geometry><mesh filename="shapes/a &amp; b.stl"/></geometry></visual></link>'
    (tmp_path / "arm.urdf").write_text(text.replace('<link name="hand"/>', mesh))
    (tmp_path / "shapes").mkdir()
    (tmp_path / "shapes" / "a & b.stl").write_bytes(b"solid")
    arm = calib.load(tmp_path / "arm.urdf")
    fit = calib.fit(arm, measured(arm, 40, 1), sigma=SIGMA)
    fit.save(tmp_path / "out" / "deep", force=True)
    robot = calib.load(tmp_path / "out" / "deep")
    q = fit.identification.data.joints
    assert np.abs(robot.positions(q) - fit.robot.positions(q)).max() < 1e-12
    again = (tmp_path / "out" / "deep" / "nominal.urdf").read_text()
    assert str(tmp_path / "shapes" / "a &amp; b.stl") in again
    assert again.replace(f"{tmp_path}/", "") == (tmp_path / "arm.urdf").read_text()


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        ("fit.npz", "fit.npz of a later one is missing"),
        ("nominal.yaml", "nominal.yaml: no such file; run the fit again"),
        ("nominal.urdf", "nominal.urdf: no such file; run the fit again"),
        ("another robot", "nominal.yaml: was changed after the fit"),
        ("another urdf", "nominal.urdf: was changed after the fit"),
        ("failed", "the fit failed and gives no calibrated robot"),
    ],
)
def test_a_folder_that_gives_no_robot_is_one_clear_line(fitted, folder, tmp_path, run_calib, damage, message):
    out = tmp_path / "out"
    shutil.copytree(folder, out)
    if (out / damage).is_file():
        (out / damage).unlink()
    elif damage == "another robot":
        (out / "nominal.yaml").write_text((out / "nominal.yaml").read_text().replace("[x, y, z]", "[x, y]"))
    elif damage == "another urdf":
        (out / "nominal.urdf").write_text((out / "nominal.urdf").read_text().replace("1e-1", "2e-1"))
    else:
        with_verdict(out, "FAIL", "no reason")
    with pytest.raises(CalibrationError) as caught:
        calib.load(out)
    assert message in str(caught.value)
    assert isinstance(caught.value, ComputationError if damage == "failed" else CalibrationError)
    (tmp_path / "q.csv").write_text("turn,slide,wrist\n0.3,0.2,-0.4\n")
    run = run_calib("predict", out, "q.csv", "--out", "p.csv", cwd=tmp_path)
    assert (run.code, run.err.count("\n")) == (3 if damage == "failed" else 2, 1)
    assert message in run.err


@pytest.mark.quick(0)
def test_every_command_takes_a_folder_as_the_robot_and_means_the_same_as_with_result(
    fitted, folder, run_calib, tmp_path
):
    generator = np.random.default_rng(8)
    q = generator.uniform([-1.5, 0, -1.5], [1.5, 0.5, 1.5], (40, 3))
    write_table(tmp_path / "q.csv", "turn,slide,wrist", np.round(q, 6))
    write_table(tmp_path / "t.csv", "tip_x,tip_y,tip_z", fitted.robot.positions(q[:3])[:, 0])
    shutil.copytree(folder, tmp_path / "done")
    for command, *rest in (
        ("predict", "q.csv", "--out", "OUT"),
        ("solve", "t.csv", "--out", "OUT"),
        ("select", "q.csv", "--count", "12", "--out", "OUT"),
        ("export", "--format", "urdf", "--provenance", "--out", "OUT"),
        ("check", "q.csv", "--json", "OUT"),
    ):
        contents = []
        for k, (robot, *values) in enumerate([("done",), (fitted.nominal.path, "--result", "done")]):
            out = f"{command}_{k}"
            run = run_calib(command, robot, *[out if word == "OUT" else word for word in rest], *values, cwd=tmp_path)
            assert run.code == 0, run.err
            text = read_plain(tmp_path / out).decode()
            text = text.replace("done/nominal.urdf", fitted.nominal.urdf.path).replace('"robot": "done"', "robot")
            contents.append(text.replace(f'"robot": "{fitted.nominal.path}"', "robot"))
        assert contents[0] == contents[1]
    run = run_calib("simulate", "done", "q.csv", "--sigma-mm", "0", "--seed", "1", "--out", "m.csv", cwd=tmp_path)
    assert run.code == 0, run.err
    assert "truth: done" in (tmp_path / "m.csv").read_text()
    run = run_calib("fit", "done", "m.csv", "--sigma-mm", "0.02", "--out", "again", cwd=tmp_path)
    assert run.code in (0, 3), run.err
    before = read_content(tmp_path / "again")["errors"]["identification"]["before"]
    assert before["max"] < 1e-3  # mm: the digits of the file; before is the calibrated robot
