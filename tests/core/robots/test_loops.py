"""Closing loops against MedRUE's closed form and geometry done by hand; why a pose cannot be assembled."""

import re

import numpy as np
import pytest

import calib
from calib.core.data.in_memory import as_measurements
from calib.core.robots import continuation, loops
from calib.core.robots.closure import residual
from calib.core.robots.loops import why_open
from medrue.closed_form import PASSIVE_JOINTS, forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from tests.project import EXAMPLES
from tests.small_robots import edited_five_bar, write_pose_loop
from tests.urdf_trees import urdf_of

ANGLES = np.array([unit == "rad" for unit in table1().units])


def passive_of(oracle, robot):
    """The closed form's passive joints in the robot's order."""
    return oracle.passive[:, [PASSIVE_JOINTS.index(name) for name in robot.passive_names]]


def inside_limits(passive, robot):
    """The only reason to differ: the mechanism's limits of the passive joints, which the closed form ignores."""
    with np.errstate(invalid="ignore"):
        return np.all((passive >= robot.mechanism.lower) & (passive <= robot.mechanism.upper), axis=1)


@pytest.mark.amount(6, 60)
def test_thousands_of_random_poses_and_parameters_agree_with_the_closed_form(medrue, amount):
    """Parameters within +-2 mm and +-1.5 degrees of nominal."""
    rng = np.random.default_rng(7)
    worst, compared = 0.0, 0
    for _ in range(amount):
        values = table1().nominal + np.where(ANGLES, np.radians(1.5), 2e-3) * rng.uniform(-1, 1, 36)
        q = target_workspace().q[rng.integers(0, 420, 110)] + rng.uniform(-1, 1, (110, 6)) * [0.03, *5 * [0.08]]
        oracle = forward(q, values)
        perturbed = medrue.with_parameters(values)
        closed = perturbed.close(q)
        passive = passive_of(oracle, medrue)
        assert np.array_equal(closed.ok, oracle.closes & inside_limits(passive, medrue))
        assert np.max(np.abs(closed.passive[closed.ok] - passive[closed.ok])) < 1e-9  # the same branch
        difference = perturbed.positions(q[closed.ok])[:, 0] - oracle.p_world_tool[closed.ok]
        worst = max(worst, float(np.max(np.abs(difference))))
        compared += int(closed.ok.sum())
    assert compared >= 100 * amount
    assert worst <= 1e-11  # metres: 1e-8 mm


@pytest.mark.quick(0)
def test_poses_over_the_whole_joint_range_never_come_back_on_a_wrong_branch(medrue):
    q = np.random.default_rng(8).uniform(*medrue.joint_limits.T, (200, 6))
    oracle = forward(q, table1().nominal)
    closed = medrue.close(q)
    assert 5 < closed.ok.sum() < 195
    assert np.array_equal(closed.ok, oracle.closes & inside_limits(passive_of(oracle, medrue), medrue))


UNLIMITED = (r'lower="[-\d.]+" upper="[-\d.]+"', 'lower="-6" upper="6"')


def elbows(a, b):
    return [np.array([x + 0.2 * np.cos(q), 0.2 * np.sin(q)]) for x, q in ((-0.1, a), (0.1, b))]


def by_hand(a, b, sign):
    """The five-bar's tip: intersection of two circles about the elbows, `sign` the side of the line between them."""
    left, right = elbows(a, b)
    across = right - left
    distance = np.linalg.norm(across)
    height = np.sqrt(0.09 - distance**2 / 4)
    return (left + right) / 2 + sign * height * np.array([-across[1], across[0]]) / distance


def five_bar(folder, sign):
    """The five-bar of the tutorial without limits; its home is on side `sign`."""
    robot = edited_five_bar(folder, UNLIMITED)
    tip = by_hand(*robot.home, sign)
    left, right = (
        np.arctan2(*(tip - elbow)[::-1]) - q for elbow, q in zip(elbows(*robot.home), robot.home, strict=True)
    )
    path = folder / "five_bar.yaml"
    path.write_text(re.sub("left_elbow: .*}", f"left_elbow: {left}, right_elbow: {right}}}", path.read_text(), count=1))
    return calib.load(path)


def test_a_five_bar_about_another_axis_keeps_the_assembly_mode_of_its_home(tmp_path):
    sign = -1  # the other mode is among the templates
    robot = five_bar(tmp_path, sign)
    rng = np.random.default_rng(3)
    q = robot.home + rng.uniform(-0.6, 0.6, (300, 2))
    expected = np.array([by_hand(a, b, sign) for a, b in q])
    assert np.max(np.abs(robot.positions(q)[:, 0, :2] - expected)) < 1e-12


