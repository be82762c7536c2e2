"""What `calib export` writes, as text: what changes, what does not, and the way round through loading."""

import json
import re
import shutil
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import yaml
from click.testing import CliRunner, Result

import calib
from calib.core.base.errors import InputError
from calib.core.results.urdf import urdf_bytes
from calib.core.robots.file_formats import formats
from calib.core.robots.urdf.text import parse_urdf
from calib.exporting.closed_model import closed_model
from calib.exporting.command import command
from calib.exporting.formats import JOINT_TABLES, export
from calib.exporting.mjcf import mjcf
from calib.printers import COMMENTS as FIRMWARES
from medrue.closed_form import ACTUATED_JOINTS, PASSIVE_JOINTS, forward
from medrue.paper_tables import table1
from medrue.workspace import target_workspace
from tests.project import ROOT
from tests.signed_files import plain, read_plain

NOT_OURS = ("dh", "mdh", "ur-kinematics", "rotary-axes", *FIRMWARES)
"""Formats that hold no closed loops, only those of delta printers, or rotary axes."""
ROBOT = ROOT / "urdf" / "medrue.yaml"
URDF = ROOT / "urdf" / "medrue.urdf"


@pytest.fixture(scope="module")
def nominal() -> calib.Robot:
    return calib.load(ROBOT)


@pytest.fixture(scope="module")
def calibrated(nominal: calib.Robot) -> calib.Robot:
    return nominal.with_parameters(table1().actual)


def without_comments(xml: bytes) -> bytes:
    return re.sub(rb"<!--.*?-->\n?", b"", xml, flags=re.DOTALL)


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(command, [str(argument) for argument in arguments])


# ---------------------------------------------------------------- URDF


def test_nominal_urdf_goes_out_byte_for_byte(nominal: calib.Robot, tmp_path: Path) -> None:
    export(nominal, tmp_path / "out.urdf", "urdf", provenance=["not needed: nothing was edited"])
    assert read_plain(tmp_path / "out.urdf") == URDF.read_bytes()


def test_provenance_is_one_comment_that_says_program_file_and_values(calibrated: calib.Robot) -> None:
    plain, told = urdf_bytes(calibrated), urdf_bytes(calibrated, ["fitted -- to 84 poses, é"])
    comment = re.search(rb"\n<!-- calib: calibrated origins.*?-->", told, re.DOTALL)
    assert comment is not None
    assert told.replace(comment.group(), b"") == plain
    words = comment.group().decode("ascii")
    assert "medrue.urdf" in words
    assert "sha256 of that file: " in words
    assert "  A1y: -233 -> -232.034 mm\n" in words
    assert "28 of 36" in words
    assert words.count("--") == 2  # XML allows two hyphens at the comment's ends only
    ElementTree.fromstring(told)


def test_provenance_of_an_earlier_export_is_replaced_not_repeated(calibrated: calib.Robot, tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_bytes(urdf_bytes(calibrated, ["first"]))
    export(calibrated, tmp_path / "home.yaml", "toolbox")  # for its assembled home
    content = yaml.safe_load((tmp_path / "home.yaml").read_text())
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(content | {"urdf": "robot.urdf"}))
    again = calib.load(tmp_path / "robot.yaml")
    assert urdf_bytes(again, ["second"]) == (tmp_path / "robot.urdf").read_bytes()  # nothing edited: as it was
    edited = urdf_bytes(again.with_parameters({"L11": 0.41}), ["third"])
    assert edited.count(b"calib: calibrated origins") == 1
    assert b"third" in edited
    assert b"first" not in edited


# ---------------------------------------------------------------- round trips


