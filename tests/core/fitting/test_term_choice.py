"""Which joint terms a fit adds: what is there is found, what is not there is left out, intervals cover, real robots.

`python -m tests.core.fitting.test_term_choice coverage 400` prints a table of docs/theory/joint_terms.md, and
`... choice 100` how often terms are found; a further number is the seed.
"""

import argparse
import re
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.core.base.threads import one_blas_thread
from calib.core.data.pose_groups import boxes
from calib.core.fitting.terms.candidate_terms import candidates
from calib.core.fitting.terms.joint_curves import is_beyond_learned
from calib.core.fitting.terms.kind_model import KindModel
from calib.core.robots.terms.one_coefficient import CouplingSection
from calib.core.robots.terms.terms import TERMS, parse_terms
from tests.core.robots.terms.test_compliance import arm, torques, upright_five_bar
from tests.project import EXAMPLES, write_table
from tests.public_data import motoman

NOISE = 2e-5
"""Standard deviation of simulated measurements per axis [m]."""
KINDS = tuple(name for name in TERMS if TERMS[name].in_auto)


def example_arm(_):
    return calib.load(EXAMPLES / "arm.yaml")


def five_bar(folder):
    return upright_five_bar(folder)[0].with_terms(())


def entries(robot, terms):
    """Entries of these terms for all joints; of a coupling, every joint by the one before it."""
    chain = zip(robot.joint_names[1:], robot.joint_names, strict=False)
    pairs = [CouplingSection(joint=joint, term="coupling", driven_by=other) for joint, other in chain]
    listed = ",".join(term for term in terms if term != "coupling")
    return (*(parse_terms(listed) if listed else ()), *(pairs if "coupling" in terms else ()))


def simulated(robot, terms, rng, n=60):
    """A robot with these terms whose parameters are as large as is expected, and n visits of it with all conditions."""
    true = robot.with_terms(entries(robot, terms))
    sigma = np.array([0.0 if p.name in robot.description.held else p.sigma_si for p in true.parameters])
    if not robot.description.priors:
        sigma[: robot.n_origin_parameters] *= 0.2  # far enough, and every loop closes
    true = true.with_parameters(true.values + sigma * rng.standard_normal(len(sigma)))
    reach = 0.5 if robot.passive_names else 1.5
    q = (robot.home if robot.passive_names else 0.0) + rng.uniform(-reach, reach, (2 * n, len(robot.joint_names)))
    return true, _measured(robot, true, q[:n], rng), q[n:]


def _measured(robot, true, q, rng):
    data = calib.as_measurements(robot, q, np.zeros((len(q), 3)))
    context = {"time": 120.0 * np.arange(len(q)), "temperature": 20 + 3 * rng.random(len(q))}
    data = replace(data, context=context, approach=np.sign(rng.standard_normal(q.shape)))
    seen = calib.core.rows.observed.predict_readings(true, true.assemble(q, context=data.conditions))
    readings = {
        name: replace(item, values=item.values + NOISE * rng.standard_normal(item.values.shape))
        for name, item in seen.items()
    }
    return replace(data, readings=readings)


@one_blas_thread
def choices(robot, terms, n, seed):
    """Of n simulated calibrations with these terms, how often what is there is added, and anything else.

    Each in two numbers: surely there, and not surely. Then the part of the 95 % intervals that hold the truth: of
    origins, and of positions at poses not measured; and the root mean square error there over that of a fit to which
    the terms were told.
    """
    counts = np.zeros((2, 2), dtype=int)
    origins, held, squares = [], [], np.zeros(2)
    for number in range(n):
        true, data, elsewhere = simulated(robot, terms, np.random.default_rng([seed, number]))
        fit = calib.fit(robot, data, terms="auto")
        known = dict(zip((p.name for p in true.parameters), true.values, strict=True))
        of_origins = {p.name for p in robot.parameters[: robot.n_origin_parameters]} & set(fit.free_names)
        estimates = {name: fit.parameters[name] for name in sorted(of_origins)}
        origins += [item.low95_si <= known[name] <= item.high95_si for name, item in estimates.items()]
        for item in (trial for trial in fit.terms.trials if trial.added):
            counts[int(item.term not in terms), int(not item.proven)] += 1
        for k, other in enumerate((fit, calib.fit(robot.with_terms(entries(robot, terms)), data))):
            errors, inside = position_errors(other, true, elsewhere)
            squares[k] += np.mean(errors**2)
            held += inside if k == 0 else []
    parts = (round(100 * float(np.mean(part)), 1) for part in (origins, held))
    return (*counts.ravel().tolist(), *parts, round(float(np.sqrt(squares[0] / squares[1])), 2))


