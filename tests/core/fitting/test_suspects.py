"""Usual mistakes are named, each made in good measurements of a robot with the expected errors."""

import re
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.data.measurements import with_points
from calib.core.fitting.likely_mistakes import likely_mistake
from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from tests.project import EXAMPLES
from tests.public_data import motoman
from tests.six_axis_arm import FREE, YAML, joints, noisy, write_six_axis

SIGMA = 4e-5


@pytest.fixture(scope="module", params=["known"])
def arm(request, tmp_path_factory):
    """With an unknown base, the search is the same, but places each robot anew, which takes three times as long."""
    yaml = YAML.replace("frame: l0", f"frame: l0, pose: {request.param}")
    return calib.load(write_six_axis(tmp_path_factory.mktemp("arm"), yaml + FREE))


@pytest.fixture(scope="module")
def data(arm):
    return noisy(real(arm, 4), joints(60), SIGMA, 1)


def real(arm, seed):
    """The arm with errors as expected of its own origins."""
    sigmas = np.array([p.sigma_si * (p.prior and not p.placement) for p in arm.parameters])
    return arm.with_parameters(arm.values + sigmas * np.random.default_rng(seed).standard_normal(len(sigmas)))


def joints_as(change):
    """A mistake in the columns of the joints."""
    return lambda arm, data: replace(data, joints=change(data.joints.copy()))


def points_as(change):
    """A mistake in the measured positions."""
    return lambda arm, data: with_points(arm, data, change(data.points(arm)))


def turned(*which):
    """Joint values with the signs of these joints turned."""
    return lambda q: q * np.where(np.isin(np.arange(q.shape[1]), which), -1, 1)


def shifted(rows):
    """Joint values so many rows below their measurements."""

    def change(_, data):
        n = np.arange(len(data) - abs(rows))
        beside, measured = (n, n + rows) if rows > 0 else (n - rows, n)
        return replace(data.subset(measured), joints=data.joints[beside], order=None)

    return change


def mapped(low, high):
    """Columns [deg] that hold parts of the range from -3 to 3 rad."""
    return joints_as(lambda q: np.radians(low + (q + 3.0) / 6.0 * (high - low)))


def scaled(by):
    return points_as(lambda p: by * p)


RIGHT_ZERO = "joint {} counted from another zero ({} would be right)"
MISTAKES = {
    "a sign": (joints_as(turned(2)), "joint j3 has the wrong sign"),
    "swapped columns": (joints_as(lambda q: q[:, [0, 2, 1, 3, 4, 5]]), "columns of joints j2 and j3 were swapped"),
    "three columns": (
        joints_as(lambda q: q[:, [0, 2, 3, 1, 4, 5]]),
        "the columns of joints j2, j3, j4 were in another order (j2 in that of j4, j3 in that of j2, j4 in that of j3)",
    ),
    "four columns": (
        joints_as(lambda q: q[:, [1, 0, 2, 3, 5, 4]]),
        "joints j1, j2, j5, j6 were in another order (j1 in that of j2, j2 in that of j1, j5 in",
    ),
    "two signs": (joints_as(turned(1, 4)), "joints j2, j5 have the wrong sign. Corrected"),
    "four signs": (joints_as(turned(0, 1, 3, 5)), "joints j1, j2, j4, j6 have the wrong sign. Corrected"),
    "a zero": (joints_as(lambda q: q - np.eye(6)[2] * np.pi / 2), RIGHT_ZERO.format("j3", "j3 +90 deg")),
    "two zeros": (
        joints_as(lambda q: q + (np.eye(6)[2] + np.eye(6)[4]) * np.pi),
        f"{RIGHT_ZERO.format('j3', 'j3 +180 deg')} and {RIGHT_ZERO.format('j5', 'j5 +180 deg')}",
    ),
    "sign and zero": (
        joints_as(lambda q: turned(2)(q) + np.eye(6)[2] * np.pi / 2),
        RIGHT_ZERO.format("j3", "90 deg - j3"),
    ),
    "the row before": (shifted(1), "all joint values are one row below their measurements"),
    "the row behind": (shifted(-1), "all joint values are one row above their measurements"),
    "counts": (mapped(0, 4095), "mapped from the joints' limits to the range 0 to 4095"),
    "degrees": (joints_as(np.degrees), "degrees read as radians"),
    "radians": (joints_as(np.radians), "radians read as degrees"),
    "mm": (scaled(1e3), "mm were read as m"),
    "half an inch": (scaled(1 / 2.54), "tenths of an inch were read as mm"),
    "no unit": (scaled(0.2), " times as long as the robot's, which no usual unit explains"),
    "a left hand": (points_as(lambda p: p * [1, -1, 1]), "y of the measured positions had the wrong sign"),
    # beyond those of `make test`
    **{f"sign of j{j + 1}": (joints_as(turned(j)), f"joint j{j + 1} has the wrong sign") for j in (0, 1, 3, 4, 5)},
    "percent": (mapped(-100, 100), "mapped from the joints' limits to the range -100 to 100"),
    "parts": (mapped(0, 1), "mapped from the joints' limits to the range 0 to 1"),
    "m": (scaled(1e-3), "m were read as mm"),
    "inches as m": (scaled(1 / 0.0254), "inches were read as m"),
    "feet": (scaled(1 / 304.8), "feet were read as mm"),
    "cm": (scaled(0.1), "cm were read as mm"),
    "swapped positions": (points_as(lambda p: p[..., [2, 1, 0]]), "x and z of the measured positions were swapped"),
    "turned positions": (
        points_as(lambda p: p[..., [1, 2, 0]] * [1, 1, -1]),
        "(x in the column of z, y in the column of x, z in the column of y)",
    ),
}


