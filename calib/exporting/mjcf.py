"""MuJoCo's format (MJCF), in a form that MuJoCo, Pinocchio and Drake read with the same meaning.

Bodies stand at the assembled home and each joint's `ref` is its value there. So the loops are closed in the reference
configuration, from which a program takes the second anchor of a `<connect>` (or the pose of a `<weld>`). Joint values
mean the same as in the URDF. Numbers are the shortest decimals that read back to the same float; MuJoCo's own writer
would keep six digits.

Every link is a body, even a fixed link; a root link named `world` becomes the body `world_link`, because MuJoCo
reserves the name. Targets and the measurement frame are bodies with only a site, because not every program reads sites;
the site of `target_tip` is `target_tip_site`. Motors are position servos whose stiffness comes from the inertia at
home. Ties in a simulator are slightly soft: its poses are not exact.

A lamp and a floor without contacts make the robot visible; the keyframe `home` puts joints and servos at home.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from calib.core.base.errors import InputError
from calib.core.results.urdf import comment, provenance_lines
from calib.core.robots.mechanism import rigid
from calib.core.robots.urdf.reader import HELD_TYPES, UrdfJoint
from calib.core.robots.urdf.writing import number_attribute
from calib.exporting.closed_model import ClosedModel, joint_motion, possible_inertia, servo_gains, tie_lines
from calib.exporting.mjcf_shapes import MjcfShapes, add_surroundings, pose_attributes
from calib.shared.links import Inertial, Link, read_links

TIE_SOFTNESS = {"solref": "-1000000 -1000", "solimp": "0.999 0.999 0.001 0.5 2"}
"""MuJoCo's softness of the ties: stiffness [1/s^2] and damping [1/s] per effective mass, and impedance (1 is rigid)."""
WORLD = "world_link"
"""Name of the body for a root link called `world`, a name that MuJoCo reserves."""
_LEAST_MASS, _LEAST_INERTIA = 1e-6, 1e-9
"""Mass and inertia for a moving link without mass [kg], [kg m^2]: MuJoCo refuses massless moving bodies."""
_NO_MASS, _NO_INERTIA = 1e-9, 1e-12
"""Mass and inertia of a massless link with shapes [kg], [kg m^2]: old MuJoCo (< 3.4) computes mass from shapes."""
_TYPES = {"prismatic": "slide", "revolute": "hinge", "continuous": "hinge"}


