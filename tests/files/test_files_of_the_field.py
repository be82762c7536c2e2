"""Measurements as other programs write them: read by their head, or named; signs and zeros of columns; joined files."""

import gzip
import importlib
import json
import pickle
import re

import numpy as np
import pytest
import scipy

import calib
from calib.core.data.other_formats import SomeFile, other_formats
from calib.core.data.tables import read_table
from tests.project import EXAMPLES, ROOT, copied
from tests.small_robots import ARM_YAML, write_arm

JOINTS = np.array([[0.1, 0.02, -0.3], [0.4, -0.05, 0.2], [-0.7, 0.08, 0.5]])
POINTS = np.array([[0.51, 0.12, 0.33], [0.42, -0.2, 0.35], [0.47, 0.3, 0.29]])


@pytest.fixture
def arm(tmp_path):
    """A description with more keys; its joints turn, slide, wrist and its target tool."""

    def load(*keys):
        path = write_arm(tmp_path)
        path.write_text(ARM_YAML.replace("tip:", "tool:") + "".join(f"{key}\n" for key in keys))
        return calib.load(path)

    return load


def rows(joints=JOINTS, points=POINTS):
    return np.column_stack([joints, points])


def text_of(numbers, separator=","):
    return "".join(separator.join(repr(float(x)) for x in row) + "\n" for row in numbers)


def joined(folder, robot, content, name="points.txt"):
    """Joint values in one file, joined with content of another."""
    (folder / "joints.csv").write_text("turn,slide,wrist\n" + text_of(JOINTS))
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return calib.read_measurements([folder / "joints.csv", folder / name], robot)


def check(data, robot):
    assert np.allclose(data.joints, JOINTS, rtol=0, atol=1e-12)
    assert np.allclose(data.points(robot)[:, 0], POINTS, rtol=0, atol=1e-12)


def test_signs_factors_and_zeros_of_columns(tmp_path, arm, caplog):
    robot = arm('columns: {turn: "-turn [deg]", s: "slide + 20 [mm]", w: "-0.5 * wrist - 3 [deg]", x: "-tool_x [mm]"}')
    header = "turn,s,w,x,tool_y,tool_z\n"
    numbers = rows()
    numbers[:, 0] = -np.degrees(JOINTS[:, 0])
    numbers[:, 1] = 1000 * JOINTS[:, 1] - 20
    numbers[:, 2] = -2 * (np.degrees(JOINTS[:, 2]) + 3)
    numbers[:, 3] *= -1000
    (tmp_path / "a.csv").write_text(header + text_of(numbers))
    check(calib.read_measurements(tmp_path / "a.csv", robot), robot)
    for said in ("turn is -the column deg", "slide is the column + 20 mm", "wrist is -0.5 * the column - 3 deg"):
        assert said in caplog.text
    (tmp_path / "b.csv").write_text(header.replace("turn", "turn [rad]").replace("s,", "s [m],") + text_of(numbers))
    other = calib.read_measurements(tmp_path / "b.csv", robot)  # the header's unit is that of the cells alone
    assert np.allclose(other.joints[:, 1], numbers[:, 1] + 0.02)


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ('{turn: "turn + 90"}', "say the unit of the offset"),
        ('{turn: "0 * turn [deg]"}', "a factor of zero"),
        ('{turn: "1e400 * turn [deg]"}', "a factor of zero, or one beyond all numbers"),
        ('{p: "-pose"}', "'pose' holds words"),
    ],
)
def test_columns_that_cannot_be_are_refused(arm, columns, said):
    with pytest.raises(calib.DescriptionError, match=said):
        arm(f"columns: {columns}")


