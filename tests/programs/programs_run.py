"""Controllers that run their languages, for tests: written by the manuals, and apart from the readers of the engine.

Each runs a subset of its language that the generated programs of `programs_made` use, and notes every move: where in
the text, and the joints or T_base_flange to which it goes. Inputs are drawn from a seed, so that two runs of a program
decide alike.
"""

import contextlib
import re
from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

MOST_STEPS = 400
BRANCHES = ("elif", "else", "case", "default", "end")


@dataclass
class Move:
    """A move: its line, and joints (6,) or T_base_flange (4, 4)."""

    line: int
    to: np.ndarray


class StopError(Exception):
    """The program has run long enough."""


class _BreakError(Exception):
    pass


class _GotoError(Exception):
    """A jump to a label of this or an outer block."""


class Controller:
    """Runs statements: line, word (`if`, `while`, `def` ... in any language, `do` for all others), and their text.

    A language says what its statements are, evaluates texts (`value`) and does what is no branch or loop (`simple`).
    """

    first = ""  # routine with which the program begins; the first one if none is named

    def __init__(self, statements, seed):
        self.inputs, self.moves, self.steps, self.line = np.random.default_rng(seed), [], 0, 0
        self.data, self.routines, self.statements = {}, {}, deque(statements)
        self.outside = self.block()

    def input(self):
        return bool(self.inputs.integers(2))

    def run(self):
        with contextlib.suppress(StopError):
            self.do(self.outside, self.data)
            if self.first:
                self.call(self.first)
        return self.moves

    def block(self, *ends):
        """Statements up to one of these words; routines are taken out of them."""
        out = []
        while self.statements and self.statements[0][1] not in ends:
            line, word, text = self.statements.popleft()
            if word == "def":
                name, parameters = re.match(r"(\w+)\s*\((.*)\)", text).groups()
                self.first = self.first or name
                self.routines[name] = ([x.strip() for x in parameters.split(",") if x.strip()], self.block("end"))
            elif word in ("if", "switch"):
                branches = [(text, self.block(*BRANCHES))]
                while self.statements[0][1] != "end":
                    _, word_of_branch, condition = self.statements.popleft()
                    condition = condition if word_of_branch in ("elif", "case") else None
                    branches.append((condition, self.block(*BRANCHES)))
                out.append((word, line, text, branches))
            elif word in ("while", "for", "loop"):
                out.append((word, line, text, self.block("end", "until"), self.statements[0]))
            else:
                out.append((word, line, text))
                continue
            self.statements.popleft()  # the end
        return out

    def do(self, block, data):
        at = 0
        while at < len(block):
            self.steps += 1
            if self.steps > MOST_STEPS:
                raise StopError
            try:
                self.statement(*block[at], data=data)
                at += 1
            except _GotoError as jump:
                labels = [k for k, other in enumerate(block) if other[0] == "label" and other[2] == jump.args[0]]
                if not labels:
                    raise
                at = labels[0]

    def statement(self, word, line, text, *parts, data):
        self.line = line
        if word == "if":
            for condition, body in parts[0]:
                if condition is None or self.value(condition, data):
                    return self.do(body, data)
        elif word == "switch":
            value = self.value(text, data)
            for values, body in parts[0][1:]:
                if values is None or value in [self.value(one, data) for one in values.split(",")]:
                    return self.do(body, data)
        elif word == "for":
            name, first, last = re.match(r"\s*(\w+)\s*(?:from|=)\s*(.*?)\s+to\s+(.*)", text, re.IGNORECASE).groups()
            for k in range(int(self.value(first, data)), int(self.value(last, data)) + 1):
                data[name] = k
                self.do(parts[0], data)
        elif word in ("while", "loop"):
            _, end, until = parts[1]
            with contextlib.suppress(_BreakError):
                while word == "loop" or self.value(text, data):
                    self.do([("nothing", line, ""), *parts[0]], data)  # an empty loop ends, too
                    if end == "until" and self.value(until, data):
                        break
        elif word == "break":
            raise _BreakError
        elif word == "goto":
            raise _GotoError(text)
        elif word == "do":
            self.simple(text, data)
        return None


def first_form(forms, text):
    """Word and text of a statement, by the first pattern that it matches: its only group, or nothing."""
    for pattern, word in forms:
        match = re.match(pattern, text)
        if match:
            return word, "".join(match.groups())
    return "do", text


