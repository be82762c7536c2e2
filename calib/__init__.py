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
from calib.parameters import Origin, Parameter, Parametrisation, twist_of_edit
from calib.robot import Robot, load

__all__ = [
    "CalibrationError",
    "ComputationError",
    "DataError",
    "DescriptionError",
    "InputError",
    "NotConvergedError",
    "NotIdentifiableError",
    "Origin",
    "Parameter",
    "ParameterError",
    "Parametrisation",
    "Robot",
    "UnreachablePoseError",
    "UrdfError",
    "load",
    "twist_of_edit",
]
