"""Every reason of the verdict is said where it is true, with right numbers, and not where its cause is gone."""

import re

import pytest
from situations import SITUATIONS, Shop

from calib.judging.next_step import next_step
from calib.judging.reasons import Code


@pytest.fixture(scope="module")
def shop(tmp_path_factory):
    return Shop(tmp_path_factory.mktemp("shop"))


def test_every_reason_has_a_situation_and_nothing_else_has():
    assert set(SITUATIONS) == set(Code)


@pytest.mark.parametrize("code", list(SITUATIONS), ids=str)
def test_a_reason_is_said_where_it_is_true_and_not_without_its_cause(shop, code):
    made = shop.situation(code)
    texts = [reason.text for reason in made.reasons(made.there) if reason.code == code]
    match = next(filter(None, (re.search(made.says, text) for text in texts)), None)
    assert match, made.reasons(made.there)
    assert [float(number) for number in match.groups()] == pytest.approx(list(made.numbers), rel=made.within), texts
    assert code not in [reason.code for reason in made.reasons(made.gone)], made.gone.verdict


@pytest.mark.parametrize(
    ("code", "cause", "contradicted"),
    [
        ("beyond_curves", "worse_on_validation", "no_gain"),  # "no gain beyond the uncertainty" beside "worse"
        ("likely_mistake", "noise_as_large_as_robot", "systematic"),  # "the target sits 595 mm elsewhere on its link"
        ("equal_columns", "equal_columns", "instruments_disagree"),
    ],
)
def test_no_reason_stands_beside_what_it_contradicts(shop, code, cause, contradicted):
    codes = shop.situation(Code(code)).there.verdict.to_dict()["codes"]
    assert cause in codes
    assert contradicted not in codes


@pytest.mark.parametrize(
    "code",
    [
        "likely_mistake",
        "misread",
        "lengths_scaled",
        "equal_columns",
        "base_elsewhere",
        "copied",
        "zero_readings",
        "doubtful_readings",
    ],
)
def test_after_a_mistake_the_next_step_is_to_correct_it(shop, code):
    """Outliers, terms and more poses are no answer to readings that mean something else."""
    said = next_step(shop.situation(Code(code)).there)
    assert said.aim == "correct the data or the description as the reasons say, and fit again"
    assert "--" not in said.command.removesuffix("--out DIR-2")