@one_blas_thread
def coverage(robot, terms, n, seed):
    """Parts of the 95 % intervals of each calibration that hold the truth, (n, 2).

    They are those of coefficients, and of positions at poses not measured.
    """
    parts = []
    for number in range(n):
        true, data, elsewhere = simulated(robot, terms, np.random.default_rng([seed, number]))
        fit = calib.fit(robot.with_terms(entries(robot, terms)), data, sigma=NOISE)
        known = dict(zip((p.name for p in true.parameters), true.values, strict=True))
        wide = fit.statistics.half_width
        own = [k for k, i in enumerate(fit.unknowns.index) if i >= fit.robot.coefficients.start]
        values = fit.robot.values[fit.unknowns.index]
        inside = [abs(values[k] - known[fit.free_names[k]]) <= wide[k] for k in own]
        parts.append((np.mean(inside), np.mean(position_errors(fit, true, elsewhere)[1])))
    return np.array(parts)


def position_errors(fit, true, q):
    """Errors of predicted positions per axis [m], and which of them their 95 % intervals hold."""
    predicted = fit.predict(q)
    errors = np.abs(predicted.positions - true.positions(q))
    moves = predicted.std > 1e-9  # the pen of the five-bar stays in its plane, whatever the parameters
    return errors, list((errors <= predicted.coverage_factor * predicted.std)[moves])


def sure(fit):
    """Kinds that are surely there."""
    return {trial.term for trial in fit.terms.trials if trial.proven}


@pytest.mark.parametrize("off", [1e-3, 3e-3])
def test_a_wrong_reading_that_is_left_out_hides_no_terms(robot, off):
    _, data, _ = simulated(robot, ("gain", "backlash"), np.random.default_rng(5), n=40)
    ((name, readings),) = data.readings.items()
    values = readings.values.copy()
    values[7] += off
    steps = []
    data = replace(data, readings={name: replace(readings, values=values)})
    fit = calib.fit(robot, data, terms="auto", exclude_outliers=True, progress=lambda *counts: steps.append(counts))
    assert [outlier.pose for outlier in fit.excluded] == [7]
    assert {trial.term for trial in fit.terms.trials if trial.added} == {"gain", "backlash"}
    assert {name.rpartition(".")[2] for name in fit.free_names} >= {"gain", "backlash"}
    assert steps[-1][0] == steps[-1][1]


def test_what_is_there_is_added_and_nothing_else(robot):
    true, data, _ = simulated(robot, ("gain", "backlash"), np.random.default_rng(5), n=40)
    fit = calib.fit(robot, data, terms="auto")
    assert sure(fit) == {"gain", "backlash"}
    known = dict(zip((p.name for p in true.parameters), true.values, strict=True))
    for k, name in enumerate(fit.free_names):
        if name.endswith((".gain", ".backlash")):  # six times the standard deviation: one of a hundred million
            assert abs(fit.robot.values[fit.unknowns.index[k]] - known[name]) < 6 * fit.statistics.std[k]
    told = {trial.term: trial for trial in fit.terms.trials}
    assert told["gain"].evidence > 20
    assert told["gain"].size95[0] < told["gain"].size < told["gain"].size95[1]
    assert all(trial.size95[0] <= trial.size <= trial.size95[1] for trial in told.values() if trial.size > 0)
    report = " ".join(fit.report(verbose=True).split())
    assert "Joint terms added: gain of joint_" in report
    assert ", surely there)" in report
    assert re.search(r"Coefficients of gain: joint_\d\.gain [+-]", report)
    assert "Joint terms that the measurements neither show nor exclude: " in report


