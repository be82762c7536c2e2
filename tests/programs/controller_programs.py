"""Programs in the languages of controllers for tests, and controllers that run them: no code of the engine in them.

The arm is that of `six_axis_arm`. Controllers are those of `programs_run`; joints of poses are made by the nominal
kinematics, starting from the joints that the pose is known to be near to, and the true robot goes there.
"""

import contextlib
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from tests.programs import programs_run as controllers
from tests.programs.programs_made import fanuc_position
from tests.six_axis_arm import _JOINTS

NUMBER = r"-?\d+\.?\d*(?:[eE][-+]?\d+)?"


NOMINAL = [
    (controllers.pose(np.array(xyz.split(), float), Rotation.identity()), np.array(axis.split(), float))
    for _, axis, xyz in _JOINTS
]
TOOL = controllers.pose([0.04, -0.02, 0.15], Rotation.from_euler("ZYX", [30, 20, -10], degrees=True))
FRAME = controllers.pose([0.35, -0.1, 0.25], Rotation.from_euler("ZYX", [-15, 5, 3], degrees=True))


def flange(q, links=NOMINAL):
    """T_base_flange by hand."""
    T = np.eye(4)
    for (origin, axis), angle in zip(links, q, strict=True):
        T = T @ origin @ controllers.pose(np.zeros(3), Rotation.from_rotvec(angle * axis))
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


# ---------------------------------------------------------------- FANUC


def fanuc(q):
    """A teach pendant program; its third joint counts against J2, as on the pendant."""
    head = ["/PROG  PART", "/ATTR", 'COMMENT = "1.5 mm";', "LINE_COUNT = 9;", "/MN"]
    motion, places = [], ["/POS"]
    for k, row in enumerate(q):
        motion.append(f"L P[{2 * k + 1}:point {k}] 100mm/sec FINE    ;")
        motion.append(f"J P[{2 * k + 2}] 50% CNT50    ;")
        T = tip(row)
        turns = Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)
        flip = "F" if row[4] < 0 else "N"
        places += fanuc_position(f'{2 * k + 1}:"point {k}"', 1e3 * T[:3, 3], turns, flip)
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


def run(language, texts, q):
    """Joints to which the controller goes, (n, 6), and which row each is of; moves that are computed come last."""
    read = {
        "URScript": lambda: controllers.URScript(texts[0], 0),
        "RAPID": lambda: controllers.Rapid(texts[0], 0),
        "KRL": lambda: controllers.Krl(*texts, 0),
        "FANUC": lambda: controllers.Fanuc(texts[0], {"UFRAME[1]": FRAME, "UTOOL[2]": TOOL}, 0),
    }
    controller, rows = read[language](), np.repeat(np.arange(len(q)), 3 if language == "URScript" else 2)
    rows = np.append(rows, 0) if language == "KRL" else rows
    with contextlib.suppress(KeyError, NameError):  # of what the program does not say
        controller.run()
    went = []
    for row, move in zip(rows, controller.moves, strict=False):
        is_pose = move.to.shape == (4, 4)
        counted = 0 if is_pose or language != "FANUC" else move.to[1] * np.eye(6)[2]
        went.append(joints_of(move.to, q[row]) if is_pose else move.to + counted)
    return np.array(went), rows


def frames_table(frames=MappingProxyType({"UFRAME[1]": FRAME, "UTOOL[2]": TOOL})):
    """Frames by name as the file that FANUC's programs need."""
    rows = ["name,x,y,z,rx,ry,rz"]
    for name, T in frames.items():
        numbers = (*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_euler("xyz"))
        rows.append(f"{name}," + ",".join(f"{v:.17g}" for v in numbers))
    return "\n".join(rows) + "\n"
