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
    """Steps of a routine, and the states at them."""

    at_any_time: bool
    steps: list[_Step] = field(default_factory=list)
    labels: dict[str, int] = field(default_factory=dict)
    states: dict[int, State] = field(default_factory=dict)
    keys: set[str] = field(default_factory=set)
    calls: set[str] = field(default_factory=set)

    @property
    def final_state(self) -> State | None:
        """State after the last step; None as long as no return of the routine is known."""
        return self.states.get(len(self.steps))

    def state_at(self, at: int, state: State) -> State:
        """Return the state at a step reached with `state`, joined with earlier states where paths meet."""
        many = at in (0, len(self.steps)) or self.steps[at].kind in ("label", "call")
        return _join_states(self.states[at], state) if many and at in self.states else state


class Flow:
    """A program as routines of steps.

    Args:
        start: First value of each setting.
    """

    def __init__(self, start: State) -> None:
        self.start = dict(start)
        self.routines: dict[str, _Routine] = {}
        self._open = [""]  # reading begins outside all routines
        self.routines[""] = _Routine(at_any_time=False)
        self._count = 0

    # steps that a reader records

    def begin(self, name: str, where: str = "", *, at_any_time: bool = False) -> None:
        """Begin a routine, which may lie inside an open one.

        Raises:
            DataError: There is a routine with this name.
        """
        if name in self.routines:
            raise DataError(f"{where}: '{name}' is declared twice; give each routine its own name")
        self.routines[name] = _Routine(at_any_time)
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
        routine = self.routines[self.routine]
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
        for routine in self.routines.values():
            routine.calls &= set(self.routines)
        self._spread_keys()
        keys = {key for routine in self.routines.values() for key in routine.keys}
        loose = {key for routine in self.routines.values() if routine.at_any_time for key in routine.keys}
        everything = (keys | set(self.start)) - {EVERYTHING}
        changed, loose = (everything if EVERYTHING in some else some for some in (keys, loose))
        steps = (step for routine in self.routines.values() if routine.at_any_time for step in routine.steps)
        set_anywhere = "is also set by a part of the program that runs at any time"
        self._loose = dict.fromkeys(loose, Unknown(next((step.why for step in steps if step.why), set_anywhere)))
        self._start = {**dict.fromkeys(everything), **self.start}
        anything = {**self._start, **dict.fromkeys(changed, Unknown("is set by other parts of the program"))}
        self._work: list[tuple[int, int]] = []
        self._names = list(self.routines)
        self._numbers = {name: number for number, name in enumerate(self._names)}
        self._callers: dict[str, set[tuple[int, int]]] = {name: set() for name in self._names}
        called = {name for routine in self.routines.values() for name in routine.calls}
        for name, routine in self.routines.items():
            if routine.at_any_time:
                self._arrive(name, 0, anything)
            elif name not in called:
                self._arrive(name, 0, self._start)
        self._run()
        for name, routine in self.routines.items():
            if 0 not in routine.states:  # routines that only call each other
                self._arrive(name, 0, self._start)
                self._run()
        moves = [
            (step.at, step.move, routine.states.get(at))
            for routine in self.routines.values()
            for at, step in enumerate(routine.steps)
            if step.move is not None
        ]
        for _, move, state in sorted(moves, key=lambda entry: entry[0]):
            move(state)

    def _spread_keys(self) -> None:
        """Add to the settings of each routine the settings of the routines that it calls."""
        callers: dict[str, list[str]] = {name: [] for name in self.routines}
        for name, routine in self.routines.items():
            for callee in routine.calls:
                callers[callee].append(name)
        for key in {key for routine in self.routines.values() for key in routine.keys}:
            work = [name for name, routine in self.routines.items() if key in routine.keys]
            while work:
                for caller in callers[work.pop()]:
                    if key not in self.routines[caller].keys:
                        self.routines[caller].keys.add(key)
                        work.append(caller)

    def _arrive(self, name: str, at: int, state: State) -> None:
        """Merge a state into the state at a step, and queue the step if that state has changed."""
        routine = self.routines[name]
        together = routine.state_at(at, {**state, **self._loose})
        if together != routine.states.get(at):
            routine.states[at] = together
            heapq.heappush(self._work, (self._numbers[name], at))

    def _run(self) -> None:
        while self._work:
            number, at = heapq.heappop(self._work)
            self._take_step(self._names[number], at)

    def _take_step(self, name: str, at: int) -> None:
        """Propagate the state of a step to all next steps; the end of a routine leads back to all its calls."""
        routine = self.routines[name]
        if at == len(routine.steps):
            for caller in self._callers[name]:
                heapq.heappush(self._work, caller)
            return
        step, state = routine.steps[at], routine.states[at]
        after: State | None = state
        if step.change is not None:
            after = step.change(state)
        elif step.kind in ("jump", "maybe"):
            if step.place in routine.labels:
                self._arrive(name, routine.labels[step.place], state)
            after = state if step.kind == "maybe" else None
        elif step.kind == "call" and step.place in self.routines:
            after = self._state_after_call(name, at, step.place, state)
        if after is not None:
            self._arrive(name, at + 1, after)

    def _state_after_call(self, name: str, at: int, callee: str, state: State) -> State | None:
        """State after a call; None as long as no return of the routine is known."""
        routine = self.routines[callee]
        self._callers[callee].add((self._numbers[name], at))
        self._arrive(callee, 0, state)
        if routine.final_state is None:
            return None
        keys = set(routine.final_state) if EVERYTHING in routine.keys else routine.keys
        return {**state, **{key: routine.final_state[key] for key in keys if key in routine.final_state}}


def _join_states(one: State, other: State) -> State:
    """State where two branches meet; a setting with different values becomes unknown."""
    both = dict(one)
    for key, value in one.items():
        if value != other.get(key) and not isinstance(value, Unknown):
            differs = Unknown("depends on the path by which the program comes here")
            both[key] = other[key] if isinstance(other.get(key), Unknown) else differs
    return both