def pose(xyz, rotation):
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), xyz
    return T


@lru_cache(4096)
def written_pose(form, *numbers):
    """A pose from a position and an orientation as a language writes it; nothing may change what is returned."""
    xyz, turn = np.array(numbers[:3]), numbers[3:]
    if form == "vector":
        return pose(xyz, Rotation.from_rotvec(turn))
    if form == "quaternion":
        return pose(xyz / 1e3, Rotation.from_quat([*turn[1:], turn[0]]))
    return pose(xyz / 1e3, Rotation.from_euler(form, turn, degrees=True))


@lru_cache(4096)
def code(text):
    return compile(text, "expression", "eval")


def value_of(text, names):
    return eval(code(text), {"__builtins__": {}}, names)


# ---------------------------------------------------------------- URScript: arguments and values are copied


class _Poses:
    """`p[...]` of URScript in Python's syntax."""

    def __getitem__(self, values):
        return _Pose(values)


class _Pose(list):
    pass


def _matrix(p):
    return written_pose("vector", *p)


def _as_pose(T):
    return _Pose([*T[:3, 3], *Rotation.from_matrix(T[:3, :3]).as_rotvec()])


class URScript(Controller):
    """Statements are lines, or parts of lines behind a colon; expressions have Python's syntax and meaning."""

    FORMS: ClassVar = (
        (r"end\b", "end"),
        (r"else\b", "else"),
        (r"break\b", "break"),
        *((rf"{word}\b\s*(.*?)[:\s]*$", word) for word in ("def", "if", "elif", "while")),
    )

    def __init__(self, text, seed):
        super().__init__(self._statements(text), seed)
        self.tool = np.eye(4)

    def _statements(self, text):
        for k, line in enumerate(text.splitlines(), 1):
            line = re.sub(r'"[^"]*"|#.*', lambda m: '""' if m[0][0] == '"' else "", line)
            for part in re.split(r"(?<=:)\s|;|\s(?=end\b)", line):
                if part.strip():
                    yield k, *first_form(self.FORMS, part.strip())

    def call(self, name, *given):
        names, body = self.routines[name]
        self.do(body, dict(zip(names, copied(list(given)), strict=True)))

    def simple(self, text, data):
        match = re.match(r"(global\s+|local\s+)?(\w+)\s*(\[(.*?)\])?\s*=(?!=)(.*)", text)
        if not match:
            self.value(text, data)
            return
        value, name = copied(self.value(match[5], data)), match[2]
        known = next((scope for scope in (data, self.data) if name in scope), data)
        scope = known if not match[1] else self.data if match[1].startswith("global") else data
        if match[3]:
            scope[name][int(self.value(match[4], data))] = value
        else:
            scope[name] = value

    def value(self, text, data):
        def move(target, *more, **options):
            for goal in [target, *more[:1]] if more and isinstance(more[0], list) else [target]:
                to = _matrix(goal) @ np.linalg.inv(self.tool) if isinstance(goal, _Pose) else np.array(goal, float)
                self.moves.append(Move(self.line, to))

        def movej_named(*given, **options):
            return move(*([options.pop("q")] if "q" in options else []), *given, **options)

        def set_tcp(value):
            self.tool = _matrix(value)

        names = {
            "p": _Poses(),
            "movej": movej_named,
            "movel": move,
            "movec": move,
            "set_tcp": set_tcp,
            "d2r": np.radians,
            "get_inverse_kin": lambda goal, qnear=None: goal,
            "pose_trans": lambda a, b: _as_pose(_matrix(a) @ _matrix(b)),
            "pose_add": lambda a, b: _as_pose(
                pose(np.add(a[:3], b[:3]), Rotation.from_rotvec(a[3:]) * Rotation.from_rotvec(b[3:]))
            ),
            "get_digital_in": lambda k: self.input(),
            "textmsg": lambda *x: None,
            "sleep": lambda t: None,
            "set_digital_out": lambda k, v: None,
        }
        names |= {name: lambda *x, name=name: self.call(name, *x) for name in self.routines}
        return value_of(text.strip(), {**names, **self.data, **data})


# ---------------------------------------------------------------- RAPID: records, and arguments by reference


