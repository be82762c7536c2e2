"""Files of strangers: names that nobody sees, aliases without bound, expressions that read, leak or never end."""

import ast
import re

import pytest

import calib
from calib.core.base.errors import CalibrationError, InputError
from calib.core.base.letters import brief, unseen, visible
from calib.core.base.sections import parse_yaml
from calib.photographs.camera_files import read_camera
from tests.project import ROOT
from tests.small_robots import ARM_URDF, ARM_YAML, write_arm
from tests.whole.test_bad_input import DATA, FIT, PREDICT, folder, refused  # noqa: F401

LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{letter}: &{letter} [{', '.join([f'*{before}'] * 9)}]\n"
    for before, letter in zip("abcdefghi", "bcdefghij", strict=True)
)
MERGES = "a: &a {k: 1}\n" + "".join(
    f"{letter}: &{letter} {{<<: [{', '.join([f'*{before}'] * 9)}]}}\n"
    for before, letter in zip("abcdefghi", "bcdefghij", strict=True)
)
BOARD = "detect photos --board b.yaml --camera c.yaml --out new.csv"


@pytest.mark.parametrize("text", [LAUGHS, MERGES], ids=["lists", "merged"])
def test_aliases_without_bound_are_refused_wherever_yaml_is_read(folder, refused, text):  # noqa: F811
    for name, command in (
        ("arm.yaml", PREDICT),
        ("b.yaml", "board --board b.yaml --out new.svg"),
    ):
        before = (folder / name).read_text() if (folder / name).is_file() else None
        (folder / name).write_text(text)
        line = refused(command)
        assert "aliases (*NAME) expand to more than 10000" in line
        if before is not None:
            (folder / name).write_text(before)
    (folder / "c.yaml").write_text(text)
    with pytest.raises(InputError, match=r"aliases \(\*NAME\) expand to more than 10000"):
        read_camera(folder / "c.yaml")


def test_a_key_of_a_camera_that_is_a_number_is_a_key(tmp_path):
    (tmp_path / "c.yaml").write_text("1: 2\nfx: 1000\nfy: 1000\ncx: 500\ncy: 400\n")
    assert read_camera(tmp_path / "c.yaml").intrinsics[0] == 1000
    (tmp_path / "c.yaml").write_text(f"fx: {10**400}\nfy: 1000\ncx: 500\ncy: 400\n")
    with pytest.raises(InputError, match="holds something that is not a number"):
        read_camera(tmp_path / "c.yaml")


def test_aliases_that_say_the_same_twice_are_read():
    assert parse_yaml("a: &a [1, 2]\nb: *a\nc: {<<: {d: 3}}\n", "x.yaml") == {"a": [1, 2], "b": [1, 2], "c": {"d": 3}}
    with pytest.raises(InputError, match=r"x\.yaml, line 1: not valid YAML \(an entry contains itself by an alias"):
        parse_yaml("a: &a [*a]\n", "x.yaml")


def test_yaml_is_read_in_one_place():
    readers = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for package in ("calib", "viz", "medrue")
        for path in sorted((ROOT / package).rglob("*.py"))
        if "yaml." in path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and re.fullmatch(r"yaml\.(\w+_)?load(_\w+)?", ast.unparse(node))
    ]
    assert [reader.partition(":")[0] for reader in readers] == ["calib/core/base/sections.py"]


@pytest.mark.parametrize("letter", ["\n", "\t", "\x1b", "\x7f", "\u202e", "\u200b", "\u2028", "\ufeff"])
def test_a_name_with_a_letter_that_nobody_sees_is_refused(folder, refused, letter):  # noqa: F811
    spelt = letter.encode("unicode_escape").decode()
    in_xml = f"&#{ord(letter)};" if ord(letter) > 31 or letter in "\n\t" else None
    for kind in ("joint", "link") if in_xml else ():
        name = {"joint": "slide", "link": "hand"}[kind]
        (folder / "arm.urdf").write_text(ARM_URDF.replace(f'"{name}"', f'"{name}{in_xml}"'))
        assert f"holds {spelt}, which nobody sees" in refused(PREDICT)
    (folder / "arm.urdf").write_text(ARM_URDF)
    in_yaml = f'"ti{spelt if ord(letter) < 256 else chr(92) + f"u{ord(letter):04x}"}p"'
    (folder / "arm.yaml").write_text(re.sub(r"\btip\b", lambda _: in_yaml, ARM_YAML))
    line = refused(PREDICT)
    assert f"holds {spelt}, which nobody sees" in line
    assert "arm.yaml, line" in line
    (folder / "arm.yaml").write_text(ARM_YAML)
    if letter != "\n":  # a line of a table ends there
        head, first, *rest = DATA.splitlines(keepends=True)
        (folder / "data.csv").write_text(
            "".join([f"pose,{head}", f"P{letter}1,{first}", *(f"Q,{row}" for row in rest)])
        )
        assert f"line 2, column 'pose': 'P{spelt}1' holds {spelt}" in refused(PREDICT)


def test_names_given_in_python_are_names_too(tmp_path):
    robot = calib.load(write_arm(tmp_path))
    with pytest.raises(InputError, match=r"names: 'P\\n1' holds \\n, which nobody sees"):
        calib.as_measurements(robot, [[0.0, 0.1, 0.2]], [[[0.3, 0.0, 0.6]]], names=["P\n1"])


def test_letters_of_many_languages_are_names():
    assert [unseen(name) for name in ("garçon", "関節 1", "\u0661", "\U0001f916", "P 1", "a-b_c.d/e")] == [""] * 6


