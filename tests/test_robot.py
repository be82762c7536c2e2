"""The robot: rules for a plain URDF, forward kinematics against yourdfpy, immutability, pickling, edited URDFs."""

import pickle
import re
import sys
from pathlib import Path

import numpy as np
import pytest
import yourdfpy
from small_robots import ARM_URDF, ARM_YAML, small_arm, write_arm, write_parallelogram

import calib
from calib.errors import DataError, DescriptionError, UnreachablePoseError, UrdfError

ONE_PICOMETRE = 1e-12
"""Rounding over 20 transforms of lengths up to a few metres stays below 1e-14 m; this leaves room."""
EXAMPLE_ROBOTS = Path(sys.prefix, "lib", f"python3.{sys.version_info.minor}", "site-packages", "cmeel.prefix", "share",
                      "example-robot-data", "robots")  # fmt: skip


def urdf_of(*joints, links=()):
    """A URDF from (name, type, parent, child, extra XML) of its joints."""
    names = dict.fromkeys([*links, *(joint[2] for joint in joints), *(joint[3] for joint in joints)])
    text = [f'<link name="{name}"/>' for name in names]
    for name, kind, parent, child, *extra in joints:
        limit = '<limit lower="-9" upper="9" effort="1" velocity="1"/>' if kind in ("revolute", "prismatic") else ""
        ends = f'<parent link="{parent}"/><child link="{child}"/>'
        text.append(f'<joint name="{name}" type="{kind}">{ends}{limit}{"".join(extra)}</joint>')
    return '<robot name="test">' + "\n".join(text) + "</robot>"


def plain(folder, *joints, **options):
    path = folder / "plain.urdf"
    path.write_text(urdf_of(*joints, **options))
    return calib.load(path)


CHAIN = (("a", "revolute", "w", "1"), ("b", "prismatic", "1", "2"), ("c", "fixed", "2", "3"))


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
    assert {p.sigma for p in origins if p.dimension == "length"} == {0.002}
    assert {p.sigma for p in origins if p.dimension == "angle"} == {0.005}
    assert not any(p.prior for p in robot.parameters if p.placement)


def test_fixed_side_branches_do_not_count_as_branches(tmp_path):
    robot = plain(tmp_path, ("camera", "fixed", "1", "lens"), *CHAIN, ("light", "fixed", "w", "lamp"))
    assert robot.target_names == ("3",)
    assert robot.joint_names == ("a", "b")


def test_of_several_ends_behind_the_same_joints_the_last_in_the_file_is_the_last_link(tmp_path):
    robot = plain(tmp_path, *CHAIN, ("flange", "fixed", "2", "tool0"))
    assert robot.target_names == ("tool0",)


def test_moving_branches_are_an_error_that_shows_the_way_out(tmp_path):
    with pytest.raises(DescriptionError) as caught:
        plain(tmp_path, *CHAIN, ("left", "revolute", "3", "finger_1"), ("right", "revolute", "3", "finger_2"))
    path = tmp_path / "plain.urdf"
    assert str(caught.value) == (
        f"{path}: the robot branches, so it has no last link; choose a link such as finger_1, finger_2 with"
        f" `calib init {path} --target LINK --out FILE`"
    )


def test_a_robot_that_does_not_move_is_an_error(tmp_path):
    with pytest.raises(DescriptionError, match="no joint moves link '2'; there is nothing to calibrate"):
        plain(tmp_path, ("a", "fixed", "w", "1"), ("b", "fixed", "1", "2"))
    with pytest.raises(DescriptionError, match="no joint moves link 'alone'"):
        plain(tmp_path, links=("alone",))


def test_floating_and_planar_joints_are_held(tmp_path):
    end = ("t", "fixed", "2", "3", '<origin xyz="1 0 0"/>')
    robot = plain(tmp_path, ("f", "floating", "w", "0"), ("p", "planar", "0", "1", '<origin xyz="0 0 2"/>'),
                  ("a", "continuous", "1", "2", '<axis xyz="0 0 1"/>'), end)  # fmt: skip
    assert robot.joint_names == ("a",)
    assert np.abs(robot.forward([np.pi / 2])[:3, 3] - [0, 1, 2]).max() < 1e-15