@pytest.mark.quick(0)
def test_which_joint_drives_which_is_found(robot):
    driven = robot.with_terms([CouplingSection(joint="joint_6", term="coupling", driven_by="joint_5", sigma=1e-3)])
    true = driven.with_parameters({"joint_6.by_joint_5": 4e-3})
    q = np.random.default_rng(17).uniform(-1.5, 1.5, (60, 6))
    fit = calib.fit(robot, _measured(robot, true, q, np.random.default_rng(18)), terms="auto")
    assert sure(fit) == {"coupling"}
    found = {name: abs(fit.parameters[name].value) for name in fit.free_names if ".by_" in name}
    assert max(found, key=found.get) == "joint_6.by_joint_5"
    known = fit.parameters["joint_6.by_joint_5"]
    assert known.low95_si < 4e-3 < known.high95_si


def test_through_a_loop_too_nothing_is_added_where_there_is_nothing(tmp_path):
    robot = five_bar(tmp_path)
    for terms in ((), ("harmonics",)):
        _, data, _ = simulated(robot, terms, np.random.default_rng(6))
        fit = calib.fit(robot, data, terms="auto")
        assert sure(fit) <= set(terms)  # motors turn through half a radian: gain and harmonics look alike
        assert bool(fit.robot.terms) == bool(terms)


def test_where_nothing_is_added_the_fit_is_that_which_asks_for_nothing(tmp_path):
    robot, told = five_bar(tmp_path), []
    _, data, _ = simulated(robot, (), np.random.default_rng(6))
    used, unused = (data.subset(np.arange(start, len(data), 2)) for start in (0, 1))
    asked, plain = (
        calib.fit(robot, used, validation=unused, terms=terms, progress=progress)
        for terms, progress in (("auto", lambda *steps: told.append(steps)), (None, None))
    )
    assert [done for done, _ in told] == list(range(1, told[-1][1] + 1))
    assert len({total for _, total in told}) == 1
    np.testing.assert_array_equal(asked.robot.values, plain.robot.values)
    np.testing.assert_array_equal(asked.statistics.half_width, plain.statistics.half_width)
    assert asked.validation.table() == plain.validation.table()


def test_compliance_in_data_of_other_code_is_found_and_not_held_back(tmp_path):
    robot, at = arm(tmp_path)
    robot = robot.with_terms(())
    rng = np.random.default_rng(7)
    q = rng.uniform(-0.8, 0.8, (60, 3))
    points = np.array([at(row)[0] for row in q + [0.0, 4e-5, 7e-5] * torques(at, q)])  # the usual is 2e-5
    points += NOISE * rng.standard_normal(points.shape)
    fit = calib.fit(robot, calib.as_measurements(robot, q, points), terms="auto")
    assert sure(fit) == {"compliance"}
    known = dict(zip(fit.free_names, fit.robot.values[fit.unknowns.index], strict=True))
    assert "turn.compliance" not in known  # its axis is vertical
    assert known["lift.compliance"] == pytest.approx(4e-5, rel=0.1)
    assert known["bend.compliance"] == pytest.approx(7e-5, rel=0.1)


@pytest.mark.quick(0)
def test_without_stated_directions_backlash_is_reported_and_not_added(robot):
    q = np.random.default_rng(9).uniform(-1.5, 1.5, (60, 6))
    data = calib.as_measurements(robot, q, np.zeros((60, 3)))
    playing = robot.with_terms(parse_terms("joint_2=backlash")).with_parameters({"joint_2.backlash": 4e-4})
    seen = playing.assemble(q, context=data.conditions)
    points = calib.core.rows.observed.predict_readings(playing, seen)["reflector"].values
    points = points + NOISE * np.random.default_rng(10).standard_normal(points.shape)
    fit = calib.fit(robot, calib.as_measurements(robot, q, points), terms="auto")
    told = next(trial for trial in fit.terms.trials if trial.term == "backlash")
    assert not told.added
    assert "do not state the direction of approach" in told.refusal