@pytest.mark.quick(20)
@pytest.mark.parametrize("what", MISTAKES)
def test_a_mistake_is_named(arm, data, what):
    mistake, words = MISTAKES[what]
    said = likely_mistake(arm, mistake(arm, data))
    assert said.startswith("probable mistake: ")
    assert words in said


def test_good_measurements_and_measurements_of_other_poses_show_no_mistake(arm, data):
    assert likely_mistake(arm, data) == ""
    assert likely_mistake(arm, replace(data, joints=data.joints[::-1])) == ""


@pytest.mark.amount(1, 4)
def test_a_shift_is_named_where_rows_are_held_out(arm, data, amount):
    """The file is shifted, and then split: rows that were neighbours in it need not be so any more."""
    for rows in (3, -5, -2, 4)[:amount]:
        used, _ = shifted(rows)(arm, data).split(validation=0.25)
        side = "below" if rows > 0 else "above"
        assert f"all joint values are {abs(rows)} rows {side} their measurements" in likely_mistake(arm, used)


@pytest.mark.amount(1, 5)
def test_a_scaled_joint_is_named_with_its_factor(arm, data, amount):
    for joint, factor in ((4, 10 / 9), (0, 1.1), (3, 0.5), (1, 2.0), (5, 0.7))[:amount]:
        q = data.joints.copy()
        q[:, joint] *= factor
        told = likely_mistake(arm, replace(data, joints=q), 0.1)
        said = re.search(r"joint (j\d) was scaled by ([\d.]+) \+- ([\de.-]+) \(([\d.]+) \* j\d", told)
        assert said[1] == f"j{joint + 1}"
        assert abs(float(said[2]) - factor) < max(2 * float(said[3]), 1e-3)
        assert float(said[4]) == pytest.approx(1 / factor, abs=2e-3)
        assert ("gon read as degrees" in told) == (factor == 10 / 9)


@pytest.mark.parametrize("joint", [1, 3])
def test_no_scale_is_named_where_a_fit_with_scales_fits_nothing_either(arm, data, joint):
    """Absolute values, and values of other rows: free scales of all joints halve the noise, and explain nothing."""
    for change in (np.abs, np.flip):
        q = data.joints.copy()
        q[:, joint] = change(q[:, joint])
        assert "scaled" not in likely_mistake(arm, replace(data, joints=q), 0.4)


@pytest.mark.quick(0)
def test_two_joints_that_are_a_little_scaled_get_no_pass(arm, data):
    """Three percent of two wrist joints: the nominal robot is off by less than half as much."""
    wrong = replace(data, joints=data.joints * [1, 1, 1, 1.03, 1.03, 1])
    verdict = calib.fit(arm, wrong).verdict
    assert verdict.grade != "PASS"
    assert "joint j4 was scaled by 1.03 " in verdict.reasons[0].text
    assert "joint j5 was scaled by 1.03 " in verdict.reasons[0].text
    with_gains = calib.fit(arm, wrong, terms="auto").verdict
    assert with_gains.grade != "PASS"
    assert "joint j4 0.9709 times as far, joint j5 0.9709 times as far" in str(with_gains)


def test_readings_of_zero_are_named_alone_and_beside_another_mistake(arm, data):
    positions = data.points(arm)
    positions[[7, 30]] = 0.0
    wrong = with_points(arm, data, positions)
    zeros = "probable mistake: 2 readings of exactly 0, 0, 0 (row 7, row 30) were empty"
    assert likely_mistake(arm, wrong).startswith(f"{zeros}. Corrected")
    wrong = replace(wrong, joints=turned(2)(wrong.joints))
    assert likely_mistake(arm, wrong).startswith(f"{zeros}, and joint j3 has the wrong sign. Corrected")


