"""The result folder: what is written is true, reads back, and is never half overwritten."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from small_robots import ARM_YAML, PARALLELOGRAM_YAML, write_arm, write_parallelogram

import calib
from calib.data.tables import read_table
from calib.errors import CalibrationError, DataError, InputError
from calib.reporting.results import load_calibrated, load_uncertainty, read_result, save

CONTRACT = ("version", "robot", "converged", "message", "seconds", "n_poses", "n_rows", "n_parameters", "rank",
            "redundant", "sigma", "observability", "parameters", "errors")  # fmt: skip
SIGMA = 20e-6


@pytest.fixture(scope="module", autouse=True)
def _without_pages():
    """Report pages take seconds, and have tests of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("calib.reporting.results.entry_points", lambda group: ())
        yield


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
    off = np.array([p.sigma * generator.normal() * free for p, free in zip(arm.parameters, arm.is_free, strict=True)])
    truth = arm.with_parameters(arm.values + off)
    return calib.fit(arm, measured(truth, 30, 22), validation=measured(truth, 12, 23))


@pytest.fixture(scope="module")
def folder(fitted, tmp_path_factory):
    path = tmp_path_factory.mktemp("results") / "out"
    save(fitted, path)
    return path


def tree(folder):
    return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


def strict(text):
    """Parse JSON as every other program does: without NaN and Infinity."""

    def refuse(constant):
        raise ValueError(constant)

    return json.loads(text, parse_constant=refuse)


def test_the_contract_s_files_are_there(folder):
    assert {"result.json", "calibrated.urdf", "parameters.csv", "residuals.csv"} <= set(tree(folder))


def test_result_json_says_what_the_contract_asks(folder, fitted):
    content = strict((folder / "result.json").read_text())
    assert set(CONTRACT) <= set(content)
    assert content == read_result(folder)
    assert content["converged"] is True
    assert content["robot"] == fitted.nominal.path
    assert (content["n_poses"], content["n_rows"], content["n_parameters"]) == (30, 30, 23)
    assert content["redundant"] == ["turn.x"]
    assert 0 < content["sigma"] < 1e-3  # metres
    assert 0 < content["seconds"] < 60
    assert set(content["observability"]) == {"O1", "O2", "O3", "O4", "O5"}


def test_parameters_are_listed_in_mm_and_deg_and_a_held_one_has_no_uncertainty(folder, fitted):
    rows = read_result(folder)["parameters"]
    keys = ["name", "unit", "nominal", "value", "std", "low95", "high95", "status"]
    for row, parameter, value, free in zip(
        rows, fitted.robot.parameters, fitted.robot.values, fitted.free, strict=True
    ):
        assert list(row)[:8] == keys
        scale = 1e3 if parameter.dimension == "length" else 180 / np.pi
        assert (row["name"], row["unit"]) == (parameter.name, "mm" if parameter.dimension == "length" else "deg")
        assert row["nominal"] == pytest.approx(parameter.nominal * scale, rel=1e-15)
        assert row["value"] == pytest.approx(value * scale, rel=1e-15)
        if free:
            assert row["low95"] < row["value"] < row["high95"]
            assert 0 < row["std"] <= parameter.sigma * scale * (1 + 1e-9)  # never wider than its prior
            assert row["status"] != "held"
        else:
            assert row["std"] is None
            assert row["low95"] is None
            assert row["high95"] is None
            assert row["status"] == "held"


@pytest.mark.parametrize(
    ("name", "state"), [(n, s) for n in ("identification", "validation") for s in ("before", "after")]
)
def test_the_error_tables_are_those_of_the_robots(folder, fitted, name, state):
    data = getattr(fitted, name).data
    robot = {"before": fitted.nominal, "after": fitted.robot}[state]
    error = 1e3 * (robot.positions(data.joints) - data.points(robot))[:, 0]
    distance = np.linalg.norm(error, axis=1)
    table = read_result(folder)["errors"][name][state]
    expected = {
        "mean": distance.mean(),
        "max": distance.max(),
        "rms": np.sqrt((distance**2).mean()),
        "std": distance.std(ddof=1),
    }
    for key, value in expected.items():
        assert table[key] == pytest.approx(value, rel=1e-9)
    for axis, values in zip("xyz", error.T, strict=True):
        assert table[axis]["max"] == pytest.approx(np.abs(values).max(), rel=1e-6)  # of one component: more cancels
        assert table[axis]["mean"] == pytest.approx(np.abs(values).mean(), rel=1e-6)


def test_the_calibrated_robot_reads_back_to_the_last_digits(folder, fitted):
    robot = load_calibrated(folder, fitted.nominal)
    assert np.abs(robot.values - fitted.robot.values).max() < 1e-15
    q = fitted.identification.data.joints
    assert np.abs(robot.positions(q) - fitted.robot.positions(q)).max() < 1e-14


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
    joints = np.stack(
        [table.column(name, "length" if name == "slide" else "angle") for name in fitted.robot.joint_names], 1
    )
    measured_at = np.stack([table.column(f"measured_{axis}", "length") for axis in "xyz"], 1)
    for state, robot in (("before", fitted.nominal), ("after", fitted.robot)):
        error = np.stack([table.column(f"error_{state}_{axis}", "length") for axis in "xyz"], 1)
        assert np.abs(robot.positions(joints)[:, 0] - measured_at - error).max() < 1e-12


