"""Robots and fits that tests of the verdict share."""

import pytest

from tests.core.judging.situations import Shop


@pytest.fixture(scope="session")
def shop(tmp_path_factory):
    return Shop(tmp_path_factory.mktemp("shop"))


@pytest.fixture
def truth(shop):
    return shop.truth


@pytest.fixture
def prior_arm(shop):
    return shop.prior
