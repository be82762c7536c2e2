"""Which chain of a URDF is the arm: structure first, names where structure says nothing."""

import pytest

from calib.core.base.errors import DescriptionError
from calib.core.robots.urdf.arm_chain import arm_chain
from calib.core.robots.urdf.text import parse_urdf
from tests.urdf_trees import urdf_of

ARM = (
    ("j1", "revolute", "base", "l1"),
    ("j2", "revolute", "l1", "l2", '<origin xyz="0 0 0.5"/>'),
    ("j3", "revolute", "l2", "l3", '<origin xyz="0.4 0 0"/>'),
)


def chosen(*joints):
    return arm_chain(parse_urdf(urdf_of(*joints).encode()))


def beyond(name, kind, parent, child, length, *extra):
    return (name, kind, parent, child, f'<origin xyz="0 0 {length}"/>', *extra)


def rows_of(sides, parent, length):
    """Three turning joints in a row on each side."""
    return [
        beyond(f"{side}{n}", "revolute", parent if n == 0 else f"{side}{n - 1}_l", f"{side}{n}_l", length)
        for side in sides
        for n in range(3)
    ]


def pair(parent):
    return [beyond(name, "prismatic", parent, end, 0.1) for name, end in ("xp", "yq")]


PALM = (("f", "fixed", "l3", "palm"), ("t", "fixed", "palm", "tcp"), ("c", "fixed", "l3", "camera"))
WRIST = (beyond("j4", "revolute", "l3", "l4", 0.05), beyond("j5", "revolute", "l4", "l5", 0.2))
TORSO = (beyond("lift", "prismatic", "base", "torso", 0.8), *rows_of(("left", "right"), "torso", 0.3))
YAW = beyond("gripper_yaw", "revolute", "l3", "wrist", 0.05)
OF_ARM, NINE = ("j1", "j2", "j3"), tuple(f"{side}{n}" for side in "abc" for n in range(3))
CHAINS = {
    "fingers without telling names are left out": (
        (*ARM, *pair("l3")),
        {"target": "l3", "joints": OF_ARM, "fingers": ("x", "y"), "branches": (), "others": ("p", "q")},
    ),
    "fingers with several joints each are left out": (
        (*ARM, *rows_of("abc", "l3", 0.05)),
        {"target": "l3", "joints": OF_ARM, "fingers": NINE, "others": ("a2_l", "b2_l", "c2_l")},
    ),
    "a frame beyond the palm is the end": ((*ARM, *PALM, *pair("palm")), {"target": "tcp"}),
    "two arms on a torso are no fingers": (
        (*TORSO, beyond("neck", "revolute", "torso", "h", 0.3)),
        {
            "target": "left2_l",
            "joints": ("lift", "left0", "left1", "left2"),
            "fingers": (),
            "branches": ("right0", "right1", "right2", "neck"),
            "others": ("right2_l", "h"),
        },
    ),
    "a linkage beside a long arm does not make the arm a finger": (
        (*ARM, beyond("parallel", "revolute", "l1", "rod", 0.4, '<mimic joint="j2"/>')),
        {"joints": OF_ARM},
    ),
    "a wrist beside a camera that turns is no finger": (
        (*ARM, *WRIST, beyond("pan", "revolute", "l3", "camera", 0.03)),
        {"joints": (*OF_ARM, "j4", "j5")},
    ),
    "a single jaw is known by joint and link": (
        (*ARM, beyond("gripper", "revolute", "l3", "jaw", 0.05)),
        {"fingers": ("gripper",)},
    ),
    "and not by its joint alone": ((*ARM, YAW), {"joints": (*OF_ARM, "gripper_yaw")}),
    "nor where it carries something": (
        (*ARM, beyond("gripper_yaw", "revolute", "l3", "gripper", 0.05), ("f", "fixed", "gripper", "tool")),
        {"joints": (*OF_ARM, "gripper_yaw")},
    ),
    "a robot that is a finger keeps all its joints": (
        [(f"finger_joint_{k}", "revolute", f"finger_{k}", f"finger_{k + 1}") for k in range(3)],
        {"joints": tuple(f"finger_joint_{k}" for k in range(3))},
    ),
    "stiff fingers are not the end": (
        (*ARM, ("t", "fixed", "l3", "tool"), ("k", "fixed", "l3", "finger_tip"),
         ("g", "fixed", "l3", "inner", '<mimic joint="j3"/>')),
        {"target": "tool"},
    ),
}  # fmt: skip


@pytest.mark.parametrize(("joints", "expected"), CHAINS.values(), ids=CHAINS)
def test_which_joints_are_the_arm(joints, expected):
    chain = chosen(*joints)
    assert {name: getattr(chain, name) for name in expected} == expected


def without_limits(names, *joints):
    """The chain of a robot, of which these joints have a limit without lower and upper."""
    text = urdf_of(*joints)
    for name in names:
        before, joint, after = text.partition(f'<joint name="{name}"')
        text = before + joint + after.replace('<limit lower="-9" upper="9" ', "<limit ", 1)
    return arm_chain(parse_urdf(text.encode()))


def test_joints_whose_limits_nobody_states_are_no_motors_and_are_named():
    chain = without_limits("fg", *ARM, ("f", "revolute", "l3", "jaw"), ("g", "prismatic", "l3", "pad"))
    assert (chain.target, chain.joints, chain.still) == ("pad", ("j1", "j2", "j3"), ("g",))
    assert "left out: g (no motor: a <limit> without lower and upper is 0 to 0; write its limits" in chain.remark
    with pytest.raises(DescriptionError, match=r"j1, j2, j3 have a <limit> without lower and upper"):
        without_limits(("j1", "j2", "j3"), *ARM)


def test_the_end_that_was_chosen_is_always_said():
    assert chosen(*ARM).remark == "the arm is taken to end at l3; another end, such as l2, l1: calib init --target NAME"
    flange = chosen(*ARM, ("f", "fixed", "l3", "flange"), ("t", "fixed", "flange", "tool0"))
    assert flange.remark.startswith("the arm is taken to end at tool0; another end, such as flange, l3")
    assert arm_chain(parse_urdf(urdf_of(*ARM).encode()), "l3").remark == ""
