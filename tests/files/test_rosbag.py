"""A ROS 2 bag is a table: readings at which the robot stood still, with the joints of that moment."""

import sys

import numpy as np
import pytest

import calib
from calib.core.data.other_formats import is_bag
from tests.project import EXAMPLES

rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

TYPES = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
JOINTS = tuple(f"joint_{k}" for k in range(1, 7))
START = 1_700_000_000.0  # [s]


def header(t):
    kind = TYPES.types
    stamp = kind["builtin_interfaces/msg/Time"](sec=int(t), nanosec=round((t - int(t)) * 1e9))
    return kind["std_msgs/msg/Header"](stamp=stamp, frame_id="tracker")


def joint_state(t, q, names=JOINTS):
    none = np.zeros(0)
    return TYPES.types["sensor_msgs/msg/JointState"](
        header=header(t), name=list(names), position=np.array(q, dtype=float), velocity=none, effort=none
    )


def place(t, p, turned=None, kind="PointStamped"):
    make = TYPES.types
    if kind == "PointStamped":
        return make["geometry_msgs/msg/PointStamped"](header(t), make["geometry_msgs/msg/Point"](*p))
    quaternion = make["geometry_msgs/msg/Quaternion"](*turned)
    if kind == "PoseStamped":
        pose = make["geometry_msgs/msg/Pose"](make["geometry_msgs/msg/Point"](*p), quaternion)
        return make["geometry_msgs/msg/PoseStamped"](header(t), pose)
    transform = make["geometry_msgs/msg/Transform"](make["geometry_msgs/msg/Vector3"](*p), quaternion)
    return make["geometry_msgs/msg/TransformStamped"](header(t), "ball", transform)


def write_bag(path, messages, storage="SQLITE3"):
    """Write (topic, type, time of recording [s], message) with the package's own writer."""
    with rosbag2.Writer(path, version=9, storage_plugin=rosbag2.StoragePlugin[storage]) as writer:
        topics = {}
        for topic, kind, t, message in messages:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=TYPES)
            writer.write(topics[topic], round(t * 1e9), TYPES.serialize_cdr(message, kind))
    return path


def recording(q, seen, rng, *, joints=True, names=JOINTS):
    """A robot that stands at each of q (n, 6) for a second and moves on, seen twice at each stop and once on the way.

    `seen(k, t)` returns topic, type and message of what is seen of the k-th stop.
    """
    messages, t = [], START
    for k, at in enumerate(q):
        for step in range(40):  # 50 Hz, flickering by a tenth of what counts as motion
            now = at + 5e-5 * rng.uniform(-1, 1, 6) if step < 20 else at + 0.02 * (step - 19)
            if joints:
                messages.append(("/joint_states", "sensor_msgs/msg/JointState", t, joint_state(t, now, names)))
            if step in (8, 12, 30):
                topic, kind, message = seen(k, t)
                messages.append((topic, kind, t, message))
            t += 0.05
    return messages


def points(p):
    """What a tracker sees of positions p (n, 3)."""
    return lambda k, t: ("/reflector", "geometry_msgs/msg/PointStamped", place(t, p[k]))


@pytest.fixture(scope="module")
def measured(robot, data):
    return robot, data.joints[:30], data.points(robot)[:30, 0]


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_a_bag_gives_the_rows_at_which_the_robot_stood_still(tmp_path, measured, storage):
    robot, q, p = measured
    folder = write_bag(tmp_path / "bag", recording(q[:4], points(p), np.random.default_rng(0)), storage)
    data = calib.read_measurements(folder, robot)
    assert data.names == ("stop 1",) * 2 + ("stop 2",) * 2 + ("stop 3",) * 2 + ("stop 4",) * 2
    assert np.abs(data.joints - np.repeat(q[:4], 2, axis=0)).max() < 5e-5
    assert np.array_equal(data.joints[0], data.joints[1])
    assert np.array_equal(data.points(robot)[:, 0], np.repeat(p[:4], 2, axis=0))
    assert data.context["time"][:2] == pytest.approx([0.4, 0.6], abs=1e-6)
    assert any("4 measurements of 12 left out: the robot moved" in comment for comment in data.comments)
    inside = next(file for file in folder.iterdir() if file.suffix in (".db3", ".mcap"))
    alone = calib.read_measurements(inside, robot)
    assert np.array_equal(alone.joints, data.joints)


