"""The robot in the formats that other programs read."""

from calib.exporting.closed_model import ClosedModel, closed_model
from calib.exporting.drake import drake_bytes
from calib.exporting.formats import CONTROLLERS, FORMATS, JOINT_TABLES, export
from calib.exporting.gap import Gap, loop_gaps
from calib.exporting.mjcf import Mjcf, mjcf
from calib.exporting.toolbox import calibrated_description, toolbox_yaml
from calib.exporting.urdf import urdf_bytes

__all__ = [
    "CONTROLLERS",
    "FORMATS",
    "JOINT_TABLES",
    "ClosedModel",
    "Gap",
    "Mjcf",
    "calibrated_description",
    "closed_model",
    "drake_bytes",
    "export",
    "loop_gaps",
    "mjcf",
    "toolbox_yaml",
    "urdf_bytes",
]
