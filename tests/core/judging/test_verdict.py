"""What reasons of a verdict depend on, beside the one situation of each in test_every_reason.py."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import calib
from calib.core.data.measurements import with_points
from calib.core.fitting.outliers import studentise_errors
from calib.core.fitting.solved_fit import Convergence
from calib.core.judging import findings
from calib.core.judging.better_or_worse import _margin_above_mean
from calib.core.judging.next_step import next_step
from calib.core.judging.reasons import Code
from calib.core.judging.rounded_joint_values import joint_steps, rounding
from calib.core.judging.row_derivatives import scales
from calib.core.judging.rules_reach import _covariance_given
from calib.core.judging.verdict import unordered
from tests.core.judging.situations import SIGMA
from tests.project import EXAMPLES, copied
from tests.six_axis_arm import FREE, YAML, joints, measurements, noisy, write_six_axis


def reason(fit, code):
    matching = [reason for reason in fit.verdict.reasons if reason.code == code]
    assert matching, [reason.text for reason in fit.verdict.reasons]
    return matching[0]


def remark(fit, code):
    """What is no doubt, since poses that were not used are as far off as claimed."""
    verdict_reason = reason(fit, code)
    assert (verdict_reason.grade, verdict_reason.counted, fit.verdict.claim.holds) == ("PASS", True, True)
    return verdict_reason


def test_a_good_fit_passes_without_reasons(shop):
    good = shop.good
    assert good.verdict.grade == "PASS"
    assert good.verdict.reasons == ()
    said = good.verdict.to_dict()
    assert said.pop("not_covered") == list(good.verdict.not_covered)
    assert said.pop("claim") == good.verdict.claim.to_dict()
    assert said == {"grade": "PASS", "reasons": [], "codes": [], "grades": []}
    assert "Verdict: PASS" in good.report()


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("end", "words"),
    [
        (Convergence(False, "the limit of evaluations was reached", 0.01, "j1.x", True), "the limit of evaluations"),
        (Convergence(False, "the sum no longer changes", 12.0, "j1.x", True), "j1.x would still move by 12 standard"),
        (Convergence(False, "the sum no longer changes", 0.0, "j1.x", False), "weights of the robust loss"),
        (
            Convergence(False, "", 2.0, "j1.x", True, ("j1.y", "j2.x")),
            "do not determine j1.y, j2.x: the fit would move them without limit",
        ),
    ],
)
def test_not_converged_fails(shop, end, words):
    failed = replace(shop.good, convergence=end)
    assert failed.verdict.grade == "FAIL"
    assert words in reason(failed, "not_converged").text
    assert failed.verdict.reasons[0].grade == "FAIL"
    assert ("calib check" if end.receding_parameters else "--starts 5") in next_step(failed).command


@pytest.mark.parametrize(
    ("robot", "noise", "other", "grade", "words"),
    [
        ("truth", 4, None, "PASS", "0.1.* per axis where 0.04 mm was stated.* get better by more than chance explains"),
        ("arm", 500, None, "FAIL", "a healthy robot does not leave more than 1 % of the measured space"),
        ("truth", 4, ("arm", 1), "FAIL", "or prove the result on other poses .--validate, --folds."),
        ("arm", 4, ("arm", 4), "PASS", "get neither better nor worse"),
    ],
    ids=["proven by poses left out unasked", "an unfit model", "another robot", "nothing to correct"],
)
def test_more_noise_than_stated_is_no_doubt_only_where_unused_poses_do_not_get_worse(
    shop, robot, noise, other, grade, words
):
    data = noisy(getattr(shop, robot), joints(80), noise * SIGMA, 1)
    unused = other and noisy(getattr(shop, other[0]), joints(30, 5), other[1] * SIGMA, 2)
    fit = calib.fit(shop.arm, data, sigma=SIGMA, validation=unused)
    said = remark(fit, "noise") if grade == "PASS" else reason(fit, "noise")
    assert said.grade == fit.verdict.grade == grade
    assert re.search(words, said.text)
    assert (fit.folds is None) == (grade == "FAIL")
    assert (robot == "arm" and grade == "PASS") == ("nothing_to_correct" in fit.verdict.to_dict()["codes"])


@pytest.mark.parametrize("loss", ["none", "huber"])
@pytest.mark.parametrize("stated", [0.5 * SIGMA, 0.01 * SIGMA])
def test_priors_are_weighed_by_the_noise_found_where_it_contradicts_what_is_stated(prior_arm, truth, stated, loss):
    """As where it is not stated, whatever was stated; where they do not contradict it, it counts."""
    data = noisy(truth, joints(80), SIGMA, 1)
    contradicted, unstated = (calib.fit(prior_arm, data, sigma=sigma, loss=loss) for sigma in (stated, None))
    np.testing.assert_allclose(contradicted.sigma, unstated.sigma, rtol=0.03)
    change = (contradicted.robot.values - unstated.robot.values)[unstated.unknowns.index]
    far = np.abs(change) / unstated.statistics.std
    assert far.max() < 0.1
    assert contradicted.scales * stated == pytest.approx(unstated.scales, rel=0.03)
    believed = calib.fit(prior_arm, data, sigma=2 * SIGMA, loss=loss)
    assert believed.scales == 1.0


@pytest.mark.parametrize(("rows", "parameters", "others"), [(180, 28, 60), (45, 30, 30)])
def test_a_robot_that_needs_no_correction_is_rarely_said_to_get_worse_also_where_the_noise_is_hardly_known(
    rows, parameters, others
):
    """Linear fits of noise alone, 5000 of them: with chi-square in the place of F, 2.2 % of the smaller ones got worse.

    One in a thousand is aimed at; the two parts of the change are not independent, which makes it 0.25 %.
    """
    rng = np.random.default_rng(0)
    used, there = (rng.standard_normal((n, parameters)) for n in (rows, others))
    known = np.linalg.inv(used.T @ used)
    off = rng.standard_normal((5000, parameters)) @ np.linalg.cholesky(known).T @ there.T
    noise = rng.standard_normal((5000, others))
    found = rng.chisquare(rows - parameters, 5000) / (rows - parameters)
    before, after = (np.sum(errors**2, axis=1) / found for errors in (noise, noise + off))
    product = there.T @ there @ known
    expected = np.trace(product)
    mixed = np.maximum(1.0, np.minimum(before, after) / others) * expected
    limits = expected + np.array([_margin_above_mean(product, size, rows - parameters) for size in mixed])
    assert np.mean(after - before > limits) < 0.005


def test_where_validation_poses_lie_elsewhere_the_broken_claim_says_how_many(arm, truth):
    """Poses of one half of the first joint, judged by others: the errors of all of them are three times as large."""
    used, other = (q[q[:, 0] < 0.0] for q in (joints(160), joints(60, 5)))
    there = other + 1.5 * np.eye(6)[0]

    def said(q):
        fit = calib.fit(arm, noisy(truth, used, SIGMA, 1), validation=noisy(truth, q, 3 * SIGMA, 2))
        return reason(fit, "validation").text

    unit = np.std(used, axis=0)
    between = np.sort(np.linalg.norm((used[:, None] - used) / unit, axis=2), axis=1)[:, 1]
    away = np.min(np.linalg.norm((there[:, None] - used) / unit, axis=2), axis=1)
    counted = int(np.sum(away > np.sort(between)[int(0.95 * (len(used) + 1))]))
    assert 0.3 * len(there) < counted < len(there)
    named = re.search(r"\. (\d+) of them lie farther from the poses used", said(there))
    assert abs(int(named[1]) - counted) <= 1  # the limit is one of the distances beside each other
    assert "farther" not in said(other)


def test_too_few_poses_are_a_remark_only_where_poses_that_were_not_used_bear_the_claim_out(arm, truth):
    """48 coordinates are fewer than twice 26 parameters, and poses left out one by one are as few."""
    data, other = noisy(truth, joints(16), SIGMA, 1), noisy(truth, joints(60, seed=5), SIGMA, 2)
    assert reason(calib.fit(arm, data), "too_few_poses").grade == "CHECK"
    remark(calib.fit(arm, data, validation=other), "too_few_poses")


@pytest.mark.quick(0)
def test_validation_at_poses_that_the_fit_has_used_is_pointed_out(arm, truth):
    data = noisy(truth, joints(80), SIGMA, 1)
    again = calib.fit(arm, data, validation=noisy(truth, joints(80)[:30], SIGMA, 2))
    assert "30 of 30 validation poses were measured at poses of the fit" in reason(again, "used_for_both").text
    loaded = replace(noisy(truth, joints(80)[:30], SIGMA, 2), context={"load": np.full(30, 3.0)})
    assert "used_for_both" not in calib.fit(arm, data, validation=loaded).verdict.to_dict()["codes"]
    light = replace(loaded, context={"load": np.full(30, 0.01), "time": np.arange(30.0)})
    reason(calib.fit(arm, data, validation=light), "used_for_both")
    joined = np.concatenate([joints(30, 5), joints(80)[:1]])  # home, say, measured in both sessions
    assert calib.fit(arm, data, validation=noisy(truth, joined, SIGMA, 2)).verdict.grade == "PASS"


def test_a_placement_without_a_prior_may_be_anywhere(tmp_path):
    robot = calib.load(write_six_axis(tmp_path, YAML.replace("frame: l0", "frame: l0, pose: unknown") + FREE))
    moved = robot.with_parameters({"base.x": 3.0, "base.rz": 1.0})
    fit = calib.fit(robot, noisy(moved, joints(80), SIGMA, 1))
    assert "at_bounds" not in [reason.code for reason in fit.verdict.reasons]


@pytest.mark.parametrize("seed", range(2))
def test_a_healthy_robot_passes_although_the_fit_adds_its_own_noise(arm, seed):
    data, other = noisy(arm, joints(60, seed), SIGMA, seed), noisy(arm, joints(30, seed + 50), SIGMA, seed + 50)
    fit = calib.fit(arm, data, validation=other, folds=4)
    assert fit.verdict.grade == "PASS"
    text = reason(fit, "nothing_to_correct").text
    assert "on the validation poses RMS" in text
    assert "on poses left out in turn RMS" in text


STATED = (10 * SIGMA, SIGMA)


def test_a_gain_that_is_far_from_halving_the_error_proves_a_fit_with_more_noise_than_stated(shop, arm):
    """The joints sag with their angle, which the model leaves out: unused poses get better by a third or so."""
    truth = shop.off(arm, 0.2)

    def measured(q, seed):
        sagged = q + 3e-3 * np.sin(3 * q)
        return measurements(arm, q, noisy(truth, sagged, SIGMA, seed).points(arm))

    fits = [calib.fit(arm, measured(joints(80), 1), sigma=s, validation=measured(joints(30, 5), 2)) for s in STATED]
    rms = [fits[0].validation.table()[state]["rms"] for state in ("after", "before")]
    assert 0.5 < rms[0] / rms[1] < 0.9
    words = "poses that were not used get better by more than chance explains"
    assert words in remark(fits[0], "noise").text
    beyond = reason(fits[1], "noise")  # more than 20 times what was stated
    assert (beyond.grade, beyond.counted, fits[1].verdict.claim.holds) == ("CHECK", False, True)
    assert words in beyond.text
    assert "look at the targets' links" in beyond.text


def test_a_pose_that_only_curves_follow_is_not_said_to_decide_itself(tmp_path):
    curves = "  - {joint: all, term: curve, orders: 9}\n"
    robot, q = calib.load(write_six_axis(tmp_path, YAML + FREE + curves)), joints(80)
    gears = robot.positions(q + 0.01 * np.sin(7 * q))
    data = measurements(robot, q, gears + SIGMA * np.random.default_rng(1).standard_normal(gears.shape))
    fit = calib.fit(robot, data, sigma=SIGMA)
    assert np.max(studentise_errors(fit).largest_leverage) > 0.95
    assert "leverage" not in fit.verdict.to_dict()["codes"]


def test_poses_in_one_corner_are_told_and_the_claim_is_for_them(shop, prior_arm):
    fit = shop.situation(Code.ONE_CORNER).there
    remark(fit, "one_corner")
    assert (
        "95 % of the time, at poses like the 80 measured (each predicted from the others). Elsewhere errors may be"
        " larger; joints that moved through less than half of their range: j1 2 %, " in fit.verdict.claim.words
    )
    near = fit.identification.data.joints.copy()
    near[:, 2] = joints(80)[:, 2]  # one joint that moves is no corner
    again = calib.fit(prior_arm, noisy(prior_arm, near, SIGMA, 1), sigma=SIGMA)
    assert "one_corner" not in again.verdict.to_dict()["codes"]


def rounded_to(q, degrees):
    return np.radians(np.round(np.degrees(q) / degrees) * degrees)


@pytest.mark.parametrize("step", [0.02, 0.1, 5.0])
def test_a_robot_that_was_sent_to_round_values_is_not_called_rounded(arm, truth, step):
    fit = calib.fit(arm, noisy(truth, rounded_to(joints(80), step), SIGMA, 1))
    assert np.degrees(joint_steps(arm, fit.identification.data.joints)) == pytest.approx(step)
    assert "rounded" not in [reason.code for reason in fit.verdict.reasons]


def test_the_score_for_rounding_is_that_of_whole_matrices(arm, truth):
    """The sums over visits against Q and M written out."""
    fit = calib.fit(arm, noisy(truth, rounded_to(joints(40), 0.01), SIGMA, 1))
    setting = findings.setting(fit)
    columns = setting.joint_columns * np.radians(0.01) / np.sqrt(12)
    q = np.zeros((120, 120))
    for visit in range(40):
        rows = slice(3 * visit, 3 * visit + 3)
        q[rows, rows] = columns[rows] @ columns[rows].T
    m, r = findings.linear(fit).after_fit(np.eye(120)), findings.linear(fit).rows.residuals
    variance = r @ r / findings.linear(fit).freedom
    mean, square = np.trace(m @ q), np.trace(m @ q @ m @ q)
    _, part, chance = rounding(fit)
    assert part == pytest.approx(mean / variance / findings.linear(fit).freedom, rel=1e-6)
    freedom, statistic = mean**2 / square, r @ q @ r / variance
    assert chance == pytest.approx(chi2.sf(statistic * mean / square, freedom), rel=1e-6)


def test_a_scale_that_nothing_shows_is_named(tmp_path, prior_arm):
    free = calib.fit(prior_arm, noisy(prior_arm, joints(80), SIGMA, 1), sigma=SIGMA)
    (said,) = (text for text in free.verdict.not_covered if text.startswith("a scale error"))
    assert "nothing else of known length was measured" in said
    yaml = YAML + "  - {origin: j3, components: [rx, rz], sigma: 5 mrad}\n"
    robot = calib.load(write_six_axis(tmp_path, yaml))
    known = calib.fit(robot, noisy(robot, joints(3000), SIGMA, 1), sigma=SIGMA)
    assert not any("scale" in text for text in known.verdict.not_covered)


PLACE = "places: {hole: {frame: l0, xyz: [0.6, 0.2, 0.5], position: unknown, sigma: 20 mm}}"
PLATE = (
    "artefact: {frame: l0, xyz: [0.6, 0.2, 0.5], pose: unknown, points: {p: [0, 0, 0], q: [0.2, 0, 0], r: [0, 0.2, 0]}}"
)


@pytest.mark.parametrize(("touched", "least_mm", "most_mm"), [(PLACE, 0.5, 5.0), (PLATE, 0.0, 0.2)])
def test_a_claim_about_contacts_says_how_well_positions_are_known(tmp_path, touched, least_mm, most_mm):
    """A robot that is 0.3 % too large: contacts with one point fit, and leave positions off by more than they claim."""
    probe = f"instruments:\n  probe: {{kind: touch, target: ball, sigma: 0.02 mm, {touched}}}\n"
    yaml = YAML.replace("parametrisation:", probe + "parametrisation:").replace(
        "100 mm]}", "100 mm], position: unknown, sigma: 2 mm}"
    )
    robot = calib.load(write_six_axis(tmp_path, yaml + FREE))
    lengths = [p for p in robot.parameters if p.dimension == "length" and p.name[0] in "jb"]  # of joints and ball
    true = robot.with_parameters({p.name: 1.003 * p.nominal_si for p in lengths})
    fit = calib.fit(robot, calib.simulate(true, calib.sample(robot, 90, seed=1), None, np.random.default_rng(3)))
    assert fit.verdict.grade == "PASS"
    assert not fit.verdict.claim.at_measured_poses.is_position
    q = 0.5 * joints(200, 7)
    predicted, positions = fit.robot.positions(q)[:, 0], true.positions(q)[:, 0]
    off = 1e3 * np.sqrt(np.mean(np.sum((aligned(predicted, positions) - positions) ** 2, axis=1)))
    (line,) = (text for text in fit.verdict.not_covered if text.startswith("positions of the tool"))
    told = float(re.search(r"known to ([\d.]+) mm RMS", line)[1])
    assert "the claim is about points of contact" in line
    assert least_mm < told < most_mm
    assert off < 2 * told
    assert (off > 5e3 * fit.verdict.claim.at_measured_poses.limit95) == (touched == PLACE)
    (scale,) = (text for text in fit.verdict.not_covered if text.startswith("a scale error"))
    assert ("(nothing of known length" in scale) == (touched == PLACE)


def test_noise_that_nobody_stated_may_be_the_robots(arm, truth):
    """A robot with play that goes either way by chance: the sentence says how far off it is at other poses."""

    def played(q, seed):
        play = 2e-4 * np.random.default_rng(seed).choice([-1.0, 1.0], q.shape)
        return truth.positions(q + play)[:, 0]

    noise = SIGMA / 4 * np.random.default_rng(3).standard_normal((80, 3))
    data = with_points(arm, noisy(truth, joints(80), SIGMA, 1), (played(joints(80), 4) + noise)[:, None])
    fit, other = calib.fit(arm, data), joints(500, 5)
    (line,) = (text for text in fit.verdict.not_covered if text.startswith("scatter of the robot"))
    off = fit.predict(other).positions[:, 0] - played(other, 6)
    told = float(re.search(r"known to ([\d.]+) mm RMS", line)[1])
    assert told == pytest.approx(1e3 * np.sqrt(np.mean(np.sum(off**2, axis=1))), rel=0.15)
    assert fit.identification_uncertainty.summary()["rms"] == pytest.approx(told, rel=0.15)  # joints are off by it
    stated = calib.fit(arm, data, sigma=SIGMA / 4, validation=noisy(truth, joints(30, 5), SIGMA, 2))
    assert not any("not stated" in text for text in stated.verdict.not_covered)
    assert "more than chance" in reason(stated, "noise").text or "times what was stated" in reason(stated, "noise").text


def test_the_scale_that_shows_is_five_standard_deviations(arm, truth):
    """The column added to the Jacobian by hand, and its standard deviation by least squares."""
    fit = calib.fit(arm, noisy(truth, joints(80), SIGMA, 1), sigma=SIGMA)
    points = fit.identification.data.points(arm).reshape(-1, 3)
    column = -((points - points.mean(axis=0)) / SIGMA).reshape(-1, 1)
    both = np.hstack([fit.rows.jacobian, column])
    std = np.sqrt(np.linalg.inv(both.T @ both)[-1, -1]) * fit.sigma / SIGMA
    assert findings.linear(fit).visible(scales(findings.setting(fit))[:, :1]) == pytest.approx(5 * std, rel=1e-3)


def test_rows_that_look_shuffled_are_named_unless_they_have_a_time(prior_arm):
    data = noisy(prior_arm, joints(80), SIGMA, 1)
    assert len(unordered(data)) == 1
    assert unordered(replace(data, context={"time": np.arange(80.0)})) == ()
    path = np.stack([np.sin(np.linspace(0, k + 2, 80)) for k in range(6)], axis=1)
    assert unordered(noisy(prior_arm, path, SIGMA, 1)) == ()


def aligned(points, onto):
    """Points moved as one body as near to others as they come, (n, 3) each (Kabsch)."""
    centre, other = points.mean(axis=0), onto.mean(axis=0)
    left, _, right = np.linalg.svd((points - centre).T @ (onto - other))
    turn = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return (points - centre) @ turn + other


@pytest.mark.quick(0)
def test_joint_terms_that_the_poses_hardly_decide_are_told(shop, prior_arm):
    """The sentence says what robots drawn from the fit's covariance scatter by, base and tool placed anew."""
    rng, fit = np.random.default_rng(3), shop.situation(Code.TERMS_UNTESTED).there
    verdict_remark, together = remark(fit, "terms_untested"), fit.identification.data.joints
    q = np.stack([np.roll(together[:, j], 10 * j) for j in range(6)], axis=1)
    drawn = rng.multivariate_normal(np.zeros(len(fit.free_names)), fit.covariance.values, size=300)
    for poses, words in ((q, r"known to ([\d.]+) mm RMS there"), (together, r"and to ([\d.]+) mm at the poses used")):
        mean, squares = fit.robot.positions(poses)[:, 0], []
        for step in drawn:
            values = fit.robot.values.copy()
            values[fit.unknowns.index] += step
            moved = fit.robot.with_parameters(values).positions(poses)[:, 0]
            squares.append(np.mean(np.sum((aligned(moved, mean) - mean) ** 2, axis=1)))
        told = float(re.search(words, verdict_remark.text)[1])
        assert told == pytest.approx(1e3 * np.sqrt(np.mean(squares)), rel=0.12)  # two digits, and 300 draws
    spread = calib.fit(prior_arm, noisy(prior_arm, 0.5 * joints(60), SIGMA, 1), sigma=SIGMA, terms="gain")
    assert "terms_untested" not in spread.verdict.to_dict()["codes"]
    beyond = "not all of the joints' range was measured: over"
    assert sum(line.startswith(beyond) for line in spread.verdict.not_covered) == 1  # measured through 1.5 of 6 rad