def test_a_passive_joint_that_another_follows_at_half_its_angle_is_not_taken_back_by_a_whole_turn(tmp_path):
    z = '<axis xyz="0 0 1"/>'
    half = '<mimic joint="leader" multiplier="-0.5"/>'
    joints = (
        ("slide", "prismatic", "ground", "slider", '<axis xyz="0 1 0"/>'),
        ("leader", "continuous", "ground", "disc", z),
        ("follower", "continuous", "disc", "arm", z + half),
        ("end", "fixed", "arm", "tip", '<origin xyz="1 0 0"/>'),
    )
    (tmp_path / "half.urdf").write_text(urdf_of(*joints))
    (tmp_path / "half.yaml").write_text(
        "urdf: half.urdf\nname_mot: [slide]\nclosed_loop: [[slider, tip]]\ntype: [3d]\nclosed_loop_axes: [[y]]\n"
        "home: {slide: -0.98544973, leader: -2.8}\nbase: {frame: ground}\ntargets: {tip: {frame: tip}}\n"
        "parametrisation: [{origin: end, components: [x], sigma: 1 mm}]\n"
    )
    slide = np.linspace(-0.99, 0.99, 40)
    tips = calib.load(tmp_path / "half.yaml").positions(slide[:, None])[:, 0]
    assert np.allclose(tips[:, :2], np.column_stack([np.sqrt(1 - slide**2), slide]), atol=1e-11)


def test_the_singular_value_is_that_of_the_angle_between_the_distal_links(tmp_path):
    robot = five_bar(tmp_path, 1)
    # the elbows move apart until the distal links are almost in one line, the loop's singular pose
    for a in (2.0, 2.3, 2.6, 2.85):
        q = np.array([a, np.pi - a])
        tip = by_hand(*q, 1)
        first, second = ((tip - elbow) / 0.3 for elbow in elbows(*q))
        # columns of C_p / 0.3 are unit vectors across the two links: s^2 = 1 - |cos of the angle between them|
        expected = np.sqrt(1 - abs(first @ second))
        assert robot.singular_values(robot.assemble(q))[0] == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("distance", [6e3, 6.4e6])
def test_a_robot_far_from_the_root_links_origin_closes_and_measures_as_well(tmp_path, distance):
    """Doubles are 1e-12 m apart at 6 km and 1e-9 m at the radius of the Earth."""
    site = (
        '<link name="world"/><joint name="site" type="fixed"><parent link="world"/><child link="table"/>'
        f'<origin xyz="{distance} -500 3" rpy="0.3 0.2 0.7"/></joint><link name="table">'
    )
    near = edited_five_bar(tmp_path)
    far = edited_five_bar(tmp_path, ('<link name="table">', site))
    q = calib.read_measurements(EXAMPLES / "five_bar_simulated.csv", near).joints
    np.testing.assert_allclose(far.assemble(q).passive, near.assemble(q).passive, rtol=0, atol=1e-12)
    np.testing.assert_allclose(far.positions(q), near.positions(q), rtol=0, atol=1e-12)


def test_loops_of_very_long_links_close_to_their_rounding(tmp_path):
    """Three kilometres of link leave 4e-13 m of rounding in every sum; the angles are those of the small robot."""
    small = edited_five_bar(tmp_path)
    large = edited_five_bar(tmp_path, (r'<origin xyz="(-?[\d.]+) 0 0"/>', r'<origin xyz="\1e4 0 0"/>'))
    assert large.mechanism.length == pytest.approx(3000)
    q = calib.read_measurements(EXAMPLES / "five_bar_simulated.csv", small).joints
    np.testing.assert_allclose(large.assemble(q).passive, small.assemble(q).passive, rtol=0, atol=1e-11)


