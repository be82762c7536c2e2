"""The table of mistakes in docs/howto/when_it_fails.md: what is tried, and that none of it ends as a PASS."""

import numpy as np
import pytest
from mistake_rates import ROBOTS, Outcome, mistakes, outcome, table


@pytest.mark.quick(1)
@pytest.mark.amount(1, 15)
@pytest.mark.parametrize("robot", ROBOTS)
def test_no_mistake_in_a_file_ends_as_a_pass_and_most_are_named(robot, amount):
    tried = list(mistakes(robot))
    chosen = np.random.default_rng(3).permutation(len(tried))[:amount]
    outcomes = [
        outcome(robot, tried[k], held_out) for k, held_out in zip(chosen, [0.0, 0.25] * len(chosen), strict=False)
    ]
    assert not [o for o in outcomes if o.grade == "PASS"]
    assert np.mean([o.named for o in outcomes]) > 0.7, [o for o in outcomes if not o.named]


def test_the_table_counts_each_kind():
    said = [Outcome("arm", "rows copied", "3 %", held, "CHECK", held == 0.0, "") for held in (0.0, 0.25)]
    assert "| rows copied | 2 | 0 | 2 | 0 | 0 | 50 % |" in table(said)


def test_copies_in_the_file_of_a_planar_robot_are_no_lengths_of_another_scale_across_its_plane():
    """There its lengths are noise, and would explain all residuals if they were scaled to nothing."""
    copied = next(
        mistake for mistake in mistakes("five-bar") if (mistake.kind, mistake.words) == ("rows copied", "15 %")
    )
    assert outcome("five-bar", copied, 0.0).grade == "CHECK"
