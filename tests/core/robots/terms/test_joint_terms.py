"""Joint terms: columns, derivatives through loops, recovery, what a curve explains of a real robot."""

import numpy as np
import pytest

import calib
from calib.core.fitting.terms.candidate_terms import candidates
from calib.core.fitting.terms.joint_curves import joint_curves
from calib.core.robots.terms.term import Context
from calib.core.robots.terms.terms import parse_terms
from tests.kind_checks import assert_positions_move_as_differences_say
from tests.project import EXAMPLES, ROOT, copied, write_table
from tests.public_data import ur10_tracker
from tests.six_axis_arm import FREE, YAML, joints, noisy, write_six_axis

FIVE_BAR_JOINT = calib.load(EXAMPLES / "five_bar.yaml").joint_names[0]


def with_terms(tmp_path, name, terms):
    lines = "".join(f"  - {term}\n" for term in terms)
    return calib.load(copied(tmp_path, EXAMPLES / name, more=f"\njoint_terms:\n{lines}"))


@pytest.fixture
def five_bar(tmp_path):
    terms = [
        "{joint: all, term: gain}",
        "{joint: all, term: harmonics, orders: [1, 17]}",
        "{joint: all, term: backlash}",
        "{joint: right_motor, term: coupling, driven_by: left_motor}",
    ]
    return with_terms(tmp_path, "five_bar.yaml", terms)


def near_home(robot, n, seed, reach=0.2):
    return robot.home + np.random.default_rng(seed).uniform(-reach, reach, (n, len(robot.home)))


ERRORS = {
    "no coefficients": ({}, lambda left, right, side: (0 * left, 0 * right)),
    "gain": ({"left_motor.gain": 2e-3}, lambda left, right, side: (2e-3 * left, 0 * right)),
    "harmonics": (
        {"right_motor.sin17": 3e-4, "right_motor.cos1": -1e-4},
        lambda left, right, side: (0 * left, 3e-4 * np.sin(17 * right) - 1e-4 * np.cos(right)),
    ),
    "backlash": ({"left_motor.backlash": 1e-4}, lambda left, right, side: (1e-4 * side, 0 * right)),
    "coupling": ({"right_motor.by_left_motor": 2e-3}, lambda left, right, side: (0 * left, 2e-3 * left)),
}


@pytest.mark.parametrize("term", ERRORS)
def test_joints_are_off_by_what_their_terms_say(five_bar, term):
    values, error = ERRORS[term]
    robot, q, side = five_bar.with_parameters(values), near_home(five_bar, 3, 1), np.array([1.0, -1.0, 0.0])
    context = Context.from_conditions(np.column_stack([side, 0 * side]), {})
    off = robot.assemble(q, context=context).actuated - q
    assert np.allclose(off, np.stack(error(*q.T, side), axis=1), rtol=0, atol=1e-15)
    assert robot.assemble(q[:0]).actuated.shape == (0, 2)


def test_of_all_joints_a_period_is_for_the_prismatic_ones_and_a_curve_repeats_after_twice_the_stroke(tmp_path):
    terms = (
        "\njoint_terms:\n  - {joint: all, term: harmonics, orders: [1], period: 5 mm}\n"
        "  - {joint: all, term: curve, orders: 3}\n"
    )
    robot = calib.load(copied(tmp_path, ROOT / "urdf" / "medrue.yaml", more=terms))
    rail, leg = robot.joint_names[:2]
    robot = robot.with_parameters({f"{rail}.sin1": 2e-5, f"{rail}.curve_cos3": 3e-5, f"{leg}.sin1": 1e-4})
    q = robot.home + np.array([[0.0123, 0.05, 0, 0, 0, 0]])
    error = robot.assemble(q).actuated[0] - q[0]
    rail_error = 2e-5 * np.sin(2 * np.pi * q[0, 0] / 5e-3) + 3e-5 * np.cos(2 * np.pi * 3 * q[0, 0] / (2 * 0.7))
    assert np.allclose(error, [rail_error, 1e-4 * np.sin(q[0, 1]), 0, 0, 0, 0], rtol=0, atol=1e-12)