SPATIAL_ANALYZER = """// SpatialAnalyzer export
// Collection, Group, Target, X, Y, Z [mm]
A, Points, p1, 510.0, 120.0, 330.0, 05/02/2024 10:11:12
A, Points, p2, 420.0, -200.0, 350.0, 05/02/2024 10:11:22
A, Points, p3, 470.0, 300.0, 290.0, 05/02/2024 10:11:32
"""
VICON = """Trajectories
100
,,Arm:Ball,,
Frame,Sub Frame,X,Y,Z
,,mm,mm,mm
1,0,510.0,120.0,330.0
2,0,420.0,-200.0,350.0
3,0,470.0,300.0,290.0
"""
MOTIVE = """Format Version,1.23,Take Name,T,Rotation Type,Quaternion,Length Units,Millimeters

,Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body
,Name,Ball,Ball,Ball,Ball,Ball,Ball,Ball,Ball
,ID,1,1,1,1,1,1,1,1
,,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error
Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,
0,0.00,0,0,0,1,510.0,120.0,330.0,0.1
1,0.01,0,0,0,1,420.0,-200.0,350.0,0.1
2,0.02,0,0,0,1,470.0,300.0,290.0,0.1
"""
U95 = """Name;X [mm];Y [mm];Z [mm];U95 [mm]
p1;510,0;120,0;330,0;0,04
p2;420,0;-200,0;350,0;0,06
p3;470,0;300,0;290,0;0,08
"""
POLYWORKS = """PolyWorks|Inspector
Project: cell 4
Units: Millimeters

Name\tControl\tNom\tMeas\tTol\tDev\tTest
p1\tX\t500.000\t510.0\t0.100\t10.0\tFail
\tY\t120.000\t120.0\t0.100\t0.0\tPass
\tZ\t330.000\t330.0\t0.100\t0.0\tPass
p2\tX\t400.000\t420.0\t0.100\t20.0\tFail
\tY\t-200.000\t-200.0\t0.100\t0.0\tPass
\tZ\t350.000\t350.0\t0.100\t0.0\tPass
p3\tX\t500.000\t470.0\t0.100\t-30.0\tFail
\tY\t300.000\t300.0\t0.100\t0.0\tPass
\tZ\t290.000\t290.0\t0.100\t0.0\tPass
"""
FARO = """"Feature","Nominal X","Nominal Y","Nominal Z","Actual X (mm)","Actual Y (mm)","Actual Z (mm)","3D Dev"
"p1",500,120,330,510.0,120.0,330.0,10
"p2",500,120,330,420.0,-200.0,350.0,10
"p3",500,120,330,470.0,300.0,290.0,10
"""


@pytest.mark.parametrize(
    "content",
    [SPATIAL_ANALYZER, VICON, MOTIVE, U95, POLYWORKS, FARO],
    ids=["sa", "vicon", "motive", "leica", "polyworks", "faro"],
)
def test_exports_of_instruments_are_read_row_by_row(tmp_path, arm, content, caplog):
    robot = arm("join: rows")
    check(joined(tmp_path, robot, content), robot)
    assert "read as" in caplog.text
    assert "joined row by row with" in caplog.text
    short = "\n".join(content.splitlines()[: -3 if content is POLYWORKS else -1])
    with pytest.raises(calib.DataError, match=r"has 2 rows, and .* has 3; 'join: rows' needs the same number"):
        joined(tmp_path, robot, short)
    with pytest.raises(calib.DataError, match=r"fewer.txt.*(no file with joint values has a pose 'p1'|join: rows, or)"):
        joined(tmp_path, arm(), short, "fewer.txt")


def decimal_commas(content, mark):
    """The content with decimal commas: separated by a mark, or with commas and in quotes."""
    quote = '"' if mark == "," else ""
    rows = [re.split("[,;\t]", line) for line in content.splitlines()]
    return "\n".join(
        mark.join(f"{quote}{cell.strip(chr(34)).replace('.', ',')}{quote}" for cell in row) for row in rows
    )


