"""Simulated measurements of MedRUE, written as a data file for the calibration.

    python -m medrue.simulated_measurements OUT.csv [--seed 1] [--sigma-mm 0.04]

A robot with Table I's actual parameters is sent to the 420 poses of the target workspace by a controller that knows
the nominal ones only. A laser tracker measures the tool point, with normal noise on each axis. The positions come
from the closed form of the paper's equations, not from the calibration's own model, so that a calibration from this
file is tested by other code than its own.

The commanded joint values are rounded to the digits of the file first; the positions belong to the rounded values.
"""

import argparse
from pathlib import Path

import numpy as np

from calib.core.base.errors import InputError
from calib.core.base.files import write_file
from calib.core.base.units import from_unit, millimetres
from medrue.closed_form import ACTUATED_JOINTS, Array, forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace

JOINT_DECIMALS = 6
"""Digits of a joint value after the point: 1e-6 mm, 1e-6 degrees (0.02 um at the tool)."""

POSITION_DECIMALS = 4
"""Digits of a position after the point: 1e-4 mm."""


def commanded_joints() -> Array:
    """Joint values sent to the robot, as the file writes them, `(420, 6) [mm, deg]`."""
    q = target_workspace().q
    return np.round(np.hstack([millimetres(q[:, :1]), np.degrees(q[:, 1:])]), JOINT_DECIMALS)


def simulated_positions(joints: Array, sigma: float, generator: np.random.Generator) -> Array:
    """Measured tool positions in the world.

    Args:
        joints: Commanded joint values, `(n, 6) [mm, deg]`.
        sigma: Standard deviation of the measurement noise on each axis [mm].
        generator: Source of the noise.

    Returns:
        Positions, `(n, 3) [mm]`.
    """
    q = np.hstack([from_unit(joints[:, :1], "mm"), np.radians(joints[:, 1:])])
    exact = millimetres(forward(q, table1().actual).p_world_tool)
    return exact + generator.normal(0.0, sigma, exact.shape)


def measurement_file(seed: int, sigma: float) -> str:
    """Text of the data file: comments, a header, one row per pose.

    Args:
        seed: Seed of the noise, written into the file.
        sigma: Standard deviation of the noise on each axis [mm].

    Raises:
        ValueError: Sigma is negative or not finite.
    """
    if not (np.isfinite(sigma) and sigma >= 0.0):
        raise ValueError(f"sigma is {sigma} mm, expected zero or more")
    joints = commanded_joints()
    positions = simulated_positions(joints, sigma, np.random.default_rng(seed))
    units = ["mm"] + ["deg"] * 5
    columns = [f"{name} [{unit}]" for name, unit in zip(ACTUATED_JOINTS, units, strict=True)]
    lines = [
        "# Simulated measurements of MedRUE; no real robot was measured.",
        "# Positions: closed form of the paper's equations with the actual parameters of Table I, plus normal noise.",
        f"# Noise: sigma {sigma:g} mm on each axis, numpy default_rng, seed {seed}.",
        "# Joint values: commanded, from the inverse kinematics with the nominal parameters of Table I.",
        ",".join(["pose", *columns, "tool_x [mm]", "tool_y [mm]", "tool_z [mm]"]),
    ]
    for pose, (row, position) in enumerate(zip(joints, positions, strict=True), start=1):
        cells = [f"{value:.{JOINT_DECIMALS}f}" for value in row]
        cells += [f"{value:.{POSITION_DECIMALS}f}" for value in position]
        lines.append(",".join([str(pose), *cells]))
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m medrue.simulated_measurements",
        description="Write simulated measurements of MedRUE at the 420 poses of its target workspace.",
    )
    parser.add_argument("out", type=Path, metavar="OUT.csv", help="file to write")
    parser.add_argument("--seed", type=int, default=1, help="seed of the measurement noise (default 1)")
    parser.add_argument("--sigma-mm", type=float, default=0.04, help="noise on each axis in mm (default 0.04)")
    parser.add_argument("--force", action="store_true", help="replace a file that this program did not write")
    options = parser.parse_args(arguments)
    if not (np.isfinite(options.sigma_mm) and options.sigma_mm >= 0.0):
        parser.error(f"--sigma-mm is {options.sigma_mm}, expected zero or more")
    if options.seed < 0:
        parser.error(f"--seed is {options.seed}, expected zero or more")
    try:
        write_file(options.out, measurement_file(options.seed, options.sigma_mm), force=options.force)
    except InputError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
