"""Parameter files: CSV `parameter,value,unit`; other columns, such as those of a result, are for people."""

from __future__ import annotations

from pathlib import Path

from calib.core.base.errors import DataError, ParameterError
from calib.core.base.parameter import index_of
from calib.core.base.units import check_plausible, per_si
from calib.core.data.tables import read_number, read_table
from calib.core.robots.loading import RobotLike, as_robot

COLUMNS = ("parameter", "value", "unit")
_LARGEST = 1e9  # [SI]: squares and products of such numbers stay finite


def read_parameters(path: Path | str, robot: RobotLike, *, complete: bool = False) -> dict[str, float]:
    """Read parameter values in SI by name; parameters that the file does not name are absent.

    Args:
        robot: Robot with these parameters; loaded, or its description or URDF.
        complete: Whether a parameter that the file does not name is an error.

    Raises:
        DataError, ParameterError: The message names file, line and parameter.
    """
    robot = as_robot(robot)
    table = read_table(path)
    for name in COLUMNS:
        if name not in table.names:
            raise DataError(f"{table.lacks(name)}; a parameter file has the columns {', '.join(COLUMNS)}")
    values: dict[str, float] = {}
    rows = zip(table.text("parameter"), table.text("value"), table.text("unit"), table.lines, strict=True)
    for name, text, unit, line in rows:
        where = f"{path}, line {line}"
        parameter = robot.parameters[index_of(robot.parameters, name, where)]
        if name in values:
            raise ParameterError(f"{where}: parameter '{name}' is given twice")
        place = f"{where}, parameter '{name}'"
        try:
            number = read_number(text, place, table.separator)
            if not unit:
                check_plausible(number, parameter.dimension, place, "into the column 'unit'")
        except DataError as error:
            raise ParameterError(str(error)) from None
        values[name] = number / per_si(unit, parameter.dimension, place, ParameterError)
        if abs(values[name]) > _LARGEST:
            raise ParameterError(f"{place}: '{text:.60}' is too large to mean anything; correct it")
    absent = [parameter.name for parameter in robot.parameters if parameter.name not in values]
    if complete and absent:
        raise ParameterError(f"{path}: no value for parameter '{absent[0]}'; the file is not complete")
    return values
