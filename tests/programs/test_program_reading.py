"""What programs of controllers set, select and decide elsewhere is left alone, however it is written."""

import time

import pytest

from calib.core.base.errors import DataError
from calib.programs.languages.languages import read_program

AXES = "[9E9,9E9,9E9,9E9,9E9,9E9]"
RAPID = (
    "MODULE m\nPERS tooldata t:=[TRUE,[[0,0,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];\n"
    f"CONST robtarget p1:=[[600,0,500],[1,0,0,0],[0,0,0,0],{AXES}];\n"
    f"VAR robtarget p2:=[[600,0,400],[1,0,0,0],[0,0,0,0],{AXES}];\nVAR num n;\nVAR bool c;\n"
    "PROC lift(INOUT robtarget r)\nr.trans.z:=0;\nENDPROC\nPROC both(num k, \\ VAR robtarget r)\nENDPROC\n"
    "FUNC num high(PERS robtarget r)\nRETURN 1;\nENDFUNC\nFUNC num seen(robtarget r)\nRETURN r.trans.z;\nENDFUNC\n"
    "PROC change(INOUT tooldata x)\nENDPROC\n"
    "PROC main()\n#\nMoveL p1,v100,fine,tool0;\nMoveL p2,v100,fine,{tool};\n%\nENDPROC\nENDMODULE\n"
)
KRL = (
    "DEF p()\nDECL E6POS P1={X 600,Y 0,Z 500,A 0,B 80,C 0}\nDECL E6POS P2={X 600,Y 0,Z 400,A 0,B 80,C 0}\n"
    "$TOOL=$NULLFRAME\n$BASE=$NULLFRAME\nLIN P1\n#\nLIN P2\n%\nEND\n"
    "DEF LIFT(R:OUT)\nEND\nDEF PLAIN(R)\nEND\nDEF SEEN(R:IN)\nEND\nDEF PICK()\n$TOOL.Z=5\nEND\n"
)
UR = (
    "def m():\nset_tcp(p[0,0,0.1,0,0,0])\nb1=p[0.6,0,0.5,0,1.4,0]\nb2=p[0.6,0,0.4,0,1.4,0]\n"
    "def f():\nset_tcp(p[0,0,0.2,0,0,0])\nend\ndef seen(x):\nend\nmovel(b1)\n#\nmovel(b2)\n%\nend\n"
)
LS_POSITION = (
    "P[{0}]{{\n   GP1:\n\tUF : {1}, UT : {1},\tCONFIG : 'N U T, 0, 0, 0',\n\tX = 600.000 mm,\tY = 0.000 mm,"
    "\tZ = 500.000 mm,\n\tW = 0.000 deg,\tP = 80.000 deg,\tR = 0.000 deg\n}};\n"
)
LS = (
    "/PROG P\n/MN\n   1:L P[1] 100mm/sec FINE ;\n#\n   2:L P[2] 100mm/sec FINE ;\n%\n/POS\n"
    + LS_POSITION.format(1, 0)
    + LS_POSITION.format(2, 1)
    + "/END\n"
)
FRAMES = "name,x,y,z,rx,ry,rz\nUFRAME[1],0.1,0,0,0,0,0\nUTOOL[1],0,0,0.1,0,0,0\n"

