"""Many simulated calibrations at once: the numbers of separate fits, whoever does them, and honest sums over draws."""

import json
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from six_axis_arm import FREE, YAML, joints, six_axis_arm, write_six_axis

import calib
from calib.identification.fit import Settings
from calib.identification.repeated import Repeated
from calib.workers import Workers

EXAMPLES = Path(__file__).parents[1] / "docs" / "examples"
SIGMA = 2e-5


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return six_axis_arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="module")
def five_bar():
    robot = calib.load(EXAMPLES / "five_bar.yaml")
    return robot, calib.read_measurements(EXAMPLES / "five_bar_simulated.csv", robot)


@pytest.fixture(scope="module")
def arm_with_priors(tmp_path_factory):
    small = FREE.replace("2 mm", "0.4 mm").replace("5 mrad", "1 mrad")
    return calib.load(write_six_axis(tmp_path_factory.mktemp("priors"), YAML + small))


def bent(robot, share=0.5):
    """A robot whose free parameters are off by a share of their sigma, up and down in turn."""
    sign = np.where(np.arange(len(robot.parameters)) % 2, 1.0, -1.0)
    sigma = np.array([parameter.sigma for parameter in robot.parameters])
    return robot.with_parameters(robot.values + share * sign * sigma * robot.is_free)