class _Record:
    """A record of RAPID; components in their order."""

    TYPES: ClassVar = {
        "robtarget": (("trans", "pos"), ("rot", "orient"), ("robconf", "list"), ("extax", "list")),
        "jointtarget": (("robax", "list"), ("extax", "list")),
        "pos": (("x", ""), ("y", ""), ("z", "")),
        "orient": (("q1", ""), ("q2", ""), ("q3", ""), ("q4", "")),
        "pose": (("trans", "pos"), ("rot", "orient")),
        "tooldata": (("robhold", ""), ("tframe", "pose"), ("tload", "list")),
        "wobjdata": (("robhold", ""), ("ufprog", ""), ("ufmec", ""), ("uframe", "pose"), ("oframe", "pose")),
    }

    def __init__(self, kind, values):
        self.kind = kind
        for (name, inner), value in zip(self.TYPES[kind], values, strict=True):
            setattr(self, name, _typed(inner, value))


def _typed(kind, value):
    return _Record(kind, value) if kind in _Record.TYPES and isinstance(value, list) else copied(value)


def _frame(p):
    t, r = p.trans, p.rot
    return written_pose("quaternion", t.x, t.y, t.z, r.q1, r.q2, r.q3, r.q4)


def copied(value):
    """A value as an assignment gives it: nothing in it is shared."""
    if isinstance(value, list):
        return type(value)(map(copied, value))
    if isinstance(value, dict):
        return {key: copied(one) for key, one in value.items()}
    if isinstance(value, _Record):
        other = object.__new__(_Record)
        other.__dict__.update(copied(vars(value)))
        return other
    return value


class _Array(list):
    def at(self, k):
        return self[int(k) - 1]


_NO_ROTATION = [1.0, 0.0, 0.0, 0.0]


