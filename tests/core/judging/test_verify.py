"""New measurements judge a calibrated robot: rightly, as often as promised, and planned beforehand."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

import calib
from calib.core.commands.verify import command
from calib.core.data.measurement_files import format_measurements
from calib.core.judging.acceptance import verify, visible_changes
from calib.core.judging.acceptance_system import System, _noncentrality, candidates
from calib.core.judging.promise import Promise
from calib.core.judging.repeatability import CONDITIONS, conditions, iso_figures
from calib.core.results.acceptance_text import text_report
from calib.core.results.result_reading import load_result
from tests.project import EXAMPLES, write_table
from tests.small_robots import ARM_YAML, write_arm

SIGMA = 3e-5
JOINTS = ",".join(f"joint_{k}" for k in range(1, 7))
MOVED = {"base.x": 1.7, "base.ry": 0.2, "base.rz": -1.0, "reflector.z": 0.052}


def value(robot, name):
    return float(robot.values[[p.name for p in robot.parameters].index(name)])


def measured(robot, q, rng, sigma=SIGMA, names=None):
    return calib.as_measurements(robot, q, robot.positions(q) + sigma * rng.standard_normal((len(q), 1, 3)), names)


@pytest.fixture(scope="module")
def truth(robot):
    """The arm of the examples as it truly is."""
    rng = np.random.default_rng(1)
    drawn = {p.name: p.nominal_si + p.sigma_si * rng.standard_normal() for p in robot.parameters if not p.placement}
    return robot.with_parameters(drawn | {"base.x": 2.1, "base.rz": 2.0, "reflector.y": -0.003})


@pytest.fixture(scope="module")
def fit(robot, truth):
    rng = np.random.default_rng(51)
    return calib.fit(robot, measured(truth, rng.uniform(-1.2, 1.2, (80, 6)), rng))


@pytest.fixture(scope="module")
def folder(fit, tmp_path_factory):
    path = tmp_path_factory.mktemp("result") / "arm"
    fit.save(path, pages=False)
    return path


@pytest.mark.quick(0)
def test_a_robot_as_calibrated_agrees_whoever_moved_the_tracker(truth, fit):
    rng, moved = np.random.default_rng(2), truth.with_parameters(MOVED)
    results = [verify(fit, measured(moved, rng.uniform(-1.2, 1.2, (15, 6)), rng)) for _ in range(40)]
    assert Counter(item.verdict for item in results)["agrees"] >= 38  # false alarms: 1 in 100
    inside = np.mean([item.low95 < item.ratio < item.high95 for item in results])
    assert inside > 0.85  # one calibration: its errors are the same for all
    promised = np.mean([item.expected_rms for item in results])
    did = np.mean([1e-3 * item.errors.table()["after"]["rms"] for item in results])
    assert promised == pytest.approx(did, rel=0.15)


def test_in_the_same_setup_the_places_count_too(truth, fit):
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.2, 1.2, (15, 6))
    assert verify(fit, measured(truth, q, rng), same_setup=True).verdict == "agrees"
    moved = truth.with_parameters({"base.x": 2.1005})
    assert verify(fit, measured(moved, q, rng), same_setup=True).verdict != "agrees"
    assert verify(fit, measured(moved, q, rng)).verdict == "agrees"


def test_places_of_all_setups_are_found_together(tmp_path):
    """An arm that hardly lifts its tool hardly tells a reflector's height from that of its base.

    Seen from a second place, the reflector would be another one unless both are placed together. In closed form it is
    at Rz(turn) ([slide + 0.375, 0, 0.5] + Ry(pi / 2 + wrist) t).
    """
    yaml = ARM_YAML.replace("{frame: ground}", "{frame: ground, pose: unknown}").partition("parametrisation:")[0]
    yaml = yaml.replace("30 mm]", "30 mm], position: unknown, sigma: 5 mm") + "setups: {first: [], moved: [base]}\n"
    yaml += "sigma: 0.02 mm\nparametrisation: [{origin: slide, components: [x, y], sigma: 1 mm}]\n"
    robot = calib.load(write_arm(tmp_path, yaml))
    rng = np.random.default_rng(6)
    q, setup = rng.uniform([-2, 0.1, -0.01], [2, 0.9, 0.01], (60, 3)), np.repeat([0, 1], 30)
    t = np.array([0, 0, 0.1]) + Rotation.from_euler("z", 0.75).apply([0.012, 0.019, 0.033])
    lifted = Rotation.from_rotvec((np.pi / 2 + q[:, 2:]) * [0, 1, 0]).apply(t) + [0.375, 0, 0.5] + q[:, 1:2] * [1, 0, 0]
    turned = Rotation.from_rotvec([[0.1, -0.3, 0.2], [-0.4, 0.2, 1.9]])[setup]
    points = (turned * Rotation.from_rotvec(q[:, :1] * [0, 0, 1])).apply(lifted)
    seen = points + np.array([[2.0, 1.7, 0.4], [1.5, -1.3, 0.3]])[setup] + rng.normal(0, 2e-5, (60, 3))
    header, setups = "setup,turn,slide,wrist,tip_x,tip_y,tip_z", ["first"] * 30 + ["moved"] * 30
    data = calib.read_measurements(write_table(tmp_path / "data.csv", header, setups, q, seen), robot)
    acceptance = verify(calib.fit(robot, data), data)
    assert acceptance.verdict == "agrees"
    assert 1e-3 * acceptance.errors.table()["after"]["rms"] == pytest.approx(2e-5 * np.sqrt(3), rel=0.2)


def test_no_change_within_its_own_uncertainty_is_called_significant(truth, fit):
    rng = np.random.default_rng(41)
    quiet = verify(fit, measured(truth.with_parameters(MOVED), rng.uniform(-1.2, 1.2, (8, 6)), rng))
    assert not any(change.significant for change in quiet.changes)
    assert quiet.alternative_changes == ()
    assert "; none is significant" in text_report(quiet, (), ())
    changed = truth.with_parameters({"joint_3.ry": value(truth, "joint_3.ry") + 4e-4})
    loud = verify(fit, measured(changed, rng.uniform(-1.2, 1.2, (30, 6)), rng))
    significant = [change for change in loud.changes if change.significant]
    assert 0 < len(significant) < len(loud.changes)
    assert all(abs(change.value) > 3 * change.std for change in significant)  # 2.8 of normal noise are 1 in 200
    assert f"{len(significant)} are significant" in text_report(loud, (), ())


def test_more_noise_is_no_matter_of_calibration(truth, fit):
    rng = np.random.default_rng(7)
    q = np.tile(rng.uniform(-1.2, 1.2, (8, 6)), (10, 1))
    names = [str(k % 8) for k in range(80)]
    assert verify(fit, measured(truth, q, rng, 2 * SIGMA, names)).verdict == "noisier"


def test_readings_that_agree_with_anything_are_too_few(truth, fit):
    """Four points are twelve coordinates, of which base and reflector take nine; fifteen leave enough."""
    rng = np.random.default_rng(81)
    few = verify(fit, measured(truth, rng.uniform(-1.2, 1.2, (4, 6)), rng))
    enough = verify(fit, measured(truth, rng.uniform(-1.2, 1.2, (15, 6)), rng))
    assert (few.verdict, few.freedom, enough.verdict) == ("too few readings", 3, "agrees")
    assert "TOO FEW READINGS: nothing contradicts the calibration" in text_report(few, (), ())
    for item in (few, enough):  # what the ratio of an unchanged robot is, drawn; 0.5 % exceed the limit
        squares = rng.chisquare(item.freedom, 400_000) / item.freedom
        squares /= rng.chisquare(fit.statistics.freedom, len(squares)) / fit.statistics.freedom
        share = np.mean(item.detectable**2 * squares > np.quantile(squares, 0.995))
        assert share == pytest.approx(0.9, abs=0.01)


def test_a_change_that_would_have_to_be_as_large_as_the_robot_is_not_looked_for(robot, fit):
    """Of the UR10, another day of the same week changed the origin of its wrist "by -440 mm"; its prior is 1 mm."""
    q = np.random.default_rng(3).uniform(-0.02, 0.02, (9, 6))
    changes = visible_changes(fit, q)
    assert 0 < len(changes) < len(candidates(robot))
    assert max(change.visible for change in changes) < 0.25  # 0.2 where one change is looked for


def test_a_promise_is_as_wide_as_poses_left_out_show():
    """A pose that decides much, with an error of the model, is far off if it is left out."""
    robot = calib.load(EXAMPLES / "five_bar.yaml")
    data = calib.read_measurements(EXAMPLES / "five_bar_simulated.csv", robot)[:24]
    q, points = data.joints, data.points(robot).copy()
    far = np.argsort(np.linalg.norm(q - q.mean(axis=0), axis=1))[-4:]
    points[far, ..., :2] += 4e-4 * np.random.default_rng(5).standard_normal((4, *points.shape[1:-1], 2))

    def errors(fit, rows):
        return (fit.robot.positions(q[rows]) - points[rows])[..., :2]

    def fitted(rows):
        return calib.fit(robot, calib.as_measurements(robot, q[rows], points[rows]))

    fit, rows = fitted(np.arange(24)), np.arange(24)
    r = errors(fit, rows)
    e = np.concatenate([errors(fitted(np.delete(rows, k)), [k]) for k in rows])
    noise = fit.noise[0].sigma
    ratio = np.sqrt(np.sum(r * e) / (3 * r.size / 2)) / noise  # rows across the plane are noise alone
    promise = Promise.from_calibration(fit)
    assert ratio > 1.1
    wider = next(iter(promise.sigma.values())) / fit.reading_noise[0]
    assert wider == pytest.approx(ratio, rel=0.1)
    assert promise.uncertainty.joint_error == pytest.approx(wider * fit.joint_error)
    size = np.max(fit.covariance.values)
    np.testing.assert_allclose(promise.uncertainty.covariance, wider**2 * fit.covariance.values, atol=1e-9 * size)


@pytest.mark.quick(0)
def test_a_change_that_is_visible_is_seen_in_nine_of_ten(truth, fit):
    rng = np.random.default_rng(9)
    q = rng.uniform(-1.2, 1.2, (20, 6))
    first = next(change for change in visible_changes(fit, q) if change.name == "joint_5.z")
    changed = truth.with_parameters({"joint_5.z": value(truth, "joint_5.z") + first.visible})
    z = [next(c.z for c in verify(fit, measured(changed, q, rng)).changes if c.name == "joint_5.z") for _ in range(6)]
    # one calibration: its own error of the parameter is the same each time, and part of std
    own = value(fit.robot, "joint_5.z") - value(truth, "joint_5.z")
    assert np.mean(z) == pytest.approx((first.visible - own) / first.std, abs=1.5)
    # 3.8 for the level over 40 candidates, 1.28 for 90 %
    assert first.visible / first.std == pytest.approx(5.1, abs=0.4)


@pytest.fixture(scope="module")
def worn(robot, truth):
    """The arm with joints that follow waves, which no parameter describes, calibrated in a part of joint space."""

    def read(q, rng, moved=0.0):
        actual = q + 4e-4 * np.sin(np.array([2, 3, 2, 3, 2, 3]) * q + np.arange(6)) + moved * np.eye(6)[2]
        return calib.as_measurements(robot, q, truth.positions(actual) + SIGMA * rng.standard_normal((len(q), 1, 3)))

    rng = np.random.default_rng(2)
    return calib.fit(robot, read(rng.uniform(-1.2, 0.2, (80, 6)), rng)), read


def test_a_result_folder_promises_what_its_fit_did(robot, worn, tmp_path):
    fit, _ = worn
    fit.save(tmp_path / "out", pages=False)
    read, own = load_result(tmp_path / "out", robot).promise, Promise.from_calibration(fit)
    size = np.max(own.uncertainty.covariance)  # an entry near zero is the rest of large ones
    np.testing.assert_allclose(read.uncertainty.covariance, own.uncertainty.covariance, rtol=1e-9, atol=1e-9 * size)
    assert read.uncertainty.joint_error == own.uncertainty.joint_error > 0
    assert np.allclose(read.robot.values, own.robot.values, rtol=0, atol=1e-12)
    assert read.freedom == pytest.approx(own.freedom)
    assert read.sigma.keys() == own.sigma.keys()
    assert list(read.sigma.values()) == pytest.approx(list(own.sigma.values()))
    assert (read.names, read.decided) == (own.names, pytest.approx(own.decided))
    assert np.allclose(read.joints, own.joints, rtol=0, atol=1e-7)


@pytest.mark.quick(0)
@pytest.mark.parametrize("place", [(-0.2, 1.2), (-0.3, 0.2)], ids=["elsewhere", "crowded"])
def test_an_unchanged_robot_has_not_drifted_at_poses_where_its_model_is_wrong(worn, place):
    """Taken for noise, what the model leaves out makes a change of some parameter stand out far beyond chance."""
    fit, read = worn
    results = []
    for seed in range(4):
        rng = np.random.default_rng(100 + seed)
        data = read(rng.uniform(*place, (40, 6)), rng)
        results.append(verify(fit, data))
        by_noise = System.from_promise(Promise.from_calibration(fit), data, same_setup=False).changes[0].p_value
        assert (results[-1].verdict == "agrees") == (not results[-1].has_unlike_poses)
        assert results[-1].has_unlike_poses or by_noise >= 0.005
    assert {item.verdict for item in results} <= {"agrees", "unlike poses"}
    if place == (-0.2, 1.2):
        assert all(item.verdict == "unlike poses" for item in results)
    for item in results:
        assert 1e-3 * item.errors.table()["after"]["rms"] < item.limit
        assert item.ratio < item.high95
        text = text_report(item, (), ())
        assert ("model's errors are common to these poses" in text) == item.has_unlike_poses
        assert item.verdict == "agrees" or "less than chance explains" not in text


def test_errors_are_called_larger_only_where_they_are(worn):
    """Where poses lie together, a joint zero of 1 mrad has a pattern; errors are as small as those of the fit."""
    fit, read = worn
    claimed = fit.verdict.claim.at_measured_poses.rms
    for place, moved in (((-0.2, 1.2), 0.0), ((-0.35, 0.2), 1e-3)):
        rng = np.random.default_rng(107)
        item = verify(fit, read(rng.uniform(*place, (40, 6)), rng, moved))
        assert item.verdict == "unlike poses"
        text, larger = text_report(item, (), ()), 1e-3 * item.errors.table()["after"]["rms"] > 1.1 * claimed
        assert ("errors are larger than the calibration claims" in text) == larger == item.has_larger_errors
        assert larger or "errors are no larger than the calibration claims" in text


@pytest.mark.parametrize(("moved", "verdict"), [(0.0, "agrees"), (1.5e-3, "drifted")])
def test_poses_of_the_calibration_settle_whether_the_robot_has_changed(worn, moved, verdict):
    """At poses that crowd together a joint zero of 1.5 mrad may be the model's error; at poses of the calibration not.

    The example arm's joint 3 turns about its own y axis, as origin joint_3 does.
    """
    fit, read = worn
    rng = np.random.default_rng(104)
    unsure = verify(fit, read(rng.uniform(*((-0.3, 0.2) if moved else (-0.2, 1.2)), (40, 6)), rng, moved))
    assert unsure.verdict == "unlike poses"
    assert 8 <= len(unsure.repeated_visits) <= 32
    used = fit.identification.data
    again = verify(fit, read(used.joints[[used.names.index(name) for name in unsure.repeated_visits]], rng, moved))
    assert again.verdict == verdict
    if moved:
        assert "zero of joint_3" in again.alternative_changes
        zero = next(change for change in again.changes if change.name == "zero of joint_3")
        assert abs(zero.value - moved) < 4 * zero.std


def test_a_change_at_poses_like_those_measured_is_found_though_the_model_is_wrong(worn):
    fit, read = worn
    rng = np.random.default_rng(101)
    q = rng.uniform(-1.2, 0.2, (40, 6))
    assert verify(fit, read(q, rng)).verdict == "agrees"
    changed = verify(fit, read(q, rng, 1e-3))
    assert (changed.verdict, changed.has_unlike_poses) == ("drifted", False)
    named = changed.alternative_changes  # a joint's zero before the parameter that does the same
    assert named.index("zero of joint_3") < named.index("joint_3.ry")
    assert "95 %: " in text_report(changed, (), ())
    assert "To settle it, measure" in text_report(changed, (), ())


def test_no_verdict_agrees_while_errors_exceed_their_limit(robot, truth):
    """Along the one direction that a calibration in a corner leaves uncertain, its limit is far above its noise."""
    rng = np.random.default_rng(21)
    fit = calib.fit(robot, measured(truth, rng.uniform(-0.25, 0.25, (40, 6)), rng))
    for _ in range(6):
        item = verify(fit, measured(truth, rng.uniform(-1.2, 1.2, (20, 6)), rng))
        assert item.limit > item.expected_rms
        assert item.verdict != "agrees" or 1e-3 * item.errors.table()["after"]["rms"] <= item.limit


def iso_data(robot, q, **stated):
    """Thirty cycles of the poses q, in turn, and what else a file states."""
    names = [f"P{k + 1}" for _ in range(30) for k in range(len(q))]
    return replace(measured(robot, np.tile(q, (30, 1)), np.random.default_rng(11), names=names), **stated)


def test_iso_figures_are_there_where_their_cycles_are(truth, fit):
    q = np.random.default_rng(12).uniform(-0.8, 0.8, (5, 6))
    plain = verify(fit, iso_data(truth, q))
    figures, missing = iso_figures(plain.errors, np.random.default_rng(0))
    assert Counter(figure.name for figure in figures) == {"AP": 5, "RP": 5, "AD": 1, "RD": 1}
    for word in ("orientation", "vAP", "drift", "conditions not stated: load, speed"):
        assert any(word in line for line in missing)
    for item in figures:
        if item.name == "RP":  # noise alike on three axes: mean 1.596, deviation 0.673 of the Maxwell distribution
            assert item.figure.low95 < (1.596 + 3 * 0.673) * SIGMA < item.figure.high95
    assert plain.placed == 9  # base 6, reflector 3: of the means of 15 coordinates
    assert "so AP has 9 degrees of freedom less" in text_report(plain, figures, missing)
    sides = np.repeat([[1.0], [-1.0]], 75, axis=0) * np.ones((1, 6))
    time, comments = np.linspace(0, 9 * 3600, 150), tuple(f"{key}: as usual" for key in CONDITIONS)
    full = verify(fit, iso_data(truth, q, approach=sides, comments=comments, context={"time": time}))
    figures, missing = iso_figures(full.errors, np.random.default_rng(0))
    assert {"vAP", "dAP", "dRP"} <= {figure.name for figure in figures}
    assert [line for line in missing if "orientation" not in line] == []


def test_conditions_are_read_from_comments():
    assert conditions(("Load: 5 kg", "speed:", "by: me", "warm-up : 2 h")) == {"load": "5 kg", "warm-up": "2 h"}


def run(tmp_path, data, folder, *options, robot=EXAMPLES / "arm.yaml"):
    path = tmp_path / "data.csv"
    path.write_text(data)
    return CliRunner().invoke(command, [str(robot), str(path), "--result", str(folder), *options])


def test_command_says_and_writes_the_verdict(truth, folder, tmp_path):
    rng = np.random.default_rng(13)
    q = rng.uniform(-1.2, 1.2, (25, 6))
    data = format_measurements(truth, measured(truth, q, rng))
    good = run(tmp_path, data, folder, "--json", str(tmp_path / "v.json"))
    assert good.exit_code == 0, good.output
    assert good.stdout.startswith("AGREES")
    assert "no pose was read more than once" in good.stdout
    content = json.loads((tmp_path / "v.json").read_text())
    assert (content["verdict"], content["n_poses"]) == ("agrees", 25)
    assert content["contains"] == ["noise and priors"]
    assert "of the calibration: noise and priors" in " ".join(good.stdout.split())
    changed = truth.with_parameters({"joint_3.ry": value(truth, "joint_3.ry") + 5e-4})
    page = tmp_path / "verify.html"
    bad = run(tmp_path, format_measurements(truth, measured(changed, q, rng)), folder, "--html", str(page))
    assert bad.exit_code == 3
    assert 'class="verdict FAIL"' in page.read_text()
    assert all(f'id="{name}"' in page.read_text() for name in ("readings", "changes"))
    assert bad.stdout.startswith("DRIFTED")
    assert "cannot tell it from a change of" in bad.stdout


def test_readings_that_the_calibration_used_are_told(truth, fit, folder, tmp_path):
    rng = np.random.default_rng(15)
    q = np.vstack([fit.identification.data.joints[:7], rng.uniform(-1.2, 1.2, (18, 6))])
    mixed = run(tmp_path, format_measurements(truth, measured(truth, q, rng)), folder)
    assert "note: 7 of 25 visits have joint values that the calibration used" in mixed.stderr
    fresh = run(tmp_path, format_measurements(truth, measured(truth, q[7:], rng)), folder)
    assert "that the calibration used" not in fresh.stderr


def test_command_plans_before_anything_is_measured(folder, tmp_path):
    text = write_table(tmp_path / "q.csv", JOINTS, np.random.default_rng(14).uniform(-1, 1, (20, 6))).read_text()
    target = tmp_path / "plan.json"
    outcome = run(tmp_path, text, folder, "--plan", "--change", "joint_3.ry=0.02 deg", "--json", str(target))
    assert outcome.exit_code == 0, outcome.output
    content = json.loads(target.read_text())
    assert 3 < content["poses_needed"] <= 20
    assert "show joint_3.ry=0.02 deg with a chance of 90 %" in outcome.stdout


ONE = f"{JOINTS}\n0,0,0.3,0,0.5,0\n"


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        (ONE, (), "no column"),
        (f"{JOINTS},reflector_x,reflector_y,reflector_z\n0,0,0.3,0,0.5,0,1,1,1\n", (), "measure more poses"),
        (ONE, ("--change", "joint_3.ry=1 deg"), "needs --plan"),
        (ONE, ("--plan", "--html", "plan.html"), "is for readings"),
        (ONE, ("--plan", "--change", "joint_3.ry"), "write NAME=SIZE"),
        (ONE, ("--plan", "--change", "joint_3.ry="), "write NAME=SIZE"),
        (ONE, ("--plan", "--change", "joint_9.ry=1 deg"), "'joint_9.ry' is no parameter or joint zero"),
        (ONE, ("--plan", "--change", "joint_3.ry=1 mm"), "joint_3.ry"),
        (ONE, ("--plan", "--change", "joint_3.ry=1"), "write the unit of the size, such as 1deg"),
        (ONE, ("--plan", "--change", "joint_3.ry=0 deg"), "is not a change"),
        (ONE, ("--plan", "--change", "base.x=1 mm"), "'base.x' is no parameter or joint zero"),
    ],
)
def test_wrong_input_is_refused_in_one_line(folder, tmp_path, text, options, message):
    outcome = run(tmp_path, text, folder, "--json", str(tmp_path / "out.json"), *options)
    assert outcome.exit_code == 2, outcome.output
    assert message in outcome.output
    assert outcome.output.count("\n") == 1
    assert not (tmp_path / "out.json").exists()


@pytest.mark.parametrize("freedom", [0.2, 1.0])
def test_a_calibration_with_hardly_a_degree_of_freedom_promises_nothing(truth, fit, freedom):
    promise, rng = replace(Promise.from_calibration(fit), freedom=freedom), np.random.default_rng(15)
    data = measured(truth, rng.uniform(-1.2, 1.2, (12, 6)), rng)
    for ask in (verify, visible_changes):
        if freedom < 1.0:
            with pytest.raises(calib.CalibrationError, match=r"left 0\.2 degrees of freedom, too few"):
                ask(promise, data)
        else:
            ask(promise, data)


@pytest.mark.parametrize("level", [1e-4, 1e-6])
def test_noise_with_one_degree_of_freedom_has_a_visible_change_at_every_level(level):
    """Its t is a ratio of normal numbers: the limit is a Cauchy quantile, and 1.645 the 90 % point of the scale."""
    assert _noncentrality(level, 1.0) == pytest.approx(1.6448536 / np.tan(np.pi * level / 2), rel=1e-6)