def test_a_mimic_joint_follows_and_is_not_actuated(tmp_path):
    axis, one = '<axis xyz="0 0 1"/>', '<origin xyz="1 0 0"/>'
    follows = '<mimic joint="a" multiplier="-2" offset="0.5"/>'
    robot = plain(tmp_path, ("a", "continuous", "w", "1", axis),
                  ("b", "continuous", "1", "2", axis, one, follows), ("t", "fixed", "2", "3", one))  # fmt: skip
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


def test_a_mimic_joint_that_is_named_as_motor_is_its_own(tmp_path):
    (tmp_path / "plain.urdf").write_text(urdf_of(
        ("a", "prismatic", "w", "1"), ("b", "prismatic", "1", "2", '<mimic joint="a" multiplier="2"/>')))  # fmt: skip
    (tmp_path / "r.yaml").write_text(
        "urdf: plain.urdf\nname_mot: [b, a]\nbase: {frame: w}\ntargets: {t: {frame: '2'}}\n"
        "parametrisation: [{origin: all, components: [x], sigma: 1 mm}]\n"
    )
    robot = calib.load(tmp_path / "r.yaml")
    assert robot.joint_names == ("b", "a")  # in the description's order, not the tree's
    assert robot.forward([0.25, 1.0])[0, 3] == 1.25


def test_joints_that_nobody_moves_stay_at_home(tmp_path):
    yaml = ARM_YAML.replace("[turn, slide, wrist]", "[turn]") + "home: {slide: 250 mm, turn: 1}\n"
    robot = calib.load(write_arm(tmp_path, yaml))
    assert robot.home.tolist() == [1.0]
    assert np.abs(robot.forward([0.0], "slider")[:3, 3] - [0.5, 0, 0.5]).max() < 1e-15


def random_tree(generator, n_links):
    """A URDF tree with every joint type that moves, limits, odd axes, mimics, and pitch angles of 90 degrees."""
    joints, leaders = [], []
    for k in range(1, n_links):
        kind = str(generator.choice(["revolute", "continuous", "prismatic", "fixed"], p=[0.4, 0.15, 0.25, 0.2]))
        rpy = generator.uniform(-4, 4, 3)
        rpy[1] = generator.choice([rpy[1], np.pi / 2, -np.pi / 2, 0.0])
        extra = '<origin xyz="{} {} {}" rpy="{} {} {}"/>'.format(*generator.uniform(-1, 1, 3), *rpy)
        axis = generator.normal(size=3)
        axis /= np.linalg.norm(axis)
        extra += '<axis xyz="{} {} {}"/>'.format(*axis) if generator.random() < 0.8 else ""
        if leaders and kind != "fixed" and generator.random() < 0.2:
            extra += '<mimic joint="{}" multiplier="{}" offset="{}"/>'.format(
                generator.choice(leaders), *generator.normal(size=2)
            )
        elif kind != "fixed":
            leaders.append(f"j{k}")
        joints.append((f"j{k}", kind, f"l{generator.integers(k)}", f"l{k}", extra))
    order = generator.permutation(len(joints))
    return urdf_of(*(joints[k] for k in order), links=["l0"]), leaders


def described(path, actuated, base, target):
    """Load a URDF with these joints actuated and every origin on the way to the target free."""
    yaml = path.with_suffix(".yaml")
    yaml.write_text(
        f"urdf: {path}\nname_mot: {list(actuated)}\nbase: {{frame: '{base}'}}\n"
        f"targets: {{point: {{frame: '{target}'}}}}\nparametrisation:\n"
        "  - {origin: all, components: [x, y, z], sigma: 2 mm}\n"
        "  - {origin: all, components: [rx, ry, rz], sigma: 5 mrad}\n"
    )
    return calib.load(yaml)


