"""Formats of other programs, with their recognition and reading; the table of `docs/howto/foreign_files.md`."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeVar

from calib.core.data.other_formats import OtherFormat, SomeFile
from calib.files import arrays, text

_Head = TypeVar("_Head")


def _begins(pattern: bytes) -> Callable[[SomeFile], bool]:
    """Return a test whether the first bytes of a file match a pattern."""
    begins = re.compile(pattern, re.DOTALL)
    return lambda file: begins.match(file.head) is not None


def _not_read(name: str, head: str, pattern: bytes, way: str) -> OtherFormat:
    """Return a format that is recognised by its first bytes but not read, with advice to the user."""
    return OtherFormat(name, head, way, _begins(pattern))


def _test_and_reader(
    find: Callable[[SomeFile], _Head | None], read: Callable[[SomeFile, _Head], list[str]]
) -> tuple[Callable[[SomeFile], bool], Callable[[SomeFile], list[str]]]:
    """Return test and reader of a format whose reader needs the head that makes the test true."""

    def lines(file: SomeFile) -> list[str]:
        head = find(file)
        assert head is not None  # else another format would have matched
        return read(file, head)

    return lambda file: find(file) is not None, lines


_CSV = "write a CSV file with a header"
FORMATS = (
    OtherFormat(
        "NumPy arrays",
        "`.npz` or `.npy`",
        "each array gives columns: NAME for one, NAME_x to NAME_z for three, NAME_x to NAME_qw for poses (4 x 4), else"
        " NAME_1, NAME_2, ...; arrays have one length; units are SI, or those stated under `columns`",
        lambda file: (
            file.head.startswith((b"\x93NUMPY", b"PK\x03\x04")) and file.path.suffix.lower() in (".npz", ".npy")
        ),
        arrays.numpy_columns,
    ),
    OtherFormat(
        "a MATLAB file (version 5)",
        "begins with `MATLAB 5.0`",
        "variables of one length become columns, named as for NumPy arrays",
        _begins(rb"MATLAB 5\.0"),
        arrays.mat5_columns,
    ),
    OtherFormat(
        "a MATLAB file (version 7.3)",
        "begins with `MATLAB 7.3`, or is HDF5",
        "variables of one length become columns, named as for NumPy arrays; this needs the package h5py",
        _begins(rb"MATLAB 7\.3|\x89HDF"),
        arrays.mat73_columns,
    ),
    _not_read(
        "a Parquet or Arrow file",
        "begins with `PAR1` (also data sets of LeRobot) or `ARROW1`",
        b"PAR1|ARROW1",
        "read it in Python: calib.read_measurements(pandas.read_parquet(FILE), robot)",
    ),
    _not_read(
        "a bag of ROS 1", "begins with `#ROSBAG`", b"#ROSBAG", "convert it: rosbags-convert --src FILE --dst FOLDER"
    ),
    _not_read("a C3D file", "begins with its mark, 02 50", rb"\x02\x50", "export a table, such as CSV or TSV"),
    _not_read(
        "a compressed file",
        "begins as gzip, xz, zstd or 7z",
        rb"\x1f\x8b|\xfd7zXZ|\x28\xb5\x2f\xfd|7z\xbc",
        "unpack it",
    ),
    _not_read(
        "a pickle of Python",
        "begins with its mark, 80 02 to 80 05",
        rb"\x80[\x02-\x05]",
        "load it in Python, and save arrays with numpy.savez",
    ),
    _not_read(
        "a web page", "begins with `<!DOCTYPE` or `<html`", rb"(?i)\s*<(!doctype|html)", "download the file itself"
    ),
    _not_read(
        "a picture or a document",
        "begins as PNG, JPEG, TIFF or PDF",
        rb"\x89PNG|\xff\xd8\xff|II\*\x00|MM\x00\*|%PDF",
        f"{_CSV}; boards in photographs are found by calib detect",
    ),
    _not_read("Leica's GSI format", "a word such as `110001+` at first", rb"\*?11\d{4}[+-]", "export X, Y, Z as text"),
    _not_read(
        "an export of Qualisys (QTM) without a column header",
        "begins with `NO_OF_`, and has no column X",
        rb"NO_OF_(?!.*\bX\b)",
        "export it with the column header; its lengths are in mm, which `columns` says",
    ),
    OtherFormat(
        "YAML",
        "`.yaml` or `.yml`",
        f"a robot description comes first, then measurements; measurements: {_CSV}, or record a bag with ROS",
        lambda file: file.path.suffix.lower() in (".yaml", ".yml"),
    ),
    OtherFormat(
        "a calibration of LeRobot's servos",
        'JSON with `"homing_offset"` and `"range_min"`, or `"motor_names"` of the first versions',
        "it has no measurements; the message gives the `columns` that read its logs in -100..100, degrees or raw ticks",
        arrays.is_calibration_of_servos,
        arrays.servo_lines,
    ),
    OtherFormat(
        "JSON",
        'begins with `{"`, `[{`, or `[` and a number',
        "arrays become columns, named as for NumPy arrays; so do fields of records (in a list, or one record a line)",
        _begins(rb'\s*(\{\s*"|\[\s*\{|\[[\s\[]*-?\d+(\.\d*)?(e-?\d+)?\s*[],])'),
        arrays.json_columns,
    ),
    OtherFormat(
        "an export of Motive (OptiTrack)",
        "begins with `Format Version`",
        "rigid bodies and markers become columns NAME_x to NAME_z, with quaternions NAME_qx to NAME_qw",
        lambda file: bool(file.first_lines) and file.first_lines[0].lstrip('"').startswith("Format Version"),
        text.motive_lines,
    ),
    OtherFormat(
        "a report of measured and nominal values, as PolyWorks and FARO write it",
        "`Name` with `Meas X`, `Actual X`, ...; or `Meas` and a column that names the axes X, Y, Z, one in each row",
        "columns pose (the name), and measured X, Y, Z; the header or a line above states their unit",
        *_test_and_reader(text.find_layout, text.report_lines),
    ),
    OtherFormat(
        "a table with names above X, Y, Z, as Vicon and TRC files have them",
        "a line of names; the next line is `X,Y,Z,X,Y,Z,...` or `X1,Y1,Z1,X2,...`",
        "columns NAME_x, NAME_y, NAME_z, with the units of the line below",
        *_test_and_reader(text.find_axes, text.named_above_lines),
    ),
    OtherFormat(
        "a table whose header is a comment, as SpatialAnalyzer and np.savetxt write it",
        "the last comment (`//`, `#`, `%`) names the columns of the numbers below it",
        "that comment is the header; a unit after Z is that of X and Y",
        *_test_and_reader(text.find_commented_header, text.commented_header_lines),
    ),
    OtherFormat(
        "a table separated by blanks",
        "a line of names with blanks between them; the lines below have as many numbers",
        "read as if commas stood there",
        text.is_separated_by_blanks,
        text.blank_lines,
    ),
    OtherFormat(
        "rows without names of columns, as np.savetxt and programs of trackers write them",
        "every line has only numbers; or texts and at least three numbers, in the same places",
        "columns are named 1, 2, 3, ...; `columns` says what they stand for",
        lambda file: text.has_no_names(file) and any(name.isdigit() for name in file.renamed),
        text.numbered_lines,
    ),
    OtherFormat(
        "rows without names of columns, as np.savetxt and programs of trackers write them",
        "the same, without `columns`",
        "write a line with the names of the columns above them, such as X [mm],Y [mm]; or state them in the robot"
        ' description: columns: {"1": "joint_1 [rad]", "2": ...}',
        text.has_no_known_names,
    ),
    OtherFormat(
        "a table with lists in its cells, as pandas writes them",
        "the first row has a cell such as `[1.0, 2.0]`",
        "the numbers of a list become columns, named as for NumPy arrays",
        arrays.has_lists,
        arrays.list_columns,
    ),
    OtherFormat(
        "a table with U95 of each point, as Leica's programs write it",
        "a column `U95`, or `U95 X`, `U95 Y`, `U95 Z`",
        "U95 is twice the standard deviation of each coordinate, which becomes its stated noise",
        *_test_and_reader(text.find_expanded_uncertainty, text.expanded_uncertainty_lines),
    ),
    OtherFormat(
        "text in UTF-16 or Latin-1",
        "a byte order mark of UTF-16, or letters that are not UTF-8",
        "read as such",
        lambda file: bool(file.first_lines) and file.encoding in ("utf-16", "cp1252"),
        lambda file: file.lines,
    ),
)