def test_poses_closed_from_solutions_of_another_assembly_mode_are_in_that_of_home(tmp_path):
    """The pen of a five-bar, mirrored at the line between its elbows by plane geometry: the loop is closed as well."""
    robot = edited_five_bar(tmp_path, UNLIMITED)
    q = robot.home + 0.3 * np.random.default_rng(1).uniform(-1, 1, (20, 2))
    known = robot.assemble(q).passive
    left, right = (robot.passive_names.index(f"{side}_elbow") for side in ("left", "right"))
    corners = np.stack([0.2 * np.exp(1j * q[:, k]) + x for k, x in ((0, -0.1), (1, 0.1))])
    pen = corners[0] + 0.3 * np.exp(1j * (q[:, 0] + known[:, left]))
    along = corners[1] - corners[0]
    other = corners[0] + along * np.conj((pen - corners[0]) / along)
    mirrored = known.copy()
    for joint, elbow in ((left, corners[0]), (right, corners[1])):
        mirrored[:, joint] += np.angle((other - elbow) / (pen - elbow))
    assert np.max(np.abs(residual(robot.mechanism, q, mirrored)[0])) < 1e-9
    one = np.where(np.arange(20)[:, None] == 7, mirrored, known)
    for seed in (known, one, mirrored):  # so a fit, which closes its loops from step to step, stays in it
        np.testing.assert_allclose(robot.assemble(q, seed).passive, known, rtol=0, atol=1e-9)


def test_a_verdict_closes_no_measured_pose_again(monkeypatch):
    robot = calib.load(EXAMPLES / "five_bar.yaml")
    fit = calib.fit(robot, calib.read_measurements(EXAMPLES / "five_bar_simulated.csv", robot))
    closed, newton = [], continuation.newton

    def recording(mechanism, mode, actuated, passive, **options):
        closed.append(actuated)
        return newton(mechanism, mode, actuated, passive, **options)

    for module in (continuation, loops):
        monkeypatch.setattr(module, "newton", recording)
    assert fit.verdict.grade == "PASS"
    assert closed  # of home
    assert not any(np.array_equal(q, fit.configurations.actuated) for q in closed)


def test_a_pose_beyond_a_passive_limit_names_the_joint_and_its_angle_in_the_closed_form(medrue):
    q = medrue.home.copy()
    q[1:3] = -1.5
    with pytest.raises(calib.UnreachablePoseError) as error:
        medrue.assemble(q)
    match = re.search(
        r"only with passive joint (\w+) at (\S+) deg, (\S+) deg beyond its limits \(-149 to -17.19 deg\)",
        str(error.value),
    )
    angle, beyond = float(match[2]), float(match[3])
    assert beyond == pytest.approx(max(-149 - angle, angle + 17.19), rel=5e-3, abs=0.02)  # printed with three digits
    expected = np.degrees(forward(q[None], table1().nominal).passive[0, PASSIVE_JOINTS.index(match[1])])
    assert (float(match[2]) - expected) % 360 == pytest.approx(0, abs=0.05)  # printed with four digits


def test_no_limit_is_named_that_holds(medrue):
    """A pose that fails among others only, because their ways lead elsewhere, is closed alone within all limits."""
    why = why_open(medrue.mechanism, medrue.mode, medrue.home)
    assert why.startswith("it closes if solved alone")
    assert not any(name in why for name in medrue.mechanism.passive)


@pytest.mark.quick(0)
def test_a_limit_of_a_passive_joint_is_no_wall_on_the_way_of_a_fit(medrue):
    """A pose ends within the limits of a slide, but is beyond them for most values on the way."""
    robot, table = medrue, table1()
    rng = np.random.default_rng(90)
    values = table.nominal + rng.choice([-1.0, 1.0], len(table.names)) * (table.actual - table.nominal)
    truth = robot.with_parameters(dict(zip(table.names, values, strict=True)))
    q = robot.sample(40, seed=rng)
    q = q[truth.close(q).ok]
    measured = forward(q, values).p_world_tool + 2e-5 * rng.standard_normal((len(q), 3))
    fit = calib.fit(robot, as_measurements(robot, q, measured))
    assert fit.converged
    new = robot.sample(60, seed=rng)
    new = new[truth.close(new).ok & fit.robot.close(new).ok]
    off = fit.robot.positions(new)[:, 0] - forward(new, values).p_world_tool
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 4e-5


def test_a_full_pose_home_that_is_turned_apart_is_refused_in_degrees(tmp_path):
    path = write_pose_loop(tmp_path)
    text = path.read_text()
    turn = float(re.search(r"tip_right_turn: (\S+)}", text)[1])
    path.write_text(text.replace(repr(turn), repr(turn + 0.1)))
    with pytest.raises(
        calib.DescriptionError, match=r"open by \d\.\d+ mm and 5\.\d+ deg; .*to \d+ mm and 3 deg or better"
    ):
        calib.load(path)
