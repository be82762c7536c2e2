from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.data.in_memory import measurements as from_readings
from calib.core.data.in_memory import plain_readings
from calib.core.data.pose_groups import are_drawn_alike, is_apart, pose_labels
from calib.core.fitting.validation import deal
from calib.core.judging.claim import is_elsewhere, unlike_measured
from tests.project import EXAMPLES
from tests.six_axis_arm import FREE, YAML, joints, noisy, write_six_axis


def measured(q, names):
    """Readings of zero at these poses."""
    return from_readings(calib.Poses(q, names, names, "test", ()), {"ball": plain_readings(np.zeros((len(q), 3)))})


def some(n, same=()):
    """n poses; those listed in `same` stand at the joint values of pose 0."""
    q = joints(n)
    q[list(same)] = q[0]
    return measured(q, tuple(str(k) for k in range(n)))


@pytest.mark.parametrize("seed", range(5))
def test_a_split_and_folds_keep_repeats_of_one_pose_together(seed):
    data = some(23, same=(4, 9, 15))
    kept, held = data.split(validation=0.3, seed=seed)
    assert len(kept) + len(held) == 23
    assert len(held) >= 7
    repeats = {"0", "4", "9", "15"}
    assert repeats <= set(held.names) or not repeats & set(held.names)
    folds = deal(data, 5, seed)
    assert sorted(np.concatenate(folds)) == list(range(23))
    assert max(map(len, folds)) - min(map(len, folds)) <= 4
    assert sum(bool({0, 4, 9, 15} & set(fold)) for fold in folds) == 1


@pytest.mark.parametrize("seed", range(5))
def test_repeats_by_name_stay_together_although_their_encoders_differ(seed):
    """Rows of one pose may differ by 2 mrad; apart, a hold-out set would be poses that the fit has seen."""
    q = np.repeat(joints(20), 3, axis=0)
    q += np.random.default_rng(1).uniform(-8e-4, 8e-4, q.shape)
    names = tuple(f"p{k // 3}" for k in range(60))
    data = measured(q, names)
    kept, held = data.split(validation=0.3, seed=seed)
    assert len(held) == 18
    assert not set(kept.names) & set(held.names)
    folds = deal(data, 4, seed)
    assert [len(fold) for fold in folds] == [15, 15, 15, 15]
    assert all(len({names[k] for k in fold}) == 5 for fold in folds)


def test_repeats_are_known_although_an_encoder_reads_them_with_noise():
    q = np.repeat(joints(30), 4, axis=0)
    label = pose_labels(q + 2e-5 * np.random.default_rng(0).standard_normal(q.shape))
    assert len(set(label)) == 30
    assert all(len(set(label[4 * k : 4 * k + 4])) == 1 for k in range(30))


@pytest.mark.parametrize("n_joints", [1, 2, 6])
def test_rows_repeat_a_pose_where_a_chain_of_neighbours_links_them(n_joints):
    rng = np.random.default_rng(1)
    q = 1e-4 * rng.integers(0, 40 if n_joints < 6 else 4, (150, n_joints))
    linked = np.all(np.abs(q[:, None] - q[None]) < 1.5e-4, axis=2)
    for _ in range(8):  # chains of up to 256 links
        linked = linked @ linked
    label = pose_labels(q + 2e-5 * rng.uniform(-1, 1, q.shape))
    np.testing.assert_array_equal(label[:, None] == label[None], linked)
    assert pose_labels(q[:0]).shape == (0,)


def test_a_split_is_in_file_order_and_repeatable():
    kept, held = some(30).split(validation=0.2, seed=7)
    assert len(held) == 6
    assert [int(name) for name in held.names] == sorted(int(name) for name in held.names)
    assert held.names == some(30).split(validation=0.2, seed=7)[1].names
    assert held.names != some(30).split(validation=0.2, seed=8)[1].names
    assert not set(held.names) & set(kept.names)


@pytest.mark.parametrize("fraction", [0.0, 1.0, -0.5, 0.01, 0.99])
def test_a_split_that_leaves_nothing_is_an_error(fraction):
    with pytest.raises(calib.DataError, match="no pose is left to"):
        some(10).split(validation=fraction)
    with pytest.raises(calib.DataError, match="no pose is left to fit"):
        some(10, same=range(1, 10)).split(validation=0.5)


def test_folds_predict_each_pose_by_a_fit_that_did_not_see_it(arm):
    data = noisy(arm, joints(45), 4e-5, seed=1)
    fit = calib.fit(arm, data, folds=3, seed=4)
    for held in deal(data, 3, 4):
        kept = np.setdiff1d(np.arange(45), held)
        alone = calib.fit(arm, data.subset(kept), validation=data.subset(held))
        np.testing.assert_array_equal(fit.folds.errors.after["ball"][held], alone.validation.after["ball"])
    assert len(fit.folds.rms) == 3
    unused, used = (e.table()["after"]["rms"] for e in (fit.folds.errors, fit.identification))
    assert unused > used


