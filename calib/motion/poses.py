"""Poses free of collisions, and colliding pairs, for planning and pages (`check_poses`).

Pairs of shapes that are not checked, as in MoveIt's setup assistant:

- Links that a joint or a loop connects: their shapes meet there.
- Links that touch at home, or at nearly all of many poses: nearly constant contact is a matter of their shapes. A home
  outside the joint limits does not count: the robot cannot stand there.
- Pairs that an SRDF beside the URDF disables.

Links that do not touch at home, but are nearer than their clearance, are built so: they are checked without clearance.

Unlike in MoveIt, pairs that never touched at many poses are checked: they cost microseconds, and rare contacts are the
ones that break robots. Obstacles and parts of the tool are only exempt from constant contact. An obstacle in constant
contact with a moving link is misplaced, which is an error.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from xml.parsers.expat import ExpatError

import numpy as np

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import DataError, DescriptionError, UrdfError
from calib.core.base.files import read_text
from calib.core.base.memoize import memoize
from calib.core.base.words import count_noun
from calib.core.robots.robot import Robot
from calib.core.robots.urdf.meshes import find_mesh
from calib.motion.scene import CollisionScene, all_shapes, exceeds_limits, moving_between
from calib.motion.shapes import is_moved_frame
from calib.motion.sight import Sight, sight_lines
from calib.motion.surroundings import UNCHECKED
from calib.shared.links import element_tree, read_links
from calib.shared.pose_check import PoseCheck

_SIGHT_SAMPLES = 100  # poses from which shapes that always hide a line are found
_CONTACT_SAMPLES = 400  # poses from which constant contacts are found
_ALWAYS = 0.95  # shapes always touch if they do in this part of the samples
_TOUCH = 1e-4  # distance of shapes that touch, at most [m]
_SHOWN = 6


def why_unchecked(robot: Robot) -> str:
    """Return the reason why nothing is checked; "" if the robot has collision shapes or the description needs it."""
    description = robot.description
    if description.obstacles == UNCHECKED:
        return f"the description says 'obstacles: {UNCHECKED}'"
    stated: list[object] = [description.obstacles, description.sight]
    stated += [each for target in description.targets.values() for each in (target.shape, target.acceptance)]
    if any(each is not None for each in stated):
        return ""
    links = {}
    if b"<collision" in robot.urdf.source:
        try:
            links = read_links(robot.urdf)
        except UrdfError as error:
            return str(error)
    shapes = [shape for link in links.values() for shape in link.collisions]
    if not shapes:
        return "the robot file has no collision shapes, and the description names no obstacles"
    for shape in shapes:
        if shape.kind == "mesh" and find_mesh(shape.file, robot.urdf.path) is None:
            return f"mesh '{shape.file}' of {robot.urdf.path} is not there"
    return ""


@memoize
def surroundings(robot: Robot) -> Sight:
    """Return the scene of a robot with its lines of sight.

    Raises:
        DescriptionError: A mesh is missing, an SRDF is of another robot, or an obstacle surrounds the robot.
    """
    sight = Sight(build_scene(robot), tuple(sight_lines(robot)))
    if not sight.lines:
        return sight
    joints, ok = sight.scene.configurations(home_and_more(robot, _SIGHT_SAMPLES, 1))
    return sight.without_ends(joints[ok])


def what_hits(robot: Robot, joints: FloatArray) -> tuple[str, ...]:
    """Return the colliding pair, or the hiding shape, at commands (n, n_actuated) [m or rad], (n,); "" for none."""
    sight = surroundings(robot)
    hits = np.array(sight.scene.hits(joints), dtype=object)
    free = np.flatnonzero(hits == "")
    if sight.lines and len(free):
        hits[free] = sight.hidden_targets(sight.scene.configurations(joints[free])[0])
    return tuple(hits)


def check_poses(robot: Robot, joints: FloatArray) -> PoseCheck:
    """Return the check of commands (n, n_actuated) [m or rad]; see `calib.shared.pose_check`."""
    unchecked = why_unchecked(robot)
    if unchecked:
        return PoseCheck(("",) * len(joints), (), unchecked)
    return PoseCheck(what_hits(robot, joints), surroundings(robot).scene.remarks)


def build_scene(robot: Robot) -> CollisionScene:
    """Return the scene of a robot, with the pairs to check."""
    scene = all_shapes(robot)
    disabled = _disabled_pairs(robot)
    names = [frozenset(scene.bodies[k].name for k in pair) for pair in scene.pairs]
    kept = np.array([name not in disabled for name in names], dtype=bool) & (scene.has_described | ~_adjacent(scene))
    return _without_permanent_contacts(scene.select_pairs(kept))


def _adjacent(scene: CollisionScene) -> BoolArray:
    """Mask of the pairs of links that a joint or a loop connects, (n_pairs,)."""
    robot = scene.robot
    frames = np.array([(scene.bodies[a].joint, scene.bodies[b].joint) for a, b in scene.pairs], dtype=np.intp)
    a, b = frames.reshape(-1, 2).T
    result = moving_between(robot, a, b) == 1
    for loop in robot.mechanism.loops:
        ends = np.full(len(a), loop.a), np.full(len(a), loop.b)
        for one, other in ((a, b), (b, a)):
            result |= (moving_between(robot, one, ends[0]) == 0) & (moving_between(robot, other, ends[1]) == 0)
    return result


def _without_permanent_contacts(scene: CollisionScene) -> CollisionScene:
    """The scene without pairs that touch at home or at nearly all poses."""
    if not scene.pairs:
        return scene
    apart = scene.distances(scene.configurations(home_and_more(scene.robot, _CONTACT_SAMPLES, 0))[0])
    names = [scene.name(k) for k in range(len(scene.pairs))]
    order = np.unique(names, return_inverse=True)[1]

    def any_of_name(mask: BoolArray) -> BoolArray:
        return np.stack([np.any(mask[:, order == k], axis=1) for k in range(order.max() + 1)], axis=1)[:, order]

    near = any_of_name(apart <= 0)
    at_home = ~scene.has_described & (not np.any(exceeds_limits(scene.robot, scene.robot.home)))
    always = np.mean(near, axis=0) >= _ALWAYS
    touching = at_home & ~always & any_of_name(apart[:1] + scene.margins <= _TOUCH)[0]
    close = at_home & ~always & ~touching & near[0]
    _require_room(scene, apart, always)
    scene = replace(scene, without_clearance=frozenset(scene.pairs[k] for k in np.flatnonzero(close)))
    for reason, out in (
        ("not checked, as they touch at home", touching),
        ("not checked, as they touch at nearly all poses", always),
        ("checked without clearance, as they are nearer at home", close),
    ):
        if listed := list(dict.fromkeys(np.array(names)[out])):
            more = f" and {count_noun(len(listed) - _SHOWN, 'further pair')}" if len(listed) > _SHOWN else ""
            scene = scene.with_remarks(f"{reason}: {', '.join(listed[:_SHOWN])}{more}")
    return scene.select_pairs(~(always | touching))


def _require_room(scene: CollisionScene, touching: FloatArray, always: BoolArray) -> None:
    """Raise `DescriptionError` if a fixed obstacle always touches a link, not counting clearance."""
    for k in np.flatnonzero(always & (np.max(touching + scene.margins, axis=0) <= 0)):
        for body in (scene.bodies[place] for place in scene.pairs[k]):
            if body.is_described and not is_moved_frame(scene.robot)[body.joint]:
                raise DescriptionError(
                    f"{scene.robot.path}: obstacle '{body.name}' is in the robot at every pose ({scene.name(int(k))});"
                    " check its frame, xyz and size"
                )


def home_and_more(robot: Robot, count: int, seed: int) -> FloatArray:
    """Return home, then up to `count` poses over the joint limits, (n, n_actuated) [m or rad]."""
    try:
        return np.vstack([robot.home, robot.sample(count, seed)])
    except DataError:
        return robot.home[None]


def _disabled_pairs(robot: Robot) -> set[frozenset[str]]:
    """Pairs of links that an SRDF of this robot disables."""
    pairs: set[frozenset[str]] = set()
    for path in _srdf_files(robot):
        try:
            root = element_tree(read_text(path, "an SRDF", DescriptionError).encode())
        except ExpatError as error:
            raise DescriptionError(f"{path}: is not XML ({error}); correct it, or take it away") from None
        own, same = path.stem == Path(robot.urdf.path).stem, root.get("name") == robot.urdf.name
        named = [
            frozenset(str(element.get(key)) for key in ("link1", "link2"))
            for element in root.iterfind("disable_collisions")
        ]
        unknown = [name for name in sorted(frozenset().union(*named)) if name not in robot.urdf.links]
        shared = named or {joint.get("name") for joint in root.iter("joint")} & set(robot.mechanism.origin_names)
        if own and not same and (unknown or not shared):  # with links or joints in common, only the names differ
            raise DescriptionError(
                f"{path}: is the SRDF of robot '{root.get('name')}', but {robot.urdf.path} is '{robot.urdf.name}'"
            )
        if own or same:
            pairs.update(named)  # links that this part of the robot lacks have no shapes here
    return pairs


def _srdf_files(robot: Robot) -> Iterator[Path]:
    folder = Path(robot.urdf.path).resolve().parent
    for place in (folder, folder.parent / "srdf", folder.parent / "config"):
        yield from sorted(place.glob("*.srdf"))
