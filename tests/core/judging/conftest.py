"""Robots and fits that tests of the verdict share."""

import pytest

from tests.core.judging.situations import Shop


@pytest.fixture(scope="session")
def shop(tmp_path_factory):
    return Shop(tmp_path_factory.mktemp("shop"))