def test_a_temperature_counts_from_the_same_reference_in_every_file(tmp_path):
    robot = with_terms(tmp_path, "five_bar.yaml", [f"{{joint: {FIVE_BAR_JOINT}, term: temperature}}"])
    robot = robot.with_parameters({f"{FIVE_BAR_JOINT}.temperature": 1e-4})
    q, approach = near_home(robot, 3, 5), np.zeros((3, 2))
    for rows in ([0, 1, 2], [1, 2]):  # a subset has another mean
        context = Context.from_conditions(approach[rows], {"temperature": np.array([20.0, 23.0, np.nan])[rows]})
        error = robot.assemble(q[rows], context=context).actuated[:, 0] - q[rows, 0]
        assert np.allclose(error, np.array([0.0, 3e-4, 0.0])[rows], rtol=0, atol=1e-15)


def test_a_condition_that_some_rows_do_not_state_is_no_condition(tmp_path):
    robot = with_terms(tmp_path, "arm.yaml", ["{joint: joint_2, term: temperature}"])
    lines = (EXAMPLES / "arm_simulated.csv").read_text().splitlines()
    header = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    rows = [f"{line},{'' if k == 3 else 20 + k}" for k, line in enumerate(lines[header + 1 :])]
    path = tmp_path / "data.csv"
    path.write_text("\n".join([f"{lines[header]},temperature [degC]", *rows]) + "\n")
    with pytest.raises(calib.DataError, match=r"line 5.*: says no temperature, which 'joint_2.temperature' depends on"):
        calib.fit(robot, calib.read_measurements(path, robot))


def test_derivatives_by_coefficients_agree_with_differences_through_the_loop(five_bar):
    rng = np.random.default_rng(4)
    values = five_bar.values.copy()
    values[five_bar.coefficients] = 1e-3 * rng.standard_normal(values[five_bar.coefficients].shape)
    robot = five_bar.with_parameters(values)
    q = near_home(robot, 7, 5)
    context = Context.from_conditions(np.sign(rng.standard_normal(q.shape)), {})
    assert_positions_move_as_differences_say(robot, q, context)


@pytest.mark.parametrize(
    ("term", "message"),
    [
        ("{joint: nowhere, term: gain}", "no actuated joint 'nowhere'"),
        ("{joint: all, term: gian}", "unknown term 'gian'; did you mean 'gain'"),
        ("{joint: all, term: gain, orders: [1]}", "unknown key"),
        ("{joint: all, term: harmonics, orders: [0]}", "greater than 0"),
        ("{joint: all, term: gain, sigma: 1 mm}", "unit 'mm' is for a length"),
        ("{joint: all, term: gain, sigma: 0}", "sigma must be positive"),
        ("{joint: JOINT, term: harmonics, period: 10 mm}", "`period` is for prismatic joints"),
        ("{joint: JOINT, term: coupling, driven_by: nowhere}", "driven_by: no actuated joint 'nowhere'"),
        ("{joint: all, term: coupling, driven_by: JOINT}", "driven_by names the joint itself; use the term `gain`"),
        ("{joint: JOINT, term: coupling}", "driven_by"),
        ("{joint: JOINT, term: curve, stroke: 1 m}", "`stroke` is for prismatic joints"),
    ],
)
def test_bad_entries_are_named(tmp_path, term, message):
    with pytest.raises(calib.DescriptionError, match=message) as caught:
        with_terms(tmp_path, "five_bar.yaml", [term.replace("JOINT", FIVE_BAR_JOINT)])
    assert "\n" not in str(caught.value)


@pytest.mark.quick(0)
def test_a_curve_is_found_where_there_is_one_and_stays_flat_where_there_is_none(tmp_path):
    curved = [f"{{joint: joint_{k}, term: curve, orders: 25}}" for k in (2, 4)]
    robot, bare = with_terms(tmp_path, "arm.yaml", curved), calib.load(EXAMPLES / "arm.yaml")
    rng = np.random.default_rng(10)
    q = rng.uniform(-1.5, 1.5, (160, 6))
    gear = q.copy()
    gear[:, 1] += 4e-4 * np.sin(11 * q[:, 1] + 0.3)
    data = calib.as_measurements(bare, q, bare.positions(gear)[:, 0] + 2e-5 * rng.standard_normal((160, 3)))
    used, unused = data[np.arange(120)], data[np.arange(120, 160)]
    fit, plain = (calib.fit(item, used, validation=unused) for item in (robot, bare))
    curves = {curve.joint: curve for curve in joint_curves(fit)}
    assert curves["joint_2"].rms == pytest.approx(4e-4 / np.sqrt(2), rel=0.15)
    assert curves["joint_4"].rms < 3e-5
    commands = np.linspace(-1.5, 1.5, 721)[:, None] * np.ones(6)
    term, own = next(each for each in fit.robot.terms_with_places() if each[0].joint == "joint_2")
    columns, free = (
        term.columns(commands, 1, Context.neutral(721, 6)),
        np.isin(fit.free_names, [p.name for p in term.parameters]),
    )
    std = np.sqrt(np.sum((columns @ fit.covariance.values[np.ix_(free, free)]) * columns, axis=1))
    error, true = columns @ fit.robot.values[own], 4e-4 * np.sin(11 * commands[:, 1] + 0.3)
    inside = np.abs(error - error.mean() - true + true.mean()) < 4 * std + 2e-5
    assert np.mean(inside) > 0.95  # a constant is the joint's zero, which the origins have
    assert fit.validation.table()["after"]["rms"] < 0.35 * plain.validation.table()["after"]["rms"]