@pytest.mark.parametrize("mark", [";", "\t", ","])
@pytest.mark.parametrize(
    "content", [VICON, MOTIVE, FARO, U95.replace(",", ".")], ids=["vicon", "motive", "faro", "leica"]
)
def test_decimal_commas_are_read_in_every_layout(tmp_path, arm, content, mark):
    robot = arm("join: rows")
    check(joined(tmp_path, robot, decimal_commas(content, mark)), robot)
    numbered = decimal_commas(text_of(rows()), mark)
    (tmp_path / "numbered.txt").write_text(numbered)
    check(calib.read_measurements(tmp_path / "numbered.txt", arm(NUMBERED)), arm(NUMBERED))


def test_a_row_of_another_length_is_named_and_separators_at_its_end_are_nothing(tmp_path, arm):
    robot = arm("join: rows")
    for content in (VICON, MOTIVE):
        check(joined(tmp_path, robot, content[:-1] + ",,\n"), robot)
    for content, said in (
        (VICON, "line 7: 4 cells for 5 columns"),
        (MOTIVE, "line 9: 8 cells for 10"),
        (U95, "line 3: 3 cells"),
    ):
        lines = content.splitlines()
        lines[-2] = lines[-2].rsplit(";" if content is U95 else ",", 1 if content is VICON else 2)[0]
        with pytest.raises(calib.DataError, match=said):
            joined(tmp_path, robot, "\n".join(lines))


def test_a_unit_of_length_is_a_whole_word_and_the_only_one(tmp_path):
    for said, unit in (
        ("Units: Millimeters", "mm"),
        ("Parameters, diameters", None),
        ("Deviations in micrometers, all else in millimeters", None),
    ):
        (tmp_path / "a.tsv").write_text(POLYWORKS.replace("Units: Millimeters", said))
        assert read_table(tmp_path / "a.tsv").units == (None, unit, unit, unit)
    for said, unit in (("Length Units,Centimeters", "centimeters"), ("Coordinates,Global", None)):
        (tmp_path / "a.csv").write_text(MOTIVE.replace("Length Units,Millimeters", said))
        assert read_table(tmp_path / "a.csv").units[6] == unit


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "latin-1"])
def test_u95_is_the_noise_of_each_row(tmp_path, arm, encoding):
    content = U95.replace("Name", "Name (20 °C)").encode(encoding)
    (readings,) = joined(tmp_path, arm("join: rows"), content).readings.values()
    std = np.sqrt(np.diagonal(readings.covariance, axis1=1, axis2=2))
    assert np.allclose(std, np.array([[0.02e-3], [0.03e-3], [0.04e-3]]) * np.ones(3))


def test_times_are_joined_by_the_nearest_within_a_lag(tmp_path, arm):
    robot = arm("join: time", "lag: 0.03", 'columns: {t: "time [s]"}')
    (tmp_path / "joints.csv").write_text("t,turn,slide,wrist\n" + text_of(np.column_stack([[1.0, 2.0, 3.0], JOINTS])))
    times = [0.5, 1.01, 1.02, 2.98, 2.02]
    seen = POINTS[[0, 0, 1, 2, 1]]
    (tmp_path / "points.csv").write_text("t,tool_x,tool_y,tool_z\n" + text_of(np.column_stack([times, seen])))
    check(calib.read_measurements([tmp_path / "joints.csv", tmp_path / "points.csv"], robot), robot)
    (tmp_path / "late.csv").write_text("t,tool_x,tool_y,tool_z\n" + text_of([[9.0, *POINTS[0]]]))
    with pytest.raises(calib.DataError, match=r"its times differ by 6 s or more from those in .*'lag' allows 0.03 s"):
        calib.read_measurements([tmp_path / "joints.csv", tmp_path / "late.csv"], robot)


NUMBERED = 'columns: {"1": "turn [rad]", "2": slide, "3": wrist, "4": tool_x, "5": tool_y, "6": tool_z}'


