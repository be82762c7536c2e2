"""Kinematic calibration of any robot with a URDF, closed loops included, on Pinocchio."""

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
from calib.fit import Fit, fit
from calib.measurements import Measurements, Poses, read_measurements, read_poses
from calib.parameters import Origin, Parameter, Parametrisation, twist_of_edit
from calib.robot import Robot, load
from calib.selection import Selection, select
from calib.simulate import simulate

__all__ = [
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
    "fit",
    "load",
    "read_measurements",
    "read_poses",
    "select",
    "simulate",
    "twist_of_edit",
]
