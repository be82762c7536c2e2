"""Every fixed-base arm of example-robot-data: load, perturb, simulate, fit, export, reload, in the tools as well."""

import importlib.metadata
import importlib.util
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from click.testing import CliRunner

import calib
from calib.core.data.measurements import Poses
from calib.core.robots.urdf.arm_chain import arm_chain
from calib.core.robots.urdf.text import read_urdf
from calib.exporting.formats import export
from calib.starting.command import command as init
from tests.interop.simulators import Drake, MuJoCo

ARMS = {  # file below robots/: link that carries the measured point
    "asr_twodof_description/urdf/TwoDofs.urdf": "Tip",
    "baxter_description/urdf/baxter.urdf": "left_gripper",
    "double_pendulum_description/urdf/double_pendulum_continuous.urdf": "link2",
    "finger_edu_description/robots/finger_edu.urdf": "finger_tip_link",
    "kinova_description/robots/kinova.urdf": "j2s6s200_end_effector",
    "panda_description/urdf/panda.urdf": "panda_hand_tcp",
    "panda_description/urdf/panda_collision.urdf": "panda_hand_tcp",
    "so_arm_description/urdf/so100.urdf": "jaw",
    "so_arm_description/urdf/so101.urdf": "gripper_frame_link",
    "talos_data/robots/talos_left_arm.urdf": "gripper_left_motor_double_link",
    "ur_description/urdf/ur3_gripper.urdf": "tool0",
    "ur_description/urdf/ur3_joint_limited_robot.urdf": "tool0",
    "ur_description/urdf/ur3_robot.urdf": "ee_link",
    "ur_description/urdf/ur5_gripper.urdf": "tool0",
    "ur_description/urdf/ur5_joint_limited_robot.urdf": "tool0",
    "ur_description/urdf/ur5_robot.urdf": "ee_link",
    "ur_description/urdf/ur10_joint_limited_robot.urdf": "tool0",
    "ur_description/urdf/ur10_robot.urdf": "ee_link",
    "xarm_description/urdf/xarm7.urdf": "link_eef",
    "z1_description/urdf/z1.urdf": "gripperMover",
}
FIRST = ("double_pendulum_continuous", "finger_edu", "panda", "talos_left_arm")
"""Arms of `make test`: two to seven axes, turning without limits, with and without a gripper."""
PARALLEL_AXES = {  # what slides the target along both axes cannot be told from where the base is
    "asr_twodof_description/urdf/TwoDofs.urdf": "Tip.z",
    "double_pendulum_description/urdf/double_pendulum_continuous.urdf": "link2.x",
}
OTHERS = {  # legged, wheeled, flying, hands, humanoids
    "a1", "alex", "alexander", "allegro_hand", "anymal_b_simple", "anymal_c_simple", "b1", "bolt", "borinot",
    "centauro", "g1", "go1", "go2", "hector", "hextilt", "human", "hyq", "icub", "iris", "laikago", "pr2",
    "quadruped", "romeo", "simple_humanoid", "solo", "talos_data", "tiago", "tiago_pro",
}  # fmt: skip
WITHOUT_LIMITS = {  # 0 to 0, which nobody has stated
    "double_pendulum_description/urdf/double_pendulum.urdf",
    "double_pendulum_description/urdf/double_pendulum_simple.urdf",
}
EMPTY = {"ur_description/urdf/ur3.urdf"}  # no robot inside: an unexpanded xacro file
SIGMA = 2e-5  # [m], what a good laser tracker has


def robots_folder() -> Path:
    try:
        distribution = importlib.metadata.distribution("example-robot-data")
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed (in a checkout: pip install -e '.[interop]')")
    prefix = next(file for file in distribution.files or () if file.name == "package.xml" and "share" in file.parts)
    return Path(str(distribution.locate_file(prefix))).parent / "robots"


def described(urdf: Path, target: str, folder: Path, held: str | None = None) -> calib.Robot:
    """The robot as `calib init` describes it, with one parameter held if need be."""
    out = folder / "robot_description.yaml"
    result = CliRunner().invoke(init, [str(urdf), "--target", target, "--out", str(out)])
    assert result.exit_code == 0, result.output
    if held is not None:
        out.write_text(f"{out.read_text()}\nheld: [{held}]\n")
    return calib.load(out)