def test_messages_and_comments_show_what_nobody_would_see(folder, run_calib):  # noqa: F811
    (folder / "data.csv").write_text("# from \u202eevil\x1b[31m\n" + DATA)
    done = run_calib(*f"{FIT} --no-pages".split(), cwd=folder)
    assert not re.search("[\u202e\x1b]", done.out + done.err)
    done = run_calib("predict", "arm.yaml", "no\u202e\x1b.csv", "--out", "new.csv", cwd=folder)
    assert (done.code, done.err) == (2, "calib: no\\u202e\\x1b.csv: no such file; give a CSV file\n")
    for file in folder.rglob("*"):
        if file.is_file() and file.name != "data.csv" and file.suffix != ".npz":
            assert not re.search("[\u202e\x1b]", file.read_bytes().decode("utf-8", "replace")), file


@pytest.mark.parametrize("token", ["9" * 50_000 + "x", "word " * 10_000], ids=["word", "words"])
def test_a_message_quotes_no_more_than_a_person_reads(folder, refused, token):  # noqa: F811
    (folder / "arm.urdf").write_text(ARM_URDF.replace("0.25 0 0", token))
    line = refused(PREDICT)
    assert len(line) < 5000
    assert "joint 'slide', xyz" in line
    assert ("further characters" in line) == (" " not in token)


def test_every_error_is_short_and_pickles():
    error = CalibrationError(f"a.csv: '{'x' * 1000}' \x1b[0m is wrong")
    assert str(error) == f"a.csv: '{'x' * 59}... (882 further characters) ...{'x' * 59}' \\x1b[0m is wrong"
    assert brief(str(error)) == visible(str(error)) == str(error)


def test_limits_beyond_every_robot_are_none(folder, run_calib):  # noqa: F811
    wide = re.sub(r'lower="[^"]*" upper="[^"]*"', 'lower="-1e308" upper="1e308"', ARM_URDF)
    (folder / "arm.urdf").write_text(wide)
    assert wide != ARM_URDF
    done = run_calib("check", "arm.yaml", "--poses", "8", cwd=folder)
    assert "defect" not in done.err + done.out
    assert "Warning" not in done.err


XACRO = (
    '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{}<link name="a"/><link name="b"/>'
    '<joint name="j" type="revolute"><parent link="a"/><child link="b"/><limit lower="-1" upper="1" effort="1"'
    ' velocity="1"/></joint></robot>'
)


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    ("inside", "message"),
    [
        ('<link name="${unknown_word}"/>', "it has no value or meaning for 'unknown_word'"),
        ("<link name=\"${xacro.load_yaml('/etc/passwd')}\"/>", "it reads a file outside of its package"),
        ("<link name=\"${xacro.load_yaml('../../secret.yaml')['key']}\"/>", "it reads a file outside of its package"),
        ('<xacro:include filename="/etc/passwd"/>', "it reads a file outside of its package"),
        ('<link name="$(env SECRET)"/>', "it needs an environment variable"),
        ('<link name="$(optenv PATH /)$(optenv PYTHONPATH /)$(optenv SECRET none)"/>', "several root links: //none, a"),
        ("<link name=\"${len('a' * 10**10)}\"/>", "it takes more than 2 GB of memory"),
    ],
)
def test_a_xacro_file_neither_reads_nor_says_what_is_not_its_own(tmp_path, monkeypatch, inside, message):
    pytest.importorskip("xacro")
    monkeypatch.setenv("SECRET", "hidden")
    (tmp_path / "secret.yaml").write_text("key: hidden\n")
    (tmp_path / "arm" / "urdf").mkdir(parents=True)
    (tmp_path / "arm" / "package.xml").write_text("<package/>")
    (tmp_path / "arm" / "urdf" / "arm.xacro").write_text(XACRO.format(inside))
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        calib.load(tmp_path / "arm" / "urdf" / "arm.xacro")
    assert not re.search("hidden|root:|Exception|Error", str(caught.value))


def test_a_xacro_file_reads_the_files_of_its_package(tmp_path):
    pytest.importorskip("xacro")
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "names.yaml").write_text("flange: tip\n")
    (tmp_path / "urdf").mkdir()
    inside = (
        '<xacro:property name="names" value="${xacro.load_yaml(\'../config/names.yaml\')}"/>'
        '<link name="${names[\'flange\']}"/><joint name="f" type="fixed"><parent link="b"/>'
        "<child link=\"${names['flange']}\"/></joint>"
    )
    (tmp_path / "urdf" / "arm.xacro").write_text(XACRO.format(inside))
    assert calib.load(tmp_path / "urdf" / "arm.xacro").urdf.links == ("tip", "a", "b")


def test_a_file_of_macros_is_a_part_of_a_robot(tmp_path):
    pytest.importorskip("xacro")
    macro = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="arm" params="prefix"/></robot>'
    (tmp_path / "arm_macro.xacro").write_text(macro)
    (tmp_path / "arm.xml").write_text("<mujocoinclude/>")
    for name in ("arm_macro.xacro", "arm.xml"):
        with pytest.raises(InputError, match=r"part of a robot.*give the file that includes it"):
            calib.load(tmp_path / name)


def test_a_xacro_file_that_does_not_end_is_stopped(tmp_path, monkeypatch):
    pytest.importorskip("xacro")
    monkeypatch.setattr("calib.files.xacro_files._SECONDS", 1)
    (tmp_path / "arm.xacro").write_text(XACRO.format('<link name="${9**9**9}"/>'))
    with pytest.raises(InputError, match="does not end within 1 s"):
        calib.load(tmp_path / "arm.xacro")
