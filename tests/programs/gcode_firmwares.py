"""What firmwares do with a G-code program: where the machine goes, by their documented rules.

Written apart from the reader of `calib`, which it judges. Sources of the rules: Klipper's pages "G-Codes" and
"Command templates" and what its `gcode_move` documents; Marlin's pages on each G and M and its notes on parsing;
RepRapFirmware's "G-code dictionary"; LinuxCNC's "G-code reference" (order of execution, offsets, G28).
A firmware is simulated with all its options on that make reading harder: homing of Z moves X and Y away, macros do
something, tools have offsets.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

AXES = "XYZ"
SAFE = np.array([37.0, -21.0, 0.0])  # where homing of Z leads X and Y [mm]


@dataclass
class Step:
    """A motion of the machine [mm]: a commanded move of the program itself, or what a firmware did."""

    commanded: bool
    start: np.ndarray
    end: np.ndarray
    frame: tuple  # zero, geometry and tool that its numbers belong to
    zero: np.ndarray
    e: float
    feed: float


@dataclass
class Machine:
    """State that all firmwares have; positions are the machine's [mm]."""

    # what commands of a firmware do: probe, move the zero, change the geometry; what else G90, G92 and G28 change
    PROBING: ClassVar = ()
    SHIFTING: ClassVar = ()
    REBUILDING: ClassVar = ()
    MODES_OF_E: ClassVar = False
    ZERO_EVERYWHERE: ClassVar = True
    HOMES_ZERO: ClassVar = True

    home: np.ndarray
    macros: dict
    at: np.ndarray = field(default_factory=lambda: np.zeros(3))
    zero: np.ndarray = field(default_factory=lambda: np.zeros(3))
    geometry: int = 0
    tool: str = "T0"
    relative: bool = False
    e_relative: bool = False
    e_at: float = 0.0  # along the filament, as commanded
    e_zero: float = 0.0
    unit: float = 1.0
    feed: float = 0.0
    motion: str = ""
    steps: list = field(default_factory=list)
    others: list = field(default_factory=list)
    depth: int = 0
    saved: dict = field(default_factory=dict)
    stack: list = field(default_factory=list)
    halted: bool = False

    def __post_init__(self):
        self.at = self.home.copy()

    @property
    def frame(self):
        return (tuple(np.round(self.zero, 9)), self.geometry, self.tool)

    def go(self, end, e=0.0, commanded=False):
        """Move to a place."""
        end = np.array(end, dtype=float)
        self.steps.append(Step(commanded, self.at, end, self.frame, self.zero.copy(), e, self.feed))
        self.at = end

    def line(self, words, e_counts_relative):
        """G0 or G1 with numbers by letter."""
        if "F" in words:
            self.feed = words["F"] * self.unit
        end = self.at.copy()
        for k, axis in enumerate(AXES):
            if axis in words:
                value = words[axis] * self.unit
                end[k] = end[k] + value if self.relative else value + self.zero[k]
        e = 0.0
        if "E" in words:
            value = words["E"] * self.unit
            to = self.e_at + value if e_counts_relative else value + self.e_zero
            e, self.e_at = to - self.e_at, to
        self.go(end, e, commanded=self.depth == 0 and any(axis in words for axis in AXES))

    def home_axes(self, named, move_others=True):
        """Homing of axes; that of Z alone leads X and Y to a safe place, that of others lifts Z."""
        end = self.at.copy()
        if move_others and named != {*AXES}:
            end = end + SAFE if "Z" in named else end + np.array([0.0, 0.0, 5.0])
        for k, axis in enumerate(AXES):
            if axis in named:
                end[k] = self.home[k]
        self.go(end)

    def set_zero(self, words, *, every=True):
        """G92: numbers of where it stands; without any, all axes are zero there, if `every`."""
        every = every and not words
        for k, axis in enumerate(AXES):
            if axis in words or every:
                self.zero[k] = self.at[k] - words.get(axis, 0.0) * self.unit
        if "E" in words or every:
            self.e_zero = self.e_at - words.get("E", 0.0) * self.unit

    def command(self, name, words, letters):
        """Run a command as printers do; `letters` are all that the line has."""
        named = {axis for axis in AXES if axis in letters} or {*AXES}
        if name in ("G0", "G1"):
            self.line({k: words[k] for k in words if k in "XYZEF"}, self.e_relative)
        elif name in ("G90", "G91"):
            self.relative = name == "G91"
            self.e_relative = self.relative if self.MODES_OF_E else self.e_relative
        elif name in ("M82", "M83"):
            self.e_relative = name == "M83"
        elif name in ("G20", "G21"):
            self.unit = 25.4 if name == "G20" else 1.0
        elif name == "G92":
            self.set_zero(words, every=self.ZERO_EVERYWHERE)
        elif name == "G28":
            self.home_axes(named)
            for k, axis in enumerate(AXES):
                if axis in named and self.HOMES_ZERO:
                    self.zero[k] = self.saved.get("offset", np.zeros(3))[k]
        elif name in self.PROBING:
            self.go(self.at + np.array([11.0, 12.0, 3.0]))
        elif name in self.SHIFTING:
            self.zero = self.zero + np.array([1.0, 2.0, 3.0])
            self.saved["offset"] = np.array([1.0, 2.0, 3.0])
        elif name in self.REBUILDING:
            self.geometry += 1
        elif name[0] == "T" and name == self.tool:
            pass
        elif name[0] == "T" or name in self.macros:
            self.tool = name if name[0] == "T" else self.tool
            self.call(name)
        else:
            self.others.append((name, tuple(sorted(words.items()))))

    def run(self, text):
        for line in text.split("\n"):
            if not self.halted:
                self.read(line)
        return self

    def call(self, name):
        """Run a macro."""
        self.others.append(name)
        if self.depth < 3:
            self.depth += 1
            for line in self.macros.get(name, ()):
                self.read(line)
            self.depth -= 1