def random_poses(robot: calib.Robot, count: int, generator: np.random.Generator, label: str) -> Poses:
    """Joint values within the limits, and within +-2 rad or m of zero where these are wide."""
    limits = {
        joint.name: (max(joint.lower, -2.0), min(joint.upper, 2.0)) if joint.lower < joint.upper else (-2.0, 2.0)
        for joint in robot.urdf.joints
    }
    lower, upper = np.array([limits[name] for name in robot.joint_names]).T
    names = tuple(f"{label} {k}" for k in range(count))
    return Poses(generator.uniform(lower, upper, (count, len(lower))), names, names, label, ())


def moved(robot: calib.Robot, generator: np.random.Generator) -> calib.Robot:
    """Each free parameter off by half of its expected deviation, at random."""
    sigma = np.array([parameter.sigma_si for parameter in robot.parameters]) * robot.is_free
    return robot.with_parameters(robot.values + 0.5 * sigma * generator.standard_normal(len(sigma)))


def check(urdf: Path, target: str, folder: Path, held: str | None = None) -> None:
    generator = np.random.default_rng(20150107)
    nominal = described(urdf, target, folder, held)
    truth = moved(nominal, generator)
    data = calib.simulate(truth, random_poses(nominal, 80, generator, "measured"), SIGMA, generator)
    held_out = calib.simulate(truth, random_poses(nominal, 40, generator, "held out"), 0.0, generator)
    fit = calib.fit(nominal, data, validation=held_out, sigma=SIGMA)

    seen = held_out.points(nominal)
    errors = np.linalg.norm(fit.robot.positions(held_out.joints) - seen, axis=2)
    before = np.linalg.norm(fit.placed.positions(held_out.joints) - seen, axis=2)
    assert errors.mean() < 2 * SIGMA  # more parameters than the data hold well: not below the noise itself
    assert errors.mean() < 0.1 * before.mean()

    again = export_and_read_back(fit.robot, folder, held_out.joints[:5])
    export(again, folder / "again.yaml", "toolbox")
    assert (folder / "again.urdf").read_bytes() == (folder / "robot.urdf").read_bytes()


