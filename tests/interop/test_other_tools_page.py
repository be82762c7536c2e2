"""docs/other_tools.md: its commands and snippets run as printed, and all tools find the tool where calib does."""

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import calib
from calib.core.commands import fit
from calib.exporting import command as export
from tests.project import EXAMPLES, ROOT
from tests.signed_files import read_plain

PAGE = (ROOT / "docs" / "other_tools.md").read_text(encoding="utf-8")
SNIPPETS = {
    code.splitlines()[0].removeprefix("# "): code for code in re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
}
NEEDS = {"MuJoCo": "mujoco", "Drake": "pydrake", "PyBullet": "pybullet", "urdf_parser_py": "urdf_parser_py"}
STILL, SIMULATED, SINGLE_PRECISION = 1e-9, 5e-5, 1e-6
TOLERANCES = {"MuJoCo": SIMULATED, "Drake": SIMULATED, "PyBullet": SIMULATED}

pytestmark = pytest.mark.filterwarnings("ignore:zmq.eventloop.ioloop is deprecated:DeprecationWarning")  # meshcat's


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which the page's commands were run."""
    folder = tmp_path_factory.mktemp("page")
    shutil.copytree(ROOT / "urdf", folder / "urdf")
    shutil.copytree(EXAMPLES, folder / "docs" / "examples")
    commands = {"fit": fit.command, "export": export.command}
    (block,) = re.findall(r"```bash\n(.*?)```", PAGE, re.DOTALL)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in block.strip().splitlines():
            program, name, *arguments = shlex.split(line)
            assert program == "calib"
            result = CliRunner().invoke(commands[name], arguments)
            assert result.exit_code == 0, result.output
        exec(SNIPPETS["calib"], {})  # writes joints.json, which the others read
    return folder


@pytest.mark.quick(2)
@pytest.mark.parametrize("name", SNIPPETS)
def test_snippet_finds_the_tool_where_calib_does(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if name in NEEDS:
        pytest.importorskip(
            NEEDS[name], reason=f"{NEEDS[name]} is not installed (in a checkout: pip install -e '.[interop]')"
        )
    monkeypatch.chdir(folder)
    variables: dict[str, object] = {}
    exec(SNIPPETS[name], variables)
    robot = calib.load("robot.yaml")
    if name == "urdf_parser_py":
        assert variables["tool"].xyz == list(
            next(joint.xyz for joint in robot.urdf.joints if joint.name == "tool_origin")
        )
        return
    step = np.array([0, 0.02, 0, 0, 0, 0]) if name == "Pinocchio with loops" else np.zeros(6)
    expected = robot.forward(robot.home + step, "tool")[:3, 3]
    assert np.abs(np.array(variables["position"]) - expected).max() < TOLERANCES.get(name, STILL)


def test_the_page_has_a_snippet_for_each_tool() -> None:
    assert set(SNIPPETS) == {"calib", "Pinocchio", "Pinocchio with loops", "yourdfpy", *NEEDS}


def test_calibrated_urdf_is_the_one_that_the_fit_wrote_plus_provenance(folder: Path) -> None:
    told = read_plain(folder / "calibrated.urdf")
    comment = re.search(rb"\n<!-- calib: calibrated origins.*?-->", told, re.DOTALL)
    assert comment is not None
    assert b"out/fit" in comment.group()
    ours = read_plain(folder / "out" / "fit" / "calibrated.urdf")
    for exported in (told.replace(comment.group(), b""), read_plain(folder / "robot.urdf")):
        texts, numbers = zip(parted(exported), parted(ours), strict=True)
        assert texts[0] == texts[1]
        # the values came from a table in mm: the way there and back may round
        np.testing.assert_allclose(numbers[0], numbers[1], rtol=4 * np.finfo(float).eps, atol=0)


def parted(urdf: bytes) -> tuple[list[bytes], list[float]]:
    """What stands between the numbers of a URDF, and the numbers."""
    pieces = re.split(rb"(?<![\w.])(-?\d+\.?\d*(?:e-?\d+)?)(?![\w.])", urdf)
    return pieces[::2], [float(piece) for piece in pieces[1::2]]
