"""What `calib check` knows: MedRUE, a robot with priors, and poses that determine too little."""

import numpy as np
import pytest

import calib
from calib.core.data.in_memory import as_poses
from calib.core.robots.jacobian import linearise
from calib.core.rows.prediction import without_common_motion
from calib.planning.assessment import accuracy_by_count, check
from calib.planning.assessment_text import text_report
from calib.planning.pose_sampling import sample
from calib.planning.selection_text import text_report as told
from calib.shared.null_space import describe_group
from medrue.workspace import target_workspace
from tests.project import EXAMPLES
from tests.six_axis_arm import YAML, joints, write_six_axis
from tests.small_robots import small_arm

Q = target_workspace().q


@pytest.fixture(scope="module")
def assessment(medrue):
    return check(medrue, as_poses(medrue, Q[::3]))


def test_observability_on_scaled_and_on_raw_columns(medrue, assessment):
    jacobian = 1e3 * linearise(medrue, medrue.assemble(Q[::3])).jacobian / medrue.parameters.per_si
    raw = np.linalg.svd(jacobian[..., medrue.is_free].reshape(-1, 28), compute_uv=False)
    assert assessment.raw["O2"] == pytest.approx(raw[-1] / raw[0], rel=1e-9)
    assert assessment.raw["O1"] == pytest.approx(np.exp(np.mean(np.log(raw))) / np.sqrt(140), rel=1e-9)
    # O1 changes by the same factor for every set of poses when units change
    other = check(medrue, as_poses(medrue, Q[1::3]))
    ratios = [each.raw["O1"] / each.scaled["O1"] for each in (assessment, other)]
    assert ratios[0] == pytest.approx(ratios[1], rel=1e-9)


def test_where_nothing_measures_lengths_observability_is_in_noise(tmp_path):
    """One turn, read 20 times with a noise of 0.1 mrad per axis: sqrt(20) pi / 180 / 1e-4 per deg."""
    turned = "instruments: {level: {kind: orientation, target: ball, sigma: 0.1 mrad}}\nparametrisation:\n"
    entry = "  - {origin: j1, components: [rz], sigma: 5 mrad}\n"
    robot = calib.load(write_six_axis(tmp_path, YAML.replace("parametrisation:\n", turned) + entry))
    assessment = check(robot, joints(20))
    expected = np.sqrt(20) * np.pi / 180 / 1e-4
    assert assessment.raw["O3"] == pytest.approx(expected)
    assert assessment.scaled["O3"] == pytest.approx(np.sqrt(20) * 5e-3 / 1e-4)
    assert "not scaled, noise per deg" in text_report(assessment, "", verbose=True)
    candidates = as_poses(robot, joints(40))
    selection = calib.select(robot, candidates, 20, index="O3")
    assert selection.raw["O3"] == pytest.approx(expected)
    assert "noise per unit" in told(selection, candidates)


def test_uncertainty_is_the_spread_of_the_normal_equations(medrue, assessment):
    jacobian = linearise(medrue, medrue.assemble(Q[::3])).jacobian[..., medrue.is_free].reshape(-1, 28)
    covariance = 4e-5**2 * np.linalg.inv(jacobian.T @ jacobian)
    np.testing.assert_allclose(assessment.std, np.sqrt(np.diag(covariance)), rtol=1e-6)
    rms = np.sqrt(np.trace(jacobian @ covariance @ jacobian.T) / 140)
    assert assessment.accuracy.rms == pytest.approx(rms, rel=1e-6)
    squares = np.einsum("nij,jk,nik->n", jacobian.reshape(140, 3, 28), covariance, jacobian.reshape(140, 3, 28))
    assert assessment.accuracy.maximum == pytest.approx(np.sqrt(squares.max()), rel=1e-6)
    assert assessment.accuracy.worst_pose == np.argmax(squares)


def test_what_stays_undetermined_is_said_in_words_and_infinite(medrue):
    freer = medrue.free("xb", "d31").fix("phi_by")
    assessment = check(freer, as_poses(freer, Q[::6]))
    assert [describe_group(group, assessment.free_parameters) for group in assessment.undetermined_groups] == [
        "d31 has no effect",
        "dq1 from xb",
    ]
    assert {row["name"] for row in assessment.rows() if np.isinf(row["std"])} == {"xb", "dq1", "d31"}
    assert np.isfinite(assessment.accuracy.rms)  # positions do not depend on what cannot be told apart
    assert {name for name, _ in assessment.hardly_known()} == {"xb", "dq1", "d31"}


def test_accuracy_where_the_poses_say_nothing_is_infinite(medrue):
    """All poses with the probe in one direction leave directions open that other poses need."""
    few = as_poses(medrue, Q[:10])
    assessment = check(medrue, few, task=as_poses(medrue, Q[::40]))
    assert assessment.posterior_information.rank.rank < 28
    assert np.isinf(assessment.accuracy.rms)


def test_priors_hold_what_poses_do_not(tmp_path):
    arm = small_arm(tmp_path)
    poses = sample(arm, 30, np.random.default_rng(0))
    assessment = check(arm, poses, sigma=5e-5)
    assert assessment.rank_free.rank < assessment.rank_free.n_columns
    assert assessment.posterior_information.rank.rank == assessment.rank_free.n_columns
    assert assessment.undetermined_groups == ()
    assert np.all(assessment.std <= np.array([p.sigma_si for p in assessment.free_parameters]) * (1 + 1e-9))
    assert any(part > 0.99 for _, part in assessment.hardly_known())
    assert np.isfinite(assessment.accuracy.rms)
    # noise of 1000 km leaves all of every expected error, but for rounding: they come in their own order
    names = [name for name, _ in check(arm, poses, sigma=1e6).hardly_known()]
    assert names == [p.name for p in assessment.free_parameters if p.prior]


