"""Rules for a plain URDF: what is actuated, what is free, and what follows, is held or is refused."""

import numpy as np
import pytest

import calib
from calib.core.base.errors import DescriptionError, UrdfError
from tests.small_robots import ARM_YAML, write_arm
from tests.urdf_trees import plain, urdf_of

CHAIN = (("a", "revolute", "w", "1"), ("b", "prismatic", "1", "2"), ("c", "fixed", "2", "3"))


def described(folder, joints, motors, base, end, free=""):
    """A description of a URDF of these joints, in r.yaml."""
    (folder / "plain.urdf").write_text(urdf_of(*joints))
    (folder / "r.yaml").write_text(
        f"urdf: plain.urdf\nname_mot: {motors}\nbase: {base}\ntargets: {{t: {{frame: '{end}'}}}}\n"
        f"parametrisation: [{free}]\n"
    )
    return calib.load(folder / "r.yaml")


def test_every_moving_joint_on_the_way_to_the_last_link_is_actuated(tmp_path):
    robot = plain(tmp_path, *CHAIN, ("d", "continuous", "3", "4"), ("e", "fixed", "4", "5"))
    assert robot.joint_names == ("a", "b", "d")
    assert robot.target_names == ("5",)
    assert robot.mechanism.dimensions == {"a": "angle", "b": "length", "d": "angle"}
    assert robot.description.base.pose == "unknown"
    assert robot.description.targets["5"].position == "unknown"


def test_every_joint_origin_on_the_way_is_free_with_default_priors(tmp_path):
    robot = plain(tmp_path, *CHAIN, ("camera", "fixed", "1", "lens"))
    names = [p.name for p in robot.parameters]
    components = ("x", "y", "z", "rx", "ry", "rz")
    assert sorted(n for n in names if "base" not in n and not n.startswith("3.")) == sorted(
        f"{joint}.{component}" for joint in "abc" for component in components
    )
    origins = [p for p in robot.parameters if not p.placement]
    assert all(p.prior for p in origins)
    assert {p.sigma_si for p in origins if p.dimension == "length"} == {0.002}
    assert {p.sigma_si for p in origins if p.dimension == "angle"} == {0.005}
    places = [p for p in robot.parameters if p.placement]
    assert [p.sigma_si for p in places if p.prior] == [0.5] * 3  # the target's; nothing is known of the base
    assert len(places) == 9


def test_an_arm_whose_tool_never_tilts_is_fitted_as_it_is(tmp_path):
    up = '<axis xyz="0 0 1"/>'
    robot = plain(
        tmp_path,
        ("a", "revolute", "0", "1", '<origin xyz="0 0 0.4"/>', up),
        ("b", "revolute", "1", "2", '<origin xyz="0.3 0 0"/>', up),
        ("c", "prismatic", "2", "3", '<origin xyz="0.25 0 0"/>', up),
        ("d", "revolute", "3", "4", '<origin xyz="0 0 -0.05"/>', up),
    )
    low, high = np.array([[-2, -2, 0, -3], [2, 2, 0.2, 3]])
    q = np.random.default_rng(0).uniform(low, high, (40, 4))
    fit = calib.fit(robot, calib.simulate(robot, q, 5e-5, 1))  # sigma separates the heights of base and tool
    assert fit.verdict.grade == "PASS"
    assert fit.rms < 1e-4


ARMS = (("left", "revolute", "3", "hand_1"), ("right", "revolute", "3", "hand_2"))


@pytest.mark.parametrize(
    ("chain", "joints", "target"),
    [
        ((("camera", "fixed", "1", "lens"), *CHAIN, ("light", "fixed", "w", "lamp")), ("a", "b"), "3"),
        ((*CHAIN, ("flange", "fixed", "2", "tool0")), ("a", "b"), "tool0"),
        ((*CHAIN, *ARMS), ("a", "b", "left"), "hand_1"),
        ((*CHAIN, *ARMS, ("wrist", "revolute", "hand_2", "end")), ("a", "b", "right", "wrist"), "end"),
    ],
    ids=["no branch that is fixed", "the last of ends behind the same joints", "the first of equal", "the longest"],
)
def test_which_chain_of_several_is_the_robot(tmp_path, chain, joints, target):
    robot = plain(tmp_path, *chain)
    assert (robot.joint_names, robot.target_names) == (joints, (target,))


def test_the_base_is_the_link_that_the_first_moving_joint_stands_on(tmp_path):
    robot = plain(tmp_path, ("world_joint", "fixed", "world", "plate"), ("bolt", "fixed", "plate", "w"), *CHAIN)
    assert robot.description.base.frame == "w"
    assert not any(p.name.startswith(("world_joint", "bolt")) for p in robot.parameters)


def test_a_fixed_root_joint_that_a_description_frees_is_free_and_checked_as_redundant(tmp_path, run_calib):
    robot = described(tmp_path, [("world_joint", "fixed", "world", "w"), *CHAIN],
                      "[a, b]", "{frame: world, pose: unknown}", "3",
                      "{origin: world_joint, components: [x, y, z], sigma: 1 mm}")  # fmt: skip
    assert robot.parameters[0].name == "world_joint.x"
    run = run_calib("check", "r.yaml", cwd=tmp_path)
    assert run.code == 0
    assert "base.x from world_joint.x" in run.out


def test_a_robot_that_does_not_move_is_an_error(tmp_path):
    with pytest.raises(DescriptionError, match="no joint moves link '2'; there is nothing to calibrate"):
        plain(tmp_path, ("a", "fixed", "w", "1"), ("b", "fixed", "1", "2"))
    with pytest.raises(DescriptionError, match="no joint moves link 'alone'"):
        plain(tmp_path, links=("alone",))


