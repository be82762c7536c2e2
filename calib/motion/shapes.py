"""Shapes for collisions: of links, tools and obstacles, each fixed to a link.

They are the collision shapes of the URDF; without any, its visuals; without these, capsules from the origin of each
link to those of its children.

Distances come in two steps. A mesh lies in its convex hull, whose distances take coal microseconds: if hulls are apart,
meshes are apart. If not, two tests decide: whether triangles touch, and whether one mesh is inside the other (then no
triangles touch). Visuals are drawn for the eye and often open. In place of these, and of meshes with very many
triangles, the hull is the shape.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from calib.core.base.arrays import BoolArray, FloatArray
from calib.core.base.errors import DescriptionError
from calib.core.base.words import listing
from calib.core.robots.mechanism import rigid
from calib.core.robots.robot_data import RobotData
from calib.core.robots.urdf.meshes import find_mesh
from calib.motion.surroundings import UNCHECKED, ShapeSection
from calib.shared.links import LinkShape, read_links

_MOST_TRIANGLES = 20_000
_THIN = 0.04  # radius of capsules for links, in characteristic lengths of the robot
_FLAT = 1e-4  # thickness of a hull without volume [m]


@dataclass(frozen=True, eq=False)
class Solid:
    """A shape in its own axes.

    Attributes:
        hull: Convex shape around it.
        radius: Distance of its farthest point from the origin [m].
        mesh: Its triangles if it is not convex, else None.
        corners: Corners of these triangles, (n, 3, 3) [m]; empty if it is convex.
    """

    hull: Any
    radius: float = 0.0
    mesh: Any = None
    corners: FloatArray = field(default_factory=lambda: np.zeros((0, 3, 3)))


@dataclass(frozen=True, eq=False)
class Body:
    """A shape on a link.

    Attributes:
        name: Name of its link, or of the obstacle.
        joint: Index of the link's frame in the mechanism.
        placement: Pose in the link's frame.
        solid: The shape.
        clearance: Least distance from other shapes [m].
        is_described: Whether it comes from the description: an obstacle, or a part of the tool.
    """

    name: str
    joint: int
    placement: pin.SE3
    solid: Solid
    clearance: float
    is_described: bool = False

    @property
    def radius(self) -> float:
        """Distance of its farthest point from the link's origin, at most [m]."""
        return float(np.linalg.norm(self.placement.translation)) + self.solid.radius


def bodies_of(robot: RobotData) -> tuple[tuple[Body, ...], tuple[str, ...]]:
    """Return the shapes of a robot and its surroundings, and remarks on them.

    Raises:
        DescriptionError: A mesh that is missing or cannot be read, an obstacle on an unknown link, or a plane on a
            moving link.
        UrdfError: A shape of the URDF is not made of numbers.
    """
    links, remarks = _links(robot)
    return (*links, *_described_bodies(robot)), remarks


def is_moved_frame(robot: RobotData) -> BoolArray:
    """Mask of the frames that move relative to the root link, (n_joints + 1,)."""
    mechanism = robot.mechanism
    return np.asarray(mechanism.support @ np.any(mechanism.select_moving != 0, axis=1) > 0)


def _links(robot: RobotData) -> tuple[list[Body], tuple[str, ...]]:
    read, clearance = read_links(robot.urdf), robot.description.self_clearance
    by_link = {name: link.collisions for name, link in read.items()}
    exact = any(by_link.values())
    if not exact:
        by_link = {name: link.visuals for name, link in read.items()}
    frames = robot.mechanism.frames
    bodies = [
        Body(name, frames[name], shape.placement, _solid_of_link(shape, name, robot, exact=exact), clearance)
        for name, shapes in by_link.items()
        for shape in shapes
    ]
    if not bodies:
        capsules = [body for name in robot.urdf.links for body in _capsules(robot, name)]
        return capsules, ("the robot file has no shapes: capsules from joint to joint stand for its links",)
    remarks = (
        [] if exact else ["the robot file has no collision shapes: the convex hulls of its visuals stand for them"]
    )
    bare_frames = set(np.flatnonzero(is_moved_frame(robot)).tolist()) - {body.joint for body in bodies}
    bare = [joint.child for joint in robot.urdf.joints if frames[joint.child] in bare_frames]
    bare = [name for name in bare if any(np.linalg.norm(j.xyz) > 0 for j in robot.urdf.joints if j.parent == name)]
    unread = [f"{kind} of {name}" for name, link in read.items() for kind in link.unknown_collisions]
    if unread:
        remarks.append(f"shapes that are not checked, as URDF has no such kind: {listing(unread)}")
    if bare:
        remarks.append(f"links without any shape, which are not checked: {listing(bare)}")
    return bodies, tuple(remarks)


def _solid_of_link(shape: LinkShape, link: str, robot: RobotData, *, exact: bool) -> Solid:
    if shape.kind != "mesh":
        return _primitive(shape.kind, shape.size)
    path = find_mesh(shape.file, robot.urdf.path)
    if path is None:
        raise DescriptionError(
            f"{robot.urdf.path}, link '{link}': mesh '{shape.file}' is not there; put it beside the URDF, or write"
            f" 'obstacles: {UNCHECKED}' into the description to go without"
        )
    return _solid_of_mesh(path, np.array(shape.size), exact=exact)


