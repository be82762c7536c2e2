"""Programs of controllers: the true robot does what they mean, only their numbers change, and the rest is named."""

import difflib
import json
import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from click.testing import CliRunner

import calib
from calib.core.base.errors import CalibrationError
from calib.programs.commands.compensate import command
from calib.programs.languages.controller_program import compensate_program
from calib.programs.languages.languages import read_program
from calib.programs.languages.robot_program import numbers_of, pose_of
from tests.programs import controller_programs as programs
from tests.programs.test_program_reading import AXES, LS_POSITION
from tests.six_axis_arm import write_six_axis

YAML = """\
urdf: arm.urdf
name_mot: [j1, j2, j3, j4, j5, j6]
base: {frame: l0}
home: {j3: 0.5, j5: 0.8}
targets:
  a: {frame: l6, xyz: [50 mm, 20 mm, 100 mm]}
  b: {frame: l6, xyz: [50 mm, 120 mm, 0 mm]}
  c: {frame: l6, xyz: [150 mm, 20 mm, 0 mm]}
parametrisation:
  - {origin: all, components: [x, y, z], sigma: 1 mm}
  - {origin: all, components: [rx, ry, rz], sigma: 2 mrad}
sigma: 0.02 mm
"""
Q = programs.rows(5)


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """A simulated true arm, and the calibration from 30 measured poses."""
    folder = tmp_path_factory.mktemp("cell")
    robot, rng = calib.load(write_six_axis(folder, YAML)), np.random.default_rng(0)
    true = robot.with_parameters([p.nominal_si + p.sigma_si * rng.standard_normal() for p in robot.parameters])
    q = rng.uniform(-1.2, 1.2, (30, 6))
    fit = calib.fit(robot, calib.as_measurements(robot, q, true.positions(q) + 2e-5 * rng.standard_normal((30, 3, 3))))
    fit.save(folder / "out", pages=False)
    (folder / "frames.csv").write_text(programs.frames_table())
    return folder, robot, true, fit


LANGUAGES = {
    "URScript": (".script", programs.urscript, {}),
    "RAPID": (".mod", programs.rapid, {}),
    "KRL": (".src", programs.krl, {}),
    "FANUC": (".ls", programs.fanuc, {"third_joint": "j2+j3"}),
}


def written(folder, suffix, make, q=Q):
    """The files of a program, by path and text."""
    made = make(q)
    texts = made if isinstance(made, tuple) else (made,)
    paths = [folder / f"part{item}" for item in ((suffix, ".dat") if len(texts) > 1 else (suffix,))]
    for path, text in zip(paths, texts, strict=True):
        path.write_bytes(text.encode())
    return paths, texts


@pytest.mark.quick(0)
@pytest.mark.parametrize("language", LANGUAGES)
def test_the_true_robot_goes_where_the_program_means_and_only_numbers_of_targets_differ(cell, language):
    folder, robot, true, fit = cell
    suffix, make, options = LANGUAGES[language]
    paths, before = written(folder, suffix, make)
    program = read_program(paths[0], [folder / "frames.csv"] if language == "FANUC" else [])
    result = compensate_program(fit, program, **options)
    assert not any(result.reasons)
    after = [content.decode() for content in result.files()]

    def errors(texts):
        went, rows = programs.run(language, texts, Q)
        meant, did = (item.forward(q, "l6") @ programs.TOOL for item, q in ((robot, Q[rows]), (true, went)))
        return np.linalg.norm((meant - did)[:, :3, 3], axis=1)

    assert errors(before).max() > 3e-3
    assert errors(after).max() < 6e-5  # promised 0.011 mm and 0.065 mrad over 65 mm, and FANUC's three decimals
    numbers = re.compile(rf"[ ]*{programs.NUMBER}")
    for old, new in zip(before, after, strict=True):
        assert numbers.sub("#", old) == numbers.sub("#", new)
        changed = [line for line in difflib.ndiff(old.split("\n"), new.split("\n")) if line[0] == "-"]
        assert all(
            re.search(r"joints_|point_|pose_trans|target [pj]\d|X[PA]\d|LIN \{X|[XW] =|J[14]=", x) for x in changed
        )
        assert len(old.split("\n")) == len(new.split("\n"))
    if language == "FANUC":
        assert all(len(a) == len(b) for a, b in zip(before[0].split("\n"), after[0].split("\n"), strict=True))


