"""What lines that somebody types are tried on."""

from types import SimpleNamespace

import numpy as np
import pytest

import calib
from tests.project import EXAMPLES

ARM, READ = str(EXAMPLES / "arm.yaml"), str(EXAMPLES / "arm_simulated.csv")


class Frame:
    """What a data frame of pandas or polars is to this package."""

    def __init__(self, columns):
        self._columns = columns

    @property
    def columns(self):
        return list(self._columns)

    def head(self):
        return self

    def __getitem__(self, name):
        return self._columns[name]


@pytest.fixture(scope="session")
def t(robot, data, tmp_path_factory):
    """A fit of the arm of docs/examples, what it is made of, and where it is saved."""
    used, held = data.split(validation=0.25, seed=1)
    fit, folder = calib.fit(robot, used, validation=held), tmp_path_factory.mktemp("out")
    fit.save(folder / "result", pages=False)
    return SimpleNamespace(
        robot=robot, data=data, used=used, held=held, fit=fit, q=data.joints[:5], folder=folder,
        saved=folder / "result", candidates=calib.sample(robot, 40, seed=5),
        frame=Frame({name: np.array(cells, dtype=object) for name, cells in data.to_dict().items()}),
    )  # fmt: skip


@pytest.fixture(scope="session")
def fit(t):
    return t.fit
