"""Programs in the languages of controllers, generated for tests: what they set, call and decide is drawn from a seed.

Each has the same ingredients: targets that are constant and some that are set (whole, or a component), branches and
loops in long and compact form, routines with arguments by value and by reference, tools and frames that change, jumps,
comments and texts with code in them, odd blanks and case.
"""

import numpy as np
from scipy.spatial.transform import Rotation

NESTED = ("branch", "loop", "switch", "test")
NONE = "[9E9,9E9,9E9,9E9,9E9,9E9]"


class _Maker:
    """Draws statements; `depth` is how far branches and loops are nested."""

    def __init__(self, seed):
        self.rng, self.count = np.random.default_rng(seed), 0

    def one(self, *items):
        return items[int(self.rng.integers(len(items)))]

    def chance(self, p):
        return self.rng.random() < p

    def new(self, name):
        self.count += 1
        return f"{name}{self.count}"

    def xyz(self):
        return self.rng.uniform([300, -400, 100], [800, 400, 600])

    def angles(self):
        return self.rng.uniform(-1.2, 1.2, 3)

    def small(self):
        return self.rng.uniform(-100, 100, 3)

    def lines(self, kinds, depth, count):
        out = []
        for _ in range(count):
            kind = self.one(*kinds)
            made = getattr(self, "move" if depth > 1 and kind in NESTED else kind)(depth)
            out += made if isinstance(made, list) else [made]
        return out


# ---------------------------------------------------------------- URScript


class URScriptMaker(_Maker):
    KINDS = ("move", "move", "move", "assign", "branch", "loop", "tool", "call", "talk", "copy")

    def pose(self):
        values = [*self.xyz() / 1e3, *self.angles()]
        return f"p[{self.one(', ', ',', ' ,  ').join(f'{v:.6f}' for v in values)}]"

    def joints(self):
        if self.chance(0.2):
            return "[" + ", ".join(f"d2r({v:.3f})" for v in self.rng.uniform(-60, 60, 6)) + "]"
        return "[" + ", ".join(f"{v:.5f}" for v in self.rng.uniform(-1, 1, 6)) + "]"

    def tool_value(self):
        return f"p[{', '.join(f'{v:.4f}' for v in [*self.small() / 1e3, *self.angles()])}]"

    def make(self):
        self.poses, self.lists = [f"b{k}" for k in range(4)], [f"q{k}" for k in range(2)]
        self.parameter = ""
        out = ["def main():"]
        self.functions = []
        for name in ("f", "g"):
            self.parameter = "x" if name == "g" else ""
            body = self.lines(self.KINDS if self.chance(0.5) else ("move", "talk"), 1, 2)
            out += [f"def {name}({self.parameter}):", *body, "end"]
            self.functions.append(name)
        self.parameter = ""
        out += [f"global {name} = {self.pose()}" for name in self.poses]
        out += [f"global {name}={self.joints()}" for name in self.lists]
        out += ["global n = 0", f"global feature = {self.tool_value()}", f"global grip = {self.tool_value()}"]
        if self.chance(0.9):
            out.append(self.one(f"set_tcp({self.tool_value()})", "set_tcp( grip )"))
        out += self.lines(self.KINDS, 0, 8)
        return "\n".join(self.one("  ", "\t", "") + line for line in [*out, "end"]) + "\n"

    def goal(self):
        name = self.one(*self.poses)
        return self.one(
            name,
            name,
            self.pose(),
            f"pose_trans(feature, {self.pose()})",
            f"pose_trans(feature , {name})",
            f"pose_add({name}, p[0,0,0.05,0,0,0])",
            f"get_inverse_kin({name}, qnear={self.one(*self.lists)})",
            self.parameter or name,
        )

    def move(self, depth):
        comment = self.one("", "", "  # movel(b0) b1[2]=3")
        if self.chance(0.2):
            return f"movej({self.one(*self.lists, self.joints())}, a=1.4 ,v=1){comment}"
        if self.chance(0.1):
            return f"movec({self.goal()}, {self.goal()}, v = 0.2)"
        return f"{self.one('movel', 'movej')} ({self.goal()}{self.one('', ', v=0.25', ', a = 1.2 , r=0.001')}){comment}"

    def assign(self, depth):
        if self.chance(0.6):
            return "n = n + 1"
        name = self.one(*self.poses[:2])
        return self.one(
            f"{name}[2] = {name}[2] + 0.05", f"{name} = {self.pose()}", f"global {name}[0]=0.4", "feature[0] = 0.2"
        )

    def copy(self, depth):
        return self.one(
            f"c = {self.one(*self.poses)}", "n = n + 2", f"c = pose_add({self.one(*self.poses)}, p[0,0,0,0,0,0])"
        )

    def condition(self):
        return self.one(
            "get_digital_in(1)",
            "(get_digital_in( 2 ))",
            "n < 3",
            f"{self.one(*self.poses)}[2] > 0.35" if self.chance(0.3) else "n > 1",
        )

    def branch(self, depth):
        out = [f"if {self.condition()}:", *self.lines(self.KINDS, depth + 1, 2)]
        if self.chance(0.3):
            out += [f"elif {self.condition()} :", *self.lines(self.KINDS, depth + 1, 1)]
        if self.chance(0.5):
            out += ["else:", *self.lines(self.KINDS, depth + 1, 1)]
        return [*out, "end"]

    def loop(self, depth):
        if self.chance(0.2):
            return f"while (get_digital_in(3)): {self.one('n = n + 1', 'b1[2]=b1[2] + 0.01', 'movel(b2)')} end"
        name = self.new("k")
        return [
            f"{name} = 0",
            f"while {name} < 2:",
            f"{name} = {name} + 1",
            *self.lines(self.KINDS, depth + 1, 2),
            *self.one([], ["if get_digital_in(0):", "break", "end"]),
            "end",
        ]

    def tool(self, depth):
        return self.one(f"set_tcp({self.tool_value()})", "set_tcp(grip)", "n = n + 1", "sleep(0.1)")

    def call(self, depth):
        if not self.functions:
            return self.move(depth)
        name = self.one(*self.functions)
        return f"{name}({self.one(*self.poses) if name == 'g' else ''})"

    def talk(self, depth):
        return self.one('textmsg("set_tcp(p[0,0,0,0,0,0]) b1[2]=5 #", n)', "set_digital_out(1, True)", "sleep(0.01)")