def with_blunders(exact, rng):
    """Normal noise, and one position in twenty off by a millimetre."""
    readings = exact.readings["ball"]
    noise = SIGMA * rng.standard_normal(readings.values.shape)
    noise[rng.choice(len(noise), len(noise) // 20, replace=False)] += 1e-3
    return replace(exact, readings={"ball": replace(readings, values=readings.values + noise)})


def twice_as_loud(exact, rng):
    """Normal noise of twice the size that is stated."""
    readings = exact.readings["ball"]
    values = readings.values + 2 * SIGMA * rng.standard_normal(readings.values.shape)
    return replace(exact, readings={"ball": replace(readings, values=values)})


def sometimes_no_contact(exact, rng):
    """No noise; in some draws the measurement fails."""
    if rng.random() < 0.3:
        raise calib.UnreachablePoseError("no contact")
    return exact


@pytest.mark.parametrize("loss", ["none", "tukey"])
@pytest.mark.parametrize("case", ["arm", "five_bar", "arm_with_priors"])
def test_a_draw_gives_the_numbers_of_a_separate_fit(case, loss, request):
    given = request.getfixturevalue(case)
    robot, poses = given if isinstance(given, tuple) else (given, joints(30))
    truth = bent(robot)
    data = [calib.simulate(truth, poses, SIGMA, seed) for seed in (1, 2)]
    settings = Settings(sigma=SIGMA, loss=loss)
    found = Repeated(calib.fit(robot, data[0], sigma=SIGMA, loss=loss), settings).estimate(data[1])
    alone = calib.fit(robot, data[1], sigma=SIGMA, loss=loss)
    off = (found.robot.values - alone.robot.values)[alone.free] / alone.statistics.std
    # both stop where the next step is below 1e-4 standard deviations; robust weights stand to a thousandth
    assert np.max(np.abs(off)) < (1e-4 if loss == "none" else 1e-2)
    assert found.statistics.std == pytest.approx(alone.statistics.std, rel=1e-5 if loss == "none" else 1e-2)
    assert found.convergence.converged
    assert found.names_outliers == bool(alone.outliers)


def test_numbers_do_not_depend_on_who_works(five_bar):
    robot, data = five_bar
    given = {"truth": bent(robot), "draws": 60, "seed": 3, "elsewhere": data.joints[::9]}
    told = []
    alone = calib.study(robot, data, **given, progress=lambda done, total: told.append((done, total)))
    assert told == [(50, 60), (60, 60)]
    with Workers(2) as processes, ThreadPoolExecutor(2) as threads:
        for executor in (processes, threads):
            shared = calib.study(robot, data, **given, executor=executor)
            for name in ("truth", "values", "std", "chi_square", "errors", "error_half_width", "names_outliers"):
                assert np.array_equal(getattr(shared.draws, name), getattr(alone.draws, name)), name
    fewer = calib.study(robot, data, **given | {"draws": 5})
    assert fewer.draws.values == pytest.approx(alone.draws.values[:5], rel=1e-9)  # a draw has its own seed


class Mislaying(Executor):
    """Loses the first piece of work that it is sent."""

    def __init__(self):
        self.sent = 0

    def submit(self, function, /, *arguments, **named):
        future, self.sent = Future(), self.sent + 1
        if self.sent == 1:
            future.set_exception(ConnectionError("the cluster was restarted"))
        else:
            future.set_result(function(*arguments, **named))
        return future


def test_a_lost_worker_loses_no_draw(five_bar):
    robot, data = five_bar
    executor = Mislaying()
    found = calib.study(robot, data, draws=60, executor=executor)
    assert executor.sent == 3  # two chunks, one of them twice
    assert np.array_equal(found.draws.values, calib.study(robot, data, draws=60).draws.values)


def test_a_dask_cluster_does_the_draws(five_bar):
    distributed = pytest.importorskip("distributed", reason="distributed is not installed (extra 'dask')")
    robot, data = five_bar
    alone = calib.study(robot, data, draws=60)
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        found = calib.study(robot, data, draws=60, executor=client.get_executor())
    assert np.array_equal(found.draws.values, alone.draws.values)


def test_sums_over_draws_are_those_of_the_arrays(arm):
    found = calib.study(arm, joints(30), draws=40, truth=bent(arm), sigma=SIGMA, elsewhere=joints(4, 5))
    draws, truth = found.draws, bent(arm).values[arm.is_free]
    off = draws.values - truth
    one = found.parameters[3]
    assert one.name == [p.name for p, free in zip(arm.parameters, arm.is_free, strict=True) if free][3]
    assert one.bias == pytest.approx(sum(off[:, 3]) / 40)
    assert one.spread == pytest.approx(np.sqrt(sum((off[:, 3] - sum(off[:, 3]) / 40) ** 2) / 39))
    assert one.bias_std == pytest.approx(one.spread / np.sqrt(40))
    assert one.claimed == pytest.approx(np.sqrt(sum(draws.std[:, 3] ** 2) / 40))
    assert one.coverage == sum(abs(off[:, 3]) <= draws.half_width[:, 3]) / 40
    assert draws.errors.shape == (40, 4, 1, 3)
    text = found.report()
    assert f"{one.name}" in text
    assert f"{1e3 * one.spread:.3g}" in text
    content = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert content["parameters"][3]["spread"] == pytest.approx(1e3 * one.spread)
    assert content["draws"] == content["answered"] == len(found) == 40


def test_intervals_hold_truths_drawn_from_the_priors(arm_with_priors):
    found = calib.study(arm_with_priors, joints(20), draws=150, truth="priors", sigma=SIGMA)
    # 36 parameters in 150 draws; one standard deviation of the mean is at most 1.8 %
    assert np.mean([one.coverage for one in found.parameters]) == pytest.approx(0.95, abs=0.03)
    assert np.all(np.std(found.draws.truth, axis=0) > 0)
    assert found.chi_square == pytest.approx(1.0, abs=0.15)  # 60 coordinates; the scatter of the mean is 0.02


def test_louder_noise_than_stated_shows_in_chi_square(arm):
    found = calib.study(arm, joints(30), draws=30, sigma=SIGMA, noise=twice_as_loud)
    assert found.chi_square == pytest.approx(4.0, abs=0.5)  # scatter of the mean: 4 sqrt(2 / (64 * 30)) = 0.13
    assert found.chi_square_refused == 1.0
    assert float(np.mean(found.draws.sigma)) == pytest.approx(2 * SIGMA, rel=0.1)


def test_where_no_noise_is_stated_there_is_no_chi_square(arm):
    found = calib.study(arm, joints(30), draws=4, noise=twice_as_loud)
    assert np.isnan(found.chi_square)
    assert found.to_dict()["chi_square"] is None
    assert "chi-square" not in str(found)


def test_blunders_are_named_and_a_robust_loss_keeps_its_promise(arm):
    found = calib.study(arm, joints(40), draws=30, sigma=SIGMA, noise=with_blunders, loss="tukey")
    assert found.outliers == 1.0
    assert np.mean([one.coverage for one in found.parameters]) > 0.88  # 26 parameters, 30 draws, 2 % scatter


def test_a_truth_that_the_model_leaves_out_shows_as_bias(five_bar):
    robot, data = five_bar
    left_out = robot.free("right_motor.y").with_parameters({"right_motor.y": 3e-4})
    found = calib.study(robot, data, draws=20, truth=left_out)
    worst = max(found.parameters, key=lambda one: abs(one.bias) / one.bias_std)
    assert abs(worst.bias) > 10 * worst.bias_std
    assert "biased by more than chance" in str(found)


def test_draws_without_an_answer_are_counted_and_left_out(five_bar):
    robot, data = five_bar
    found = calib.study(robot, data, draws=12, noise=sometimes_no_contact, seed=4)
    lost = int(np.sum(~found.draws.answered))
    assert 0 < lost == len(found.failures) < 12
    assert np.all(np.isfinite([one.spread for one in found.parameters]))
    assert f"{lost} draws gave no answer: no contact" in str(found)
    assert found.to_dict()["answered"] == 12 - lost


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"draws": 1}, "draws 1: must be 2 or more"),
        ({"executor": 0}, "executor 0: a number of processes"),
        ({"sigma": None}, "states no noise"),
        ({"sigma": -1.0}, "sigma -1 m"),
        ({"loss": "least"}, "least"),
        ({"truth": "priors"}, "has no priors"),
        ({"truth": "nominal"}, "truth 'nominal'"),
        ({"seed": -1}, "seed -1"),
        ({"elsewhere": [[0.0, 1.0]]}, "joint values of shape"),
    ],
)
def test_what_makes_no_sense_is_refused(arm, given, message):
    with pytest.raises(calib.CalibrationError, match=message):
        calib.study(arm, joints(30), **{"draws": 4, "sigma": SIGMA} | given)


def test_too_few_poses_are_refused_as_by_a_fit(arm):
    with pytest.raises(calib.DataError, match="measure at least"):
        calib.study(arm, joints(5), draws=4, sigma=SIGMA)
