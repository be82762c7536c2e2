"""The shipped file of simulated measurements: reproducible, consistent with itself, and as noisy as it says."""

import numpy as np
import pytest
from click.testing import CliRunner

from medrue.closed_form import forward
from medrue.paper_tables import table1
from medrue.simulated_measurements import command, measurement_file
from tests.project import EXAMPLES

SHIPPED = EXAMPLES / "medrue_simulated.csv"
HEADER = "pose,q1 [mm],q2 [deg],q3 [deg],q4 [deg],q5 [deg],q6 [deg],tool_x [mm],tool_y [mm],tool_z [mm]"


def read(text):
    """The rows of a measurement file, `(n, 10)`."""
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    assert lines[0] == HEADER
    return np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])


def residuals(rows):
    """Measured minus exact positions of the actual robot, `(n, 3) [mm]`."""
    q = np.hstack([rows[:, 1:2] / 1000.0, np.radians(rows[:, 2:7])])
    return rows[:, 7:] - forward(q, table1().actual).p_world_tool * 1000.0


def test_command_writes_the_shipped_file_again(tmp_path):
    """Equal to the last digit but one: another processor may round the last one differently."""
    assert CliRunner().invoke(command, [str(tmp_path / "again.csv")]).exit_code == 0
    written, shipped = (path.read_text(encoding="utf-8") for path in (tmp_path / "again.csv", SHIPPED))
    assert np.abs(read(written) - read(shipped)).max() < 1.1e-4
    assert [line for line in written.splitlines() if line.startswith("#")][:4] == shipped.splitlines()[:4]
    assert [path.name for path in tmp_path.iterdir()] == ["again.csv"]


def test_shipped_file_has_420_poses_and_says_that_it_is_simulated():
    text = SHIPPED.read_text(encoding="utf-8")
    assert text.startswith("# Simulated")
    assert "seed 1" in text
    assert "sigma 0.04 mm" in text
    assert read(text)[:, 0].tolist() == list(range(1, 421))


def test_shipped_noise_has_the_stated_sigma():
    errors = residuals(read(SHIPPED.read_text(encoding="utf-8")))
    assert abs(errors.std() - 0.04) < 0.0032  # four standard errors of a deviation from 1260 values
    assert np.abs(errors.mean(axis=0)).max() < 0.0078  # four standard errors of a mean of 420 values


def test_without_noise_the_positions_belong_to_the_written_joints():
    assert np.abs(residuals(read(measurement_file(seed=1, sigma=0.0)))).max() < 0.51e-4  # half the last digit


@pytest.mark.parametrize(
    ("arguments", "message"),
    [("missing/out.csv", "cannot be written"), ("out.csv --sigma-mm -1", "sigma"), ("out.csv --sigma-mm nan", "sigma")],
)
def test_command_refuses_places_that_cannot_be_written_and_impossible_noise(tmp_path, arguments, message):
    run = CliRunner().invoke(command, f"{tmp_path}/{arguments}")
    assert run.exit_code == 2
    assert message in run.output