def test_letters_that_count_from_a_home_with_a_straight_wrist_mean_nothing(tmp_path):
    """By the sign of joint 5, which is neither N nor F at zero."""
    robot = calib.load(write_six_axis(tmp_path, YAML.replace("j5: 0.8", "j5: 0")))
    (tmp_path / "part.ls").write_text(LS)
    result = compensate_program(robot, read_program(tmp_path / "part.ls"), third_joint="j3")
    assert result.values[1] is None
    assert "'N U T, 0, 0, 0', whose sides count from home" in result.reasons[1]


@pytest.mark.parametrize(
    ("language", "left"),
    [
        ("URScript", [(40, "pose_add")]),
        ("RAPID", [(34, "it moves along with p0"), (35, "pHome: is not declared")]),
        ("KRL", [(36, "is relative to where the robot is"), (37, "computed at run time")]),
        ("FANUC", [(17, "position register"), (18, "computed at run time (Offset)")]),
    ],
)
def test_what_is_worked_out_at_run_time_is_listed_with_its_line(cell, language, left):
    suffix, make, _ = LANGUAGES[language]
    paths, texts = written(cell[0], suffix, make)
    program = read_program(paths[0], [cell[0] / "frames.csv"])
    assert len(program.left_out) == len(left)
    lines = texts[0].split("\n")
    for place, (_, why) in zip(program.left_out, left, strict=True):
        assert why in str(place)
        assert place.text[:8] in lines[place.line - 1]


def test_a_joint_that_leaves_its_configuration_is_named_with_its_line(cell):
    folder, *_, fit = cell
    q = np.array([[-2e-5, 0.1, 0.6, 0.3, 0.8, 0.2], [0.4, 0.1, 0.6, 0.3, 0.8, 0.2]])
    result = compensate_program(fit, read_program(written(folder, ".mod", programs.rapid, q)[0][0]))
    crossed = result.compensation.q[0, 0] > 0 or result.compensation.q[1, 0] > 0
    assert crossed
    assert [
        remark
        for remark in result.configurations
        if "(p0): its configuration ([-1,0,0,0]) is unchanged" in remark and "j1 at" in remark
    ]
    assert len(result.configurations) == 1


@pytest.mark.quick(0)
def test_the_branch_is_the_one_that_the_program_says(cell):
    """The wrist flipped over, axis 4 half a turn on: the same pose, and another robot there."""
    folder, *_, fit = cell
    q = Q[:1]
    other = q + np.array([0, 0, 0, np.pi, 0, np.pi])
    other[:, 4] *= -1
    other = (other + np.pi) % (2 * np.pi) - np.pi
    assert np.allclose(programs.flange(q[0]), programs.flange(other[0]))
    for suffix, make in ((".mod", programs.rapid), (".src", programs.krl), (".ls", programs.fanuc)):
        for meant in (q, other):
            if np.abs(meant).max() > 3:  # the limits of the arm
                continue
            program = read_program(written(folder, suffix, make, meant)[0][0], [folder / "frames.csv"])
            result = compensate_program(fit, program, third_joint="j2+j3")
            assert np.abs(result.compensation.program - meant).max() < 1e-4


