"""Visits of a program to its targets, and which targets can get other numbers.

The numbers of a target stand in one place, and the program may go there several times. They stay unchanged if any of
these visits cannot be compensated, if visits have different tools or frames, or if the target would move along with
another target that is its frame or tool.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from calib.core.base.errors import DataError
from calib.programs.languages.robot_program import NotCompensated, ProgramSource, ProgramTarget, RobotProgram

Place = tuple[int, int]
"""Where numbers stand: index of the file, and index of their first word."""


@dataclass(frozen=True)
class Visit:
    """A move of the program to a target.

    Attributes:
        where: File and line of the move.
        text: The text there.
        place: Place of the target's numbers; None if the program does not have them.
        target: The target; None if it cannot be compensated.
        why: Reason why it cannot.
        frames: Places of the program's data that define its frame or tool.
    """

    where: tuple[str, int]
    text: str
    place: Place | None
    target: ProgramTarget | None = None
    why: str = ""
    frames: tuple[Place, ...] = ()

    def not_compensated(self, why: str) -> NotCompensated:
        """Return the entry for a target that stays unchanged."""
        return NotCompensated(*self.where, self.text, why)


def program_of(language: str, sources: Sequence[ProgramSource], visits: Iterable[Visit]) -> RobotProgram:
    """Return a program with the targets that can be compensated.

    Args:
        language: Name of its language.
        sources: Its files, the given file first.
        visits: Visits in the order of the text.

    Raises:
        DataError: No target can be compensated.
    """
    left = list[NotCompensated]()
    same = dict[Place, list[Visit]]()
    for visit in visits:
        if visit.target is None:
            left.append(visit.not_compensated(visit.why))
        if visit.place is not None:
            same.setdefault(visit.place, []).append(visit)
    targets = dict[Place, ProgramTarget]()
    for place, group in same.items():
        stays = next((visit for visit in group if visit.target is None or _differs(group[0], visit)), None)
        if stays is None:
            targets[place] = _join_visits(group)
            continue
        if stays.target is not None:
            left.append(stays.not_compensated("is reached with different tools or frames; give each a target"))
        because = f"stays as it is because of line {stays.where[1]}"
        left += [visit.not_compensated(because) for visit in group if visit.target is not None and visit is not stays]
    along = {
        place: targets[frame].name
        for place in targets
        for visit in same[place]
        for frame in reversed(visit.frames)
        if frame in targets
    }
    for place, name in along.items():
        left += [
            visit.not_compensated(f"moves along with {name}, a target that is its frame or tool")
            for visit in same[place]
        ]
        del targets[place]
    once = dict[tuple[str, int, str], NotCompensated]()
    for place_left in left:
        once.setdefault((place_left.path, place_left.line, place_left.text), place_left)
    ordered = sorted(once.values(), key=lambda place_left: (place_left.path != sources[0].path, place_left.line))
    if not targets:
        why = f"; {ordered[0]}" if ordered else ""
        raise DataError(f"{sources[0].path}: has no targets that can be compensated as {language}{why}")
    return RobotProgram(language, tuple(sources), tuple(targets.values()), tuple(ordered))


def _differs(first: Visit, visit: Visit) -> bool:
    one, other = first.target, visit.target
    if one is None or other is None or one.rotation is None:
        return False
    return not (one.frame.isApprox(other.frame) and one.tool.isApprox(other.tool))


def _join_visits(group: Sequence[Visit]) -> ProgramTarget:
    """The target of equal visits, with the first stated near joints."""
    targets = [visit.target for visit in group if visit.target is not None]
    return replace(targets[0], near=next((target.near for target in targets if target.near), ()))