# what stands before or behind the move to the second target, which is then left alone; the first is compensated
SET = {
    "a RAPID statement within a line": (
        "IF c p2.trans.z:=500;",
        "IF n=1 p2.trans.z := 500;",
        "IF (n=1) P2.TRANS.Z:=500;",
        "IF NOT c AND n>2 p2 := p1;",
        "IF c THEN p2:=p1; ENDIF",
        "IF c THEN n:=1; ELSE p2:=p1; ENDIF",
        "IF c THEN ELSEIF n=1 THEN p2.rot:=p1.rot; ENDIF",
        "TEST n CASE 1: p2:=p1; ENDTEST",
        "TEST n CASE 1,2: n:=1; DEFAULT: p2.trans:=p1.trans; ENDTEST",
        "FOR i FROM 1 TO 3 DO p2.trans.z:=i; ENDFOR",
        "WHILE c DO p2:=p1; ENDWHILE",
        "here: p2:=p1;",
        'TPWrite "x"; p2:=p1;',
        "n:=1; ! c\n  p2\n.trans\n.z\n:=\n5;",
        "IF c IF c p2.trans.x:=1;",
        "IF (c) AND (n>1) p2.trans:=[1,2,3];",
        "TEST n CASE 1: TEST n CASE 2: p2:=p1; ENDTEST DEFAULT: n:=1; ENDTEST",
        "IF -1<n p2.trans.x:=n;",
        "FOR p2 FROM 1 TO 2 DO ENDFOR",
        "IF c GOTO out; p2.extax:=p1.extax; out: n:=1;",
    ),
    "a RAPID argument": (
        "lift p2;",
        "LIFT P2 ;",
        "IF c lift p2;",
        "IF c THEN lift p2; ENDIF",
        "both 1 \\r:=p2;",
        "n:=high(p2);",
        "IF high(p2)=1 n:=2;",
        "elsewhere p2;",
        "Add p2.trans.z,5;",
        "Incr p2.trans.z;",
        "n:=elsewhere(p2);",
        "SearchL di1,p2,p1,v100,tool0;",
        '%"lift"% p2;',
        "WHILE high(p2)>1 DO ENDWHILE",
        '%"li"+"ft"% p2;',
        "BitSet p2.robconf.cf1,1;",
        'c:=StrToVal("5",p2.trans.z);',
    ),
    "what RAPID decides": (
        "IF p2.trans.z>500 n:=1;",
        "WHILE p2.trans.z>500 DO ENDWHILE",
        "n:=p2.trans.z; IF n=1 n:=2;",
        "n:=seen(p2); TEST n CASE 1: n:=2; ENDTEST",
        "WaitUntil p2.trans.z>500;",
    ),
    "a KRL frame in part": (
        "$TOOL.Z=200",
        "$BASE.Z=100",
        "$tool.x = 1",
        "  $BASE.A=1 ; turned",
        "IF $IN[1] THEN $TOOL.Z=200 ENDIF",
        "IF $IN[1] THEN\n$BASE.C=1\nENDIF",
        "SWITCH N\nCASE 1\n$TOOL.Z=1\nENDSWITCH",
        "LOOP\n$TOOL.Z=1\nEXIT\nENDLOOP",
        "WHILE $IN[1]\n$TOOL.B=1\nENDWHILE",
        "FOR I=1 TO 3\n$BASE.X=1\nENDFOR",
        "REPEAT\n$BASE.X=1\nUNTIL TRUE",
        "PICK()",
        "TRIGGER WHEN DISTANCE=0 DELAY=0 DO $TOOL.Z=5",
        "INTERRUPT DECL 3 WHEN $IN[1] DO PICK()",
        "ELSEWHERE()",
        "BAS(#INITMOV,0)",
        "$ROBROOT.Z=1",
        "$BASE=$BASE:{X 0,Y 0,Z 5,A 0,B 0,C 0}",
        "$TOOL=TOOL_DATA[N]",
        "$ACT_EX_AX=5",
        "$BASE:={X 1}",
        "ANIN ON $TOOL.Z=1*$ANIN[1]\n$TOOL=$NULLFRAME",
        "BAS(#FRAMES)",
    ),
    "a KRL statement within a line": (
        "IF $IN[1] THEN P2.Z=500 ENDIF",
        "IF $IN[1] THEN P2.Z=500",
        "if $in[1] then p2.z = 500 endif",
        "IF N==1 THEN N=2 ELSE P2=P1 ENDIF",
        "IF (N==1) THEN P2=P1 ENDIF",
        "TRIGGER WHEN DISTANCE=1 DELAY=0 DO P2.Z=5 PRIO=-1",
        "here: P2.Z=5",
        "ELSEWHERE(P2)",
        "LIFT(P2)",
        "PLAIN(P2)",
        "N=PLAIN(P2)",
        "IF P2.Z>5 THEN N=1 ENDIF",
        "FOR P2=1 TO 3\nENDFOR",
        "P2={X 1}",
        "P2:{X 0,Y 0,Z 5}",
        "INTERRUPT DECL 4 WHEN $IN[2] DO LIFT(P2)",
        "GOTO L1\nP2.Z=5\nL1:",
        "SREAD(S,ST,P2)",
        "ANIN ON P2.X=1*$ANIN[1]",
        "DIGIN ON P2.Z=2*$DIGIN1",
        "DECL E6POS P2=P1",
    ),
    "a URScript statement within a line": (
        "while (True): b2[2]=0.5 end",
        "while True: b2[2] = 0.5\nend",
        "if get_digital_in(1): b2[2]=0.5 end",
        "if get_digital_in(1): x=1 else: b2[0]=1 end",
        "if c: x=1 elif d: b2=b1 end",
        "x=1; b2[2]=0.5",
        "x = 1 ; global b2 = b1",
        "def g(): b2[2]=0.5 end",
        "thread t(): b2[2]=0.5 end",
        "while c: while d: b2[1]=1 end end",
        "elsewhere(b2)",
        "if b2[2]>0.5: x=1 end",
        "x=b2[2]\nwhile x>0: x=x-1 end",
        "x=b2[0]=5",
        "switch c:\ncase 1: b2[0]=1\nend",
        "b2[get_digital_in(1)]=5",
        "while norm(b2)>1: x=1 end",
        "assert(b2[2]>0.3)",
        "path_offset_enable()",
        "if c: path_offset_enable() end",
        "force_mode(b1,x,x,2,x)",
        "track_conveyor_linear(b1,500)\nset_tcp(p[0,0,0.1,0,0,0])",
        "track_conveyor_circular(b1,500)\nif c: stop_conveyor_tracking() end",
        "thread t(): force_mode(p[0,0,0,0,0,0],x,x,2,x) end",
    ),
    "a URScript tool": (
        "if c: set_tcp(p[0,0,0.2,0,0,0]) end",
        "while c: set_tcp(b1) end",
        "thread t(): set_tcp(p[0,0,0,0,0,0]) end",
        "elsewhere()",
        "if c: f() end",
        "x = c and f()",
        "while c:\n f()\nbreak\nend",
        "sync(set_tcp(p[0,0,0.2,0,0,0]))",
        "if c: x=1 elif f(): x=2 end",
        "set_tcp(get_tcp_offset())",
        "switch c:\ncase 1: f()\nend",
        "set_tcp(pose_add(b1,b1))",
        "set_tool_data(b1)",
    ),
    "a FANUC frame, position or selection": (
        "   3:  UFRAME[1]=PR[1] ;",
        "   3:  UTOOL[1]=PR[1] ;",
        "   3:  UFRAME[R[1]]=PR[1] ;",
        "   3:  UFRAME_NUM=2 ;",
        "   3:  IF R[1]=1,UTOOL_NUM=2 ;",
        "   3:  IF (R[1]=1) THEN ;\n UFRAME[1]=PR[1] ;\n ENDIF ;",
        "   3:  CALL GRIP ;",
        "   3:  SELECT R[1]=1,CALL GRIP ;\n    :  =2,JMP LBL[1] ;\n LBL[1] ;",
        "   3:  OPEN HAND 1 ;",
        "   3:  $MNUFRAME[1,1]=PR[1] ;",
        "   3:  P[2]=LPOS ;",
        "   3:  P[R[1]]=LPOS ;",
        "   3:  UTOOL_NUM=R[1] ;",
        "   3:  IF P[2]=P[1],R[1]=1 ;",
        "   3:L P[1] 100mm/sec FINE TB .10sec,CALL GRIP ;",
        "   3:  P[2:x]=PR[1] ;",
        "   3:  PR[1]=P[2]+PR[2] ;",
        "   3:  RUN OTHER ;",
        "   3:  FOR R[1]=1 TO 3 ;\n UTOOL_NUM=2 ;\n ENDFOR ;",
        "   3:L P[1] 100mm/sec FINE DB 5mm,P[2]=LPOS ;",
        "   3:L P[1] 100mm/sec FINE TB .10sec,UFRAME_NUM=2 ;",
    ),
}
# of these the tool of the second move is left alone
TOOLS = (
    "IF c t.tframe.trans.z:=500;",
    "IF c THEN t.tframe:=[[0,0,0],[1,0,0,0]]; ENDIF",
    "MToolTCPCalib j1,j2,j3,j4,t,n,n;",
    "IF c MToolTCPCalib j1,j2,j3,j4,t,n,n;",
    "MToolRotCalib p1,p1,t;",
    "change t;",
    "IF c change t;",
    "TEST n CASE 1: t.robhold:=FALSE; ENDTEST",
    "here: t.tframe.trans.x:=1;",
    "FOR i FROM 1 TO 3 DO t.tframe.trans.x:=i; ENDFOR",
    "elsewhere;",
    "PDispSet [[0,0,1],[1,0,0,0]];",
    "IF c PDispOn p1,t;",
    "ConfL\\Off; IF c ConfL\\On;",
    "ConfL\\Off; TEST n CASE 1: ConfL\\On; ENDTEST",
    "IF c IF n=1 t:=tool0;",
    "PDispOn\\Rot,p1,t;",
    "FOR t FROM 1 TO 2 DO ENDFOR",
)
# LOCAL data that are set or read by their name as text
BY_NAME = (
    'SetDataVal "p2",x; PDispOff; EOffsOff; ConfL\\On; ConfJ\\On;',
    'SetAllDataVal "robtarget",x; PDispOff; EOffsOff; ConfL\\On; ConfJ\\On;',
    'GetDataVal "p2",x; IF x.trans.z>1 n:=2; PDispOff; EOffsOff; ConfL\\On; ConfJ\\On;',
)
PROGRAMS = {"RAPID": (".mod", RAPID.replace("{tool}", "tool0")), "KRL": (".src", KRL), "URScript": (".script", UR)}
PROGRAMS["FANUC"] = (".ls", LS)
CASES = [
    (next(PROGRAMS[language] for language in PROGRAMS if language in what), edit)
    for what, edits in SET.items()
    for edit in edits
] + [((".mod", RAPID.replace("{tool}", "t")), edit) for edit in TOOLS]
LOCAL = RAPID.replace("{tool}", "tool0").replace("VAR robtarget p2", "LOCAL VAR robtarget p2")
CASES += [((".mod", LOCAL), edit) for edit in BY_NAME]