# ---------------------------------------------------------------- RAPID


class RapidMaker(_Maker):
    KINDS = ("move", "move", "move", "assign", "branch", "compact", "loop", "test", "call", "talk", "displace", "tool")

    def pos(self, values=None):
        return "[" + ",".join(f"{v:.3f}" for v in (self.xyz() if values is None else values)) + "]"

    def rot(self):
        x, y, z, w = Rotation.from_rotvec(self.angles()).as_quat()
        return "[" + ",".join(f"{v:.9f}" for v in (w, x, y, z)) + "]"

    def target(self):
        return f"[{self.pos()},{self.rot()},[0,0,0,0],{NONE}]"

    def joints(self):
        return f"[[{','.join(f'{v:.4f}' for v in self.rng.uniform(-60, 60, 6))}],{NONE}]"

    def tooldata(self):
        return f"[TRUE,[{self.pos(self.small())},{self.rot()}],[1,[0,0,1],[1,0,0,0],0,0,0]]"

    def make(self):
        out = ["MODULE Part"]
        half = "[[0,0,0],[1,0,0,0]]"
        for name in ("t1", "t2"):
            out.append(f"PERS tooldata {name}:={self.tooldata()};")
        out.append(f'TASK PERS wobjdata w1 := [FALSE,TRUE,"",{half},[{self.pos(self.small())},{self.rot()}]];')
        out += [f"{self.one('CONST', 'PERS', 'VAR', 'LOCAL VAR')} robtarget p{k}:={self.target()};" for k in range(4)]
        out += [f"CONST jointtarget j{k}:={self.joints()};" for k in range(2)]
        out += [f"VAR robtarget arr{{2}}:=[{self.target()},\n   {self.target()}];", "VAR num n:=0; ! p1:=p2;"]
        self.procedures = []
        for name, parameters in (
            ("sub", ""),
            ("lift", "INOUT robtarget r"),
            ("go", "robtarget r"),
            ("adjust", "PERS tooldata r"),
        ):
            body = {"lift": ["r.trans.z:=r.trans.z+5;"], "adjust": ["r.tframe.trans.x:=40;"]}.get(name)
            body = body or self.lines(self.KINDS if self.chance(0.4) else ("move", "talk"), 1, 2)
            if name == "go":
                body.append("MoveL r,v100,fine,t1;")
            out += [f"PROC {name}({parameters})", *body, "ENDPROC"]
            self.procedures.append(name)
        out += ["PROC main()", *self.lines(self.KINDS, 0, 9)]
        if self.chance(0.3):
            out += ["again:", *self.lines(("move", "assign"), 1, 2), "n:=n+1;", "IF n<4 GOTO again;"]
        out += ["ENDPROC", "ENDMODULE", ""]
        return "\n".join(self.written(line) for line in out)

    def written(self, line):
        """A line in other case, with other blanks."""
        line = self.one(line, line, line.upper(), line.lower(), line.swapcase())
        return self.one("", "  ", "\t") + line.replace(":=", self.one(":=", " := ", ":= "))

    def goal(self):
        return self.one(*("p0", "p1", "p2", "p3") * 2, "arr{1}", "arr{2}", self.target(), "Offs(p2,0,0,50)", "arr{ 1 }")

    def move(self, depth):
        comment = self.one("", "", " ! p2.trans.z:=5;")
        wobj = self.one("", "\\WObj:=w1", " \\WObj:=w1", "\\wobj := w1")
        tool = self.one("t1", "t1", "t2", "tool0")
        if self.chance(0.2):
            return f"MoveAbsJ {self.one('j0', 'j1', self.joints())}\\NoEOffs, v1000, z50, {tool}{wobj};{comment}"
        if self.chance(0.1):
            return f"MoveC {self.goal()},{self.goal()} ,v100,fine,{tool}{wobj};"
        return f"{self.one('MoveL', 'MoveJ')} {self.goal()} , v100,{self.one(' fine', 'z10')},{tool}{wobj};{comment}"

    def simple(self):
        """A statement that sets something."""
        name = self.one("p0", "p1", "arr{2}") if self.chance(0.5) else "n"
        if name == "n":
            return self.one("n:=n+1;", "SetDO do1,1;", "Add n,1;")
        return self.one(
            f"{name}.trans.z:={name}.trans.z+5;", f"{name}:=p3;", f"{name}.trans.x := 500;", "Add p0.trans.z,5;"
        )

    def assign(self, depth):
        return self.simple()

    def condition(self):
        return self.one("n=1", "n<2", "(di1)", "di1", "(p2.trans.z>350)" if self.chance(0.3) else "n>2")

    def compact(self, depth):
        return f"IF {self.condition()} {self.one(self.simple(), self.move(2), 't1.tframe.trans.z:=150;')}"

    def branch(self, depth):
        out = [f"IF {self.condition()} THEN {self.simple()}", *self.lines(self.KINDS, depth + 1, 1)]
        if self.chance(0.3):
            out += [f"ELSEIF {self.condition()} THEN", *self.lines(self.KINDS, depth + 1, 1)]
        if self.chance(0.5):
            out += [f"ELSE {self.simple()}"]
        return [*out, "ENDIF"]

    def test(self, depth):
        before, within = self.one(("", ""), ("", ""), ("PDispSet [[100,0,200],[1,0,0,0]];", "PDispOff;"))
        return [
            f"{before}TEST n CASE 1,2: {self.simple()}",
            f"CASE 3: {within}{self.simple()}{self.move(2)}",
            f"DEFAULT: {self.move(2)}",
            f"ENDTEST {within}",
        ]

    def loop(self, depth):
        if self.chance(0.5):
            return [f"FOR i FROM 1 TO 2 DO {self.simple()}", *self.lines(self.KINDS, depth + 1, 1), "ENDFOR"]
        return [f"WHILE {self.one('n<3', 'di1')} DO n:=n+1;", *self.lines(self.KINDS, depth + 1, 1), "ENDWHILE"]

    def call(self, depth):
        if not self.procedures:
            return self.move(depth)
        name = self.one(*self.procedures)
        given = {"lift": self.one("p0", "p1", "arr{1}"), "go": self.one("p2", "p3"), "adjust": "t2"}.get(name, "")
        return f"{name} {given};" if self.chance(0.5) or name != "adjust" else "n:=n+1;"

    def displace(self, depth):
        if self.chance(0.6):
            return self.move(depth)
        return self.one("PDispSet [[100,0,200],[1,0,0,0]];", "PDispOff;", "ConfL\\On;", "ConfJ \\Off;")

    def tool(self, depth):
        if self.chance(0.7):
            return self.move(depth)
        return self.one("t2.tframe.trans.z:=120;", f"t2:={self.tooldata()};", "n:=2;")

    def talk(self, depth):
        return self.one('TPWrite "p2:=p1; MoveL p3";', "WaitTime 0.1;", "SetDO do1 ,1;")