class Mjcf:
    """An MJCF file.

    Args:
        model: The robot.
        path: The file; mesh files are named relative to its folder.
        provenance: Lines of its comment.

    Attributes:
        content: Its bytes.
        meshes: Contents of the mesh files that had to be converted for it.
        notes: Remarks on shapes that cannot be drawn.

    Raises:
        InputError: A link other than the root is named `world`, which MuJoCo reserves.
    """

    def __init__(self, model: ClosedModel, path: Path | str = "robot.xml", provenance: Sequence[str] = ()) -> None:
        self.model = model
        self.links = read_links(model.urdf)
        self.remarks: list[str] = []
        self.shapes = MjcfShapes(model.robot.urdf.path, Path(path))
        self.children: dict[str, list[UrdfJoint]] = {link: [] for link in model.urdf.links}
        for joint in model.urdf.joints:
            self.children[joint.parent].append(joint)
        self.content = self._write(provenance)
        self.meshes, self.notes = self.shapes.converted, tuple(dict.fromkeys(self.shapes.remarks))

    def _write(self, provenance: Sequence[str]) -> bytes:
        root = Element("mujoco", model=self.model.urdf.name or "robot")
        SubElement(root, "compiler", angle="radian", autolimits="true")
        SubElement(root, "option", timestep="0.001", integrator="implicitfast")
        self._world(SubElement(root, "worldbody"))
        if len(self.shapes.asset) > 0:
            root.append(self.shapes.asset)
        self._contact(root)
        self._equality(root)
        self._actuators(root)
        self._keyframe(root)
        ElementTree.indent(root)
        lines = [*provenance, *provenance_lines(self.model.robot), *tie_lines(self.model)]
        lines += dict.fromkeys(self.remarks + self.shapes.remarks)
        header = comment(["calib: a closed robot for MuJoCo, Pinocchio and Drake", *lines])
        body = ElementTree.tostring(root, encoding="utf-8")
        return b'<?xml version="1.0" encoding="utf-8"?>\n' + header.encode() + b"\n" + body + b"\n"

    def _world(self, world: Element) -> None:
        urdf = self.model.urdf
        if "world" in urdf.links and urdf.root != "world":
            raise InputError(
                f"{urdf.path}: link 'world' is not the root link; MuJoCo keeps this name for its world: rename the link"
            )
        robot = self.model.robot
        T_root_base = np.linalg.inv(robot.forward(robot.home, urdf.root))
        links = np.array([T_root_base @ robot.forward(robot.home, link) for link in robot.urdf.links])
        add_surroundings(world, links[:, :3, 3])
        # Pinocchio ignores the placement of a body that is fixed to the worldbody itself; this body has none
        self._content(SubElement(world, "body", name=self._body_name(urdf.root)), urdf.root, moving=False)

    def _content(self, element: Element, name: str, moving: bool) -> None:
        """Fill a body with its mass, shapes, markers and children."""
        link = self.links[name]
        self._inertial(element, name, link, moving)
        self.shapes.add(element, link, [np.asarray(joint.xyz, dtype=float) for joint in self.children[name]])
        for marker in self.model.markers:
            if marker.link == name:
                body = SubElement(element, "body", {"name": marker.name, **pose_attributes(marker.placement)})
                SubElement(body, "site", name=f"{marker.name}_site", size="0.005")
        for joint in self.children[name]:
            self._body(element, joint)

    def _body(self, parent: Element, joint: UrdfJoint) -> None:
        moving = joint.type not in HELD_TYPES
        value = self.model.home[joint.name] if moving else 0.0
        placement = rigid(joint.xyz, joint.rpy) * joint_motion(joint.type, joint.axis, value)
        body = SubElement(parent, "body", {"name": joint.child, **pose_attributes(placement)})
        if moving:
            attributes = {
                "name": joint.name,
                "type": _TYPES[joint.type],
                "axis": number_attribute(joint.axis),
                "ref": number_attribute([value]),
            }
            if math.isfinite(joint.lower) and joint.lower < joint.upper:
                attributes |= {"limited": "true", "range": number_attribute([joint.lower, joint.upper])}
            SubElement(body, "joint", attributes)
        self._content(body, joint.child, moving)

    def _inertial(self, element: Element, name: str, link: Link, moving: bool) -> None:
        inertial = link.inertial
        if inertial is None or inertial.mass <= 0:
            carried = (self.links[link].inertial for link in self._fixed_links(name) - {name}) if moving else ()
            if moving and sum(fixed.mass for fixed in carried if fixed) <= 0:
                inertial = Inertial(_LEAST_MASS, np.zeros(3), _LEAST_INERTIA * np.eye(3))
                self.remarks.append(f"link {name} moves and has no mass: {_LEAST_MASS:g} kg added for the simulator")
            elif link.visuals or link.collisions:
                inertial = Inertial(_NO_MASS, np.zeros(3), _NO_INERTIA * np.eye(3))
            else:
                return
        possible = possible_inertia(inertial.inertia)
        if not np.array_equal(possible, inertial.inertia):
            self.remarks.append(
                f"link {name}: its moments of inertia are impossible; the nearest possible ones are taken"
            )
        xx, yy, zz = np.diag(possible)
        full = number_attribute([xx, yy, zz, possible[0, 1], possible[0, 2], possible[1, 2]])
        place, mass = number_attribute(inertial.centre), number_attribute([inertial.mass])
        SubElement(element, "inertial", pos=place, mass=mass, fullinertia=full)

    def _contact(self, root: Element) -> None:
        """Exclude contacts between links that a tie connects."""
        touching = {name for name, link in self.links.items() if link.collisions}
        if not touching or not self.model.ties:
            return
        contact = SubElement(root, "contact")
        pairs = {
            tuple(sorted((link, other)))
            for tie in self.model.ties
            for link in self._fixed_links(tie.a) & touching
            for other in self._fixed_links(tie.b) & touching
            if link != other
        }
        for link, other in sorted(pairs):
            SubElement(contact, "exclude", body1=self._body_name(link), body2=self._body_name(other))

    def _carrier(self, name: str) -> tuple[str, pin.SE3]:
        """The moving body that carries a link, and the link's pose in it (Pinocchio ties fixed bodies wrongly)."""
        placement = pin.SE3.Identity()
        while name != self.model.urdf.root:
            joint = next(joint for joint in self.model.urdf.joints if joint.child == name)
            if joint.type not in HELD_TYPES:
                return name, placement
            placement = rigid(joint.xyz, joint.rpy) * placement
            name = joint.parent
        return self._body_name(name), placement

    def _body_name(self, link: str) -> str:
        return WORLD if link == "world" else link

    def _fixed_links(self, name: str) -> set[str]:
        """Links fixed to a link, including itself."""
        carrier = self._carrier(name)[0]
        return {link for link in self.links if self._carrier(link)[0] == carrier}

    def _equality(self, root: Element) -> None:
        moving = (joint for joint in self.model.urdf.joints if joint.type not in HELD_TYPES)
        followers = [joint for joint in moving if joint.mimic and joint.name not in self.model.robot.joint_names]
        if not self.model.ties and not followers:
            return
        equality = SubElement(root, "equality")
        for tie in self.model.ties:
            (body, anchor), (other, _) = self._carrier(tie.a), self._carrier(tie.b)
            attributes = {"name": tie.name, "body1": body, "body2": other, **TIE_SOFTNESS}
            if tie.full_pose:
                SubElement(equality, "weld", attributes)
            else:
                SubElement(equality, "connect", attributes, anchor=number_attribute(anchor.translation))
        for joint in followers:
            assert joint.mimic is not None
            leader, factor, _ = joint.mimic  # no offset: MuJoCo counts both from their `ref`
            attributes = {"name": f"{joint.name}_mimics_{leader}", "joint1": joint.name, "joint2": leader}
            SubElement(equality, "joint", attributes, polycoef=number_attribute([0.0, factor, 0.0, 0.0, 0.0]))

    def _actuators(self, root: Element) -> None:
        actuator = SubElement(root, "actuator")
        for name, inertia in zip(self.model.robot.joint_names, self.model.inertia, strict=True):
            stiffness, damping = servo_gains(inertia)
            SubElement(actuator, "position", name=name, joint=name, kp=repr(stiffness), kv=repr(damping))

    def _keyframe(self, root: Element) -> None:
        """Add the keyframe home, with the servos there; joints in MuJoCo's order."""
        joints = [element.attrib for element in root.iter("joint") if "type" in element.attrib]
        positions = number_attribute(self.model.home[joint["name"]] for joint in joints)
        controls = number_attribute(self.model.home[name] for name in self.model.robot.joint_names)
        SubElement(SubElement(root, "keyframe"), "key", name="home", qpos=positions, ctrl=controls)
