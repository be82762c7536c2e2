"""`calib init`: the description that it writes loads and works as it is, whatever the names in the URDF."""

import json
import re
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import calib
from calib.core.robots.description import Description
from calib.starting.descriptions import schema_text
from tests.project import EXAMPLES, ROOT
from tests.small_robots import ARM_URDF
from tests.urdf_trees import urdf_of

ODD_NAMES = ["a, b", "c: d", "#e", "yes", "1", "[f]", "{g}", "it's", 'say "h"', "- i", "*j", "é µ", "~", "0x1"]
ODD_NAMES += ["null", "k #l", "a" * 200]

GRIPPER = urdf_of(
    ("bolt", "fixed", "floor", "base"),
    ("a", "revolute", "base", "one"),
    ("pan", "revolute", "one", "camera", '<origin xyz="0 0.3 0"/>'),
    ("b", "revolute", "one", "two", '<origin xyz="0 0 0.5"/>'),
    ("left_drive", "prismatic", "two", "left_tip", '<origin xyz="0 0.02 0.1"/>'),
    ("flange", "fixed", "two", "tcp", '<origin xyz="0 0 0.12"/>'),
    ("right_drive", "prismatic", "two", "right_tip", '<origin xyz="0 -0.02 0.1"/>', '<mimic joint="left_drive"/>'),
)


def chain_urdf(joints, links, name="robot"):
    """A chain of revolute joints with these joint and link names."""
    text = [f"<link name={quoteattr(link)}/>" for link in links]
    for joint, parent, child in zip(joints, links[:-1], links[1:], strict=True):
        text.append(
            f"<joint name={quoteattr(joint)} type='revolute'><parent link={quoteattr(parent)}/>"
            f"<child link={quoteattr(child)}/><origin xyz='0.1 0 0.2'/><limit lower='-3' upper='3'/></joint>"
        )
    return f"<robot name='{name}'>{''.join(text)}</robot>"


@pytest.fixture
def init(tmp_path, run_calib):
    """Run `calib init` for a URDF, the small arm unless another is given, and write r.yaml."""

    def run(*arguments, urdf=ARM_URDF, out="r.yaml"):
        (tmp_path / "r.urdf").write_text(urdf)
        done = run_calib("init", "r.urdf", *arguments, "--out", out, cwd=tmp_path)
        assert (done.code, done.err) == (0, "")
        return done

    return run


def test_the_description_means_the_same_as_the_plain_urdf(tmp_path, init):
    run = init()
    first, end = run.out.splitlines()
    assert first == "r.yaml written; it works as it is, and its comments say what to change"
    assert end.startswith("the arm is taken to end at tool; another end, such as hand, slider, upper: ")
    described, plain = calib.load(tmp_path / "r.yaml"), calib.load(tmp_path / "r.urdf")
    assert described.parameters == plain.parameters
    assert described.description == plain.description
    q = np.array([[0.1, 0.2, 0.3]])
    assert np.array_equal(described.positions(q), plain.positions(q))


@pytest.mark.parametrize("odd", ODD_NAMES)
def test_odd_names_are_quoted(tmp_path, init, odd):
    init(urdf=chain_urdf([odd, "second"], ["root " + odd, "middle", odd + " end"]))
    robot = calib.load(tmp_path / "r.yaml")
    assert robot.joint_names == (odd, "second")
    assert robot.target_names == (odd + " end",)
    assert robot.description.base.frame == "root " + odd


def test_an_odd_name_as_the_whole_link_name_is_quoted_too(tmp_path, init):
    for k, link in enumerate(ODD_NAMES[1:]):
        urdf = chain_urdf([f"j{k}" for k in range(len(ODD_NAMES) - 1)], ODD_NAMES)
        init("--target", link, urdf=urdf, out=f"r{k}.yaml")
        assert calib.load(tmp_path / f"r{k}.yaml").target_names == (link,)