# ---------------------------------------------------------------- KRL


class KrlMaker(_Maker):
    KINDS = (
        "move",
        "move",
        "move",
        "assign",
        "branch",
        "compact",
        "loop",
        "switch",
        "call",
        "talk",
        "select",
        "select",
    )

    def pose(self, values=None):
        numbers = [*(self.xyz() if values is None else values), *np.degrees(self.angles())]
        return "{" + ",".join(f"{k} {v:.4f}" for k, v in zip("XYZABC", numbers, strict=True)) + "}"

    def axes(self):
        return "{" + ",".join(f"A{k} {v:.4f}" for k, v in enumerate(self.rng.uniform(-60, 60, 6), 1)) + "}"

    def make(self):
        dat = ["&ACCESS RVP", "DEFDAT PART"]
        for k in (1, 2):
            dat += [f"TOOL_DATA[{k}]={self.pose(self.small())}", f"BASE_DATA[{k}]={self.pose(self.small())}"]
            dat.append(f"DECL FDAT FP{k}={{TOOL_NO {k},BASE_NO {self.one(1, 2)},IPO_FRAME #BASE}}")
            dat.append(f"DECL FRAME F{k}={self.pose(self.small())}")
        dat += [f"DECL E6POS XP{k}={self.pose()}" for k in range(4)]
        dat += [f"{self.one('DECL ', '')}E6AXIS XA{k}={self.axes()}" for k in range(2)]
        dat += ["DECL INT N=0", "ENDDAT", ""]
        src, self.routines, subs = ["DEF PART( )"], ["SUB", "LIFT", "GO"], []
        for name, parameters in (("SUB", ""), ("LIFT", "R:OUT"), ("GO", "R:IN")):
            body = (
                ["R.Z=R.Z+5"]
                if name == "LIFT"
                else self.lines(self.KINDS if self.chance(0.4) else ("move", "talk"), 1, 2)
            )
            subs += [f"DEF {name}({parameters})", *body, *(["LIN R"] if name == "GO" else []), "END"]
        src += ["BAS (#TOOL,1)", self.one("BAS(#BASE, 2)", "$BASE=$NULLFRAME", "$BASE = F1")]
        src += self.lines(self.KINDS, 0, 9)
        if self.chance(0.3):
            src += ["AGAIN:", *self.lines(("move", "assign"), 1, 2), "N=N+1", "IF N<4 THEN", "GOTO AGAIN", "ENDIF"]
        text = "\n".join(self.written(line) for line in [*src, "END", *subs, ""])
        return text, "\n".join(dat)

    def written(self, line):
        line = self.one(line, line, line.lower(), line.title() if "{" not in line and "(" not in line else line)
        return self.one("", "  ", "\t") + line

    def goal(self):
        return self.one("XP0", "XP1", "XP2", "XP3", "XP2", "XP3", self.pose())

    def move(self, depth):
        comment = self.one("", "", " ; $TOOL.Z=5")
        if self.chance(0.2):
            return f"PTP {self.one('XA0', 'XA1', self.axes())} C_PTP"
        if self.chance(0.1):
            return f"CIRC {self.goal()}, {self.goal()},CA 45"
        if self.chance(0.1):
            return f"SLIN {self.goal()} WITH $VEL.CP=0.1, {self.one('$TOOL', '$BASE')}={self.pose(self.small())}"
        return f"{self.one('LIN', 'PTP')} {self.goal()}{self.one('', ' C_DIS', ' C_PTP')}{comment}"

    def simple(self):
        return self.one(
            "N=N+1", "N = N + 2", "$OUT[1]=TRUE", "XP0.Z=XP0.Z+5", "XP1=XP3", f"XP1 = {self.pose()}", "$TOOL.Z=200"
        )

    def assign(self, depth):
        return self.simple() if self.chance(0.5) else "N=N+1"

    def condition(self):
        return self.one("N==1", "N<3", "$IN[1]", "($IN[2])", "XP2.Z>350" if self.chance(0.3) else "N>1")

    def compact(self, depth):
        return f"IF {self.condition()} THEN {self.simple()} {self.one('', 'ELSE N=N+1 ')}ENDIF"

    def branch(self, depth):
        out = [f"IF {self.condition()} THEN", *self.lines(self.KINDS, depth + 1, 2)]
        if self.chance(0.5):
            out += ["ELSE", *self.lines(self.KINDS, depth + 1, 1)]
        return [*out, "ENDIF"]

    def switch(self, depth):
        inner = self.lines(self.KINDS, depth + 1, 1)
        return ["SWITCH N", "CASE 1,2", *inner, "CASE 3", self.simple(), "DEFAULT", self.move(2), "ENDSWITCH"]

    def loop(self, depth):
        inner = self.lines(self.KINDS, depth + 1, 2)
        return self.one(
            ["FOR I=1 TO 2", *inner, "ENDFOR"],
            ["WHILE $IN[3]", *inner, "ENDWHILE"],
            ["REPEAT", *inner, "UNTIL $IN[4]"],
            ["LOOP", *inner, "IF $IN[5] THEN", "EXIT", "ENDIF", "ENDLOOP"],
        )

    def call(self, depth):
        if not getattr(self, "routines", None):
            return self.move(depth)
        name = self.one(*self.routines)
        given = {"LIFT": self.one("XP0", "XP1", "F2"), "GO": self.one("XP2", "XP3")}.get(name, "")
        return f"{name} ({given})"

    def select(self, depth):
        if self.chance(0.4):
            return self.move(depth)
        return self.one(
            "BAS(#TOOL,2)",
            "BAS (#BASE, 1)",
            f"$TOOL={self.pose(self.small())}",
            "$BASE = BASE_DATA[2]",
            "$BASE.X=100",
            "$BASE=F2",
            "F2.Z=F2.Z+10",
            f"TOOL_DATA[2]={self.pose(self.small())}",
            "TOOL_DATA[2].Z=90",
            ["FDAT_ACT=FP1", "BAS(#PTP_PARAMS,100)"],
            ["FDAT_ACT=FP2", "BAS(#FRAMES)"],
        )

    def talk(self, depth):
        return self.one(";FOLD PTP XP0.Z=5 $TOOL", "WAIT SEC 0.1", "$OUT[2]=FALSE", "CONTINUE")


