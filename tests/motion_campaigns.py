"""An independent look at routes: joints placed by a few lines of numpy, triangles checked by FCL through trimesh.

It shares no code with the engine: the URDF is read by ElementTree, meshes by trimesh, contacts are FCL's.
"""

from __future__ import annotations

import itertools
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import trimesh

import calib
from calib.core.base.errors import CalibrationError
from calib.motion.poses import surroundings
from calib.motion.route import plan_route

ROBOTS = (
    "ur_description/urdf/ur3_joint_limited_robot.urdf",
    "ur_description/urdf/ur5_joint_limited_robot.urdf",
    "ur_description/urdf/ur10_joint_limited_robot.urdf",
    "ur_description/urdf/ur5_robot.urdf",
    "panda_description/urdf/panda.urdf",
    "panda_description/urdf/panda_collision.urdf",
    "kinova_description/robots/kinova.urdf",
    "z1_description/urdf/z1.urdf",
    "xarm_description/urdf/xarm7.urdf",
    "so_arm_description/urdf/so100.urdf",
    "so_arm_description/urdf/so101.urdf",
    "talos_data/robots/talos_left_arm.urdf",
    "tiago_description/robots/tiago_no_hand.urdf",
    "baxter_description/urdf/baxter.urdf",
    "pr2_description/urdf/pr2.urdf",
    "a1_description/urdf/a1.urdf",
    "go1_description/urdf/go1.urdf",
    "laikago_description/urdf/laikago.urdf",
    "solo_description/robots/solo12.urdf",
    "anymal_b_simple_description/robots/anymal-kinova.urdf",
    "b1_description/urdf/b1-z1.urdf",
    "double_pendulum_description/urdf/double_pendulum_simple.urdf",
)


def folder() -> Path:
    """Return where the robots of example-robot-data are."""
    import importlib.metadata

    files = importlib.metadata.files("example-robot-data") or []
    inside = next(file for file in files if str(file).endswith("ur_description/urdf/ur5_robot.urdf"))
    return Path(str(inside.locate())).resolve().parents[2]


def _transform(xyz, rpy):
    T = trimesh.transformations.euler_matrix(*rpy, axes="sxyz")
    T[:3, 3] = xyz
    return T


def _origin(element):
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    numbers = [list(map(float, origin.get(key, "0 0 0").split())) for key in ("xyz", "rpy")]
    return _transform(*numbers)


def _mesh(geometry, urdf):
    (shape,) = geometry
    if shape.tag == "box":
        return trimesh.creation.box(list(map(float, shape.get("size").split())))
    if shape.tag == "sphere":
        return trimesh.creation.icosphere(subdivisions=3, radius=float(shape.get("radius")))
    if shape.tag == "cylinder":
        return trimesh.creation.cylinder(float(shape.get("radius")), float(shape.get("length")), sections=48)
    name = shape.get("filename").removeprefix("file://")
    places = [urdf.parent / name]
    if name.startswith("package://"):
        inside = name.removeprefix("package://")
        places = [root / inside for root in urdf.parents]
    mesh = trimesh.load(next(place for place in places if place.is_file()), force="mesh")
    mesh.apply_scale(list(map(float, shape.get("scale", "1 1 1").split())))
    return mesh


class Checker:
    """Contacts of a robot's collision shapes and of boxes on its root link."""

    def __init__(self, urdf, home, boxes=()):
        root = ET.parse(urdf).getroot()
        self.joints = [
            (
                joint.get("name"),
                joint.find("parent").get("link"),
                joint.find("child").get("link"),
                _origin(joint),
                joint.get("type"),
                np.array(list(map(float, joint.find("axis").get("xyz").split())))
                if joint.find("axis") is not None
                else np.array([1.0, 0.0, 0.0]),
                joint.find("mimic"),
            )
            for joint in root.iterfind("joint")
        ]
        children = {joint[2] for joint in self.joints}
        self.root = next(link.get("name") for link in root.iterfind("link") if link.get("name") not in children)
        self.home, self.manager, self.owner, self.places = home, trimesh.collision.CollisionManager(), {}, {}
        for link in root.iterfind("link"):
            for k, shape in enumerate(link.iterfind("collision")):
                key = f"{link.get('name')}#{k}"
                self.owner[key], self.places[key] = link.get("name"), _origin(shape)
                self.manager.add_object(key, _mesh(shape.find("geometry"), urdf))
        for name, (size, xyz) in dict(boxes).items():
            self.owner[name], self.places[name] = name, _transform(xyz, (0, 0, 0))
            self.manager.add_object(name, trimesh.creation.box(size))
        self.boxes = set(dict(boxes))

    def placed(self, values):
        """Return T_root_link of each link, joints being {name: value}."""
        T = {self.root: np.eye(4)}
        left = list(self.joints)
        while left:
            for joint in list(left):
                name, parent, child, origin, kind, axis, mimic = joint
                if parent not in T:
                    continue
                if mimic is not None:
                    lead = values.get(mimic.get("joint"), self.home.get(mimic.get("joint"), 0.0))
                    value = float(mimic.get("multiplier", 1)) * lead + float(mimic.get("offset", 0))
                else:
                    value = values.get(name, self.home.get(name, 0.0))
                motion = np.eye(4)
                if kind in ("revolute", "continuous"):
                    motion = trimesh.transformations.rotation_matrix(value, axis)
                elif kind == "prismatic":
                    motion[:3, 3] = value * axis / np.linalg.norm(axis)
                T[child] = T[parent] @ origin @ motion
                left.remove(joint)
        return T

    def contacts(self, values):
        """Return the pairs of owners that touch."""
        T = self.placed(values)
        for key, place in self.places.items():
            self.manager.set_transform(key, place if key in self.boxes else T[self.owner[key]] @ place)
        _, pairs = self.manager.in_collision_internal(return_names=True)
        return {frozenset((self.owner[a], self.owner[b])) for a, b in pairs}