def test_what_savetxt_writes_is_read(tmp_path, arm):
    robot = arm(NUMBERED)
    np.savetxt(tmp_path / "bare.txt", rows())
    np.savetxt(tmp_path / "comma.txt", rows(), delimiter=",")
    np.savetxt(tmp_path / "named.txt", rows(), header="turn slide wrist tool_x tool_y tool_z")
    for name in ("bare", "comma", "named"):
        check(calib.read_measurements(tmp_path / f"{name}.txt", robot), robot)
    with pytest.raises(calib.DataError, match=r'rows without names of columns, .*columns: \{"1": "joint_1 \[rad\]"'):
        calib.read_measurements(tmp_path / "bare.txt", arm())


@pytest.mark.parametrize("row", ['"p 1" {} {} {}', "A,Points,p1,{},{},{},05/02/2024 10:11:12", "p1 {} {} {}"])
def test_points_without_a_header_are_read_by_the_numbers_of_their_columns(tmp_path, arm, row):
    first = next(k for k, cell in enumerate(row.replace('"p 1"', "p").replace(",", " ").split()) if cell == "{}") + 1
    named = ", ".join(f'"{first + k}": "tool_{axis} [mm]"' for k, axis in enumerate("xyz"))
    robot = arm("join: rows", f"columns: {{{named}}}")
    check(joined(tmp_path, robot, "".join(row.format(*(1000 * point)) + "\n" for point in POINTS)), robot)
    with pytest.raises(calib.DataError, match="write a line with the names of the columns above them"):
        read_table(tmp_path / "points.txt")
    (tmp_path / "named.csv").write_text("pose,1,2,3\np1,510,120,330\n")
    assert read_table(tmp_path / "named.csv", {"1": "tool_x [mm]"}).names[0] == "pose"


def test_lists_in_cells_are_columns(tmp_path):
    for number, text in enumerate(('"[1.0, -20.5]"', "[1.0 -20.5]")):
        (tmp_path / f"{number}.csv").write_text(f"timestamp,observation.state\n0.0,{text}\n0.1,{text}\n0.2,{text}\n")
        table = read_table(tmp_path / f"{number}.csv")
        assert table.names == ("timestamp", "observation.state_1", "observation.state_2")
        assert np.allclose(table.column("observation.state_2", None), [-20.5] * 3)


def test_heads_without_labels_are_known(tmp_path):
    (tmp_path / "m.csv").write_text(MOTIVE.replace(",Type,", ",,").replace(",Name,", ",,").replace(",ID,", ",,"))
    assert "Ball_qw" in read_table(tmp_path / "m.csv").names


def test_names_and_numbers_may_be_parted_by_blanks(tmp_path, arm):
    names, numbers = "turn slide wrist tool_x tool_y tool_z\n", text_of(rows(), " ")
    named = "".join(f"p{k} {line}\n" for k, line in enumerate(numbers.splitlines()))
    for text in (names.replace("_x", "_x  ") + numbers, f"pose {names}{named}"):
        (tmp_path / "blanks.txt").write_text(text)
        check(calib.read_measurements(tmp_path / "blanks.txt", arm()), arm())


TRC = (
    "PathFileType\t4\t(X/Y/Z)\ta.trc\nDataRate\tCameraRate\tUnits\n100\t100\tmm\n"
    "Frame#\tTime\tball\t\t\tbase\t\t\n\t\tX1\tY1\tZ1\tX2\tY2\tZ2\n\n1\t0.0\t4\t5\t6\t1\t2\t3\n2\t0.1\t4\t5\t6\t11\t12\t13\n"
)
SEGMENTS = """Segments
100
,,Arm:Hand,,,,,,Arm:Base,,,,,
Frame,Sub Frame,RX,RY,RZ,TX,TY,TZ,RX,RY,RZ,TX,TY,TZ
,,deg,deg,deg,mm,mm,mm,deg,deg,deg,mm,mm,mm
1,0,1,2,3,4,5,6,7,8,9,10,11,12
"""


