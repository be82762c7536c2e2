"""The linear model of rows and a prior against stacked least squares."""

import numpy as np
import pytest

from calib.core.numerics.clusters import shifts_without_block
from calib.core.numerics.linear_model import LinearModel, RowGroups
from calib.core.numerics.prior import Prior

RNG = np.random.default_rng(0)
GROUP = np.repeat([0, 1, -1], [20, 15, 5])


@pytest.fixture
def model():
    prior = Prior(np.array([True, False, True, True]), np.array([2, 3]), np.array([[1.0, 0.5], [0.5, 1.0]]))
    jacobian, residuals = RNG.normal(size=(40, 4)), RNG.normal(size=40)
    return LinearModel(residuals, jacobian, prior, RNG.normal(size=4), RowGroups.from_groups(GROUP, 2))


def stacked(model, residuals):
    """The step to the minimum of rows above those of the prior."""
    rows = np.vstack([model.jacobian, model.prior.rows])
    right = np.concatenate([residuals, model.prior.rows @ model.deviations])
    return -np.linalg.lstsq(rows, right, rcond=None)[0]


def test_the_step_is_that_of_stacked_least_squares(model):
    np.testing.assert_allclose(model.step(), stacked(model, model.residuals), rtol=1e-9)
    others = RNG.normal(size=40)
    np.testing.assert_allclose(model.step(others), stacked(model, others), rtol=1e-9)


def test_a_model_by_some_parameters_holds_the_others(model):
    some = np.array([True, True, False, True])
    part = model.select_parameters(some)
    assert part.cost == pytest.approx(np.sum(model.residuals**2) + np.sum(model.deviations[[0, 3]] ** 2))
    np.testing.assert_allclose(part.step(), stacked(part, part.residuals), rtol=1e-9)


def test_a_block_left_out_moves_its_rows_to_where_the_others_have_them(model):
    block = np.arange(40) // 8
    moved, decided = shifts_without_block(model.span, block, model.residuals + model.jacobian @ model.step())
    assert decided.shape == (5,)
    for b in range(5):
        rest = block != b
        others = LinearModel(model.residuals[rest], model.jacobian[rest], model.prior, model.deviations, model.layout)
        expected = model.jacobian[~rest] @ (others.step() - model.step())
        np.testing.assert_allclose(moved[~rest], expected, rtol=1e-8, atol=1e-10)


def test_rows_that_were_not_read_count_in_no_group(model):
    assert model.layout.counts.tolist() == [20, 15]
