"""MuJoCo's format (MJCF) read as a URDF, for `urdf: robot.xml`.

MuJoCo reads the file, with its includes, defaults and units; its model is written as an equivalent URDF. With p a
joint's place in its body and q0 its value in the file (`ref`):

    body        a link of its name in the body's frame
    joint       T_parent_joint = T_parent_body Trans(p) Motion(-q0), so that its value is MuJoCo's (qpos). Trans(-p)
                leads from it to the body. Several joints of a body follow each other, with links between them
    ball joint  three hinges about x, y and z, in a row; for a rod tied to others at one point, two across it
    site        a link that is fixed to its body
    connect, weld (equality)
                a loop that stays cut open: two coinciding links, one fixed to each body
    joint (equality)
                `mimic`, about the values in the file

Directions of a loop. A `connect` ties two points in three directions. In a planar loop, no joint moves the points apart
along one direction n of the first body, so the loop holds the other two. Along n, all rows n^T (J_a - J_b) are zero, at
configurations drawn around the file's. The links of such a loop have n as their z axis: it holds x and y.

When it fails. Free joints are fixed at the file's pose. Ties by tendons, and joints that follow others by a polynomial,
are errors: URDF has none. Of shapes, boxes, spheres, cylinders, capsules and mesh files are kept: as visuals those that
MuJoCo draws, as collisions those that touch something in it. A remark says where other collision shapes are left out,
and those of the world.

Reference: todorov2012.
"""

from __future__ import annotations

import itertools
import os
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Comment, Element, SubElement

import numpy as np
import pinocchio as pin

from calib.core.base.arrays import FloatArray, ReadOnlyArrays
from calib.core.base.errors import UrdfError, require_package
from calib.core.base.words import warn_once
from calib.core.numerics import linalg
from calib.core.robots.mechanism import perpendicular_axes
from calib.core.robots.urdf.text import ForeignLoop, ForeignRobot
from calib.core.robots.urdf.writing import number_attribute
from calib.files.urdf_elements import NewUrdf

_DRAWN = 12  # configurations for the directions of a loop
_SPREAD = 0.3  # standard deviation from the file's configuration [m, rad]
_MOVES = 1e-7  # joints move along a direction whose singular value is more than this part of the largest
_SHOWN_GROUPS = 3  # number of shape groups: MuJoCo draws groups 0, 1 and 2
_NOT_HELD = "a URDF cannot hold it; take it out of the file, or its joints if the arm does not need them"
_MESHES = (".stl", ".obj", ".dae", ".ply")


@dataclass(frozen=True, eq=False)
class _Motion(ReadOnlyArrays):
    """A joint of one degree of freedom.

    Attributes:
        name: Name in the URDF.
        kind: Type in the URDF.
        axis: Axis in the body, (3,).
        before, after: Shift from the body's frame to the joint's place before the motion, and back after it, (3,) [m].
        value: Value in the file [m or rad].
        limits: Lowest and highest value, or None.
    """

    name: str
    kind: str
    axis: FloatArray
    before: FloatArray
    after: FloatArray
    value: float = 0.0
    limits: tuple[float, float] | None = None


def read_mjcf(path: str, *_: object) -> tuple[bytes, ForeignRobot]:
    """Return an MJCF file, with its includes, as a URDF, and what a URDF cannot hold.

    `UrdfError` if MuJoCo is not installed, or cannot read the file; or URDF has no equivalent for its content.
    """
    what = f"{path}: is an MJCF file, and the package that reads them is not installed"
    mujoco = require_package("mujoco", f"{what}: pip install mujoco; or give a URDF", UrdfError)
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda text: warn_once(f"{path}: MuJoCo says: {text}"))  # else into MUJOCO_LOG.TXT
    try:
        spec = mujoco.MjSpec.from_file(str(Path(path).resolve()))  # mesh paths are relative to the working folder
        with warnings.catch_warnings(action="ignore"):  # warnings about soft bodies
            model = spec.compile()
    except (ValueError, OSError) as error:
        raise UrdfError(f"{path}: MuJoCo cannot read it: {' '.join(str(error).split())}") from None
    finally:
        mujoco.set_mju_user_warning(before)
    if model.nflex:
        raise UrdfError(f"{path}: has soft bodies (flex), which a URDF cannot hold; take them out of the file")
    folder = Path(path).resolve().parent
    return _MjcfReader(mujoco, model, path, os.path.relpath(folder / (spec.meshdir or "."), folder)).read()


