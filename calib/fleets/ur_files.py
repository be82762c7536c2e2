"""A result folder from the maker's calibration of a robot, as if `calib fit` had fitted the stock model of its type.

Controllers of Universal Robots compute with a calibration (`calib.fleets.ur_kinematics`). The stock model of
the type is fitted to rounded poses of the robot in this file, with all joint origins free, and base and tool known.
Single numbers of two files cannot be compared, because parallel axes leave some of them undetermined. The prior of the
fit puts all robots of a type into one gauge, and its covariance shows which combinations stay undetermined.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy

from calib.core.base.errors import DataError
from calib.core.base.files import write_file
from calib.core.base.units import quantity_text
from calib.core.calibrating.calibrate import calibrate
from calib.core.data.in_memory import as_measurements
from calib.core.fitting.settings import Settings
from calib.core.numerics.halton import halton
from calib.core.results.results import save
from calib.core.robots.loading import load
from calib.core.robots.loading import robot as robot_of
from calib.core.robots.parametrisation import default_sections
from calib.core.robots.robot import Robot
from calib.fleets.ur_kinematics import nearest_type, nominal_origins, read_origins, ur_urdf
from calib.shared.ur_calibration import JOINTS

_POSES = 40
_STEP = 5e-5, 2e-4  # rounding of poses, far below the differences between robots [m], [rad]
_FAR = 0.03  # largest RMS distance of a robot from its type [m]


def is_calibration(path: Path | str) -> bool:
    """Return whether a path is a calibration file of Universal Robots, not a result folder."""
    return Path(path).suffix.lower() in (".yaml", ".yml") and Path(path).is_file()


def result_of_calibration(path: Path | str, folder: Path) -> None:
    """Write the result folder of a robot from its maker's calibration.

    Raises:
        DataError: The robot is of no known type.
        UrdfError: The file is not a calibration, or fits a known type only with the other sign of a number.
    """
    origins = read_origins(path)
    model, away = nearest_type(origins)
    if away > _FAR:
        raise DataError(
            f"{path}: is of no known type; the nearest, {model}, is {quantity_text(away, 'mm', '.0f')} off (RMS)"
        )
    urdf = folder.parent / f"{model}.urdf"
    if not urdf.exists():
        write_file(str(urdf), ur_urdf(nominal_origins(model), model))
    stock, robot = _stock(urdf), load(path)
    q = 2 * np.pi * halton(_POSES + 1, 6)[1:] - np.pi
    T = np.linalg.inv(robot.forward(q, "base_link_inertia")) @ robot.forward(q, "tool0")
    turns = scipy.spatial.transform.Rotation.from_matrix(T[:, :3, :3]).as_rotvec()
    values = np.hstack([np.round(part / step) * step for part, step in zip((T[:, :3, 3], turns), _STEP, strict=True)])
    names = [f"{Path(path).stem} {k}" for k in range(_POSES)]
    save(calibrate(stock, as_measurements(stock, q, {"maker": values}, names), None, Settings()), folder)


def _stock(urdf: Path) -> Robot:
    """The stock model of a type, with the origins of its moving joints free, and base and tool known."""
    length, angle = (step / np.sqrt(12) for step in _STEP)
    noise = {"sigma": quantity_text(length, "mm", ".4f"), "sigma_angle": quantity_text(angle, "mrad", ".4f")}
    stock = robot_of(
        urdf,
        motors=JOINTS,
        base={"frame": "base_link_inertia"},
        target={"tool0": {"frame": "tool0"}},
        instruments={"maker": noise | {"kind": "pose", "target": "tool0", "rotation": "rotation_vector"}},
        parametrisation=default_sections(),
    )
    return stock.fix([p.name for p in stock.parameters if p.name.rpartition(".")[0] not in JOINTS])
