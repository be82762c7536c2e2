"""A robot's functions as one C99 file: tables of facts, and code that computes with them without allocation."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.robots.terms.term import REFERENCE_TEMPERATURE
from calib.exporting.functions.facts import SOURCES, RobotFacts, header_lines, template
from calib.exporting.functions.trees import FunctionTree

_FUNCTIONS = """\
int @_forward(const double q[@_N], const @_conditions *given, int tool, double pose[16]);
    Pose of a tool, four rows of four [m]. Returns 1; or 0 if the pose is not known: then it is NaN.
size_t @_forward_many(size_t n, const double *q, const @_conditions *given, int tool, double *poses);
    The same for an array of n commands, with an array of n conditions or NULL. Returns how many poses are known.
int @_jacobian(const double q[@_N], const @_conditions *given, int tool, double jacobian[6 * @_N]);
    Motion of a tool by each command, six rows: x, y, z, rotation vector, in the measurement frame. Returns 1 or 0.
int @_inverse(const double pose[16], const double start[@_N], const @_conditions *given, int tool,
              const int use[6], double q[@_N]);
    Commands within the joint limits that bring a tool to a pose, to 1e-10 (m and rad), by damped Newton steps from a
    start. If these fail, the search begins again at home; its result may be another posture. `use` says which of x, y,
    z, rx, ry, rz shall be reached; NULL: all. Returns 1; or 0 if nothing was found: then q is NaN.

Nothing is allocated, and nothing is kept between calls. Include the file where it is needed; link with -lm."""


def c_text(facts: RobotFacts, lines: Sequence[str]) -> str:
    """Return the C file of a robot; `lines` are comments on the origin of the numbers."""
    parts = [_comment(facts, lines), _sizes(facts), template("c_types"), _tables(facts)]
    parts += [template(name) for name in ("c_code", "c_loops", "c_joints", "c_doors")]
    prefix = c_name(facts.robot.name)
    return f"{''.join(parts)}\n#endif\n".replace("@", prefix)


def c_name(name: str) -> str:
    """Return the prefix of names in C, made from a robot's name."""
    plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").lower()
    return plain if plain and not plain[0].isdigit() else f"robot_{plain}".rstrip("_")


def _comment(facts: RobotFacts, lines: Sequence[str]) -> str:
    text = header_lines(facts, [line.replace("@", "(at)") for line in lines], "@_base()")
    text += ["", *_FUNCTIONS.splitlines()]
    if facts.conditions:
        text += ["", "Joint errors depend on these members of the conditions; where NULL is given, they are neutral:"]
        text += [f"    {name}: {meaning}; neutral: {value:g}" for name, (value, meaning) in facts.conditions.items()]
    else:
        text += ["", "This robot's joint errors depend on no conditions; give NULL."]
    body = "\n".join(f" * {line}".rstrip() for line in "\n".join(text).replace("*/", "* /").splitlines())
    return f"/*\n{body}\n */\n"


def _sizes(facts: RobotFacts) -> str:
    trees = [facts.tree, *([facts.gravity.tree] if facts.gravity else [])]
    sizes = {
        "N": len(facts.robot.joint_names),
        "N_DRIVEN": facts.tree.n_driven,
        "N_PASSIVE": facts.tree.n_passive,
        "N_TOOLS": len(facts.robot.target_names),
        "N_SHARES": len(facts.shares),
        "N_WAVES": len(facts.waves),
        "MAX_JOINTS": max(len(tree.joints) for tree in trees),
        "MAX_PASSIVE": max(1, *(tree.n_passive for tree in trees)),
        "MAX_X": max(tree.n_driven + tree.n_passive for tree in trees),
        "has_gravity": int(facts.gravity is not None),
    }
    lines = ["#ifndef @_INCLUDED", "#define @_INCLUDED", "", "#include <math.h>", "#include <stddef.h>", ""]
    lines += [f"#define @_{name} {size}" for name, size in sizes.items()]
    lines += [f"#define @_LENGTH {_number(facts.robot.mechanism.length)} /* compares metres and radians */"]
    lines += [f"#define @_TURN {_number(2.0 * np.pi)}", f"#define @_REFERENCE {_number(REFERENCE_TEMPERATURE)}", ""]
    return "\n".join(lines) + "\n"


