"""What tests of files with measurements share."""

import logging

import pytest

from calib.core.base.words import warn_once
from tests.small_robots import small_arm


@pytest.fixture
def arm(tmp_path):
    return small_arm(tmp_path)


@pytest.fixture(autouse=True)
def untold(monkeypatch):
    """Guesses are told anew in each test, and where pytest sees them."""
    warn_once.cache_clear()
    monkeypatch.setattr(logging.getLogger("calib"), "propagate", True)
