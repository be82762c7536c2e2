"""Kinematic calibration of any robot with a URDF, closed loops included, on Pinocchio.

Names are imported when they are first used, so that a program that needs few of them starts quickly.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from calib.base.errors import (
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
    from calib.base.parameter import Parameter
    from calib.calibration import Calibration, fit
    from calib.data.in_memory import as_measurements, as_poses
    from calib.data.measurement_files import read_measurements, read_poses
    from calib.data.measurements import Measurements, Poses
    from calib.data.parameter_files import read_parameters
    from calib.exporting.formats import export
    from calib.fitting.fitted import Fit
    from calib.judging.acceptance import Acceptance, verify
    from calib.planning.assessment import Assessment, check
    from calib.planning.pose_sampling import sample
    from calib.planning.progress import Progress
    from calib.planning.selection import Selection, select
    from calib.planning.studies.study import study
    from calib.planning.studies.study_result import Study
    from calib.planning.watch import Watch
    from calib.reporting.fleet import Fleet, fleet
    from calib.reporting.loaded_result import LoadedResult, load_result, predict
    from calib.reporting.result_comparison import ResultComparison
    from calib.reporting.result_differences import compare
    from calib.reporting.result_reading import load
    from calib.robots.held import Holds
    from calib.robots.loading import robot
    from calib.robots.parameters import Origin, Parametrisation, twist_of_edit
    from calib.robots.robot import Robot
    from calib.rows.simulate import simulate
    from calib.using.compensation import Compensation, compensate
    from calib.using.goals import Goals
    from calib.using.inverse import Solution, solve

    __version__: str

_NAMES: dict[str, tuple[str, ...]] = {
    "calib.calibration": ("Calibration", "fit"),
    "calib.data.in_memory": ("as_measurements", "as_poses"),
    "calib.data.measurement_files": ("read_measurements", "read_poses"),
    "calib.data.measurements": ("Measurements", "Poses"),
    "calib.data.parameter_files": ("read_parameters",),
    "calib.exporting.formats": ("export",),
    "calib.judging.acceptance": ("Acceptance", "verify"),
    "calib.fitting.fitted": ("Fit",),
    "calib.planning.studies.study": ("study",),
    "calib.planning.studies.study_result": ("Study",),
    "calib.using.compensation": ("Compensation", "compensate"),
    "calib.using.goals": ("Goals",),
    "calib.using.inverse": ("Solution", "solve"),
    "calib.rows.simulate": ("simulate",),
    "calib.robots.held": ("Holds",),
    "calib.robots.loading": ("robot",),
    "calib.robots.parameters": ("Origin", "Parametrisation", "twist_of_edit"),
    "calib.robots.robot": ("Robot",),
    "calib.base.parameter": ("Parameter",),
    "calib.planning.assessment": ("Assessment", "check"),
    "calib.planning.pose_sampling": ("sample",),
    "calib.planning.selection": ("Selection", "select"),
    "calib.reporting.fleet": ("Fleet", "fleet"),
    "calib.reporting.loaded_result": ("LoadedResult", "load_result", "predict"),
    "calib.reporting.result_comparison": ("ResultComparison",),
    "calib.reporting.result_differences": ("compare",),
    "calib.reporting.result_reading": ("load",),
    "calib.planning.progress": ("Progress",),
    "calib.planning.watch": ("Watch",),
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
    "Fleet",
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
    "fleet",
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
        return import_module("calib.base.version").VERSION
    if name not in _HOMES:
        if name.startswith("_"):
            raise AttributeError(name)
        raise import_module("calib.base.other_words").no_name_in_package(name, __all__)
    found = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return found


def __dir__() -> list[str]:
    return __all__