def test_segments_markers_and_other_heads_are_told_apart(tmp_path, arm):
    (tmp_path / "s.csv").write_text(SEGMENTS)
    table = read_table(tmp_path / "s.csv")
    assert table.names[2:8] == ("Hand_rx", "Hand_ry", "Hand_rz", "Hand_x", "Hand_y", "Hand_z")
    assert table.units[8:14] == ("deg", "deg", "deg", "mm", "mm", "mm")
    markers = ",".join(["Marker"] * 4)
    turned = ",".join(["Rotation"] * 4)
    (tmp_path / "m.csv").write_text(MOTIVE.replace("Quaternion", "XYZ").replace(turned, markers))
    assert "Ball_x" in read_table(tmp_path / "m.csv").names
    inches = SPATIAL_ANALYZER.replace("[mm]", "").replace("export", "export, Units: Inches")
    (tmp_path / "inches.txt").write_text(inches)
    assert read_table(tmp_path / "inches.txt").units[5] == "in"
    (tmp_path / "trc.txt").write_text(TRC)
    table = read_table(tmp_path / "trc.txt")
    assert table.names == ("Frame#", "Time", "ball_x", "ball_y", "ball_z", "base_x", "base_y", "base_z")
    assert np.allclose(table.column("base_z", None), [3, 13])


@pytest.mark.parametrize("form", ["records", "lines", "arrays", "nested"])
def test_json_of_arrays_or_records_is_read(tmp_path, arm, form):
    robot = arm("columns: {q_x: turn, q_y: slide, q_z: wrist}")
    arrays = {"q": JOINTS.tolist(), "tool": POINTS.tolist(), "pose": ["p0", "p1", "p2"]}
    records = [dict(zip(arrays, row, strict=True)) for row in zip(*arrays.values(), strict=True)]
    content = {
        "records": json.dumps(records, indent=1),
        "lines": "\n".join(json.dumps(record) for record in records),
        "arrays": json.dumps(arrays),
        "nested": json.dumps(arrays | {"q": JOINTS.T.tolist(), "rate": 10.0}),
    }[form]
    (tmp_path / "a.json").write_text(content)
    data = calib.read_measurements(tmp_path / "a.json", robot)
    if form != "nested":  # three joints of three poses: the first axis counts
        check(data, robot)
    assert data.names == ("p0", "p1", "p2")


def test_null_in_json_is_an_empty_cell(tmp_path, arm):
    robot = arm("columns: {q_x: turn, q_y: slide, q_z: wrist}")
    points = [{"tool": point} for point in (POINTS[0].tolist(), [None, None, None], POINTS[2].tolist())]
    (tmp_path / "a.json").write_text(json.dumps([{"q": q} | p for q, p in zip(JOINTS.tolist(), points, strict=True)]))
    data = calib.read_measurements(tmp_path / "a.json", robot)
    assert np.allclose(data.points(robot)[:, 0], POINTS[[0, 2]])


