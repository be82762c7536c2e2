"""Measurements: columns by name, units, repeats averaged, and mistakes refused at the door."""

import numpy as np
import pytest
from small_robots import ARM_YAML, small_arm, write_arm

import calib
from calib.data.measurement_files import format_measurements, read_measurements, read_poses
from calib.errors import DataError

HEADER = "pose,turn [deg],slide [mm],wrist,tip_x [mm],tip_y,tip_z [um]\n"


@pytest.fixture
def arm(tmp_path):
    return small_arm(tmp_path)


@pytest.fixture
def read(tmp_path, arm):
    """Write a measurement file and read it for the arm."""

    def read_text(text, robot=arm, reader=read_measurements):
        path = tmp_path / "data.csv"
        path.write_text(text)
        return reader(path, robot)

    return read_text


def complaint(function, *arguments, **options):
    with pytest.raises(DataError) as caught:
        function(*arguments, **options)
    return str(caught.value)


def test_columns_are_found_by_name_in_any_order_and_converted(read):
    data = read("tip_z [um],note,wrist,tip_y,turn [deg],tip_x [mm],slide [mm]\n3e5,a,0.1,0.2,180,100,250\n")
    assert data.joints.tolist() == [[np.pi, 0.25, 0.1]]
    assert data.positions.tolist() == [[[0.1, 0.2, 0.3]]]
    assert data.ignored == ("note",)
    assert data.names == ("1",)
    assert data.labels == (f"{data.path}, line 2",)


def test_repeats_of_a_pose_are_averaged_in_the_order_of_their_first_row(read):
    rows = ["far,10,100,0,1,0,0", "near,20,200,0,5,0,0", "far,10,100,0,3,0,0", "far,10.01,100,0,5,0,0"]
    data = read(HEADER + "\n".join(rows) + "\n")
    assert data.names == ("far", "near")
    assert data.counts.tolist() == [3, 1]
    assert data.n_rows == 4
    assert data.positions[:, 0, 0] == pytest.approx([0.003, 0.005], abs=1e-18)
    assert data.joints[0, 0] == pytest.approx(np.radians(10 + 0.01 / 3), abs=1e-15)
    assert np.isnan(data.scatter).all()  # the joint values differ: part of it may be motion
    still = data.at_mean_joints(np.zeros((2, 1, 3, data.joints.shape[1])))
    assert still.scatter[0, 0, 0] == pytest.approx(0.002, abs=1e-15)  # standard deviation of 1, 3, 5 mm
    assert np.isnan(data.scatter[1]).all()
    assert data.labels[0] == f"{data.path}, line 2 (pose far)"


def test_repeatability_pools_the_repeats_by_their_degrees_of_freedom(read):
    generator = np.random.default_rng(3)
    lines, squares, freedom = [], 0.0, 0
    for name, count in (("a", 2), ("b", 5), ("c", 1), ("d", 3)):
        readings = generator.normal(0, 1, (count, 3))
        squares += ((readings - readings.mean(axis=0)) ** 2).sum()
        freedom += 3 * (count - 1)
        lines += [f"{name},0,0,0,{x!r},{y / 1e3!r},{1e3 * z!r}" for x, y, z in readings.tolist()]
    data = read(HEADER + "\n".join(lines) + "\n")
    assert data.repeatability() == pytest.approx(1e-3 * np.sqrt(squares / freedom), rel=1e-12)


def test_without_repeats_there_is_no_repeatability(read):
    assert np.isnan(read(HEADER + "a,0,0,0,0,0,0\nb,0,0,0,0,0,0\n").repeatability())


