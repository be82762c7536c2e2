"""Programs in the languages of controllers for tests, and controllers that run them: no code of the engine in them.

The arm is that of `six_axis_arm`. A controller reads its own language with the patterns below, makes joints of poses by
its nominal kinematics, starting from the joints that the pose is known to be near to, and the true robot goes there.
"""

import re

import numpy as np
from scipy.spatial.transform import Rotation

from tests.six_axis_arm import _JOINTS

NUMBER = r"-?\d+\.?\d*(?:[eE][-+]?\d+)?"


def transform(rotation, xyz):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), xyz
    return T


NOMINAL = [
    (transform(Rotation.identity(), np.array(xyz.split(), float)), np.array(axis.split(), float))
    for _, axis, xyz in _JOINTS
]
TOOL = transform(Rotation.from_euler("ZYX", [30, 20, -10], degrees=True), [0.04, -0.02, 0.15])
FRAME = transform(Rotation.from_euler("ZYX", [-15, 5, 3], degrees=True), [0.35, -0.1, 0.25])


def flange(q, links=NOMINAL):
    """T_base_flange by hand."""
    T = np.eye(4)
    for (origin, axis), angle in zip(links, q, strict=True):
        T = T @ origin @ transform(Rotation.from_rotvec(angle * axis), np.zeros(3))
    return T


def joints_of(T, near):
    """Joints of the nominal arm that bring the flange to T, by Newton with central differences."""
    q = np.array(near, float)
    for _ in range(30):
        miss = _miss(T, q)
        if np.linalg.norm(miss) < 1e-12:
            return q
        steps = 1e-6 * np.eye(6)
        J = np.column_stack([(_miss(T, q + step) - _miss(T, q - step)) / 2e-6 for step in steps])
        q = q - np.linalg.solve(J, miss)
    raise AssertionError("the controller does not reach the pose")


def _miss(T, q):
    at = flange(q)
    return np.append(at[:3, 3] - T[:3, 3], Rotation.from_matrix(at[:3, :3] @ T[:3, :3].T).as_rotvec())


def rows(count, seed=7):
    """Joints well inside the limits, away from singular poses, of several postures."""
    rng = np.random.default_rng(seed)
    q = rng.uniform([-1.2, -0.4, 0.2, -1.0, 0.4, -1.5], [1.2, 0.6, 1.0, 1.0, 1.2, 1.5], (count, 6))
    q[1::4, 4] *= -1  # the wrist flipped
    return q


def tip(q):
    """The pose of the tool in the frame: what a program has."""
    return np.linalg.inv(FRAME) @ flange(q) @ TOOL


# ---------------------------------------------------------------- URScript


def _ur(T):
    values = (*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_rotvec())
    return "p[" + ", ".join(f"{v:.6f}" for v in values) + "]"


def urscript(q):
    """Joints, poses, poses in a feature, with a stated branch."""
    lines = ["def part():", f"  set_tcp({_ur(TOOL)})  # tool 1.5", f"  feature = {_ur(FRAME)}", "  speed = 0.25"]
    lines += [f"  global joints_{k} = [{', '.join(f'{v:.6f}' for v in row)}]" for k, row in enumerate(q)]
    lines += [f"  global point_{k} = {_ur(flange(row) @ TOOL)}" for k, row in enumerate(q)]
    for k, row in enumerate(q):
        lines += [
            f"  movej(joints_{k}, a=1.4, v=speed)",
            f'  textmsg("at [1, 2, 3, 4, 5, 6]", {k})',
            f"  movej(get_inverse_kin(point_{k}, qnear=joints_{k}), a=1.4, v=1.05)",
            f"  movel(pose_trans(feature, {_ur(tip(row))}), a=1.2, v=0.25, r=0.001)",
        ]
    return "\r\n".join(
        [*lines, "  if speed > 0.1:", "    movel(pose_add(point_0, p[0,0,0.1,0,0,0]))", "  end", "end", ""]
    )


def run_urscript(text, q):
    """Joints to which the controller goes, (n, 6), and which row each is of."""
    lists = [np.array(numbers.split(","), float) for numbers in re.findall(r"joints_\d+ = \[(.*?)\]", text)]
    points = [np.array(numbers.split(","), float) for numbers in re.findall(r"point_\d+ = p\[(.*?)\]", text)]
    inline = [np.array(numbers.split(","), float) for numbers in re.findall(r"pose_trans\(feature, p\[(.*?)\]\)", text)]

    def pose(values):
        return transform(Rotation.from_rotvec(values[3:]), values[:3])

    tool = np.linalg.inv(TOOL)
    went = [*lists]
    went += [joints_of(pose(values) @ tool, near) for values, near in zip(points, q, strict=True)]
    went += [joints_of(FRAME @ pose(values) @ tool, near) for values, near in zip(inline, q, strict=True)]
    return np.array(went), np.tile(np.arange(len(q)), 3)