SERVO = {"id": 1, "drive_mode": 0, "homing_offset": -100, "range_min": 1024, "range_max": 3072}
SO100 = {"homing_offset": [1, 2], "drive_mode": [0, 1], "calib_mode": ["DEGREE"], "motor_names": ["elbow_flex", "grip"]}
REFUSED = [  # name, content, and what is said
    ("a.csv", FARO.splitlines()[0] + "\n", "has no measured points below its header"),
    (
        "a.tsv",
        POLYWORKS.replace("420.0", "1,420.0"),
        "a.tsv, line 9, column 'Meas': '1,420.0' is not a number; write thous",
    ),
    ("a.json", json.dumps({"a": [[10**400, None]]}), "cannot be read (int too large"),
    (
        "a.npy",
        b"\x93NUMPY\x01\0v\0{'descr':'<f8','fortran_order':False,'shape':(99999999999999,)}".ljust(127) + b"\n",
        "cannot be read",
    ),
    ("a.tsv", POLYWORKS.replace("p2\tX", "p2\tDiameter"), "point 'p2' lacks a measured X, Y or Z"),
    ("a.csv", SEGMENTS + "\n" + VICON, "a.csv, line 11: a second table begins; keep one of them"),
    ("a.csv", 't,q\n0,"[1, 2]"\n1,"[1]"\n', "a.csv: cannot be read"),
    ("a.json", '{"a": 1}', "holds no arrays of numbers"),
    ("a.json", '{"a": [1, 2', "cannot be read"),
    ("a.json", '[{"a": 1}, {"b": 2}]', "not every record has 'a'"),
    ("a.json", "[" * 10_000 + "1,", "cannot be read"),
    ("a.csv", b"ARROW1\0\0", "this looks like a Parquet or Arrow file"),
    ("a.csv", b"#ROSBAG V2.0\n", "this looks like a bag of ROS 1"),
    ("a.csv", b"\x02\x50" + bytes(100), "this looks like a C3D file"),
    ("a.csv", gzip.compress(b"a,b\n1,2\n", mtime=0), "this looks like a compressed file"),
    ("a.csv", pickle.dumps({"q": [1]}), "this looks like a pickle of Python"),
    ("a.csv", b"\n<!doctype html>\n", "this looks like a web page"),
    ("a.csv", b"\x89PNG\r\n\x1a\n" + bytes(100), "this looks like a picture or a document"),
    ("a.csv", "*110001+0000000000000P01 81..00+0000000000510000\n", "this looks like Leica's GSI format"),
    ("a.csv", "NO_OF_FRAMES\t3\nMARKER_NAMES\tball\n1.0\t2.0\t3.0\n", "this looks like an export of Qualisys"),
    ("a.dt", "[*SYSTEM*]$MNUFRAME\n", "has a header but no rows"),
    ("a.yaml", "urdf: arm.urdf\n", "this looks like YAML: a robot description comes first"),
    ("a.parquet", b"PAR1" + bytes(100), "read_parquet"),
    ("a.npz", b"PK\x03\x04" + bytes(100), "a.npz: cannot be read"),
    ("a.json", json.dumps({"elbow": SERVO, "gripper": SERVO}), 'columns: {elbow.pos: "0.9 * elbow [deg]"}'),
    ("a.json", json.dumps({"elbow": SERVO}), 'elbow.pos: "0.087891 * elbow - 180 [deg]"'),
    ("a.json", json.dumps({"elbow": SERVO | {"drive_mode": 1}}), 'elbow.pos: "-0.9 * elbow [deg]"'),
    ("a.json", json.dumps(SO100), '{elbow_flex.pos: "elbow_flex [deg]"} into the robot desc'),
]


@pytest.mark.parametrize(("name", "content", "said"), REFUSED)
def test_files_that_are_not_read_are_named_with_the_way(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(calib.DataError, match=re.escape(said)):
        read_table(tmp_path / name)


def test_files_that_only_begin_alike_are_none_of_these(tmp_path):
    table = "Frame\tTime\tball X\tball Y\tball Z\n1\t0\t1\t2\t3\n2\t1\t1\t2\t3\n"
    (tmp_path / "a.tsv").write_text(f"NO_OF_FRAMES\t3\n{table}")
    assert "ball Y" in read_table(tmp_path / "a.tsv").names


def test_columns_of_an_array_in_c_and_units_behind_a_slash_are_read(tmp_path, arm):
    robot = arm('columns: {"q[0]": turn, "q[1]": slide, "q[2]": wrist}')
    header = "q[0],q[1],q[2],tool_x/m,tool_y/m,tool_z/m\n"
    (tmp_path / "a.csv").write_text(header + text_of(rows()))
    check(calib.read_measurements(tmp_path / "a.csv", robot), robot)


def test_arrays_are_columns(tmp_path, arm):
    robot = arm("columns: {q_x: turn, q_y: slide, q_z: wrist}")
    arrays = {"q": JOINTS, "tool": POINTS, "dt": np.float64(0.1), "note": np.array("text")}
    np.savez(tmp_path / "a.npz", **arrays)
    scipy.io.savemat(tmp_path / "a.mat", {"q": JOINTS, "tool": POINTS, "dt": 0.1})
    for name in ("a.npz", "a.mat"):
        check(calib.read_measurements(tmp_path / name, robot), robot)
    scipy.io.savemat(tmp_path / "s.mat", {"run": {"q": JOINTS, "tool": POINTS}})
    assert read_table(tmp_path / "s.mat").names[0] == "run_q_x"
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "b.mat", "w") as file:
        file["q"], file["tool"] = JOINTS.T, POINTS.T
    check(calib.read_measurements(tmp_path / "b.mat", robot), robot)