@pytest.mark.quick(0)
def test_curves_halve_what_origins_leave_of_a_real_robot(shared_data):
    robot, data, use = ur10_tracker(shared_data / "ur10_tracker")
    after = {}
    for name, made in (("origins", robot), ("curves", robot.with_terms(parse_terms("curve")))):
        fit = calib.fit(made, data[use == "train"], validation=data[use == "test"])
        after[name] = fit.validation.table()["after"]["rms"]
    assert after["origins"] == pytest.approx(0.444, abs=0.005)  # the data's README: 0.44
    assert after["curves"] < 0.15  # the data's README: 0.174 by another program


TURNS = np.linspace(-7.0, 9.0, 60)


def endless(folder, *terms):
    """The six-axis arm with a first joint that turns without end, and these terms."""
    path = write_six_axis(folder, YAML + FREE + "".join(f"  - {term}\n" for term in terms))
    urdf = (folder / "arm.urdf").read_text()
    (folder / "arm.urdf").write_text(urdf.replace('name="j1" type="revolute"', 'name="j1" type="continuous"'))
    return calib.load(path)


def turned(first):
    q = joints(60)
    q[:, 0] = first
    return q


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("first", "doubted"),
    [
        ((TURNS + np.pi) % (2 * np.pi) - np.pi, True),
        (np.degrees(TURNS) % 360 // 0.01 * 0.01 * np.pi / 180, True),
        (TURNS, False),  # turns are counted
        (TURNS / 8, False),  # nowhere near both ends of a turn
    ],
)
def test_terms_that_count_turns_are_doubted_where_values_may_be_wrapped(first, doubted, tmp_path, run_calib):
    robot = endless(tmp_path, "{joint: j1, term: gain}", "{joint: j3, term: coupling, driven_by: j1}")
    q = turned(first)
    fit = calib.fit(robot, noisy(robot, q, 4e-5, seed=1))
    words = [reason.text for reason in fit.verdict.reasons if reason.code == "turns_not_counted"]
    wrong = "j1 lie within one turn, and the URDF states no limits. If these values were wrapped, j1.gain, j3.by_j1"
    assert [wrong in text for text in words] == [True] * doubted
    run = run_calib("check", robot.path, write_table(tmp_path / "poses.csv", robot.joint_names, q))
    assert run.code == 0
    assert ("j1.gain, j3.by_j1 cannot be right. Give values that count turns" in run.err) == doubted


def test_auto_asks_no_joint_that_may_be_wrapped_for_what_counts_turns(tmp_path):
    robot = endless(tmp_path)
    by_name = {}
    for first in (TURNS, TURNS % (2 * np.pi)):
        for joint in candidates(robot, noisy(robot, turned(first), 4e-5, seed=1)):
            by_name.setdefault(joint.term, []).append(joint)
    for term in ("gain", "coupling"):
        counted, wrapped, told = by_name[term]
        results = [
            {section.driven_by if term == "coupling" else section.joint for section in item.sections}
            for item in (counted, wrapped)
        ]
        assert results == [{"all"} if term == "gain" else set(robot.joint_names), set(robot.joint_names) - {"j1"}]
        assert told.refusal.startswith("all values of joint j1 lie within one turn, and the URDF states no limits")
        assert f"a {term} cannot be right" in told.refusal
    assert [item.sections for item in by_name["curve"]] == [by_name["curve"][0].sections] * 2  # periodic: no matter
    only = candidates(robot, noisy(robot, np.column_stack([TURNS % (2 * np.pi), np.zeros((60, 5))]), 4e-5, seed=1))
    assert "a gain cannot be right" in next(name for name in only if name.term == "gain").refusal
