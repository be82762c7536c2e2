"""What several tests of the viewer and the report look at."""

import pytest

from tests.viz.viz_examples import medrue_fit, medrue_robots


@pytest.fixture(scope="session")
def fit():
    return medrue_fit()


@pytest.fixture(scope="session")
def robots():
    return medrue_robots()