def _tables(facts: RobotFacts) -> str:
    scale = facts.tree.scale[: len(facts.robot.joint_names)]
    neutral = [[0.0], 0.0, REFERENCE_TEMPERATURE, 0.0]  # approach, time, temperature, load
    text = [
        _array("double @_lower[]", facts.lower),
        _array("double @_upper[]", facts.upper),
        _array("double @_home[]", facts.home),
        _array("double @_joint_scale[]", scale),
        f"static const @_conditions @_neutral = {_literal(neutral)};\n",
    ]
    if facts.base is not None:
        table = _array("double pose[16]", facts.base.ravel()).strip()
        text.append(f"static inline const double *@_base(void) {{\n{table}\n    return pose;\n}}\n")
    text.append(_tree("@_robot", facts.tree))
    text += _errors(facts)
    gravity, own = facts.gravity, ["&@_robot", "NULL", 0, [0.0], [0.0]]
    if gravity is not None:
        text.append(_tree("@_nominal", gravity.tree))
        bodies = np.vstack([np.zeros(4), np.column_stack([gravity.masses, gravity.moments])])
        text.append(_structs("double @_bodies[][4]", bodies))
        own = ["&@_nominal", "@_bodies", *gravity.payload, gravity.acceleration]
    return "".join([*text, f"static const @_gravity @_own_gravity = {_literal(own)};\n"])


def _errors(facts: RobotFacts) -> list[str]:
    """Tables of the joint errors; an empty table has one unused entry, as C requires."""
    text = []
    for k, wave in enumerate(facts.waves):
        text += [_array(f"double @_sine_{k}[]", wave.sine), _array(f"double @_cosine_{k}[]", wave.cosine)]
    waves = [
        (wave.driven, wave.place, len(wave.sine), wave.base, f"@_sine_{k}", f"@_cosine_{k}")
        for k, wave in enumerate(facts.waves)
    ]
    shares = [(share.driven, f"@_{SOURCES[share.source].upper()}", *share[2:]) for share in facts.shares]
    text.append(_structs("@_share @_shares[]", shares or [(0, "@_ONE", 0, 0.0, 0.0)]))
    text.append(_structs("@_wave @_waves[]", waves or [(0, 0, 0, 0.0, "NULL", "NULL")]))
    return text


def _tree(name: str, tree: FunctionTree) -> str:
    """A tree, after the tables to which it points."""
    joints = [joint._replace(placement=_columns(joint.placement)) for joint in tree.joints]
    frames = [(frame.after, f"{name}_moved_{k}", _columns(frame.placement)) for k, frame in enumerate(tree.frames)]
    rows = [(a, b, row) for a, b, rows in tree.closures for row in rows]
    places = [place for block in tree.blocks for part in block for place in part]
    ends = np.cumsum([0, *(len(part) for block in tree.blocks for part in block)])
    blocks = [
        (len(block[0]), ends[2 * k], ends[2 * k + 1], int(sign))
        for k, (block, sign) in enumerate(zip(tree.blocks, tree.signs, strict=True))
    ]
    starts = tree.starts if tree.closures else np.zeros((1, 1))
    counts = [tree.n_driven, tree.n_passive, len(tree.joints), len(starts), len(blocks), len(tree.limits)]
    parts = ("joints", "frames", "rows", "scale", "starts", "blocks", "block_places", "limits")
    members = [*counts, tree.tolerance, *(f"{name}_{part}" for part in parts)]
    return "".join(
        [
            _structs(f"@_joint {name}_joints[]", joints),
            *(
                f"static const unsigned char {name}_moved_{k}[] = {_literal(frame.moved_by)};\n"
                for k, frame in enumerate(tree.frames)
            ),
            _structs(f"@_frame {name}_frames[]", frames),
            _structs(f"@_row {name}_rows[]", rows or [(0, 0, 0)]),
            _array(f"double {name}_scale[]", tree.scale),
            _array(f"double {name}_starts[]", starts.ravel()),
            _structs(f"@_block {name}_blocks[]", blocks or [(0, 0, 0, 0)]),
            f"static const int {name}_block_places[] = {_literal(places or [0])};\n",
            _structs(f"@_limit {name}_limits[]", tree.limits or [(0, False, 0.0, 0.0)]),
            f"static const @_tree {name} = {_literal(members)};\n",
        ]
    )


def _columns(placement: FloatArray) -> FloatArray:
    return placement[:3].T.ravel()


def _number(value: float) -> str:
    """A number that reads back exactly."""
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return repr(float(value) + 0.0)


def _literal(value: Any) -> str:
    """Numbers, texts as they are, and sequences of them in braces."""
    if isinstance(value, str):
        return value
    if isinstance(value, (int, np.integer, np.bool_)):
        return str(int(value))
    return _number(value) if isinstance(value, float) else f"{{{', '.join(map(_literal, value))}}}"


def _array(declared: str, values: Iterable[float]) -> str:
    text = list(map(_number, values))
    return _structs(declared, [", ".join(text[k : k + 5]) for k in range(0, len(text), 5)])


def _structs(declared: str, entries: Iterable[Any]) -> str:
    body = ",\n    ".join(map(_literal, entries))
    return f"static const {declared} = {{\n    {body}\n}};\n"
