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


def test_fingers_without_telling_names_are_left_out():
    chain = chosen(*ARM, beyond("x", "prismatic", "l3", "p", 0.1), beyond("y", "prismatic", "l3", "q", 0.1))
    assert (chain.target, chain.joints) == ("l3", ("j1", "j2", "j3"))
    assert (chain.fingers, chain.branches, chain.others) == (("x", "y"), (), ("p", "q"))


def test_fingers_with_several_joints_each_are_left_out():
    fingers = [
        beyond(f"{k}{n}", "revolute", "l3" if n == 0 else f"{k}{n - 1}_link", f"{k}{n}_link", 0.05)
        for k in "abc"
        for n in range(3)
    ]
    chain = chosen(*ARM, *fingers)
    assert (chain.target, len(chain.fingers)) == ("l3", 9)
    assert chain.others == ("a2_link", "b2_link", "c2_link")


def test_a_frame_beyond_the_palm_is_the_end():
    palm = (("f", "fixed", "l3", "palm"), ("t", "fixed", "palm", "tcp"), ("c", "fixed", "l3", "camera"))
    chain = chosen(*ARM, *palm, beyond("x", "prismatic", "palm", "p", 0.1), beyond("y", "prismatic", "palm", "q", 0.1))
    assert chain.target == "tcp"


def test_two_arms_on_a_torso_are_no_fingers():
    arms = [
        beyond(f"{side}{n}", "revolute", "torso" if n == 0 else f"{side}{n - 1}_l", f"{side}{n}_l", 0.3)
        for side in ("left", "right")
        for n in range(3)
    ]
    chain = chosen(
        beyond("lift", "prismatic", "base", "torso", 0.8), *arms, beyond("neck", "revolute", "torso", "h", 0.3)
    )
    assert (chain.target, chain.joints) == ("left2_l", ("lift", "left0", "left1", "left2"))
    assert chain.fingers == ()
    assert chain.branches == ("right0", "right1", "right2", "neck")
    assert chain.others == ("right2_l", "h")


def test_a_linkage_beside_a_long_arm_does_not_make_the_arm_a_finger():
    link = beyond("parallel", "revolute", "l1", "rod", 0.4, '<mimic joint="j2"/>')
    assert chosen(*ARM, link).joints == ("j1", "j2", "j3")


def test_a_wrist_beside_a_camera_that_turns_is_no_finger():
    wrist = (beyond("j4", "revolute", "l3", "l4", 0.05), beyond("j5", "revolute", "l4", "l5", 0.2))
    chain = chosen(*ARM, *wrist, beyond("pan", "revolute", "l3", "camera", 0.03))
    assert chain.joints == ("j1", "j2", "j3", "j4", "j5")


def test_a_single_jaw_is_known_by_joint_and_link_together():
    assert chosen(*ARM, beyond("gripper", "revolute", "l3", "jaw", 0.05)).fingers == ("gripper",)
    assert chosen(*ARM, beyond("gripper_yaw", "revolute", "l3", "wrist", 0.05)).joints[-1] == "gripper_yaw"
    turning = (beyond("gripper_yaw", "revolute", "l3", "gripper", 0.05), ("f", "fixed", "gripper", "tool"))
    assert chosen(*ARM, *turning).joints[-1] == "gripper_yaw"  # it carries something


def test_a_robot_that_is_a_finger_keeps_all_its_joints():
    joints = [(f"finger_joint_{k}", "revolute", f"finger_{k}", f"finger_{k + 1}") for k in range(3)]
    assert len(chosen(*joints).joints) == 3


def test_stiff_fingers_are_not_the_end():
    fixed = ("g", "fixed", "l3", "inner", '<mimic joint="j3"/>')
    chain = chosen(*ARM, ("t", "fixed", "l3", "tool"), ("k", "fixed", "l3", "finger_tip"), fixed)
    assert chain.target == "tool"


@pytest.mark.parametrize(
    ("name", "base", "target", "fingers"),
    [
        ("mukca/urdf/panda.urdf", "panda_link0", "ball_link", ("panda_finger_joint1", "panda_finger_joint2")),
        ("mukca/urdf/iiwa14.urdf", "base_link", "ball_link", ()),
        ("motoman_right/robot.urdf", "l0", "flange", ()),
    ],
)
def test_arms_that_others_measured(shared_data, name, base, target, fingers):
    chain = arm_chain(parse_urdf((shared_data / name).read_bytes()))
    assert (chain.base, chain.target, len(chain.joints), chain.fingers) == (base, target, 7, fingers)


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