# ---------------------------------------------------------------- FANUC


def fanuc_position(name, xyz, turns, flip="N"):
    """Lines of a position [mm, deg]."""
    (x, y, z), (w, p, r) = xyz, turns
    return [
        f"P[{name}]{{",
        "   GP1:",
        f"\tUF : 1, UT : 2,\t\tCONFIG : '{flip} U T, 0, 0, 0',",
        f"\tX = {x:9.3f}  mm,\tY = {y:9.3f}  mm,\tZ = {z:9.3f}  mm,",
        f"\tW = {w:9.3f} deg,\tP = {p:9.3f} deg,\tR = {r:9.3f} deg",
        "};",
    ]


class FanucMaker(_Maker):
    KINDS = ("move", "move", "move", "register", "branch", "compact", "select", "jump", "talk", "copy")

    def make(self):
        self.labels, main = 0, ["UFRAME_NUM=1", "UTOOL_NUM=2"] if self.chance(0.7) else []
        main += self.lines(self.KINDS, 0, 12)
        text = ["/PROG  PART", "/ATTR", 'COMMENT = "L P[1]";', "/MN"]
        text += [
            f"{self.one(f'{k:4d}', '')}:{self.one('', '  ')}{line} {self.one('', '   ')};"
            for k, line in enumerate(main, 1)
        ]
        text.append("/POS")
        for k in range(1, 5):
            xyz, turns = self.xyz(), np.degrees(self.angles())
            text += fanuc_position(f"{k}{self.one('', f':{chr(34)}P 1 = 5;{chr(34)}')}", xyz, turns)
        shown = ",\t".join(f"J{j}= {v:9.3f} deg" for j, v in enumerate(self.rng.uniform(-60, 60, 6), 1))
        return "\n".join([*text, "P[5]{", "   GP1:", "\tUF : 1, UT : 2,", "\t" + shown, "};", "/END", ""])

    def move(self, depth):
        place = self.one(*[f"P[{k}{self.one('', ':L P 2 ;x', ':a')}]" for k in (1, 2, 3, 4, 4, 5)])
        if self.chance(0.08):
            place = self.one("P[R[1]]", "PR[2]")
        option = self.one("", "", "", " ACC50", " Offset,PR[1]", "")
        if place.startswith("P[5"):
            return f"J {place} 50% {self.one('FINE', 'CNT50')}"
        if self.chance(0.1):
            return f"C P[1] P[{self.one(2, 3)}] 100mm/sec FINE"
        speed, stop = self.one("100mm/sec", "50%", "R[5]mm/sec"), self.one("FINE", "CNT100")
        return f"{self.one('L', 'J')} {place} {speed} {stop}{option}"

    def register(self, depth):
        return self.one("R[1]=R[1]+1", "R[2:count]=2", "DO[1]=ON", "R[1]=PR[1,3]" if self.chance(0.3) else "R[3]=0")

    def copy(self, depth):
        return self.one("PR[1]=P[3]", "PR[1,3]=10", "PR[4]=P[4:up]", "R[1]=1", "R[3]=2")

    def condition(self):
        return self.one("R[1]=1", "R[1]<3", "DI[1]=ON", "R[2]>R[3]", "PR[1,3]>350" if self.chance(0.2) else "R[1]<>2")

    def select(self, depth):
        if self.chance(0.6):
            return self.move(depth)
        return self.one("UFRAME_NUM=1", "UFRAME_NUM=3", "UTOOL_NUM=2", "UFRAME[1]=PR[1]", "R[1]=2")

    def compact(self, depth):
        return f"IF {self.condition()},{self.one('R[1]=R[1]+1', 'UFRAME_NUM=3', 'UTOOL_NUM=2', 'DO[2]=OFF')}"

    def branch(self, depth):
        out = [f"IF ({self.condition()}) THEN", *self.lines(self.KINDS, depth + 1, 2)]
        if self.chance(0.5):
            out += ["ELSE", *self.lines(self.KINDS, depth + 1, 1)]
        return [*out, "ENDIF"]

    def jump(self, depth):
        if depth:
            return self.move(depth)
        self.labels += 1
        label = self.labels
        inner = self.lines(self.KINDS, 1, 2)
        return self.one(
            [f"LBL[{label}:back]", *inner, "R[1]=R[1]+1", f"IF R[1]<3,JMP LBL[{label}]"],
            [f"IF {self.condition()},JMP LBL[{label}]", *inner, f"LBL[{label}]"],
        )

    def talk(self, depth):
        return self.one("!L P[1] UFRAME_NUM=3", "WAIT   .10(sec)", "DO[1:ok]=OFF", "MESSAGE[don't: UTOOL_NUM=1]")