def test_poses_of_arrays_are_positions_and_quaternions(tmp_path):
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, :3, :3] = scipy.spatial.transform.Rotation.random(5, rng=1).as_matrix()
    poses[:, :3, 3] = np.arange(15).reshape(5, 3)
    np.savez(tmp_path / "p.npz", marker=poses)
    table = read_table(tmp_path / "p.npz")
    assert table.names == tuple(f"marker_{ending}" for ending in ("x", "y", "z", "qx", "qy", "qz", "qw"))
    turned = np.stack([table.column(f"marker_q{axis}", None) for axis in "xyzw"], axis=1)
    assert np.allclose(scipy.spatial.transform.Rotation.from_quat(turned).as_matrix(), poses[:, :3, :3])


def test_ordinary_tables_are_none_of_these(tmp_path):
    (tmp_path / "a.csv").write_text("# a comment\nPoint,J1 [deg],X [mm],Y [mm],Z [mm]\n1,2,3,4,5\n")
    (tmp_path / "b.csv").write_text("Report,of,today\n\nPoint;X;Y;Z\n;mm;mm;mm\n1;2;3;4\n")
    for path in (*tmp_path.glob("*.csv"), *(EXAMPLES).glob("*.csv")):
        file = SomeFile(path, path.read_bytes()[: 1 << 16], {})
        assert [each.name for each in other_formats() if each.fits(file)] == [], path


def test_the_page_has_the_table_of_formats(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "docs" / "site"))
    make_files_table = importlib.import_module("make_files_table")
    assert make_files_table.page() == make_files_table.PAGE.read_text(encoding="utf-8"), "run make_files_table.py"


@pytest.mark.quick(0)
@pytest.mark.parametrize("unit", ["deg", pytest.param(None, marks=pytest.mark.amount(0, 1))])
def test_the_line_that_a_wrong_sign_prints_corrects_it(tmp_path, run_calib, unit):
    lines = (EXAMPLES / "arm_simulated.csv").read_text().splitlines()
    header = next(k for k, line in enumerate(lines) if not line.startswith("#"))
    rows = [line.split(",") for line in lines[header + 1 :]]
    names = lines[header].split(",")
    j, k = names.index("joint_2 [deg]"), names.index("joint_3 [deg]")
    for row in rows:
        row[j], row[k] = repr(90 - float(row[j])), repr(-float(row[k]))
        if unit is None:
            row[j : j + 1] = [repr(float(np.radians(float(row[j]))))]
    names[j] = "joint_2 [deg]" if unit else "joint_2"
    (tmp_path / "w.csv").write_text("\n".join(",".join(row) for row in [names, *rows]))
    text = copied(tmp_path, EXAMPLES / "arm.yaml").read_text()
    told = run_calib("fit", "arm.yaml", "w.csv", "--out", "o", "--no-pages", cwd=tmp_path)
    line = re.search(r"columns:\s+\{[^}]*\}", told.out)[0]
    assert re.sub(r"\s+", " ", line).endswith('joint_3: "-joint_3 [deg]"}')
    (tmp_path / "arm.yaml").write_text(f"{text}\n{line}\n")
    again = run_calib("fit", "arm.yaml", "w.csv", "--out", "p", "--no-pages", cwd=tmp_path)
    assert "Verdict: PASS" in again.out, again
