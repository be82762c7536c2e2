"""An independent look at routes: joints placed by a few lines of numpy, triangles looked at by FCL.

It shares no code with the engine: the URDF is read by yourdfpy, meshes by trimesh, distances are FCL's. A way is
walked in steps of a tenth of the motion bound: no pair can come nearer, from one step to the next, than by a twentieth
of its clearance (the engine leaves half of it for what is between the points that it looks at). Steps that lie within
FCL's distance of a step before are free without a look. `python -m tests.motion.motion_campaigns --help` runs
campaigns.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import itertools
import json
import tempfile
import time
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

import fcl
import numpy as np
import trimesh
import yaml
import yourdfpy

import calib
from calib.core.base.errors import CalibrationError
from calib.motion.poses import surroundings
from calib.motion.route import plan_route
from tests.project import ROOT

ROBOTS = (
    "ur_description/urdf/ur3_joint_limited_robot.urdf",
    "ur_description/urdf/ur5_joint_limited_robot.urdf",
    "ur_description/urdf/ur10_joint_limited_robot.urdf",
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
    "a1_description/urdf/a1.urdf",
    "laikago_description/urdf/laikago.urdf",
    "solo_description/robots/solo12.urdf",
    "anymal_b_simple_description/robots/anymal-kinova.urdf",
    "urdf/medrue.yaml",
    "docs/examples/delta.yaml",
    "docs/examples/stewart.yaml",
)
LEG = {"cylinder": [0.1, 0.7], "xyz": [0.237, 0.34, -0.04], "rpy": [0, np.pi / 2, 0]}  # see medrue.workspace
OWN_KEYS = {"tiago_no_hand": {"self_clearance": 0.002}}  # at 3.3 mm of its wrist, less than the usual 5 mm, it turns
FINER = 10
POSES_IN_A_SCENE = 5  # campaigns of a robot among the same boxes, each with other poses
LEAST = 1e-3  # clearance of which the steps are a part, at least [m]
ARC = 1.02  # by which a point's way between two steps is longer than the straight line, at most


def source(name):
    """Return the file of a robot: beside this repository, or of example-robot-data."""
    here = ROOT / name
    if here.is_file():
        return here
    files = importlib.metadata.files("example-robot-data") or []
    inside = next(file for file in files if str(file).endswith("ur_description/urdf/ur5_robot.urdf"))
    return Path(str(inside.locate())).resolve().parents[2] / name


def load(path, **keys):
    """Return the robot of a URDF or of a description, with further keys; joints that cannot be 0 have a home."""
    if path.suffix != ".yaml":
        return calib.robot(path, **{"home": _middles(path)} | OWN_KEYS.get(path.stem, {}) | keys)
    content = yaml.safe_load(path.read_text())
    content["urdf"] = str(path.resolve().parent / content["urdf"])
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, path.name)
        file.write_text(yaml.safe_dump(content | keys))
        return calib.load(file)


@cache
def _parsed(urdf):
    return yourdfpy.URDF.load(str(urdf), load_meshes=False, build_scene_graph=False)


def _middles(urdf):
    """Middles of the limits without 0."""
    ends = {joint.name: (joint.limit.lower or 0, joint.limit.upper or 0) for joint in _joints(urdf) if joint.limit}
    return {name: (low + high) / 2 for name, (low, high) in ends.items() if low > 0 or high < 0}


def _joints(urdf):
    return _parsed(urdf).robot.joints


def _origin(element):
    return np.eye(4) if element.origin is None else element.origin


def _mesh(geometry, urdf):
    if geometry.box is not None:
        return trimesh.creation.box(geometry.box.size)
    if geometry.sphere is not None:
        return trimesh.creation.icosphere(subdivisions=3, radius=geometry.sphere.radius)
    if geometry.cylinder is not None:
        return trimesh.creation.cylinder(geometry.cylinder.radius, geometry.cylinder.length, sections=48)
    name = geometry.mesh.filename.removeprefix("file://")
    places = [urdf.parent / name]
    if name.startswith("package://"):
        places = [root / name.removeprefix("package://") for root in urdf.parents]
    mesh = trimesh.load(next(place for place in places if place.is_file()), force="mesh")
    mesh.apply_scale(1.0 if geometry.mesh.scale is None else geometry.mesh.scale)
    return mesh


@dataclass(frozen=True, eq=False)
class Solid:
    """A mesh on a link or on the root link: its owner's name, place, and what FCL makes of it."""

    owner: str
    place: np.ndarray
    mesh: trimesh.Trimesh
    shape: fcl.BVHModel
    middle: np.ndarray
    radius: float
    is_obstacle: bool = False


