"""Patterns of residuals: each is found where it is, and said in its own words, and in good data there is none."""

import dataclasses
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import f

import calib
from calib.core.data.measurements import directions_of_motion
from calib.core.judging import findings, residual_patterns
from calib.core.judging.effect_kinds import Family, Kind, Pattern, describe
from calib.core.judging.effects import ORDERS, Effects, wave_orders
from calib.core.judging.verdict import not_covered
from calib.core.numerics.tall import Span
from tests.six_axis_arm import FREE, YAML, joints, measurements, write_six_axis

SIGMA = 4e-5
N_WAVES = 3 * 6 * 119
"""Tests of waves, times three families: six joints that go through less than half a turn show all but the first."""


def fitted(arm, q_true, shift=0.0, q=None, seed=3):
    """A fit of joint values, `joints(n)` if not given, while the robot really stood at q_true."""
    return calib.fit(arm, noisy_data(arm, arm.positions(q_true) + shift, q, seed))


def noisy_data(arm, positions, q=None, seed=3):
    noise = SIGMA * np.random.default_rng(seed).standard_normal(positions.shape)
    return measurements(arm, joints(len(positions)) if q is None else q, positions + noise)


def significant(fit):
    return [pattern for pattern in fit.patterns if pattern.significant]


def off(joint, by, q=None):
    """Where joints stand at q, `joints(n)` if not given, one of them off."""
    return (joints(len(by)) if q is None else q) + np.outer(by, np.eye(6)[joint])


def played(q, by):
    """Where joints stand if the third has play."""
    return off(2, by * directions_of_motion(q)[:, 2], q)


def course(n=80):
    return np.linspace(0, 1, n)[:, None, None]


def centred(arm):
    positions = arm.positions(joints(80))
    return positions - positions.mean(axis=0)


@pytest.fixture(scope="module")
def stiff(tmp_path_factory):
    """The arm with one axis unknown and all lengths known."""
    yaml = YAML + "  - {origin: j3, components: [rx, rz], sigma: 5 mrad}\n"
    return calib.load(write_six_axis(tmp_path_factory.mktemp("stiff"), yaml))


MOVED = np.where(np.arange(80) < 50, 0.0, 2e-4)[:, None, None] * [0.0, 1.0, 0.0]
"""A tracker that moved while measuring."""


def test_the_direction_of_motion_is_kept_while_a_joint_stands_still():
    q = np.array([[0, 0], [1, 0], [1, -2], [0.5, -2], [0.5, 3], [0.5, 3]], dtype=float)
    np.testing.assert_array_equal(directions_of_motion(q), [[0, 0], [1, 0], [1, -1], [-1, -1], [-1, 1], [-1, 1]])


def test_a_hold_out_set_keeps_the_directions_of_the_whole_file(arm):
    data = measurements(arm, joints(10), arm.positions(joints(10)))
    part = data.subset(np.array([4, 7]))
    np.testing.assert_array_equal(part.approach_directions, directions_of_motion(data.joints)[[4, 7]])


WAVE = 2e-4 * np.cos(np.outer([3, 20, 50], joints(80)[:, 1]) + 0.4)
SCALE = 3e-4  # of 80 positions of 40 um over 0.6 m, which leave 2 % of it
FOUND = [
    ("arm", off(2, 2e-3 * joints(80)[:, 1]), None, "coupling", "j3", 2e-3, "off by +2 mrad for each rad of joint j2"),
    ("arm", off(2, 2e-3 * joints(80)[:, 3]), None, "coupling", "j3", 2e-3, "off by +2 mrad for each rad of joint j4"),
    ("arm", played(joints(80), 1e-4), None, "approach", "j3", 1e-4, "deg with the direction of approach"),
    ("arm", off(1, WAVE[0]), None, "wave", "j2", 2e-4, "3 cycles a turn, amplitude 0.01"),  # 2e-4 rad are 0.0115 deg
    ("arm", off(1, WAVE[1]), None, "wave", "j2", 2e-4, "with 20 cycles a turn, amplitude 0.01"),
    ("arm", off(1, WAVE[2]), None, "wave", "j2", 2e-4, "with 50 cycles a turn, amplitude 0.01"),
    ("arm", None, lambda _: MOVED, "drift", "xyz", None, "if a tracker or base had moved"),
    ("arm", off(2, 4e-4 * (np.arange(80) >= 40)), None, "zero", "j3", None, "joint j3 changes in the course of"),
    ("arm", None, lambda at: course() * np.cross([2e-4, 3e-4, 0], at), "turning", "xyz", None, "had turned"),
    ("arm", None, lambda at: 5e-4 * course() * at, "growth", "xyz", None, "warmed up"),
    ("stiff", None, lambda _: np.array([0, 0, -3e-5]), "axis", "z", 3e-5, "a constant shift of +0.0"),
    ("stiff", None, lambda at: SCALE * at, "scale", "xyz", SCALE, "lengths that are all read +3"),
    ("stiff", None, lambda at: np.cross([0, 0, 3e-4], at), "turn", "xyz", None, "a turn of the measurement frame"),
]
"""Robot, where its joints stood, how far readings are off; and the pattern: kind, name, amount, and words on it."""