# ---------------------------------------------------------------- RAPID


def _abb(T):
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat()
    position = ",".join(f"{1e3 * v:.4f}" for v in T[:3, 3])
    return f"[{position}],[{w:.9f},{x:.9f},{y:.9f},{z:.9f}]"


def rapid(q):
    """A module with constants, an array, arguments that are written out, a tool and a work object."""
    none = "[9E9,9E9,9E9,9E9,9E9,9E9]"
    half = ",".join(["[0,0,0]", "[1,0,0,0]"])
    lines = [
        "%%%\n  VERSION:1\n  LANGUAGE:ENGLISH\n%%%\nMODULE Part",
        f"  PERS tooldata tGrip:=[TRUE,[{_abb(TOOL)}],[1.5,[0,0,50],[1,0,0,0],0,0,0]];",
        f'  TASK PERS wobjdata wTable:=[FALSE,TRUE,"",[{half}],[{_abb(FRAME)}]];',
        "  ! a remark with numbers 1.5 [2,3]",
    ]
    for k, row in enumerate(q):
        cf = [int(np.floor(row[j] / (np.pi / 2))) for j in (0, 3, 5)]
        lines.append(f"  CONST robtarget p{k}:=[{_abb(tip(row))},[{cf[0]},{cf[1]},{cf[2]},0],{none}];")
        lines.append(f"  CONST jointtarget j{k}:=[[{','.join(f'{np.degrees(v):.5f}' for v in row)}],{none}];")
    lines.append("  PROC main()\n    ConfL\\On;\n    VAR num n:=0;")
    for k in range(len(q)):
        lines.append(f"    MoveAbsJ j{k}\\NoEOffs, v1000, z50, tGrip\\WObj:=wTable;")
        lines.append(f"    MoveL p{k}, v100\\V:=80, fine, tGrip \\WObj:=wTable;  ! point {k}")
    lines.append("    MoveL Offs(p0,0,0,50), v100, fine, tGrip\\WObj:=wTable;")
    return "\n".join([*lines, "    MoveJ pHome, v100, fine, tool0;", "  ENDPROC", "ENDMODULE", ""])


def run_rapid(text, q):
    went = []
    for name, near in ((f"p{k}", row) for k, row in enumerate(q)):
        v = np.array(re.findall(NUMBER, re.search(rf"robtarget {name}:=(.*?);", text)[1])[:7], float)
        T = transform(Rotation.from_quat([*v[4:7], v[3]]), v[:3] / 1e3)
        went.append(joints_of(FRAME @ T @ np.linalg.inv(TOOL), near))
    for k in range(len(q)):
        v = np.array(re.findall(NUMBER, re.search(rf"jointtarget j{k}:=(.*?);", text)[1])[:6], float)
        went.append(np.radians(v))
    return np.array(went), np.tile(np.arange(len(q)), 2)


# ---------------------------------------------------------------- KRL


def _kuka(T):
    angles = Rotation.from_matrix(T[:3, :3]).as_euler("ZYX", degrees=True)
    shown = [f"{name} {v:.6f}" for name, v in zip("XYZABC", (*(1e3 * T[:3, 3]), *angles), strict=True)]
    return ",".join(shown)


def _turns(q):
    return sum(1 << k for k in range(6) if q[k] < 0)


def krl(q):
    """A .src and a .dat: inline forms, expert's statements, a position that is written out."""
    dat = [
        "&ACCESS RVP",
        "DEFDAT  PART",
        ";FOLD EXTERNAL DECLARATIONS",
        "DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE}",
    ]
    dat += [f"TOOL_DATA[1]={{{_kuka(TOOL)}}}", f"BASE_DATA[2]={{{_kuka(FRAME)}}}"]
    src = ["&ACCESS RVP", "DEF PART( )", "BAS (#INITMOV,0 )"]
    for k, row in enumerate(q):
        dat.append(
            f"DECL E6POS XP{k}={{{_kuka(tip(row))},S 2,T {_turns(row)},E1 0.0,E2 0.0,E3 0.0,E4 0.0,E5 0.0,E6 0.0}}"
        )
        axes = ",".join(f"A{j + 1} {np.degrees(v):.5f}" for j, v in enumerate(row))
        dat.append(f"DECL E6AXIS XA{k}={{{axes},E1 0.0}}")
        src += [
            f";FOLD PTP P{k} Vel=100 % PDAT1 Tool[1]:grip Base[2]:table;%{{PE}}%R 8.3.22",
            "FDAT_ACT=FP1",
            "BAS(#PTP_PARAMS,100)",
            f"PTP XP{k} C_PTP",
            ";ENDFOLD",
            f"PTP XA{k}",
        ]
    written_out = f"LIN {{{_kuka(tip(q[0]))}}} C_DIS"
    src += [
        "$TOOL=TOOL_DATA[1]",
        "$BASE=BASE_DATA[2]",
        written_out,
        "LIN_REL {Z 10}",
        "LIN XP0:{X 10,Y 0,Z 0,A 0,B 0,C 0}",
        "END",
        "",
    ]
    return "\n".join(src), "\n".join([*dat, "ENDDAT", ""])