@pytest.mark.quick(1)
@pytest.mark.parametrize("values", ["calibrated", "nominal"])
def test_export_load_export_is_identical(values: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    robot = request.getfixturevalue(values)
    before = robot.positions(robot.home)
    export(robot, tmp_path / "robot.yaml", "toolbox")
    loaded = calib.load(tmp_path / "robot.yaml")
    assert plain(urdf_bytes(loaded)) == urdf_bytes(robot)
    for file_format in ("toolbox", "mjcf", "drake"):
        first, two = tmp_path / "one" / "robot.yaml", tmp_path / "two" / "robot.yaml"
        for path, source in ((first, robot), (two, loaded)):
            path.parent.mkdir(exist_ok=True)
            export(source, path, file_format)
        if file_format == "toolbox":
            assert yaml.safe_load(first.read_text()) == yaml.safe_load(two.read_text())
        else:
            assert without_comments(first.read_bytes()) == without_comments(two.read_bytes())
    assert np.array_equal(robot.positions(robot.home), before)  # exporting leaves the robot as it was


def test_a_found_base_and_target_are_in_the_exported_description(tmp_path: Path) -> None:
    shutil.copy(URDF, tmp_path / "arm.urdf")
    content = yaml.safe_load(ROBOT.read_text()) | {
        "urdf": "arm.urdf",
        "base": {"frame": "world", "pose": "unknown"},
        "targets": {"tool": {"frame": "tool", "position": "unknown"}},
        "parametrisation": [{"origin": "all", "components": ["x", "y", "z"], "sigma": "2 mm"}],
    }
    del content["held"], content["elimination_order"]
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(content))
    robot = calib.load(tmp_path / "arm.yaml")
    placed = robot.with_parameters({"base.x": 0.3, "base.rz": 0.4, "base.rx": -0.2, "tool.y": 0.05})
    export(placed, tmp_path / "robot.yaml", "toolbox")
    q = target_workspace().q[:3]
    assert np.abs(calib.load(tmp_path / "robot.yaml").positions(q) - placed.positions(q)).max() < 1e-12


# ---------------------------------------------------------------- MJCF and Drake


def test_mjcf_bodies_stand_at_the_assembled_home(calibrated: calib.Robot) -> None:
    """Body poses multiplied up from the XML, against Pinocchio on the calibrated URDF at the closed form's home."""
    closed = forward(calibrated.home[None], table1().actual)
    values = dict(zip((*ACTUATED_JOINTS, *PASSIVE_JOINTS), (*calibrated.home, *closed.passive[0]), strict=True))
    model = pin.buildModelFromXML(urdf_bytes(calibrated).decode())
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array([values[name] for name in model.names[1:]]))
    root = ElementTree.fromstring(mjcf(closed_model(calibrated)).content)
    by_name = {}

    def walk(element: ElementTree.Element, pose: pin.SE3) -> None:
        for body in element.iterfind("body"):
            w, x, y, z = map(float, body.get("quat", "1 0 0 0").split())
            place = np.array(body.get("pos", "0 0 0").split(), dtype=float)
            by_name[body.get("name")] = pose * pin.SE3(pin.Quaternion(w, x, y, z), place)
            walk(body, by_name[body.get("name")])

    walk(root.find("worldbody"), pin.SE3.Identity())
    links = set(calibrated.urdf.links)
    assert set(by_name) == links - {"world"} | {"world_link", "measurement_frame", "target_tool"}
    for link in links - {"world"}:
        expected = data.oMf[model.getFrameId(link, pin.FrameType.BODY)]
        assert np.abs(by_name[link].homogeneous - expected.homogeneous).max() < 1e-12, link
    refs = {joint.get("name"): float(joint.get("ref")) for joint in root.iter("joint")}
    assert refs == pytest.approx(values, abs=1e-12)


def test_mjcf_has_a_servo_for_each_motor_and_a_connect_for_each_loop(nominal: calib.Robot) -> None:
    root = ElementTree.fromstring(mjcf(closed_model(nominal)).content)
    assert [servo.get("joint") for servo in root.find("actuator")] == list(nominal.joint_names)
    assert [(tie.get("body1"), tie.get("body2")) for tie in root.find("equality")] == [
        ("distal_B1", "distal_D1"),
        ("distal_B2", "distal_D2"),
        ("distal_D2", "G2_slide"),
    ]