def test_an_odd_place_of_the_urdf_is_found_from_the_description(tmp_path, run_calib):
    folder = tmp_path / "my robots: #1, [new]"
    folder.mkdir()
    (folder / "it's é.urdf").write_text(ARM_URDF)
    (tmp_path / "elsewhere").mkdir()
    run = run_calib("init", folder / "it's é.urdf", "--out", "elsewhere/arm.yaml", cwd=tmp_path)
    assert run.code == 0, run.err
    assert calib.load(tmp_path / "elsewhere" / "arm.yaml").joint_names == ("turn", "slide", "wrist")
    assert str(tmp_path) not in (tmp_path / "elsewhere" / "arm.yaml").read_text()  # relative: the folders can move


def test_a_robot_name_with_line_ends_stays_in_its_comment(tmp_path, init):
    init(urdf=chain_urdf(["a"], ["x", "y"], name="one&#10;priors: false&#10;two"))
    assert calib.load(tmp_path / "r.yaml").description.priors is True


def test_every_key_is_explained_and_every_commented_key_exists(tmp_path, init):
    init()
    text = (tmp_path / "r.yaml").read_text()
    keys = set(yaml.safe_load(text)) | set(re.findall(r"^# ([a-z_]+): \S", text, flags=re.MULTILINE))
    assert keys <= set(Description.model_fields)
    assert {"urdf", "name_mot", "closed_loop", "type", "closed_loop_axes", "home", "base", "targets",
            "parametrisation", "held", "priors", "sigma", "columns"} <= keys  # fmt: skip


def test_the_commented_examples_are_valid_once_uncommented(tmp_path, init):
    init()
    text = (tmp_path / "r.yaml").read_text()
    text = re.sub(r"^# ((held|priors|sigma|columns|home): )", r"\1", text, flags=re.MULTILINE)
    (tmp_path / "r.yaml").write_text(text)
    description = calib.load(tmp_path / "r.yaml").description
    assert description.held == ("turn.x",)
    assert description.priors is False
    assert description.sigma == 40e-6
    assert description.columns == {"x1": "tool_x [m]", "j1": "turn [deg]"}


def test_what_the_arm_leaves_out_is_said_on_the_terminal_and_in_the_file(tmp_path, init):
    run = init(urdf=GRIPPER)
    remark = (
        "the arm is taken to end at tcp; left out: left_drive, right_drive (taken for a gripper); pan (not on the way"
        " to it); another end, such as camera, left_tip, right_tip: calib init --target NAME"
    )
    first = "r.yaml written; it works as it is, and its comments say what to change"
    assert run.out.splitlines() == [first, remark]
    text = (tmp_path / "r.yaml").read_text()
    assert remark[1:] in text.replace("\n# ", " ")
    assert calib.load(tmp_path / "r.yaml").description == calib.load(tmp_path / "r.urdf").description
    assert init("--target", "left_tip", urdf=GRIPPER, out="l.yaml").out.count("\n") == 1
    assert calib.load(tmp_path / "l.yaml").joint_names == ("a", "b", "left_drive")


def test_a_plain_urdf_as_the_robot_says_what_it_leaves_out(tmp_path, run_calib):
    (tmp_path / "r.urdf").write_text(GRIPPER)
    run = run_calib("check", "r.urdf", cwd=tmp_path)
    assert run.code == 0
    assert run.err.startswith("note: the arm is taken to end at tcp; left out: left_drive, right_drive (taken for a")
    assert run_calib("check", "r.urdf", "--quiet", cwd=tmp_path).err == ""


