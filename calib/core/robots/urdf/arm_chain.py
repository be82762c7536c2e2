"""The arm's chain in a URDF, if the link with the measured point is not named.

The arm is the chain with the most motors, without the fingers of a gripper; if chains are equally long, the first in
the file. Fingers are first recognised by structure: two or more joints on one link whose longest two have about the
same reach, all shorter than a third of the way from the arm's first joint to that link. (In the robots of Pinocchio's
example-robot-data, hands reach up to a quarter of that way, the arms of a torso more than twice as far.) A gripper with
one moving joint looks like a last axis; there names decide: the last joint and its link are both called finger, gripper
or the like, and the joint before is not.

When it fails. A tool changer with two short tools that have motors looks like a gripper. If legs and an arm have
equally many joints, the first in the file is taken. Omitted joints are always reported, and `calib init --target`
overrules.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass, replace

from calib.core.base.errors import DescriptionError, require_known
from calib.core.base.words import listing
from calib.core.robots.urdf.reader import HELD_TYPES, UrdfJoint
from calib.core.robots.urdf.text import UrdfText, require_supported

_SHORT = 1 / 3  # fingers reach less than this part of the way from the arm's first joint to them
_ALIKE = 0.5  # the second longest finger reaches at least this part of the longest
_FINGER = re.compile("finger|thumb|jaw|claw", re.IGNORECASE)
_GRIPPER = re.compile(f"gripper|{_FINGER.pattern}", re.IGNORECASE)
_SHOWN = 8


@dataclass(frozen=True)
class ArmChain:
    """A chain of joints from the base to a link.

    Attributes:
        target: Link at its end.
        base: Link that carries its first moving joint.
        joints: Its moving joints, without mimic joints.
        fingers: Moving joints at its end that were taken for a gripper's.
        branches: The robot's other moving joints, if the program chose the chain.
        still: Joints of the chain without stated limits, taken as fixed.
        others: If the program chose the chain, other possible end links, likely ones first.
    """

    target: str
    base: str
    joints: tuple[str, ...]
    fingers: tuple[str, ...] = ()
    branches: tuple[str, ...] = ()
    still: tuple[str, ...] = ()
    others: tuple[str, ...] = ()

    @property
    def remark(self) -> str:
        """A sentence on the chosen tool link, omitted joints, and how to choose another; empty without a choice."""
        reasons = (
            (self.fingers, "taken for a gripper"),
            (self.branches, "not on the way to it"),
            (self.still, "no motor: a <limit> without lower and upper is 0 to 0; write its limits into the URDF"),
        )
        parts = [f"{listing(names, shown=_SHOWN)} ({why})" for names, why in reasons if names]
        left = f"left out: {'; '.join(parts)}" if parts else ""
        if not self.others:
            return left
        end = f"another end, such as {listing(self.others)}: calib init --target NAME"
        return "; ".join(filter(None, (f"the arm is taken to end at {self.target}", left, end)))


def arm_chain(urdf: UrdfText, target: str | None = None) -> ArmChain:
    """Return the chain to a link, `target`, by default to the end of the arm.

    `DescriptionError` if there is no such link, or no joint moves it, or a joint of an unsupported type does.
    """
    tree = _Tree(urdf)
    if target is not None:
        require_known(target, urdf.links, f"{urdf.path}: no link", DescriptionError)
        return tree.chain(target)
    return tree.arm()


class _Tree:
    """The joints on the way to each link, and the links that move together.

    Attributes:
        way: Joints from the root to each link.
        body: For each link, the name of the moving joint that carries it; empty for the root's body.
        carried: Link that each joint carries.
        distance: Length of the way to each link [m].
        furthest: Length of the longest way over each link [m].
    """

    def __init__(self, urdf: UrdfText) -> None:
        self.urdf = urdf
        self.way: dict[str, list[UrdfJoint]] = {urdf.root: []}
        self.distance = {urdf.root: 0.0}
        for joint in urdf.joints_from_root:
            self.way[joint.child] = [*self.way[joint.parent], joint]
            self.distance[joint.child] = self.distance[joint.parent] + math.hypot(*joint.xyz)
        self.furthest = dict(self.distance)
        for joint in reversed(urdf.joints_from_root):
            self.furthest[joint.parent] = max(self.furthest[joint.parent], self.furthest[joint.child])
        self.body = {link: ([""] + [joint.name for joint in _moving(self.way[link])])[-1] for link in urdf.links}
        self.carried = {joint.name: joint.child for joint in urdf.joints}

    def chain(self, target: str) -> ArmChain:
        """The chain to a link."""
        way = self.way[target]
        names, moving = _motors(way), _moving(way)
        require_supported(way[way.index(moving[0]) :] if moving else way, self.urdf.path)
        still = tuple(joint.name for joint in way if joint.unstated and not joint.moves)
        if not names:
            unstated = "a <limit> without lower and upper, which is 0 to 0; write the limits into the URDF"
            advice = f'{listing(still)} have {unstated}, or type="continuous"'
            why = advice if still else "there is nothing to calibrate"
            raise DescriptionError(f"{self.urdf.path}: no joint moves link '{target}'; {why}")
        return ArmChain(target, moving[0].parent, names, still=still)

    def arm(self) -> ArmChain:
        """The chain to the end of the arm, and the omitted joints."""
        cut = self._hands() | self._single_jaws()
        bodies = [
            body
            for body in dict.fromkeys(self.body.values())
            if all(joint.name in cut for joint in self._joints_on(body)) and not cut & self._joints_before(body)
        ]
        ends = sorted((self._end(body) for body in bodies), key=lambda link: -len(_motors(self.way[link])))
        chain = self.chain(ends[0])
        kept = {joint.name for joint in self.way[chain.target]}
        left = [joint for joint in _moving(self.urdf.joints) if joint.name not in kept]
        fingers = [joint for joint in left if self.body[chain.target] in self._joints_before(self.body[joint.parent])]
        tips = [joint.child for joint in fingers if not self._joints_on(joint.name)]
        others = [*(link for link in ends[1:] if _motors(self.way[link])), *tips]
        if not others:  # links of the end's own body, and those before it
            others = [link for link in reversed(self.urdf.links) if self.body[link] == self.body[chain.target]]
            others += [joint.child for joint in reversed(self.way[chain.target]) if _motors(self.way[joint.child])]
        return replace(
            chain,
            fingers=tuple(joint.name for joint in fingers),
            branches=tuple(joint.name for joint in left if all(joint is not finger for finger in fingers)),
            others=tuple(link for link in dict.fromkeys(others) if link != chain.target),
        )

    def _joints_on(self, body: str) -> list[UrdfJoint]:
        """Moving joints on a body."""
        return [joint for joint in _moving(self.urdf.joints) if self.body[joint.parent] == body]

    def _joints_before(self, body: str) -> set[str]:
        """Moving joints on the way to a body, including its own."""
        return {joint.name for joint in _moving(self.way[self.carried[body]])} if body else set()

    def _hands(self) -> set[str]:
        """First joints of fingers, by structure."""
        fingers: set[str] = set()
        for body in set(self.body.values()) - {""}:
            joints = self._joints_on(body)
            reach = sorted(self._reach(joint) for joint in joints)
            if len(joints) > 1 and _ALIKE * reach[-1] <= reach[-2] and reach[-1] < _SHORT * self._arm_length(joints):
                fingers |= {joint.name for joint in joints}
        return fingers

    def _single_jaws(self) -> set[str]:
        """Last joints without further links that belong to a gripper by their names."""
        parents = {joint.parent for joint in self.urdf.joints}
        chains = [_moving(self.way[link]) for link in self.urdf.links if link not in parents]
        ends = [chain[-2:] for chain in chains if len(chain) > 1 and chain[-1].child not in parents]
        return {last.name for before, last in ends if _is_gripper(last) and not _is_gripper(before)}

    def _end(self, body: str) -> str:
        """The last link in the file at an end of a body, without stiff fingers; beyond the palm if the body has one."""
        ties = {link for loop in self.urdf.foreign.loops for link in loop.links}
        links = [link for link in self.urdf.links if self.body[link] == body and link not in ties]
        plain = [link for link in links if not self._is_stiff_finger(link)] or links
        parents = {joint.parent for joint in self.urdf.joints if joint.child in plain}
        ends = [link for link in plain if link not in parents]
        palms = {joint.parent for joint in self._joints_on(body)}
        beyond = [link for link in ends if palms & {link, *(joint.parent for joint in self.way[link])}]
        return (beyond or ends)[-1]

    def _is_stiff_finger(self, link: str) -> bool:
        """Whether a link is called a finger, or is on a fixed joint with a mimic."""
        return bool(_FINGER.search(link)) or any(j.mimic and j.type in HELD_TYPES for j in self.way[link])

    def _reach(self, joint: UrdfJoint) -> float:
        return self.furthest[joint.child] - self.distance[joint.parent]

    def _arm_length(self, joints: list[UrdfJoint]) -> float:
        """Length of the way from the first moving joint to the nearest of these joints."""
        first = _moving(self.way[joints[0].parent])[0]
        return min(self.distance[joint.parent] for joint in joints) - self.distance[first.child]


def _moving(joints: Iterable[UrdfJoint]) -> list[UrdfJoint]:
    return [joint for joint in joints if joint.moves]


def _motors(way: list[UrdfJoint]) -> tuple[str, ...]:
    return tuple(joint.name for joint in _moving(way) if joint.mimic is None)


def _is_gripper(joint: UrdfJoint) -> bool:
    return bool(_GRIPPER.search(joint.name) and _GRIPPER.search(joint.child))