def test_predict_uses_the_result(folder, fitted, run_calib, tmp_path):
    q = np.array([[0.3, 0.2, -0.4]])
    (tmp_path / "q.csv").write_text("turn,slide,wrist\n0.3,0.2,-0.4\n")
    run = run_calib("predict", fitted.nominal.path, "q.csv", "--result", folder, "--out", "p.csv", cwd=tmp_path)
    assert run.code == 0, run.err
    table = read_table(tmp_path / "p.csv")
    found = [table.column(f"tip_{axis}", "length")[0] for axis in "xyz"]
    assert np.abs(fitted.robot.positions(q)[0, 0] - found).max() < 1e-14


def test_a_second_result_replaces_the_first_and_leaves_other_files(fitted, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "result.json").write_text("old")
    out = tmp_path
    fitted.save(out)
    assert (out / "notes.txt").read_text() == "mine"
    assert read_result(out)["n_poses"] == 30


@pytest.mark.parametrize("failing", ["result.json", "calibrated.urdf", "residuals.csv"])
def test_a_result_that_cannot_be_written_leaves_the_old_one(fitted, tmp_path, monkeypatch, failing):
    out = tmp_path / "out"
    save(fitted, out)
    (out / "notes.txt").write_text("mine")
    before = tree(out)
    write_bytes = Path.write_bytes

    def disk_full(self, data):
        if self.name == failing:
            write_bytes(self, data[: len(data) // 2])
            raise OSError(28, "No space left on device")
        return write_bytes(self, data)

    monkeypatch.setattr(Path, "write_bytes", disk_full)
    with pytest.raises(InputError, match="no space left on device"):
        save(fitted, out)
    assert tree(out) == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_saving_twice_gives_the_same_bytes(fitted, folder, tmp_path):
    save(fitted, tmp_path / "again")
    again = tree(tmp_path / "again")
    for name in ("result.json", "calibrated.urdf", "parameters.csv", "residuals.csv"):
        assert again[name] == (folder / name).read_bytes()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "holds no result (no result.json); give the folder that `calib fit --out` wrote"),
        ("", "cannot be read"),
        ("{", "cannot be read"),
        ('{"a":' * 100_000, "cannot be read"),
        ("[1, 2]", "is not a result of format version"),
        ('{"version": 999}', "is not a result of format version"),
        (b"\xff\xfe\x00", "is not UTF-8 text"),
        ('{"version": 1, "robot"', "cannot be read"),
    ],
)
def test_a_folder_without_a_result_is_an_error(tmp_path, content, message):
    if content is not None:
        (tmp_path / "result.json").write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(DataError) as caught:
        read_result(tmp_path)
    assert message in str(caught.value)
    assert str(tmp_path) in str(caught.value)


def test_a_file_in_the_place_of_the_folder_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "absent"):
        with pytest.raises(DataError, match=r"file|absent"):
            read_result(path)


def test_the_result_of_another_robot_is_refused(folder, tmp_path):
    other = calib.load(write_parallelogram(tmp_path, PARALLELOGRAM_YAML))
    with pytest.raises(DataError, match=r"is the result of another robot \(.*arm\.yaml\); its parameters differ"):
        load_calibrated(folder, other)


@pytest.mark.parametrize("damage", ["missing", "truncated", "another name", "another value", "no value"])
def test_a_damaged_result_is_an_error_and_never_another_robot(fitted, folder, tmp_path, damage):
    for name, content in tree(folder).items():
        (tmp_path / name).write_bytes(content)
    path = tmp_path / "parameters.csv"
    if damage == "missing":
        path.unlink()
    elif damage == "truncated":
        lines = path.read_text().splitlines()
        path.write_text("\n".join(lines[:-3]) + "\n")
    elif damage == "another name":
        path.write_text(path.read_text().replace("slide.x", "slide.q"))
    else:
        result = json.loads((tmp_path / "result.json").read_text())
        result["parameters"][3]["value"] = None if damage == "no value" else result["parameters"][3]["value"] + 0.001
        (tmp_path / "result.json").write_text(json.dumps(result))
    with pytest.raises(CalibrationError, match="parameters"):
        load_calibrated(tmp_path, fitted.nominal)


@pytest.mark.parametrize("damage", ["missing", "not finite", "no freedom"])
def test_a_damaged_covariance_gives_no_uncertainty(fitted, folder, tmp_path, damage):
    for name, content in tree(folder).items():
        (tmp_path / name).write_bytes(content)
    path = tmp_path / "covariance.csv"
    if damage == "missing":
        path.unlink()
    elif damage == "not finite":
        lines = path.read_text().splitlines()
        lines[-1] = ",".join([*lines[-1].split(",")[:-1], "inf"])
        path.write_text("\n".join(lines) + "\n")
    else:
        result = json.loads((tmp_path / "result.json").read_text())
        (tmp_path / "result.json").write_text(json.dumps(result | {"degrees_of_freedom": "many"}))
    with pytest.raises(CalibrationError, match="run the fit again"):
        load_uncertainty(tmp_path, fitted.nominal)
