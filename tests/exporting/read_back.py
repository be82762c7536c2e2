"""Exported files read back by other code than the engine's, and how far off the robots in them are.

URDF by Pinocchio, MJCF by MuJoCo, everything else by the few lines below; loops are closed by a root finder, base and
target placed by a least-squares solver of another make. `tests/exporting/file_accuracy.py` prints what comes out.
"""

import csv
import re
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import yaml
from scipy.optimize import fsolve, least_squares
from scipy.spatial.transform import Rotation

import calib
from calib.core.base.units import quantity
from tests.interop.simulators import MuJoCo

Links = Callable[[dict[str, float], str], np.ndarray]
"""Pose of a link in the root link, (4, 4), at values of all joints."""
Tip = Callable[[np.ndarray], np.ndarray]
"""Poses (n, 4, 4) of the target's link in the base's link at commands (n, n_joints)."""


def urdf_links(source: bytes) -> Links:
    """The links of a URDF, by Pinocchio."""
    text = source.decode().replace('type="continuous"', 'type="revolute"')
    model = pin.buildModelFromXML(text)
    data = model.createData()

    def pose(values: dict[str, float], link: str) -> np.ndarray:
        pin.framesForwardKinematics(model, data, np.array([values[name] for name in list(model.names)[1:]]))
        return data.oMf[model.getFrameId(link)].homogeneous

    return pose


def tip_of(links: Links, robot: calib.Robot, joint: Callable[[str, float], float] = lambda name, value: value) -> Tip:
    """The target's link, loops closed; with what each joint really is when it is told a value."""
    tip = robot.description.targets[robot.target_names[0]].frame
    closures = list(zip(robot.description.closed_loop, robot.description.closed_loop_axes or (), strict=True))

    def at(row: np.ndarray) -> np.ndarray:
        near = robot.assemble(row).passive[0] if closures else np.zeros(0)  # nominal: the assembly mode is kept
        values = {name: joint(name, float(value)) for name, value in zip(robot.joint_names, row, strict=True)}

        def miss(passive: np.ndarray) -> list[float]:
            every, misses = values | dict(zip(robot.passive_names, passive, strict=True)), []
            for (a, b), axes in closures:
                T_a, T_b = links(every, a), links(every, b)
                apart = T_a[:3, :3].T @ (T_b - T_a)[:3, 3]
                misses += [apart["xyz".index(axis)] for axis in axes]
            return misses

        if closures:
            values |= dict(zip(robot.passive_names, fsolve(miss, near, xtol=1e-12), strict=True))
        return np.linalg.inv(links(values, robot.description.base.frame)) @ links(values, tip)

    return lambda q: np.array([at(row) for row in q])


def in_file(robot: calib.Robot, file_format: str, path: Path) -> Tip:
    """The robot that an exported file gives."""
    if file_format == "mjcf":
        return tip_of(MuJoCo(path).at, robot)
    if file_format in ("dh", "mdh"):
        return _product_of_rows(path)
    if file_format == "ur-kinematics":
        return _ur_product(path, robot)
    if file_format == "joint-offsets":
        zeros = joint_zeros(path)
        nominal = urdf_links(robot.urdf.source)
        return tip_of(nominal, robot, lambda name, value: zeros[name][0] * value + zeros[name][1])
    if file_format == "joint-tables":
        rows = table_rows(path / "joint_tables.csv")

        def actual(name: str, value: float) -> float:
            own = [(float(row["commanded"]), float(row["actual"])) for row in rows if row["joint"] == name]
            return float(np.interp(value, *zip(*own, strict=True)))

        return tip_of(urdf_links((path / "joint_tables.urdf").read_bytes()), robot, actual)
    if file_format == "xacro":
        return tip_of(urdf_links(_with_properties(path, robot)), robot)
    source = path.with_suffix(".urdf") if file_format == "toolbox" else path
    return tip_of(urdf_links(source.read_bytes()), robot)


def table_rows(path: Path) -> list[dict[str, str]]:
    """Rows of a table, without comments."""
    return list(csv.DictReader(line for line in path.read_text().splitlines() if not line.startswith("#")))


def _moved(turn: np.ndarray, shift: tuple[float, ...] = (0.0, 0.0, 0.0)) -> np.ndarray:
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = turn, shift
    return result