def test_numbers_of_orientations_stay_the_same_turn_and_near():
    rng = np.random.default_rng(3)
    for kind, count in (("vector", 3), ("quaternion", 4), ("zyx", 3), ("xyz", 3)):
        for _ in range(20):
            turned = rng.uniform(-np.pi, np.pi, count)
            turned = turned / np.linalg.norm(turned) if kind == "quaternion" else turned
            values = (*rng.standard_normal(3), *turned)
            pose = pose_of(values, kind)
            back = numbers_of(pose, kind, values)
            assert np.allclose(back, values, atol=1e-9)
            moved = pin.SE3(pose.rotation @ pin.exp3(1e-4 * rng.standard_normal(3)), pose.translation)
            assert np.allclose(pose_of(numbers_of(moved, kind, values), kind).homogeneous, moved.homogeneous)


@pytest.mark.parametrize(("start", "said"), [("", [True]), ("movej([0,0.1,0.5,0,0.8,0])\n", [])])
def test_a_program_that_begins_on_an_unstated_branch_is_told(cell, tmp_path, start, said):
    pose = "p[0.6,0,0.5,0,1.4,0]"
    (tmp_path / "p.script").write_text(f"def m():\nset_tcp(p[0,0,0.1,0,0,0])\n{start}movel({pose})\nend\n")
    remarks = compensate_program(cell[3], read_program(tmp_path / "p.script")).configurations
    assert ["line 3 is the first target, and states no joints" in remark for remark in remarks] == said


@pytest.mark.quick(0)
def test_the_command_writes_the_program_and_tells_what_holds(cell, tmp_path, monkeypatch):
    folder = cell[0]
    src, dat = programs.krl(Q[:3])
    (tmp_path / "p.src").write_text(src)
    (tmp_path / "p.dat").write_text(dat)
    arguments = [str(folder / "out"), str(tmp_path / "p.src"), "--out", str(tmp_path / "new.src")]
    done = CliRunner().invoke(command, [*arguments, "--json", str(tmp_path / "new.json")])
    assert done.exit_code == 0, done.output
    assert "7 of 7 targets compensated (pose kept)" in done.stdout
    assert "tool tips are up to 64.8 mm from" in done.stdout
    assert "At the targets the tool is expected to be off by" in done.stdout
    assert "Between distant targets it is off by more" in done.stdout
    assert "Poses are from link 'l0' to link 'l6'" in done.stdout
    assert "not compensated" in done.stderr
    content = json.loads((tmp_path / "new.json").read_text())
    assert content["n_compensated"] == 7
    assert content["expected_mm"]["rms"] < 0.02 < 1 < content["before_mm"]["rms"]
    assert [item["line"] for item in content["not_compensated"]] == [len(src.split("\n")) - 3, len(src.split("\n")) - 2]
    assert (tmp_path / "new.src").read_text().count("\n") == src.count("\n")
    assert (tmp_path / "new.dat").read_text().startswith("&ACCESS RVP\nDEFDAT")
    twice = [str(folder / "out"), str(tmp_path / "new.src"), "--out", str(tmp_path / "newer.src")]
    assert "if it is compensated already, give the one it came from" in CliRunner().invoke(command, twice).stderr
    assert "compensated already" not in done.stderr
    again = CliRunner().invoke(command, arguments)  # its own files may be replaced, those of others not
    assert again.exit_code == 0, again.output
    (tmp_path / "new.dat").write_text("mine")
    for refused in (arguments, [*arguments[:-1], str(tmp_path / "p.src")]):
        done = CliRunner().invoke(command, refused)
        assert done.exit_code == 2, done.output
    assert (tmp_path / "new.dat").read_text() == "mine"
    assert (tmp_path / "p.src").read_text() == src