def read(tmp_path, suffix, text, **options):
    (tmp_path / "frames.csv").write_text(FRAMES)
    (tmp_path / f"part{suffix}").write_text(text)
    frames = [tmp_path / "frames.csv"] if suffix == ".ls" else []
    return read_program(tmp_path / f"part{suffix}", frames, **options)


@pytest.mark.parametrize(("program", "edit"), CASES)
@pytest.mark.parametrize("place", ["#", "%"])
def test_what_is_set_or_decided_anywhere_is_left_alone_and_named(tmp_path, program, edit, place):
    suffix, text = program
    if place == "%":  # behind the move: it counts where the program comes there before, in a loop
        again = {
            ".mod": (f"WHILE c DO\n@{edit}\nENDWHILE", "MoveL p2"),
            ".src": (f"LOOP\n@{edit}\nENDLOOP", "LIN P2"),
            ".script": (f"while x:\n@{edit}\nend", "movel(b2"),
            ".ls": (f" LBL[9] ;\n@{edit}\n JMP LBL[9] ;", "   2:L P[2]"),
        }[suffix]
        move = next(line for line in text.split("\n") if line.startswith(again[1])) + "\n"
        text = text.replace(move, "").replace("%", again[0].replace("@", move)).replace("#\n", "")
    else:
        text = text.replace("#", edit).replace("%\n", "")
    try:
        program = read(tmp_path, suffix, text)
    except DataError:  # the other target is left alone too, or the program is refused
        return
    names = [target.name.upper() for target in program.targets]
    assert not {"P2", "B2", "P[2]"} & set(names), names
    assert [left for left in program.left_out if left.text.upper().startswith(("P2", "B2", "P[2]", "MOVEL(B2"))]


