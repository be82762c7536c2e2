"""Many calibrations at once: the numbers of separate fits, whoever does them, and honest sums over draws."""

import json
import os
import signal
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.base.workers import Workers, results_in_order
from calib.core.fitting.settings import Settings
from calib.core.judging.findings import outliers
from calib.studies.study import RepeatedCalibration
from calib.studies.study_data import ResampledDraws
from tests.core.base.test_workers import Shared
from tests.project import EXAMPLES
from tests.six_axis_arm import FREE, NO_PRIORS, YAML, joints, write_six_axis

SIGMA = 2e-5


@pytest.fixture(scope="module", autouse=True)
def _small_chunks():
    """Two chunks of work from 6 draws on."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("calib.studies.study._CHUNK", 5)
        yield


@pytest.fixture(scope="module")
def five_bar():
    robot = calib.load(EXAMPLES / "five_bar.yaml")
    return robot, calib.read_measurements(EXAMPLES / "five_bar_simulated.csv", robot)


@pytest.fixture(scope="module")
def alone(five_bar):
    """A study that nobody shares the work of."""
    return calib.study(*five_bar, draws=6)


@pytest.fixture(scope="module")
def arm_with_priors(tmp_path_factory):
    small = FREE.replace("2 mm", "0.4 mm").replace("5 mrad", "1 mrad")
    return calib.load(write_six_axis(tmp_path_factory.mktemp("priors"), YAML + small))


def bent(robot, share=0.5):
    """A robot whose free parameters are off by a share of their sigma, up and down in turn."""
    sign = np.where(np.arange(len(robot.parameters)) % 2, 1.0, -1.0)
    sigma = np.array([parameter.sigma_si for parameter in robot.parameters])
    return robot.with_parameters(robot.values + share * sign * sigma * robot.is_free)


def with_errors(data, errors, name="ball"):
    """Readings that are off, (n, 3) [m]."""
    values = data.readings[name].values.copy()
    values[:, :3] += errors
    return replace(data, readings=data.readings | {name: replace(data.readings[name], values=values)})


def with_blunders(exact, rng):
    """Normal noise, and one position in twenty off by a millimetre."""
    noise = SIGMA * rng.standard_normal((len(exact), 3))
    noise[rng.choice(len(noise), len(noise) // 20, replace=False)] += 1e-3
    return with_errors(exact, noise)


def twice_as_loud(exact, rng):
    """Normal noise of twice the size that is stated."""
    return with_errors(exact, 2 * SIGMA * rng.standard_normal((len(exact), 3)))


def sometimes_no_contact(exact, rng):
    """No noise; in some draws the measurement fails."""
    if rng.random() < 0.3:
        raise calib.UnreachablePoseError("no contact")
    return exact


def fits_of(robot, first, others, **given):
    """Fits that repeat the first one and fits by themselves, of other data, and how many std apart they are."""
    repeated = RepeatedCalibration(calib.fit(robot, first, **given), Settings(**given))
    for data in others:
        made, alone = repeated.fit(data), calib.fit(robot, data, **given)
        off = (made.robot.values[made.free] - alone.robot.values[alone.free]) / alone.statistics.std
        yield made, alone, np.max(np.abs(off))


@pytest.mark.quick(1)
@pytest.mark.parametrize("loss", ["none", "tukey"])
@pytest.mark.parametrize("case", ["arm", "five_bar", "arm_with_priors"])
def test_a_draw_gives_the_numbers_of_a_separate_fit(case, loss, request):
    given = request.getfixturevalue(case)
    robot, poses = given if isinstance(given, tuple) else (given, joints(30))
    data = [calib.simulate(bent(robot), poses, SIGMA, seed) for seed in (1, 2)]
    ((made, alone, off),) = fits_of(robot, data[0], data[1:], sigma=SIGMA, loss=loss)
    # both stop where the next step is below 1e-4 standard deviations; robust weights stand to a thousandth
    assert off < (1e-4 if loss == "none" else 1e-2)
    assert made.statistics.std == pytest.approx(alone.statistics.std, rel=1e-5 if loss == "none" else 1e-2)
    assert made.converged
    assert bool(outliers(made)) == bool(alone.outliers)


TWO_INSTRUMENTS = """\
instruments:
  camera: {kind: pose, target: plate, sigma: 0.03 mm, sigma_angle: 0.02 deg}
  tracker: {kind: position, target: ball, sigma: 0.02 mm}
