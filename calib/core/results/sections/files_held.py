"""How much of a calibrated robot each kind of file holds, and the error that it leaves."""

from __future__ import annotations

import numpy as np

from calib.core.base.units import DISPLAY_UNIT, ERROR_UNIT, in_unit
from calib.core.fitting.fitted import Fit
from calib.core.judging.rules_model import why_no_origins
from calib.core.results.sections.grid import Grid, GridColumn, GridNumber
from calib.core.robots.accuracy_of_files import FileRobot, Holds
from calib.core.robots.file_formats import formats_that_hold
from calib.core.robots.robot import Robot
from calib.core.robots.robot_files import lost_by


def files_of(fit: Fit) -> dict[Holds, FileRobot]:
    """Return the robot that each kind of file can hold; none for kinds without a format."""
    nowhere = () if formats_that_hold(Holds.TO_LAST_AXIS, fit.nominal) else (Holds.TO_LAST_AXIS,)
    known = {holds: fit.robot.files.get(holds) for holds in Holds if holds not in nowhere}
    return {holds: file_robot for holds, file_robot in known.items() if file_robot is not None}


def files_grid(fit: Fit) -> Grid | None:
    """Return the error of each kind of file, the nominal robot first and the whole model last.

    None if files of joint origins hold everything and are written.
    """
    files = files_of(fit)
    differs = fit.reduced is not None and (fit.reduced or lost_by(fit.robot, Holds.ORIGINS) or why_no_origins(fit))
    if not differs or Holds.EVERYTHING not in files:
        return None
    whole = files[Holds.EVERYTHING].accuracy
    unit = ERROR_UNIT[whole.dimension]
    before = files.get(Holds.ORIGINS, files[Holds.EVERYTHING]).accuracy.before
    rows = [("nominal robot", GridNumber(in_unit(before, unit)), GridNumber(np.nan), "")]
    for holds in (holds for holds in reversed(Holds) if holds in files):
        accuracy, formats = files[holds].accuracy, formats_that_hold(holds, fit.nominal)
        words = ("withheld: " if formats and files[holds].withheld else "") + ", ".join(formats)
        if holds is Holds.EVERYTHING:
            words = "; ".join(part for part in ("predict, solve, compensate, view", words) if part)
        rms, limit95 = (GridNumber(in_unit(size, unit)) for size in (accuracy.rms, accuracy.limit95))
        rows.append((holds.value, rms, limit95, words))
    columns = (GridColumn("file holds", "a file holds", words=True), GridColumn("RMS"), GridColumn("95 % limit"))
    return Grid(
        f"What files are worth, {unit} ({whole.part} error, {whole.pose_words})",
        f"What files are worth: {whole.part} error [{unit}], {whole.pose_words}; the error at one more such pose is"
        " below the 95 % limit with a chance of 95 %",
        (*columns, GridColumn("formats", words=True)),
        tuple(rows),
        (len(rows) - 1,),
    )


def file_entries(fit: Fit) -> list[dict[str, object]]:
    """Return the entries of `result.json` on files: content of each kind, its formats, and its error."""
    entries = list[dict[str, object]]()
    for holds, file_robot in files_of(fit).items():
        accuracy, unit = file_robot.accuracy, ERROR_UNIT[file_robot.accuracy.dimension]
        entries.append(
            {
                "holds": holds.name.lower(),
                "formats": formats_that_hold(holds, fit.nominal),
                "poses": accuracy.poses.name.lower(),
                "n_poses": accuracy.n_poses,
                "part": accuracy.part,
                "dimension": accuracy.dimension,
                "unit": unit,
                "rms_nominal": in_unit(accuracy.before, unit),
                "rms": in_unit(accuracy.rms, unit),
                "limit95": in_unit(accuracy.limit95, unit),
                "withheld": file_robot.withheld or None,
                "joint_zeros": _zeros(fit.nominal, file_robot),
            }
        )
    return entries


def _zeros(robot: Robot, file_robot: FileRobot) -> list[dict[str, object]] | None:
    if not len(file_robot.offsets):
        return None
    units = [DISPLAY_UNIT[robot.mechanism.dimensions[name]] for name in robot.joint_names]
    rows = zip(robot.joint_names, file_robot.signs, file_robot.offsets, units, strict=True)
    return [
        {"joint": name, "sign": int(sign), "offset": in_unit(float(offset), unit), "unit": unit}
        for name, sign, offset, unit in rows
    ]