def test_candidates_say_why_they_cannot_be_tried():
    robot = calib.load(EXAMPLES / "five_bar.yaml")  # lies flat on a table
    q = robot.home + np.random.default_rng(11).uniform(-0.3, 0.3, (20, 2))
    data = calib.as_measurements(robot, q, np.zeros((20, 3)))
    refused = {term.term: term.refusal for term in candidates(robot, data)}
    assert refused["gain"] == refused["coupling"] == ""
    assert "drift" not in refused  # it changes from day to day, and must be named
    assert refused["compliance"] == "gravity loads no joint differently from pose to pose"
    described = robot.with_terms(parse_terms("gain,left_motor=curve"))
    by_name = {term.term: term for term in candidates(described, data)}
    assert by_name["gain"].refusal == "the description has it already"
    assert [section.joint for section in by_name["curve"].sections] == ["right_motor"]


@pytest.mark.quick(0)
def test_intervals_of_terms_and_of_predictions_cover(tmp_path):
    # of 24 coefficients each that go together, 95 % +- 5; and half as much again for positions of the same fits
    for robot, n in ((example_arm(None), 2), (five_bar(tmp_path), 6)):
        coefficients, positions = coverage(robot, ("gain", "backlash"), n, 12).mean(axis=0)
        assert coefficients > 0.88
        assert positions > 0.85


@pytest.mark.quick(0)
def test_sizes_of_chosen_curves_are_drawn_no_second_time(monkeypatch):
    """A fit finds them, and counts how uncertain they are: drawn again, they would count twice."""
    robot, drawn = example_arm(None), []
    original = KindModel.undecided

    def looking(self, model, fitted, others, robot):
        drawn.append((self.families, fitted, others))
        return original(self, model, fitted, others, robot)

    monkeypatch.setattr(KindModel, "undecided", looking)
    _, data, _ = simulated(robot, ("curve",), np.random.default_rng(3))
    fit = calib.fit(robot, data, terms="auto")
    families, fitted, others = drawn[0]
    chosen = {term.joint for term in fit.robot.terms if term.parameters[0].family}
    assert chosen
    for k, family in enumerate(families):
        changes = bool(np.ptp(others[:, k]) > 0)
        assert changes == (family.term != "curve" or family.joint not in chosen), family
        assert changes or np.all(others[:, k] == fitted[k])


def test_boxes_are_neighbours_and_keep_repeats_together(robot):
    rng = np.random.default_rng(13)
    q = rng.uniform(-1, 1, (64, 6)) * [1.0, 3.0, 2.0, 0.1, 0.1, 0.1]
    names = [f"p{k}" for k in range(64)]
    data = calib.as_measurements(robot, np.vstack([q, q]), np.zeros((128, 3)), [*names, *names])
    box = boxes(data.joints, data.pose_numbers, 8, robot.mechanism.depths)
    np.testing.assert_array_equal(box[:64], box[64:])
    np.testing.assert_array_equal(np.bincount(box), [16] * 8)
    alone = boxes(q, np.arange(64), 8, robot.mechanism.depths)
    widths, in_order = (
        np.mean([np.ptp(part, axis=0) / np.ptp(q, axis=0) for part in cut])
        for cut in ([q[alone == k] for k in range(8)], np.split(q, 8))
    )
    assert widths < 0.8 * in_order


@pytest.fixture
def curved(tmp_path):
    """An arm whose second joint has a curve, measured from -1 to 1 rad alone, and its files."""
    robot = example_arm(None)
    rng = np.random.default_rng(14)
    q = rng.uniform(-1.0, 1.0, (100, 6))
    points = robot.positions(_geared(q, 11))[:, 0] + NOISE * rng.standard_normal((100, 3))
    header = [*(f"{name} [rad]" for name in robot.joint_names), *(f"reflector_{a} [m]" for a in "xyz")]
    write_table(tmp_path / "data.csv", header, q, points)
    far = q[:5].copy()
    far[:, 1] += 2.0
    write_table(tmp_path / "far.csv", header, far, robot.positions(far)[:, 0])
    return robot, tmp_path


