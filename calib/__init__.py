"""Kinematic calibration of any robot with a URDF, closed loops included, on Pinocchio.

Names are imported when they are first used, so that a program that needs few of them starts quickly.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

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

if TYPE_CHECKING:
    from calib.calibration import Calibration, fit
    from calib.data.in_memory import as_measurements, as_poses
    from calib.data.measurement_files import read_measurements, read_poses
    from calib.data.measurements import Measurements, Poses
    from calib.data.parameter_files import read_parameters
    from calib.exporting.formats import export
    from calib.identification.acceptance import Acceptance, verify
    from calib.identification.fitted import Fit
    from calib.identification.study import study
    from calib.identification.study_result import Study
    from calib.inverse_kinematics.compensation import Compensation, compensate
    from calib.inverse_kinematics.goals import Goals
    from calib.inverse_kinematics.inverse import Solution, solve
    from calib.linearisation.simulate import simulate
    from calib.model.loading import robot
    from calib.model.parameters import Origin, Parametrisation, twist_of_edit
    from calib.model.robot import Robot
    from calib.parameter import Parameter
    from calib.pose_choice.assessment import Assessment, check
    from calib.pose_choice.pose_sampling import sample
    from calib.pose_choice.selection import Selection, select
    from calib.reporting.loaded_result import LoadedResult, load_result, predict
    from calib.reporting.result_comparison import ResultComparison
    from calib.reporting.result_differences import compare
    from calib.reporting.result_reading import load
    from calib.watching.progress import Progress
    from calib.watching.watch import Watch

_HOMES = {
    "Acceptance": "calib.identification.acceptance",
    "Assessment": "calib.pose_choice.assessment",
    "Calibration": "calib.calibration",
    "Compensation": "calib.inverse_kinematics.compensation",
    "Fit": "calib.identification.fitted",
    "Goals": "calib.inverse_kinematics.goals",
    "LoadedResult": "calib.reporting.loaded_result",
    "Measurements": "calib.data.measurements",
    "Origin": "calib.model.parameters",
    "Parameter": "calib.parameter",
    "Parametrisation": "calib.model.parameters",
    "Poses": "calib.data.measurements",
    "Progress": "calib.watching.progress",
    "ResultComparison": "calib.reporting.result_comparison",
    "Robot": "calib.model.robot",
    "Selection": "calib.pose_choice.selection",
    "Solution": "calib.inverse_kinematics.inverse",
    "Study": "calib.identification.study_result",
    "Watch": "calib.watching.watch",
    "as_measurements": "calib.data.in_memory",
    "as_poses": "calib.data.in_memory",
    "check": "calib.pose_choice.assessment",
    "compare": "calib.reporting.result_differences",
    "compensate": "calib.inverse_kinematics.compensation",
    "export": "calib.exporting.formats",
    "fit": "calib.calibration",
    "load": "calib.reporting.result_reading",
    "load_result": "calib.reporting.loaded_result",
    "predict": "calib.reporting.loaded_result",
    "read_measurements": "calib.data.measurement_files",
    "read_parameters": "calib.data.parameter_files",
    "read_poses": "calib.data.measurement_files",
    "robot": "calib.model.loading",
    "sample": "calib.pose_choice.pose_sampling",
    "select": "calib.pose_choice.selection",
    "simulate": "calib.linearisation.simulate",
    "solve": "calib.inverse_kinematics.inverse",
    "study": "calib.identification.study",
    "twist_of_edit": "calib.model.parameters",
    "verify": "calib.identification.acceptance",
}

__all__ = [
    "Acceptance",
    "Assessment",
    "Calibration",
    "CalibrationError",
    "Compensation",
    "ComputationError",
    "DataError",
    "DescriptionError",
    "Fit",
    "Goals",
    "InputError",
    "LoadedResult",
    "Measurements",
    "NotConvergedError",
    "NotIdentifiableError",
    "Origin",
    "Parameter",
    "ParameterError",
    "Parametrisation",
    "Poses",
    "Progress",
    "ResultComparison",
    "Robot",
    "Selection",
    "Solution",
    "Study",
    "UnreachablePoseError",
    "UrdfError",
    "Watch",
    "as_measurements",
    "as_poses",
    "check",
    "compare",
    "compensate",
    "export",
    "fit",
    "load",
    "load_result",
    "predict",
    "read_measurements",
    "read_parameters",
    "read_poses",
    "robot",
    "sample",
    "select",
    "simulate",
    "solve",
    "study",
    "twist_of_edit",
    "verify",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'calib' has no attribute '{name}'")
    found = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return found


def __dir__() -> list[str]:
    return __all__
