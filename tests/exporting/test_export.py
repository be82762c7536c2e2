"""What `calib export` writes, as text: what changes, what does not, and the way round through loading."""

import json
import re
import shutil
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

import calib
from calib.core.base.errors import InputError
from calib.core.results.urdf import urdf_bytes
from calib.core.robots.urdf.text import parse_urdf
from calib.exporting.closed_model import closed_model
from calib.exporting.formats import export
from calib.exporting.mjcf import Mjcf
from medrue.closed_form import ACTUATED_JOINTS, PASSIVE_JOINTS, forward
from medrue.paper_tables import table1
from tests.project import EXAMPLES, ROOT, copied
from tests.signed_files import plain, read_plain

ROBOT = ROOT / "urdf" / "medrue.yaml"
URDF = ROOT / "urdf" / "medrue.urdf"


@pytest.fixture(scope="module")
def calibrated(medrue: calib.Robot) -> calib.Robot:
    return medrue.with_parameters(table1().actual)


def without_comments(xml: bytes) -> bytes:
    return re.sub(rb"<!--.*?-->\n?", b"", xml, flags=re.DOTALL)


# ---------------------------------------------------------------- URDF


def test_nominal_urdf_goes_out_byte_for_byte(medrue: calib.Robot, tmp_path: Path) -> None:
    export(medrue, tmp_path / "out.urdf", "urdf", provenance=["not needed: nothing was edited"])
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
@pytest.mark.parametrize("values", ["calibrated", "medrue"])
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


def test_a_found_base_and_target_are_in_the_exported_description(robot: calib.Robot, tmp_path: Path) -> None:
    placed = robot.with_parameters({"base.x": 0.3, "base.rz": 0.4, "base.rx": -0.2, "reflector.y": 0.05})
    export(placed, tmp_path / "robot.yaml", "toolbox")
    q = robot.sample(3, 1)
    assert np.abs(calib.load(tmp_path / "robot.yaml").positions(q) - placed.positions(q)).max() < 1e-12


# ---------------------------------------------------------------- MJCF and Drake


def test_mjcf_joints_stand_at_the_assembled_home(calibrated: calib.Robot) -> None:
    """By the closed form; tests/interop looks at where the bodies are."""
    closed = forward(calibrated.home[None], table1().actual)
    values = dict(zip((*ACTUATED_JOINTS, *PASSIVE_JOINTS), (*calibrated.home, *closed.passive[0]), strict=True))
    root = ElementTree.fromstring(Mjcf(closed_model(calibrated)).content)
    refs = {joint.get("name"): float(joint.get("ref")) for joint in root.iter("joint")}
    assert refs == pytest.approx(values, abs=1e-12)


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


def test_command_reads_a_parameter_file(tmp_path: Path, run_calib) -> None:
    (tmp_path / "values.csv").write_text("parameter,value,unit\nL11,410,mm\n")
    arguments = ("--parameters", "values.csv", "--format", "urdf", "--provenance", "--out", "out.urdf")
    assert run_calib("export", ROBOT, *arguments, cwd=tmp_path).code == 0
    text = (tmp_path / "out.urdf").read_text()
    assert 'xyz="0 0.41 0"' in text
    assert "L11: 400 -> 410 mm" in text
    assert "values.csv" in text


def test_a_header_counts_poses_and_rows(tmp_path: Path, run_calib) -> None:
    arm = calib.load(EXAMPLES / "arm.yaml")
    data = calib.read_measurements(EXAMPLES / "arm_simulated.csv", arm)
    calib.fit(arm, data).save(tmp_path / "arm", pages=False)
    assert run_calib("export", tmp_path / "arm", "--format", "c", "--out", tmp_path / "arm.c").code == 0
    assert f"fitted to {len(data)} poses, {len(data)} rows; noise found: 0.0" in (tmp_path / "arm.c").read_text()


def test_command_prints_the_gaps_as_json(tmp_path: Path, run_calib) -> None:
    result = run_calib("export", ROBOT, "--format", "mjcf", "--json", "-", "--out", tmp_path / "out.xml")
    gaps = json.loads(result.out)["gaps"]
    assert [gap["name"] for gap in gaps] == ["E1_B-E1_D", "E2_B-E2_D"]
    assert {(gap["direction"], gap["unit"]) for gap in gaps} == {("x", "m")}
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
def test_wrong_use_is_one_line_and_exit_code_2(arguments, words, tmp_path: Path, run_calib) -> None:
    shutil.copy(URDF, tmp_path / "robot.urdf")
    copied(tmp_path, ROBOT, (f"urdf: {URDF}", "urdf: robot.urdf")).rename(tmp_path / "robot.yaml")
    before = sorted(tmp_path.rglob("*"))
    assert words in run_calib("export", "robot.yaml", *arguments, cwd=tmp_path).refusal()
    assert sorted(tmp_path.rglob("*")) == before
    assert (tmp_path / "robot.urdf").read_bytes() == URDF.read_bytes()


def test_unknown_format_from_python_names_the_nearest(medrue: calib.Robot, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown; did you mean 'mjcf'"):
        export(medrue, tmp_path / "x", "mjfc")
