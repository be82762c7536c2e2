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
    from calib.model.held import Holds
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

    __version__: str

_NAMES: dict[str, tuple[str, ...]] = {
    "calib.calibration": ("Calibration", "fit"),
    "calib.data.in_memory": ("as_measurements", "as_poses"),
    "calib.data.measurement_files": ("read_measurements", "read_poses"),
    "calib.data.measurements": ("Measurements", "Poses"),
    "calib.data.parameter_files": ("read_parameters",),
    "calib.exporting.formats": ("export",),
    "calib.identification.acceptance": ("Acceptance", "verify"),
    "calib.identification.fitted": ("Fit",),
    "calib.identification.study": ("study",),
    "calib.identification.study_result": ("Study",),
    "calib.inverse_kinematics.compensation": ("Compensation", "compensate"),
    "calib.inverse_kinematics.goals": ("Goals",),
    "calib.inverse_kinematics.inverse": ("Solution", "solve"),
    "calib.linearisation.simulate": ("simulate",),
    "calib.model.held": ("Holds",),
    "calib.model.loading": ("robot",),
    "calib.model.parameters": ("Origin", "Parametrisation", "twist_of_edit"),
    "calib.model.robot": ("Robot",),
    "calib.parameter": ("Parameter",),
    "calib.pose_choice.assessment": ("Assessment", "check"),
    "calib.pose_choice.pose_sampling": ("sample",),
    "calib.pose_choice.selection": ("Selection", "select"),
    "calib.reporting.loaded_result": ("LoadedResult", "load_result", "predict"),
    "calib.reporting.result_comparison": ("ResultComparison",),
    "calib.reporting.result_differences": ("compare",),
    "calib.reporting.result_reading": ("load",),
    "calib.watching.progress": ("Progress",),
    "calib.watching.watch": ("Watch",),
}
"""Names by the module that has them, as type checkers are told above."""
_HOMES = {name: module for module, names in _NAMES.items() for name in names}

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
    "Holds",
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
    if name == "__version__":
        return import_module("calib.version").VERSION
    if name not in _HOMES:
        raise AttributeError(f"module 'calib' has no attribute '{name}'")
    found = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return found


def __dir__() -> list[str]:
    return __all__