@pytest.mark.parametrize(
    ("suffix", "text", "edit"),
    [
        (".mod", RAPID.replace("{tool}", "t"), "SetDO do1,1; WaitTime 1; n:=n+1; ConfL\\On;"),
        (".mod", RAPID.replace("{tool}", "t"), "PDispSet [[0,0,1],[1,0,0,0]]; PDispOff;"),
        (".mod", RAPID.replace("{tool}", "t"), 'TPWrite "p2:=p1;"; ! t.tframe.trans.z:=5;'),
        (".mod", RAPID.replace("{tool}", "t"), "IF c THEN MoveL p1,v100,fine,tool0; ELSE n:=1; ENDIF"),
        (".mod", RAPID.replace("{tool}", "t"), "n:=Distance(p1.trans,p1.trans);"),
        (".mod", RAPID.replace("{tool}", "t"), "FOR i FROM (1) TO (n+1) STEP (1) DO n:=(n+1); ENDFOR"),
        (".mod", RAPID.replace("{tool}", "t").replace("[9E9,9E9", "[0,9E9"), "SetDO do1,1;"),
        (".src", KRL, "WAIT FOR ($IN[1]==TRUE)\nWAIT SEC (0.5)\nFOR I=(1) TO (N+1) STEP (1)\nN=(N+1)\nENDFOR"),
        (".src", KRL, "INTERRUPT DECL 3 WHEN ($STOPMESS==TRUE) DO IR_STOPM ( )"),
        (".src", KRL, "BAS(#INITMOV,0)\n$TOOL=$NULLFRAME\n$BASE=$NULLFRAME"),
        (".src", KRL, "FDAT_ACT={TOOL_NO 0,BASE_NO 0,IPO_FRAME #BASE}\nBAS(#FRAMES)"),
        (".src", KRL, "$VEL.CP=0.1\nWAIT SEC 1\n$OUT[1]=TRUE ; $TOOL.Z=5"),
        (".src", KRL, "IF $IN[1] THEN\n$TOOL.Z=5\nENDIF\n$TOOL=$NULLFRAME"),
        (".src", KRL, "PICK()\n$TOOL={X 0,Y 0,Z 0,A 0,B 0,C 0}"),
        (".src", KRL, "SEEN(P1)\nGLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )"),
        (".script", UR, 'textmsg("b2[2]=5")\nset_digital_out(1, True) # set_tcp(b1)'),
        (".script", UR, "if c: set_tcp(b1) else: f() end\nset_tcp(p[0,0,0.3,0,0,0])"),
        (".script", UR, "def g(): end_force_mode() end\npath_offset_disable()\nstop_conveyor_tracking()\ng()"),
        (".ls", LS, "   3:L P[1] 100mm/sec FINE DB 5mm,DO[1]=ON ;"),
        (".ls", LS, "   3:  DO[1]=ON ;\n   4:  !UFRAME_NUM=2 ;\n   5:  MESSAGE[don't; CALL X] ;"),
        (".ls", LS, "   3:  Arc Start[1,2] ;\n   4:  Weave Sine[5] ;"),
        (".ls", LS, "   3:  --eg:don't use 5\" \\ UTOOL_NUM=3 ;"),
        (".ls", LS, "   3:  UFRAME_NUM=1 ;\n   4:  UTOOL_NUM=1 ;\n   5:  WAIT   1.00(sec) ;"),
    ],
)
def test_what_changes_nothing_leaves_both_targets_compensated(tmp_path, suffix, text, edit):
    program = read(tmp_path, suffix, text.replace("#", edit).replace("%\n", ""))
    assert len(program.targets) == 2, [str(left) for left in program.left_out]
    assert program.left_out == ()


