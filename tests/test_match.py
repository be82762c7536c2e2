"""Robots matched to the poses that their controllers print; all controllers are simulated, by their own kinematics."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import calib
from calib.core.base.errors import DataError
from calib.core.robots.urdf.ur_kinematics import JOINTS, KEYS, LINKS, nominal_origins, ur_urdf
from calib.matching.pairs import read_pairs
from calib.matching.readings import candidates

STEP = 1e-3, 1e-5  # of a pendant: 0.001 rad, 0.01 mm


def origins(seed: int = 0) -> np.ndarray:
    """A UR5e as its maker may have calibrated it."""
    rng = np.random.default_rng(seed)
    sizes = np.array([3e-4, 3e-4, 3e-4, 1e-3, 1e-3, 1e-3])
    return nominal_origins("ur5e") + sizes * rng.standard_normal((6, 6))


def poses(q: np.ndarray, o: np.ndarray) -> np.ndarray:
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for k in range(6):
        A, Z = np.eye(4), np.tile(np.eye(4), (len(q), 1, 1))
        A[:3, :3], A[:3, 3] = Rotation.from_euler("xyz", o[k, 3:]).as_matrix(), o[k, :3]
        Z[:, :3, :3] = Rotation.from_euler("z", q[:, [k]]).as_matrix()
        T = T @ A @ Z
    return T


def joint_values(seed: int, n: int = 30, size: float = np.pi) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-size, size, (n, 6))


def write(path: Path, header: str, *blocks: np.ndarray, digits: tuple[int, ...]) -> Path:
    columns = [(column, d) for block, d in zip(blocks, digits, strict=True) for column in block.T]
    rows = zip(*([f"{x:.{d}f}" for x in column] for column, d in columns), strict=True)
    path.write_text(header + "\n" + "\n".join(",".join(row) for row in rows) + "\n")
    return path


def ur_pairs(path: Path, q: np.ndarray, T: np.ndarray, digits: tuple[int, ...] = (6, 2, 3)) -> Path:
    vectors = Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
    return write(path, "q0,q1,q2,q3,q4,q5,x,y,z,rx,ry,rz", q, 1e3 * T[:, :3, 3], vectors, digits=digits)


@pytest.fixture(scope="module")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("stock") / "ur5e.urdf"
    path.write_bytes(ur_urdf(nominal_origins("ur5e")))
    return path


def distance95(match: calib.Match, controller: Callable[[np.ndarray], np.ndarray]) -> float:
    q = joint_values(99, 300)
    away = np.linalg.norm(match.fit.robot.positions(q)[:, 0] - controller(q)[:, :3, 3], axis=1)
    return float(np.quantile(away, 0.95))


def test_rounded_pairs_give_a_robot_that_agrees_at_other_poses(stock: Path, tmp_path: Path) -> None:
    o, q = origins(), joint_values(1)
    matched = calib.match(stock, ur_pairs(tmp_path / "pairs.csv", q, poses(q, o)))
    assert matched.grade == "PASS", matched.report()
    assert distance95(matched, lambda q: poses(q, o)) <= matched.agreed.claim < 0.015e-3
    assert "rotation vector" in matched.report()
    matched.save(tmp_path / "out")
    again = calib.load(tmp_path / "out" / "default_kinematics.yaml")
    base = np.linalg.inv(again.forward(q, "base_link_inertia"))
    away = (base @ again.forward(q, "tool0"))[:, :3, 3] - poses(q, o)[:, :3, 3]
    assert np.max(np.abs(away)) < 0.02e-3
    assert {"calibrated.urdf", "dh.csv", "mdh.csv", "origins.xacro"} <= {p.name for p in (tmp_path / "out").iterdir()}


def test_rounded_joint_values_count_as_rounding(stock: Path, tmp_path: Path) -> None:
    o, q = origins(), joint_values(1)
    matched = calib.match(stock, ur_pairs(tmp_path / "pairs.csv", q, poses(q, o), digits=(3, 2, 3)))
    assert matched.grade == "PASS", matched.report()
    assert distance95(matched, lambda q: poses(q, o)) <= matched.agreed.claim


@pytest.mark.parametrize(("joint", "by", "size"), [(4, 3, 2e-4), (2, 1, 1e-3)])
def test_couplings_of_a_controller_are_no_pass(stock: Path, tmp_path: Path, joint: int, by: int, size: float) -> None:
    def controller(q: np.ndarray) -> np.ndarray:
        coupled = q.copy()
        coupled[:, joint] += size * q[:, by]
        return poses(coupled, origins())

    q = joint_values(1)
    matched = calib.match(stock, ur_pairs(tmp_path / "pairs.csv", q, controller(q)), terms=False)
    assert matched.grade != "PASS"
    assert "the controller knows something that joint origins cannot hold" in matched.conclusion


def test_pair_of_another_program_is_named_and_left_out(stock: Path, tmp_path: Path) -> None:
    o, q = origins(), joint_values(1)
    T = poses(q, o)
    T[11, :3, 3] += [0.0, 0.0, 0.05]
    matched = calib.match(stock, ur_pairs(tmp_path / "pairs.csv", q, T))
    assert [name for name, _ in matched.left_out] == ["line 13"]
    assert matched.grade == "CHECK"
    assert distance95(matched, lambda q: poses(q, o)) <= matched.agreed.claim


def test_tool_is_found_and_a_wrong_statement_is_named(stock: Path, tmp_path: Path) -> None:
    o, q = origins(), joint_values(1)
    tool = np.eye(4)
    tool[:3, 3] = [0.03, 0.0, 0.12]
    pairs = ur_pairs(tmp_path / "pairs.csv", q, poses(q, o) @ tool)
    found = calib.match(stock, pairs)
    assert found.grade == "PASS", found.report()
    assert "tool: the controller's differs from tool0: xyz" in found.places[1]
    assert calib.match(stock, pairs, tool=[30, 0, 120, 0, 0, 0]).grade == "PASS"
    with pytest.raises(DataError, match="of another tool than the one stated"):
        calib.match(stock, pairs, tool=[0, 0, 80, 0, 0, 0])


EULER = {"A,B,C": "ZYX", "W,P,R": "xyz", "Rx,Ry,Rz": "XYZ", "O,A,T": "ZYZ"}


@pytest.mark.parametrize("words", EULER)
def test_makers_angles_are_found(stock: Path, tmp_path: Path, words: str) -> None:
    q, robot = joint_values(1), calib.load(stock)
    T = poses(q, origins())
    angles = Rotation.from_matrix(T[:, :3, :3]).as_euler(EULER[words], degrees=True)
    header = f"J1,J2,J3,J4,J5,J6,X,Y,Z,{words}"
    file = write(tmp_path / "p.csv", header, np.degrees(q), 1e3 * T[:, :3, 3], angles, digits=(3, 2, 3))
    (found,) = candidates(robot, read_pairs(file, JOINTS))
    reading = found.reading
    assert (reading.form, reading.joint_unit, reading.length_unit, reading.angle_unit, reading.direction) == (
        EULER[words], "deg", "mm", "deg", "direct",
    )  # fmt: skip


def test_quaternions_of_abb_and_lines_without_a_header_are_read(stock: Path, tmp_path: Path) -> None:
    q, robot = joint_values(1), calib.load(stock)
    T = poses(q, origins())
    turns = Rotation.from_matrix(T[:, :3, :3])
    header = "J1,J2,J3,J4,J5,J6,X,Y,Z,q1,q2,q3,q4"
    scalar_first = turns.as_quat()[:, [3, 0, 1, 2]]
    file = write(tmp_path / "p.csv", header, np.degrees(q), 1e3 * T[:, :3, 3], scalar_first, digits=(3, 2, 6))
    (found,) = candidates(robot, read_pairs(file, JOINTS))
    assert found.reading.form == "qw qx qy qz"
    lines = [f"{a.tolist()} p{b.tolist()}" for a, b in zip(q, np.hstack([T[:, :3, 3], turns.as_rotvec()]), strict=True)]
    (tmp_path / "log.txt").write_text("\n".join(lines))
    (found,) = candidates(robot, read_pairs(tmp_path / "log.txt", JOINTS))
    assert (found.reading.form, found.reading.joint_unit, found.reading.length_unit) == ("rotation vector", "rad", "m")


def mistakes(stock: Path, file: Path) -> str:
    robot = calib.load(stock)
    pairs = read_pairs(file, JOINTS)
    return " ".join(candidates(robot, pairs)[0].reading.mistakes(robot, pairs))


def test_inverse_poses_wrong_units_and_coupled_joints_are_named(stock: Path, tmp_path: Path) -> None:
    q = joint_values(1)
    T = poses(q, origins())
    assert "inverse poses" in mistakes(stock, ur_pairs(tmp_path / "inverse.csv", q, np.linalg.inv(T)))
    header = ",".join(f"J{k} [deg]" for k in range(1, 7)) + ",X,Y,Z,rx,ry,rz"
    vectors = Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
    file = write(tmp_path / "units.csv", header, q, 1e3 * T[:, :3, 3], vectors, digits=(5, 2, 4))
    assert "joint values are in rad, not in deg" in mistakes(stock, file)
    fanuc = q.copy()
    fanuc[:, 2] -= q[:, 1]
    assert "counts elbow_joint from the horizontal" in mistakes(stock, ur_pairs(tmp_path / "j23.csv", fanuc, T))
    other = q * np.array([1, 1, -1, 1, 1, 1])
    assert "elbow_joint counted the other way" in mistakes(stock, ur_pairs(tmp_path / "sign.csv", other, T))


def test_readings_that_fit_alike_are_refused(stock: Path, tmp_path: Path) -> None:
    level = np.array([0.0, -np.pi / 2, np.pi / 2, -np.pi / 2, -np.pi / 2, 0.0])
    q = level + joint_values(1, size=0.1)
    turned = np.linalg.inv(poses(level[None], nominal_origins("ur5e")))[0]
    turned[:3, 3] = 0.0  # the tool is level where the pairs are: all forms of a small rotation are nearly the same
    with pytest.raises(DataError, match="fit alike"):
        calib.match(stock, ur_pairs(tmp_path / "pairs.csv", q, poses(q, origins()) @ turned, digits=(6, 1, 2)))


def test_pairs_of_another_robot_are_refused(tmp_path: Path, stock: Path) -> None:
    q = joint_values(1)
    T = poses(q, origins())
    T[:, :3, 3] = np.random.default_rng(0).uniform(-0.5, 0.5, (30, 3))
    with pytest.raises(DataError, match="no reading of the columns"):
        calib.match(stock, ur_pairs(tmp_path / "pairs.csv", q, T))


def write_calibration(path: Path, o: np.ndarray) -> Path:
    content = {link: dict(zip(KEYS, map(float, row), strict=True)) for link, row in zip(LINKS, o, strict=True)}
    path.write_text(yaml.safe_dump({"kinematics": {**content, "hash": "calib_1"}}))
    return path


def test_calibration_of_universal_robots_is_read_as_a_robot(tmp_path: Path) -> None:
    o, q = origins(), joint_values(2, 10)
    robot = calib.load(write_calibration(tmp_path / "my_calibration.yaml", o))
    base = np.linalg.inv(robot.forward(q, "base_link_inertia"))
    assert np.allclose(base @ robot.forward(q, "tool0"), poses(q, o), atol=1e-12)
    calib.export(robot, tmp_path / "again.yaml", "ur-kinematics")
    again = calib.load(tmp_path / "again.yaml")
    assert np.allclose(again.forward(q, "tool0"), robot.forward(q, "tool0"), atol=1e-12)


def test_lost_sign_and_missing_number_of_a_calibration_are_named(tmp_path: Path) -> None:
    o = origins()
    o[3, 0] *= -1
    with pytest.raises(calib.UrdfError, match=r"other sign of kinematics\.wrist_1\.x it would be a ur5e"):
        calib.load(write_calibration(tmp_path / "lost.yaml", o))
    (tmp_path / "short.yaml").write_text("kinematics: {shoulder: {x: 0}}")
    with pytest.raises(calib.UrdfError, match=r"kinematics\.shoulder\.y should be a number"):
        calib.load(tmp_path / "short.yaml")


def test_calibrations_are_a_fleet_and_its_file_a_model(stock: Path, tmp_path: Path) -> None:
    files = [write_calibration(tmp_path / f"robot_{k}.yaml", origins(k)) for k in range(3)]
    learned = calib.fleet(*files)
    assert [member.name for member in learned.members] == ["robot_0", "robot_1", "robot_2"]
    learned.save(tmp_path / "model.yaml")
    description = (
        f"urdf: {stock}\nmodel: model.yaml\n"
        + """