def test_values_a_turn_beyond_the_limits_need_a_look_even_where_the_joint_moves_no_target(tmp_path):
    """Degrees read as radians of a UR10's last joint passed, since its reflector sat near that joint's axis."""
    robot = calib.load(copied(tmp_path, EXAMPLES / "arm.yaml", ("20 mm, 0 mm, 50 mm", "50 mm, 0 mm, 0 mm")))
    q = np.random.default_rng(1).uniform(-1.2, 1.2, (50, 6))
    points = robot.positions(q) + 3e-5 * np.random.default_rng(2).standard_normal((50, 1, 3))
    for factor, grade in ((1.0, "PASS"), (np.degrees(1.0), "CHECK")):
        values = q * [1, 1, 1, 1, 1, factor]
        verdict = calib.fit(robot, calib.as_measurements(robot, values, points)).verdict
        assert verdict.grade == grade
        assert (grade == "CHECK") == any("beyond the URDF's limits of joint_6" in r.text for r in verdict.reasons)


def test_what_is_left_uncertain_if_some_were_known_is_the_inverse_of_their_information():
    root = np.random.default_rng(4).standard_normal((7, 7)) * 10.0 ** np.arange(-6, 1)[:, None]
    known = np.array([False, True, False, True, True, False, False])
    result = _covariance_given(root @ root.T, known)
    information = np.linalg.inv(root).T @ np.linalg.inv(root)
    expected = np.linalg.inv(information[np.ix_(~known, ~known)])
    square = np.outer(*2 * [np.sqrt(np.diag(expected))])
    np.testing.assert_allclose(result[np.ix_(~known, ~known)] / square, expected / square, atol=1e-5)
    assert np.all(result[known] == 0)
    undetermined = np.diag([2.0, 0.0, 3.0])  # one that nothing moves
    np.testing.assert_array_equal(_covariance_given(undetermined, np.array([False, True, False])), undetermined)
