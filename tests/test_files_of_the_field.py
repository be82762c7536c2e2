"""Measurements as other programs write them: read by their head, or named; signs and zeros of columns; joined files."""

import importlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
import scipy
from small_robots import ARM_YAML, write_arm

import calib
from calib.core.data.other_formats import SomeFile, other_formats
from calib.core.data.tables import read_table

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
        ('{p: "-pose"}', "no column '-pose'|no column 'pose'"),
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


@pytest.mark.parametrize("content", [SPATIAL_ANALYZER, VICON, MOTIVE, U95], ids=["sa", "vicon", "motive", "leica"])
def test_exports_of_instruments_are_read_row_by_row(tmp_path, arm, content, caplog):
    robot = arm("join: rows")
    (tmp_path / "joints.csv").write_text("turn,slide,wrist\n" + text_of(JOINTS))
    (tmp_path / "points.txt").write_text(content)
    data = calib.read_measurements([tmp_path / "joints.csv", tmp_path / "points.txt"], robot)
    check(data, robot)
    assert "read as" in caplog.text
    assert "joined row by row with" in caplog.text
    (tmp_path / "fewer.txt").write_text("\n".join(content.splitlines()[:-1]))
    with pytest.raises(calib.DataError, match=r"has 2 rows and .* 3; join: rows needs as many"):
        calib.read_measurements([tmp_path / "joints.csv", tmp_path / "fewer.txt"], robot)
    with pytest.raises(calib.DataError, match=r"fewer.txt.*(no file with joint values has a pose 'p1'|join: rows, or)"):
        calib.read_measurements([tmp_path / "joints.csv", tmp_path / "fewer.txt"], arm())


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "latin-1"])
def test_u95_is_the_noise_of_each_row(tmp_path, arm, encoding):
    robot = arm("join: rows")
    (tmp_path / "joints.csv").write_text("turn,slide,wrist\n" + text_of(JOINTS))
    (tmp_path / "p.txt").write_bytes(U95.replace("Name", "Name (20 °C)").encode(encoding))
    (readings,) = calib.read_measurements([tmp_path / "joints.csv", tmp_path / "p.txt"], robot).readings.values()
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
    with pytest.raises(calib.DataError, match=r"no time within 0.03 s .*the nearest is 6 s away"):
        calib.read_measurements([tmp_path / "joints.csv", tmp_path / "late.csv"], robot)


NUMBERED = 'columns: {"1": "turn [rad]", "2": slide, "3": wrist, "4": tool_x, "5": tool_y, "6": tool_z}'


def test_what_savetxt_writes_is_read(tmp_path, arm):
    robot = arm(NUMBERED)
    np.savetxt(tmp_path / "bare.txt", rows())
    np.savetxt(tmp_path / "comma.txt", rows(), delimiter=",")
    np.savetxt(tmp_path / "named.txt", rows(), header="turn slide wrist tool_x tool_y tool_z")
    for name in ("bare", "comma", "named"):
        check(calib.read_measurements(tmp_path / f"{name}.txt", robot), robot)
    with pytest.raises(calib.DataError, match=r'numbers without names, .*columns: \{"1": "joint_1 \[rad\]"'):
        calib.read_measurements(tmp_path / "bare.txt", arm())


def test_arrays_are_columns(tmp_path, arm):
    robot = arm("columns: {q_x: turn, q_y: slide, q_z: wrist}")
    arrays = {"q": JOINTS, "tool": POINTS, "dt": np.float64(0.1), "note": np.array("text")}
    np.savez(tmp_path / "a.npz", **arrays)
    scipy.io.savemat(tmp_path / "a.mat", {"q": JOINTS, "tool": POINTS, "dt": 0.1})
    for name in ("a.npz", "a.mat"):
        check(calib.read_measurements(tmp_path / name, robot), robot)
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


def test_files_that_are_not_read_are_named_with_the_way(tmp_path, arm):
    servo = {"id": 1, "drive_mode": 0, "homing_offset": -100, "range_min": 1024, "range_max": 3072}
    (tmp_path / "so101.json").write_text(json.dumps({"elbow_flex": servo, "gripper": servo}))
    with pytest.raises(calib.DataError, match=re.escape('columns: {elbow_flex.pos: "0.9 * elbow_flex [deg]"}')):
        calib.read_measurements(tmp_path / "so101.json", arm())
    (tmp_path / "d.parquet").write_bytes(b"PAR1" + bytes(100))
    with pytest.raises(calib.DataError, match=r"this looks like a Parquet file: .*read_parquet"):
        calib.read_measurements(tmp_path / "d.parquet", arm())
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04" + bytes(100))
    with pytest.raises(calib.DataError, match=r"bad.npz: cannot be read"):
        calib.read_measurements(tmp_path / "bad.npz", arm())


def test_ordinary_tables_are_none_of_these(tmp_path):
    (tmp_path / "a.csv").write_text("# a comment\nPoint,J1 [deg],X [mm],Y [mm],Z [mm]\n1,2,3,4,5\n")
    (tmp_path / "b.csv").write_text("Report,of,today\n\nPoint;X;Y;Z\n;mm;mm;mm\n1;2;3;4\n")
    for path in (*tmp_path.glob("*.csv"), *(Path(__file__).parents[1] / "docs" / "examples").glob("*.csv")):
        file = SomeFile(path, path.read_bytes()[: 1 << 16], {})
        assert [each.name for each in other_formats() if each.fits(file)] == [], path


def test_the_page_has_the_table_of_formats(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "docs" / "site"))
    make_files_table = importlib.import_module("make_files_table")
    assert make_files_table.page() == make_files_table.PAGE.read_text(encoding="utf-8"), "run make_files_table.py"
