"""Instruments and places of a robot description: what is measured, from which frames, in which setups.

Without `instruments`, the position of every target is measured: this is short for the kind `position`. A place
(measurement frame, target, or a place of an instrument) that was moved between two setups is a new place from then on.
In setup s, an instrument looks from and at the same two frames, each replaced by its latest new place.
"""

from __future__ import annotations

from dataclasses import replace

from calib.core.base.errors import DescriptionError, require_known
from calib.core.base.sections import COMPONENTS
from calib.core.instruments.kind import FrameInstrument, Instrument, Place, placed
from calib.core.instruments.kinds import KINDS
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.instruments.position import Position
from calib.core.robots.description import Description

MEASUREMENT_FRAME = "measurement frame"
"""Name of the place that `base` describes."""
_TARGETS_GROUP = "targets"


def instruments_of(description: Description, where: str) -> tuple[Instrument, ...]:
    """Return the instruments of a description.

    `DescriptionError` if one looks at a target that does not exist, or two have the same column.
    """
    if not description.instruments:
        noise = Noise((PartNoise.from_sigma(description.sigma, 3),))
        return tuple(Position(name, name, _TARGETS_GROUP, noise=noise) for name in description.targets)
    sections = description.instruments.items()
    instruments = tuple(KINDS[section.kind].from_section(name, section) for name, section in sections)
    for instrument in instruments:
        if isinstance(instrument, FrameInstrument):
            lacks = f"{where}: instruments.{instrument.name}: no target"
            require_known(instrument.target, description.targets, lacks, DescriptionError)
    _check_columns(description, instruments, where)
    return instruments


def _check_columns(description: Description, instruments: tuple[Instrument, ...], where: str) -> None:
    """Raise `DescriptionError` if a column has two meanings."""
    owners: dict[str, Instrument] = {}
    for instrument in instruments:
        for name in [*(column.name for column in instrument.columns()), *instrument.text_columns()]:
            other = owners.setdefault(name, instrument)
            if other is not instrument and (
                instrument.label_column is None or instrument.label_column != other.label_column
            ):
                raise DescriptionError(f"{where}: instruments: two of them have a column '{name}'; rename one")
            if name in (*description.name_mot, "pose", "setup", "instrument"):
                whose = "of a joint" if name in description.name_mot else f"of {name}s"
                raise DescriptionError(
                    f"{where}: instruments.{instrument.name}: its column '{name}' is that {whose}; rename the"
                    " instrument"
                )


def places_of(description: Description, instruments: tuple[Instrument, ...], where: str) -> tuple[Place, ...]:
    """Return the measurement frame, the targets, the places of instruments, and the new places of later setups.

    `DescriptionError` if two places have one name, or a setup names one that does not exist.
    """
    base = description.base
    unknown = COMPONENTS if base.pose == "unknown" else ()
    places = [Place(MEASUREMENT_FRAME, base.frame, base.xyz, base.rpy, unknown, inverted=True)]
    places += [placed(name, target) for name, target in description.targets.items()]
    for instrument in instruments:
        places += instrument.places()
    names = [place.name for place in places]
    again = next((name for k, name in enumerate(names) if name in names[:k]), None)
    if again is not None:
        raise DescriptionError(f"{where}: two places are called '{again}'; rename one")
    for setup, moved in description.setups.items():
        for name in moved:
            require_known(name, ("base", *names[1:]), f"{where}: setups.{setup}: no place", DescriptionError)
            original = places[names.index(_key(name))]
            if not original.unknown:
                raise DescriptionError(
                    f"{where}: setups.{setup}: '{name}' was moved, but its place is said to be known; set it to"
                    " 'unknown'"
                )
            places.append(replace(original, name=_later(original.name, setup)))
    return tuple(places)


def pair_names(description: Description, instrument: Instrument) -> tuple[tuple[str, str], ...]:
    """Return the frames that an instrument looks from and at: all pairs of the first setup, then of the next."""
    return tuple(
        (_place_in_setup(description, a, setup), _place_in_setup(description, b, setup))
        for setup in description.setups or [""]
        for a, b in instrument.pairs(MEASUREMENT_FRAME)
    )


def _key(name: str) -> str:
    return MEASUREMENT_FRAME if name == "base" else name


def _later(place: str, setup: str) -> str:
    """Name of the new place of something that was moved before a setup."""
    return f"{place}@{setup}"


def _place_in_setup(description: Description, place: str, setup: str) -> str:
    """Name that a place has in a setup: the one of its latest move."""
    current = place
    for name, moved in description.setups.items():
        if place in map(_key, moved):
            current = _later(place, name)
        if name == setup:
            break
    return current