@pytest.mark.quick(0)
def test_a_calibration_from_a_bag_is_that_from_the_table(tmp_path, measured, run_calib):
    robot, q, p = measured
    folder = write_bag(tmp_path / "bag", recording(q, points(p), np.random.default_rng(1)))
    assert run_calib("fit", EXAMPLES / "arm.yaml", folder, "--out", tmp_path / "out", "--no-pages").code == 0
    plain = calib.fit(robot, calib.as_measurements(robot, q, p)).robot
    again = calib.load(tmp_path / "out")
    assert np.abs(again.positions(q) - plain.positions(q)).max() < 2e-4  # 0.05 mrad of flicker, averaged


def test_poses_transforms_and_foreign_names(tmp_path, measured):
    text = (EXAMPLES / "arm.yaml").read_text()
    (tmp_path / "arm.urdf").write_bytes((EXAMPLES / "arm.urdf").read_bytes())
    columns = {f"arm/{name}": name for name in JOINTS}
    columns |= {f"tracker/ball_{axis}": f"six_{axis}" for axis in ("x", "y", "z", "qx", "qy", "qz", "qw")}
    text = text[: text.index("targets:")] + "targets:\n  ball: {frame: flange, position: unknown}\n"
    text += "instruments:\n  six: {kind: pose, target: ball}\nparametrisation:\n"
    text += "  - {origin: all, components: [x, y, z], sigma: 1 mm}\ncolumns:\n"
    (tmp_path / "arm.yaml").write_text(text + "".join(f"  {a}: {b}\n" for a, b in columns.items()))
    robot = calib.load(tmp_path / "arm.yaml")
    half = np.sqrt(0.5)
    for kind in ("PoseStamped", "TransformStamped"):
        messages = [
            ("/js", "sensor_msgs/msg/JointState", t, joint_state(t, measured[1][0], columns))
            for t in START + np.arange(0, 1, 0.1)
        ]
        placed = place(START + 0.52, [1.0, 2.0, 3.0], [0.0, 0.0, half, half], kind)
        messages.append(("/tracker/ball", f"geometry_msgs/msg/{kind}", START + 0.52, placed))
        data = calib.read_measurements(write_bag(tmp_path / kind, messages), robot)
        assert data.readings["six"].values == pytest.approx(np.array([[1, 2, 3, 0, 0, np.pi / 2]]))


def test_without_stamps_the_time_of_the_recording_counts(tmp_path, measured):
    robot, q, _ = measured
    messages = [("/js", "sensor_msgs/msg/JointState", 50 + t, joint_state(0.0, q[0])) for t in np.arange(0, 1, 0.1)]
    messages.append(("/reflector", "geometry_msgs/msg/PointStamped", 50.5, place(0.0, [1.0, 0.0, 0.0])))
    data = calib.read_measurements(write_bag(tmp_path / "bag", messages), robot)
    assert data.context["time"] == pytest.approx([0.5])


def still(q, at=0.5, speed=0.0, names=JOINTS):
    """A robot that stands at q, or moves, for a second, and a measurement."""
    messages = [
        ("/js", "sensor_msgs/msg/JointState", START + t, joint_state(START + t, q + speed * t, names))
        for t in np.arange(0, 1, 0.1)
    ]
    return [*messages, ("/reflector", "geometry_msgs/msg/PointStamped", START + at, place(START + at, [1.0, 0.0, 0.0]))]


NOWHERE = "the robot stood still at none of 1 measurement"
WRONG = {  # functions of joint values that make messages, and what is said of these
    "no joints": (lambda q: still(q)[10:], "their topic too; the bag has /reflector (geometry_msgs/msg/PointStamped)"),
    "no measurement": (lambda q: still(q)[:10], "their topic too; the bag has /js (sensor_msgs/msg/JointState)"),
    "moving": (lambda q: still(q, speed=1.0), NOWHERE),
    "apart": (lambda q: still(q, at=5.0), NOWHERE),
    "joints twice": (lambda q: [*still(q), ("/js2", *still(q)[0][1:])], "joint 'joint_1' is in /js and in /js2"),
    "not finite": (lambda q: still(q * np.nan), "numbers that are not finite"),
    "other joints": (lambda q: still(q, names="abcdef"), "no column 'joint_1'"),
}