def test_a_target_inside_the_chain_can_be_chosen(tmp_path, init):
    init("--target", "slider")
    robot = calib.load(tmp_path / "r.yaml")
    assert robot.joint_names == ("turn", "slide")
    assert robot.target_names == ("slider",)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("--target tol --out new.yaml", "arm.urdf: no link 'tol'; did you mean 'tool'?"),
        ("--target ground --out new.yaml", "arm.urdf: no joint moves link 'ground'; there is nothing to calibrate"),
        ("--out old.yaml", "old.yaml: was not written by this program, or was changed since; choose another place"),
        ("--out new.txt", "new.txt: the name of a robot description ends in .yaml"),
        ("--out no/new.yaml", "no/new.yaml: cannot be written (no such file or directory); choose another place for"),
    ],
)
def test_mistakes_are_one_line_and_nothing_is_written(tmp_path, run_calib, arguments, message):
    (tmp_path / "arm.urdf").write_text(ARM_URDF)
    (tmp_path / "old.yaml").write_text("edited by hand")
    run = run_calib("init", "arm.urdf", *arguments.split(), cwd=tmp_path)
    assert (run.code, run.out, run.err.count("\n")) == (2, "", 1)
    assert run.err.startswith(f"calib: {message}")
    assert {path.name for path in tmp_path.iterdir()} == {"arm.urdf", "old.yaml"}
    assert (tmp_path / "old.yaml").read_text() == "edited by hand"


@pytest.mark.parametrize(
    "name", ["motoman_right/robot.urdf", "ur10/robot.urdf", "mukca/urdf/iiwa14.urdf", "mukca/urdf/panda.urdf"]
)
def test_descriptions_of_real_robots_load(shared_data, tmp_path, run_calib, name):
    run = run_calib("init", shared_data / name, "--out", "robot.yaml", cwd=tmp_path)
    assert run.code == 0, run.err
    assert len(calib.load(tmp_path / "robot.yaml").joint_names) in (6, 7)


FILLED = {"tracker": "1.1,2.2,3.3", "touch": "a", "ballbar": "512.5"}


@pytest.mark.parametrize("measure", ["tracker", "touch", "ballbar", "rosbag"])
def test_a_way_to_measure_gives_a_description_that_loads_and_a_file_that_reads(tmp_path, init, measure):
    run = init("--measure", measure)
    robot, sheet = calib.load(tmp_path / "r.yaml"), tmp_path / "r_measurements.csv"
    assert sheet.exists() == (measure != "rosbag")
    if measure == "rosbag":
        assert robot.instruments[0].name == "reflector"
        return
    assert "r_measurements.csv" in run.out
    with pytest.raises(calib.DataError, match="has a header but no rows"):
        calib.read_measurements(sheet, robot)
    joints = ",".join("10" for _ in robot.joint_names)
    sheet.write_text(sheet.read_text() + f"1,{joints},{FILLED[measure]}\n")
    data = calib.read_measurements(sheet, robot)
    assert data.n_readings == 1
    assert data.ignored == ()


@pytest.mark.quick(1)
@pytest.mark.parametrize("measure", ["tracker", "touch", "camera", "ballbar", "rosbag"])
def test_the_schema_takes_the_description_of_every_way_to_measure(tmp_path, init, measure):
    jsonschema = pytest.importorskip("jsonschema")
    init("--measure", measure)
    validator, text = jsonschema.Draft202012Validator(json.loads(schema_text())), (tmp_path / "r.yaml").read_text()
    assert list(validator.iter_errors(yaml.safe_load(text))) == []
    if measure == "camera":
        short = text.replace("r_board.yaml", "chessboard:9x6:25mm")
        assert list(validator.iter_errors(yaml.safe_load(short))) == []
        assert list(validator.iter_errors(yaml.safe_load(text.replace('"r_board.yaml"', "9"))))


def test_the_schema_takes_what_descriptions_say_and_refuses_a_misspelt_key(tmp_path, run_calib):
    jsonschema = pytest.importorskip("jsonschema")
    assert run_calib("init", "--schema", "--out", "robot.schema.json", cwd=tmp_path).code == 0
    schema = json.loads((tmp_path / "robot.schema.json").read_text())
    validator = jsonschema.Draft202012Validator(schema)
    for path in (*EXAMPLES.glob("*.yaml"), *(ROOT / "urdf").glob("*.yaml")):
        said = yaml.safe_load(path.read_text())
        assert list(validator.iter_errors(said)) == [], path
        assert list(validator.iter_errors(said | {"name_motor": []}))
        assert list(validator.iter_errors(said | {"priors": "perhaps"}))
    assert run_calib("init", "arm.urdf", "--schema", "--out", "x.json", cwd=tmp_path).code == 2