@pytest.mark.quick(0)
def test_a_place_that_nobody_expects_anywhere_has_no_expected_error_left():
    """The tracker's place has no prior; that of the reflector has one, and three poses hardly say more."""
    arm = calib.load(EXAMPLES / "arm.yaml")
    assessment = check(arm, sample(arm, 4, np.random.default_rng(0)), sigma=1e-3)
    parts = dict(zip([p.name for p in assessment.free_parameters], assessment.part_left, strict=True))
    assert all(np.isnan(part) == name.startswith("base.") for name, part in parts.items())
    assert max(part for name, part in parts.items() if name.startswith("reflector.")) <= 1 + 1e-9
    assert not [name for name, _ in assessment.hardly_known() if name.startswith("base.")]


def test_correlations_above_the_limit_are_listed_largest_first(assessment):
    pairs = assessment.correlated_pairs(0.9)
    sizes = [abs(r) for _, _, r in pairs]
    assert sizes == sorted(sizes, reverse=True)
    assert min(sizes) > 0.9
    first, second, r = pairs[0]
    names = [p.name for p in assessment.free_parameters]
    matrix = assessment.posterior_information.correlations()
    assert matrix[names.index(first), names.index(second)] == pytest.approx(r)


def test_more_poses_predict_better_and_the_best_beat_the_uniform_ones(assessment):
    inside = [row for row in assessment.by_count if row.uniform is not None]
    rms = [row.chosen.rms for row in assessment.by_count]
    assert rms == sorted(rms, reverse=True)
    assert all(row.chosen.rms <= row.uniform.rms * (1 + 1e-9) for row in inside)
    assert inside[-1].count == 140
    assert inside[-1].chosen.rms == pytest.approx(assessment.accuracy.rms, rel=1e-9)
    assert assessment.by_count[-1].count == 560
    assert assessment.by_count[-1].chosen.rms == pytest.approx(assessment.accuracy.rms / 2, rel=1e-6)


def test_of_very_many_poses_only_few_are_searched_for_the_best():
    rows = np.random.default_rng(0).standard_normal((2500, 3, 4))
    by_count = {row.count: row for row in accuracy_by_count(rows, np.zeros((0, 4)), rows[:50])}
    assert by_count[20].chosen.rms < by_count[20].uniform.rms
    assert by_count[956].chosen is None
    assert by_count[2500].chosen.rms == pytest.approx(by_count[2500].uniform.rms)
    assert list(by_count)[-2:] == [5000, 10000]


def test_a_robot_with_everything_held_is_an_error(tmp_path):
    arm = small_arm(tmp_path)
    held = arm.fix(*(p.name for p in arm.parameters))
    with pytest.raises(calib.InputError, match="nothing to identify"):
        check(held, sample(held, 5, np.random.default_rng(0)))


@pytest.mark.parametrize("sigmas", [("1000 m", "0.001 mm"), ("0.001 mm", "1000 m")])
def test_no_expected_error_hides_what_moves_the_target(tmp_path, sigmas):
    """Ranks and groups are facts of mechanism and poses, however far apart the expected errors are."""

    def assessed(first, second):
        yaml = f"priors: false\n{YAML}  - {{origin: j1, components: [x], sigma: {first}}}\n"
        yaml += f"  - {{origin: j4, components: [x, z], sigma: {second}}}\n"
        robot = calib.load(write_six_axis(tmp_path, yaml))
        return check(robot, as_poses(robot, joints(20)), sigma=1e-4)

    apart, equal = assessed(*sigmas), assessed("1 mm", "1 mm")
    assert equal.rank_free.rank == apart.rank_free.rank == 3
    assert apart.groups == apart.undetermined_groups == ()
    np.testing.assert_allclose(apart.std, equal.std, rtol=1e-9)
    assert "no effect" not in text_report(apart, "poses")
    assert "All 3 free parameters can be found from these poses." in text_report(apart, "poses")


def test_position_errors_beside_a_common_motion_of_all():
    rng = np.random.default_rng(3)
    positions = rng.normal(size=(30, 2, 3))
    flat = positions.reshape(-1, 3)
    turned = np.cross([0.3, -0.2, 0.5], flat)  # what small motions of the base do
    shifted = np.tile([1.0, 2.0, -1.0], (len(flat), 1))
    larger = flat - flat.mean(axis=0)  # a scale: neither shift nor turn has a part in it
    rows = np.stack([turned, shifted, larger, larger + turned + shifted], axis=2).reshape(30, 6, 4)
    beside = without_common_motion(positions, rows)
    assert beside.shape == rows.shape
    assert np.allclose(beside[..., :2], 0.0, atol=1e-12)
    assert np.allclose(beside[..., 2], rows[..., 2], atol=1e-12)
    assert np.allclose(beside[..., 3], rows[..., 2], atol=1e-12)


@pytest.mark.quick(0)
def test_what_sockets_do_not_see_is_told_apart(tmp_path, run_calib):
    arm = EXAMPLES / "arm.urdf"
    assert run_calib("init", arm, "--measure", "touch", "--out", "touch.yaml", cwd=tmp_path).code == 0
    robot = calib.load(tmp_path / "touch.yaml")
    assessment = calib.check(robot, calib.read_poses(EXAMPLES / "arm_touches_simulated.csv", robot))
    assert assessment.rms_without_common < 1e-4 < 1e-3 < assessment.accuracy.rms  # the plate stands anywhere
    told = run_calib("check", "touch.yaml", EXAMPLES / "arm_touches_simulated.csv", cwd=tmp_path).out
    assert "Without that part, positions at these poses are known to" in " ".join(told.split())
