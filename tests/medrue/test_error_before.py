"""What was tried to explain the paper's error before calibration, and that it explains Table II's only."""

import numpy as np
import pytest

from medrue.closed_form import forward
from medrue.error_before import base_placed, differences, errors_of, placements, rotation_orders, signs
from medrue.paper_tables import error_table, table1, table3
from medrue.workspace import target_workspace

Q = np.array(target_workspace().q)
PRINTED = error_table(4)["before"]["mean"]


def test_a_best_fit_of_the_base_does_not_explain_it():
    nominal, true = (forward(Q, p).p_world_tool for p in (table1().nominal, table3().identified))
    assert errors_of(base_placed(nominal, true)).mean == pytest.approx(8.64, abs=0.005)
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert errors_of(base_placed(nominal, nominal @ turn.T + 0.3)).largest < 1e-9


@pytest.mark.quick(0)
def test_signs_and_orders_of_rotation_do_not_explain_it():
    result = list(signs(Q[::5]))
    assert len(result) == 256
    assert min(fourth.mean for _, fourth in result) > 2 * PRINTED
    first = errors_of(differences(table3().identified, Q[::5]))
    assert result[0][1] == first  # all signs as they are
    assert all(fourth.mean > 2 * PRINTED for _, fourth in rotation_orders(Q[::5]).values())


@pytest.mark.amount(0, 1)
def test_other_places_explain_table_2_and_not_table_4():
    """A coarse part of the places that the module tries."""
    result = list(placements(step=0.2, turns=4))
    assert any(second.is_near(error_table(2)["before"]) for second, _ in result)
    assert min(fourth.mean for _, fourth in result) > 1.5 * PRINTED