def test_drake_urdf_is_the_calibrated_urdf_plus_one_block(calibrated: calib.Robot, tmp_path: Path) -> None:
    export(calibrated, tmp_path / "out.urdf", "drake")
    written, before = read_plain(tmp_path / "out.urdf"), urdf_bytes(calibrated)
    start = written.index(b"\n<!-- calib: a closed robot for Drake")
    end = written.index(b"</robot>")
    namespace = b' xmlns:drake="http://drake.mit.edu"'
    assert written.count(namespace) == 1
    assert (written[:start] + written[end:]).replace(namespace, b"") == before
    assert written[start:end].count(b"<drake:ball_constraint>") == 3
    assert written[start:end].count(b"<transmission ") == 6
    assert [j.name for j in parse_urdf(written).joints] == [j.name for j in calibrated.urdf.joints]


# ---------------------------------------------------------------- the command


@pytest.mark.amount(3, 99)
def test_command_writes_every_format(tmp_path: Path, amount: int) -> None:
    """Few: each format has tests of what it holds."""
    ours = sorted((item for item in formats() if item not in (*NOT_OURS, JOINT_TABLES)), key="toolbox".__ne__)
    for file_format in ours[:amount]:
        result = run(ROBOT, "--format", file_format, "--out", tmp_path / f"{file_format}.yaml")
        assert result.exit_code == 0, result.output
        assert (tmp_path / f"{file_format}.yaml").stat().st_size > 500
    assert read_plain(tmp_path / "toolbox.urdf") == URDF.read_bytes()


def test_command_reads_a_parameter_file(tmp_path: Path) -> None:
    (tmp_path / "values.csv").write_text("parameter,value,unit\nL11,410,mm\n")
    result = run(ROBOT, "--parameters", tmp_path / "values.csv", "--format", "urdf", "--provenance", "--out",
                 tmp_path / "out.urdf")  # fmt: skip
    assert result.exit_code == 0, result.output
    text = (tmp_path / "out.urdf").read_text()
    assert 'xyz="0 0.41 0"' in text
    assert "L11: 400 -> 410 mm" in text
    assert "values.csv" in text


def test_command_prints_the_gaps_as_json(tmp_path: Path) -> None:
    result = run(ROBOT, "--format", "mjcf", "--json", "-", "--out", tmp_path / "out.xml")
    assert result.exit_code == 0, result.output
    gaps = json.loads(result.output)["gaps"]
    assert [(gap["name"], gap["direction"], gap["unit"]) for gap in gaps] == [
        ("E1_B-E1_D", "x", "m"),
        ("E2_B-E2_D", "x", "m"),
    ]
    assert all(abs(gap["at_home"]) + gap["change"] < 1e-12 for gap in gaps)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--format", "urdf", "--out", "robot.urdf"), "robot.urdf: is read by this command"),
        (("--format", "toolbox", "--out", "robot.yaml"), "robot.yaml: is read by this command"),
        (("--format", "toolbox", "--out", "x.urdf"), "name the YAML file"),
        (("--format", "urdf", "--free-slide", "--out", "x.urdf"), "has no variant with free slides"),
        (("--format", "mjcf", "--out", "no/such/folder/x.xml"), "cannot be written"),
        (("--format", "dh", "--out", "x.csv"), "follows other joints; this format holds chains"),
        (("--format", "ur-kinematics", "--out", "x.yaml"), "follows other joints; this format holds chains"),
        (("--format", "mjcf", "--meshes", "package://a", "--out", "x.xml"), "has no mesh paths to change"),
        (("--format", "toolbox", "--out", "."), "cannot be written"),
        (("--format", "mjfc", "--out", "x.xml"), "'mjfc' is not one of"),
    ],
)  # fmt: skip
def test_wrong_use_is_one_line_and_exit_code_2(
    arguments: tuple[str, ...], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(URDF, "robot.urdf")
    Path("robot.yaml").write_text(ROBOT.read_text().replace("urdf: medrue.urdf", "urdf: robot.urdf"))
    before = sorted(tmp_path.rglob("*"))
    result = run("robot.yaml", *arguments)
    assert result.exit_code == 2
    assert words in result.output
    assert sorted(tmp_path.rglob("*")) == before
    assert Path("robot.urdf").read_bytes() == URDF.read_bytes()


def test_unknown_format_from_python_names_the_nearest(nominal: calib.Robot, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown; did you mean 'mjcf'"):
        export(nominal, tmp_path / "x", "mjfc")