name_mot: [shoulder_pan_joint, shoulder_lift_joint, elbow_joint, wrist_1_joint, wrist_2_joint, wrist_3_joint]
base: {frame: base_link_inertia}
targets: {tool0: {frame: tool0}}
parametrisation:
- {origin: all, components: [x, y, z], sigma: 2 mm}
- {origin: all, components: [rx, ry, rz], sigma: 5 mrad}
"""
    )
    (tmp_path / "arm.yaml").write_text(description)
    robot = calib.load(tmp_path / "arm.yaml")
    sigma = {p.name: p.sigma_si for p in robot.parameters}
    assert sigma["elbow_joint.x"] < 1e-3 < sigma["flange-tool0.x"]


@pytest.mark.parametrize("model", ["ur5", "ur5e", "ur3e", "ur10e"])
def test_models_that_ship_are_those_of_their_stock_robots(tmp_path: Path, model: str) -> None:
    from calib.core.robots.loading import with_model

    path = tmp_path / "stock.urdf"
    path.write_bytes(ur_urdf(nominal_origins(model)))
    known = with_model(calib.load(path), model)
    assert known.description.fleet is not None
    assert known.description.fleet.robots >= 3
    path.write_bytes(ur_urdf(nominal_origins("ur10")))
    with pytest.raises(calib.DescriptionError, match=f"is no stock '{model}'"):
        with_model(calib.load(path), model)