class Klipper(Machine):
    """One command a line; `;` alone begins a comment; G91 makes E relative too, whatever M82 says."""

    PROBING = ("BED_MESH_CALIBRATE", "PROBE", "QUAD_GANTRY_LEVEL", "G29")
    REBUILDING = ("SET_SKEW", "SKEW_PROFILE")

    def read(self, line):
        line = line.split(";")[0].strip().upper()
        parts = re.findall(r"([A-Z_]+)([^A-Z_]*)", line)
        if parts and parts[0][0] == "N":
            parts = parts[1:]
        if not parts or line.startswith(("(", "%")):
            return  # nothing, or an unknown command
        given = {letter: value.strip() for letter, value in parts[1:]}
        name = "".join(parts[0]).strip()
        rest = line.partition(" ")[2]
        try:
            tight = {axis: float(given[axis]) for axis in "XYZEF" if axis in given}
        except ValueError:
            self.halted = name in ("G0", "G1", "G92")  # an error ends a print
            return
        if name in ("G0", "G1"):
            self.line(tight, self.e_relative or self.relative)
        elif name in ("G90", "G91", "M82", "M83", "G92", "G28", *self.PROBING, *self.REBUILDING):
            self.command(name, tight, given)
        elif name == "SET_GCODE_OFFSET":
            offset = self.saved.setdefault("offset", np.zeros(3))
            given = dict(re.findall(r"(\w+)=([-\d.]+)", rest))
            delta = np.array([float(given.get(a, o)) for a, o in zip(AXES, offset, strict=True)]) - offset
            self.zero, self.saved["offset"] = self.zero + delta, offset + delta
            if given.get("MOVE") == "1":
                self.go(self.at + delta)
        elif name == "SET_KINEMATIC_POSITION":
            given = dict(re.findall(r"(\w+)=([-\d.]+)", rest))
            self.geometry += 1  # the same numbers are elsewhere
            self.at = np.array([float(given.get(a, p)) for a, p in zip(AXES, self.at, strict=True)])
        elif name in ("BED_MESH_CLEAR", "BED_MESH_PROFILE"):
            self.at = self.at + np.array([0.0, 0.0, 0.21])
        elif name == "SAVE_GCODE_STATE":
            state = (re.findall(r"NAME=(\S+)", rest) or ["DEFAULT"])[0]
            offset = self.saved.get("offset", np.zeros(3)).copy()
            self.saved[":" + state] = (
                self.relative,
                self.e_relative,
                self.zero.copy(),
                self.at,
                offset,
                self.e_at,
                self.feed,
            )
        elif name == "RESTORE_GCODE_STATE":
            state = ":" + (re.findall(r"NAME=(\S+)", rest) or ["DEFAULT"])[0]
            if state in self.saved:
                self.relative, self.e_relative, zero, at, offset, e_at, self.feed = self.saved[state]
                self.zero, self.saved["offset"] = zero.copy(), offset.copy()
                self.e_zero += self.e_at - e_at
                if re.search(r"MOVE=1", rest):
                    self.go(at)
        elif name in self.macros:
            self.call(name)
        else:
            self.others.append((name, tuple(sorted(given.items()))))


class Marlin(Machine):
    """One command a line; no comment in parentheses; G90 and G91 clear M82 and M83."""

    PROBING, SHIFTING = ("G29", "G30"), ("M206", "M428")
    REBUILDING = ("M92", "M665", "M666", "M852", "M218")
    MODES_OF_E, ZERO_EVERYWHERE = True, False

    def read(self, line):
        line = re.sub(r"^\s*N\s*\d+\s*", "", line.split(";")[0].split("*")[0].strip().upper())
        match = re.match(r"([GMT])\s*(\d+)(?:\.(\d+))?", line)
        if not match:
            return
        name, rest = f"{match[1]}{int(match[2])}", line[match.end() :]
        flags = set(re.findall(r"[A-Z]", rest))
        words = {a: float(v) for a, v in re.findall(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))", rest)}
        if name == "M420":
            self.at = self.at + np.array([0.0, 0.0, 0.21])  # the same place has another Z
        elif name == "G60":
            self.saved["slot"] = self.at
        elif name == "G61" and "slot" in self.saved:
            self.go(self.saved["slot"])
        elif re.fullmatch(r"G5[4-9]", name):
            self.zero = self.zero + np.array([0.0, 0.0, int(name[1:]) - 50.0])
        elif name != "G28" or "O" not in flags:
            self.command(name, words, flags)