@pytest.mark.quick(1)
@pytest.mark.parametrize("what", WRONG)
def test_bags_that_say_too_little_are_refused_in_one_line(measured, refused, tmp_path, what):
    messages, words = WRONG[what]
    refused(write_bag(tmp_path / "bag", messages(measured[1][0])), words)


@pytest.fixture
def refused(tmp_path, run_calib):
    def check(bag, words):
        assert words in run_calib("fit", EXAMPLES / "arm.yaml", bag, "--out", tmp_path / "out").refusal()
        assert not (tmp_path / "out").exists()

    return check


def test_files_that_are_no_bags_are_refused_in_one_line(tmp_path, measured, refused):
    refused(tmp_path / "nothing.mcap", "no such file; give a CSV file or a bag")
    for name in ("broken.mcap", "broken.db3"):
        (tmp_path / name).write_bytes(b"nothing of the kind")
        refused(tmp_path / name, "is not a bag that can be read")
    folder = write_bag(tmp_path / "bag", still(measured[1][0]))
    next(folder.glob("*.db3")).write_bytes(b"SQLite format 3\x00 and then nothing")
    refused(folder, "is not a bag that can be read")
    (folder / "metadata.yaml").write_text("}")
    refused(folder, "is not a bag that can be read")
    assert not is_bag(tmp_path)


def test_without_the_package_the_message_says_how_to_get_it(tmp_path, monkeypatch, refused):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    (tmp_path / "a.mcap").write_bytes(b"")
    refused(tmp_path / "a.mcap", "is not installed: pip install rosbags")


@pytest.mark.quick(0)
def test_of_a_bag_one_photograph_of_each_stop_comes_with_the_joints_of_that_moment(tmp_path, run_calib):
    pytest.importorskip("cv2")
    from calib.photographs.commands.boards import read_board_option
    from calib.photographs.opencv import read_image
    from calib.photographs.rendering import example

    board, q = "charuco:5x7:30mm:22mm:DICT_5X5_100", np.random.default_rng(3).uniform(-1, 1, (2, 6))
    for name, content in example(read_board_option(board), 1, np.random.default_rng(0)).items():
        (tmp_path / name).write_bytes(content)
    pixels, generator = read_image(tmp_path / "shot_01.png"), np.random.default_rng(1)

    def image(k, t):
        kind = "sensor_msgs/msg/Image"
        message = TYPES.types[kind](header(t), *pixels.shape, "mono8", 0, pixels.shape[1], pixels.ravel())
        return "/image", kind, message

    write_bag(tmp_path / "bag", recording(q, image, generator))
    write_bag(tmp_path / "none", recording(q, image, generator, joints=False))
    write_bag(tmp_path / "other", recording(q, image, generator, names=tuple("abcdef")))
    again = ("/goals", "sensor_msgs/msg/JointState", START, joint_state(START, q[1], JOINTS))
    write_bag(tmp_path / "twice", [*recording(q, image, generator), again])

    def detect(*sources):
        return run_calib("detect", *sources, "--board", board, "--out", "pixels.csv", "--force", cwd=tmp_path)

    done = detect("bag", "shot_01.png")
    assert done.code == 0
    said = "bag: 4 of 6 images left out: the robot moved, or had no joint states, at 2 (3, 6); 2 show the same"
    assert said in done.err
    assert "left out: shot_01: has no joint values, unlike images of bag" in done.err
    lines = (tmp_path / "pixels.csv").read_text().splitlines()
    rows = [line.split(",") for line in lines if not line.startswith("#")]
    assert rows[0][4:] == list(JOINTS)
    by_pose = {row[0]: np.array(row[4:], dtype=float) for row in rows[1:]}
    assert list(by_pose) == ["bag_2", "bag_5"]
    assert np.abs(np.array(list(by_pose.values())) - q).max() < 5e-5
    done = detect("none")
    assert "none: has no joint states (sensor_msgs/JointState), so its images have no joint values" in done.err
    assert "joint_1" not in (tmp_path / "pixels.csv").read_text()
    done = detect("bag", "other")
    assert done.code == 2
    assert "other: has the joints a, b, c, d, e, and 1 more, and bag has joint_1" in done.err
    done = detect("twice")
    assert done.code == 2
    assert "joint 'joint_1' is in " in done.err
