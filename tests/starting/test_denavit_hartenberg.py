"""Denavit-Hartenberg tables: published ones against textbook products, the way out and back in, and bad files."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from click.testing import CliRunner

import calib
from calib.core.robots.robot_files import urdf_of_origins
from calib.exporting.dh_tables import dh_table, table_poses
from calib.shared.denavit_hartenberg import DhRow
from calib.starting.command import command as init_command
from calib.starting.dh_tables import read_dh
from tests.core.data.test_parameter_files import parameter_file
from tests.exporting.read_back import in_file

ROUNDING = 1e-12
"""A few dozen roundings of lengths of 1 m, through rpy angles and decimal degrees."""
HALF = np.pi / 2

# a [m], d [m], alpha [rad], theta [rad] of each joint; P: prismatic
MOTOMAN = [  # right arm, as its owners publish it with their measurements
    (0.0, -0.263, np.deg2rad(15), -HALF), (0.15, 1.4159, -HALF, 0.0), (0.614, 0.0, np.pi, -HALF),
    (0.2, 0.0, -HALF, 0.0), (0.0, -0.64, HALF, 0.0), (0.03, 0.0, HALF, -HALF), (0.0, 0.2, 0.0, 0.0),
]  # fmt: skip
PUMA = [  # Corke, Robotics, Vision and Control
    (0.0, 0.0, HALF, 0.0), (0.4318, 0.0, 0.0, 0.0), (0.0203, 0.15005, -HALF, 0.0), (0.0, 0.4318, HALF, 0.0),
    (0.0, 0.0, -HALF, 0.0), (0.0, 0.0, 0.0, 0.0),
]  # fmt: skip
UR10 = [  # Universal Robots
    (0.0, 0.1273, HALF, 0.0), (-0.612, 0.0, 0.0, 0.0), (-0.5723, 0.0, 0.0, 0.0), (0.0, 0.163941, HALF, 0.0),
    (0.0, 0.1157, -HALF, 0.0), (0.0, 0.0922, 0.0, 0.0),
]  # fmt: skip
STANFORD = [  # Paul; the third joint slides
    (0.0, 0.412, -HALF, 0.0), (0.0, 0.154, HALF, 0.0), (0.0, 0.0, 0.0, -HALF), (0.0, 0.0, -HALF, 0.0),
    (0.0, 0.0, HALF, 0.0), (0.0, 0.263, 0.0, 0.0),
]  # fmt: skip
PUMA_MODIFIED = [  # Craig, Introduction to Robotics, with the lengths of PUMA
    (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, -HALF, 0.0), (0.4318, 0.15005, 0.0, 0.0), (0.0203, 0.4318, -HALF, 0.0),
    (0.0, 0.0, HALF, 0.0), (0.0, 0.0, -HALF, 0.0),
]  # fmt: skip
TABLES = {
    "motoman": ("standard", MOTOMAN, ""),
    "puma": ("standard", PUMA, ""),
    "ur10": ("standard", UR10, ""),
    "stanford": ("standard", STANFORD, "3"),
    "craig": ("modified", PUMA_MODIFIED, ""),
}


def textbook(convention: str, rows: list, sliding: str, q: np.ndarray) -> np.ndarray:
    """The product of the matrices that textbooks print, written out element by element."""
    product = np.eye(4)
    for k, ((a, d, alpha, theta), value) in enumerate(zip(rows, q, strict=True), start=1):
        slides = str(k) in sliding
        d, theta = (d + value, theta) if slides else (d, theta + value)
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        if convention == "standard":
            matrix = [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]
        else:
            matrix = [[ct, -st, 0, a], [st * ca, ct * ca, -sa, -sa * d], [st * sa, ct * sa, ca, ca * d], [0, 0, 0, 1]]
        product = product @ np.array(matrix)
    return product


def write_dh_table(path: Path, convention: str, rows: list, sliding: str) -> Path:
    lines = [f"# convention: {convention}", "type,theta [deg],d [mm],a [mm],alpha [deg],lower,upper"]
    for k, (a, d, alpha, theta) in enumerate(rows, start=1):
        kind, limits = ("P", "100 mm,1 m") if str(k) in sliding else ("R", "-170 deg,170 deg")
        numbers = [float(np.rad2deg(theta)), d * 1000, a * 1000, float(np.rad2deg(alpha))]
        lines.append(",".join([kind, *map(repr, numbers), limits]))
    path.write_text("\n".join(lines) + "\n")
    return path


def robot_of(table: Path, out: Path) -> calib.Robot:
    result = CliRunner().invoke(init_command, ["--dh", str(table), "--out", str(out)])
    assert result.exit_code == 0, result.output
    return calib.load(out)


def published(name: str, folder: Path) -> calib.Robot:
    return robot_of(write_dh_table(folder / f"{name}.csv", *TABLES[name]), folder / f"{name}.yaml")


def flange_poses(robot: calib.Robot, q: np.ndarray) -> np.ndarray:
    """The flange in the first link, (n, 4, 4), by a Pinocchio model of the calibrated URDF; joints in its order."""
    model = pin.buildModelFromXML(urdf_of_origins(robot).decode().replace("continuous", "revolute"))
    assert list(model.names)[1:] == list(robot.joint_names)
    data, tip = model.createData(), model.getFrameId("flange")
    result = np.empty((len(q), 4, 4))
    for pose, row in zip(result, q, strict=True):
        pin.framesForwardKinematics(model, data, row)
        pose[:] = data.oMf[tip].homogeneous
    return result


def poses(n: int, table: str) -> np.ndarray:
    return np.random.default_rng(3).uniform(-2.9, 2.9, (n, len(TABLES[table][1])))


@pytest.mark.parametrize("name", TABLES)
def test_a_published_table_becomes_a_robot(name: str, tmp_path: Path) -> None:
    robot, q = published(name, tmp_path), poses(1000, name)
    expected = np.array([textbook(*TABLES[name], row) for row in q])
    assert np.abs(robot.forward(q, "flange") - expected).max() < ROUNDING
    assert robot.joint_names == tuple(f"joint_{k}" for k in range(1, len(TABLES[name][1]) + 1))
    sliding = [joint.name for joint in robot.urdf.joints if joint.type == "prismatic"]
    assert sliding == [f"joint_{k}" for k in TABLES[name][2]]


@pytest.mark.quick(2)
@pytest.mark.parametrize("name", TABLES)
@pytest.mark.parametrize("file_format", ["dh", "mdh"])
def test_in_and_out_and_in_again(name: str, file_format: str, tmp_path: Path, run_calib) -> None:
    robot, out = published(name, tmp_path), tmp_path / "out.csv"
    assert "held exactly" in run_calib("export", robot.path, "--format", file_format, "--out", out).out
    again = robot_of(out, tmp_path / "again.yaml")
    assert again.joint_names == robot.joint_names
    q = poses(50, name)
    assert np.abs(again.forward(q, "flange") - robot.forward(q, "flange")).max() < ROUNDING
    limits = robot.urdf.limits(robot.joint_names)
    assert np.allclose(again.urdf.limits(again.joint_names), limits, rtol=0, atol=1e-15)


def test_published_poses(tmp_path: Path) -> None:
    printed = [[0, 0, 1, 0.5963], [0, 1, 0, -0.1501], [-1, 0, 0, -0.0144], [0, 0, 0, 1]]  # Corke's p560 at qn
    puma = published("puma", tmp_path).forward([0, np.pi / 4, np.pi, 0, np.pi / 4, 0], "flange")
    assert np.abs(puma - printed).max() < 1e-4
    ur10 = published("ur10", tmp_path).forward(np.zeros(6), "flange")
    assert ur10[:3, 3] == pytest.approx([-1.1843, -0.256141, 0.0116], abs=ROUNDING)


@pytest.mark.parametrize("name", ["ur10", "motoman"])
def test_a_published_table_comes_back_with_its_numbers(name: str, tmp_path: Path) -> None:
    """No axes of these two are without a common normal of their own but parallel ones, where d is 0 in both."""
    calib.export(published(name, tmp_path), tmp_path / "out.csv", "dh")
    rows = read_dh(tmp_path / "out.csv").rows[1:-1]
    values = np.array([(row.a, row.d, np.sin(row.alpha), np.cos(row.alpha), row.beta) for row in rows])
    expected = np.array([(a, d, np.sin(alpha), np.cos(alpha), 0.0) for a, d, alpha, _ in TABLES[name][1]])
    expected[-1, 1] = 0.0  # along the last axis: in the row of the tool
    assert np.abs(values - expected).max() < 1e-9


@pytest.mark.quick(1)
@pytest.mark.parametrize("file_format", ["dh", "mdh"])
@pytest.mark.parametrize("name", ["ur10", "stanford"])
def test_a_calibrated_robot_is_held_exactly(file_format: str, name: str, tmp_path: Path, run_calib) -> None:
    """Errors of every origin, so that no axes are parallel; the file multiplied up, against Pinocchio."""
    nominal, out = published(name, tmp_path), tmp_path / "out.csv"
    own = np.array([not parameter.name.startswith(("base", "flange.")) for parameter in nominal.parameters])
    robot = nominal.with_parameters(nominal.values + own * np.random.default_rng(8).normal(0, 2e-3, len(own)))
    (tmp_path / "values.csv").write_text(parameter_file(robot))
    values = ("--parameters", tmp_path / "values.csv")
    assert run_calib("export", nominal.path, *values, "--format", file_format, "--out", out).code == 0
    header = next(line for line in out.read_text().splitlines() if not line.startswith("#"))
    assert header == "joint,type,theta [deg],d [mm],a [mm],alpha [deg],beta [deg],sign,lower,upper"
    q = poses(250, name)
    assert np.abs(in_file(robot, file_format, out)(q) - flange_poses(robot, q)).max() < ROUNDING


@pytest.mark.parametrize("tilt", [0.0, 1e-13, 1e-9, 1e-5, 0.049, 0.051])
def test_parallel_axes_keep_the_table_inside_the_robot(tilt: float) -> None:
    """The foot of the common normal would be 1 m / tilt away; and at every tilt the product is the chain."""
    link = pin.SE3(pin.exp3(np.array([0.6, 0.8, 0]) * tilt), np.array([0.3, -0.4, 0.2]))
    flipped = link * pin.SE3(pin.utils.rotate("x", np.pi), np.array([0.1, 0, 0]))
    links = [link, link, flipped, pin.SE3.Identity()]
    table = dh_table(links, [DhRow(name) for name in "abc"], "standard")
    assert max(abs(row.d) for row in table.rows) < 25
    q = np.random.default_rng(1).uniform(-3, 3, (20, 3))
    for result, row in zip(table_poses(table, q), q, strict=True):
        pose = links[0]
        for angle, after in zip(row, links[1:], strict=True):
            pose = pose * pin.SE3(pin.utils.rotate("z", angle), np.zeros(3)) * after
        assert np.abs(result - pose.homogeneous).max() < ROUNDING


def test_signs_and_offsets_of_a_table(tmp_path: Path) -> None:
    (tmp_path / "two.csv").write_text(
        "# convention: standard\njoint;type;theta [deg];d [mm];a [mm];alpha [deg];offset;sign;lower;upper\n"
        "lift;prismatic;0;100,5;0;0;20 mm;-1;0 mm;300 mm\nturn;revolute;;0;500;0;90 deg;-1;;\n"
    )
    robot = robot_of(tmp_path / "two.csv", tmp_path / "two.yaml")
    pose = robot.forward([0.01, 0.3], "flange")  # d = 100.5 + 20 - 10 mm, theta = 90 deg - 0.3 rad
    assert pose[:3, 3] == pytest.approx([0.5 * np.sin(0.3), 0.5 * np.cos(0.3), 0.1105], abs=ROUNDING)


GOOD = "# convention: standard\njoint,type,theta [deg],d [mm],a [mm],alpha [deg],lower,upper\none,revolute,0,1,2,90,,\n"


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("# convention: standard\n", "", "nothing says which convention"),
        ("standard", "craig", "unknown convention 'craig'"),
        ("alpha [deg],", "", "line 3: 8 cells for 7 columns"),
        ("alpha [deg]", "alpa [deg]", "unknown column 'alpa'; did you mean 'alpha'?"),
        ("alpha [deg]", "beta [deg]", "no column 'alpha'"),
        ("d [mm]", "d [deg]", "unit 'deg' is for an angle"),
        ("alpha [deg]", "alpha", "90 rad is not plausible"),
        ("revolute", "revolut", "unknown type 'revolut'; did you mean 'revolute'?"),
        ("revolute", "prismatic", "a prismatic joint needs limits"),
        ("revolute", "fixed", "every row is fixed"),
        (",90,,", ",90,5 deg,-5 deg", "limits need a lower and a larger upper"),
        (",90,,", ",90,5 mm,9 mm", "unit 'mm' is for a length"),
        ("one,revolute,0,1,2,90,,\n", "one,revolute,0,1,2,90,,\n" * 2, "joint 'one' appears twice"),
        ("one,revolute,0,1,2,90,,\n", "", "has a header but no rows"),
    ],
)
def test_bad_tables(old: str, new: str, words: str, tmp_path: Path, run_calib) -> None:
    assert old in GOOD
    (tmp_path / "bad.csv").write_text(GOOD.replace(old, new))
    assert words in run_calib("init", "--dh", "bad.csv", "--out", "bad.yaml", cwd=tmp_path).refusal()
    assert [path.name for path in tmp_path.iterdir()] == ["bad.csv"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--out", "x.yaml"), "give one of these: a URDF, a Denavit-Hartenberg table"),
        (("arm.urdf", "--dh", "good.csv", "--out", "x.yaml"), "give one of these"),
        (("arm.urdf", "--convention", "modified", "--out", "x.yaml"), "is for a table given with --dh"),
        (("--dh", "good.csv", "--convention", "modified", "--out", "x.yaml"), "says 'convention: standard', but"),
        (("--dh", "good.csv", "--out", "taken.yaml"), "taken.urdf: was not written by this program"),
        (("--dh", "nowhere.csv", "--out", "x.yaml"), "nowhere.csv: no such file; give a CSV file"),
        (("--dh", "good.csv", "--target", "hand", "--out", "x.yaml"), "no link 'hand'"),
    ],
)
def test_wrong_use(arguments: tuple[str, ...], words: str, tmp_path: Path, run_calib) -> None:
    before = {"good.csv": GOOD, "taken.urdf": "mine"}
    for name, text in before.items():
        (tmp_path / name).write_text(text)
    assert words in run_calib("init", *arguments, cwd=tmp_path).refusal()
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == before


def test_joints_of_nearly_parallel_axes_stand_inside_the_robot(tmp_path: Path) -> None:
    """As a controller of Universal Robots has its calibrated table: d of joints 2 to 4 cancel each other."""
    rows = list(UR10)
    rows[1:4] = [(-0.612, 278.3, 1.1e-4, 0.002), (-0.5723, -271.1, -9e-5, -0.001), (0.0, -7.04, HALF, 0.0)]
    robot = robot_of(write_dh_table(tmp_path / "ur.csv", "standard", rows, ""), tmp_path / "ur.yaml")
    assert max(np.linalg.norm(joint.xyz) for joint in robot.urdf.joints) < 2.0
    q = np.random.default_rng(3).uniform(-3, 3, (40, 6))
    expected = np.array([textbook("standard", rows, "", row) for row in q])
    assert np.allclose(flange_poses(robot, q), expected, rtol=0, atol=1e-11)  # 278 m have roundings of 6e-14 m