def test_the_error_of_a_fold_is_that_of_what_was_read(arm):
    data = noisy(arm, joints(45), 4e-5, seed=1)
    values = data.readings["ball"].values.copy()
    values[3, 0] = np.nan
    fit = calib.fit(arm, replace(data, readings={"ball": replace(data.readings["ball"], values=values)}), folds=3)
    sizes, squares = map(len, deal(data, 3)), np.square(fit.folds.rms)
    assert np.average(squares, weights=list(sizes)) == pytest.approx(fit.folds.errors.rms("after") ** 2)


@pytest.mark.parametrize("folds", [1, -2, 46])
def test_a_senseless_number_of_folds_is_an_error(arm, folds):
    with pytest.raises(calib.InputError, match=f"folds {folds}: must be 2 or more"):
        calib.fit(arm, noisy(arm, joints(45), 4e-5, seed=1), folds=folds)


def test_an_error_of_a_fit_without_one_fold_says_so():
    """The file has enough poses; those without a fold do not."""
    robot = calib.load(EXAMPLES / "five_bar.yaml")
    data = calib.read_measurements(EXAMPLES / "five_bar_simulated.csv", robot)[:8]
    said = r"fit without one fold \(4 of 8 poses\): .*; or ask for more folds"
    with pytest.raises(calib.CalibrationError, match=said):
        calib.fit(robot, data, folds=2)


def test_before_is_with_base_and_target_placed_alone(tmp_path):
    yaml = YAML.replace("frame: l0", "frame: l0, pose: unknown").replace("100 mm]", "100 mm], position: unknown")
    robot = calib.load(write_six_axis(tmp_path, yaml + FREE))
    moved = {"base.x": 0.7, "base.rz": 0.4, "ball.y": 0.05, "j3.rx": 0.002}
    data = noisy(robot.with_parameters(moved), joints(60), 4e-5, seed=1)
    fit = calib.fit(robot, data, validation=noisy(robot.with_parameters(moved), joints(20, 3), 4e-5, seed=2))
    placed = [p.placement for p in robot.parameters]
    assert np.any(fit.placed.values[placed] != robot.values[placed])
    np.testing.assert_array_equal(fit.placed.values[~np.array(placed)], robot.values[~np.array(placed)])
    for errors in (fit.identification, fit.validation):
        rms = errors.table()["before"]["rms"]
        assert 0.2 < rms < 5  # the robot's own 2 mrad, not the base's 700 mm


def test_of_poses_drawn_like_those_used_one_in_twenty_lies_apart():
    used, others = joints(300), joints(4000, 1)
    assert 0.03 < np.mean(is_apart(others, used)) < 0.08  # the limit is itself drawn: +- 0.013
    assert np.mean(is_apart(others + 1.5 * np.eye(6)[0], used)) > 0.25
    assert np.all(is_apart(others + 6.0 * np.eye(6)[0], used))


def test_apart_is_beyond_the_nearest_other_pose_whatever_repeats_say():
    """Poses in steps of 0.1 along one joint, each read three times; a joint that never moved is another matter."""
    used = np.repeat(np.column_stack([0.1 * np.arange(30), np.full(30, 0.5)]), 3, axis=0)
    others = np.array([[0.55, 0.5], [2.98, 0.5], [3.05, 0.5], [0.5, 0.6]])
    assert is_apart(others, used).tolist() == [False, False, True, True]
    assert not np.any(is_apart(others, used[:54]))  # 18 poses


def test_poses_drawn_as_those_used_are_told_from_poses_elsewhere_and_from_crowded_ones():
    rng = np.random.default_rng(3)
    used = rng.uniform(-1, 1, (200, 6))
    alike = [are_drawn_alike(rng.uniform(-1, 1, (60, 6)), used) for _ in range(200)]
    assert np.sum(alike) >= 197  # 0.1 % by chance
    assert not are_drawn_alike(rng.uniform(0.8, 1.5, (60, 6)), used)
    assert not are_drawn_alike(rng.uniform(0.0, 0.3, (60, 6)), used)
    assert are_drawn_alike(used[:30], used)
    assert are_drawn_alike(np.repeat(rng.uniform(-1, 1, (12, 6)), 30, axis=0), used)  # a repeat is no new pose


def test_poses_of_a_setup_that_was_not_used_are_unlike_those_measured(arm):
    fit = calib.fit(arm, noisy(arm, joints(40), 1e-4, 1), validation=noisy(arm, joints(30, 5), 1e-4, 2))
    assert np.array_equal(unlike_measured(fit), is_apart(joints(30, 5), joints(40)))
    assert not is_elsewhere(unlike_measured(fit))
    setups = np.zeros(40, dtype=int), np.where(np.arange(30) < 3, 0, 1)
    used, other = (
        replace(errors, data=replace(errors.data, setups=numbers))
        for numbers, errors in zip(setups, (fit.identification, fit.validation), strict=True)
    )
    moved = replace(fit, identification=used, validation=other)
    assert np.all(unlike_measured(moved)[3:])
    assert is_elsewhere(unlike_measured(moved))
