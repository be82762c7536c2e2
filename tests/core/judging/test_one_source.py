"""Every answer about a calibrated robot's positions contains the same uncertainty."""

import numpy as np
import pytest

import calib
from calib.core.data.measurements import Poses
from calib.core.judging.acceptance import verify
from calib.core.judging.acceptance_system import System
from calib.core.judging.promise import Promise
from tests.six_axis_arm import FREE, YAML, joints, write_six_axis


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """An arm whose noise is not stated, whose joints have gains and rough errors, and what was read of it."""
    arm = calib.load(write_six_axis(tmp_path_factory.mktemp("arm"), YAML.replace("sigma: 0.02 mm", "") + FREE))
    q, rng = joints(80, 1), np.random.default_rng(2)
    actual = q * (1.0 + 2e-3 * rng.standard_normal(6)) + 1e-4 * np.sin(40 * q)
    return arm, calib.as_measurements(arm, q, arm.positions(actual)[:, 0] + 2e-5 * rng.standard_normal((80, 3)))


def test_predict_verify_watch_and_study_say_the_same_of_a_pose(measured):
    arm, data = measured
    fit, q = calib.fit(arm, data), joints(4, 5)
    known = fit.predict(q)
    assert fit.joint_error > 0
    assert fit.undecided is not None  # the gains that the fit lacks
    alone = np.sqrt(np.trace(known.covariance[:, 0], axis1=1, axis2=2))
    by_parameters = fit.uncertainty.linearise(fit.robot, q, calib.as_poses(arm, q).conditions).jacobian[:, 0, :3]
    by_parameters = by_parameters[..., : len(fit.free_names)]
    less = np.einsum("nij,jk,nik->n", by_parameters, fit.covariance.values, by_parameters)
    assert np.all(alone > 1.2 * np.sqrt(less))  # a door that leaves one of both out shows
    for k, pose in enumerate(q):
        read = calib.as_measurements(arm, pose[None], known.positions[k])
        promised = System.from_promise(Promise.from_calibration(fit), read, same_setup=True).expected
        assert promised.calibration_rms == pytest.approx(alone[k], rel=1e-6)
        assert promised.rms == pytest.approx(np.hypot(alone[k], np.sqrt(3) * fit.reading_noise[0]), rel=1e-6)
    watched = calib.Watch(arm, "1 mm", candidates=q).update(data)
    assert watched.predicted.value == pytest.approx(np.sqrt(np.mean(alone**2)), rel=1e-6)
    drawn = calib.study(arm, data, draws=2, noise=lambda exact, rng: data, elsewhere=q).draws  # of the same readings
    stds = drawn.error_half_width[:, :, 0] / known.coverage_factor
    assert np.sqrt(np.sum(stds**2, axis=2)) == pytest.approx(np.array([alone, alone]), rel=1e-3)  # solver's tolerance
    own = np.array([p.std_si for p in fit.parameters.values() if p.std_si > 0])
    assert drawn.std == pytest.approx(np.array([own, own]), rel=1e-3)


def test_noise_and_errors_of_joints_are_together_what_residuals_show(tmp_path):
    """Counted as noise, errors of joints would count twice in what a reading is expected to be off."""
    arm = calib.load(write_six_axis(tmp_path, YAML.replace("sigma: 0.02 mm", "") + FREE))
    rng = np.random.default_rng(2)

    def read(q):
        points = arm.positions(q + 1e-4 * np.sin(40 * q))[:, 0] + 2e-5 * rng.standard_normal((len(q), 3))
        return calib.as_measurements(arm, q, points)

    fit = calib.fit(arm, read(joints(100, 1)))
    assert fit.reading_noise[0] < 0.8 * fit.sigma
    ratios = [verify(fit, read(joints(40, 10 + k))).ratio for k in range(4)]
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)  # 120 rows each: 0.03, and the fit's own noise as much


def test_readings_of_a_pose_share_the_errors_of_its_joints(measured):
    """Twenty readings of one pose are not twenty poses: they show errors of the robot there once."""
    arm, data = measured
    fit, rng = calib.fit(arm, data), np.random.default_rng(3)
    pose = joints(1, 9)
    points = fit.robot.positions(pose + 4.0 * fit.joint_error * np.array([0, 1.0, -1.0, 1.0, 0, 0]))[:, 0]
    read, q = points + fit.reading_noise[0] * rng.standard_normal((20, 3)), np.repeat(pose, 20, axis=0)
    squares = []
    for names in (("one",) * 20, tuple(map(str, range(20)))):
        poses = Poses(q, tuple(map(str, range(20))), names, "x", ())
        readings = calib.as_measurements(arm, poses, read)
        squares.append(System.from_promise(Promise.from_calibration(fit), readings, same_setup=True).square)
    once, often = squares
    assert 57 < once < 57 + 60  # of noise 57 and its scatter, and the three coordinates of one error
    assert often < 30  # errors of 20 poses would scatter more