def _solid(owner, place, mesh, is_obstacle=False):
    shape, (low, high) = fcl.BVHModel(), mesh.bounds
    shape.beginModel(len(mesh.vertices), len(mesh.faces))
    shape.addSubModel(mesh.vertices, mesh.faces)
    shape.endModel()
    middle = (low + high) / 2
    radius = float(np.max(np.linalg.norm(mesh.vertices - middle, axis=1)))
    return Solid(owner, place, mesh, shape, middle, radius, is_obstacle)


@cache
def solids(urdf):
    """Return the shapes of a URDF: for collisions; else hulls of those for the eye."""
    links = _parsed(urdf).robot.links
    for role in ("collisions", "visuals"):
        found = [(link.name, shape, _mesh(shape.geometry, urdf)) for link in links for shape in getattr(link, role)]
        if found:
            hulls = role == "visuals"
            return [_solid(owner, _origin(at), mesh.convex_hull if hulls else mesh) for owner, at, mesh in found]
    return []


def capsules(urdf, robot):
    """Return what stands for links without shapes: capsules to what they carry, rods where motors slide, balls."""
    radius, home, origin = 0.04 * robot.mechanism.length, robot.description.home or {}, np.zeros(3)
    ends = {link.name: [] for link in _parsed(urdf).robot.links}
    for target in robot.description.targets.values():
        ends[target.frame].append((origin, np.array(target.xyz)))
    for joint in _joints(urdf):
        T = _origin(joint)
        ends[joint.parent].append((origin, T[:3, 3]))
        if joint.type == "prismatic" and joint.name in robot.joint_names:
            rod = float(home.get(joint.name, 0.0)) * _axis(joint)
            ends[joint.parent].append((T[:3, 3], T[:3, 3] + T[:3, :3] @ rod))
            ends[joint.child].append((-rod, origin))
    balls = [_capsule(link, np.zeros((2, 3)), radius) for link, stretches in ends.items() if not stretches]
    long = [(link, pair) for link, stretches in ends.items() for pair in stretches if np.ptp(pair, axis=0).any()]
    return balls + [_capsule(link, pair, radius) for link, pair in long if np.linalg.norm(pair[1] - pair[0]) > radius]


def _capsule(link, ends, radius):
    along = ends[1] - ends[0]
    if not np.any(along):
        return _solid(link, np.eye(4), trimesh.creation.icosphere(subdivisions=3, radius=radius))
    mesh = trimesh.creation.capsule(height=np.linalg.norm(along), radius=radius, count=[24, 24])
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    place = trimesh.geometry.align_vectors([0, 0, 1], along)
    place[:3, 3] = (ends[0] + ends[1]) / 2
    return _solid(link, place, mesh)


def _axis(joint):
    return joint.axis / np.linalg.norm(joint.axis)


