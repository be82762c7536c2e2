"""The robot in the formats that other programs read."""

from calib.export.closed_model import ClosedModel, closed_model
from calib.export.drake import drake_bytes
from calib.export.formats import CONTROLLERS, FORMATS, JOINT_TABLES, export
from calib.export.gap import Gap, loop_gaps
from calib.export.mjcf import Mjcf, mjcf
from calib.export.toolbox import calibrated_description, toolbox_yaml
from calib.export.urdf import urdf_bytes

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
