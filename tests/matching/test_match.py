"""Robots matched to the poses that their controllers print; all controllers are simulated, by their own kinematics."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import calib
from calib.core.base.errors import DataError
from calib.fleets.atlas import with_model
from calib.fleets.ur_kinematics import nominal_origins, ur_urdf
from calib.matching.agreement import hypotheses
from calib.matching.pairs import read_pairs
from calib.matching.readings import candidates
from calib.shared.ur_calibration import JOINTS, KEYS, LINKS


def origins(seed: int = 0) -> np.ndarray:
    """A UR5e as its maker may have calibrated it."""
    rng = np.random.default_rng(seed)
    sizes = np.array([3e-4, 3e-4, 3e-4, 1e-3, 1e-3, 1e-3])
    return nominal_origins("ur5e") + sizes * rng.standard_normal((6, 6))


def frame(turn: Rotation, xyz: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = turn.as_matrix(), xyz
    return T


def chain(q: np.ndarray, origins: list[np.ndarray], turning: list[bool]) -> np.ndarray:
    """The end of joints that turn about z, or slide along it, behind each origin (4, 4), at values q (n, n_joints)."""
    T = np.tile(np.eye(4), (len(q), 1, 1))
    for k, (origin, turns) in enumerate(zip(origins, turning, strict=True)):
        Z = np.tile(np.eye(4), (len(q), 1, 1))
        Z[:, :3, :3] = Rotation.from_euler("z", q[:, [k]] * turns).as_matrix()
        Z[:, 2, 3] = q[:, k] * (not turns)
        T = T @ origin @ Z
    return T


def poses(q: np.ndarray, o: np.ndarray) -> np.ndarray:
    return chain(q, [frame(Rotation.from_euler("xyz", row[3:]), row[:3]) for row in o], [True] * 6)


def joint_values(seed: int, n: int = 30, size: float = np.pi) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-size, size, (n, 6))


def write(path: Path, header: str, *blocks: np.ndarray, digits: tuple[int, ...]) -> Path:
    formats = [f"%.{d}f" for block, d in zip(blocks, digits, strict=True) for _ in block.T]
    np.savetxt(path, np.hstack(blocks), formats, ",", header=header, comments="")
    return path


def ur_pairs(path: Path, q: np.ndarray, T: np.ndarray, digits: tuple[int, ...] = (6, 2, 3)) -> Path:
    vectors = Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
    return write(path, "q0,q1,q2,q3,q4,q5,x,y,z,rx,ry,rz", q, 1e3 * T[:, :3, 3], vectors, digits=digits)


def write_stock(folder: Path, model: str) -> Path:
    path = folder / f"{model}.urdf"
    path.write_bytes(ur_urdf(nominal_origins(model)))
    return path


@pytest.fixture(scope="module")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stock(tmp_path_factory.mktemp("stock"), "ur5e")


def only_reading(stock: Path, file: Path) -> Any:
    """The only reading of the columns of pairs that the poses allow."""
    robot = calib.load(stock)
    (candidate,) = candidates(robot, read_pairs(file, robot.joint_names))
    return candidate


def distance95(match: calib.Match) -> float:
    """Of the robot of a match from the controller, at other poses [m]."""
    q = joint_values(99, 300)
    away = np.linalg.norm(match.fit.robot.positions(q)[:, 0] - poses(q, origins())[:, :3, 3], axis=1)
    return float(np.quantile(away, 0.95))


def test_rounded_pairs_give_a_robot_that_agrees_at_other_poses(stock: Path, tmp_path: Path) -> None:
    o, q = origins(), joint_values(1)
    coarse = calib.match(stock, ur_pairs(tmp_path / "pairs.csv", q, poses(q, o), digits=(3, 2, 3)))
    assert coarse.grade == "PASS", coarse.report()
    assert distance95(coarse) <= coarse.agreement.claim
    matched = calib.match(stock, ur_pairs(tmp_path / "pairs.csv", q, poses(q, o)))
    assert matched.grade == "PASS", matched.report()
    assert distance95(matched) <= matched.agreement.claim < 0.015e-3
    assert "rotation vector" in matched.report()
    matched.save(tmp_path / "out")
    again = calib.load(tmp_path / "out" / "default_kinematics.yaml")
    base = np.linalg.inv(again.forward(q, "base_link_inertia"))
    away = (base @ again.forward(q, "tool0"))[:, :3, 3] - poses(q, o)[:, :3, 3]
    assert np.max(np.abs(away)) < 0.02e-3
    assert {"calibrated.urdf", "dh.csv", "mdh.csv", "origins.xacro"} <= {p.name for p in (tmp_path / "out").iterdir()}


def test_decimal_commas_are_decimals(tmp_path: Path) -> None:
    q = joint_values(3)
    file = ur_pairs(tmp_path / "points.csv", q, poses(q, origins()))
    (tmp_path / "commas.csv").write_text(file.read_text().replace(",", ";").replace(".", ","))
    names = tuple(f"q{k}" for k in range(6))
    assert read_pairs(tmp_path / "commas.csv", names).steps == pytest.approx([*[1e-6] * 6, 1e-2, 1e-3])


def test_joints_that_stand_at_a_round_value_do_not_count_as_rounded_to_it(stock: Path, tmp_path: Path) -> None:
    q = joint_values(1)
    q[:, 1:5] = -1.0, 2.0, 0.5, -1.0
    pairs = read_pairs(ur_pairs(tmp_path / "pairs.csv", q, poses(q, origins())), JOINTS)
    np.testing.assert_allclose(pairs.steps[:6], 1e-6)


EFFECTS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "coupling of wrist_2_joint by wrist_1_joint": lambda q: 2e-4 * np.eye(6)[4] * q[:, [3]],
    "gear of elbow_joint (3 waves a turn)": lambda q: 1e-4 * np.eye(6)[2] * np.sin(3 * q[:, [2]]),
    # the shoulder gives way to upper arm and forearm, 6 and 4 kg at the heights of their ends
    "gravity at shoulder_lift_joint": lambda q: (
        1e-4 * np.eye(6)[1] * (10 * 0.425 * np.cos(q[:, [1]]) + 4 * 0.392 * np.cos(q[:, [1]] + q[:, [2]]))
    ),
}
"""Errors of joints [rad] that a controller computes with, as they are named."""


@pytest.mark.quick(1)
@pytest.mark.parametrize("words", EFFECTS)
def test_what_a_controller_knows_beside_joint_origins_is_named_and_no_pass(
    stock: Path, tmp_path: Path, words: str
) -> None:
    q = joint_values(1)
    matched = calib.match(stock, ur_pairs(tmp_path / "pairs.csv", q, poses(q + EFFECTS[words](q), origins())))
    assert matched.grade != "PASS"
    assert "the controller computes with something that joint origins cannot hold" in matched.conclusion
    assert f"with {words} it agrees to the digits" in matched.conclusion
    assert matched.agreement.left_out > 2 * matched.agreement.rounding_distance


def test_of_pairs_on_a_coarse_grid_only_the_lowest_number_of_waves_is_tried(stock: Path) -> None:
    """Every 60 degrees, 5 waves a turn are at every pose minus 1 wave, 4 are minus 2 waves, and 6 are none."""
    robot = calib.load(stock)
    steps = np.radians(60) * np.random.default_rng(1).integers(-3, 4, (40, 6))
    tried = [[words for words, _ in hypotheses(robot, q) if " wave" in words] for q in (steps, joint_values(1))]
    assert [word for word in tried[0] if "elbow" in word] == [
        f"gear of elbow_joint ({waves} a turn)" for waves in ("1 wave", "2 waves", "3 waves")
    ]
    assert len(tried[1]) == 6 * 6


SCARA = [
    ("revolute", "0 0 0.2", 1),
    ("revolute", "0.325 0 0", 1),
    ("prismatic", "0.275 0 0", -1),
    ("revolute", "0 0 -0.05", -1),
]
"""Kind, origin [m] and direction along z of each joint."""


def scara_poses(q: np.ndarray, o: np.ndarray) -> np.ndarray:
    kinds, places, signs = zip(*SCARA, strict=True)
    xyz = [np.array(place.split(), float) + row[:3] for place, row in zip(places, o, strict=True)]
    turns = Rotation.from_rotvec(o[:, 3:])
    return chain(q * signs, list(map(frame, turns, xyz)), [kind == "revolute" for kind in kinds])


def scara_urdf(folder: Path, turned: str = "0") -> Path:
    """The nominal SCARA, the slide turned about x [rad] with its axis."""
    links = "".join(f"<link name='l{k}'/>" for k in range(5))
    joints = "".join(
        f"<joint name='j{k + 1}' type='{kind}'><parent link='l{k}'/><child link='l{k + 1}'/><origin xyz='{xyz}'"
        f" rpy='{turned if kind == 'prismatic' else 0} 0 0'/><axis xyz='0 0 {sign}'/>"
        f"<limit lower='{-3 if kind == 'revolute' else 0}' upper='{3 if kind == 'revolute' else 0.2}'/></joint>"
        for k, (kind, xyz, sign) in enumerate(SCARA)
    )
    (folder / "scara.urdf").write_text(f"<robot name='scara'>{links}{joints}</robot>")
    return folder / "scara.urdf"


def scara_pairs(path, q, T, header="j1,j2,j3,j4,x,y,z,w,p,r", digits=(6, 4, 6), scales=(1, 1, 1, 1)) -> Path:
    """Pairs in degrees and millimetres, joint values times scales."""
    angles = Rotation.from_matrix(T[:, :3, :3]).as_euler("xyz", degrees=True)
    joints = (np.degrees(q) * [1, 1, 0, 1] + 1e3 * q * [0, 0, 1, 0]) * scales
    return write(path, header, joints, 1e3 * T[:, :3, 3], angles, digits=digits)


def scara_values(seed: int, n: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform([-2.3, -2.3, 0.0, -3.0], [2.3, 2.3, 0.2, 3.0], (n, 4))


BASE = np.array([500.0, -300.0, 800.0, 2.0, -10.0, 115.0])
TOOL = np.array([50.0, 20.0, 100.0, 172.0, -14.0, 8.0])
"""Places in the form of the pairs [mm, deg]."""


def place(numbers: np.ndarray) -> np.ndarray:
    return frame(Rotation.from_euler("xyz", numbers[3:], degrees=True), 1e-3 * numbers[:3])


def option(numbers: np.ndarray, dx: float = 0.0, dz: float = 0.0) -> str:
    return ",".join(f"{x:g}" for x in numbers + np.array([dx, 0, dz, 0, 0, 0]))


@pytest.mark.quick(2)
@pytest.mark.parametrize("lean", [0.0, 1e-6, 1e-3])
@pytest.mark.parametrize("n", [4, 30])
def test_a_scara_is_placed_and_fitted(tmp_path: Path, n: int, lean: float) -> None:
    stock, rng, q = scara_urdf(tmp_path), np.random.default_rng(3), scara_values(3, n)
    o = rng.normal(size=(4, 6)) * [3e-4, 3e-4, 3e-4, lean, lean, 0.0]
    base, tool = place(BASE), place(TOOL)
    for origins, most in ((0 * o, 2e-5), (o, 2e-3 + lean)):  # the nominal robot and noise alone; as its maker knows it
        T = base @ scara_poses(q, origins) @ tool
        noisy = T.copy()
        noisy[:, :3, 3] += 1e-5 * rng.normal(size=(n, 3))
        path = scara_pairs(tmp_path / "p.csv", q, noisy)
        robot = calib.load(stock)
        best = candidates(robot, read_pairs(path, robot.joint_names))[0]
        assert best.aligned.rms_distance < most
        assert np.linalg.norm((best.aligned.base @ np.linalg.inv(base))[:2, :2] - np.eye(2)) < 5e-3 + 5 * lean
    if n == 30:
        matched = calib.match(stock, scara_pairs(tmp_path / "p.csv", q, T))
        assert matched.grade == "PASS", matched.report()
        other = scara_values(4, 300)
        away = matched.fit.robot.positions(other)[:, 0] - (base @ scara_poses(other, o) @ tool)[:, :3, 3]
        assert np.quantile(np.linalg.norm(away, axis=1), 0.95) <= matched.agreement.claim < 1e-5


UNSEEN = r"no pose shows the change tool\.z \+1 mm, base\.x .* mm: both stay.*; --base or --tool states one"


@pytest.mark.parametrize("longer", [0.0, 8e-4])
def test_a_shift_that_no_pose_shows_is_said_until_it_is_stated(tmp_path: Path, run_calib, longer: float) -> None:
    stock, q = scara_urdf(tmp_path), scara_values(3, 30)
    o = np.zeros((4, 6))
    o[1, 0], o[2, 0] = longer, -longer / 2
    pairs = scara_pairs(tmp_path / "p.csv", q, place(BASE) @ scara_poses(q, o) @ place(TOOL))
    base, tool = f"--base={option(BASE)}", f"--tool={option(TOOL)}"
    for stated, is_unseen in (((), True), ((base,), False), ((tool,), False), ((base, tool), False)):
        run = run_calib("match", stock, pairs, *stated, "--out", tmp_path / "out", "--force")
        said = " ".join(run.out.split())
        assert (run.code, "PASS: agrees" in said) == (0, True), run.out + run.err
        assert bool(re.search(UNSEEN, said)) == is_unseen, said
    made = calib.load(tmp_path / "out" / "calibrated.urdf")  # of the last run: with base and tool as stated
    other = scara_values(4, 50)
    away = made.forward(other, "l4") - scara_poses(other, o)
    assert np.max(np.abs(away[:, :3, 3])) < 5e-6  # origins stay near nominal where places and they look alike


@pytest.mark.parametrize(
    ("stated", "said"),
    [
        ((f"--base={option(BASE, dx=60)}",), "contradict the stated base:"),
        ((f"--tool={option(TOOL, dx=60)}",), "contradict the stated tool:"),
        ((f"--base={option(BASE)}", f"--tool={option(TOOL, dz=60)}"), "contradict the stated base and tool:"),
        ((f"--base={option(BASE, dz=60)}",), ""),  # no pose shows it
    ],
)
def test_a_stated_place_is_contradicted_only_by_what_poses_show(tmp_path: Path, run_calib, stated, said: str) -> None:
    base = BASE * [1, 1, 1, 0, 0, 1]  # upright, so that z is the direction that no pose shows
    stated = tuple(text.replace(",2,-10,115", ",0,0,115") for text in stated)
    stock, q = scara_urdf(tmp_path), scara_values(3, 30)
    T = place(base) @ scara_poses(q, np.zeros((4, 6))) @ place(TOOL)
    run = run_calib("match", stock, scara_pairs(tmp_path / "p.csv", q, T), *stated)
    assert run.code == (2 if said else 0), run.out + run.err
    assert said in run.err


def test_of_pairs_that_leave_more_open_than_all_poses_would_no_robot_is_made(tmp_path: Path, run_calib) -> None:
    stock, q = scara_urdf(tmp_path), scara_values(3, 30)
    q[:, :2] = 1.1234
    T = place(BASE) @ scara_poses(q, np.zeros((4, 6))) @ place(TOOL)
    run = run_calib("match", stock, scara_pairs(tmp_path / "p.csv", q, T), "--out", tmp_path / "out")
    assert run.code == 3, run.out
    assert "do not determine base and tool; add pairs in which all joints turn far, or state --base" in run.err
    assert not (tmp_path / "out").exists()


def test_axes_that_are_parallel_but_for_digits_of_the_file_show_no_shift(tmp_path: Path, run_calib) -> None:
    """rpy="3.14159 0 0" leans by 2.7e-6 rad; base and tool would be at 90 m."""
    stock, q = scara_urdf(tmp_path, turned="3.14159"), scara_values(3, 30)
    o = np.zeros((4, 6))
    o[1, 0], o[2, 3] = 8e-4, np.pi
    pairs = scara_pairs(tmp_path / "p.csv", q, place(BASE) @ scara_poses(q, o) @ place(TOOL))
    run = run_calib("match", stock, pairs, "--json", "-")
    result = json.loads(run.out)
    assert (run.code, result["grade"]) == (0, "PASS"), result
    assert any(re.search(UNSEEN, remark) for remark in result["remarks"])
    numbers = [float(x) for text in result["places"] for x in re.findall(r"xyz (\S+) (\S+) (\S+) mm", text)[0]]
    assert np.max(np.abs(numbers)) < 1500


@pytest.mark.parametrize("seed", range(5))
def test_of_rotations_about_one_axis_every_form_is_tried(tmp_path: Path, seed: int) -> None:
    """The tool stays level: the controller prints 0, 0 and one angle, which may turn about any axis in any form."""
    stock, q = scara_urdf(tmp_path, turned="3.14159"), scara_values(seed, 30)
    o = np.random.default_rng(seed).normal(size=(4, 6)) * [3e-4, 3e-4, 3e-4, 0, 0, 0]
    o[2, 3] = np.pi
    T = scara_poses(q, o) @ place(np.array([0.0, 0.0, 150.0, 180.0, 0.0, 0.0]))
    path = scara_pairs(tmp_path / "p.csv", q, T, "j1,j2,j3,j4,x,y,z,rx,ry,rz", digits=(5, 3, 5))
    assert only_reading(stock, path).aligned.rms_distance < 2e-3


@pytest.mark.parametrize(
    ("header", "scales"),
    [
        ("j1 [deg],j2 [deg],j3 [mm],j4 [deg]", [1.0, 1.0, 1.0, 1.0]),
        ("j1 [rad],j2 [deg],j3 [m],j4 [deg]", [np.pi / 180, 1.0, 1e-3, 1.0]),
    ],
)
def test_each_joint_column_has_a_unit_of_its_own(tmp_path: Path, run_calib, header: str, scales: list[float]) -> None:
    stock, q = scara_urdf(tmp_path), scara_values(3, 30)
    T, columns = scara_poses(q, np.zeros((4, 6))), f"{header},x [mm],y [mm],z [mm],w,p,r"
    path = scara_pairs(tmp_path / "p.csv", q, T, columns, (8, 4, 6), scales)
    run = run_calib("match", stock, path)
    assert (run.code, "PASS: agrees" in run.out) == (0, True), run.out + run.err
    assert "not in" not in run.out
    reading = only_reading(stock, path).reading
    assert reading.joint_units == tuple(re.findall(r"\[(\w+)\]", header))
    assert np.allclose(reading.joints(read_pairs(path, ("j1", "j2", "j3", "j4")).joints), q, atol=1e-7)


def test_pair_of_another_program_is_named_and_left_out(stock: Path, tmp_path: Path) -> None:
    q = joint_values(1)
    T = poses(q, origins())
    T[11, :3, 3] += [0.0, 0.0, 0.05]
    matched = calib.match(stock, ur_pairs(tmp_path / "pairs.csv", q, T))
    assert [name for name, _ in matched.left_out] == ["line 13"]
    assert matched.grade == "CHECK"
    assert distance95(matched) <= matched.agreement.claim


@pytest.mark.quick(0)
def test_a_tool_is_found(stock: Path, tmp_path: Path) -> None:
    o, q = origins(), joint_values(1)
    tool = frame(Rotation.identity(), np.array([0.03, 0.0, 0.12]))
    pairs = ur_pairs(tmp_path / "pairs.csv", q, poses(q, o) @ tool)
    found = calib.match(stock, pairs)
    assert found.grade == "PASS", found.report()
    assert "tool: the controller's frame differs from tool0 by xyz" in found.places[1]
    assert calib.match(stock, pairs, tool=[30, 0, 120, 0, 0, 0]).grade == "PASS"


def as_makers_write(folder: Path, q: np.ndarray, T: np.ndarray) -> Iterator[tuple[Path, str]]:
    """Files of the same pairs, each with the form of its rotations."""
    turns = Rotation.from_matrix(T[:, :3, :3])
    head, pairs = "J1,J2,J3,J4,J5,J6,X,Y,Z,", (np.degrees(q), 1e3 * T[:, :3, 3])
    for words, form in {"A,B,C": "ZYX", "W,P,R": "xyz", "Rx,Ry,Rz": "XYZ", "O,A,T": "ZYZ"}.items():
        angles = turns.as_euler(form, degrees=True)
        yield write(folder / "p.csv", head + words, *pairs, angles, digits=(3, 2, 3)), form
    quaternions = turns.as_quat(scalar_first=True)
    yield write(folder / "p.csv", f"{head}q1,q2,q3,q4", *pairs, quaternions, digits=(3, 2, 6)), "qw qx qy qz"
    vectors = np.hstack([T[:, :3, 3], turns.as_rotvec()])
    (folder / "log.txt").write_text("\n".join(f"{a.tolist()} p{b.tolist()}" for a, b in zip(q, vectors, strict=True)))
    yield folder / "log.txt", "rotation vector"
    by_column = T.swapaxes(1, 2).reshape(-1, 16)
    for stem, rows, form in (("actual_TCP_pose", vectors, "rotation vector"), ("O_T_EE", by_column, "matrix")):
        names = ["timestamp", *(f"actual_q_{k}" for k in range(6)), *(f"{stem}_{k}" for k in range(rows.shape[1]))]
        yield write(folder / "p.csv", ",".join(names), np.arange(30)[:, None], q, rows, digits=(2, 6, 6)), form


def test_columns_of_all_makers_are_read(stock: Path, tmp_path: Path) -> None:
    q = joint_values(1)
    T = poses(q, origins())
    for file, form in as_makers_write(tmp_path, q, T):
        reading, pairs = only_reading(stock, file).reading, read_pairs(file, JOINTS)
        assert (reading.convention.form, reading.mistakes(pairs)) == (form, [])
        joints, printed = reading.values(pairs)
        assert np.allclose(joints, q, atol=2e-5)
        assert np.allclose(printed, T, atol=3e-5)  # angles of a thousandth of a degree


def test_a_log_of_thousands_is_used_evenly(stock: Path, tmp_path: Path) -> None:
    q = np.repeat(joint_values(1, 40), 50, axis=0)
    read = read_pairs(ur_pairs(tmp_path / "log.csv", q, poses(q, origins())), JOINTS).evenly(500)
    assert len(read) == 500
    assert (read.rows[0], read.rows[-1]) == ("line 2", "line 2001")
    assert np.allclose(read.joints[[0, -1]], q[[0, -1]], atol=1e-6)


def test_a_row_of_a_log_is_where_the_stock_robot_is_and_a_log_at_rest_says_too_little(tmp_path: Path) -> None:
    """A row that URSim wrote, of a UR3e, as published with a recorder of its RTDE."""
    q = [1.3084329994998356, -1.5311321190997251, 1.39087118907581, -1.637036610180001, -1.5187584099703901, 0.197163]
    pose = [0.04737631470299991, -0.34733247603100004, 0.3524927572500001, 0.69333359, 3.00077912, -0.32157151]
    header = ",".join([f"actual_q_{k}" for k in range(6)] + [f"actual_TCP_pose_{k}" for k in range(6)])
    log = write(tmp_path / "log.csv", header, np.tile(q, (9, 1)), np.tile(pose, (9, 1)), digits=(6, 8))
    robot, read = calib.load(write_stock(tmp_path, "ur3e")), read_pairs(log, JOINTS)
    T = np.linalg.inv(robot.forward(read.joints, "base_link_inertia")) @ robot.forward(read.joints, "tool0")
    assert np.allclose(T[:, :3, 3], read.positions, atol=1e-6)
    assert np.allclose(Rotation.from_matrix(T[:, :3, :3]).as_rotvec(), read.rotations, atol=1e-5)
    with pytest.raises(DataError, match=r"the tool moves by 0\.0 mm only"):
        calib.match(robot, log)


def numbers(T: np.ndarray, form: str = "") -> np.ndarray:
    """Positions in mm, and rotations as vectors or angles in degrees."""
    turns = Rotation.from_matrix(T[:, :3, :3])
    return np.hstack([1e3 * T[:, :3, 3], turns.as_euler(form, degrees=True) if form else turns.as_rotvec()])


IN_DEGREES = ",".join(f"J{k} [deg]" for k in range(1, 7))
VECTORS = "j1,j2,j3,j4,j5,j6,x,y,z,rx,ry,rz"
THOROUGH = pytest.mark.amount(0, 1)
Q = np.random.default_rng(1).uniform(-np.pi, np.pi, (30, 6))  # as `joint_values(1)`


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("header", "q", "numbers", "said"),
    [
        ("q0,q1,q2,q3,q4,q5,x,y,z,rx,ry,rz", Q, lambda T: numbers(np.linalg.inv(T)), "(inverse poses)"),
        (f"{IN_DEGREES},X,Y,Z,rx,ry,rz", Q, numbers, "joint values are in rad, not in deg"),
        ("J1,J2,J3,J4,J5,J6,X,Y,Z,A,B,C", Q, lambda T: numbers(T, "xyz"), "a b c are not ZYX, but xyz"),
        ("J1,J2,J3,J4,J5,J6,X,Y,Z,W,P,R", Q, lambda T: numbers(T, "ZYX"), "w p r are not xyz, but ZYX"),
        (VECTORS, Q - Q[:, [1]] * np.eye(6)[2], numbers, "elbow_joint from the horizontal"),
        pytest.param(VECTORS, Q * [1, 1, -1, 1, 1, 1], numbers, "elbow_joint has the wrong sign", marks=THOROUGH),
        (VECTORS, Q, lambda T: np.roll(numbers(T), 1, axis=0), "1 row above their poses"),
        pytest.param(
            VECTORS, Q, lambda T: numbers(T) * [1, -1, 1, 1, 1, 1], "x, y, z of positions hold", marks=THOROUGH
        ),
    ],
)
def test_a_file_that_is_not_as_it_seems_is_named(stock: Path, tmp_path: Path, header: str, q, numbers, said) -> None:
    pairs = read_pairs(write(tmp_path / "pairs.csv", header, q, numbers(poses(Q, origins())), digits=(5, 3)), JOINTS)
    assert said in " ".join(candidates(calib.load(stock), pairs)[0].reading.mistakes(pairs))


@pytest.mark.parametrize(
    ("header", "row", "said"),
    [
        (f"{IN_DEGREES},x,y,z,rx,ry,rz", "0,,0,0,0,0,1,2,3,0,0,0", "line 2, column 'J2': is empty"),
        (
            "j1,j2,j3,j4,j5,j6,x,y,z,qw,qx,qy,qz",
            "0,0,0,0,0,0,1,2,3,0,0,0,0",
            "line 2: the rotation is not a quaternion",
        ),
        (
            "j1;j2;j3;j4;j5;j6;x;y;z;rx;ry;rz",
            "0;0;0;0;0;0;1,234;2;3;0.5;0;0",
            "line 2, column 'x': '1,234', but another column has '0.5'",
        ),
    ],
)
def test_cells_that_say_nothing_are_named(tmp_path: Path, header: str, row: str, said: str) -> None:
    (tmp_path / "pairs.csv").write_text(f"{header}\n{row}\n{row}\n")
    with pytest.raises(DataError, match=said):
        read_pairs(tmp_path / "pairs.csv", JOINTS)


def test_readings_that_fit_alike_are_refused(stock: Path, tmp_path: Path) -> None:
    level = np.array([0.0, -np.pi / 2, np.pi / 2, -np.pi / 2, -np.pi / 2, 0.0])
    q = level + joint_values(1, size=0.1)
    turned = np.linalg.inv(poses(level[None], nominal_origins("ur5e")))[0]
    turned[:3, 3] = 0.0  # the tool is level where the pairs are: all forms of a small rotation are nearly the same
    with pytest.raises(DataError, match="fit equally well"):
        calib.match(stock, ur_pairs(tmp_path / "pairs.csv", q, poses(q, origins()) @ turned, digits=(6, 1, 2)))


@pytest.mark.amount(0, 1)
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


def described(path: Path, stock: Path, more: str) -> Path:
    path.write_text(
        f"urdf: {stock}\nname_mot: [{', '.join(JOINTS)}]\nbase: {{frame: base_link_inertia}}\nsigma: 0.03 mm\n"
        "targets: {ball: {frame: tool0, xyz: [0, 0, 50 mm]}}\nparametrisation:\n"
        "- {origin: all, components: [x, y, z], sigma: 2 mm}\n"
        f"- {{origin: all, components: [rx, ry, rz], sigma: 5 mrad}}\n{more}"
    )
    return path


@pytest.mark.quick(0)
def test_calibrations_are_a_fleet_and_its_file_a_model(stock: Path, tmp_path: Path) -> None:
    files = [write_calibration(tmp_path / f"robot_{k}.yaml", origins(k)) for k in range(3)]
    learned = calib.fleet(*files)
    assert [member.name for member in learned.members] == ["robot_0", "robot_1", "robot_2"]
    learned.save(tmp_path / "model.yaml")
    robot = calib.load(described(tmp_path / "arm.yaml", stock, "model: model.yaml\n"))
    sigma = {p.name: p.sigma_si for p in robot.parameters}
    assert sigma["elbow_joint.x"] < 1e-3 < sigma["flange-tool0.x"]


@pytest.mark.quick(1)
@pytest.mark.parametrize("model", ["ur5", "ur5e", "ur3e", "ur10e"])
def test_models_that_ship_are_those_of_their_stock_robots(tmp_path: Path, model: str) -> None:
    known = with_model(calib.load(write_stock(tmp_path, model)), model)
    assert known.description.fleet is not None
    assert known.description.fleet.robots >= 3
    with pytest.raises(calib.DescriptionError, match=f"is not the stock robot '{model}'"):
        with_model(calib.load(write_stock(tmp_path, "ur10")), model)


def test_a_prior_says_before_measuring_that_fewer_poses_reach_a_goal(stock: Path, tmp_path: Path, run_calib) -> None:
    table = write(tmp_path / "candidates.csv", ",".join(JOINTS), joint_values(1, 40, 2.5), digits=(4,))
    counts = []
    for name, line in (("without", ""), ("with", "model: ur5e\n")):
        robot, out = described(tmp_path / f"{name}.yaml", stock, line), tmp_path / f"{name}.csv"
        run = run_calib("select", robot, table, "--goal-mm", 1, "--out", out)
        assert run.code == 0, run.err
        counts.append(sum(not row.startswith("#") for row in out.read_text().splitlines()) - 1)
    assert 2 * counts[1] <= counts[0]