def in_pinocchio(robot: calib.Robot, model: pin.Model, q: np.ndarray, *links: str) -> Iterator[list[pin.SE3]]:
    """Where links are at each pose, in the model's root."""
    data = model.createData()
    for row in q:
        values = pin.neutral(model)
        for name, value in zip(robot.joint_names, row, strict=True):
            joint = model.joints[model.getJointId(name)]
            values[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        pin.framesForwardKinematics(model, data, values)
        yield [data.oMf[model.getFrameId(link, pin.FrameType.BODY)] for link in links]


def export_and_read_back(robot: calib.Robot, folder: Path, q: np.ndarray) -> calib.Robot:
    """Export, and hold what four programs read against the robot; return what calib reads."""
    for name, file_format in (("robot.yaml", "toolbox"), ("robot.xml", "mjcf"), ("robot.drake.urdf", "drake")):
        export(robot, folder / name, file_format)
    again, expected = calib.load(folder / "robot.yaml"), robot.positions(q)[:, 0]
    assert np.abs(again.positions(q)[:, 0] - expected).max() < 1e-12
    target = robot.description.targets[robot.target_names[0]].frame
    urdf = pin.buildModelFromXML((folder / "robot.urdf").read_bytes())
    for row, (placed,) in zip(q, in_pinocchio(robot, urdf, q, target), strict=True):
        pose = np.linalg.solve(robot.forward(row, robot.urdf.root), robot.forward(row, target))
        assert np.abs(placed.homogeneous - pose).max() < 1e-9
    links = ("measurement_frame", f"target_{robot.target_names[0]}")
    mjcf = pin.buildModelFromMJCF(str(folder / "robot.xml"))
    for point, poses in zip(expected, in_pinocchio(robot, mjcf, q, *links), strict=True):
        assert np.abs(poses[0].actInv(poses[1].translation) - point).max() < 1e-9
    tools = [(MuJoCo, "robot.xml")] if importlib.util.find_spec("mujoco") else []
    if importlib.util.find_spec("pydrake") and not any(j.mimic and j.type == "fixed" for j in robot.urdf.joints):
        tools.append((Drake, "robot.drake.urdf"))  # it refuses fixed joints that mimic others (talos_left_arm)
    for tool, name in tools:
        simulator = tool(folder / name, robot.urdf.root)
        for point, row in zip(expected, q, strict=True):
            simulator.put(dict(zip(robot.joint_names, row, strict=True)))
            frame, placed = (simulator.pose(link) for link in links)
            assert np.abs((np.linalg.inv(frame) @ placed)[:3, 3] - point).max() < 1e-9
    return again


@pytest.mark.parametrize(
    ("name", "target", "joints", "fingers"),
    [
        ("panda_description/urdf/panda.urdf", "panda_hand_tcp", 7, 2),
        ("baxter_description/urdf/baxter.urdf", "right_gripper", 7, 2),
        ("talos_data/robots/talos_full_v2.urdf", "gripper_left_base_link", 9, 7),
        ("talos_data/robots/talos_left_arm.urdf", "gripper_left_base_link", 6, 1),
        ("tiago_description/robots/tiago.urdf", "hand_grasping_frame", 8, 36),
        ("tiago_pro_description/robots/tiago_pro.urdf", "gripper_left_base_link", 8, 6),
        ("pr2_description/urdf/pr2.urdf", "r_gripper_tool_frame", 8, 6),
        ("romeo_description/urdf/romeo.urdf", "l_gripper", 8, 12),
        ("g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf", "left_hand_palm_link", 10, 7),
        ("ur_description/urdf/ur5_robot.urdf", "tool0", 6, 0),
        ("z1_description/urdf/z1.urdf", "gripperStator", 6, 1),
        ("so_arm_description/urdf/so101.urdf", "gripper_frame_link", 5, 1),
    ],
)
def test_the_arm_is_found_without_its_fingers(name: str, target: str, joints: int, fingers: int) -> None:
    chain = arm_chain(read_urdf(robots_folder() / name))
    assert (chain.target, len(chain.joints), len(chain.fingers)) == (target, joints, fingers)


@pytest.mark.quick(0)
@pytest.mark.parametrize(
    "arm",
    [pytest.param(arm, marks=pytest.mark.amount(Path(arm).stem in FIRST, 1)) for arm in ARMS],
    ids=lambda arm: Path(arm).stem,
)
def test_arm_is_calibrated_exported_and_loaded_again(arm: str, tmp_path: Path) -> None:
    check(robots_folder() / arm, ARMS[arm], tmp_path, PARALLEL_AXES.get(arm))


def check_read_back(file: Path, folder: Path) -> None:
    """The first arm or leg of a robot, exported; what four programs read is where it is."""
    robot = calib.load(file)
    export_and_read_back(robot, folder, random_poses(robot, 3, np.random.default_rng(4), "any").joints)


def others() -> list[Path]:
    """Legged, wheeled and flying robots and hands, those with the fewest meshes first."""
    folder = robots_folder()
    files = [
        path for path in folder.rglob("*.urdf") if str(path.relative_to(folder)) not in {*ARMS, *WITHOUT_LIMITS, *EMPTY}
    ]
    return sorted(files, key=lambda path: (path.read_text(errors="replace").count("<mesh"), str(path)))


@pytest.mark.amount(1, 50)
def test_exports_of_other_robots_are_read_back(tmp_path: Path, amount: int) -> None:
    read = 0
    for k, file in enumerate(others()):
        try:
            calib.load(file)
        except calib.CalibrationError:  # a file with a fault of its own, or a robot without an arm
            continue
        (tmp_path / str(k)).mkdir()
        check_read_back(file, tmp_path / str(k))
        read += 1
        if read == amount:
            break
    assert read >= min(amount, 30)


@pytest.mark.amount(0, 100)
def test_exports_of_robosuites_mjcf_robots_are_read_back(tmp_path: Path, amount: int) -> None:
    pytest.importorskip("mujoco")
    try:
        files = importlib.metadata.distribution("robosuite").files or []
    except importlib.metadata.PackageNotFoundError:
        pytest.skip("robosuite is not installed (its files alone: pip install --no-deps robosuite)")
    robots = sorted(Path(str(f.locate())) for f in files if f.match("models/assets/robots/*/robot.xml"))
    for robot in [file for file in robots if file.parent.name != "null"][-amount:]:
        (tmp_path / robot.parent.name).mkdir()
        check_read_back(robot, tmp_path / robot.parent.name)


@pytest.mark.parametrize("name", sorted(WITHOUT_LIMITS), ids=lambda name: Path(name).stem)
def test_arms_whose_limits_nobody_states_are_named(name: str) -> None:
    with pytest.raises(calib.DescriptionError, match=r"joint1, joint2 have a <limit> without lower and upper"):
        calib.load(robots_folder() / name)


def test_no_fixed_base_arm_is_left_out() -> None:
    folder = robots_folder()
    files = {str(path.relative_to(folder)) for path in folder.rglob("*.urdf")}
    assert set(ARMS) <= files
    families = {Path(name).parts[0].removesuffix("_description") for name in files - set(ARMS) - WITHOUT_LIMITS - EMPTY}
    assert families <= OTHERS
