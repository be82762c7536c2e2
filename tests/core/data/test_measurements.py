"""Measurements: columns by name, units, rows that stay rows, gaps, several files, and mistakes refused at the door."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.core.data.measurement_files import format_measurements, format_positions, read_measurements, read_poses
from calib.core.data.measurements import with_points
from tests.core.data.test_tables import complaint
from tests.project import EXAMPLES
from tests.small_robots import ARM_YAML, write_arm

HEADER = "pose,turn [deg],slide [mm],wrist,tip_x [mm],tip_y,tip_z [um]\n"
TWO_BALLS = ARM_YAML.replace("targets:\n", "targets:\n  elbow: {frame: slider}\n")
TWO_INSTRUMENTS = (
    TWO_BALLS + "instruments:\n  tracker: {kind: position, target: tip}\n  arm: {kind: position, target: elbow}\n"
)
BOTH = "turn,slide,wrist,tracker_x,tracker_y,tracker_z,arm_x,arm_y,arm_z\n"


@pytest.fixture
def read(tmp_path, arm):
    """Write a measurement file and read it for the arm."""

    def read_text(text, robot=arm, reader=read_measurements):
        path = tmp_path / "data.csv"
        path.write_text(text)
        return reader(path, robot)

    return read_text


def test_columns_are_found_by_name_in_any_order_and_converted(arm, read):
    text = "# Simulated.\n#second line\ntip_z [um],note,wrist,tip_y,turn [deg],tip_x [mm],slide [mm]\n"
    data = read(text + "3e5,a,0.1,0.2,180,100,250\n")
    assert data.joints.tolist() == [[np.pi, 0.25, 0.1]]
    assert data.readings["tip"].values.tolist() == [[0.1, 0.2, 0.3]]
    assert data.points(arm).tolist() == [[[0.1, 0.2, 0.3]]]
    moved = with_points(arm, data, data.points(arm) + np.array([0.5, 0, 0]))
    assert moved.points(arm)[0, 0] == pytest.approx([0.6, 0.2, 0.3], abs=1e-15)
    assert data.ignored == ("note",)
    assert data.names == ("1",)
    assert data.labels == (f"{data.path}, line 4",)
    assert data.subset(np.array([0])).comments == data.comments == ("Simulated.", "second line")
    poses = read("# said\nslide [mm],turn [deg],wrist [deg],note\n100,90,0,x\n", reader=read_poses)  # nothing measured
    assert poses.joints.tolist() == [[np.pi / 2, 0.1, 0.0]]
    assert (poses.ignored, poses.comments, len(poses)) == (("note",), ("said",), 1)


def test_repeats_of_a_pose_stay_rows_of_their_own(read):
    rows = ["far,10,100,0,1,0,0", "near,20,200,0,5,0,0", " far ,10,100,0,3,0,0", "far,10.01,100,0,5,0,0"]
    data = read(HEADER + "\n".join(rows) + "\n")
    assert data.names == ("far", "near", "far", "far")
    assert data.pose_numbers.tolist() == [0, 1, 0, 0]
    assert (len(data), data.n_poses, data.n_readings) == (4, 2, 4)
    assert data.readings["tip"].visits.tolist() == [0, 1, 2, 3]
    assert data.readings["tip"].values[:, 0] == pytest.approx([0.001, 0.005, 0.003, 0.005], abs=1e-18)
    assert np.degrees(data.joints[:, 0]) == pytest.approx([10, 20, 10, 10.01], abs=1e-13)
    assert data.labels[2] == f"{data.path}, line 4 (pose far)"


@pytest.mark.parametrize(
    ("second", "message"),
    [
        ("10.2,100,0", "line 2 (pose a): joint 'turn' differs by 0.2 deg among the rows of pose 'a'"),
        ("10,102,0", "line 2 (pose a): joint 'slide' differs by 2 mm among the rows of pose 'a'"),
        ("10.2,110,0", "joint 'slide' differs by 10 mm"),  # the joint that is worst
    ],
)
def test_rows_of_one_pose_with_other_joint_values_are_refused(read, second, message):
    text = complaint(read, HEADER + f"a,10,100,0,0,0,0\na,{second},0,0,0\n")
    assert message in text
    assert text.endswith("rows with the same pose value must repeat one pose")


NOISY = "turn,slide,wrist,tip_x,tip_y,tip_z,{}\n0,0,0,1,2,3,{}\n"
STD = "tip_std_x,tip_std_y,tip_std_z"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEADER + "a,0,0,0,0,0,0\n,0,0,0,0,0,0\n", "line 3, column 'pose': is empty; name the pose, or leave"),
        ("turn,slide,tip_x,tip_y,tip_z\n0,0,0,0,0\n", "no column 'wrist'"),
        ("turns,slide,wrist,tip_x,tip_y,tip_z\n0,0,0,0,0,0\n", "no column 'turn'; did you mean 'turns'?"),
        ("turn,slide,wrist,tip_x,tip_z\n0,0,0,0,0\n", "no column 'tip_y'; the file has turn, slide, wrist"),
        ("turn [mm],slide,wrist,tip_x,tip_y,tip_z\n0,0,0,0,0,0\n", "column 'turn': unit 'mm' is for a length"),
        ("turn,slide [deg],wrist,tip_x,tip_y,tip_z\n0,0,0,0,0,0\n", "column 'slide': unit 'deg' is for an angle"),
        ("turn,slide,wrist,tip_x,tip_y,tip_z\n0,0,0,0,nan,0\n", "line 2, column 'tip_y': 'nan' is not finite"),
        (HEADER + "a,0,0,0,1,,3\n", "line 2, column 'tip_y': is empty; fill it in, or leave all cells of 'tip' empty"),
        (HEADER + "a,0,0,0,,,\n", "all cells of the measured columns are empty"),
        (HEADER + "a,0,,0,1,2,3\n", "line 2, column 'slide': is empty"),
        (NOISY.format("tip_std_x,tip_std_y", "1,1"), "no column 'tip_std_z' beside 'tip_std_x'; give all standard"),
        (NOISY.format("tip_corr_x_y", "0.5"), "no column 'tip_std_x' beside 'tip_corr_x_y'; give all standard"),
        (NOISY.format(STD, "1,,1"), "line 2, column 'tip_std_y': is empty; fill it in, because this row has a reading"),
        (NOISY.format(STD, "1,0,1"), "line 2, column 'tip_std_y': a standard deviation must be positive"),
        (NOISY.format(f"{STD},tip_corr_x_y", "1,1,1,1.2"), "line 2: the correlations of 'tip' contradict each other"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_its_place(read, text, message):
    assert message in complaint(read, text)


def test_foreign_columns_are_mapped_by_the_description(tmp_path, read):
    columns = 'columns: {X: "tip_x [mm]", Y: tip_y, Z: "tip_z [um]", j1: "turn [deg]", name: pose}\n'
    robot = calib.load(write_arm(tmp_path, ARM_YAML + columns))
    data = read("name,j1,slide,wrist,X,Y,Z\na,180,0,0,1,1,1\n", robot)
    assert data.joints[0, 0] == np.pi
    assert data.readings["tip"].values.tolist() == [[1e-3, 1.0, 1e-6]]
    assert data.names == ("a",)


def test_what_is_written_reads_back(arm, read):
    generator = np.random.default_rng(5)
    rows = "\n".join(f"{a},{b},{c}" for a, b, c in generator.uniform(0, 1, (20, 3)))
    poses = read("turn,slide,wrist\n" + rows, reader=read_poses)
    positions = arm.positions(poses.joints)
    data = read(format_positions(arm, poses, positions, ("a comment",)))
    assert data.names == poses.names
    # one rounding each way, of numbers up to 60 deg and 1400 mm
    assert np.abs(data.joints - poses.joints).max() < 1e-15
    assert np.abs(data.points(arm) - positions).max() < 1e-15


def test_a_joint_or_target_with_brackets_or_commas_in_its_name_survives_a_file(tmp_path, read):
    yaml = ARM_YAML.replace("tip:", '"tip [left], upper":').replace("[turn,", '["turn[1], #", ')
    urdf = (tmp_path / "arm.urdf").read_text().replace('"turn"', '"turn[1], #"')
    robot = calib.load(write_arm(tmp_path, yaml, urdf))
    poses = read('"turn[1], # [rad]",slide,wrist\n0.5,0.25,0\n', robot, read_poses)
    data = read(format_positions(robot, poses, robot.positions(poses.joints)), robot)
    assert np.abs(data.points(robot) - robot.positions(poses.joints)).max() < 1e-15


def test_the_arrays_are_copies_that_nobody_can_write_to(read):
    data = read(HEADER + "a,0,0,0,0,0,0\nb,0,0,0,0,0,0\n")
    result = data.readings["tip"]
    for array in (data.joints, result.visits, result.values, data.subset(np.array([0])).joints):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    joints = np.zeros((1, 3))
    poses = calib.Poses(joints, ("a",), ("a",), "here", ())
    joints[0] = 7
    assert poses.joints.tolist() == [[0, 0, 0]]


def test_a_subset_keeps_rows_together_in_the_order_asked_for_and_remembers_that_of_measurement(read):
    whole = read(HEADER + "a,1,0,0,10,0,0\na,1,0,0,10,0,0\nb,2,0,0,20,0,0\nc,3,0,0,30,0,0\n")
    assert whole.places.tolist() == [0, 1, 2, 3]
    data = whole.subset(np.array([3, 0]))
    assert (data.names, data.places.tolist()) == (("c", "a"), [3, 0])
    assert [label[-8:] for label in data.labels] == ["(pose c)", "(pose a)"]
    assert data.readings["tip"].values[:, 0].tolist() == [0.03, 0.01]
    assert data.readings["tip"].visits.tolist() == [0, 1]
    assert np.degrees(data.joints[:, 0]) == pytest.approx([3, 1])
    twice = data.subset(np.array([1, 0, 1]))
    assert (twice.names, twice.places.tolist()) == (("a", "c", "a"), [0, 3, 0])
    assert twice.readings["tip"].values[:, 0].tolist() == [0.01, 0.03, 0.01]


def test_empty_cells_are_readings_that_were_not_taken(tmp_path, read):
    robot = calib.load(write_arm(tmp_path, TWO_BALLS))
    header = "turn,slide,wrist,tip_x,tip_y,tip_z,elbow_x,elbow_y,elbow_z\n"
    data = read(header + "0,0,0,1,2,3,,,\n0,1,0,,,,,,\n0,0,1,,,,4,5,6\n0,0,2,7,8,9,1,1,1\n", robot)
    assert data.places.tolist() == [0, 2, 3]  # of the order of measurement; at the second, nothing was read
    assert data.readings["tip"].visits.tolist() == [0, 2]
    assert data.readings["elbow"].visits.tolist() == [1, 2]
    nan = [np.nan] * 3
    expected = [[nan, [1, 2, 3]], [[4, 5, 6], nan], [[1, 1, 1], [7, 8, 9]]]  # in the order of the description
    np.testing.assert_array_equal(data.points(robot), expected)
    assert data.n_readings == 4


def test_several_files_are_joined_by_the_pose(tmp_path):
    robot = calib.load(write_arm(tmp_path, TWO_INSTRUMENTS))
    (tmp_path / "joints.csv").write_text("pose,turn,slide,wrist\nA,0,0,0\nB,0.5,0,0\nC,1,0,0\n")
    (tmp_path / "tracker.csv").write_text("pose,tracker_x,tracker_y,tracker_z\nC,7,8,9\nA,1,2,3\nC,7,8,8\n")
    (tmp_path / "arm.csv").write_text("pose,arm_x [mm],arm_y,arm_z\nB,4000,5,6\n")
    data = read_measurements([tmp_path / f"{name}.csv" for name in ("joints", "tracker", "arm")], robot)
    assert data.names == ("A", "B", "C")
    assert data.readings["tracker"].visits.tolist() == [2, 0, 2]
    assert data.readings["tracker"].values.tolist() == [[7, 8, 9], [1, 2, 3], [7, 8, 8]]
    assert data.readings["arm"].visits.tolist() == [1]
    assert data.points(robot)[2, 1].tolist() == [7, 8, 8.5]  # of two readings at one visit, the mean
    (tmp_path / "arm.csv").write_text("pose,arm_x,arm_y,arm_z\nD,4,5,6\n")
    text = complaint(read_measurements, [tmp_path / "joints.csv", tmp_path / "arm.csv"], robot)
    assert "arm.csv, line 2, column 'pose': no file with joint values has a pose 'D'" in text
    (tmp_path / "arm.csv").write_text("arm_x,arm_y,arm_z\n4,5,6\n")
    text = complaint(read_measurements, [tmp_path / "joints.csv", tmp_path / "arm.csv"], robot)
    assert "arm.csv: has neither a column for every joint nor a column 'pose'" in text
    (tmp_path / "again.csv").write_text((tmp_path / "tracker.csv").read_text())
    text = complaint(read_measurements, [tmp_path / "tracker.csv", tmp_path / "again.csv"], robot)
    assert "none of the files has a column for every joint (turn, slide, wrist)" in text


@pytest.fixture
def sessions(tmp_path):
    """Two sessions, in files."""
    one, two = (tmp_path / f"{name}.csv" for name in ("one", "two"))
    one.write_text("# first\n" + BOTH.replace("wrist,", "wrist,temperature,") + "0,0,0,20,1,2,3,4,5,6\n")
    two.write_text("# second\nturn,slide,wrist,arm_x,arm_y,arm_z\n0.5,0,0,7,8,9\n0.6,0,0,7,8,9\n")
    return calib.load(write_arm(tmp_path, TWO_INSTRUMENTS)), [one, two]


def test_files_of_two_sessions_follow_one_another(sessions):
    robot, files = sessions
    data = read_measurements(files, robot)
    assert data.joints[:, 0].tolist() == [0, 0.5, 0.6]
    assert data.names == ("1", "2", "3")  # not the same pose twice
    assert data.readings["arm"].visits.tolist() == [0, 1, 2]
    assert data.readings["tracker"].visits.tolist() == [0]
    assert data.comments == ("first", "second")
    np.testing.assert_array_equal(data.context["temperature"], [20, np.nan, np.nan])
    files[1].write_text("turn,slide,wrist,arm_x,arm_y,arm_z,approach_turn\n0.5,0,0,7,8,9,1\n")
    text = complaint(read_measurements, files, robot)
    assert "one.csv: states no directions of approach, but another file does" in text


def test_measurements_that_were_read_follow_one_another_as_their_files_do(sessions):
    robot, files = sessions
    of_files = read_measurements(files, robot)
    one, two = (read_measurements(file, robot) for file in files)
    for parts in ([one, two], (one, files[1]), [files[0], two]):
        data = calib.as_measurements(robot, parts)
        assert data.names == of_files.names == ("1", "2", "3")
        assert (data.labels, data.path, data.approach) == (of_files.labels, of_files.path, None)
        np.testing.assert_array_equal(data.joints, of_files.joints)
        np.testing.assert_array_equal(data.context["temperature"], of_files.context["temperature"])
        for name, readings in of_files.readings.items():
            np.testing.assert_array_equal(data.readings[name].visits, readings.visits)
            np.testing.assert_array_equal(data.readings[name].values, readings.values)
    assert calib.as_measurements(robot, [two, replace(two)]).names == ("1", "2", "1", "2")  # joint values repeat
    moved = replace(two, setups=np.ones(2, dtype=int))
    assert calib.as_measurements(robot, [one, moved]).setups.tolist() == [0, 1, 1]
    parts_of_one = calib.as_measurements(robot, [of_files[:2], of_files[2:]])
    assert not parts_of_one.states_approach
    np.testing.assert_array_equal(parts_of_one.approach_directions, of_files.approach_directions)


def test_measurements_are_joined_only_where_their_files_are(sessions, tmp_path):
    robot, files = sessions
    one, two = (read_measurements(file, robot) for file in files)
    assert "one.csv: is given twice, so that every reading" in complaint(calib.as_measurements, robot, [one, two, one])
    stated = replace(two, approach=np.ones((2, 3)))
    text = complaint(calib.as_measurements, robot, [one, stated])
    assert "one.csv: states no directions of approach, but another file does" in text
    named = replace(two, names=("1", "b"))
    assert "among the rows of pose '1'" in complaint(calib.as_measurements, robot, [one, named])
    other = calib.load(EXAMPLES / "arm.yaml")
    assert "is of 'small arm', whose joints are not those of" in complaint(calib.as_measurements, other, [one, two])


def test_context_and_approach_are_read(read):
    header = "turn,slide,wrist,tip_x,tip_y,tip_z,time [min],temperature,load [kg],approach_turn\n"
    data = read(header + "0,0,0,1,2,3,2,21.5,0.5,-1\n0.5,0,0,1,2,3,,22,,1\n")
    np.testing.assert_array_equal(data.context["time"], [120, np.nan])
    np.testing.assert_array_equal(data.context["temperature"], [21.5, 22])
    np.testing.assert_array_equal(data.context["load"], [0.5, np.nan])
    assert data.ignored == ()
    assert data.approach_directions.tolist() == [[-1, 0, 0], [1, 0, 0]]
    assert data.subset(np.array([1])).context["temperature"].tolist() == [22]


def test_standard_deviations_and_correlations_are_the_covariance_of_a_row(read):
    header = "turn,slide,wrist,tip_x,tip_y,tip_z,tip_std_x [mm],tip_std_y [mm],tip_std_z [mm],tip_corr_x_z\n"
    data = read(header + "0,0,0,1,2,3,1,2,3,0.5\n0,1,0,,,,,,,\n0.5,0,0,1,2,3,4,5,6,0\n")  # not seen in the middle
    expected = 1e-6 * np.array([[1, 0, 1.5], [0, 4, 0], [1.5, 0, 9]])
    np.testing.assert_allclose(data.readings["tip"].covariance[0], expected, rtol=1e-12, atol=1e-20)
    np.testing.assert_allclose(data.readings["tip"].covariance[1], 1e-6 * np.diag([16, 25, 36]), rtol=1e-12, atol=1e-20)


def test_the_setup_of_a_row_says_from_which_place_it_was_read(tmp_path, read):
    yaml = ARM_YAML.replace("frame: ground", "frame: ground, pose: unknown") + "setups: {first: [], moved: [base]}\n"
    robot, header = calib.load(write_arm(tmp_path, yaml)), "turn,slide,wrist,tip_x,tip_y,tip_z"
    data = read(f"{header},setup\n0,0,0,1,2,3,moved\n0.5,0,0,1,2,3,first\n", robot)
    assert data.readings["tip"].pairs.tolist() == [1, 0]
    text = complaint(read, f"{header},setup\n0,0,0,1,2,3,move\n", robot)
    assert "line 2, column 'setup': no setup 'move'; did you mean 'moved'?" in text
    text = complaint(read, f"{header}\n0,0,0,1,2,3\n", robot)
    assert "no column 'setup'; the description names the setups first, moved" in text


def test_measurements_with_gaps_and_repeats_read_back(tmp_path, read):
    robot = calib.load(write_arm(tmp_path, TWO_INSTRUMENTS))
    rows = "a,0,0,0,0.1,0.2,0.3,,,\nb,0.5,0,0,,,,0.4,0.5,0.6\na,0,0,0,0.7,0.8,0.9,1,2,3\n"
    data = read("pose," + BOTH + rows, robot)
    again = read(format_measurements(robot, data, ("said",)), robot)
    assert again.comments == ("said",)
    assert again.names == data.names
    for name, readings in data.readings.items():
        assert again.readings[name].visits.tolist() == readings.visits.tolist()
        np.testing.assert_allclose(again.readings[name].values, readings.values, rtol=1e-15)


@pytest.mark.parametrize("directions", [[1, -1], [0, 0]])
def test_directions_of_approach_read_back(arm, read, directions):
    data = read(HEADER + "a,0,0,0,1,0,0\nb,1,0,0,2,0,0\n")
    assert "approach" not in format_measurements(arm, data)  # the order of the rows says it
    given = np.zeros((2, 3))
    given[:, 1] = directions
    again = read(format_measurements(arm, replace(data, approach=given)))
    assert again.approach_directions.tolist() == given.tolist()