def _product_of_rows(path: Path) -> Tip:
    """Rot z(theta) Trans z(d) and Trans x(a) Rot x(alpha) Rot y(beta) of each row, in the order of the convention."""
    standard, rows = "convention: standard" in path.read_text(), table_rows(path)

    def number(row: dict[str, str], name: str) -> float:
        head = next((key for key in row if key.split(" ")[0] == name), None)
        return {"[mm]": 1e-3, "[deg]": np.pi / 180}.get((head or "").split(" ")[-1], 1.0) * float(row[head] or 0.0)

    def product(q: np.ndarray) -> np.ndarray:
        told, result = iter(q), np.eye(4)
        for row in rows:
            theta, d, a, alpha = (number(row, name) for name in ("theta", "d", "a", "alpha"))
            beta = number(row, "beta") if any(key.startswith("beta") for key in row) else 0.0
            if row["type"] != "fixed":
                value = float(row.get("sign") or 1.0) * next(told)
                theta, d = (theta, d + value) if row["type"] == "prismatic" else (theta + value, d)
            along = _moved(Rotation.from_euler("z", theta).as_matrix(), (0.0, 0.0, d))
            bent = Rotation.from_euler("x", alpha) * Rotation.from_euler("y", beta)
            across = _moved(bent.as_matrix(), (a, 0.0, 0.0))
            result = result @ (along @ across if standard else across @ along)
        return result

    return lambda q: np.array([product(row) for row in q])


def _ur_product(path: Path, robot: calib.Robot) -> Tip:
    """As ur_description builds its chain from the file, with what it has behind wrist_3."""
    kinematics = yaml.safe_load(path.read_text())["kinematics"]
    origins = [
        _moved(Rotation.from_euler("xyz", [origin[k] for k in ("roll", "pitch", "yaw")]).as_matrix(),
               (origin["x"], origin["y"], origin["z"]))
        for origin in kinematics.values() if isinstance(origin, dict)
    ]  # fmt: skip
    nominal, zero = urdf_links(robot.urdf.source), dict.fromkeys(robot.joint_names, 0.0)
    joints, target = (
        {joint.name: joint for joint in robot.urdf.joints},
        robot.description.targets[robot.target_names[0]],
    )
    first, last = (joints[robot.joint_names[k]] for k in (0, -1))
    frames = (robot.description.base.frame, first.parent, last.child, target.frame)
    base, foot, wrist, tip = (nominal(zero, frame) for frame in frames)

    def product(q: np.ndarray) -> np.ndarray:
        result = np.linalg.inv(base) @ foot
        for origin, value in zip(origins, q, strict=True):
            result = result @ origin @ _moved(Rotation.from_euler("z", value).as_matrix())
        return result @ np.linalg.inv(wrist) @ tip

    return lambda q: np.array([product(row) for row in q])


def joint_zeros(path: Path) -> dict[str, tuple[float, float]]:
    """Sign and zero [rad or m] of each joint in a file of joint zeros."""
    per_unit = {"deg": np.pi / 180, "mm": 1e-3}
    return {
        row["joint"]: (float(row["sign"]), float(row["offset"]) * per_unit[row["unit"]]) for row in table_rows(path)
    }


def _with_properties(path: Path, robot: calib.Robot) -> bytes:
    """The nominal URDF with the origins that a xacro file's properties give."""
    values = {element.get("name"): element.get("value") for element in ElementTree.parse(path).getroot()}
    root = ElementTree.fromstring(robot.urdf.source)
    for joint in root.iter("joint"):
        for old in joint.findall("origin"):
            joint.remove(old)
        name = re.sub(r"\W", "_", joint.get("name"))
        origin = {key: values[f"{name}_{key}"] for key in ("xyz", "rpy")}
        joint.append(ElementTree.Element("origin", origin))
    return ElementTree.tostring(root)


def held_out(tip: Tip, robot: calib.Robot, train: tuple[np.ndarray, np.ndarray], test: tuple[np.ndarray, np.ndarray]):
    """Root mean square distance of predicted from read points of the test [m].

    Base and target are placed by the training where the robot's description calls them unknown.

    Args:
        tip: The target's link.
        robot: Says where the target is expected.
        train, test: Commands (n, n_joints) and points that were read, (n, 3) [m].
    """
    target = robot.description.targets[robot.target_names[0]]
    expected = np.array([quantity(x, "length", "xyz") for x in target.xyz])
    free = np.repeat([robot.description.base.pose == "unknown", target.position == "unknown"], [6, 3])

    def predicted(x: np.ndarray, poses: np.ndarray) -> np.ndarray:
        own = np.append(expected + x[6:], 1.0)
        return Rotation.from_rotvec(x[:3]).apply((poses @ own)[:, :3]) + x[3:6]

    def misses(some: np.ndarray) -> np.ndarray:
        placed[free] = some
        return (predicted(placed, frames) - train[1]).ravel()

    frames, placed = tip(train[0]), np.zeros(9)
    own = (frames @ np.append(expected, 1.0))[:, :3]
    turn = Rotation.align_vectors(train[1] - train[1].mean(0), own - own.mean(0))[0]
    start = np.concatenate([turn.as_rotvec(), train[1].mean(0) - turn.apply(own.mean(0)), np.zeros(3)])
    if np.any(free):
        misses(least_squares(misses, start[free], x_scale="jac").x)
    return float(np.sqrt(np.mean(np.sum((predicted(placed, tip(test[0])) - test[1]) ** 2, axis=1))))