class Checker:
    """Contacts of a robot's shapes and of obstacles on its root link.

    Args:
        urdf: File.
        home: Values of joints that nobody gives.
        obstacles: As in a description: boxes and cylinders.
        looked_at: Pairs of owners that count.
        shapes: Of the robot.
    """

    def __init__(self, urdf, home, obstacles, looked_at, shapes):
        joints = _joints(urdf)
        self.root = next(iter({joint.parent for joint in joints} - {joint.child for joint in joints}))
        self.joints, placed = [], {self.root}  # parents first
        while joints:
            self.joints += [joint for joint in joints if joint.parent in placed]
            joints = [joint for joint in joints if joint.parent not in placed]
            placed |= {joint.child for joint in self.joints}
        self.home, self.solids = home, list(shapes)
        for name, section in obstacles.items():
            box = section.get("box")
            mesh = trimesh.creation.box(box) if box else trimesh.creation.cylinder(*section["cylinder"], sections=96)
            place = trimesh.transformations.euler_matrix(*section.get("rpy", (0, 0, 0)), axes="sxyz")
            place[:3, 3] = section["xyz"]
            self.solids.append(_solid(name, place, mesh, True))
        pairs = itertools.combinations(self.solids, 2)
        self.pairs = [(a, b) for a, b in pairs if frozenset((a.owner, b.owner)) in looked_at]
        self.looks = 0

    def frames(self, values):
        """Return T_root_link of each link, (n, 4, 4), joints being {name: values (n,)}."""
        n = len(next(iter(values.values())))
        T = {self.root: np.broadcast_to(np.eye(4), (n, 4, 4))}
        for joint in self.joints:
            T[joint.child] = T[joint.parent] @ _origin(joint) @ self._motion(joint, values, n)
        return T

    def _motion(self, joint, values, n):
        motion = np.tile(np.eye(4), (n, 1, 1))
        if joint.type == "fixed":
            return motion
        lead = joint.name if joint.mimic is None else joint.mimic.joint
        value = values.get(lead, np.full(n, self.home.get(lead, 0.0)))
        if joint.mimic is not None:
            multiplier, offset = joint.mimic.multiplier, joint.mimic.offset
            value = (1.0 if multiplier is None else multiplier) * value + (offset or 0.0)
        if joint.type in ("revolute", "continuous"):
            K = np.cross(np.eye(3), _axis(joint))
            sine, cosine = np.sin(value)[:, None, None], np.cos(value)[:, None, None]
            motion[:, :3, :3] += sine * K + (1 - cosine) * (K @ K)
        elif joint.type == "prismatic":
            motion[:, :3, 3] = value[:, None] * _axis(joint)
        return motion

    def _relative(self, values):
        """Yield pairs whose spheres meet anywhere, and T_b_a, (n, 4, 4)."""
        T = self.frames(values)
        n = len(next(iter(T.values())))
        placed = [solid.place[None] if solid.is_obstacle else T[solid.owner] @ solid.place for solid in self.solids]
        place = {id(solid): np.broadcast_to(at, (n, 4, 4)) for solid, at in zip(self.solids, placed, strict=True)}
        middles = {
            id(solid): place[id(solid)][:, :3, :3] @ solid.middle + place[id(solid)][:, :3, 3] for solid in self.solids
        }
        for a, b in self.pairs:
            if np.any(np.linalg.norm(middles[id(a)] - middles[id(b)], axis=1) <= a.radius + b.radius):
                yield a, b, _inverse(place[id(b)]) @ place[id(a)]

    def _distance(self, a, b, T):
        self.looks += 1
        placed = fcl.CollisionObject(a.shape, fcl.Transform(T[:3, :3], T[:3, 3])), fcl.CollisionObject(b.shape)
        return fcl.distance(*placed, fcl.DistanceRequest(), fcl.DistanceResult())

    def walk(self, values):
        """Return the pairs that touch at steps {name: values (n,)} or, where they come near, at ten between two."""
        found = set()
        for a, b, T in self._relative(values):
            corners = np.array(list(itertools.product(*a.mesh.bounds.T)))
            points = T[:, :3, :3] @ corners.T + T[:, :3, 3:]
            moved = ARC * np.sqrt(np.max(np.sum(np.diff(points, axis=0) ** 2, axis=1), axis=1))
            gone, k = np.concatenate([[0.0], np.cumsum(moved)]), 0
            while k < len(gone):
                apart = self._distance(a, b, T[k])
                if apart <= 0:
                    found.add(frozenset((a.owner, b.owner)))
                    break
                ahead = int(np.searchsorted(gone, gone[k] + apart)) - 1  # the last that cannot touch
                if ahead == k and k + 1 < len(gone) and self._touches_between(a, b, values, k):
                    found.add(frozenset((a.owner, b.owner)))
                    break
                k = max(k + 1, ahead if ahead < len(gone) - 1 else len(gone))
        return found

    def _touches_between(self, a, b, values, k):
        parts = np.linspace(0, 1, FINER + 1)[1:-1]
        T = self.frames({name: value[k] + parts * (value[k + 1] - value[k]) for name, value in values.items()})
        one, other = (T[each.owner] @ each.place if not each.is_obstacle else each.place[None] for each in (a, b))
        return any(self._distance(a, b, each) <= 0 for each in _inverse(other) @ one)


def _inverse(T):
    result, turned = np.zeros(T.shape), np.swapaxes(T[:, :3, :3], 1, 2)
    result[:, :3, :3], result[:, 3, 3] = turned, 1.0
    result[:, :3, 3] = -np.einsum("nij,nj->ni", turned, T[:, :3, 3])
    return result


def values_at(robot, scene, q):
    """Return the values of joints at commands (n, n_actuated) by name: with loops, of all, which must close."""
    if not robot.mechanism.loops:
        return dict(zip(robot.joint_names, q.T, strict=True))
    joints, ok = scene.configurations(q)
    assert np.all(ok)
    return dict(zip(robot.mechanism.origin_names, joints.T, strict=True))


def checker_of(robot, scene, obstacles):
    """Return the checker of a robot's URDF, with the pairs of a scene."""
    home = dict(zip(robot.mechanism.origin_names, robot.mechanism.constant, strict=True))
    urdf = Path(robot.urdf.path)
    looked_at = {frozenset(scene.bodies[k].name for k in pair) for pair in scene.pairs}
    return Checker(urdf, home, obstacles, looked_at, solids(urdf) or capsules(urdf, robot))


def gap_of_loops(robot, checker, values):
    """Return how far loops are open by the checker's own frames, in the directions that they close, at most [m]."""
    T, worst = checker.frames(values), 0.0
    description = robot.description
    for (a, b), axes in zip(description.closed_loop, description.closed_loop_axes, strict=True):
        gap = (np.linalg.inv(T[a]) @ T[b])[:, :3, 3]
        worst = max(worst, float(np.max(np.abs(gap[:, ["xyz".index(axis) for axis in axes]]))))
    return worst


