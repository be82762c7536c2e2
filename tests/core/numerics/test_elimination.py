"""The paper's elimination: its eight parameters, and that ties never depend on rounding."""

import numpy as np
import pytest

from calib.core.numerics.identifiability import TIE, eliminate, numerical_rank
from calib.core.robots.jacobian import linearise
from medrue.paper_tables import PARAMETERS, table1
from medrue.workspace import target_workspace

NAMES = list(PARAMETERS)
PAPER = ["A2y", "A2z", "d31", "d32", "d41", "d5", "xb", "zb"]


@pytest.fixture(scope="module")
def scaled(medrue):
    jacobian = linearise(medrue, medrue.assemble(target_workspace().q)).jacobian
    return (jacobian * np.array([p.sigma_si for p in medrue.parameters])).reshape(-1, 36)


def test_the_order_of_medrues_description_gives_the_papers_eight_whatever_the_poses_and_the_rounding(medrue, scaled):
    order = [NAMES.index(name) for name in medrue.description.elimination_order]
    noise = 1 + 1e-12 * np.random.default_rng(0).standard_normal(scaled.shape)
    for matrix in (scaled, scaled[::2], scaled[:630], scaled * noise):
        assert sorted(NAMES[k] for k in eliminate(matrix, order).dropped) == sorted(PAPER)
    assert sorted(PAPER) == sorted(table1().redundant) == sorted(medrue.description.held)


def test_the_rest_has_full_rank_and_the_condition_number_that_is_told(scaled):
    elimination = eliminate(scaled, [NAMES.index(name) for name in PAPER])
    rest = np.delete(scaled, elimination.dropped, axis=1)
    assert numerical_rank(rest).rank == rest.shape[1] == 28
    values = np.linalg.svd(rest, compute_uv=False)
    assert elimination.conditions[-1] == pytest.approx(values[0] / values[-1], rel=1e-9)


def test_without_an_order_every_step_takes_the_smallest_condition_number(scaled):
    elimination = eliminate(scaled)
    left, scaled = list(range(36)), np.linalg.qr(scaled, mode="r")
    for column, condition in zip(elimination.dropped, elimination.conditions, strict=True):
        for other in left:
            rest = scaled[:, [k for k in left if k != other]]
            values = np.linalg.svd(rest, compute_uv=False)
            if values[27] > 1e-9 * values[0]:
                assert values[0] / values[27] >= condition * (1 - 1e-5)
        left.remove(column)


def test_no_step_with_the_order_is_worse_than_the_tie_allows(scaled):
    free, ordered = eliminate(scaled), eliminate(scaled, [NAMES.index(name) for name in PAPER])
    assert ordered.conditions[-1] <= TIE * free.conditions[-1]


def test_among_equal_columns_the_later_goes_and_what_is_needed_and_independent_stays():
    matrix = np.random.default_rng(1).standard_normal((20, 4))
    doubled = np.hstack([matrix, matrix[:, :1]])
    assert eliminate(matrix).dropped == ()
    assert eliminate(doubled).dropped == (4,)
    assert eliminate(doubled, order=[0]).dropped == (0,)
    assert eliminate(doubled, order=[1, 2]).dropped in ((4,), (0,))
    assert len(eliminate(np.zeros((6, 3))).dropped) == 3


@pytest.mark.parametrize("seed", range(8))
def test_condition_numbers_of_exactly_the_factor_of_a_tie_tie(seed):
    """Without the first column the condition number is 2, without the second 1, however the rows are turned."""
    turned = np.linalg.qr(np.random.default_rng(seed).standard_normal((5, 5)))[0][:, :2]
    assert eliminate(turned @ np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 1.0]]), [0]).dropped == (0,)