def assert_same_kinematics_as_yourdfpy(robot, path, generator, count=3):
    other = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    for _ in range(count):
        q = generator.uniform(-3, 3, len(robot.joint_names))
        other.update_cfg(dict(zip(robot.joint_names, q.tolist(), strict=True)))
        links = robot.urdf.links
        for link in links[:: max(1, len(links) // 12)]:
            expected = other.get_transform(link, robot.urdf.root)
            assert np.abs(robot.forward(q, link) - expected).max() < ONE_PICOMETRE, link


def test_random_trees_have_the_same_forward_kinematics_as_in_yourdfpy(tmp_path):
    generator = np.random.default_rng(11)
    for k in range(25):
        text, actuated = random_tree(generator, int(generator.integers(3, 15)))
        path = tmp_path / f"tree{k}.urdf"
        path.write_text(text)
        urdf = yourdfpy.URDF.load(str(path), build_scene_graph=False)
        ends = {joint.child for joint in urdf.robot.joints} - {joint.parent for joint in urdf.robot.joints}
        if actuated:
            robot = described(path, actuated, "l0", min(ends))
            assert_same_kinematics_as_yourdfpy(robot, path, generator)


EXAMPLES = {
    "motoman_right/robot.urdf": "shared",
    "ur10/robot.urdf": "shared",
    "mukca/urdf/iiwa14.urdf": "shared",
    "mukca/urdf/panda.urdf": "shared",
    "ur_description/urdf/ur5_robot.urdf": "examples",
    "talos_data/robots/talos_full_v2.urdf": "examples",
    "tiago_description/robots/tiago_dual.urdf": "examples",
    "double_pendulum_description/urdf/double_pendulum_continuous.urdf": "examples",
    "hector_description/robots/quadrotor_base.urdf": "examples",
    "panda_description/urdf/panda.urdf": "examples",
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_real_robots_have_the_same_forward_kinematics_as_in_yourdfpy(name, request, tmp_path):
    folder = request.getfixturevalue("shared_data") if EXAMPLES[name] == "shared" else EXAMPLE_ROBOTS
    if not folder.is_dir():
        pytest.skip("the package example-robot-data is not installed")
    path = tmp_path / "robot.urdf"
    path.write_bytes((folder / name).read_bytes())
    urdf = calib.model.urdf_text.read_urdf(path)
    moving = [j.name for j in urdf.joints if j.type in ("revolute", "continuous", "prismatic") and j.mimic is None]
    if not moving:
        with pytest.raises(DescriptionError, match="no joint moves link"):
            calib.load(path)
        return
    robot = described(path, moving, urdf.root, urdf.links[-1])
    assert_same_kinematics_as_yourdfpy(robot, path, np.random.default_rng(12), count=1)


def test_an_edited_urdf_reloads_to_the_same_kinematics(tmp_path, medrue):
    generator = np.random.default_rng(13)
    robots = [medrue, small_arm(tmp_path)]
    for k in range(5):
        text, actuated = random_tree(generator, 12)
        path = tmp_path / f"tree{k}.urdf"
        path.write_text(text)
        robots.append(described(path, actuated, "l0", "l11"))
    for robot in robots:
        size = 2e-3 if robot is medrue else 0.3
        edited = robot.with_parameters(robot.values + generator.normal(0, size, len(robot.values)))
        (tmp_path / "edited.urdf").write_bytes(edited.calibrated_urdf())
        yaml = Path(robot.path).read_text()
        yaml = re.sub("^urdf: .*$", f"urdf: {tmp_path / 'edited.urdf'}", yaml, count=1, flags=re.MULTILINE)
        if robot is medrue:  # its home is not closed with other parameters
            assembled = edited.assemble(robot.home)
            for name, value in zip(robot.passive_names, assembled.passive[0].tolist(), strict=True):
                yaml = re.sub(f"^  {name}: .*$", f"  {name}: {value!r}", yaml, flags=re.MULTILINE)
        (tmp_path / "edited.yaml").write_text(yaml)
        reloaded = calib.load(tmp_path / "edited.yaml")
        q = robot.home + generator.normal(0, 0.05, (5, len(robot.home)))
        for link in robot.urdf.links:
            assert np.abs(reloaded.forward(q, link) - edited.forward(q, link)).max() < ONE_PICOMETRE, link
        changed = robot.forward(q) - edited.forward(q)
        assert np.abs(changed).max() > 1e-4  # the edit did something


def snapshot(robot):
    return (
        robot.values.tobytes(),
        robot.calibrated_urdf(),
        [placement.homogeneous.tobytes() for placement in list(robot.mechanism.model.jointPlacements)],
        robot.positions(robot.home).tobytes(),
    )


def test_with_parameters_leaves_the_old_robot_as_it_was(tmp_path, medrue):
    for robot in (medrue, small_arm(tmp_path)):
        before = snapshot(robot)
        changed = robot.with_parameters(robot.values + 1e-3)
        assert snapshot(robot) == before
        assert snapshot(changed) != before
        assert snapshot(changed.with_parameters(robot.values)) == before
        assert changed.with_parameters({}).values.tolist() == changed.values.tolist()


def test_the_values_given_are_copied(tmp_path):
    robot = small_arm(tmp_path)
    values = robot.values.copy()
    changed = robot.with_parameters(values)
    values[:] = 7.0
    assert changed.values.tolist() == robot.values.tolist()


def arrays_of(robot):
    mechanism = robot.mechanism
    return (robot.values, robot.home, mechanism.support, mechanism.select_actuated, mechanism.select_passive,
            mechanism.constant, mechanism.lower, mechanism.upper, robot.assemble(robot.home).actuated)  # fmt: skip


def test_no_array_of_a_robot_can_be_written_to(medrue):
    for robot in (medrue, medrue.with_parameters(medrue.values), pickle.loads(pickle.dumps(medrue))):
        for array in arrays_of(robot):
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0.0


def test_no_attribute_of_a_robot_can_be_set(medrue):
    with pytest.raises(AttributeError):
        medrue.values = np.zeros(36)
    with pytest.raises(AttributeError):
        medrue.mechanism.length = 1.0


def test_a_robot_survives_pickling_with_its_values(medrue, tmp_path):
    generator = np.random.default_rng(14)
    for robot in (medrue, small_arm(tmp_path), calib.load(write_parallelogram(tmp_path))):
        changed = robot.with_parameters(robot.values + generator.normal(0, 1e-3, len(robot.values)))
        copied = pickle.loads(pickle.dumps(changed))
        q = robot.home + generator.normal(0, 0.05, (4, len(robot.home)))
        assert np.array_equal(copied.positions(q), changed.positions(q))
        assert copied.calibrated_urdf() == changed.calibrated_urdf()
        assert copied.parameters == changed.parameters


def test_forward_takes_one_pose_or_many_and_any_frame(tmp_path):
    robot = small_arm(tmp_path)
    q = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    both = robot.forward(q, "tip")
    assert both.shape == (2, 4, 4)
    assert np.array_equal(robot.forward(q[1], "tip"), both[1])
    assert np.array_equal(robot.forward(q), both)  # the first target
    assert np.array_equal(robot.forward(q, "flange"), robot.forward(q, "tool"))  # a joint's frame is its child's
    assert np.array_equal(robot.forward(q, "ground"), np.tile(np.eye(4), (2, 1, 1)))
    assert np.abs(robot.positions(q)[:, 0] - both[:, :3, 3]).max() < 1e-15
    tip = both[:, :3, :3] @ [0, 0, 0] + both[:, :3, 3]
    tool = robot.forward(q, "tool")
    assert np.abs(tool[:, :3, :3] @ [0.01, 0.02, 0.03] + tool[:, :3, 3] - tip).max() < 1e-15


def test_no_poses_at_all_are_no_error(medrue, tmp_path):
    for robot in (medrue, small_arm(tmp_path)):
        assert robot.positions(np.zeros((0, len(robot.home)))).shape == (0, 1, 3)


@pytest.mark.parametrize(
    ("q", "message"),
    [
        ([0.0, 0.0], r"joint values of shape \(2,\); expected \(n, 3\) in the order turn, slide, wrist"),
        (np.zeros((4, 2)), r"joint values of shape \(4, 2\); expected \(n, 3\)"),
        (np.zeros((1, 1, 3)), r"joint values of shape \(1, 1, 3\)"),
        (0.0, r"joint values of shape \(\); expected"),
        ([[0, 0, 0], [0, np.nan, 0]], "pose 1: joint 'slide' is not finite"),
    ],
)
def test_joint_values_that_cannot_be_are_errors(tmp_path, q, message):
    with pytest.raises(DataError, match=message):
        small_arm(tmp_path).positions(q)


def test_an_unknown_frame_names_the_nearest(tmp_path):
    with pytest.raises(DescriptionError, match="no link or joint 'tol'; did you mean 'tool'"):
        small_arm(tmp_path).forward([0, 0, 0], "tol")


def test_a_pose_that_cannot_be_assembled_is_an_error_that_says_by_how_much(tmp_path):
    """Crank 0.5, coupler 1, rocker 0.25, ground 1 m: at a = 180 deg, 1.5 m are to be spanned with 1.25 m."""
    yaml = write_parallelogram(tmp_path)
    urdf = yaml.with_suffix(".urdf")
    urdf.write_text(re.sub('(rocker_end"/> <origin xyz=")0.5', r"\g<1>0.25", urdf.read_text()))
    b, c = four_bar(np.radians(75), 0.5, 1.0, 0.25)
    yaml.write_text(re.sub("home: .*", f"home: {{a: 75 deg, b: {b!r}, c: {c!r}}}", yaml.read_text()))
    with pytest.raises(UnreachablePoseError) as caught:
        calib.load(yaml).positions([[np.radians(80)], [np.pi], [np.pi]])
    assert str(caught.value) == (
        "pose 1 (and 1 more poses): loop rocker_end-coupler_end stays open by 250.000 mm at best;"
        " check these joint values, or leave the pose out"
    )


def four_bar(a, crank, coupler, rocker):
    """Passive joints of a four-bar with ground (1, 0), elbow down, from the intersection of two circles."""
    B = crank * np.exp(1j * a)
    d = abs(1 - B)
    along = (coupler**2 - rocker**2 + d**2) / (2 * d)
    E = B + (1 - B) / d * (along + 1j * np.sqrt(coupler**2 - along**2))
    return float(np.angle(E - B) - a), float(np.angle(E - 1))


def test_a_robot_prints_as_one_short_line(medrue):
    assert len(repr(medrue)) < 200
    assert "36 parameters" in repr(medrue)


def test_a_path_with_an_upper_case_suffix_or_a_text_path_is_fine(tmp_path):
    path = write_arm(tmp_path)
    upper = path.rename(tmp_path / "ARM.YML")
    assert calib.load(str(upper)).name == "small arm"


def test_a_urdf_elsewhere_is_found_from_its_description(tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "urdfs").mkdir()
    (tmp_path / "urdfs" / "arm.urdf").write_text(ARM_URDF)
    (tmp_path / "sub" / "arm.yaml").write_text(ARM_YAML.replace("arm.urdf", "../urdfs/arm.urdf"))
    assert calib.load(tmp_path / "sub" / "arm.yaml").joint_names == ("turn", "slide", "wrist")


def test_a_name_of_target_and_link_means_the_link_and_no_name_the_target(tmp_path):
    """A plain URDF's target is called like its last link, and may be calibrated to lie elsewhere on it."""
    urdf = write_arm(tmp_path).with_suffix(".urdf")
    robot = calib.load(urdf)
    (target,) = robot.target_names
    moved = robot.with_parameters({f"{target}.x": 0.05})
    q = np.array([0.1, 0.2, 0.3])
    assert np.allclose(moved.forward(q)[:3, 3], moved.positions(q)[0, 0], atol=1e-15)
    assert np.array_equal(moved.forward(q, target), robot.forward(q, target))
    assert np.linalg.norm(moved.forward(q)[:3, 3] - moved.forward(q, target)[:3, 3]) == pytest.approx(0.05)


@pytest.mark.parametrize("value", [1e300, -2e6])
def test_a_joint_value_that_no_robot_reaches_is_refused(tmp_path, value):
    with pytest.raises(DataError, match=r"pose 0: joint 'slide' is .* m or rad, which no robot reaches"):
        calib.load(write_arm(tmp_path)).positions([0.1, value, 0.2])


def test_poses_near_a_singularity_of_the_loops_are_named(tmp_path):
    """The parallelogram is flat, and singular, at 0 and 180 degrees."""
    robot = calib.load(write_parallelogram(tmp_path))
    q = np.radians([[90.0], [1.0]])
    (remark,) = robot.near_singularities(robot.assemble(q), ["far", "near"])
    assert remark.startswith("near: ")
    assert remark.endswith("from a singularity of the loops (limit 0.02)")