UR = (
    "def p():\n  set_tcp(p[0,0,0.1,0,0,0])\n  a = [0,0.1,0.5,0,0.8,0]\n  movej(a)\n  movel(p[0.6,0,0.5,0,1.4,0])\nend\n"
)
ABB = (
    "MODULE m\nPERS tooldata t:=[TRUE,[[0,0,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
    'PERS wobjdata w:=[FALSE,TRUE,"",[[0,0,0],[1,0,0,0]],[[0,0,0],[1,0,0,0]]];\n'
    f"CONST robtarget p:=[[600,0,500],[0.7648,0,0.6442,0],[0,0,0,0],{AXES}];\n"
    f"CONST jointtarget j:=[[0,5,30,0,45,0],{AXES}];\n"
    "PROC main()\nMoveAbsJ j,v100,fine,t;\nMoveL p,v100,fine,t\\WObj:=w;\nENDPROC\nENDMODULE\n"
)
KUKA = (
    "DEF p()\n$TOOL={X 0,Y 0,Z 100,A 0,B 0,C 0}\n$BASE=$NULLFRAME\nPTP {A1 0,A2 5,A3 30,A4 0,A5 45,A6 0}\n"
    "LIN {X 600,Y 0,Z 500,A 0,B 80,C 0,S 2,T 0}\nEND\n"
)
LS = (
    "/PROG P\n/MN\n   1:J P[1] 100% FINE ;\n   2:L P[2] 100mm/sec FINE ;\n/POS\nP[1]{\n   GP1:\n\tUF : 0, UT : 0,\n"
    "\tJ1= 0.000 deg,\tJ2= 5.000 deg,\tJ3= 30.000 deg,\n\tJ4= 0.000 deg,\tJ5= 45.000 deg,\tJ6= 0.000 deg\n};\n"
    + LS_POSITION.format(2, 0) + "/END\n"
)  # fmt: skip
# what is put in the place of what, and a part of what is said of it: in an error, or of what is left out
BAD = {
    ".script": (
        UR,
        [
            (UR, "", "has no targets"),
            (UR, "\x00\x01", "line 1: is not text"),
            (
                "movej(a)\n  movel(p[0.6,0,0.5,0,1.4,0])",
                "b=p[0.6,0,0.5,0,1.4,0]\nmovel(b)\nset_tcp(p[0,0,0.2,0,0,0])\nmovel(b)",
                "line 7: b: is reached with different tools or frames",
            ),
            (UR, "G1 X5\n", "has no targets that can be compensated as URScript"),
            ("movej(a)", "movej(b)", "line 4: b: is not declared here"),
            ("movej(a)", "movej(a[0])", "line 4: a[0]: is computed at run time"),
            ("movej(a)", "a[0] = 1\n  movej(a)", "is set more than once"),
            ("movej(a)", "a = [0,0,0,0,0,0]\n  movej(a)", "is set more than once"),
            ("movej(a)", "movej([0,0,0,0,0])", "is computed at run time"),
            ("movej(a)", "movej([0,0,0,0,0,0,0])", "is computed at run time"),
            ("movej(a)", "movej([0,0,0,0,0,x])", "is computed at run time"),
            ("movej(a)", "movej([0,0,0,0,0,1.5.7])", "is computed at run time"),
            ("movej(a)", "movej([0,0,0,0,0,1e9])", "line 4: '1e9' is beyond what any machine reads"),
            ("movej(a)", "movej([0,0,0,0,0,pi/2])", "is computed at run time"),
            ("movej(a)", "movej(get_actual_joint_positions())", "is computed at run time"),
            ("movej(a)", "movej(get_inverse_kin(a))", "is computed at run time"),
            ("movej(a)", "movej(get_inverse_kin())", "is computed at run time"),
            ("movej(a)", "movel(pose_trans(get_forward_kin(), p[0,0,0,0,0,0]))", "its frame is not constant"),
            ("movej(a)", "movel(pose_trans(a, p[0,0,0,0,0,0]))", "its frame is not constant"),
            ("movej(a)", "movel(pose_add(p[0,0,0,0,0,0], p[0,0,0,0,0,0]))", "is computed at run time"),
            ("movej(a)", "speedl([0,0,0.1,0,0,0], 0.5, 1)", "speedl: moves the robot by an amount that it computes"),
            ("  set_tcp(p[0,0,0.1,0,0,0])\n", "", "no set_tcp before it selects a tool"),
            ("set_tcp(p[0,0,0.1,0,0,0])", "set_tcp(get_tcp())", "no set_tcp before it selects"),
            ("set_tcp(p[0,0,0.1,0,0,0])", "set_tcp([0,0,0.1,0,0,0])", "no set_tcp before it selects"),
            ("def p():", "def p(a):", "a: is given to a routine when it is called"),
            ("movej(a)", "movej(a # )", "line 4: movej(: has a bracket that is not closed"),
            ("movej(a)", "movec(a, q)", "q: is not declared here"),
            ("movej(a)", "servoj(q, t=0.008)", "q: is not declared here"),
            (
                "movej(a)",
                "w = p[0.6,0,0.5,0,1.4,0]\n  movel(pose_trans(w, p[0,0,0,0,0,0]), v=1)\n  movel(w)",
                "line 5: pose_trans(w, p[0,0,0,0,0,0]): moves along with w, a target that is its frame or tool",
            ),
        ],
    ),
    ".mod": (
        ABB,
        [
            (ABB, "", "has no targets"),
            (ABB, "\x00", "is not text"),
            (ABB, "def p():\nmovej([0,0,0,0,0,0])\n", "has no targets that can be compensated as RAPID"),
            ("MoveL p,", "MoveL q,", "q: is not declared here"),
            ("MoveL p,", "MoveL Offs(p,0,0,5),", "is computed at run time; it moves along with p"),
            ("MoveL p,", "MoveL RelTool(p,0,0,5),", "it moves along with p"),
            ("MoveL p,", "MoveL CRobT(),", "is computed at run time"),
            ("MoveL p,", "MoveL p{n},", "is not declared here"),
            ("MoveL p,", "p.trans.x:=5;\nMoveL p,", "p: is set while the program runs"),
            ("MoveL p,", "PDispOn p,t;\nMoveL p,", "a program displacement"),
            ("MoveL p,", "EOffsSet [0,0,0,0,0,0];\nMoveL p,", "an offset of axes"),
            ("MoveL p,v100,fine,t", "MoveL p,v100,fine,t2", "tool 't2' is not declared here; give its module"),
            ("WObj:=w", "WObj:=w2", "work object 'w2' is not declared here"),
            ("t:=[TRUE", "t:=[FALSE", "tool 't' is not on the robot"),
            ("w:=[FALSE", "w:=[TRUE", "the robot holds work object 'w'"),
            ("w:=[FALSE,TRUE", "w:=[FALSE,FALSE", "is moved by another unit"),
            ("t:=[TRUE,[[0,0,100]", "t:=[TRUE,[[0,0,h]", "'t' is not constant: 'h' is not a plain number"),
            ("MoveL p,", "t.tframe.trans.z:=5;\nMoveL p,", "'t' is set while the program runs"),
            ("[0.7648,", "[0.9,", "line 4: the quaternion has length 1.10"),
            ("[600,0,500]", "[600,0]", "line 4: a position has 2 numbers; expected 3"),
            ("[600,0,500]", "[600,0,x]", "'x' is not a plain number"),
            ("[600,0,500]", "[600,0,5E7]", "'5E7' is beyond what any machine reads"),
            ("[0,0,0,0],[9E9,", "[0,0,0,0],[100,", "moves external axes"),
            (f"[0,0,0,0],{AXES}]", "[0,0,0,0]]", "robtarget 'p' is not complete"),
            ("45,0]", "45]", "robax has 5 numbers; expected 6"),
            ("MoveL p,", "SearchL di1,p,p,", "is where a search ends"),
            (
                "MoveL p,",
                f"CONST robtarget ps{{1}}:=[[[1,2,3],[1,0,0,0],[0,0,0,0],{AXES}]];\nMoveL ps{{n}},",
                "ps{n}: is chosen at run time",
            ),
            ("MoveL p,", "CONST robtarget p:=[[1,2,3],[1,0,0,0]];\nMoveL p,", "p: is declared in several places"),
            ("PROC main()", "PROC main(robtarget p,num n)", "p: is given to a routine when it is called"),
            ("PROC main()", "PROC main(INOUT tooldata t)", "'t' is given to a routine"),
        ],
    ),
    ".src": (
        KUKA,
        [
            (KUKA, "", "has no targets"),
            (KUKA, "\x02", "is not text"),
            (KUKA, "DEF p()\nPTP_REL {A1 5}\nEND\n", "is relative to where the robot is"),
            ("LIN {X 600,", "LIN XP1 ; {X 600,", "XP1: is not declared here"),
            ("LIN {X 600,Y 0", "LIN {X 600", "gives only a part of a position"),
            ("A1 0,A2 5", "A2 5", "gives only a part of a position"),
            ("LIN {X 600,", "LIN {X a,", "is not plain numbers"),
            ("LIN {X 600,", "LIN {X 'B1',", "is not plain numbers"),
            ("LIN {X 600,", "LIN {X 6e7,", "'6e7' is beyond what any machine reads"),
            ("LIN {X", "LIN_REL {X", "is relative to where the robot is"),
            ("LIN {X", "LIN XP1:{X", "is computed at run time"),
            ("S 2,T 0}", "S 2,T 0,E1 100}", "moves external axes"),
            ("A6 0}", "A6 0,E2 1}", "moves external axes"),
            ("$TOOL={X 0,Y 0,Z 100,A 0,B 0,C 0}\n", "", "nothing before it selects a tool"),
            ("$BASE=$NULLFRAME\n", "", "nothing before it selects a base"),
            ("$TOOL={X 0,Y 0,Z 100,A 0,B 0,C 0}", "$TOOL=TOOL_DATA[3]", "TOOL_DATA[3] is not known here; give $config"),
            ("$TOOL={X 0,Y 0,Z 100,A 0,B 0,C 0}", "BAS(#TOOL,4)", "TOOL_DATA[4] is not known here"),
            ("$BASE=$NULLFRAME", "BAS(#BASE,5)", "BASE_DATA[5] is not known here"),
            ("$BASE=$NULLFRAME", "$BASE=found", "found is not known here"),
            ("$BASE=$NULLFRAME", "FDAT_ACT=FP9\nBAS(#PTP_PARAMS,100)", "FP9 is not declared here"),
            ("$TOOL={X 0,", "$TOOL={X h,", "$TOOL is not six plain numbers"),
            ("$TOOL={X 0,", "$TOOL={", "$TOOL is not six plain numbers"),
            ("$BASE=$NULLFRAME", "$BASE=$NULLFRAME\n$IPO_MODE=#TCP", "the tool is not on the robot"),
            ("LIN {X", "LIN $POS_ACT ;{X", "is computed at run time"),
            ("LIN {X", "DECL E6POS XP1={X 1}\nLIN XP1 ;{X", "gives only a part of a position"),
            ("LIN {X", "DECL E6POS P1={X 1,Y 1,Z 1,A 1,B 1,C 1}\nP1.X=5\nLIN P1 ;{X", "is set while the program runs"),
            ("LIN {X", "CIRC XP1,{X", "XP1: is not declared here"),
            (
                "LIN {X",
                "DECL FRAME P1={X 600,Y 0,Z 500,A 0,B 80,C 0}\nLIN P1\n$BASE=P1\nLIN {X",
                "moves along with P1, a target that is its frame or tool",
            ),
            ("S 2,T 0}", "S 2,T 0} WITH $BASE=BASE_DATA[3]", "BASE_DATA[3] is not known here"),
            ("LIN {X", "SPLINE WITH $TOOL=STOOL2(FP1)\nLIN {X", "FP1 is not declared here"),
        ],
    ),
    ".ls": (
        LS,
        [
            (LS, "", "has no /MN and /POS sections"),
            (LS, "\x00\x03", "is not text"),
            ("/POS", "/PAS", "has no /MN and /POS sections"),
            ("/MN", "/MM", "has no /MN and /POS sections"),
            ("L P[2] 1", "L P[7] 1", "line 4: P[7] is not in /POS; save the program again"),
            ("L P[2] 1", "L P[R[1]] 1", "line 4: P[R[1]]: is computed at run time"),
            ("L P[2] 1", "L PR[1] 1", "is a position register"),
            ("mm/sec FINE ;", "mm/sec FINE Offset,PR[1] ;", "is computed at run time (Offset)"),
            ("mm/sec FINE ;", "mm/sec FINE Tool_Offset,PR[1] ;", "is computed at run time (Tool_Offset)"),
            ("mm/sec FINE ;", "mm/sec FINE INC ;", "is computed at run time (INC)"),
            ("mm/sec FINE ;", "mm/sec FINE VOFFSET,VR[1] ;", "is computed at run time (VOFFSET)"),
            ("UF : 0, UT : 0,\tC", "UF : 3, UT : 0,\tC", "its user frame is not known; give UFRAME[3] with --frames"),
            ("UF : 0, UT : 0,\tC", "UF : 0, UT : 5,\tC", "its tool is not known; give UTOOL[5] with --frames"),
            ("UF : 0, UT : 0,\tC", "UF : F, UT : 0,\tC", "its user frame is chosen at run time"),
            ("UF : 0, UT : 0,\tC", "UF : 0, UT : F,\tC", "its tool is chosen at run time"),
            ("UF : 0, UT : 0,\tC", "\tC", "does not say UF and UT"),
            ("CONFIG : 'N U T, 0, 0, 0',", "", "has no CONFIG such as"),
            ("'N U T, 0, 0, 0'", "'N U T, 0, 1, 0'", "its configuration counts turns"),
            ("'N U T, 0, 0, 0'", "'X U T, 0, 0, 0'", "has no CONFIG such as"),
            ("X = 600.000 mm", "X = 600.000 in", "P[2] has no number for X"),
            ("R = 0.000 deg", "R = * deg", "P[2] has no number for R"),
            ("Z = 500.000", "Z = 50000000.000", "is beyond what any machine reads"),
            ("GP1:\n\tUF : 0, UT : 0,\tC", "GP1:\n\tUF : 0, UT : 0,\n   GP2:\n\tC", "moves other motion groups"),
            ("GP1:\n\tUF : 0, UT : 0,\tC", "GP2:\n\tUF : 0, UT : 0,\tC", "moves other motion groups"),
            ("R = 0.000 deg", "R = 0.000 deg,\tE1= 5.000 mm", "moves external axes"),
        ],
    ),
}
CASES = [(suffix, k) for suffix, (_, edits) in BAD.items() for k in range(len(edits))]