def _described_bodies(robot: RobotData) -> list[Body]:
    """Obstacles, parts of the tool, and shapes at targets."""
    description, mechanism, where = robot.description, robot.mechanism, robot.path
    bodies = []
    obstacles = description.obstacles if isinstance(description.obstacles, dict) else {}
    for name, section in obstacles.items():
        joint = 0 if section.frame is None else _frame(robot, section.frame, f"obstacles.{name}.frame")
        if section.plane and is_moved_frame(robot)[joint]:
            raise DescriptionError(f"{where}: obstacles.{name}: a plane cannot move with '{section.frame}'; give a box")
        solid = _solid_of_section(section, f"{where}: obstacles.{name}")
        bodies.append(Body(name, joint, rigid(section.xyz, section.rpy), solid, section.clearance, is_described=True))
    for name, target in description.targets.items():
        if target.shape is not None:
            place = rigid(target.shape.xyz, target.shape.rpy)
            solid = _solid_of_section(target.shape, f"{where}: targets.{name}.shape")
            bodies.append(
                Body(name, mechanism.places[name], place, solid, description.self_clearance, is_described=True)
            )
    return bodies


def _frame(robot: RobotData, name: str, where: str) -> int:
    try:
        return robot.mechanism.joint(name)
    except DescriptionError as error:
        raise DescriptionError(f"{robot.path}: {where}: {error}") from None


def _solid_of_section(section: ShapeSection, where: str) -> Solid:
    if section.kind == "plane":
        return Solid(coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0))
    if section.kind == "mesh":
        assert section.mesh is not None
        if not Path(section.mesh).is_file():
            raise DescriptionError(f"{where}: mesh '{section.mesh}' is not there")
        return _solid_of_mesh(Path(section.mesh), np.full(3, section.scale), exact=True)
    size = getattr(section, section.kind)
    return _primitive(section.kind, size if isinstance(size, tuple) else (size,))


def _primitive(kind: str, size: Sequence[float]) -> Solid:
    if kind == "sphere":
        return Solid(coal.Sphere(size[0]), size[0])
    if kind == "cylinder":
        radius, length = size
        return Solid(coal.Cylinder(radius, length), math.hypot(radius, length / 2))
    return Solid(coal.Box(*size), math.hypot(*size) / 2)


def _solid_of_mesh(path: Path, scale: FloatArray, *, exact: bool) -> Solid:
    import trimesh

    try:
        mesh: Any = trimesh.load(path, force="mesh", ignore_broken=True)
        vertices, faces = np.asarray(mesh.vertices) * scale, np.asarray(mesh.faces, dtype=np.int64)
        if not len(faces):
            raise ValueError("it holds no triangles")
    except Exception as error:  # the readers of mesh files raise many kinds
        raise DescriptionError(f"{path}: the mesh cannot be read ({str(error).splitlines()[0]:.80})") from None
    hull, radius = _hull(vertices)
    whole = trimesh.Trimesh(vertices, faces, process=False)
    if not exact or len(faces) > _MOST_TRIANGLES or whole.is_convex:
        return Solid(hull, radius)
    surface = coal.BVHModelOBBRSS()
    surface.beginModel(len(faces), len(vertices))
    surface.addVertices(vertices)
    surface.addTriangles(faces)
    surface.endModel()
    return Solid(hull, radius, surface, vertices[faces])


def _hull(vertices: FloatArray) -> tuple[Any, float]:
    """Convex hull of points, and the distance of its farthest corner; a box around points in a plane."""
    import scipy
    import trimesh

    try:
        hull: Any = trimesh.convex.convex_hull(vertices)
    except (scipy.spatial.QhullError, ValueError):
        hull = trimesh.creation.box(bounds=(vertices.min(axis=0) - _FLAT / 2, vertices.max(axis=0) + _FLAT / 2))
    corners, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    corners.extend(list(hull.vertices))
    triangles.extend([coal.Triangle(*face) for face in hull.faces.tolist()])
    return coal.Convex(corners, triangles), float(np.max(np.linalg.norm(hull.vertices, axis=1)))


def _capsules(robot: RobotData, link: str) -> list[Body]:
    """Capsules along a link; a ball at the end of a chain."""
    joint, radius = robot.mechanism.frames[link], _THIN * robot.mechanism.length
    bodies, stretches = [], list(_stretches(robot, link))
    for start, end in stretches or [(np.zeros(3), np.zeros(3))]:
        length = float(np.linalg.norm(end - start))
        if length <= radius and stretches:
            continue
        turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end - start).matrix()
        solid = Solid(coal.Capsule(radius, length), length / 2 + radius)
        bodies.append(Body(link, joint, pin.SE3(turn, (start + end) / 2), solid, robot.description.self_clearance))
    return bodies


def _stretches(robot: RobotData, link: str) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Ends of the rods of a link, (3,) [m]: from its origin to its joints and targets, and rods of slides.

    Both links of a sliding joint have a rod as long as the joint's value at home. Together they cover twice that value.
    """
    home = dict(zip(robot.mechanism.actuated, robot.home.tolist(), strict=True))
    origin = np.zeros(3)
    for joint in robot.urdf.joints:
        rod = np.array(joint.axis) * home.get(joint.name, 0.0) if joint.type == "prismatic" else origin
        if joint.parent == link:
            place = rigid(joint.xyz, joint.rpy)
            yield origin, place.translation
            if np.any(rod):
                yield place.translation, place.act(rod)
        elif joint.child == link and np.any(rod):
            yield -rod, origin
    for target in robot.description.targets.values():
        if target.frame == link:
            yield origin, np.array(target.xyz)


def is_inside(point: FloatArray, corners: FloatArray) -> bool:
    """Whether a point (3,) is inside a closed mesh of triangles (n, 3, 3), by their solid angles.

    Reference: oosterom1983.
    """
    a, b, c = np.moveaxis(corners - point, 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    below = la * lb * lc + lc * np.einsum("ij,ij->i", a, b)
    below += la * np.einsum("ij,ij->i", b, c) + lb * np.einsum("ij,ij->i", c, a)
    return bool(abs(np.sum(2.0 * np.arctan2(volume, below))) > 2.0 * np.pi)
