"""Choosing poses pays: real fits to simulated noise, and what is true of a real arm."""

import numpy as np
import pytest

import calib
from calib.core.base.threads import one_blas_thread
from calib.core.numerics.observability import information
from calib.core.robots.jacobian import linearise
from calib.core.rows.unknowns import Unknowns
from calib.planning.selection import select
from calib.shared.candidates import rows_of_poses
from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from tests import public_data

Q = target_workspace().q
SIGMA = 4e-5


def test_o1_identifies_better_than_a_uniform_choice_by_far_more_than_its_standard_error(medrue):
    """Linearised fits with paired noise; `medrue study` does it with 200 real fits of each set and all indices."""
    rows = linearise(medrue, medrue.assemble(Q)).jacobian[:, 0][:, :, medrue.is_free]
    noise = SIGMA * np.random.default_rng(11).standard_normal((400, 420, 3))
    squares = []
    for index in (np.arange(2, 420, 5), select(medrue, Q, 84, "O1").chosen):
        estimates = np.linalg.lstsq(rows[index].reshape(252, 28), noise[:, index].reshape(400, 252).T, rcond=None)[0]
        errors = (rows.reshape(1260, 28) @ estimates).reshape(420, 3, 400)
        squares.append(np.sqrt(np.mean(np.sum(errors**2, axis=1), axis=0)))
    gain = squares[0] - squares[1]
    assert np.mean(gain) > 5 * np.std(gain, ddof=1) / np.sqrt(len(gain))
    assert np.mean(gain) > 0.05 * np.mean(squares[0])


@pytest.mark.quick(0)
def test_the_predicted_error_is_the_one_that_fits_have(medrue):
    selection = select(medrue, Q, 84, "task", sigma=SIGMA)
    truth = forward(Q, table1().nominal).p_world_tool
    rng, squares = np.random.default_rng(3), []
    for _ in range(5):
        noisy = truth[selection.chosen] + SIGMA * rng.standard_normal((84, 3))
        fitted = calib.fit(medrue, calib.as_measurements(medrue, Q[selection.chosen], noisy), sigma=SIGMA).robot
        squares.append(np.mean(np.sum((fitted.positions(Q)[:, 0] - truth) ** 2, axis=1)))
    # 5 draws of 28 parameters give the root mean square to about 8 %
    assert np.sqrt(np.mean(squares)) == pytest.approx(selection.after["task"], rel=0.3)


COUNT = 53


def rms(errors):
    """Root mean square length of errors (n, 3) [m], in mm."""
    return 1e3 * np.sqrt(np.mean(np.sum(errors**2, axis=1)))


@pytest.fixture(scope="module")
def motoman(shared_data):
    """A fit of all poses, these, the held-out ones, and the numbers of those that O1 chooses."""
    robot, train, test = public_data.motoman(shared_data / "motoman_right")
    everything = calib.fit(robot, train, validation=test)
    by_o1 = select(everything.robot, train.joints, COUNT, "O1", sigma=everything.sigma).chosen
    return everything, train, test, by_o1


@one_blas_thread
def test_on_the_real_arm_noise_alone_would_make_the_choice_best_of_all(motoman):
    everything, train, test, by_o1 = motoman
    robot, sigma, rng = everything.robot, everything.sigma, np.random.default_rng(0)
    rows = rows_of_poses(robot, robot.assemble(train.joints), sigma).rows
    there = rows_of_poses(robot, robot.assemble(test.joints), sigma).position_rows
    priors = Unknowns.from_robot(robot).prior.rows
    by_task = select(robot, train.joints, COUNT, "task", task=test.joints, sigma=sigma).chosen
    choices = by_o1, by_task, *(rng.choice(len(train), COUNT, replace=False) for _ in range(200))
    errors = [np.mean(information(rows[index], priors).position_errors(there) ** 2) for index in choices]
    assert max(errors[:2]) < min(errors[2:])


def test_on_the_real_arm_the_model_and_not_the_noise_is_what_is_left(motoman):
    """So the choice cannot show there: O1 takes extreme poses, where what the model leaves out is largest."""
    everything, train, test, chosen = motoman
    inside = np.isin(np.arange(len(train)), chosen)
    residual = everything.identification.errors("after")
    assert rms(residual[inside]) > 1.1 * rms(residual[~inside])
    by_o1 = calib.fit(everything.nominal, train.subset(np.sort(chosen)), validation=test)
    # within 15 % of what all 159 poses give; the noise part of either is a third of it
    assert rms(by_o1.validation.errors("after")) < 1.15 * rms(everything.validation.errors("after"))
