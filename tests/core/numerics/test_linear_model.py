"""The linear model of rows and a prior against stacked least squares."""

import numpy as np
import pytest

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


def test_the_transposed_product_is_that_of_stacked_rows(model):
    column = RNG.normal(size=43)
    rows = np.vstack([model.jacobian, model.prior.rows])
    np.testing.assert_allclose(model.transposed_product(column), rows.T @ column, rtol=1e-12)


def test_a_model_by_some_parameters_holds_the_others(model):
    some = np.array([True, True, False, True])
    part = model.select_parameters(some)
    assert part.cost == pytest.approx(np.sum(model.residuals**2) + np.sum(model.deviations[[0, 3]] ** 2))
    np.testing.assert_allclose(part.step(), stacked(part, part.residuals), rtol=1e-9)
