"""Settings of delta printers, as lines to paste: Klipper's sections, `M665` and `M666` of Marlin and Duet.

Their meaning is in `calib.printers.files` and `calib.printers.linear_delta`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from calib.core.base.errors import InputError
from calib.core.base.units import in_unit, millimetres
from calib.core.robots.file_formats import FormatFile
from calib.core.robots.robot import Robot
from calib.printers import COMMENTS
from calib.printers.linear_delta import ANGLES, NAME, PARAMETERS, TOWERS, DeltaGeometry


def geometry_of(robot: Robot) -> DeltaGeometry:
    """Return a printer's present geometry.

    Raises:
        InputError: The robot is no linear delta.
    """
    if robot.description.parametrisation != NAME:
        raise InputError(
            f"{robot.path}: is not a delta printer; formats {', '.join(COMMENTS)} need the parametrisation"
            " linear_delta, as calib init --klipper writes it"
        )
    value = {parameter.name: float(v) for parameter, v in zip(robot.parameters, robot.values, strict=True)}
    angle_c = next(joint.rpy[2] for joint in robot.urdf.joints if joint.name == "tower_c")
    return DeltaGeometry.from_values([value[name] for name in PARAMETERS], float(angle_c))


def printer_lines(robot: Robot, firmware: str, provenance: Sequence[str] = ()) -> FormatFile:
    """Return the lines to paste into the settings of a firmware of `COMMENTS`.

    Raises:
        InputError: The robot is no linear delta.
    """
    geometry = geometry_of(robot)
    body, statement = {"klipper": _klipper, "marlin": _marlin, "duet": _duet}[firmware](geometry)
    mark = COMMENTS[firmware]
    head = [f"{mark} calib: {statement}", *(f"{mark} {line}" for line in provenance)]
    return FormatFile(("\n".join([*head, *body]) + "\n").encode(), statement)


def _mm(value: float) -> str:
    return f"{millimetres(value):.4f}"


def _degrees(value: float) -> str:
    return f"{in_unit(value, 'deg') + 0.0:.4f}"


def _klipper(geometry: DeltaGeometry) -> tuple[list[str], str]:
    lines = ["[printer]", f"delta_radius: {_mm(geometry.radius)}"]
    for k, tower in enumerate(TOWERS):
        lines += [
            "",
            f"[stepper_{tower}]",
            f"position_endstop: {_mm(geometry.endstops[k])}",
            f"arm_length: {_mm(geometry.arms[k])}",
            f"angle: {_degrees(geometry.angles[k])}",
        ]
    return lines, "replace these numbers in printer.cfg, also in the lines that begin with #*#; then RESTART"


def _trims(geometry: DeltaGeometry) -> str:
    trims = np.array(geometry.angles) - ANGLES
    return " ".join(f"{axis}{_degrees(float(trim))}" for axis, trim in zip("XYZ", trims, strict=True))


def _marlin(geometry: DeltaGeometry) -> tuple[list[str], str]:
    """M666 lowers endstops to the lowest one, so it is never positive; A, B and C are added to the mean arm."""
    rod, height = round(float(np.mean(geometry.arms)), 7), min(geometry.endstops)
    arms = " ".join(f"{axis}{_mm(arm - rod)}" for axis, arm in zip("ABC", geometry.arms, strict=True))
    ends = " ".join(f"{axis}{_mm(height - end + 0.0)}" for axis, end in zip("XYZ", geometry.endstops, strict=True))
    first = f"M665 L{_mm(rod)} R{_mm(geometry.radius)} H{_mm(height)} {_trims(geometry)} {arms}"
    remark = "send these lines to the printer (Marlin 2); M500 stores them. With a probe, first add Z of its M851 to H"
    return [first, f"M666 {ends}", "M500"], remark


def _duet(geometry: DeltaGeometry) -> tuple[list[str], str]:
    """M666 has the endstops relative to their mean; the bed is not tilted."""
    height = round(float(np.mean(geometry.endstops)), 7)
    ends = " ".join(f"{axis}{_mm(end - height + 0.0)}" for axis, end in zip("XYZ", geometry.endstops, strict=True))
    arms = ":".join(_mm(arm) for arm in geometry.arms)
    first = f"M665 L{arms} R{_mm(geometry.radius)} H{_mm(height)} {_trims(geometry)}"
    remark = "put these lines into config.g, in place of its M665 and M666; B, the radius of the bed, stays"
    return [first, f"M666 {ends} A0 B0"], remark
