"""Simulated measurements of MedRUE, written as a data file for the calibration.

    python -m medrue.simulated_measurements OUT.csv [--seed 1] [--sigma-mm 0.04]

A robot with Table I's actual parameters is sent to the 420 poses of the target workspace by a controller that knows
the nominal ones only. A laser tracker measures the tool point, with normal noise on each axis. The positions come
from the closed form of the paper's equations, not from the calibration's own model, so that a calibration from this
file is tested by other code than its own.

The commanded joint values are rounded to the digits of the file first; the positions belong to the rounded values.
"""

import io

import click
import numpy as np

from calib.core.base.files import write_file
from calib.core.base.units import from_unit, millimetres
from calib.core.commands.common import Output, shared_options
from medrue.cli import NumberRange
from medrue.closed_form import ACTUATED_JOINTS, forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace

JOINT_DECIMALS = 6
"""Digits of a joint value after the point: 1e-6 mm, 1e-6 degrees (0.02 um at the tool)."""

POSITION_DECIMALS = 4
"""Digits of a position after the point: 1e-4 mm."""


def measurement_file(seed: int, sigma: float) -> str:
    """Text of the data file: comments, a header, one row per pose.

    Args:
        seed: Seed of the noise, written into the file.
        sigma: Standard deviation of the noise on each axis [mm].
    """
    q = target_workspace().q
    joints = np.round(np.hstack([millimetres(q[:, :1]), np.degrees(q[:, 1:])]), JOINT_DECIMALS)
    sent = np.hstack([from_unit(joints[:, :1], "mm"), np.radians(joints[:, 1:])])
    exact = millimetres(forward(sent, table1().actual).p_world_tool)
    positions = exact + np.random.default_rng(seed).normal(0.0, sigma, exact.shape)
    units = ["mm"] + ["deg"] * 5
    columns = [f"{name} [{unit}]" for name, unit in zip(ACTUATED_JOINTS, units, strict=True)]
    lines = (
        "# Simulated measurements of MedRUE; no real robot was measured.",
        "# Positions: closed form of the paper's equations with the actual parameters of Table I, plus normal noise.",
        f"# Noise: sigma {sigma:g} mm on each axis, numpy default_rng, seed {seed}.",
        "# Joint values: commanded, from the inverse kinematics with the nominal parameters of Table I.",
        ",".join(["pose", *columns, "tool_x [mm]", "tool_y [mm]", "tool_z [mm]"]),
    )
    table = np.column_stack([np.arange(1, len(q) + 1), joints, positions])
    forms = ["%d", *[f"%.{JOINT_DECIMALS}f"] * 6, *[f"%.{POSITION_DECIMALS}f"] * 3]
    text = io.StringIO()
    np.savetxt(text, table, fmt=forms, delimiter=",", header="\n".join(lines), comments="")
    return text.getvalue()


@click.command("simulated_measurements", context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("out", metavar="OUT.csv")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Seed of the measurement noise.")
@click.option("--sigma-mm", type=NumberRange(0, 1000), default=0.04, show_default=True, help="Noise on each axis [mm].")
@shared_options()
def command(out: str, seed: int, sigma_mm: float, output: Output) -> None:
    """Write simulated measurements of MedRUE at the 420 poses of its target workspace."""
    write_file(out, measurement_file(seed, sigma_mm), force=output.force)


if __name__ == "__main__":
    command()
