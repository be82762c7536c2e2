"""A file of measurements that somebody is still writing."""

from __future__ import annotations

from pathlib import Path

from calib.data.measurement_files import read_measurements
from calib.data.measurements import Measurements
from calib.errors import DataError
from calib.files import read_text
from calib.model.robot import Robot


class GrowingFile:
    """A CSV file to look at now and then; a last line without its end is left for the next time.

    Args:
        path: The file; it need not exist yet.
        robot: Whose joints and instruments it is about.
    """

    def __init__(self, path: str, robot: Robot) -> None:
        self._path, self._robot = path, robot
        self._seen = ""

    def changed(self) -> Measurements | None:
        """Return what the whole lines hold; None where there is nothing, or nothing new since the last time.

        Raises:
            DataError: A whole line is not valid.
        """
        if not Path(self._path).exists():
            return None
        text = read_text(self._path, "a CSV file", DataError, growing=True)
        rows = [line for line in text.split("\n") if line.strip() and not line.lstrip().startswith("#")]
        if text == self._seen or len(rows) < 2:  # a header is no row
            return None
        self._seen = text
        data = read_measurements(self._path, self._robot, growing=True)
        return data if len(data) else None
