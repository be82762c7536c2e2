"""Controllers that run their languages, for tests: written by the manuals, and apart from the readers of the engine.

Each runs a subset of its language that the generated programs of `programs_made` use, and notes every move: where in
the text, and the joints or T_base_flange to which it goes. Inputs are drawn from a seed, so that two runs of a program
decide alike.
"""

import contextlib
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

MOST_STEPS = 400


@dataclass
class Move:
    """A move: its line, and joints (6,) or T_base_flange (4, 4)."""

    line: int
    to: np.ndarray


class StopError(Exception):
    """The program has run long enough."""


class Controller:
    def __init__(self, seed):
        self.inputs, self.moves, self.steps = np.random.default_rng(seed), [], 0

    def step(self):
        self.steps += 1
        if self.steps > MOST_STEPS:
            raise StopError

    def input(self):
        return bool(self.inputs.integers(2))


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


class _BreakError(Exception):
    pass


class _GotoError(Exception):
    """A jump to a label of this or an outer block."""


def _labelled(error, block, is_label):
    """Where a block goes on behind a jump."""
    found = next((k for k, statement in enumerate(block) if is_label(statement, error.args[0])), None)
    if found is None:
        raise error
    return found + 1


class URScript(Controller):
    """Statements are lines, or parts of lines behind a colon; expressions have Python's syntax and meaning."""

    def __init__(self, text, seed):
        super().__init__(seed)
        self.functions, self.tool = {}, np.eye(4)
        lines = [
            (k, re.sub(r'"[^"]*"|#.*', lambda m: '""' if m[0][0] == '"' else "", line))
            for k, line in enumerate(text.splitlines(), 1)
        ]
        self.parts = []
        for k, line in lines:
            for part in re.split(r"(?<=:)\s|;|\s(?=end\b)", line):
                if part.strip():
                    self.parts.append((k, part.strip().rstrip(";").strip()))
        self.scopes = [{}]

    def run(self):
        block, _ = self._block(0)
        with contextlib.suppress(StopError):
            self._do(block)
        return self.moves

    def _block(self, at):
        """Statements up to `end`, `elif` or `else`, and where that is."""
        out = []
        while at < len(self.parts):
            line, text = self.parts[at]
            word = re.match(r"\w*", text)[0]
            if word in ("end", "elif", "else"):
                return out, at
            if word in ("def", "while", "if"):
                branches = []
                while True:
                    line, text = self.parts[at]
                    head = text.rstrip(": ").partition(" ")[2] if not text.startswith("else") else "True"
                    if text.startswith(("while(", "if(", "elif(")):
                        head = text.rstrip(": ")[text.index("(") :]
                    body, at = self._block(at + 1)
                    branches.append((line, head, body))
                    if self.parts[at][1].startswith("end"):
                        break
                out.append((word, branches))
            else:
                out.append(("do", line, text))
            at += 1
        return out, at

    def _do(self, block):
        for statement in block:
            self.step()
            if statement[0] == "def":
                _, head, body = statement[1][0]
                name, inside = re.match(r"(\w+)\s*\((.*)\)", head).groups()
                self.functions[name] = ([x.strip() for x in inside.split(",") if x.strip()], body)
                if len(self.scopes) == 1:
                    self._call(name)
            elif statement[0] == "if":
                for line, head, body in statement[1]:
                    if self._value(head, line):
                        self._do(body)
                        break
            elif statement[0] == "while":
                line, head, body = statement[1][0]
                with contextlib.suppress(_BreakError):
                    while self._value(head, line):
                        self.step()
                        self._do(body)
            else:
                self._simple(*statement[1:])

    def _simple(self, line, text):
        if text == "break":
            raise _BreakError
        match = re.match(r"(global\s+|local\s+)?(\w+)\s*(\[(.*?)\])?\s*=(?!=)(.*)", text)
        if not match:
            self._value(text, line)
            return
        value, name = copied(self._value(match[5], line)), match[2]
        scope = self.scopes[-1]
        if match[1] and match[1].startswith("global"):
            scope = self.scopes[0]
        elif not match[1]:
            scope = next((s for s in (self.scopes[-1], self.scopes[0]) if name in s), scope)
        if match[3]:
            scope[name][int(self._value(match[4], line))] = value
        else:
            scope[name] = value

    def _call(self, name, *given):
        names, body = self.functions[name]
        self.scopes.append(dict(zip(names, copied(list(given)), strict=True)))
        self._do(body)
        self.scopes.pop()

    def _value(self, text, line):
        def move(target, *more, **options):
            for goal in [target, *more[:1]] if more and isinstance(more[0], list) else [target]:
                to = _matrix(goal) @ np.linalg.inv(self.tool) if isinstance(goal, _Pose) else np.array(goal, float)
                self.moves.append(Move(line, to))

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
        names |= {name: lambda *x, name=name: self._call(name, *x) for name in self.functions}
        return value_of(text.strip(), {**names, **self.scopes[0], **self.scopes[-1]})


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
    """Statements by a scanner; expressions as Python's after `=`, `<>` and the index braces are rewritten."""

    def __init__(self, text, seed):
        super().__init__(seed)
        text = re.sub(r'"[^"\n]*"|![^\n]*', lambda m: '""' + " " * (len(m[0]) - 2) if m[0][0] == '"' else "", text)
        self.text, self.at = text.lower(), text.lower().index("module")
        half = [[0.0, 0.0, 0.0], _NO_ROTATION]
        self.data = {
            "tool0": _Record("tooldata", [True, half, []]),
            "wobj0": _Record("wobjdata", [False, True, "", half, half]),
        }
        self.routines, self.displaced = {}, np.eye(4)

    def run(self):
        self._module()
        with contextlib.suppress(StopError):
            self._call("main", [])
        return self.moves

    def _blank(self):
        self.at = re.compile(r"\s*").match(self.text, self.at).end()

    def _word(self):
        self._blank()
        match = re.compile(r"[a-z_]\w*").match(self.text, self.at)
        return match[0] if match else ""

    def _take(self, pattern):
        self._blank()
        match = re.compile(pattern).match(self.text, self.at)
        assert match, (pattern, self.text[self.at : self.at + 60])
        self.at = match.end()
        return match[0]

    def _line(self, at):
        return self.text.count("\n", 0, at) + 1

    def _module(self):
        self._take(r"module\s+\w+")
        while self._word() != "endmodule":
            word = self._word()
            if word in ("local", "task"):
                self._take(word)
            elif word == "proc":
                self._take(word)
                name = self._take(r"\w+")
                inside = self._take(r"\([^)]*\)")[1:-1]
                parameters = [x.split() for x in inside.split(",") if x.strip()]
                self.routines[name] = (parameters, self._block("endproc"))
                self._take(r"\w+")
            else:
                self._declare(self.data, self._take(r"[^;]*;")[:-1])

    def _declare(self, data, text):
        match = re.match(r"(?:const|pers|var)\s+(\w+)\s+(\w+)\s*(\{[^}]*\})?\s*(?::=(.*))?$", text.strip(), re.DOTALL)
        value = self._value(match[4], data) if match[4] else 0
        if match[3]:
            data[match[2]] = _Array(_typed(match[1], one) for one in value)
        else:
            data[match[2]] = _typed(match[1], value)

    def _block(self, *ends):
        out = []
        while self._word() not in ends:
            out.append(self._statement())
        return out

    def _statement(self):
        word, start = self._word(), self.at
        self._blank()
        start = self.at
        if word == "if":
            self._take("if")
            branches, compact = [], re.compile(r"[^;]*?\bthen\b").match(self.text, self.at)
            one = re.compile(r"\s*(\([^()]*\)|\w+\s*(?:=|<>|<|>)\s*[\w.+-]+|\w+)(?=[\s(])").match(self.text, self.at)
            if compact and "\x00" not in compact[0] and not self._is_compact(one):
                condition = self._take(r"[^;]*?\bthen\b")[:-4]
                while True:
                    body = self._block("elseif", "else", "endif")
                    branches.append((condition, body))
                    end = self._take(r"\w+")
                    if end == "endif":
                        return ("if", branches)
                    condition = "true" if end == "else" else self._take(r"[^;]*?\bthen\b")[:-4]
            self.at = one.end()
            return ("if", [(one[1], [self._statement()])])
        if word == "for":
            head = re.compile(r"\s*for\s+(\w+)\s+from\s+(.*?)\s+to\s+(.*?)\s+do\b").match(self.text, self.at)
            self.at = head.end()
            body = self._block("endfor")
            self._take("endfor")
            return ("for", head[1], head[2], head[3], body)
        if word == "while":
            head = self._take(r"while\b.*?\bdo\b")[5:-2]
            body = self._block("endwhile")
            self._take("endwhile")
            return ("while", head, body)
        if word == "test":
            head, branches = self._take(r"test\b.*?(?=\bcase\b)")[4:], []
            while self._word() != "endtest":
                case = self._take(r"case\b[^:]*:|default\s*:")
                values = case[4:-1].split(",") if case.startswith("case") else None
                branches.append((values, self._block("case", "default", "endtest")))
            self._take("endtest")
            return ("test", head, branches)
        label = re.compile(r"(\w+)\s*:(?!=)").match(self.text, self.at)
        if label:
            self.at = label.end()
            return ("label", label[1])
        text = self._take(r"[^;]*;")[:-1]
        return ("do", self._line(start), text.strip())

    def _is_compact(self, one):
        """Whether a statement follows behind a first value, and no `then`."""
        return one is not None and not re.compile(r"\s*(then|and|or|=|<|>)").match(self.text, one.end())

    def _call(self, name, given):
        parameters, body = self.routines[name]
        data = {}
        for parameter, value in zip(parameters, given, strict=True):
            data[parameter[-1]] = value if parameter[0] in ("inout", "pers", "var") else copied(value)
        self._do(body, data)

    def _do(self, block, data):
        at = 0
        while at < len(block):
            self.step()
            try:
                self._one(block[at], data)
                at += 1
            except _GotoError as jump:
                at = _labelled(jump, block, lambda statement, label: statement == ("label", label))

    def _one(self, statement, data):
        kind = statement[0]
        if kind == "if":
            for condition, body in statement[1]:
                if self._value(condition, data):
                    self._do(body, data)
                    break
        elif kind == "for":
            _, name, first, last, body = statement
            for k in range(int(self._value(first, data)), int(self._value(last, data)) + 1):
                data[name] = k
                self._do(body, data)
        elif kind == "while":
            while self._value(statement[1], data):
                self.step()
                self._do(statement[2], data)
        elif kind == "test":
            value = self._value(statement[1], data)
            for values, body in statement[2]:
                if values is None or any(self._value(one, data) == value for one in values):
                    self._do(body, data)
                    break
        elif kind == "do":
            self._simple(statement[1], statement[2], data)

    def _simple(self, line, text, data):
        if re.match(r"(const|pers|var)\b", text):
            self._declare(data, text)
            return
        word = re.match(r"\w+", text)[0]
        if word == "goto":
            raise _GotoError(text.split()[1])
        assigned = re.match(r"([\w.{}\s+-]+?)\s*:=(.*)", text, re.DOTALL)
        if assigned and not word.startswith("move"):
            self._assign(assigned[1].strip(), self._value(assigned[2], data), data)
        elif word.startswith("move"):
            self._move(line, word, text[len(word) :], data)
        elif word == "pdispset":
            self.displaced = _frame(_typed("pose", self._value(text[len(word) :], data)))
        elif word == "pdispoff":
            self.displaced = np.eye(4)
        elif word in self.routines:
            self._call(word, [self._value(one, data) for one in _split(text[len(word) :])])
        elif word == "add":
            name, value = _split(text[len(word) :])[:2]
            self._assign(name, self._value(f"({name})+({value})", data), data)
        else:
            assert word in ("setdo", "waittime", "tpwrite", "confl", "confj", "singarea"), word

    def _assign(self, target, value, data):
        parts = re.match(r"(\w+)\s*(?:\{(.*?)\})?\s*((?:\.\w+)*)$", target.replace(" ", ""))
        scope = data if parts[1] in data else self.data
        held = scope[parts[1]]
        names = [x for x in parts[3].split(".") if x]
        if parts[2] and not names:
            held[int(self._value(parts[2], data)) - 1] = _like(held.at(1), value)
            return
        held = held.at(self._value(parts[2], data)) if parts[2] else held
        if not names:
            if isinstance(held, _Record):  # by reference: the record stays the same one
                held.__dict__.update(_like(held, value).__dict__)
            else:
                scope[parts[1]] = copied(value)
            return
        for name in names[:-1]:
            held = getattr(held, name)
        setattr(held, names[-1], copied(value))

    def _move(self, line, word, text, data):
        options = dict(re.findall(r"\\\s*(\w+)\s*:=\s*(\w+)", text))
        given = [x for x in (re.split(r"\\", one)[0].strip() for one in _split(text)) if x]
        count = 2 if word == "movec" else 1
        if word == "moveabsj":
            target = _typed("jointtarget", self._value(given[0], data))
            self.moves.append(Move(line, np.radians(target.robax)))
            return
        tool, wobj = self._value(given[count + 2], data), self._value(options.get("wobj", "wobj0"), data)
        frame = _frame(wobj.uframe) @ _frame(wobj.oframe)
        for one in given[:count]:
            target = _typed("robtarget", self._value(one, data))
            to = frame @ self.displaced @ _frame(target) @ np.linalg.inv(_frame(tool.tframe))
            self.moves.append(Move(line, to))

    def _value(self, text, data):
        text = _in_python(text)
        names = {
            "true": True,
            "false": False,
            "di1": self.input() if "di1" in text else 0,
            "offs": _offs,
            "fine": 0,
            "abs": abs,
            **dict.fromkeys(("v100", "v1000", "z10", "z50"), 0),
            **{name: lambda *x, name=name: self._call(name, list(x)) for name in self.routines},
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

    def __init__(self, src, dat, seed):
        super().__init__(seed)
        self.data = {"$NULLFRAME": dict(self.NULL), "$TOOL": None, "$BASE": None, "TOOL_DATA": {}, "BASE_DATA": {}}
        self.routines, self.depth = {}, 0
        for _, line in self._lines(dat):
            text = re.sub(r"^(DECL|GLOBAL)\s+", "", line)
            text = re.sub(r"^(E6POS|E6AXIS|FRAME|FDAT|INT)\s+", "", text)
            match = re.match(r"([$\w]+(?:\[\d+\])?)\s*=(.*)", text)
            if match and not line.startswith("DEFDAT"):
                self._assign(match[1], self._value(match[2], {}), {})
        self.lines = self._split_lines(self._lines(src))
        at = 0
        while at < len(self.lines):
            head = re.match(r"DEF\s+(\w+)\s*\((.*)\)", self.lines[at][1])
            body, at = self._block(at + 1, ("END",))
            parameters = [x.strip() for x in head[2].split(",") if x.strip()]
            self.routines[head[1]] = (parameters, body)
            self.first = getattr(self, "first", head[1])
            at += 1

    @staticmethod
    def _lines(text):
        lines = [(k, re.sub(r"[;&].*", "", line).strip().upper()) for k, line in enumerate(text.splitlines(), 1)]
        return [line for line in lines if line[1]]

    @staticmethod
    def _split_lines(lines):
        """IF c THEN statement ENDIF on a line as its parts."""
        out = []
        for k, text in lines:
            parts = re.split(r"(?<=\bTHEN)\s+|\s+(?=ENDIF\b)|\s+(?=ELSE\b)|(?<=\bELSE)\s+", text)
            out += [(k, part.strip()) for part in parts if part.strip()]
        return out

    def run(self):
        with contextlib.suppress(StopError):
            self._call(self.first, [])
        return self.moves

    def _block(self, at, ends):
        out = []
        while True:
            line, text = self.lines[at]
            word = re.match(r"[$\w]*", text)[0]
            if word in ends:
                return out, at
            if word in ("IF", "WHILE", "FOR", "LOOP", "REPEAT", "SWITCH"):
                close = {"REPEAT": "UNTIL"}.get(word, f"END{word}")
                branches = []
                while True:
                    head = self.lines[at][1]
                    body, at = self._block(at + 1, (close, "ELSE", "CASE", "DEFAULT"))
                    branches.append((head, body))
                    if self.lines[at][1].startswith(close):
                        break
                out.append((word, branches, self.lines[at][1]))
            else:
                out.append(("do", line, text))
            at += 1

    def _call(self, name, given):
        parameters, body = self.routines[name]
        data, back = {}, []
        self.depth += 1
        if self.depth > 20:
            raise StopError
        for parameter, (text, scope) in zip(parameters, given, strict=True):
            key, _, mode = parameter.partition(":")
            data[key.strip()] = copied(self._value(text, scope))
            if mode.strip() != "IN" and re.fullmatch(r"[$\w\[\].]+", text):
                back.append((text, key.strip(), scope))
        self._do(body, data)
        for text, key, scope in back:
            self._assign(text, data[key], scope)
        self.depth -= 1

    def _do(self, block, data):
        at = 0
        while at < len(block):
            self.step()
            try:
                self._one(block[at], data)
                at += 1
            except _GotoError as jump:
                at = _labelled(jump, block, lambda s, label: s[0] == "do" and s[2] == f"{label}:")

    def _one(self, statement, data):
        word = statement[0]
        if word == "do":
            self._simple(statement[1], statement[2], data)
        elif word == "IF":
            head = re.match(r"IF\b(.*)\bTHEN", statement[1][0][0])[1]
            branch = 0 if self._value(head, data) else 1
            if branch < len(statement[1]):
                self._do(statement[1][branch][1], data)
        elif word == "SWITCH":
            value = self._value(statement[1][0][0][6:], data)
            for head, body in statement[1][1:]:
                if head.startswith("DEFAULT") or value in [self._value(x, data) for x in head[4:].split(",")]:
                    self._do(body, data)
                    break
        else:
            self._loop(word, statement, data)

    def _loop(self, word, statement, data):
        head, body = statement[1][0]
        with contextlib.suppress(_BreakError):
            if word == "FOR":
                name, first, last = re.match(r"FOR\s+(\w+)\s*=\s*(.*?)\s+TO\s+(.*)", head).groups()
                for k in range(int(self._value(first, data)), int(self._value(last, data)) + 1):
                    self.data[name] = k
                    self.step()
                    self._do(body, data)
                return
            while word != "WHILE" or self._value(head[5:], data):
                self.step()
                self._do(body, data)
                if word == "REPEAT" and self._value(statement[2][5:], data):
                    return

    def _simple(self, line, text, data):
        match = re.match(r"(PTP|LIN|CIRC|SLIN|SPTP)(_REL)?\s+(?=[^=\s])(.*)", text)
        if match:
            self._move(line, match[1], match[3], data)
            return
        if text.startswith("GOTO"):
            raise _GotoError(text.split()[1])
        if text == "EXIT":
            raise _BreakError
        if text.endswith(":") or text.startswith(("DECL", "WAIT", "HALT", "CONTINUE")):
            return
        call = re.match(r"(\w+)\s*\((.*)\)$", text)
        if call and call[1] == "BAS":
            self._bas([x.strip() for x in call[2].split(",")])
        elif call:
            self._call(call[1], [(one, data) for one in _split(call[2])])
        else:
            target, value = re.match(r"([$\w\[\].\s]+?)\s*=(.*)", text).groups()
            if target.startswith("$OUT"):
                return
            if target == "FDAT_ACT":
                self.form = self.data[value.strip()]
                return
            self._assign(target, self._value(value, data), data)

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
            key = int(self._value(parts[2], data))
        else:
            held, key = scope, parts[1]
        if parts[3]:
            held[key] = {**held[key], parts[3]: value}
        else:
            held[key] = copied(value)

    def _move(self, line, word, text, data):
        text, _, behind = text.partition(" WITH ")
        text = re.sub(r"\s+C_\w+.*", "", text)
        held = {key: self.data[key] for key in ("$TOOL", "$BASE")}
        for one in _split(behind):
            name, _, value = one.partition("=")
            if name.strip() in held:
                held[name.strip()] = self._value(value, data)
        for one in _split(text)[: 2 if word == "CIRC" else 1]:
            value = self._value(one, data)
            if "A1" in value:
                self.moves.append(Move(line, np.radians([value[f"A{k}"] for k in range(1, 7)])))
                continue
            tool, base = (_krl_pose(held[key]) for key in ("$TOOL", "$BASE"))
            self.moves.append(Move(line, base @ _krl_pose(value) @ np.linalg.inv(tool)))

    def _value(self, text, data):
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
                value = value[int(self._value(index, data))] if index else value
                value = value[component] if component else value
            counter[0] += 1
            names[f"v{counter[0]}"] = value
            return f"v{counter[0]}"

        text = re.sub(r"([$A-Z_][$\w]*)\s*(?:\[([^\]]*)\])?(?:\.([A-Z]\d?)\b)?", variable, text)
        return value_of(text, names)


# ---------------------------------------------------------------- FANUC: lines, labels, frames by number


class Fanuc(Controller):
    """Positions are in the frame and of the tool that are selected: the controller's check of numbers is off."""

    def __init__(self, text, frames, seed):
        super().__init__(seed)
        self.frames, self.registers, self.subroutines = frames, {}, set()
        main, _, rest = text.partition("/POS")
        main = main.partition("/MN")[2]
        first = text[: text.index("/MN")].count("\n") + 1
        self.lines = []
        for k, line in enumerate(main.split("\n"), first):
            body = re.sub(r"^\s*\d*:", "", line).strip()
            if not body or body.startswith("!"):
                continue
            body = re.sub(r"\[(\d+):[^\]]*\]", r"[\1]", body)
            if self.lines and not self.lines[-1][1].endswith(";"):
                self.lines[-1] = (self.lines[-1][0], self.lines[-1][1] + " " + body)
            else:
                self.lines.append((k, body))
        self.positions = {}
        for block in re.findall(r"P\[(\d+)[^\]]*\]\s*\{(.*?)\}\s*;", rest, re.DOTALL):
            self.positions[int(block[0])] = self._position(block[1])
        self.selected = {"UFRAME": None, "UTOOL": None}

    @staticmethod
    def _position(text):
        number = r"=\s*(-?\d+\.\d*)"
        if re.search(rf"J1\s*{number}", text):
            return [float(re.search(rf"J{k}\s*{number}", text)[1]) for k in range(1, 7)]
        values = [float(re.search(rf"\b{k}\s*{number}", text)[1]) for k in "XYZWPR"]
        return values, int(re.search(r"UF\s*:\s*(\d+)", text)[1]), int(re.search(r"UT\s*:\s*(\d+)", text)[1])

    def run(self):
        at = 0
        with contextlib.suppress(StopError):
            while at < len(self.lines):
                self.step()
                line, text = self.lines[at]
                at = self._do(at, line, text.rstrip("; "))
        return self.moves

    def _label(self, number):
        return next(k for k, (_, text) in enumerate(self.lines) if re.match(rf"LBL\[{number}\]", text))

    def _end(self, at, *words):
        depth = 0
        for k in range(at + 1, len(self.lines)):
            text = self.lines[k][1]
            if depth == 0 and text.startswith(words):
                return k
            depth += text.rstrip("; ").endswith("THEN") - text.startswith("ENDIF")
        raise AssertionError

    def _do(self, at, line, text):
        match = re.match(r"([JLC])\s+((?:P\[[^\]]*\]+\s*|PR\[[^\]]*\]\s*)+)(.*)", text)
        if match:
            for place in re.findall(r"PR?\[(?:R\[\d+\]|\d+)\]", match[2]):
                self._move(line, place, match[3])
        elif text.startswith("IF") and text.endswith("THEN"):
            return at + 1 if self._true(text[2:-4]) else self._end(at, "ELSE", "ENDIF") + 1
        elif text == "ELSE":
            return self._end(at, "ENDIF") + 1
        elif text.startswith("IF"):
            condition, action = re.split(r",(?![^\[]*\])", text[2:], maxsplit=1)
            if self._true(condition):
                return self._do(at, line, action.strip())
        elif text.startswith("JMP"):
            return self._label(re.search(r"\[(\d+)\]", text)[1])
        elif text.startswith("END") and text != "ENDIF":
            raise StopError
        elif "=" in text and not text.startswith(("WAIT", "ENDIF")):
            target, _, value = text.partition("=")
            self._set(target.strip(), value.strip())
        return at + 1

    def _set(self, target, value):
        if target in ("UFRAME_NUM", "UTOOL_NUM"):
            self.selected[target[:-4]] = int(self._value(value))
        elif target.startswith(("UFRAME[", "UTOOL[")):
            self.frames[target] = self._matrix(self.registers.get(value, [0.0] * 6))
        elif target.startswith("PR[") and "," not in target:
            number = re.match(r"P\[(\d+)\]", value)
            self.registers[target] = list(self.positions[int(number[1])][0]) if number else [100.0, 0, 50, 0, 0, 0]
        elif target.startswith("PR["):
            register, component = re.match(r"(PR\[\d+),(\d+)\]", target).groups()
            self.registers.setdefault(register + "]", [0.0] * 6)[int(component) - 1] = self._value(value)
        elif target.startswith("R["):
            self.registers[target] = self._value(value)

    @staticmethod
    def _matrix(values):
        return written_pose("xyz", *values)

    def _value(self, text):
        def register(match):
            if match[0].startswith("PR"):
                return repr(self.registers.get(match[1] + "]", [0.0] * 6)[int(match[2]) - 1])
            return repr(self.registers.get(match[0], 0))

        text = re.sub(r"(PR\[\d+),(\d+)\]|R\[\d+\]", register, text)
        return value_of(text, {})

    def _true(self, text):
        text = text.strip().strip("()")
        if text.startswith("DI["):
            return self.input()
        return bool(self._value(re.sub(r"(?<![<>])=", "==", text).replace("<>", "!=")))

    def _move(self, line, place, behind):
        if place.startswith("PR"):
            values = self.registers.get(place, [400.0, 0, 300, 0, 0, 0])
        else:
            number = re.search(r"\[(?:R\[(\d+)\]|(\d+))\]", place)
            key = int(self.registers.get(f"R[{number[1]}]", 1)) if number[1] else int(number[2])
            key = key if key in self.positions else 1
            if isinstance(self.positions.get(key), list):
                self.moves.append(Move(line, np.radians(self.positions[key])))
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
        self.moves.append(Move(line, T))

    def _frame(self, name):
        return np.eye(4) if name.endswith("[0]") else self.frames[name]
