"""Calibrations of LeRobot's servos: no measurements, but the meaning of numbers in a log of joints."""

from __future__ import annotations

import json

from calib.core.base.errors import DataError
from calib.core.data.other_formats import SomeFile

_TICKS = 4096  # ticks in a turn of the servos of LeRobot's arms
_KEYS = ((b'"homing_offset"', b'"range_min"'), (b'"homing_offset"', b'"motor_names"'))  # current and first versions


def is_calibration_of_servos(file: SomeFile) -> bool:
    """Return whether a file is such JSON."""
    return file.head.lstrip()[:1] == b"{" and any(all(key in file.head for key in keys) for keys in _KEYS)


def servo_lines(file: SomeFile) -> list[str]:
    """Raise `DataError` with the lines of `columns` that convert a log's numbers to joint angles."""
    try:
        servos = json.loads("\n".join(file.lines))
        if "motor_names" in servos:
            ranges, signs, names = {}, {}, [str(name) for name in servos["motor_names"]]
        else:
            ranges = {str(name): (int(each["range_min"]), int(each["range_max"])) for name, each in servos.items()}
            signs = {str(name): -1 if each.get("drive_mode") else 1 for name, each in servos.items()}
            names = list(ranges)
    except (ValueError, KeyError, TypeError, AttributeError):
        raise DataError(
            f"{file.path}: looks like a calibration of LeRobot, but cannot be read; save it again"
        ) from None
    named, turn = f"{file.path}: this looks like a calibration of LeRobot's servos, not measurements; ", 360 / _TICKS
    names = [name for name in names if "grip" not in name]
    in_degrees = _line({name: f"{name} [deg]" for name in names})
    if not ranges:
        raise DataError(
            f"{named}logs of this version are in degrees from the stretched arm; write {in_degrees} into the robot"
            " description of so101_old_calib.urdf or so100.urdf; find zeros and signs with a few poses"
            " (docs/howto/hobby_arm.md)"
        )
    of_range = _line({n: f"{signs[n] * (ranges[n][1] - ranges[n][0]) / 200 * turn:.4g} * {n} [deg]" for n in names})
    of_ticks = _line({n: f"{turn:.5g} * {n} - {(ranges[n][0] + ranges[n][1]) / 2 * turn:.6g} [deg]" for n in names})
    raise DataError(
        f"{named}write into the robot description: for a log of -100..100, {of_range}; for degrees, {in_degrees}; for"
        f" raw ticks, {of_ticks}; find zeros and signs with a few poses (docs/howto/hobby_arm.md)"
    )


def _line(entries: dict[str, str]) -> str:
    return "columns: {" + ", ".join(f'{name}.pos: "{text}"' for name, text in entries.items()) + "}"