@pytest.mark.parametrize(("suffix", "k"), CASES)
def test_what_cannot_be_read_is_named_with_its_line(suffix, k, tmp_path):
    good, edits = BAD[suffix]
    old, new, said = edits[k]
    assert old in good
    path = tmp_path / f"part{suffix}"
    path.write_text(good.replace(old, new))
    try:
        heard = [str(place) for place in read_program(path).left_out]
    except CalibrationError as error:
        heard = [str(error)]
    assert [message for message in heard if said in message], heard
    assert all(f"part{suffix}" in message and "\n" not in message for message in heard)


def test_targets_are_taken_by_their_keywords(tmp_path):
    path = tmp_path / "part.script"
    path.write_text(UR.replace("movej(a)", "movej(a=1.4, v=1, q=a)").replace("movel(p[", "movel(a=1, pose=p["))
    program = read_program(path)
    assert (len(program.targets), program.left_out) == (2, ())


def test_what_stands_behind_with_holds_for_its_motion_or_spline(tmp_path):
    """Bases at 0, 10, 20 mm in x: of the program, of a motion, of a spline; by hand."""
    path = tmp_path / "part.src"
    pose = "{X 500,Y 0,Z 500,A 0,B 80,C 0}"
    path.write_text(
        "DEF p()\n$TOOL=$NULLFRAME\n$BASE={X 0,Y 0,Z 0,A 0,B 0,C 0}\n"
        f"SLIN {pose} WITH $VEL.CP=0.1, $BASE={{X 10,Y 0,Z 0,A 0,B 0,C 0}}\nLIN {pose}\n"
        f"SPLINE WITH $BASE={{X 20,Y 0,Z 0,A 0,B 0,C 0}}\nSLIN {pose}\nSPL {pose}\nENDSPLINE\nLIN {pose}\nEND\n"
    )
    program = read_program(path)
    assert program.left_out == ()
    assert [round(1e3 * target.flange.translation[0]) for target in program.targets] == [510, 500, 520, 520, 500]