@pytest.mark.parametrize(
    ("whole", "named"),
    [
        ("[[0,0,100],[1,0,0,0]]", "f"),  # the frame of the tool
        ("[TRUE,[[0,0,100],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]]", "tool0"),
        (f"[[600,0,400],[1,0,0,0],[0,0,0,0],{AXES}]", "p1"),
        ("[600,0,400]", "q"),
    ],
)
def test_rapid_data_that_name_others_leave_one_target_and_not_the_program(tmp_path, whole, named):
    text = RAPID.replace("{tool}", "t").replace("#\n", "").replace("%\n", "").replace(whole, named)
    program = read(tmp_path, ".mod", text)
    assert [target.name for target in program.targets] == ["p1"]
    assert f"'{named}' is not written out as numbers" in program.left_out[0].why


@pytest.mark.parametrize(
    ("suffix", "edit"),
    [
        (".mod", "PDispSet w; TEST n CASE 1: PDispOff; DEFAULT: MoveL p2,v100,fine,tool0; ENDTEST PDispOff;"),
        (".mod", "PDispSet w; IF c THEN PDispOff; ELSE MoveL p2,v100,fine,tool0; ENDIF PDispOff;"),
        (".src", "$TOOL.Z=9\nSWITCH N\nCASE 1\n$TOOL=$NULLFRAME\nDEFAULT\nLIN P2\nENDSWITCH\n$TOOL=$NULLFRAME"),
        (".src", "$TOOL.Z=9\nIF $IN[1] THEN\n$TOOL=$NULLFRAME\nELSE\nLIN P2\nENDIF\n$TOOL=$NULLFRAME"),
        (".script", "f()\nif c: set_tcp(p[0,0,0.1,0,0,0]) else: movel(b2) end\nset_tcp(p[0,0,0.1,0,0,0])"),
        (".script", "f()\nswitch c:\ncase 1: set_tcp(b1) default: movel(b2) end\nset_tcp(p[0,0,0.1,0,0,0])"),
    ],
)
def test_a_branch_is_taken_in_place_of_the_others_and_not_behind_them(tmp_path, suffix, edit):
    text = {".mod": RAPID.replace("{tool}", "tool0"), ".src": KRL, ".script": UR}[suffix]
    program = read(tmp_path, suffix, text.replace("#", edit).replace("%\n", ""))
    assert [target.name.upper()[-1] for target in program.targets] == ["1"]


