"""Formats of other programs, each with its head and what becomes of it: a table of `docs/howto/foreign_files.md`."""

from __future__ import annotations

from calib.core.data.other_formats import OtherFormat
from calib.files import arrays, reports, servos, text

FORMATS = (
    OtherFormat(
        "NumPy arrays",
        "`.npz` or `.npy`",
        "arrays of one length are columns: NAME, NAME_x to NAME_z for three, NAME_x to NAME_qw for poses (4 x 4), else"
        " NAME_1, NAME_2, ...; in SI, or say their units under `columns`",
        lambda file: (
            file.head.startswith((b"\x93NUMPY", b"PK\x03\x04")) and file.path.suffix.lower() in (".npz", ".npy")
        ),
        arrays.numpy_columns,
    ),
    OtherFormat(
        "a MATLAB file (version 5)",
        "begins with `MATLAB 5.0`",
        "variables of one length are columns, as NumPy arrays",
        lambda file: file.head.startswith(b"MATLAB 5.0"),
        arrays.mat5_columns,
    ),
    OtherFormat(
        "a MATLAB file (version 7.3)",
        "begins with `MATLAB 7.3`, or is HDF5",
        "variables of one length are columns, as NumPy arrays; this needs the package h5py",
        lambda file: file.head.startswith((b"MATLAB 7.3", b"\x89HDF\r\n")),
        arrays.mat73_columns,
    ),
    OtherFormat(
        "a Parquet file",
        "begins with `PAR1`, as data sets of LeRobot",
        "give the data frame from Python: calib.read_measurements(pandas.read_parquet(FILE), robot)",
        lambda file: file.head.startswith(b"PAR1"),
    ),
    OtherFormat(
        "a calibration of LeRobot's servos",
        'JSON with `"homing_offset"` and `"range_min"`, or `"motor_names"` of the first versions',
        "no measurements: the message gives the lines of `columns` for logs of -100..100, degrees and raw ticks",
        servos.is_calibration_of_servos,
        servos.servo_lines,
    ),
    OtherFormat(
        "JSON",
        "begins with `{` or `[`",
        "write a CSV file with a header, or give a data frame from Python",
        lambda file: file.head.lstrip()[:1] in (b"{", b"["),
    ),
    OtherFormat(
        "an export of Motive (OptiTrack)",
        "begins with `Format Version`",
        "rigid bodies and markers are columns NAME_x to NAME_z, with quaternions NAME_qx to NAME_qw",
        lambda file: bool(file.first_lines) and file.first_lines[0].lstrip('"').startswith("Format Version"),
        text.motive_lines,
    ),
    OtherFormat(
        "a report of measured and nominal values, as PolyWorks and FARO write it",
        "`Name` with `Meas X`, `Actual X`, ...; or with `Meas` and a column of X, Y, Z below each other",
        "columns pose (the name), X, Y, Z as measured, with the unit that the header or a line above names",
        reports.is_report,
        reports.report_lines,
    ),
    OtherFormat(
        "a table with names above X, Y, Z, as Vicon writes it",
        "a line of names above one that repeats `X,Y,Z`",
        "columns NAME_x, NAME_y, NAME_z, with the units of the line below",
        text.has_names_above,
        text.named_above_lines,
    ),
    OtherFormat(
        "a table whose header is a comment, as SpatialAnalyzer and np.savetxt write it",
        "the last comment (`//`, `#`, `%`) names the columns of the numbers below it",
        "that comment is the header; a unit behind Z is that of X and Y",
        text.has_header_in_comment,
        text.commented_header_lines,
    ),
    OtherFormat(
        "a table parted by blanks",
        "names parted by blanks above as many numbers in each line",
        "read as if commas stood there",
        text.is_parted_by_blanks,
        text.blank_lines,
    ),
    OtherFormat(
        "numbers without names, as np.savetxt writes them",
        "every line has numbers alone",
        "columns are named 1, 2, 3, ...; `columns` says what they stand for",
        lambda file: text.has_only_numbers(file) and "1" in file.renamed,
        text.numbered_lines,
    ),
    OtherFormat(
        "numbers without names, as np.savetxt writes them",
        "the same, without `columns`",
        "write a line with the names of the columns above them, such as X [mm],Y [mm]; or say in the robot description"
        ' what they are: columns: {"1": "joint_1 [rad]", "2": ...}',
        text.has_only_blank_numbers,
    ),
    OtherFormat(
        "a table with U95 of each point, as Leica's programs write it",
        "a column `U95`, or `U95 X`, `U95 Y`, `U95 Z`",
        "U95 is twice the standard deviation of each coordinate, which becomes its stated noise",
        text.has_expanded_uncertainty,
        text.expanded_uncertainty_lines,
    ),
    OtherFormat(
        "text in UTF-16 or Latin-1",
        "a byte order mark of UTF-16, or letters that are not UTF-8",
        "read as such",
        lambda file: bool(file.first_lines) and file.encoding in ("utf-16", "cp1252"),
        lambda file: file.lines,
    ),
)