def test_floating_and_planar_joints_below_the_robots_base_are_held(tmp_path):
    end = ("t", "fixed", "2", "3", '<origin xyz="1 0 0"/>')
    robot = plain(tmp_path, ("f", "floating", "w", "0"), ("p", "planar", "0", "1", '<origin xyz="0 0 2"/>'),
                  ("a", "continuous", "1", "2", '<axis xyz="0 0 1"/>'), end)  # fmt: skip
    assert robot.joint_names == ("a",)
    assert robot.description.base.frame == "1"
    T_1_3, T_1_w = robot.forward([np.pi / 2], "3"), robot.forward([np.pi / 2], "w")
    assert np.abs(T_1_3[:3, 3] - [0, 1, 0]).max() < 1e-15
    assert np.abs(T_1_w[:3, 3] - [0, 0, -2]).max() < 1e-15


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_floating_and_planar_joints_that_carry_what_is_measured_are_refused_by_name(tmp_path, run_calib, kind):
    axis = '<axis xyz="0 0 1"/>'
    said = f"joint 'p' is {kind}; planar and floating joints are not supported: make it of"
    behind = [("a", "continuous", "w", "1", axis), ("p", kind, "1", "2"), ("t", "continuous", "2", "3", axis)]
    with pytest.raises(DescriptionError, match=said):
        plain(tmp_path, *behind)
    with pytest.raises(DescriptionError, match=said):
        plain(tmp_path, ("p", kind, "w", "1"))
    for motors, end in (("[a, t]", "3"), ("[p]", "1")):
        with pytest.raises(DescriptionError, match=said):
            described(tmp_path, behind, motors, "{frame: w, pose: known}", end)
    run = run_calib("init", "plain.urdf", "--target", "3", "--out", "new.yaml", cwd=tmp_path)
    assert said in run.refusal()
    assert not (tmp_path / "new.yaml").exists()


def test_a_mimic_joint_follows_and_is_not_actuated(tmp_path):
    axis, origin = '<axis xyz="0 0 1"/>', '<origin xyz="1 0 0"/>'
    follows = '<mimic joint="a" multiplier="-2" offset="0.5"/>'
    robot = plain(tmp_path, ("a", "continuous", "w", "1", axis),
                  ("b", "continuous", "1", "2", axis, origin, follows), ("t", "fixed", "2", "3", origin))  # fmt: skip
    assert robot.joint_names == ("a",)
    a = 0.3
    b = -2 * a + 0.5
    expected = [np.cos(a) + np.cos(a + b), np.sin(a) + np.sin(a + b), 0]
    assert np.abs(robot.forward([a])[:3, 3] - expected).max() < 1e-15


def test_a_mimic_of_a_mimic_multiplies_through_and_a_ring_is_an_error(tmp_path):
    slide = '<axis xyz="1 0 0"/>'
    chain = [("a", "prismatic", "w", "1", slide),
             ("b", "prismatic", "1", "2", slide, '<mimic joint="a" multiplier="2" offset="1"/>'),
             ("c", "prismatic", "2", "3", slide, '<mimic joint="b" multiplier="-3" offset="10"/>')]  # fmt: skip
    x = plain(tmp_path, *chain).forward([0.5])[0, 3]
    assert x == pytest.approx(0.5 + (2 * 0.5 + 1) + (-3 * 2 + 10), abs=1e-15)
    chain[1] = ("b", "prismatic", "1", "2", slide, '<mimic joint="c" multiplier="2"/>')
    with pytest.raises(UrdfError, match="joint 'b': mimics itself through b, c"):
        plain(tmp_path, *chain)


def test_a_whole_turn_is_the_same_pose_unless_a_joint_follows_in_another_proportion(tmp_path):
    chain = [("motor", "continuous", "w", "1", '<axis xyz="0 0 1"/>')]
    for proportion, kind, same in ((2, "continuous", True), (0.5, "continuous", False), (1, "prismatic", False)):
        follower = ("follower", kind, "1", "2", f'<axis xyz="0 1 0"/><mimic joint="motor" multiplier="{proportion}"/>')
        robot = plain(tmp_path, *chain, follower, ("end", "fixed", "2", "3", '<origin xyz="1 0 0"/>'))
        here, later = robot.forward(np.array([[0.3], [0.3 + 2 * np.pi]]), "3")
        assert np.allclose(here, later) == same == robot.mechanism.actuated_repeats[0]


def test_a_mimic_joint_that_is_named_as_motor_is_its_own(tmp_path):
    joints = ("a", "prismatic", "w", "1"), ("b", "prismatic", "1", "2", '<mimic joint="a" multiplier="2"/>')
    robot = described(tmp_path, joints, "[b, a]", "{frame: w}", "2", "{origin: all, components: [x], sigma: 1 mm}")
    assert robot.joint_names == ("b", "a")  # in the description's order, not the tree's
    assert robot.forward([0.25, 1.0])[0, 3] == 1.25


def test_joints_that_nobody_moves_stay_at_home(tmp_path):
    yaml = ARM_YAML.replace("[turn, slide, wrist]", "[turn]") + "home: {slide: 250 mm, turn: 1}\n"
    robot = calib.load(write_arm(tmp_path, yaml))
    assert robot.home.tolist() == [1.0]
    assert np.abs(robot.forward([0.0], "slider")[:3, 3] - [0.5, 0, 0.5]).max() < 1e-15