parametrisation:
"""


@pytest.mark.quick(0)
@pytest.mark.parametrize("instruments", [TWO_INSTRUMENTS, "parametrisation:\n"])
def test_draws_give_all_the_numbers_of_separate_fits(instruments, tmp_path):
    """Several groups of rows, an outlier; poses that are visited again and are off by the same each time."""
    several = instruments is TWO_INSTRUMENTS
    yaml = NO_PRIORS + YAML.replace("targets:\n", "targets:\n  plate: {frame: l6}\n" if several else "targets:\n")
    robot = calib.load(write_six_axis(tmp_path, yaml.replace("parametrisation:\n", instruments) + FREE))
    sigma, name = (None, "tracker") if several else (SIGMA, "ball")
    truth, poses = bent(robot, 0.1), joints(50) if several else joints(27)[np.r_[:27, :4, :4]]
    exact = calib.simulate(truth, poses, 0.0)
    named = exact if several else replace(exact, names=tuple(str(k if k < 27 else (k - 27) % 4) for k in range(35)))
    data = [calib.simulate(truth, named, sigma, seed) for seed in range(4)]
    errors = np.zeros((len(poses), 3))
    if several:
        errors[3, 0] = 1.2e-4
    else:
        errors[:4] = errors[27:31] = errors[31:] = 3e-4 * np.random.default_rng(0).standard_normal((4, 3))
    data.append(with_errors(data[0], errors, name))
    for made, alone, off in fits_of(robot, data[0], data, sigma=sigma):
        statistics = alone.statistics
        assert off < 1e-4
        assert made.statistics.std == pytest.approx(statistics.std, rel=1e-5)
        assert made.statistics.covariance == pytest.approx(
            statistics.covariance, rel=1e-4, abs=1e-5 * np.max(made.statistics.std) ** 2
        )
        assert made.statistics.half_width == pytest.approx(statistics.half_width, rel=1e-4)
        assert made.statistics.freedom == pytest.approx(statistics.freedom, rel=1e-9)
        found = [[estimate.sigma for estimate in fit.noise] for fit in (made, alone)]
        assert found[0] == pytest.approx(found[1], rel=1e-7)
        assert made.chi_square.value == pytest.approx(alone.chi_square.value, rel=1e-7)
        assert bool(outliers(made)) == bool(alone.outliers)
    assert bool(outliers(made)) == several
    assert (statistics.shared_scatter is None) == several


@pytest.mark.quick(0)
def test_draws_of_which_more_is_to_be_found_give_the_numbers_of_fits(five_bar):
    """Noise that contradicts what is stated, with priors; readings that are missing."""
    robot, data = five_bar
    robot = robot.with_prior("left_elbow.x", "0.1 mm")
    quiet, loud = (calib.simulate(robot, data, sigma, 1) for sigma in (SIGMA, 4 * SIGMA))
    pen = quiet.readings["pen"]
    fewer = {key: np.delete(getattr(pen, key), 7, axis=0) for key in ("visits", "pairs", "values", "details")}
    missing = replace(quiet, readings={"pen": replace(pen, **fewer)})
    for made, alone, off in fits_of(robot, quiet, (quiet, loud, missing), sigma=SIGMA):
        assert off < 1e-2
        assert made.statistics.std == pytest.approx(alone.statistics.std, rel=1e-2)  # noise is found to one percent


@pytest.mark.quick(0)
def test_numbers_do_not_depend_on_who_works(five_bar):
    robot, data = five_bar
    given = {"truth": bent(robot), "draws": 6, "seed": 3, "elsewhere": data.joints[::9]}
    told = []
    alone = calib.study(robot, data, **given, progress=lambda done, total: told.append((done, total)))
    assert told == [(5, 6), (6, 6)]
    with Workers(2) as processes, ThreadPoolExecutor(2) as threads:
        for executor in (processes, threads):
            shared = calib.study(robot, data, **given, executor=executor)
            for name in ("truth", "values", "std", "chi_square", "errors", "error_half_width", "names_outliers"):
                assert np.array_equal(getattr(shared.draws, name), getattr(alone.draws, name)), name
        resampled = [calib.study(robot, data, draws=6, resample=True, executor=item) for item in (None, processes)]
        assert np.array_equal(resampled[0].draws.values, resampled[1].draws.values)
        assert not resampled[0].failures
    fewer = calib.study(robot, data, **given | {"draws": 3})
    assert fewer.draws.values == pytest.approx(alone.draws.values[:3], rel=1e-9)  # a draw has its own seed


@pytest.mark.amount(0, 1)
def test_code_is_compiled_before_work_is_given_out(five_bar, monkeypatch):
    """So that processes find it, instead of compiling it each by itself."""
    pytest.importorskip("numba", reason="numba is not installed (extra 'fast')")
    used = []
    monkeypatch.setattr("calib.studies.study.pays", lambda n_poses: n_poses > 0)
    monkeypatch.setattr("calib.core.robots.acceleration._tell_compiling", lambda: used.append(True))

    class Waiting(ThreadPoolExecutor):
        def submit(self, function, /, *arguments, **named):
            assert used
            return super().submit(function, *arguments, **named)

    with Waiting(1) as executor:
        studied = calib.study(*five_bar, draws=4, sigma=SIGMA, seed=1, executor=executor)
    assert np.all(np.isfinite(studied.draws.values))


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


def test_a_lost_worker_loses_no_draw(five_bar, alone):
    executor = Mislaying()
    studied = calib.study(*five_bar, draws=6, executor=executor)
    assert executor.sent == 3  # two chunks, one of them twice
    assert np.array_equal(studied.draws.values, alone.draws.values)


@pytest.mark.quick(0)
def test_folds_and_starts_of_a_fit_do_not_depend_on_who_works(five_bar):
    robot, data = five_bar
    told, losing = [], Mislaying()
    given = {"folds": 4, "starts": 4, "seed": 5}
    alone = calib.fit(robot, data, **given, progress=lambda done, total: told.append((done, total)))
    assert told == [(done, 10) for done in range(1, 11)]  # three of the fit, three other starts, four folds
    for executor in (2, losing):
        shared = calib.fit(robot, data, **given, executor=executor)
        minima = [[(each.cost, each.count) for each in fit.starts.minima] for fit in (shared, alone)]
        assert minima[0] == minima[1]
        assert np.array_equal(shared.folds.errors.after["pen"], alone.folds.errors.after["pen"])
        assert np.array_equal(shared.folds.errors.singular_value, alone.folds.errors.singular_value)
        assert np.array_equal(shared.robot.values, alone.robot.values)
        assert np.array_equal(shared.statistics.std, alone.statistics.std)
    assert losing.sent == 8  # seven pieces of work, one of them twice


@pytest.mark.parametrize("executor", [0, -1, 1.5, "two"])
def test_who_cannot_work_is_refused(five_bar, executor):
    with pytest.raises(calib.InputError, match=f"executor '?{executor}'?: must be an executor of concurrent"):
        calib.fit(*five_bar, executor=executor)


@pytest.mark.amount(0, 1)
def test_a_dask_cluster_does_the_draws(five_bar, alone, monkeypatch):
    monkeypatch.setattr(Shared, "sent", 0)
    distributed = pytest.importorskip("distributed", reason="distributed is not installed (extra 'dask')")
    robot, data = five_bar
    fit = calib.fit(robot, data, folds=3)
    with (
        distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        studied = calib.study(robot, data, draws=6, executor=client.get_executor())
        folds = calib.fit(robot, data, folds=3, executor=client.get_executor()).folds
        products = list(results_in_order(Shared(3), range(20), client.get_executor()))
    assert products == [3 * k for k in range(20)]
    assert Shared.sent == 1
    assert np.array_equal(studied.draws.values, alone.draws.values)
    assert np.array_equal(folds.errors.after["pen"], fit.folds.errors.after["pen"])


@pytest.mark.quick(0)
@pytest.mark.amount(0, 1)
def test_processes_of_loky_do_the_draws_and_one_that_is_killed_loses_none(five_bar, alone):
    loky = pytest.importorskip("loky", reason="loky is not installed (extra 'loky')")
    executor = loky.get_reusable_executor(max_workers=2)
    try:
        studied = calib.study(*five_bar, draws=6, executor=executor)
        os.kill(executor.submit(os.getpid).result(), signal.SIGKILL)
        after_loss = calib.study(*five_bar, draws=6, executor=executor)
    finally:
        executor.shutdown(kill_workers=True)
    assert np.array_equal(studied.draws.values, alone.draws.values)
    assert np.array_equal(after_loss.draws.values, alone.draws.values)


@pytest.mark.quick(0)
def test_sums_over_draws_are_those_of_the_arrays(arm):
    studied = calib.study(arm, joints(30), draws=40, truth=bent(arm), sigma=SIGMA, elsewhere=joints(4, 5))
    draws, truth = studied.draws, bent(arm).values[arm.is_free]
    off = 1e3 * (draws.values - truth)
    parameter = studied.parameters[3]
    assert parameter.name == [p.name for p, free in zip(arm.parameters, arm.is_free, strict=True) if free][3]
    assert parameter.unit == "mm"
    assert parameter.bias == pytest.approx(sum(off[:, 3]) / 40)
    assert parameter.spread == pytest.approx(np.sqrt(sum((off[:, 3] - sum(off[:, 3]) / 40) ** 2) / 39))
    assert parameter.bias_std == pytest.approx(parameter.spread / np.sqrt(40))
    assert parameter.claimed == pytest.approx(np.sqrt(sum((1e3 * draws.std[:, 3]) ** 2) / 40))
    assert parameter.coverage == sum(abs(off[:, 3]) <= 1e3 * draws.half_width[:, 3]) / 40
    assert draws.errors.shape == (40, 4, 1, 3)
    text = studied.report(verbose=True)
    assert f"{parameter.name}" in text
    assert f"{parameter.spread:.3g}" in text
    content = json.loads(json.dumps(studied.to_dict(), allow_nan=False))
    assert content["parameters"][3]["spread"] == pytest.approx(parameter.spread)
    assert content["draws"] == content["answered"] == len(studied) == 40


def test_the_report_of_many_parameters_fits_on_a_screen(arm):
    studied = calib.study(arm, joints(30), draws=6, sigma=SIGMA)
    rows = sorted(studied.parameters, key=lambda parameter: parameter.coverage)
    assert len(rows) > 25
    lines = studied.report().splitlines()
    assert len(lines) <= 40
    assert [line.split()[0] for line in lines[3:13]] == [row.name for row in rows[:10]]
    assert f"{len(rows) - 10} more parameters covered at least as often: --verbose prints them" in lines[13]
    assert len(studied.report(verbose=True).splitlines()) == len(lines) - 11 + len(rows)


def test_truths_drawn_from_the_priors_are_all_different_and_noise_is_what_is_stated(arm_with_priors):
    studied = calib.study(arm_with_priors, joints(20), draws=20, truth="priors", sigma=SIGMA)
    assert np.all(np.std(studied.draws.truth, axis=0) > 0)
    assert studied.chi_square == pytest.approx(1.0, abs=0.2)  # 60 coordinates; the scatter of the mean is 0.05


def test_louder_noise_than_stated_shows_in_chi_square_and_none_is_told_where_nothing_is_stated(arm):
    studied = calib.study(arm, joints(30), draws=30, sigma=SIGMA, noise=twice_as_loud)
    assert studied.chi_square == pytest.approx(4.0, abs=0.5)  # scatter of the mean: 4 sqrt(2 / (64 * 30)) = 0.13
    assert studied.chi_square_refused == 1.0
    assert float(np.mean(studied.draws.sigma)) == pytest.approx(2 * SIGMA, rel=0.1)
    unstated = calib.study(arm, joints(30), draws=4, noise=twice_as_loud)
    assert np.isnan(unstated.chi_square)
    assert unstated.to_dict()["chi_square"] is None
    assert "chi-square" not in str(unstated)


@pytest.mark.quick(0)
def test_blunders_are_named_and_a_robust_loss_keeps_its_promise(arm):
    studied = calib.study(arm, joints(40), draws=30, sigma=SIGMA, noise=with_blunders, loss="tukey")
    assert studied.outliers == 1.0
    coverage = np.mean([parameter.coverage for parameter in studied.parameters])
    assert coverage > 0.88  # 26 parameters, 30 draws, 2 % scatter


def test_a_truth_that_the_model_leaves_out_shows_as_bias(five_bar):
    robot, data = five_bar
    left_out = robot.free("right_motor.y").with_parameters({"right_motor.y": 3e-4})
    studied = calib.study(robot, data, draws=20, truth=left_out)
    worst = max(studied.parameters, key=lambda item: abs(item.bias) / item.bias_std)
    assert abs(worst.bias) > 10 * worst.bias_std
    assert "biased by more than chance" in str(studied)


def test_draws_without_an_answer_are_counted_and_left_out(five_bar):
    robot, data = five_bar
    studied = calib.study(robot, data, draws=12, noise=sometimes_no_contact, seed=4)
    lost = len(studied.failures)
    assert 0 < lost == 12 - len(studied.draws) < 12
    assert np.all(np.isfinite(studied.draws.values))
    assert np.all(np.isfinite([parameter.spread for parameter in studied.parameters]))
    assert f"{lost} draws gave no answer: no contact" in str(studied)
    assert studied.to_dict()["answered"] == 12 - lost


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"draws": 1}, "draws 1: must be 2 or more"),
        ({"sigma": None}, "states no noise"),
        ({"sigma": -1.0}, "sigma -1 m"),
        ({"loss": "least"}, "least"),
        ({"truth": "priors"}, "has no priors"),
        ({"truth": "nominal"}, "truth 'nominal'"),
        ({"seed": -1}, "seed -1"),
        ({"elsewhere": [[0.0, 1.0]]}, "joint values of shape"),
        ({"resample": True}, "resample: needs measurements"),
        ({"resample": True, "truth": "priors"}, "truth and noise have no effect"),
        ({"resample": True, "noise": with_blunders}, "truth and noise have no effect"),
        ({"poses": joints(5)}, "measure at least"),
    ],
)
def test_what_makes_no_sense_is_refused(arm, given, message):
    with pytest.raises(calib.CalibrationError, match=message):
        calib.study(arm, **{"poses": joints(30), "draws": 4, "sigma": SIGMA} | given)


def uneven(exact, rng):
    """Noise that is eight times as large where the arm leans far to one side."""
    size = np.where(exact.joints[:, 1:3].sum(axis=1) > 1, 8.0, 1.0)[:, None]
    return with_errors(exact, SIGMA * size * rng.standard_normal((len(exact), 3)))


def sandwich(fit, data):
    """Standard deviations H^-1 (sum over poses of g g^T) H^-1 of positions that weigh alike, by differences."""
    free = np.flatnonzero(fit.free)
    step = 1e-6
    columns = []
    for k in free:
        change = step * np.eye(len(fit.robot.values))[k]
        ends = [fit.robot.with_parameters(fit.robot.values + s * change).positions(data.joints) for s in (1, -1)]
        columns.append((ends[0] - ends[1])[:, 0] / (2 * step))
    slopes = np.stack(columns, axis=2)  # (n_poses, 3, n_free)
    off = fit.robot.positions(data.joints)[:, 0] - data.readings["ball"].values
    hessian = sum(slope.T @ slope for slope in slopes)
    gradients = [slope.T @ item for slope, item in zip(slopes, off, strict=True)]
    inverse = np.linalg.inv(hessian)
    return np.sqrt(np.diag(inverse @ sum(np.outer(g, g) for g in gradients) @ inverse))


@pytest.mark.quick(0)
@pytest.mark.amount(80, 200)
def test_drawing_poses_again_finds_the_scatter_that_uneven_noise_makes(arm, amount):
    data = uneven(calib.simulate(bent(arm), joints(150), 0.0), np.random.default_rng(6))
    fit = calib.fit(arm, data)
    studied = calib.study(arm, data, draws=amount, resample=True)
    spread = np.array([parameter.spread for parameter in studied.parameters])
    expected = sandwich(fit, data) * [name.per_si for name in studied.free]
    # 200 draws know a standard deviation to 5 %, 80 to 8 %; the rest is what 150 poses are short of many
    assert spread == pytest.approx(expected, rel=0.15 + 1.4 / np.sqrt(amount))
    assert np.mean(spread / expected) == pytest.approx(1.0, abs=0.1)
    claimed = np.array([parameter.claimed for parameter in studied.parameters]) / expected
    assert claimed.max() / claimed.min() > 1.5  # which the fit, told that noise is even, does not know
    assert np.array_equal(studied.draws.truth[0], fit.robot.values[fit.free])
    assert np.isnan(studied.chi_square)
    assert f"{amount} calibrations of six axes, each from 150 of its 150 poses, with replacement" in str(studied)
    assert "intervals contain what all poses give" in str(studied)
    assert "outlier" not in str(studied)
    assert studied.to_dict()["resampled"] is True


def test_repeats_of_a_pose_are_drawn_together_and_a_pose_drawn_twice_is_two(arm):
    q = np.repeat(joints(40), 2, axis=0)
    measured = calib.simulate(bent(arm), q, SIGMA, 3)
    data = replace(measured, names=tuple(f"p{k // 2}" for k in range(80)))
    source = ResampledDraws(arm, data, arm.assemble(q).passive)
    drawn = source.draw(np.random.SeedSequence(1))[1]
    assert len(drawn) == 80
    assert drawn.n_poses == 40
    said = [name.split(": ") for name in drawn.names]
    for turn in range(40):
        which = [k for k, (number, _) in enumerate(said) if number == str(turn)]
        pose = said[which[0]][1]
        own = [k for k, name in enumerate(data.names) if name == pose]
        assert np.array_equal(drawn.readings["ball"].values[which], data.readings["ball"].values[own])
    assert 15 < len({pose for _, pose in said}) < 36  # 1 - 1 / e of 40 is 25


@pytest.mark.quick(0)
def test_the_command_prints_and_writes_what_python_gives(five_bar, run_calib, tmp_path):
    robot, data = five_bar
    files = EXAMPLES / "five_bar.yaml", EXAMPLES / "five_bar_simulated.csv"
    options = ("--draws", 4, "--seed", 2, "--jobs", 1)
    target = tmp_path / "study.json"
    truth = EXAMPLES / "five_bar_truth.csv"
    given = ("--truth", truth, "--sigma-mm", 0.05, "--loss", "huber", "--elsewhere", files[1])
    done = run_calib("study", *files, *options, *given, "--json", target)
    true = robot.with_parameters(calib.read_parameters(truth, robot))
    by_name = {"draws": 4, "seed": 2, "sigma": 5e-5, "loss": "huber", "elsewhere": data.joints}
    studied = calib.study(robot, data, truth=true, **by_name)
    assert (done.code, done.out.rstrip(), done.err) == (0, str(studied), "")
    written = json.loads(target.read_text())
    assert written.pop("written_by").startswith("written by")
    assert written | {"seconds": 0} == json.loads(json.dumps(studied.to_dict())) | {"seconds": 0}
    again = run_calib("study", *files, *options, "--resample")
    assert again.out.rstrip() == str(calib.study(robot, data, draws=4, seed=2, resample=True))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("five_bar.yaml", "five_bar_simulated.csv", "--draws", 1), "1 is not in the range x>=2"),
        (("five_bar.yaml", "five_bar_simulated.csv", "--jobs", 0), "0 is not in the range x>=1"),
        (("five_bar.yaml", "five_bar_simulated.csv", "--truth", "nowhere.csv"), "nowhere.csv: no such file"),
        (("five_bar.yaml", "five_bar_simulated.csv", "--truth", "arm.yaml"), "has joints joint_1"),
        (("five_bar.yaml", "five_bar_truth.csv", "--resample"), "no column 'left_motor'"),
    ],
)
def test_wrong_input_of_the_command_is_one_line(run_calib, given, said):
    done = run_calib("study", *given, cwd=EXAMPLES)
    assert said in done.refusal()
    assert done.err.count("\n") == 1
    assert done.out == ""


@pytest.mark.quick(0)
def test_intervals_hold_what_bends_along_directions_that_priors_hold(robot, data):
    """3 mrad that no reading sees make 3 um of 1 mm, and readings tell joint_2.x to 2 um."""
    draws = calib.study(robot, data, draws=60, truth="priors", sigma=5e-6, seed=7).draws
    k = [p.name for p, free in zip(robot.parameters, robot.is_free, strict=True) if free].index("joint_2.x")
    off = np.abs(draws.values - draws.truth)
    assert np.mean(off <= draws.half_width) == pytest.approx(0.95, abs=0.02)
    # of 60 draws 52 or fewer are one in forty where 95 % are promised
    assert np.mean(off[:, k] <= draws.half_width[:, k]) > 52 / 60
    fit = calib.fit(robot, calib.simulate(robot, data, 5e-6, 1), sigma=5e-6)
    linear = fit.statistics.coverage_factor * fit.statistics.std
    assert np.mean(off[:, k] <= linear[k]) < 52 / 60
    assert np.all(fit.statistics.half_width >= linear)