def scene_names(scene):
    """Return the pairs of names that a scene looks at."""
    return {frozenset((scene.bodies[a].name, scene.bodies[b].name)) for a, b in scene.pairs}


def boxes_around(robot, rng, count=2):
    """Return boxes that home does not touch, where the robot reaches, on its root link."""
    tip = robot.mechanism.targets[0].b
    scene = surroundings(robot).scene
    joints, ok = scene.configurations(robot.sample(60, rng))
    import pinocchio as pin

    data, points = robot.mechanism.model.createData(), []
    for q in joints[ok]:
        pin.forwardKinematics(robot.mechanism.model, data, q)
        points.append(np.array(data.oMi[tip].translation))
    points = np.array(points)
    size = max(float(np.ptp(points, axis=0).max()), 0.05)
    chosen = points[rng.integers(len(points), size=count)]
    return {f"box{k}": (rng.uniform(0.05, 0.2, 3) * size, point) for k, point in enumerate(chosen)}


def campaign(urdf, seed, n_poses=8, step=0.005):
    """Plan a route among random boxes and walk along it; return what was seen.

    Returns:
        Contacts found on the way, how many steps were looked at, stops, ways around, names left out.
    """
    plain = calib.robot(urdf, obstacles="unchecked")
    rng = np.random.default_rng(seed)
    for _ in range(20):
        boxes = boxes_around(plain, rng)
        obstacles = {name: {"box": list(size), "xyz": list(xyz)} for name, (size, xyz) in boxes.items()}
        robot = calib.robot(urdf, obstacles=obstacles)
        try:
            scene = surroundings(robot).scene
            if scene.hits(robot.home[None])[0]:
                continue
            poses = calib.sample(robot, n_poses, seed)
        except CalibrationError:  # a box around the base, or around everything
            continue
        break
    else:
        return None
    route = plan_route(robot, poses, seed=seed)
    home = dict(zip(robot.mechanism.origin_names, robot.mechanism.constant, strict=True))
    checker, looked_at = Checker(urdf, home, boxes), scene_names(scene)
    reach = scene.reach(np.max(np.abs(scene.configurations(route.corners())[0]), axis=0))
    found, steps = set(), 0
    corners = route.corners()
    for one, other in itertools.pairwise(corners):
        moved = np.abs(np.diff(scene.configurations(np.array([one, other]))[0], axis=0))[0]
        n = max(1, int(np.ceil(np.max(reach @ moved, initial=0.0) / step)))
        for part in np.linspace(0, 1, n + 1):
            values = dict(zip(robot.joint_names, one + part * (other - one), strict=True))
            found |= checker.contacts(values) & looked_at
            steps += 1
    around = sum(len(stop.corners) > 0 for stop in route.stops)
    return found, steps, len(route.stops), around, len(route.left_out)


def shares(urdf, seed, n=200):
    """Return the share of random poses that touch something by the engine, and by the checker, no clearance kept."""
    rng, plain = np.random.default_rng(seed), calib.robot(urdf, obstacles="unchecked")
    for _ in range(20):
        boxes = boxes_around(plain, rng)
        obstacles = {n: {"box": list(size), "xyz": list(xyz), "clearance": 0} for n, (size, xyz) in boxes.items()}
        robot = calib.robot(urdf, obstacles=obstacles, self_clearance=0)
        try:
            scene = surroundings(robot).scene
        except CalibrationError:  # a box around the base
            continue
        break
    q = robot.sample(n, seed)
    home = dict(zip(robot.mechanism.origin_names, robot.mechanism.constant, strict=True))
    checker, looked_at = Checker(urdf, home, boxes), scene_names(scene)
    theirs = [bool(checker.contacts(dict(zip(robot.joint_names, row, strict=True))) & looked_at) for row in q]
    ours = [bool(hit) for hit in scene.hits(q)]
    return np.array(ours), np.array(theirs)


if __name__ == "__main__":
    import argparse
    import time

    parser = argparse.ArgumentParser(description="Walk routes of robots step by step, with shapes looked at by FCL.")
    parser.add_argument("campaigns", type=int, help="how many for each robot")
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help="URDFs of example-robot-data; those of the list")
    given = parser.parse_args()
    for name in given.robots or ROBOTS:
        started = time.perf_counter()
        try:
            ours, theirs = shares(folder() / name, 1)
            print(
                f"{name}: left out {ours.mean():.3f}, by FCL {theirs.mean():.3f}, differ {np.sum(ours != theirs)}",
                flush=True,
            )
            for seed in range(given.campaigns):
                print("  ", seed, campaign(folder() / name, seed), f"{time.perf_counter() - started:.0f} s", flush=True)
        except Exception as error:
            print(f"{name}: {type(error).__name__}: {error}", flush=True)