@pytest.mark.quick(0)
def test_a_camera_is_described_with_its_board_and_can_be_used_at_once(tmp_path, run_calib, init):
    (tmp_path / "truth.csv").write_text(
        "parameter,value,unit\njoint_2.rx,0.2,deg\njoint_3.z,441.5,mm\ncamera.x,20,mm\ncamera.z,40,mm\ncamera.fx,1020,px\n"
    )
    run = init("--measure", "camera", urdf=(EXAMPLES / "arm.urdf").read_text())
    assert "r_board.yaml written: the board" in run.out
    (tmp_path / "r.yaml").write_text((tmp_path / "r.yaml").read_text().replace("# sigma: 0.2 ", "sigma: 0.2 "))
    for command in (
        "sample r.yaml --count 40 --out poses.csv",
        "simulate r.yaml poses.csv --parameters truth.csv --seed 1 --out measured.csv",
        "fit r.yaml measured.csv --no-pages --out result",
        "predict r.yaml poses.csv --result result --out predicted.csv",
        "predict r.yaml poses.csv --parameters truth.csv --out true.csv",
    ):
        run = run_calib(*command.split(), cwd=tmp_path)
        assert run.code == 0, (command, run.err)
        assert "few of these poses" not in run.err
    tool, truth = (
        1e-3 * np.loadtxt(tmp_path / name, delimiter=",", skiprows=2, usecols=(7, 8, 9))
        for name in ("predicted.csv", "true.csv")
    )
    # the board tells no place of the base: compared after the rigid motion that lays one on the other
    _, distance = Rotation.align_vectors(tool - tool.mean(axis=0), truth - truth.mean(axis=0))
    assert distance / np.sqrt(len(tool)) < 0.15e-3  # 1.5 mm and 0.2 deg before


def test_a_cameras_board_and_lens_may_be_given(tmp_path, run_calib, init):
    (tmp_path / "mine.yaml").write_text("kind: chessboard\ncolumns: 9\nrows: 6\nsquare: 25 mm\n")
    (tmp_path / "lens.yaml").write_text("fx: 800\nfy: 801\ncx: 320\ncy: 240\nk1: -0.1\nimage: [640, 480]\n")
    init("--measure", "camera", "--board", "mine.yaml", "--camera", "lens.yaml")
    assert not (tmp_path / "r_board.yaml").exists()
    camera = calib.load(tmp_path / "r.yaml").instrument("camera")
    assert len(camera.points_of_body) == 40
    assert camera.intrinsics[:5] == (800, 801, 320, 240, -0.1)
    assert camera.image == (640, 480)
    assert (tmp_path / "r_measurements.csv").read_text().count("camera_u") == 0
    for wrong, said in (
        (("tracker", "--board", "mine.yaml"), "calib: --board and --camera are for --measure camera"),
        (("tracker", "--camera", "lens.yaml"), "calib: --board and --camera are for --measure camera"),
        (("camera", "--board", "chess"), "is neither a YAML file nor a kind"),
    ):
        assert said in run_calib("init", "r.urdf", "--measure", *wrong, "--out", "t.yaml", cwd=tmp_path).refusal()


def test_a_joint_that_cannot_be_at_zero_starts_in_the_middle_of_its_limits(tmp_path, init):
    urdf = chain_urdf(["a", "b: 1"], ["one", "two", "three"])
    low = "lower='{}' upper='{}'".format
    for ends, middle in (((-3.0718, -0.0698), -1.5708), ((0.5, 0.7), 0.6)):
        init("--force", urdf=low(*ends).join(urdf.rsplit(low(-3, 3), 1)))
        assert calib.load(tmp_path / "r.yaml").home == pytest.approx([0.0, middle], abs=1e-12)
    init("--force", urdf=low(0, 3).join(urdf.rsplit(low(-3, 3), 1)))
    assert calib.load(tmp_path / "r.yaml").description.home == {}