class Rapid(Controller):
    """Expressions are Python's after `=`, `<>` and the index braces are rewritten."""

    first = "main"
    FORMS: ClassVar = (
        (r"module\s+\w+|endmodule|local\b|task\b", ""),
        (r"proc\s+(\w+\s*\([^)]*\))", "def"),
        (r"end(?:proc|if|for|while|test)\b", "end"),
        (r"elseif\b([^;]*?)\bthen\b", "elif"),
        (r"else\b", "else"),
        (r"case\b([^:]*):", "case"),
        (r"default\s*:", "default"),
        (r"for\b(.*?)\bdo\b", "for"),
        (r"while\b(.*?)\bdo\b", "while"),
        (r"test\b(.*?)(?=\bcase\b)", "switch"),
        # a value, and a statement behind it
        (r"if\s*(\([^()]*\)|\w+\s*(?:=|<>|<|>)\s*[\w.+-]+|\w+)(?=[\s(])(?!\s*(?:then|and|or|=|<|>))", "compact"),
        (r"if\b([^;]*?)\bthen\b", "if"),
        (r"goto\s+(\w+)\s*;", "goto"),
        (r"(\w+)\s*:(?!=)", "label"),
        (r"([^;]*);", "do"),
    )

    def __init__(self, text, seed):
        text = re.sub(r'"[^"\n]*"|![^\n]*', lambda m: '""' + " " * (len(m[0]) - 2) if m[0][0] == '"' else "", text)
        super().__init__(self._statements(text.lower()), seed)
        half = [[0.0, 0.0, 0.0], _NO_ROTATION]
        self.data["tool0"] = _Record("tooldata", [True, half, []])
        self.data["wobj0"] = _Record("wobjdata", [False, True, "", half, half])
        self.displaced = np.eye(4)

    def _statements(self, text):
        at, compact = text.index("module"), 0
        while at < len(text.rstrip()):
            at = re.compile(r"\s*").match(text, at).end()
            forms = ((re.compile(pattern, re.DOTALL).match(text, at), word) for pattern, word in self.FORMS)
            match, word = next((match, word) for match, word in forms if match)
            line, at = text.count("\n", 0, at) + 1, match.end()
            if word:
                yield line, "if" if word == "compact" else word, "".join(match.groups()).strip()
            compact += word == "compact"
            while compact and word in ("do", "goto"):
                yield line, "end", ""
                compact -= 1

    def _declare(self, data, text):
        match = re.match(r"(?:const|pers|var)\s+(\w+)\s+(\w+)\s*(\{[^}]*\})?\s*(?::=(.*))?$", text.strip(), re.DOTALL)
        value = self.value(match[4], data) if match[4] else 0
        if match[3]:
            data[match[2]] = _Array(_typed(match[1], one) for one in value)
        else:
            data[match[2]] = _typed(match[1], value)

    def call(self, name, *given):
        parameters, body = self.routines[name]
        data = {}
        for parameter, value in zip(map(str.split, parameters), given, strict=True):
            data[parameter[-1]] = value if parameter[0] in ("inout", "pers", "var") else copied(value)
        self.do(body, data)

    def simple(self, text, data):
        if re.match(r"(const|pers|var)\b", text):
            self._declare(data, text)
            return
        word = re.match(r"\w+", text)[0]
        assigned = re.match(r"([\w.{}\s+-]+?)\s*:=(.*)", text, re.DOTALL)
        if assigned and not word.startswith("move"):
            self._assign(assigned[1].strip(), self.value(assigned[2], data), data)
        elif word.startswith("move"):
            self._move(word, text[len(word) :], data)
        elif word == "pdispset":
            self.displaced = _frame(_typed("pose", self.value(text[len(word) :], data)))
        elif word == "pdispoff":
            self.displaced = np.eye(4)
        elif word in self.routines:
            self.call(word, *(self.value(one, data) for one in _split(text[len(word) :])))
        elif word == "add":
            name, value = _split(text[len(word) :])[:2]
            self._assign(name, self.value(f"({name})+({value})", data), data)
        else:
            assert word in ("setdo", "waittime", "tpwrite", "confl", "confj", "singarea"), word

    def _assign(self, target, value, data):
        parts = re.match(r"(\w+)\s*(?:\{(.*?)\})?\s*((?:\.\w+)*)$", target.replace(" ", ""))
        scope = data if parts[1] in data else self.data
        held = scope[parts[1]]
        names = [x for x in parts[3].split(".") if x]
        if parts[2] and not names:
            held[int(self.value(parts[2], data)) - 1] = _like(held.at(1), value)
            return
        held = held.at(self.value(parts[2], data)) if parts[2] else held
        if not names:
            if isinstance(held, _Record):  # by reference: the record stays the same one
                held.__dict__.update(_like(held, value).__dict__)
            else:
                scope[parts[1]] = copied(value)
            return
        for name in names[:-1]:
            held = getattr(held, name)
        setattr(held, names[-1], copied(value))

    def _move(self, word, text, data):
        options = dict(re.findall(r"\\\s*(\w+)\s*:=\s*(\w+)", text))
        given = [x for x in (re.split(r"\\", one)[0].strip() for one in _split(text)) if x]
        count = 2 if word == "movec" else 1
        if word == "moveabsj":
            target = _typed("jointtarget", self.value(given[0], data))
            self.moves.append(Move(self.line, np.radians(target.robax)))
            return
        tool, wobj = self.value(given[count + 2], data), self.value(options.get("wobj", "wobj0"), data)
        frame = _frame(wobj.uframe) @ _frame(wobj.oframe)
        for one in given[:count]:
            target = _typed("robtarget", self.value(one, data))
            to = frame @ self.displaced @ _frame(target) @ np.linalg.inv(_frame(tool.tframe))
            self.moves.append(Move(self.line, to))

    def value(self, text, data):
        text = _in_python(text)
        names = {
            "true": True,
            "false": False,
            "di1": self.input() if "di1" in text else 0,
            "offs": _offs,
            "fine": 0,
            "abs": abs,
            **dict.fromkeys(("v100", "v1000", "z10", "z50"), 0),
            **{name: lambda *x, name=name: self.call(name, *x) for name in self.routines},
        }
        return value_of(text, {**names, **self.data, **data})


@lru_cache(4096)
def _in_python(text):
    text = re.sub(r"\{([^{}]*)\}", r".at(\1)", text)
    return " ".join(re.sub(r"(?<![<>:])=", "==", text).replace("<>", "!=").split())


def _like(held, value):
    return _typed(held.kind, value) if isinstance(value, list) else copied(value)


def _offs(target, x, y, z):
    moved = copied(target)
    moved.trans.x, moved.trans.y, moved.trans.z = moved.trans.x + x, moved.trans.y + y, moved.trans.z + z
    return moved


