import numpy as np
import pytest
from six_axis_arm import YAML, joints, six_axis_arm, write_six_axis

import calib
from calib.data.measurement_files import read_measurements
from calib.data.repeats import beyond_repeatability, repeats
from calib.reporting.result_content import to_dict

HEADER = ",".join(["pose", *(f"j{k} [rad]" for k in range(1, 7)), *(f"ball_{axis} [mm]" for axis in "xyz")])


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return six_axis_arm(tmp_path_factory.mktemp("arm"))


def file_of(folder, rows):
    path = folder / "data.csv"
    path.write_text("\n".join([HEADER, *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path


def test_accuracy_and_repeatability_by_hand(arm, tmp_path):
    q = [0.1] * 6
    rows = [["a", *q, 0, 0, 0], ["a", *q, 2, 0, 0], ["a", *q, 1, 0, 3], ["b", *[0.5] * 6, 7, 7, 7]]
    data = read_measurements(file_of(tmp_path, rows), arm)
    before, after = np.zeros((2, 1, 3)), np.zeros((2, 1, 3))
    before[0, 0], after[0, 0] = [3e-3, 4e-3, 0], [0, 0, 1e-3]
    found = repeats(data, before, after)
    lengths = np.array([np.sqrt(2), np.sqrt(2), 2.0])  # from the mean (1, 0, 1) mm
    assert found.poses.tolist() == [0]
    assert found.readings.tolist() == [3]
    assert 1e3 * found.repeatability[0, 0] == pytest.approx(lengths.mean() + 3 * lengths.std(ddof=1))
    assert 1e3 * found.accuracy_before[0, 0] == pytest.approx(5.0)
    table = found.table()
    assert table["pose_accuracy"]["after"]["max"] == pytest.approx(1.0)
    assert table["n_readings"] == 3


def test_without_repeats_there_is_no_table(arm, tmp_path):
    data = read_measurements(file_of(tmp_path, [["a", *[0.1] * 6, 1, 2, 3], ["b", *[0.2] * 6, 1, 2, 3]]), arm)
    assert repeats(data, np.zeros((2, 1, 3)), np.zeros((2, 1, 3))) is None
    ratio, chance = beyond_repeatability(data, 1e-4, 10)
    assert np.isnan(ratio)
    assert chance == 1.0


def measured(arm, tmp_path, *, scatter, between, seed=1):
    """60 poses of three readings: each pose off by `between`, each reading by `scatter` [m]."""
    rng = np.random.default_rng(seed)
    rows = []
    for k, (q, position) in enumerate(zip(joints(60), arm.positions(joints(60))[:, 0], strict=True)):
        mean = position + between * rng.standard_normal(3)
        rows += [[f"p{k}", *q, *(1e3 * (mean + scatter * rng.standard_normal(3)))] for _ in range(3)]
    return read_measurements(file_of(tmp_path, rows), arm)


def test_repeats_weigh_and_the_noise_found_is_that_of_one_reading(arm, tmp_path):
    fit = calib.fit(arm, measured(arm, tmp_path, scatter=5e-5, between=0.0))
    assert fit.statistics.sigma == pytest.approx(5e-5, rel=0.15)  # standard error 6 %
    assert fit.identification.data.repeatability() == pytest.approx(5e-5, rel=0.1)
    assert fit.identification.data.n_rows == 180
    assert "repeatability" not in [reason.code for reason in fit.verdict.reasons]


def test_residuals_larger_than_the_repeats_scatter_are_pointed_out(arm, tmp_path):
    fit = calib.fit(arm, measured(arm, tmp_path, scatter=1e-5, between=5e-5))
    reason = next(reason for reason in fit.verdict.reasons if reason.code == "repeatability")
    assert "times what repeats of a pose scatter" in reason.text
    assert reason.grade == "CHECK"
    assert "ISO 9283-style, 60 poses used" in fit.report()


def test_accuracy_and_repeatability_of_validation_poses_are_told_too(arm, tmp_path):
    data = measured(arm, tmp_path, scatter=5e-5, between=0.0)
    fit = calib.fit(arm, data.subset(np.arange(45)), validation=data.subset(np.arange(45, 60)))
    assert "ISO 9283-style, 15 poses not used" in fit.report()
    table = to_dict(fit)["repeats_validation"]
    assert table["n_readings"] == 45
    assert table["pose_accuracy"]["after"]["mean"] > to_dict(fit)["repeats"]["pose_accuracy"]["after"]["mean"]


def test_repeats_whose_encoders_differ_scatter_about_what_the_model_predicts(tmp_path):
    scatter = 4e-5
    (tmp_path / "unknown").mkdir()
    yaml = f"priors: false\n{YAML}" + "  - {origin: j2, components: [x], sigma: 2 mm}\n"
    yaml = yaml.replace("frame: l0", "frame: l0, pose: unknown")  # the displacement is told in the tracker's frame
    robot = calib.load(write_six_axis(tmp_path / "unknown", yaml))
    truth = robot.with_parameters({"base.x": 2.0, "base.rz": 2.2, "j2.x": 0.052})
    rng = np.random.default_rng(3)
    q = np.repeat(joints(50), 6, axis=0)
    q += rng.uniform(-8e-4, 8e-4, q.shape)
    positions = truth.positions(q)[:, 0] + scatter * rng.standard_normal((len(q), 3))
    rows = [[f"p{k // 6}", *q[k], *(1e3 * positions[k])] for k in range(len(q))]
    data = read_measurements(file_of(tmp_path, rows), robot)
    assert np.isnan(data.repeatability())  # positions alone do not tell motion from scatter
    fit = calib.fit(robot, data.subset(np.arange(40)), validation=data.subset(np.arange(40, 50)))
    # 250 degrees of freedom for each axis: 2.6 % standard error over the three
    assert fit.identification.data.repeatability() == pytest.approx(scatter, rel=0.1)
    assert fit.validation.data.repeatability() == pytest.approx(scatter, rel=0.2)
    # mean(l) + 3 std(l) of six readings: between 2 and 4.5 sigma for normal scatter
    assert to_dict(fit)["repeats"]["pose_repeatability"]["mean"] < 4.5e3 * scatter
    assert "repeatability" not in [reason.code for reason in fit.verdict.reasons]