class _MjcfReader:
    def __init__(self, mujoco: Any, model: Any, path: str, meshes: str) -> None:
        self.mujoco, self.model, self.path, self.meshes = mujoco, model, path, meshes
        self.urdf = NewUrdf(_text(model.names) or Path(path).stem)
        self.joints: dict[str, Element] = {}  # by name
        self.link_of: dict[int, str] = {}  # link of each body
        self.home: dict[str, float] = {}
        self.remarks: list[str] = []

    def read(self) -> tuple[bytes, ForeignRobot]:
        self._link("world", 0)
        for body in range(1, self.model.nbody):
            self._body(body)
        for site in range(self.model.nsite):
            carrier = self.link_of[int(self.model.site_bodyid[site])]
            place = _se3(self.model.site_pos[site], self.model.site_quat[site])
            self.urdf.fix(carrier, self._new(self._name("SITE", site)), place)
        loops = tuple(self._equalities())
        remarks = (*self.remarks, *self.urdf.remarks)
        comment = "; ".join([f" from MJCF: {Path(self.path).name}", *remarks]).replace("--", "- -")
        self.urdf.root.insert(0, Comment(f"{comment} "))
        motors = tuple(dict.fromkeys(self._motors()))
        stiff = [self._name("JOINT", int(number)) for number in np.flatnonzero(self.model.jnt_stiffness > 0)]
        springs = tuple(name for name in stiff if name in self.home and name not in motors)
        return self.urdf.document(), ForeignRobot(motors, loops, springs, self.home, remarks)

    def _name(self, kind: str, number: int) -> str:
        of = getattr(self.mujoco.mjtObj, f"mjOBJ_{kind}")
        return self.mujoco.mj_id2name(self.model, of, number) or f"{kind.lower()}_{number}"

    def _new(self, name: str) -> str:
        while name in self.urdf.links:
            name += "_"
        return name

    def _body(self, body: int) -> None:
        model, name = self.model, self._new(self._name("BODY", body))
        parent = self.link_of[int(model.body_parentid[body])]
        place = _se3(model.body_pos[body], model.body_quat[body])
        first = int(model.body_jntadr[body])
        joints = list(range(first, first + int(model.body_jntnum[body])))
        motions = [motion for joint in joints for motion in self._motions(joint)]
        for count, motion in enumerate(motions, start=1):
            ends = count == len(motions) and not np.any(motion.after)
            child = name if ends else self._new(f"{name}_{motion.name}")
            self._moving(motion, parent, child, place * pin.SE3(np.eye(3), motion.before))
            if ends:
                self._link(child, body)
            else:
                self.urdf.add_link(child)
            parent, place = child, pin.SE3(np.eye(3), -motion.after)
        if name not in self.urdf.links:
            self.urdf.add_joint(f"{name}_fixed", "fixed", (parent, name), place)
            self._link(name, body)

    def _motions(self, joint: int) -> Iterator[_Motion]:
        """Elementary motions of a joint; none for a free joint."""
        model, types = self.model, self.mujoco.mjtJoint
        kind, name = int(model.jnt_type[joint]), self._name("JOINT", joint)
        about, nowhere = np.array(model.jnt_pos[joint]), np.zeros(3)
        if kind == types.mjJNT_FREE:
            body = self._name("BODY", int(model.jnt_bodyid[joint]))
            self.remarks.append(f"body {body} moves freely in the file, and stands still here")
        elif kind == types.mjJNT_BALL:
            along = self._rod(int(model.jnt_bodyid[joint]), about)
            axes = np.eye(3) if along is None else perpendicular_axes(along)
            names = [f"{name}_{letter}" for letter, _ in zip("xyz", axes, strict=False)]
            hinges = f"{', '.join(names[:-1])} and {names[-1]}"
            self.remarks.append(
                f"ball joint {name} is three hinges, {hinges}"
                if along is None
                else f"ball joint {name} is two hinges, {hinges}: the spin of this rod about itself moves nothing"
            )
            befores = [about, *[nowhere] * (len(names) - 1)]
            for hinge, axis, before, after in zip(names, axes, befores, befores[::-1], strict=True):
                yield _Motion(hinge, "continuous", axis, before, after)
        else:
            limits = (float(model.jnt_range[joint, 0]), float(model.jnt_range[joint, 1]))
            limited = bool(model.jnt_limited[joint])
            turning = "revolute" if limited else "continuous"
            moves = "prismatic" if kind == types.mjJNT_SLIDE else turning
            if moves == "prismatic" and not limited:
                raise UrdfError(
                    f"{self.path}: joint '{name}' slides without a range, which a URDF must have: add range"
                )
            value = float(model.qpos0[model.jnt_qposadr[joint]])
            axis = np.array(model.jnt_axis[joint])
            yield _Motion(name, moves, axis, about, about, value, limits if limited else None)

    def _rod(self, body: int, centre: FloatArray) -> FloatArray | None:
        """Direction in a body from its ball joint to the only point that ties it to others, (3,); None: no rod."""
        model, types = self.model, self.mujoco.mjtEq
        if np.any(model.body_parentid[1:] == body) or model.body_jntnum[body] != 1:
            return None
        points = []
        for number in np.flatnonzero(model.eq_active0):
            if model.eq_type[number] == types.mjEQ_JOINT:
                continue
            bodies, places = self._bodies_of_tie(int(number))
            if body in bodies and model.eq_type[number] != types.mjEQ_CONNECT:
                return None
            points += [place.translation - centre for place, own in zip(places, bodies, strict=True) if own == body]
        length = float(np.linalg.norm(points[0])) if len(points) == 1 else 0.0
        return points[0] / length if length > 0 else None

    def _moving(self, motion: _Motion, parent: str, child: str, place: pin.SE3) -> None:
        """Add a moving joint that has the same value as in MuJoCo."""
        if motion.kind == "prismatic":
            place = place * pin.SE3(np.eye(3), -motion.value * motion.axis)
        elif motion.value:
            place = place * pin.SE3(pin.AngleAxis(-motion.value, motion.axis).matrix(), np.zeros(3))
        ends, name = (parent, child), motion.name
        self.joints[name] = self.urdf.add_joint(name, motion.kind, ends, place, motion.axis, motion.limits)
        self.home[motion.name] = motion.value

    def _link(self, name: str, body: int) -> None:
        """Add the link of a body, with its mass and shapes."""
        self.urdf.add_link(name)
        model, self.link_of[body] = self.model, name
        if body and model.body_mass[body] > 0:
            diagonal = dict(zip(("ixx", "iyy", "izz"), map(repr, map(float, model.body_inertia[body])), strict=True))
            place = _se3(model.body_ipos[body], model.body_iquat[body])
            self.urdf.add_inertia(name, place, repr(float(model.body_mass[body])), diagonal)
        first = int(model.body_geomadr[body])
        for geom in range(first, first + int(model.body_geomnum[body])):
            shapes = list(self._shapes(geom)) if body else []
            if model.geom_group[geom] < _SHOWN_GROUPS:
                self.urdf.add_shape(name, "visual", shapes[:1])
            if model.geom_contype[geom] or model.geom_conaffinity[geom]:
                self.urdf.add_shape(name, "collision", shapes)

    def _shapes(self, geom: int) -> Iterator[tuple[pin.SE3, Element]]:
        """URDF's shapes of a shape, with their places: of a capsule the cylinder, then its ends."""
        model, types = self.model, self.mujoco.mjtGeom
        size, place = np.array(model.geom_size[geom]), _se3(model.geom_pos[geom], model.geom_quat[geom])
        kind = int(model.geom_type[geom])
        if kind == types.mjGEOM_BOX:
            yield place, Element("box", size=number_attribute(2 * size))
        elif kind == types.mjGEOM_SPHERE:
            yield place, Element("sphere", radius=repr(float(size[0])))
        elif kind in (types.mjGEOM_CYLINDER, types.mjGEOM_CAPSULE):
            radius, half = repr(float(size[0])), float(size[1])
            yield place, Element("cylinder", radius=radius, length=repr(2 * half))
            for end in (-half, half) if kind == types.mjGEOM_CAPSULE else ():
                yield place * pin.SE3(np.eye(3), np.array([0.0, 0.0, end])), Element("sphere", radius=radius)
        elif kind == types.mjGEOM_MESH:
            mesh = int(model.geom_dataid[geom])
            file = _text(model.paths[model.mesh_pathadr[mesh] :]) if model.mesh_pathadr[mesh] >= 0 else ""
            if Path(file).suffix.lower() in _MESHES:
                place = place * _se3(model.mesh_pos[mesh], model.mesh_quat[mesh]).inverse()  # MuJoCo centres meshes
                where = Path(self.meshes, file).as_posix()
                yield place, Element("mesh", filename=where, scale=number_attribute(model.mesh_scale[mesh]))

    def _motors(self) -> Iterator[str]:
        types = self.mujoco.mjtTrn
        for number in range(self.model.nu):
            of_joint = int(self.model.actuator_trntype[number]) in (types.mjTRN_JOINT, types.mjTRN_JOINTINPARENT)
            name = self._name("JOINT", int(self.model.actuator_trnid[number, 0])) if of_joint else ""
            if name in self.joints:
                yield name

    def _equalities(self) -> Iterator[ForeignLoop]:
        model, types = self.model, self.mujoco.mjtEq
        for number in range(model.neq):
            name, kind = self._name("EQUALITY", number), int(model.eq_type[number])
            if not model.eq_active0[number]:
                continue
            if kind in (types.mjEQ_CONNECT, types.mjEQ_WELD):
                yield self._loop(number, name, whole=kind == types.mjEQ_WELD)
            elif kind == types.mjEQ_JOINT:
                self._follower(number, name)
            else:
                raise UrdfError(f"{self.path}: equality '{name}' ties neither bodies nor joints; {_NOT_HELD}")

    def _follower(self, number: int, name: str) -> None:
        model = self.model
        follower, led_by = (self._name("JOINT", int(ids[number])) for ids in (model.eq_obj1id, model.eq_obj2id))
        polynomial = model.eq_data[number]
        if not {follower, led_by} <= self.joints.keys() or np.any(polynomial[2:5]):
            raise UrdfError(f"{self.path}: equality '{name}' is not linear, or not between two joints; {_NOT_HELD}")
        factor = float(polynomial[1])
        offset = self.home[follower] + float(polynomial[0]) - factor * self.home[led_by]
        SubElement(self.joints[follower], "mimic", joint=led_by, multiplier=repr(factor), offset=repr(offset))

    def _loop(self, number: int, name: str, *, whole: bool) -> ForeignLoop:
        bodies, places = self._bodies_of_tie(number)
        axes: tuple[str, ...] = ("x", "y", "z", "rx", "ry", "rz")
        if not whole:
            turn, count = self._loop_axes(bodies, [place.translation for place in places])
            axes = axes[:count]
            places = [pin.SE3(turn, place.translation) for place in places]  # the second's rotation is irrelevant
        links = self._new(f"{name}_a"), self._new(f"{name}_b")
        return self.urdf.cut_loop([self.link_of[body] for body in bodies], links, places, axes=axes)

    def _bodies_of_tie(self, number: int) -> tuple[list[int], list[pin.SE3]]:
        """The two bodies of a tie, and its place in each."""
        model = self.model
        ids = [int(model.eq_obj1id[number]), int(model.eq_obj2id[number])]
        data, straight = np.array(model.eq_data[number]), np.array([1.0, 0.0, 0.0, 0.0])
        if model.eq_objtype[number] == self.mujoco.mjtObj.mjOBJ_SITE:
            return [int(model.site_bodyid[k]) for k in ids], [_se3(model.site_pos[k], model.site_quat[k]) for k in ids]
        if model.eq_type[number] == self.mujoco.mjtEq.mjEQ_WELD:
            return ids, [_se3(data[3:6], data[6:10]), _se3(data[0:3], straight)]
        return ids, [_se3(data[0:3], straight), _se3(data[3:6], straight)]

    def _loop_axes(self, bodies: list[int], points: list[FloatArray]) -> tuple[FloatArray, int]:
        """Axes of a loop in its first body, (3, 3); first those along which joints move it, and their number."""
        mujoco, model = self.mujoco, self.model
        data, random = mujoco.MjData(model), np.random.default_rng(0)
        columns = []
        for _ in range(_DRAWN):
            data.qpos[:] = model.qpos0
            mujoco.mj_integratePos(model, data.qpos, _SPREAD * random.standard_normal(model.nv), 1.0)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            turn = data.xmat[bodies[0]].reshape(3, 3)
            jacobians = []
            for body, point in zip(bodies, points, strict=True):
                jacobian = np.zeros((3, model.nv))
                where = data.xpos[body] + data.xmat[body].reshape(3, 3) @ point
                mujoco.mj_jac(model, data, jacobian, None, where, body)
                jacobians.append(jacobian)
            columns.append(turn.T @ (jacobians[0] - jacobians[1]))
        directions, values, _ = linalg.svd(np.hstack(columns), full_matrices=False)
        count = int(np.sum(values > _MOVES * max(values[0], 1e-12)))
        if count == 3:
            return np.eye(3), 3
        axis = directions[:, 2] if count == 2 else directions[:, 0]
        second, third = perpendicular_axes(axis)
        return np.column_stack([second, third, axis] if count == 2 else [axis, second, third]), max(count, 1)


def _se3(xyz: FloatArray, quaternion: FloatArray) -> pin.SE3:
    """A placement from MuJoCo's numbers: w, x, y, z."""
    w, x, y, z = map(float, quaternion)
    turned = pin.Quaternion(w, x, y, z)
    turned.normalize()
    return pin.SE3(turned.matrix(), np.array(xyz, dtype=float))


def _text(names: bytes) -> str:
    return bytes(itertools.takewhile(bool, names)).decode(errors="replace")