class RepRapFirmware(Machine):
    """Commands of a line one after the other; comments in parentheses; M120 and M121 push and pop modes."""

    PROBING, SHIFTING, HOMES_ZERO = ("G29",), ("M206", "M290"), False
    REBUILDING = ("M92", "M556", "M579", "M665", "M666", "M669")

    def read(self, line):
        line = re.sub(r'("[^"]*")|\([^()]*\)|;.*', lambda match: match[1] or " ", line).strip().upper()
        line = re.sub(r"^N\s*\d+\s*", "", line)
        if line.startswith("M117"):
            self.others.append(line)
            return
        if re.match(r"[A-Z_]{2}", line):
            self.call(line.split()[0])
            return
        line = re.sub(r'"[^"]*"', "0", line)  # a text
        for letter, number, rest in re.findall(r"([GMT])(\d+(?:\.\d+)?)([^GM]*)", line):
            self.one(f"{letter}{float(number):g}", rest)

    def one(self, name, rest):
        words = {}
        for letter, value in re.findall(r"([A-Z])\s*([-+]?\d*\.?\d*(?:E[-+]?\d+)?)", rest):
            words[letter] = float(value) if re.search(r"\d", value) else 0.0
        if name in ("G0", "G1") and {"H", "R", "S"} & {*words}:
            self.geometry += 1  # motors by themselves, or a saved place
        if name == "M120":
            self.stack.append((self.relative, self.e_relative, self.unit, self.feed))
        elif name == "M121":
            if self.stack:
                self.relative, self.e_relative, self.unit, self.feed = self.stack.pop()
        elif name == "G30":
            self.go(self.at + np.array([0.0, 0.0, -2.0]))
            self.zero = self.zero + np.array([0.0, 0.0, 0.4])
        elif name == "G10" and {*AXES} & {*words}:
            self.zero = self.zero + np.array([words.get(axis, 0.0) for axis in AXES])
        elif re.fullmatch(r"G5[4-9]", name):
            self.zero = self.saved.setdefault(name, np.full(3, float(name[1:]) - 54.0)).copy()
        else:
            self.command(name, words, {*words})


class Cnc(Machine):
    """A line is run at once, modes before motion; G0 and G1 go on; G28 goes to a place over X, Y, Z of its line."""

    def read(self, line):
        line = re.sub(r"\([^()]*\)|;.*", " ", line).strip().upper()
        line = re.sub(r"^N\s*\d+\s*", "", line)
        words = re.findall(r"([A-Z])\s*([-+]?(?:\d+\.?\d*|\.\d+))", line)
        codes = [f"{a}{float(v):g}" for a, v in words if a in "GM"]
        given = {a: float(v) for a, v in words if a not in "GM"}
        for tool in [f"T{given['T']:g}"] if "T" in given else []:
            self.saved["next"] = tool
        if "F" in given:
            self.feed = given["F"] * self.unit
        for code in codes:
            if code == "M6":
                self.tool = self.saved.get("next", self.tool)
                self.call("M6")
            elif code in ("G20", "G21"):
                self.unit = 25.4 if code == "G20" else 1.0
            elif code in ("G90", "G91"):
                self.relative = code == "G91"
            elif re.fullmatch(r"G5[4-9]", code):
                self.zero = np.full(3, float(code[1:]) - 54.0)
            elif code == "M70":
                self.stack.append((self.relative, self.unit))
            elif code == "M72" and self.stack:
                self.relative, self.unit = self.stack[-1]
            elif code in self.macros and code != "M6":
                self.call(code)
        for code in codes:
            if code in ("G0", "G1"):
                self.motion = code
            elif code == "G80":
                self.motion = ""
            elif code[0] == "M":
                self.others.append(code)
        if "G92" in codes:
            self.set_zero({axis: given[axis] for axis in AXES if axis in given}, every=False)
        elif "G28" in codes or "G30" in codes:
            named = [axis for axis in AXES if axis in given] or [*AXES]
            end = self.at.copy()
            for k, axis in enumerate(AXES):
                if axis in given:
                    value = given[axis] * self.unit
                    end[k] = end[k] + value if self.relative else value + self.zero[k]
            self.go(end)
            self.go([self.home[k] if axis in named else end[k] for k, axis in enumerate(AXES)])
        elif any(axis in given for axis in AXES) and not {"G4", "G10"} & {*codes} and self.motion:
            self.line({k: v for k, v in given.items() if k in "XYZE"}, False)


FIRMWARES = {"klipper": Klipper, "marlin": Marlin, "rrf": RepRapFirmware, "cnc": Cnc}