def boxes_around(robot, rng, count=2):
    """Return boxes where the robot reaches, on its root link."""
    q = robot.sample(60, rng)
    points = robot.forward(q)[:, :3, 3]
    size = max(float(np.ptp(points, axis=0).max()), 0.05)
    chosen = points[rng.integers(len(points), size=count)]
    sizes = [rng.uniform(0.05, 0.2, 3) * size for _ in chosen]
    return {
        f"box{k}": {"box": side.tolist(), "xyz": point.tolist()}
        for k, (side, point) in enumerate(zip(sizes, chosen, strict=True))
    }


@lru_cache(1)
def checked_scene(path, seed):
    """Return a robot among random boxes that leave its home free, its scene, and the checker; MedRUE at its leg."""
    plain, rng, is_medrue = load(path, obstacles="unchecked"), np.random.default_rng(seed), path.stem == "medrue"
    for _ in range(50):
        obstacles = boxes_around(plain, rng, 1 if is_medrue else 2) | ({"leg": LEG} if is_medrue else {})
        robot = load(path, obstacles=obstacles)
        try:
            scene = surroundings(robot).scene
        except CalibrationError:  # a box around the base
            continue
        if not scene.hits(robot.home[None])[0]:
            return robot, scene, checker_of(robot, scene, obstacles)
    raise RuntimeError(f"{path}: no boxes leave home free")


def campaign(path, seed, n_poses=5):
    """Plan a route among random boxes and walk along it; return what was seen, as a dictionary."""
    robot, scene, checker = checked_scene(path, seed // POSES_IN_A_SCENE)
    try:
        poses = calib.sample(robot, n_poses, seed)
        route = plan_route(robot, poses, seed=seed)
    except CalibrationError as error:
        return {"no_route": str(error)[:200]}
    corners, looks = route.corners(), checker.looks
    reach = scene.reach(np.max(np.abs(scene.configurations(corners)[0]), axis=0))
    found, steps, gap = set(), 0, 0.0
    for one, other in itertools.pairwise(corners):
        moved = np.abs(np.diff(scene.configurations(np.array([one, other]))[0], axis=0))[0]
        n = max(1, int(np.ceil(np.max(reach @ moved / (np.maximum(scene.margins, LEAST) / 2), initial=0.0))))
        values = values_at(robot, scene, one + np.linspace(0, 1, n + 1)[:, None] * (other - one))
        if robot.mechanism.loops:
            gap = max(gap, gap_of_loops(robot, checker, values))
        found |= checker.walk(values)
        steps += FINER * n
    return {
        "contacts": sorted(" - ".join(sorted(pair)) for pair in found),
        "steps": steps,
        "looks": checker.looks - looks,
        "stops": len(route.stops),
        "around": sum(len(stop.corners) > 0 for stop in route.stops),
        "left_out": len(route.left_out),
        "gap": gap,
    }


def main():
    """Run campaigns, one robot after the other in each round, and write a line of JSON for each."""
    parser = argparse.ArgumentParser(description="Walk routes of robots step by step, with shapes looked at by FCL.")
    parser.add_argument("campaigns", type=int, help="how many for each robot")
    parser.add_argument("robots", nargs="*", metavar="ROBOT", help="those of the list, if none is named")
    parser.add_argument("--out", type=Path, required=True, help="lines of JSON; those that are there are not repeated")
    parser.add_argument("--step", type=int, default=1, help="run every n-th of what is left")
    parser.add_argument("--first", type=int, default=0, help="from this one on")
    given = parser.parse_args()
    done = set()
    if given.out.exists():
        done = {(row["robot"], row["seed"]) for row in map(json.loads, given.out.read_text().splitlines())}
    starts = range(0, given.campaigns, POSES_IN_A_SCENE)
    rounds = [range(k, min(k + POSES_IN_A_SCENE, given.campaigns)) for k in starts]
    tasks = [(seed, name) for seeds in rounds for name in given.robots or ROBOTS for seed in seeds]
    for seed, name in tasks[given.first :: given.step]:
        if (name, seed) in done:
            continue
        started = time.process_time()
        try:
            what = campaign(source(name), seed)
        except Exception as error:  # said, and the next one
            what = {"error": f"{type(error).__name__}: {error}"[:300]}
        row = {"robot": name, "seed": seed} | what | {"seconds": round(time.process_time() - started, 1)}
        with given.out.open("a") as file:
            print(json.dumps(row), file=file)


if __name__ == "__main__":
    main()