def _split(text):
    parts, depth, last = [], 0, 0
    for k, c in enumerate(text):
        depth += (c in "([{") - (c in ")]}")
        if c == "," and depth == 0:
            parts.append(text[last:k])
            last = k + 1
    return [one.strip() for one in [*parts, text[last:]] if one.strip()]


# ---------------------------------------------------------------- KRL: lines, frames in system variables


def _krl_pose(v):
    return written_pose("ZYX", *(v[k] for k in "XYZABC"))


class Krl(Controller):
    """A statement ends with its line; parameters without `:IN` are by reference."""

    NULL = dict.fromkeys("XYZABC", 0.0)
    FORMS: ClassVar = (
        (r"DEF\s+(.*)", "def"),
        (r"END(?:IF|WHILE|FOR|LOOP|SWITCH)?$", "end"),
        (r"IF\b(.*)\bTHEN", "if"),
        (r"ELSE$", "else"),
        *((rf"{word}\b(.*)", word.lower()) for word in ("WHILE", "FOR", "SWITCH", "CASE", "DEFAULT", "UNTIL")),
        (r"LOOP$|REPEAT$", "loop"),
        (r"EXIT$", "break"),
        (r"GOTO\s+(\w+)", "goto"),
        (r"(\w+):$", "label"),
    )

    def __init__(self, src, dat, seed):
        super().__init__(self._statements(src), seed)
        self.data = {"$NULLFRAME": dict(self.NULL), "$TOOL": None, "$BASE": None, "TOOL_DATA": {}, "BASE_DATA": {}}
        self.depth = 0
        for _, line in self._lines(dat):
            text = re.sub(r"^(DECL|GLOBAL)\s+", "", line)
            text = re.sub(r"^(E6POS|E6AXIS|FRAME|FDAT|INT)\s+", "", text)
            match = re.match(r"([$\w]+(?:\[\d+\])?)\s*=(.*)", text)
            if match and not line.startswith("DEFDAT"):
                self._assign(match[1], self.value(match[2], {}), {})

    @staticmethod
    def _lines(text):
        lines = [(k, re.sub(r"[;&].*", "", line).strip().upper()) for k, line in enumerate(text.splitlines(), 1)]
        return [line for line in lines if line[1]]

    def _statements(self, text):
        for k, line in self._lines(text):  # IF c THEN statement ENDIF on a line in its parts
            for part in re.split(r"(?<=\bTHEN)\s+|\s+(?=ENDIF\b)|\s+(?=ELSE\b)|(?<=\bELSE)\s+", line):
                if part.strip():
                    yield k, *first_form(self.FORMS, part.strip())

    def call(self, name, *given):
        parameters, body = self.routines[name]
        data, back = {}, []
        self.depth += 1
        if self.depth > 20:
            raise StopError
        for parameter, (text, scope) in zip(parameters, given, strict=True):
            key, _, mode = parameter.partition(":")
            data[key.strip()] = copied(self.value(text, scope))
            if mode.strip() != "IN" and re.fullmatch(r"[$\w\[\].]+", text):
                back.append((text, key.strip(), scope))
        self.do(body, data)
        for text, key, scope in back:
            self._assign(text, data[key], scope)
        self.depth -= 1

    def simple(self, text, data):
        match = re.match(r"(PTP|LIN|CIRC|SLIN|SPTP)(_REL)?\s+(?=[^=\s])(.*)", text)
        if match:
            self._move(match[1], match[3], data)
            return
        if text.startswith(("DECL", "WAIT", "HALT", "CONTINUE")):
            return
        call = re.match(r"(\w+)\s*\((.*)\)$", text)
        if call and call[1] == "BAS":
            self._bas([x.strip() for x in call[2].split(",")])
        elif call:
            self.call(call[1], *((one, data) for one in _split(call[2])))
        else:
            target, value = re.match(r"([$\w\[\].\s]+?)\s*=(.*)", text).groups()
            if target.startswith("$OUT"):
                return
            if target == "FDAT_ACT":
                self.form = self.data[value.strip()]
                return
            self._assign(target, self.value(value, data), data)

    def _bas(self, given):
        if given[0] == "#TOOL":
            self.data["$TOOL"] = dict(self.data["TOOL_DATA"][int(given[1])])
        elif given[0] == "#BASE":
            self.data["$BASE"] = dict(self.data["BASE_DATA"][int(given[1])])
        elif given[0] in ("#PTP_PARAMS", "#CP_PARAMS", "#FRAMES"):
            self.data["$TOOL"] = dict(self.data["TOOL_DATA"][int(self.form["TOOL_NO"])])
            self.data["$BASE"] = dict(self.data["BASE_DATA"][int(self.form["BASE_NO"])])
        else:
            assert given[0] in ("#VEL_PTP", "#ACC_PTP", "#VEL_CP", "#INITMOV"), given

    def _assign(self, target, value, data):
        parts = re.match(r"([$\w]+)\s*(?:\[(.*?)\])?\s*(?:\.(\w+))?$", target.replace(" ", ""))
        scope = data if parts[1] in data else self.data
        if parts[2]:
            held = scope.setdefault(parts[1], {})
            key = int(self.value(parts[2], data))
        else:
            held, key = scope, parts[1]
        if parts[3]:
            held[key] = {**held[key], parts[3]: value}
        else:
            held[key] = copied(value)

    def _move(self, word, text, data):
        text, _, behind = text.partition(" WITH ")
        text = re.sub(r"\s+C_\w+.*", "", text)
        held = {key: self.data[key] for key in ("$TOOL", "$BASE")}
        for one in _split(behind):
            name, _, value = one.partition("=")
            if name.strip() in held:
                held[name.strip()] = self.value(value, data)
        for one in _split(text)[: 2 if word == "CIRC" else 1]:
            value = self.value(one, data)
            if "A1" in value:
                self.moves.append(Move(self.line, np.radians([value[f"A{k}"] for k in range(1, 7)])))
                continue
            tool, base = (_krl_pose(held[key]) for key in ("$TOOL", "$BASE"))
            self.moves.append(Move(self.line, base @ _krl_pose(value) @ np.linalg.inv(tool)))

    def value(self, text, data):
        text = text.strip()
        if text.startswith("{"):
            inside = re.sub(r"^\{\s*\w+\s*:", "{", text)[1:-1]
            pairs = [one.split(None, 1) for one in inside.split(",")]
            return {key: value if value.startswith("#") else float(value) for key, value in pairs}
        text = text.replace("<>", "!=")
        names, counter = {}, [0]

        def variable(match):
            name, index, component = match.groups()
            if name in ("AND", "OR", "NOT", "TRUE", "FALSE"):
                return {"TRUE": "True", "FALSE": "False"}.get(name, name.lower())
            if name == "$IN":
                value = self.input()
            else:
                value = data[name] if name in data else self.data[name]
                value = value[int(self.value(index, data))] if index else value
                value = value[component] if component else value
            counter[0] += 1
            names[f"v{counter[0]}"] = value
            return f"v{counter[0]}"

        text = re.sub(r"([$A-Z_][$\w]*)\s*(?:\[([^\]]*)\])?(?:\.([A-Z]\d?)\b)?", variable, text)
        return value_of(text, names)