@pytest.mark.parametrize(("suffix", "text"), [(".mod", RAPID), (".src", KRL), (".script", UR)])
def test_the_mark_that_editors_put_before_a_text_stays(tmp_path, suffix, text):
    read(tmp_path, suffix, text.replace("{tool}", "t").replace("#\n", "").replace("%\n", ""))
    path = tmp_path / f"part{suffix}"
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    program = read_program(path)
    assert len(program.targets) == 2
    assert program.rewritten([None, None]) == (path.read_bytes(),)


@pytest.mark.parametrize(
    ("form", "left", "x"),
    [
        ("{TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}", "", 0.6 + 0.02 - 0.01),
        ("{TOOL_NO 1,BASE_NO 2,IPO_FRAME #TCP}", "the tool is not on the robot", 0.0),
        ("{TOOL_NO N,BASE_NO 2,IPO_FRAME #BASE}", "TOOL_DATA[N] is not known here", 0.0),
        ("{TOOL_NO 1}", "FDAT_ACT does not say TOOL_NO and BASE_NO", 0.0),
    ],
)
def test_a_form_that_is_written_out_selects_tool_and_base(tmp_path, form, left, x):
    """By hand: a base at x = 20 mm, a tool 10 mm ahead in x."""
    (tmp_path / "frames.csv").write_text(
        "name,x,y,z,rx,ry,rz\nTOOL_DATA[1],0.01,0,0,0,0,0\nBASE_DATA[2],0.02,0,0,0,0,0\n"
    )
    edit = f"FDAT_ACT={form}\nBAS(#PTP_PARAMS,50)"
    (tmp_path / "part.src").write_text(KRL.replace("#", edit).replace("%\n", "").replace("B 80", "B 0"))
    program = read_program(tmp_path / "part.src", [tmp_path / "frames.csv"])
    assert [str(place).partition("P2: ")[2].startswith(left) for place in program.left_out] == [True] * bool(left), left
    assert [target.flange.translation[0] for target in program.targets[1:]] == pytest.approx([x] * (not left))