@pytest.mark.quick(0)
def test_beyond_the_range_measured_predictions_widen_and_the_verdict_says_so(curved):
    robot, folder = curved
    data, far = (calib.read_measurements(folder / name, robot) for name in ("data.csv", "far.csv"))
    fit = calib.fit(robot, data, validation=far, terms="joint_2=curve")
    inside = data.joints[:5]
    bare = calib.fit(robot, data)
    widened = fit.predict(far.joints).distance.mean() / fit.predict(inside).distance.mean()
    assert widened > 3 * bare.predict(far.joints).distance.mean() / bare.predict(inside).distance.mean()
    assert "beyond_curves" in [reason.code for reason in fit.verdict.reasons]
    near = calib.fit(robot, data, validation=data.subset(np.arange(20)), terms="joint_2=curve")
    assert "beyond_curves" not in [reason.code for reason in near.verdict.reasons]


def test_poses_just_beyond_the_range_measured_are_no_reason_where_a_curve_is_still_sure(robot):
    rng = np.random.default_rng(14)
    q, edge = rng.uniform(-1.0, 1.0, (60, 6)), rng.uniform(-1.0, 1.0, (5, 6))
    edge[:, 1] = 1.06
    used, other = (
        calib.as_measurements(robot, joints, robot.positions(off) + NOISE * rng.standard_normal((len(joints), 1, 3)))
        for joints, off in ((q, _geared(q, 1)), (edge, _geared(edge, 1)))
    )
    fit = calib.fit(robot, used, validation=other, terms="joint_2=curve")
    assert np.all(is_beyond_learned(fit.robot, q, edge)[:, 1])
    assert "beyond_curves" not in fit.verdict.to_dict()["codes"], fit.verdict


def _geared(q, waves):
    """What joints stand at whose second one is off by waves, so many in a radian."""
    off = q.copy()
    off[:, 1] += 4e-4 * np.sin(waves * q[:, 1])
    return off


def test_a_result_with_terms_is_read_back_by_other_commands(curved, run_calib):
    robot, folder = curved
    arm = EXAMPLES / "arm.yaml"
    options = ("--terms", "joint_2=curve", "--force", "--verbose", "--out", folder / "out")
    run = run_calib("fit", arm, folder / "data.csv", *options)
    assert run.code == 0, run.err
    assert "Joint terms requested: joint_2=curve" in run.out
    run = run_calib("predict", arm, folder / "far.csv", "--result", folder / "out", "--out", folder / "predicted.csv")
    assert run.code == 0, run.err
    assert "5 poses lie where no error curve of joint_2 was learned" in " ".join(run.err.split())
    loaded = calib.core.results.result_reading.load_result(folder / "out", robot).robot
    assert len(loaded.terms) == 1
    assert np.any(loaded.values[loaded.coefficients] != 0)
    assert np.array_equal(calib.load(folder / "out").values, loaded.values)


def test_none_leaves_out_what_the_description_has(curved):
    robot, folder = curved
    data = calib.read_measurements(folder / "data.csv", robot)
    fit = calib.fit(robot.with_terms(parse_terms("gain")), data, terms="none")
    assert fit.robot.terms == ()
    assert np.array_equal(fit.robot.values, calib.fit(robot, data).robot.values)


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ("gian", "no term 'gian'; did you mean 'gain'?"),
        ("gain,", "no term ''"),
        ("coupling", "'coupling' needs further values"),
        ("nowhere=gain", "no actuated joint 'nowhere'"),
        ("gain,gain", "a parameter name is used twice"),
    ],
)
def test_bad_lists_are_named(curved, run_calib, terms, message):
    _, folder = curved
    run = run_calib("fit", EXAMPLES / "arm.yaml", folder / "data.csv", "--terms", terms, "--out", folder / "out")
    assert run.code == 2
    assert message in " ".join(run.err.split())
    assert not (folder / "out").exists()