def test_blanks_around_a_pose_name_do_not_make_another_pose(read):
    assert read(HEADER + "a,0,0,0,0,0,0\n a ,0,0,0,0,0,0\n").counts.tolist() == [2]


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


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HEADER + "a,0,0,0,0,0,0\n,0,0,0,0,0,0\n", "line 3, column 'pose': is empty; name the pose, or leave"),
        ("turn,slide,tip_x,tip_y,tip_z\n0,0,0,0,0\n", "no column 'wrist'"),
        ("turns,slide,wrist,tip_x,tip_y,tip_z\n0,0,0,0,0,0\n", "no column 'turn'; did you mean 'turns'?"),
        ("turn,slide,wrist,tip_x,tip_z\n0,0,0,0,0\n", "no column 'tip_y'; did you mean"),
        ("turn [mm],slide,wrist,tip_x,tip_y,tip_z\n0,0,0,0,0,0\n", "column 'turn': unit 'mm' is for a length"),
        ("turn,slide [deg],wrist,tip_x,tip_y,tip_z\n0,0,0,0,0,0\n", "column 'slide': unit 'deg' is for an angle"),
        ("turn,slide,wrist,tip_x,tip_y,tip_z\n0,0,0,0,nan,0\n", "line 2, column 'tip_y': 'nan' is not finite"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_its_place(read, text, message):
    assert message in complaint(read, text)


def test_poses_need_no_measured_columns(read):
    poses = read("slide [mm],turn [deg],wrist [deg],note\n100,90,0,x\n", reader=read_poses)
    assert poses.joints.tolist() == [[np.pi / 2, 0.1, 0.0]]
    assert poses.ignored == ("note",)
    assert len(poses) == 1


def test_foreign_columns_are_mapped_by_the_description(tmp_path, read):
    columns = 'columns: {X: "tip_x [mm]", Y: tip_y, Z: "tip_z [um]", j1: "turn [deg]", name: pose}\n'
    robot = calib.load(write_arm(tmp_path, ARM_YAML + columns))
    data = read("name,j1,slide,wrist,X,Y,Z\na,180,0,0,1,1,1\n", robot)
    assert data.joints[0, 0] == np.pi
    assert data.positions.tolist() == [[[1e-3, 1.0, 1e-6]]]
    assert data.names == ("a",)


def test_several_targets_are_kept_in_the_order_of_the_description(tmp_path, read):
    yaml = ARM_YAML.replace("targets:\n", "targets:\n  elbow: {frame: slider}\n")
    robot = calib.load(write_arm(tmp_path, yaml))
    data = read("turn,slide,wrist,tip_x,tip_y,tip_z,elbow_x,elbow_y,elbow_z\n0,0,0,1,2,3,4,5,6\n", robot)
    assert robot.target_names == ("elbow", "tip")
    assert data.positions.tolist() == [[[4.0, 5.0, 6.0], [1.0, 2.0, 3.0]]]


def test_what_is_written_reads_back(arm, read):
    generator = np.random.default_rng(5)
    poses = read(
        "turn,slide,wrist\n" + "\n".join(f"{a},{b},{c}" for a, b, c in generator.uniform(0, 1, (20, 3))),
        reader=read_poses,
    )
    positions = arm.positions(poses.joints)
    data = read(format_measurements(arm, poses, positions, ("a comment",)))
    assert data.names == poses.names
    # one rounding each way, of numbers up to 60 deg and 1400 mm
    assert np.abs(data.joints - poses.joints).max() < 1e-15
    assert np.abs(data.positions - positions).max() < 1e-15


def test_a_joint_or_target_with_brackets_or_commas_in_its_name_survives_a_file(tmp_path, read):
    yaml = ARM_YAML.replace("tip:", '"tip [left], upper":').replace("[turn,", '["turn[1], #", ')
    urdf = (tmp_path / "arm.urdf").read_text().replace('"turn"', '"turn[1], #"')
    robot = calib.load(write_arm(tmp_path, yaml, urdf))
    poses = read('"turn[1], # [rad]",slide,wrist\n0.5,0.25,0\n', robot, read_poses)
    data = read(format_measurements(robot, poses, robot.positions(poses.joints)), robot)
    assert np.abs(data.positions - robot.positions(poses.joints)).max() < 1e-15


def test_the_arrays_are_copies_that_nobody_can_write_to(read):
    data = read(HEADER + "a,0,0,0,0,0,0\nb,0,0,0,0,0,0\n")
    for array in (data.joints, data.positions, data.counts, data.scatter, data.subset(np.array([0])).joints):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1
    joints = np.zeros((1, 3))
    poses = calib.Poses(joints, ("a",), ("a",), "here", ())
    joints[0] = 7
    assert poses.joints.tolist() == [[0, 0, 0]]


def test_a_subset_keeps_rows_together_in_the_order_asked_for(read):
    data = read(HEADER + "a,1,0,0,10,0,0\nb,2,0,0,20,0,0\nc,3,0,0,30,0,0\n").subset(np.array([2, 0]))
    assert data.names == ("c", "a")
    assert [label[-8:] for label in data.labels] == ["(pose c)", "(pose a)"]
    assert data.positions[:, 0, 0].tolist() == [0.03, 0.01]
    assert np.degrees(data.joints[:, 0]) == pytest.approx([3, 1])


def test_what_a_file_says_about_itself_is_kept(read):
    said = "# Simulated; no real robot was measured.\n#second line\n"
    rows = "a,1,0,0,10,0,0\na,1,0,0,10,0,0\nb,2,0,0,20,0,0\n"
    data = read(said + HEADER + rows)
    assert data.comments == ("Simulated; no real robot was measured.", "second line")
    assert data.subset(np.array([1])).comments == data.comments
    assert read(HEADER + rows).comments == ()
    assert read(said + HEADER + rows, reader=read_poses).comments == data.comments


def test_a_subset_remembers_the_order_of_measurement(read):
    data = read(HEADER + "a,1,0,0,10,0,0\na,1,0,0,10,0,0\nb,2,0,0,20,0,0\nc,3,0,0,30,0,0\n")
    assert data.places.tolist() == [0, 1, 2]
    chosen = data.subset(np.array([2, 0]))
    assert chosen.places.tolist() == [2, 0]
    assert chosen.subset(np.array([0])).places.tolist() == [2]