@pytest.mark.parametrize(("written", "decimals"), [("600", 3), ("600.0", 3), ("600.000", 3), ("600.00000", 5)])
def test_whole_millimetres_of_fanuc_are_not_kept_whole(tmp_path, written, decimals):
    """A controller writes three decimals; a correction rounded to whole millimetres is none."""
    text = LS.replace("#\n", "").replace("%\n", "").replace("600.000", written)
    cell = read(tmp_path, ".ls", text).targets[0].cells[0]
    assert len(cell.format(0.6001234567).partition(".")[2]) == decimals


def test_inline_forms_of_controllers_are_read(tmp_path):
    """As KUKA's controllers (KSS 8.6) write them. By hand: a base at x = 20 mm, a tool 10 mm ahead in x."""
    (tmp_path / "frames.csv").write_text(
        "name,x,y,z,rx,ry,rz\nTOOL_DATA[1],0.01,0,0,0,0,0\nBASE_DATA[2],0.02,0,0,0,0,0\n"
    )
    pose = "{X 600,Y 0,Z 500,A 0,B 0,C 0}"
    frames = "$TOOL = STOOL2(FP1), $BASE = SBASE(FP1.BASE_NO), $IPO_MODE = SIPO_MODE(FP1.IPO_FRAME)"
    (tmp_path / "part.src").write_text(
        f"DEF p()\nDECL FDAT FP1={{TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}}\nDECL E6POS XP1={pose}\n"
        f"DECL E6POS XP2={pose}\nDECL E6POS XP3={pose}\nBAS (#INITMOV,0 )\n"
        f"SPTP XP1 WITH $VEL_AXIS[1] = SVEL_JOINT(100.0), {frames}, $LOAD = SLOAD(FP1.TOOL_NO), $ACC_AXIS[1] ="
        " SACC_JOINT(PPDAT1), $APO = SAPO_PTP(PPDAT1), $GEAR_JERK[1] = SGEAR_JERK(PPDAT1), $COLLMON_TOL_PRO[1] ="
        f" USE_CM_PRO_VALUES(0)\nSLIN XP2 WITH $VEL = SVEL_CP(2.0, , LCPDAT1), {frames}, $LOAD = SLOAD(FP1.TOOL_NO),"
        " $ACC = SACC_CP(LCPDAT1), $ORI_TYPE = SORI_TYP(LCPDAT1), $APO = SAPO(LCPDAT1), $JERK = SJERK(LCPDAT1)\n"
        "$BWDSTART = FALSE\nLDAT_ACT = LCPDAT1\nFDAT_ACT = FP1\nBAS(#CP_PARAMS, 2.0)\nSET_CD_PARAMS (0)\nLIN XP3\nEND\n"
    )
    program = read_program(tmp_path / "part.src", [tmp_path / "frames.csv"])
    assert program.left_out == ()
    assert [target.flange.translation[0] for target in program.targets] == pytest.approx([0.61] * 3)