# ---------------------------------------------------------------- FANUC: lines, labels, frames by number


class Fanuc(Controller):
    """Positions are in the frame and of the tool that are selected: the controller's check of numbers is off."""

    FORMS: ClassVar = (
        (r"IF\b(.*)\bTHEN$", "if"),
        (r"ELSE$", "else"),
        (r"ENDIF$", "end"),
        (r"JMP\s+LBL\[(\d+)\]", "goto"),
        (r"LBL\[(\d+)\]", "label"),
    )

    def __init__(self, text, frames, seed):
        main, _, rest = text.partition("/POS")
        before, _, main = main.partition("/MN")
        super().__init__(self._statements(main, before.count("\n") + 1), seed)
        self.frames, self.registers = frames, {}
        self.positions = {}
        for block in re.findall(r"P\[(\d+)[^\]]*\]\s*\{(.*?)\}\s*;", rest, re.DOTALL):
            self.positions[int(block[0])] = self._position(block[1])
        self.selected = {"UFRAME": None, "UTOOL": None}

    def _statements(self, main, first):
        for k, line in enumerate(main.split("\n"), first):
            text = re.sub(r"^\s*\d*:", "", line).strip()
            text = re.sub(r"\[(\d+):[^\]]*\]", r"[\1]", text).rstrip("; ")
            compact = re.match(r"(IF\b.*?),(?![^\[]*\])(.*)", text)
            if compact:
                yield k, "if", compact[1][2:]
                yield k, *first_form(self.FORMS, compact[2].strip())
                yield k, "end", ""
            elif text and not text.startswith("!"):
                yield k, *first_form(self.FORMS, text)

    @staticmethod
    def _position(text):
        number = r"=\s*(-?\d+\.\d*)"
        if re.search(rf"J1\s*{number}", text):
            return [float(re.search(rf"J{k}\s*{number}", text)[1]) for k in range(1, 7)]
        values = [float(re.search(rf"\b{k}\s*{number}", text)[1]) for k in "XYZWPR"]
        return values, int(re.search(r"UF\s*:\s*(\d+)", text)[1]), int(re.search(r"UT\s*:\s*(\d+)", text)[1])

    def simple(self, text, data):
        match = re.match(r"([JLC])\s+((?:P\[[^\]]*\]+\s*|PR\[[^\]]*\]\s*)+)(.*)", text)
        if match:
            for place in re.findall(r"PR?\[(?:R\[\d+\]|\d+)\]", match[2]):
                self._move(place, match[3])
        elif "=" in text and not text.startswith("WAIT"):
            target, _, value = text.partition("=")
            self._set(target.strip(), value.strip())

    def _set(self, target, value):
        if target in ("UFRAME_NUM", "UTOOL_NUM"):
            self.selected[target[:-4]] = int(self.value(value))
        elif target.startswith(("UFRAME[", "UTOOL[")):
            self.frames[target] = self._matrix(self.registers.get(value, [0.0] * 6))
        elif target.startswith("PR[") and "," not in target:
            number = re.match(r"P\[(\d+)\]", value)
            self.registers[target] = list(self.positions[int(number[1])][0]) if number else [100.0, 0, 50, 0, 0, 0]
        elif target.startswith("PR["):
            register, component = re.match(r"(PR\[\d+),(\d+)\]", target).groups()
            self.registers.setdefault(register + "]", [0.0] * 6)[int(component) - 1] = self.value(value)
        elif target.startswith("R["):
            self.registers[target] = self.value(value)

    @staticmethod
    def _matrix(values):
        return written_pose("xyz", *values)

    def value(self, text, data=None):
        def register(match):
            if match[0].startswith("PR"):
                return repr(self.registers.get(match[1] + "]", [0.0] * 6)[int(match[2]) - 1])
            return repr(self.registers.get(match[0], 0))

        text = text.strip().strip("()")
        if text.startswith("DI["):
            return self.input()
        text = re.sub(r"(?<![<>])=", "==", text).replace("<>", "!=")
        return value_of(re.sub(r"(PR\[\d+),(\d+)\]|R\[\d+\]", register, text), {})

    def _move(self, place, behind):
        if place.startswith("PR"):
            values = self.registers.get(place, [400.0, 0, 300, 0, 0, 0])
        else:
            number = re.search(r"\[(?:R\[(\d+)\]|(\d+))\]", place)
            key = int(self.registers.get(f"R[{number[1]}]", 1)) if number[1] else int(number[2])
            key = key if key in self.positions else 1
            if isinstance(self.positions.get(key), list):
                self.moves.append(Move(self.line, np.radians(self.positions[key])))
                return
            values, frame, tool = self.positions[key]
            for kind, own in (("UFRAME", frame), ("UTOOL", tool)):
                if self.selected[kind] is None:
                    self.selected[kind] = own
        selected = {kind: 0 if number is None else number for kind, number in self.selected.items()}
        frame, tool = (self._frame(f"{kind}[{number}]") for kind, number in selected.items())
        T = frame @ self._matrix(values) @ np.linalg.inv(tool)
        offset = re.search(r"(?i)\boffset\s*,\s*(PR\[\d+\])", behind)
        if offset:
            T = frame @ self._matrix(self.registers.get(offset[1], [0.0] * 6)) @ np.linalg.inv(frame) @ T
        self.moves.append(Move(self.line, T))

    def _frame(self, name):
        return np.eye(4) if name.endswith("[0]") else self.frames[name]
