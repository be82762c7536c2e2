"""Settings of a program (tools, frames, modes) at each of its moves, over all paths that lead to the move.

A reader records each routine as steps: settings, moves, calls, branches and loops. A state holds the value of each
setting. Where two paths meet with different values, the setting is unknown. States are propagated along the paths until
none changes. A step is repeated only if one of its settings has become unknown, so the time is linear in the steps.

Some routines may run at any time (a thread, an interrupt, an error handler). The settings that they change are unknown
everywhere.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Hashable, Iterable, Mapping
from dataclasses import dataclass, field

from calib.core.base.errors import DataError

State = Mapping[str, Hashable]
Change = Callable[[State], State]
EVERYTHING = "*"


@dataclass(frozen=True)
class Unknown:
    """A setting whose value is unknown; `why` is a whole sentence if `whole`, else a predicate of the setting."""

    why: str
    whole: bool = False


@dataclass(frozen=True)
class _Step:
    """A step of a routine; the kind `maybe` is a jump that the program may skip."""

    kind: str
    place: str = ""
    change: Change | None = None
    keys: frozenset[str] = frozenset()
    move: Callable[[State | None], None] | None = None
    at: int = 0
    why: str = ""


@dataclass
class _Routine:
    """Steps of a routine, the states at them, and the calls in it and of it; its number is that of its beginning."""

    number: int
    at_any_time: bool
    steps: list[_Step] = field(default_factory=list)
    labels: dict[str, int] = field(default_factory=dict)
    states: dict[int, State] = field(default_factory=dict)
    keys: set[str] = field(default_factory=set)
    calls: set[str] = field(default_factory=set)
    called_at: set[tuple[int, int]] = field(default_factory=set)


class Flow:
    """A program as routines of steps.

    Args:
        start: First value of each setting.
    """

    def __init__(self, start: State) -> None:
        self.start = dict(start)
        self._routines = {"": _Routine(0, at_any_time=False)}
        self._open = [""]  # reading begins outside all routines
        self._count = 0

    # steps that a reader records

    def begin(self, name: str, where: str = "", *, at_any_time: bool = False) -> None:
        """Begin a routine, which may lie inside an open one.

        Raises:
            DataError: There is a routine with this name.
        """
        if name in self._routines:
            raise DataError(f"{where}: '{name}' is declared twice; give each routine its own name")
        self._routines[name] = _Routine(len(self._routines), at_any_time)
        self._open.append(name)

    def finish(self) -> None:
        """End the open routine."""
        self.label("return")
        if len(self._open) > 1:
            self._open.pop()

    @property
    def routine(self) -> str:
        """Name of the open routine; empty outside of all routines."""
        return self._open[-1]

    def _add(self, step: _Step) -> None:
        routine = self._routines[self.routine]
        if step.kind == "label":
            routine.labels[step.place] = len(routine.steps)
        routine.keys |= step.keys
        if step.kind == "call":
            routine.calls.add(step.place)
        routine.steps.append(step)

    def change(self, keys: Iterable[str], change: Change) -> None:
        """Record a step that changes these settings, or `EVERYTHING`."""
        self._add(_Step("change", change=change, keys=frozenset(keys)))

    def note_setting(self, key: str, value: Hashable) -> None:
        """Record that a setting gets a value."""
        self.change([key], lambda state: {**state, key: value})

    def mark_unknown(self, why: str, keys: Iterable[str] = ()) -> None:
        """Record that these settings, or all, are unknown from here on."""
        some = frozenset(keys)

        def change(state: State) -> State:
            return {**state, **dict.fromkeys(some or state, Unknown(why))}

        self._add(_Step("change", change=change, keys=some or frozenset([EVERYTHING]), why=why))

    def move(self, at: int, move: Callable[[State | None], None]) -> None:
        """Record a move at a place of the text; `follow` calls `move` with the state there, None if unreachable."""
        self._add(_Step("move", move=move, at=at))

    def call(self, name: str, *, maybe: bool = False) -> None:
        """Record a call of a routine; with `maybe` the program may skip the call."""
        if not maybe:
            self._add(_Step("call", name))
            return
        over = self.new_label()
        self.note_jump(over)
        self.call(name)
        self.label(over)

    def label(self, name: str) -> None:
        """Record a label that can be jumped to."""
        self._add(_Step("label", name))

    def jump(self, name: str) -> None:
        """Record a jump; `return` leaves the routine."""
        self._add(_Step("jump", name))

    def note_jump(self, name: str) -> None:
        """Record a jump that the program may skip."""
        self._add(_Step("maybe", name))

    def new_label(self) -> str:
        """Return the name of a label that no program has."""
        self._count += 1
        return f" {self._count}"

    # states at the steps

    def follow(self) -> None:
        """Propagate states along all paths, then call every move with its state, in the order of the text."""
        self._in_order = list(self._routines.values())
        self._spread_keys()
        at_any_time = [routine for routine in self._in_order if routine.at_any_time]
        keys, loose = (set[str]().union(*(each.keys for each in some)) for some in (self._in_order, at_any_time))
        everything = (keys | set(self.start)) - {EVERYTHING}
        changed, loose = (everything if EVERYTHING in some else some for some in (keys, loose))
        reasons = (step.why for routine in at_any_time for step in routine.steps if step.why)
        set_anywhere = "is also set by a part of the program that runs at any time"
        self._loose = dict.fromkeys(loose, Unknown(next(reasons, set_anywhere)))
        start: State = {**dict.fromkeys(everything), **self.start}
        anything: State = {**start, **dict.fromkeys(changed, Unknown("is set by other parts of the program"))}
        self._work: list[tuple[int, int]] = []
        called = set[str]().union(*(routine.calls for routine in self._in_order))
        for name, routine in self._routines.items():
            if routine.at_any_time or name not in called:
                self._arrive(routine, 0, anything if routine.at_any_time else start)
        self._run()
        for routine in self._in_order:
            if 0 not in routine.states:  # routines that only call each other
                self._arrive(routine, 0, start)
                self._run()
        moves = [
            (step.at, step.move, routine.states.get(at))
            for routine in self._in_order
            for at, step in enumerate(routine.steps)
            if step.move is not None
        ]
        for _, move, state in sorted(moves, key=lambda entry: entry[0]):
            move(state)

    def _spread_keys(self) -> None:
        """Add to the settings of each routine the settings of the routines that it calls."""
        callers: dict[str, list[_Routine]] = {name: [] for name in self._routines}
        for routine in self._in_order:
            routine.calls &= set(self._routines)
            for callee in routine.calls:
                callers[callee].append(routine)
        names = list(self._routines)
        work = [(routine, key) for routine in self._in_order for key in routine.keys]
        while work:
            routine, key = work.pop()
            for caller in callers[names[routine.number]]:
                if key not in caller.keys:
                    caller.keys.add(key)
                    work.append((caller, key))

    def _arrive(self, routine: _Routine, at: int, state: State) -> None:
        """Merge a state into the state at a step where paths meet, and queue the step if that state has changed."""
        before, state = routine.states.get(at), {**state, **self._loose}
        if before is not None and (at in (0, len(routine.steps)) or routine.steps[at].kind in ("label", "call")):
            state = _join_states(before, state)
        if state != before:
            routine.states[at] = state
            heapq.heappush(self._work, (routine.number, at))

    def _run(self) -> None:
        """Propagate the state of every queued step to all next steps; the end of a routine leads back to its calls."""
        while self._work:
            number, at = heapq.heappop(self._work)
            routine = self._in_order[number]
            if at == len(routine.steps):
                for caller in routine.called_at:
                    heapq.heappush(self._work, caller)
                continue
            step, after = routine.steps[at], routine.states[at]
            if step.kind in ("jump", "maybe") and step.place in routine.labels:
                self._arrive(routine, routine.labels[step.place], after)
            if step.change is not None:
                after = step.change(after)
            elif step.kind == "call" and step.place in self._routines:
                callee = self._routines[step.place]
                callee.called_at.add((number, at))
                self._arrive(callee, 0, after)
                end = callee.states.get(len(callee.steps))
                if end is None:  # no return of the routine is known
                    continue
                keys = end.keys() if EVERYTHING in callee.keys else callee.keys & end.keys()
                after = {**after, **{key: end[key] for key in keys}}
            if step.kind != "jump":
                self._arrive(routine, at + 1, after)


def _join_states(one: State, other: State) -> State:
    """State where two branches meet; a setting with different values becomes unknown."""
    both = dict(one)
    for key, value in one.items():
        if value != other.get(key) and not isinstance(value, Unknown):
            differs = Unknown("depends on the path by which the program comes here")
            both[key] = other[key] if isinstance(other.get(key), Unknown) else differs
    return both