@pytest.mark.parametrize(("robot", "stood", "shift", "kind", "name", "amount", "words"), FOUND)
def test_a_pattern_is_found_without_stated_noise(request, robot, stood, shift, kind, name, amount, words):
    robot = request.getfixturevalue(robot)
    patterns = significant(
        fitted(robot, joints(80) if stood is None else stood, shift(centred(robot)) if shift else 0.0)
    )
    pattern = next(pattern for pattern in patterns if (pattern.kind, pattern.name) == (kind, name))
    assert pattern is patterns[0] or kind in ("coupling", "scale", "turn")
    assert amount is None or abs(pattern.amount) == pytest.approx(amount, rel=0.3 if amount < 2e-4 else 0.1)
    assert words in describe(pattern, robot.mechanism.dimensions)
    smooth = ("joint", "j2") in [(other.kind, other.name) for other in patterns]
    assert smooth or not words.startswith("3 cycles")


def test_patterns_of_very_many_poses_are_judged_on_some_of_them_and_the_claim_on_all(arm, monkeypatch):
    q = joints(400)
    q[:, 5] = np.tile([-1.0, 0.0, 1.0, 0.5], 100)  # a regular step of 4 would meet one of these values alone
    data = noisy_data(arm, arm.positions(played(q, 1e-4)), q)
    whole = calib.fit(arm, data)
    assert findings.sample_of_poses(whole) is whole
    assert whole.budget.n_poses == whole.verdict.claim.at_measured_poses.n_poses == 400
    monkeypatch.setattr(findings, "MOST_POSES", 100)
    fit = calib.fit(arm, data)
    judged = findings.sample_of_poses(fit).identification.data
    np.testing.assert_array_equal(judged.places // 4, np.arange(100))
    assert len(np.unique(judged.joints[:, 5])) == 4
    for each in (whole, fit):
        assert (significant(each)[0].kind, significant(each)[0].name) == ("approach", "j3")
        assert abs(significant(each)[0].amount) == pytest.approx(1e-4, rel=0.2)
    assert fit.budget.n_poses == 100
    assert fit.verdict.claim == whole.verdict.claim
    assert fit.verdict.grade == whole.verdict.grade
    assert any("judged on 100 of 400 poses" in line for line in fit.verdict.not_covered)
    monkeypatch.setattr(findings, "MOST_POSES", 3)  # too few for a fit
    fit = calib.fit(arm, data)
    assert findings.sample_of_poses(fit) is fit


def test_rows_that_show_a_change_in_their_course_are_not_called_unordered(arm):
    assert not any("random order" in line for line in not_covered(fitted(arm, joints(80), shift=MOVED)))
    assert any("random order" in line for line in not_covered(fitted(arm, joints(80))))


@pytest.mark.parametrize(
    ("rows_kept", "sums_at_once"), [(10, 1), (1000, 1 << 22)], ids=["many rows, a visit at a time", "few rows"]
)
def test_a_wave_is_tested_as_if_its_columns_were_written_out(arm, monkeypatch, rows_kept, sums_at_once):
    monkeypatch.setattr(residual_patterns, "KEPT", rows_kept)
    monkeypatch.setattr(residual_patterns, "_SUMS_AT_ONCE", sums_at_once)
    q = joints(80)
    fit = fitted(arm, off(1, 2e-4 * np.sin(7 * q[:, 1])))
    result = next(p for p in fit.patterns if (p.kind, p.detail) == ("wave", "7 cycles a turn"))
    setting, linear = findings.setting(fit), findings.linear(fit)
    by_joint = setting.joint_columns[:, 1]
    z = by_joint[:, None] * np.repeat(np.column_stack([np.sin(7 * q[:, 1]), np.cos(7 * q[:, 1])]), 3, axis=0)
    r = linear.rows.residuals
    span = linear.span[:]
    left = z - span @ (span.T @ z)
    coefficients = np.linalg.solve(z.T @ left, z.T @ r)
    gain = r @ z @ coefficients
    variance_ratio = (gain / 2) / ((r @ r - gain) / (linear.freedom - 2))
    assert result.amount == pytest.approx(np.linalg.norm(coefficients), rel=1e-9)
    assert result.p_value == pytest.approx(N_WAVES * f.sf(variance_ratio, 2, linear.freedom - 2), rel=1e-6, abs=0.0)


@pytest.mark.parametrize(("seed", "height"), [(18, 0.0), (3, 8e-5)])
def test_where_readings_of_a_pose_share_an_error_a_finding_needs_poses_foretold_by_all_others(arm, seed, height):
    """Fits by numpy, without each pose in turn. The fit of all takes 76 cycles of a sound joint for a finding."""
    rng, q = np.random.default_rng(seed), joints(60, seed)
    points = arm.positions(q + height * np.eye(6)[1] * np.sin(5 * q[:, 1:2]))
    q, points = (np.repeat(x, 3, axis=0) for x in (q, points + SIGMA * rng.standard_normal(points.shape)))
    poses = calib.Poses(q, tuple(map(str, range(180))), tuple(str(k // 3) for k in range(180)), "test", ())
    fit = calib.fit(arm, calib.as_measurements(arm, poses, points + SIGMA / 2 * rng.standard_normal(points.shape)))
    joint, order = (1, 5) if height else (4, 76)
    tested = (p for p in fit.patterns if (p.kind, p.name) == ("wave", f"j{joint + 1}"))
    result = next(p for p in tested if p.detail.startswith(f"{order} "))
    assert result.significant == (height > 0)
    setting, linear = findings.setting(fit), findings.linear(fit)
    by_joint = setting.joint_columns[:, joint]
    phase = np.repeat(order * q[:, joint], 3)
    span, r = linear.span[:], linear.rows.residuals
    z = by_joint[:, None] * np.column_stack([np.sin(phase), np.cos(phase)])
    left = z - span @ np.linalg.lstsq(span, z, rcond=None)[0]
    gain = np.sum((left @ np.linalg.lstsq(left, r, rcond=None)[0]) ** 2)
    pose, both, scores = np.repeat(np.arange(60), 9), np.hstack([span, z]), []
    directions = np.linalg.qr(left)[0]
    for k in range(60):
        others, own = pose != k, pose == k
        scores.append(
            directions[own].T @ (r[own] - both[own] @ np.linalg.lstsq(both[others], r[others], rcond=None)[0])
        )
    inflation = np.sum(np.square(scores)) / (2 * linear.factor**2)
    ratio = (gain / 2) / ((r @ r - gain) / (linear.freedom - 2)) / inflation
    assert result.p_value == pytest.approx(N_WAVES * f.sf(ratio, 2, linear.pose_freedom - 2), rel=1e-6, abs=0.0)


@pytest.mark.quick(0)
@pytest.mark.amount(10, 100)
def test_good_data_show_a_pattern_in_one_set_of_a_hundred(arm, amount):
    with_patterns = sum(bool(significant(fitted(arm, joints(80), seed=seed))) for seed in range(amount))
    assert with_patterns <= (4 if amount == 100 else 1)  # chance of more: 0.3 %, and 0.4 %


def test_a_constant_shift_is_not_tested_where_the_base_is_free(tmp_path):
    robot = calib.load(write_six_axis(tmp_path, YAML.replace("frame: l0", "frame: l0, pose: unknown") + FREE))
    fit = fitted(robot, joints(80))
    assert not any(pattern.kind == "axis" for pattern in fit.patterns)


def test_enough_data_do_not_make_a_trifle_a_finding(arm):
    fit = fitted(arm, played(joints(3000), 6e-6))  # a tenth of the noise at the ball
    trifle = next(p for p in fit.patterns if (p.kind, p.name) == ("approach", "j3"))
    assert trifle.p_value < 1e-3
    assert not trifle.significant


def test_a_joint_that_always_moves_the_same_way_has_no_direction_to_compare(arm):
    q = joints(60)
    q = q[np.argsort(q[:, 0])]
    fit = fitted(arm, q, q=q, seed=1)
    tested = {pattern.name for pattern in fit.patterns if pattern.kind == "approach"}
    first_pose_only = dataclasses.replace(fit.identification.data, approach=np.ones((60, 6)))
    again = calib.fit(arm, first_pose_only)
    assert tested >= {"j2", "j3"}
    assert not any(pattern.kind == "approach" for pattern in again.patterns)


def test_nothing_is_put_down_to_a_joint_that_never_moved(prior_arm):
    """The tracker drifts; joint 1, which stood still, moves the ball in much the same way."""
    q = joints(80)
    q[:, 0] = 0.2
    fit = fitted(prior_arm, q, 10 * SIGMA * course() * np.array([0.0, 1.0, 0.0]), q)
    assert "drift" in [pattern.kind for pattern in significant(fit)]
    assert "j1" not in [pattern.name for pattern in fit.patterns]


def test_an_error_that_follows_a_joint_is_no_sure_change_where_poses_are_sorted_by_it(arm):
    q = joints(80)
    q = q[np.argsort(q[:, 1])]
    sagging = fitted(arm, off(1, 2e-4 * np.sin(2 * q[:, 1]), q), q=q)
    assert ("zero", "j2") in [(p.kind, p.name) for p in significant(sagging)]
    assert findings.changes(sagging) == ()
    points = arm.positions(q)
    growing = fitted(arm, q, 3e-4 * course() * (points - points.mean(axis=0)), q)
    assert findings.changes(growing)[0].kind == "growth"


def test_rows_with_a_time_may_stand_in_any_order(arm):
    shift = course() * np.cross([2e-4, 3e-4, 0.0], centred(arm))
    data = noisy_data(arm, arm.positions(joints(80)) + shift)
    order = np.random.default_rng(1).permutation(80)
    shuffled = dataclasses.replace(data.subset(order), order=None, approach=None)
    assert "turning" not in [pattern.kind for pattern in significant(calib.fit(arm, shuffled))]
    timed = dataclasses.replace(shuffled, context={"time": 30.0 * order})
    assert significant(calib.fit(arm, timed))[0].kind == "turning"


def test_a_target_that_slips_is_found_with_its_size_and_row(arm):
    """The ball sits on link 6, whose axes the true robot turns: the slip is along its z."""
    q = joints(80)
    rotation = arm.forward(q, "l6")[:, :3, :3]
    slip = np.where(np.arange(80) >= 45, 2e-4, 0.0)[:, None] * rotation[:, :, 2]
    pattern = significant(fitted(arm, q, shift=slip[:, None]))[0]
    assert (pattern.kind, pattern.name) == ("slip", "ball")
    assert pattern.amount == pytest.approx(2e-4, rel=0.25)
    row = int(pattern.detail.split()[2])
    assert abs(row - 45) <= 5  # places are 5 rows apart
    assert describe(pattern, arm.mechanism.dimensions).startswith(f"from row {row} on, target ball sits")


def test_every_kind_says_its_own_sentence():
    dimensions = {"turn": "angle", "slide": "length"}
    said = {kind: describe(Pattern(kind, "turn", 0.0, 2e-5, 3e-4, True, detail="slide"), dimensions) for kind in Kind}
    assert said == {
        Kind.AXIS: "a constant shift of +0.3 mm along turn",
        Kind.TURN: "a turn of the measurement frame (0.02 mm RMS)",
        Kind.SCALE: "lengths that are all read +300 ppm too long (0.02 mm RMS)",
        Kind.OFFSET: "readings of turn are off by +0.3 mm (0.02 mm RMS)",
        Kind.FACTOR: "readings of turn are +300 ppm too large (0.02 mm RMS)",
        Kind.DRIFT: "a shift in the course of the measurement, as if a tracker or base had moved (0.02 mm RMS)",
        Kind.TURNING: "a turn in the course of the measurement, as if a tracker or base had turned (0.02 mm RMS)",
        Kind.GROWTH: "lengths that change in the course of the measurement, as if robot or instrument warmed up"
        " (0.02 mm RMS)",
        Kind.SLIP: "slide, target turn sits 0.3 mm elsewhere on its link (0.02 mm RMS)",
        Kind.LINK: "target turn moves with joint slide, as if it sat on the link behind it, 0.3 mm from where the model"
        " has it (0.02 mm RMS)",
        Kind.JOINT: "it follows joint turn (0.02 mm RMS)",
        Kind.COUPLING: "joint turn is off by +0.3 mrad for each m of joint slide (0.02 mm RMS)",
        Kind.WAVE: "it follows joint turn with slide, amplitude 0.017 deg (0.02 mm RMS)",
        Kind.APPROACH: "joint turn differs by 0.034 deg with the direction of approach (0.02 mm RMS)",
        Kind.ZERO: "joint turn changes in the course of the measurement (0.02 mm RMS)",
    }
    assert {kind.family for kind in Kind} == set(Family)


@pytest.mark.parametrize(("step", "true", "beyond"), [(5, 1, 71), (20, 3, 93)])
def test_of_joint_values_on_a_grid_the_lowest_number_of_cycles_is_named(arm, step, true, beyond):
    """On a grid of 5 degrees 71 cycles are at every pose minus 1 cycle, on one of 20 degrees 93 are 3."""
    grid = np.deg2rad(step) * np.round(np.rad2deg(joints(80)) / step)
    assert np.allclose(np.cos(beyond * grid[:, 1]), np.cos(true * grid[:, 1]))
    assert wave_orders(grid)[1].stop - 1 == 180 // step
    assert wave_orders(joints(80))[1].stop == ORDERS.stop


def geared(n):
    """Where joints stand at `joints(n)` if the second follows a wave."""
    return off(1, 3e-3 * np.sin(41 * joints(n)[:, 1]))


def test_a_number_of_cycles_that_few_poses_do_not_determine_is_not_named(arm):
    waves = [p for p in fitted(arm, geared(16)).patterns if p.kind == "wave" and p.name == "j2"]
    assert [p.detail for p in waves] == ["a number of cycles a turn that these poses do not determine"]
    assert "joint j2 with a number of cycles a turn that" in describe(waves[0], arm.mechanism.dimensions)


def test_no_range_of_cycles_is_named_that_is_all_that_were_tried(arm):
    """On eleven poses beside 26 parameters any number of cycles explains the residuals."""
    waves = [p.detail for p in fitted(arm, geared(11)).patterns if p.kind == "wave"]
    assert waves
    assert all(not detail.startswith(("1 to ", "2 to ")) for detail in waves)


def test_effects_at_visits_of_unequal_length_are_summed_as_if_their_columns_were_written_out():
    rng = np.random.default_rng(7)
    visit = np.repeat(np.arange(300), rng.integers(3, 12, size=300))
    n = len(visit)
    base, span, r, factors = (rng.normal(size=shape) for shape in ((n, 4), (n, 5), n, (300, 2, 3)))
    linear = SimpleNamespace(span=Span(span, np.eye(5)), rows=SimpleNamespace(residuals=r))
    effect = Effects(Kind.DRIFT, "xyz", base, visit, factors)
    ((squares, moments),) = residual_patterns._moments(linear, [effect])
    for number in range(3):
        z = effect.columns(number)
        np.testing.assert_allclose(squares[number], z.T @ z, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(moments[:, :, number], np.vstack([r, span.T]) @ z, rtol=1e-9, atol=1e-9)


def test_sums_over_visits_take_no_memory_for_all_visits_at_once():
    rng, n = np.random.default_rng(8), 40_000
    base, span, r, factors = (rng.normal(size=shape) for shape in ((n, 8), (n, 40), n, (n // 2, 1, 1)))
    linear = SimpleNamespace(span=Span(span, np.eye(40)), rows=SimpleNamespace(residuals=r))
    effect = Effects(Kind.DRIFT, "xyz", base, np.repeat(np.arange(n // 2), 2), factors)
    tracemalloc.start()
    list(residual_patterns._moments(linear, [effect]))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * (n // 2) * 8 * (8 + 41) / 4  # bytes: a quarter of all sums; few are in memory
