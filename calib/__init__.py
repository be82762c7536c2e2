"""Kinematic calibration of any robot with a URDF, closed loops included, on Pinocchio."""

from calib.calibration import Calibration, fit
from calib.data.in_memory import as_measurements, as_poses
from calib.data.measurement_files import read_measurements, read_poses
from calib.data.measurements import Measurements, Poses
from calib.errors import (
    CalibrationError,
    ComputationError,
    DataError,
    DescriptionError,
    InputError,
    NotConvergedError,
    NotIdentifiableError,
    ParameterError,
    UnreachablePoseError,
    UrdfError,
)
from calib.identification.fitted import Fit
from calib.linearisation.simulate import simulate
from calib.model.parameters import Origin, Parametrisation, twist_of_edit
from calib.model.robot import Robot
from calib.parameter import Parameter
from calib.pose_choice.selection import Selection, select
from calib.reporting.results import load

__all__ = [
    "Calibration",
    "CalibrationError",
    "ComputationError",
    "DataError",
    "DescriptionError",
    "Fit",
    "InputError",
    "Measurements",
    "NotConvergedError",
    "NotIdentifiableError",
    "Origin",
    "Parameter",
    "ParameterError",
    "Parametrisation",
    "Poses",
    "Robot",
    "Selection",
    "UnreachablePoseError",
    "UrdfError",
    "as_measurements",
    "as_poses",
    "fit",
    "load",
    "read_measurements",
    "read_poses",
    "select",
    "simulate",
    "twist_of_edit",
]