@pytest.mark.parametrize(
    ("suffix", "text", "call"),
    [
        (".mod", RAPID.replace("{tool}", "t"), "rGrip;"),
        (".src", KRL, "GRIP()"),
        (".script", UR, "rGrip()"),
        (".ls", LS, "   3:  CALL RGRIP ;"),
    ],
)
def test_a_routine_that_is_said_to_be_harmless_is(tmp_path, suffix, text, call):
    text = text.replace("#", call).replace("%\n", "")
    try:
        left = [str(place) for place in read(tmp_path, suffix, text).left_out]
    except DataError as error:
        left = [str(error)]
    assert [message for message in left if "--harmless" in message and "rip" in message.lower()], left
    program = read(tmp_path, suffix, text, harmless=["GRIP" if suffix == ".src" else "rGrip"])
    assert (len(program.targets), program.left_out) == (2, ())


@pytest.mark.parametrize(
    ("suffix", "text", "said"),
    [
        (".script", "def m():\nmovel(b1)\n", "routine 'm' has no end"),
        (".script", "def m():\nwhile c:\nmovel(b1)\nend\n", "has no end"),
        (".script", "movel(b1)\nend\n", "'end' ends nothing"),
        (".script", "def m():\nelse:\nend\n", "'else' belongs to nothing"),
        (".script", "def m():\nmovel(?)\nend\n", "'?' is not understood"),
        (".script", 'def m():\ntextmsg("x)\nend\n', "is not understood"),
        (".mod", "MODULE m\nPROC a()\nIF c THEN\nENDPROC\n", "'ENDPROC' ends nothing"),
        (".mod", "MODULE m\nPROC a()\nENDIF\n", "'ENDIF' ends nothing"),
        (".mod", "MODULE m\nPROC a()\nMoveL [[1,2);\n", "bracket that is not closed"),
        (".mod", "MODULE m\nPROC a()\n", "has no end"),
        (".src", "DEF p()\nIF $IN[1] THEN\nEND\n", "'END' ends nothing"),
        (".src", "DEF p()\nLIN {X 1,\nY 2}\nEND\n", "bracket that is not closed"),
        (".src", "DEF p()\nUNTIL TRUE\nEND\n", "'UNTIL' belongs to nothing"),
        (".ls", LS.replace("#", " IF (R[1]=1) THEN ;").replace("%\n", ""), "has no end"),
        (".ls", LS.replace("#", " ENDFOR ;").replace("%\n", ""), "'ENDFOR' ends nothing"),
        (".ls", LS.replace("#\n", "").replace("%\n", "").replace("P[2]{", "P[1]{"), "is in /POS twice"),
    ],
)
def test_a_program_that_is_not_understood_is_refused_with_its_line(tmp_path, suffix, text, said):
    with pytest.raises(DataError, match="part") as error:
        read(tmp_path, suffix, text)
    assert said in str(error.value)


@pytest.mark.quick(1)
@pytest.mark.parametrize(
    ("suffix", "piece"),
    [
        (".script", "movel("),
        (".script", "movel(pose_trans("),
        (".script", "a="),
        (".script", '"'),
        (".script", "if x: "),
        (".mod", "IF a THEN "),
        (".mod", "p{"),
        (".src", "DEF "),
        (".src", "SWITCH "),
        (".ls", "P[1]{ "),
        (".ls", "IF R[1]=1,"),
    ],
)
def test_time_is_linear_in_the_text(tmp_path, suffix, piece):
    """Four times the text takes about four times as long, and 100 kB less than seconds."""
    heads = {".mod": "MODULE m\nPROC a()\n", ".src": "DEF p()\n", ".ls": "/PROG X\n/MN\n", ".script": "def m():\n"}
    tail = "\n/POS\n" + piece * 100 + "\n/END\n" if suffix == ".ls" else ""
    seconds = []
    for size in (25_000, 100_000):
        started = time.process_time()
        with pytest.raises(DataError):
            read(tmp_path, suffix, heads[suffix] + piece * (size // len(piece)) + tail)
        seconds.append(time.process_time() - started)
    assert seconds[1] < 10 * seconds[0] + 0.5