def run_krl(src, dat, q):
    def pose(text):
        v = np.array([re.search(rf"\b{name} ({NUMBER})", text)[1] for name in "XYZABC"], float)
        T = transform(Rotation.from_euler("ZYX", v[3:], degrees=True), v[:3] / 1e3)
        return FRAME @ T @ np.linalg.inv(TOOL)

    went = [joints_of(pose(re.search(rf"XP{k}=(.*)", dat)[1]), near) for k, near in enumerate(q)]
    for k in range(len(q)):
        text = re.search(rf"XA{k}=(.*)", dat)[1]
        went.append(np.radians([float(re.search(rf"A{j} ({NUMBER})", text)[1]) for j in range(1, 7)]))
    went.append(joints_of(pose(re.search(r"LIN (\{X.*)", src)[1]), q[0]))
    return np.array(went), np.append(np.tile(np.arange(len(q)), 2), 0)


# ---------------------------------------------------------------- FANUC


def fanuc(q):
    """A teach pendant program; its third joint counts against J2, as on the pendant."""
    head = ["/PROG  PART", "/ATTR", 'COMMENT = "1.5 mm";', "LINE_COUNT = 9;", "/MN"]
    motion, places = [], ["/POS"]
    for k, row in enumerate(q):
        motion.append(f"L P[{2 * k + 1}:point {k}] 100mm/sec FINE    ;")
        motion.append(f"J P[{2 * k + 2}] 50% CNT50    ;")
        T = tip(row)
        w, p, r = Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)
        x, y, z = 1e3 * T[:3, 3]
        flip = "F" if row[4] < 0 else "N"
        places += [
            f'P[{2 * k + 1}:"point {k}"]{{',
            "   GP1:",
            f"\tUF : 1, UT : 2,\t\tCONFIG : '{flip} U T, 0, 0, 0',",
            f"\tX = {x:9.3f}  mm,\tY = {y:9.3f}  mm,\tZ = {z:9.3f}  mm,",
            f"\tW = {w:9.3f} deg,\tP = {p:9.3f} deg,\tR = {r:9.3f} deg",
            "};",
        ]
        v = np.degrees(row)
        v[2] -= v[1]
        shown = [f"J{j}= {angle:9.3f} deg" for j, angle in enumerate(v, 1)]
        places += [
            f"P[{2 * k + 2}]{{",
            "   GP1:",
            "\tUF : 1, UT : 2,",
            f"\t{',	'.join(shown[:3])},",
            f"\t{',	'.join(shown[3:])}",
            "};",
        ]
    motion += ["  !P[99] is not used 1.5 ;", "L PR[3] 100mm/sec FINE    ;", "L P[1] 100mm/sec FINE Offset,PR[1]    ;"]
    numbered = [f"{k:4d}:{line}" for k, line in enumerate(motion, 1)]
    return "\n".join([*head, *numbered, *places, "/END", ""])


def run_fanuc(text, q):
    went = []
    blocks = dict(re.findall(r"(?m)^P\[(\d+)[^\]]*\]\{(.*?)^\};", text, re.DOTALL))
    for k, near in enumerate(q):
        block = blocks[str(2 * k + 1)]
        v = np.array([re.search(rf"\b{name} =\s*({NUMBER})", block)[1] for name in "XYZWPR"], float)
        T = transform(Rotation.from_euler("xyz", v[3:], degrees=True), v[:3] / 1e3)
        went.append(joints_of(FRAME @ T @ np.linalg.inv(TOOL), near))
    for k in range(len(q)):
        block = blocks[str(2 * k + 2)]
        v = np.radians([float(re.search(rf"J{j}=\s*({NUMBER})", block)[1]) for j in range(1, 7)])
        v[2] += v[1]
        went.append(v)
    return np.array(went), np.tile(np.arange(len(q)), 2)


def frames_table():
    lines = ["name,x [mm],y [mm],z [mm],rx [deg],ry [deg],rz [deg]"]
    for name, T in (("UFRAME[1]", FRAME), ("UTOOL[2]", TOOL)):
        x, y, z = 1e3 * T[:3, 3]
        rx, ry, rz = Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)
        lines.append(f"{name},{x!r},{y!r},{z!r},{rx!r},{ry!r},{rz!r}".replace("np.float64(", "").replace(")", ""))
    return "\n".join(lines) + "\n"