@pytest.mark.parametrize(("status", "turns"), [("'B010'", "'B100010'"), ("'b10'", "'H22'"), ("2", "34")])
def test_bits_are_read_as_controllers_write_them(status, turns, tmp_path):
    path = tmp_path / "part.src"
    path.write_text(KUKA.replace("S 2,T 0", f"S {status},T {turns}"))
    configuration = read_program(path).targets[1].configuration
    assert configuration.text == "S 2, T 34"
    assert [k for k, (low, _) in configuration.ranges.items() if low < 0] == [1, 5]


@pytest.mark.parametrize("suffix", BAD)
def test_of_a_good_program_everything_is_compensated(suffix, cell, tmp_path):
    good, _ = BAD[suffix]
    (tmp_path / f"part{suffix}").write_text(good)
    program = read_program(tmp_path / f"part{suffix}")
    assert program.left_out == ()
    result = compensate_program(cell[3], program, third_joint="j3")
    assert not any(result.reasons)


@pytest.mark.quick(2)
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["part.ls", "--frames", "frames.txt"], "give a table (.csv), a RAPID module"),
        (["part.ls", "--frames", "no.csv"], "no.csv: no such file"),
        (["part.ls", "--frames", "nameless.csv"], "no column 'name'"),
        (["part.ls", "--frames", "twice.csv"], "'UTOOL[1]' is given twice"),
        (["part.ls", "--base-link", "l9"], "no link 'l9'"),
        (["part.ls", "--base-link", "l3"], "link 'l3' moves relative to the description's base"),
        (["part.ls", "--flange-link", "l3"], "link 'l3' moves relative to target 'a'"),
        (["part.ls", "--keep", "pose"], "--keep: not for controllers' programs"),
        (["part.csv", "--third-joint", "j3"], "--third-joint: not for tables"),
        (["part.ls"], "say with --third-joint whether"),
        (["part.ls", "--out", "new.mod"], "the language of part.ls; give the output the same ending"),
        (["far.script"], "is out of the nominal robot's reach"),
        (["other.src"], "not in configuration S 0, T 63"),
    ],
)
def test_bad_options_end_with_one_line(cell, arguments, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "part.ls").write_text(LS)
    (tmp_path / "part.csv").write_text("j1\n0\n")
    (tmp_path / "nameless.csv").write_text("x,y\n0,0\n")
    row = "UTOOL[1],0,0,0,0,0,0\n"
    (tmp_path / "twice.csv").write_text(f"name,x,y,z,rx,ry,rz\n{row}{row}")
    (tmp_path / "far.script").write_text(UR.replace("p[0.6", "p[6"))
    (tmp_path / "other.src").write_text(KUKA.replace("S 2,T 0", "S 0,T 63"))
    before = sorted(tmp_path.iterdir())
    done = CliRunner().invoke(command, [str(cell[0] / "out"), "--out", "new" + Path(arguments[0]).suffix, *arguments])
    assert done.exit_code == 2, done.output
    assert said in done.output
    assert sorted(tmp_path.iterdir()) == before
