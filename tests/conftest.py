"""Fixtures that several test files use."""

import contextlib
import io
import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import pytest

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before numpy: threads of processes side by side wait for each other

import calib
from calib.pictures import pages
from tests.project import EXAMPLES, ROOT, SHARED
from tests.six_axis_arm import six_axis_arm

LONGEST = (
    "test_many_calibrations.py",
    "test_functions.py",
    "test_motion.py",
    "test_qualification.py",
    "test_wheel.py",
    "test_suspects.py",
    "test_selection.py",
    "test_code_comparison.py",
    "test_watch.py",
    "test_redundancy.py",
    "test_sharing.py",
    "test_viz_report.py",
    "test_searched_input.py",
    "test_term_choice.py",
    "test_every_headline.py",
    "test_snippets.py",
)
"""Files that take longest: first, so that no process is left alone with one at the end."""


THOROUGH = os.environ.get("CALIB_TESTS") == "thorough"
EVERY_CASE = os.environ.get("CALIB_TESTS") == "every-case"
"""Every case of each test, with the draws of the quick run."""


def _amount(item: pytest.Item) -> int | None:
    """How much a test tries; None where it is not marked."""
    mark = item.get_closest_marker("amount")
    return int(mark.args[THOROUGH]) if mark else None


def _mark_cases(items: list[pytest.Item]) -> None:
    """Leave the cases beyond those of `@pytest.mark.quick` to the thorough run, by the mark `amount`."""
    cases: Counter[str] = Counter()
    for item in items:
        if mark := item.get_closest_marker("quick"):
            name = item.nodeid.partition("[")[0]
            cases[name] += 1
            if cases[name] > mark.args[0]:
                amount = item.get_closest_marker("amount")
                item.add_marker(pytest.mark.amount(0, amount.args[1] if amount else 1), append=False)


@pytest.hookimpl(tryfirst=True)  # before cases are chosen by their marks
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out tests that try nothing, and put pages and the files that take longest first."""
    if not EVERY_CASE:
        _mark_cases(items)
    idle = [item for item in items if _amount(item) == 0]
    config.hook.pytest_deselected(items=idle)
    order = {name: k for k, name in enumerate(LONGEST)}
    items[:] = sorted(
        (item for item in items if _amount(item) != 0),
        key=lambda item: (item.path.parent.name != "browser", order.get(item.path.name, len(LONGEST))),
    )


@dataclass(frozen=True)
class Run:
    """What a run of the `calib` program left behind."""

    code: int
    out: str
    err: str

    def refusal(self) -> str:
        """The one line that says what is wrong with the input."""
        assert self.code == 2, self
        (line,) = self.err.strip().splitlines()
        return line


RunCalib = Callable[..., Run]


def _in_process(*arguments: object, cwd: Path | None = None) -> Run:
    from calib.cli import group  # here, so that tests of the library need no command line
    from calib.core.commands.program import run_program

    out, err, code = io.StringIO(), io.StringIO(), 0
    with contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.redirect_stdout(out))
        stack.enter_context(contextlib.redirect_stderr(err))
        stack.enter_context(mock.patch.object(sys, "argv", ["calib", *map(str, arguments)]))
        stack.enter_context(contextlib.chdir(cwd or Path.cwd()))
        stack.enter_context(
            mock.patch("calib.core.commands.common._LINE_EVERY", float("inf"))
        )  # however slow the machine
        try:
            run_program(group)
        except SystemExit as end:
            code = int(end.code or 0)
    return Run(code, out.getvalue(), err.getvalue())


def _as_process(*arguments: object, cwd: Path | None = None) -> Run:
    command = [sys.executable, "-m", "calib", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=120)
    return Run(done.returncode, done.stdout, done.stderr)


@pytest.fixture(scope="session")
def run_calib() -> RunCalib:
    """Run the `calib` program inside this process: `run_calib("fit", robot, data, "--out", folder)`."""
    return _in_process


@pytest.fixture(scope="session")
def spawn_calib() -> RunCalib:
    """Run `python -m calib` as a process of its own, a second slower than `run_calib`."""
    return _as_process


@pytest.fixture
def amount(request: pytest.FixtureRequest) -> int:
    """How much a test tries: the first number of `@pytest.mark.amount`; with CALIB_TESTS=thorough, the second."""
    return _amount(request.node) or 0


@pytest.fixture(scope="session")
def medrue() -> calib.Robot:
    """MedRUE at its nominal parameters."""
    return calib.load(ROOT / "urdf" / "medrue.yaml")


@pytest.fixture(scope="session")
def arm(tmp_path_factory: pytest.TempPathFactory) -> calib.Robot:
    """The arm of `six_axis_arm`, without priors."""
    return six_axis_arm(tmp_path_factory.mktemp("arm"))


@pytest.fixture(scope="session")
def robot() -> calib.Robot:
    """The arm of docs/examples."""
    return calib.load(EXAMPLES / "arm.yaml")


@pytest.fixture(scope="session")
def data(robot: calib.Robot) -> calib.Measurements:
    """80 simulated positions of the arm of docs/examples."""
    return calib.read_measurements(EXAMPLES / "arm_simulated.csv", robot)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real measurements by other people, which the project does not contain."""
    if not SHARED.is_dir():
        pytest.skip(f"real measurements are not here ({SHARED} is absent)")
    return SHARED


@pytest.fixture(scope="session", autouse=True)
def _no_pages() -> Iterator[None]:
    """Write no report pages beside results: half of the time of a fit."""
    with mock.patch("calib.pictures.pages", return_value={}):
        yield


@pytest.fixture
def with_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    """Write report pages all the same."""
    monkeypatch.setattr("calib.pictures.pages", pages)