def test_columns_that_are_copies_are_named(arm, data):
    wrong = calib.as_measurements(arm, data, data.points(arm)[..., [0, 0, 2]])
    copied = "column ball_y is a copy of ball_x; they are equal in every row"
    assert likely_mistake(arm, wrong) == f"probable mistake: {copied}"


@pytest.mark.quick(0)
@pytest.mark.parametrize("arm", ["known", "unknown"], indirect=True)
@pytest.mark.amount(1, 20)
def test_healthy_arms_show_no_mistake(arm, amount):
    for seed in range(amount):
        assert likely_mistake(arm, noisy(real(arm, seed), joints(60, seed), SIGMA, seed)) == ""


OF_FIVE_BAR = {
    "a motor half a turn off": (
        joints_as(lambda q: q + np.array([0.0, np.pi])),
        "(right_motor -180 deg would be right)",
    ),
    "a shifted table": (lambda robot, data: shifted(1)(robot, data[np.arange(20)]), MISTAKES["the row before"][1]),
    "none": (lambda _, data: data.subset(np.sort(np.random.default_rng(1).permutation(len(data))[:25])), ""),
}


@pytest.mark.quick(1)
@pytest.mark.parametrize("what", OF_FIVE_BAR)
def test_a_mistake_with_a_five_bar_is_named(what):
    robot, (mistake, words) = calib.load(EXAMPLES / "five_bar.yaml"), OF_FIVE_BAR[what]
    data = calib.read_measurements(EXAMPLES / "five_bar_simulated.csv", robot)
    said = likely_mistake(robot, mistake(robot, data))
    assert words in said
    assert bool(said) == bool(words)


@pytest.mark.quick(0)
@pytest.mark.amount(1, 2)
def test_a_healthy_real_arm_shows_no_mistake(shared_data, amount):
    robot, data, _ = motoman(shared_data / "motoman_right")
    generator = np.random.default_rng(1)
    for _ in range(amount):
        assert likely_mistake(robot, data.subset(np.sort(generator.permutation(len(data))[:100]))) == ""


@pytest.mark.quick(0)
def test_mistakes_in_the_data_of_a_real_arm_are_named(shared_data):
    robot, data, _ = motoman(shared_data / "motoman_right")
    data = data.subset(np.arange(50))
    signs = np.array([1, -1, -1, -1, 1, 1, 1])
    assert "joints S, L, U have the wrong sign" in likely_mistake(robot, replace(data, joints=signs * data.joints))
    assert "all joint values are one row below their measurements" in likely_mistake(robot, shifted(1)(robot, data))


@pytest.mark.quick(0)
@pytest.mark.parametrize("arm", ["unknown"], indirect=True)
def test_a_left_handed_frame_somewhere_is_named(arm, data):
    mistake = likely_mistake(arm, MISTAKES["a left hand"][0](arm, data))
    assert "left-handed" in mistake or "y of the measured positions had the wrong sign" in mistake


@pytest.mark.quick(0)
def test_a_closed_loop_robot_whose_loops_stay_open_is_told_the_mistake(medrue):
    q = np.array(target_workspace().q)[::20]
    swapped = calib.as_measurements(medrue, q[:, [0, 1, 3, 2, 4, 5]], forward(q, table1().actual).p_world_tool[:, None])
    with pytest.raises(calib.UnreachablePoseError, match="columns of joints q3 and q4 were swapped"):
        calib.fit(medrue, swapped)


def test_a_first_point_that_is_the_origin_of_the_frame_is_no_lost_sight(arm, data):
    first = with_points(arm, data, data.points(arm) - data.points(arm)[:1])
    assert not {"zero_readings", "likely_mistake"} & set(calib.fit(arm, first).verdict.to_dict()["codes"])


def test_an_error_names_readings_of_zero_that_no_mistake_explains(arm, data, monkeypatch):
    def fails(*_):
        raise calib.ComputationError("the robot cannot be assembled")

    monkeypatch.setattr("calib.core.calibrating.calibrate.minimum_of", fails)
    wrong = data.points(arm).copy()
    wrong[[2, 7]] = 0.0
    dead = with_points(arm, replace(data, joints=data.joints[::-1]), wrong)  # and the rows are other poses'
    said = "cannot be assembled; 2 poses were read at exactly 0, 0, 0, .*: row 2, row 7; leave them out$"
    with pytest.raises(calib.ComputationError, match=said):
        calib.fit(arm, dead)
    with pytest.raises(calib.ComputationError, match=r"the robot cannot be assembled$"):
        calib.fit(arm, replace(data, joints=data.joints[::-1]))