def test_too_few_poses_for_blocks_are_refused(robot):
    _, data, _ = simulated(robot, (), np.random.default_rng(15), n=30)
    with pytest.raises(calib.DataError, match="at least 16 different poses"):
        calib.fit(robot, data.subset(np.arange(15)), terms="auto")


def test_terms_that_leave_no_freedom_are_not_added():
    """Harmonics and couplings beside the origins explain all of 54 coordinates."""
    robot, told = example_arm(None), []
    true, data, elsewhere = simulated(robot, ("curve",), np.random.default_rng(2), n=18)
    fit = calib.fit(robot, data, terms="auto", progress=lambda *steps: told.append(steps))
    assert fit.robot.terms == ()
    assert {trial.term for trial in fit.terms.trials if trial.lacks_measurements} == {"harmonics", "coupling"}
    assert "none, because these measurements are too few to fit" in fit.report()
    assert told[-1][0] == told[-1][1]
    assert np.mean(position_errors(fit, true, elsewhere)[1]) > 0.9
    np.testing.assert_array_equal(fit.robot.values, calib.fit(robot, data, terms="none").robot.values)


def test_data_without_noise_ask_for_no_terms(robot):
    q = np.random.default_rng(16).uniform(-1, 1, (40, 6))
    fit = calib.fit(robot, calib.as_measurements(robot, q, robot.positions(q)), terms="auto")
    assert sure(fit) == set()
    assert "computed, not measured" in fit.terms.trials[0].refusal


@pytest.mark.quick(0)
def test_auto_helps_a_real_robot_on_poses_that_it_has_not_seen(shared_data):
    robot, train, test = motoman(shared_data / "motoman_right", ("2 mm", "1 mm"), ("5 mrad", "3 mrad"))
    fit = calib.fit(robot, train, validation=test, terms="auto")
    assert "coupling" in sure(fit)
    assert fit.validation.table()["after"]["rms"] < 0.0700  # 0.0742 by the origins alone


CASES = [*[(kind,) for kind in KINDS], ("gain", "curve", "backlash", "drift", "compliance")]


def _print_tables(what, n, seed=1):
    with tempfile.TemporaryDirectory() as folder:
        for make in (example_arm, five_bar):
            robot = make(Path(folder))
            for terms in CASES if what == "coverage" else [(), *CASES]:
                if what == "coverage":
                    parts = 100 * coverage(robot, terms, n, seed)
                    columns = zip(parts.mean(axis=0), parts.std(axis=0) / np.sqrt(n), strict=True)
                    cells = " | ".join(f"{mean:.1f} +- {deviation:.1f}" for mean, deviation in columns)
                else:
                    cells = " | ".join(str(count) for count in choices(robot, terms, n, seed))
                print(f"| {robot.name} | {', '.join(terms) or 'none'} | {cells} |", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("choice", "coverage"))
    parser.add_argument("n", type=int, help="simulated calibrations of each row")
    parser.add_argument("seed", nargs="?", type=int, default=1)
    options = parser.parse_args()
    _print_tables(options.what, options.n, options.seed)


@pytest.mark.quick(0)
def test_coefficients_that_explain_every_reading_are_no_evidence():
    """Of 90 coordinates, harmonics and couplings beside the origins leave nothing: no noise, and nothing foretold."""
    robot, seed = example_arm(None), [2, 30, sum(map(ord, "harmonics"))]
    true, data, elsewhere = simulated(robot, ("harmonics",), np.random.default_rng(seed), 30)
    fit = calib.fit(robot, data, terms="auto")
    assert sure(fit) == {"harmonics"}
    alone = calib.fit(robot, data)
    after, before = (np.sqrt(np.mean(position_errors(item, true, elsewhere)[0] ** 2)) for item in (fit, alone))
    assert after < 0.5 * before
