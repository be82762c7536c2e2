"""Every term of a joint's error, by the name that robot descriptions use: the one place that knows them all.

Terms of other packages come in by entry points of the group `calib.terms`, or by `TERMS.register` in Python.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Annotated

from pydantic import TypeAdapter, ValidationError

from calib.core.base.errors import DescriptionError, InputError, nearest
from calib.core.base.other_words import hint_for
from calib.core.base.registry import Registry, entry
from calib.core.base.units import Dimension
from calib.core.robots.terms import one_coefficient, periodic
from calib.core.robots.terms.term import CONTEXT, JointTerm, TermSection

TERMS: Registry[JointTerm] = Registry(
    "joint term",
    "calib.terms",
    JointTerm,  # type: ignore[type-abstract]
    {
        "gain": one_coefficient.Gain,
        "harmonics": periodic.Harmonics,
        "curve": periodic.Curve,
        "backlash": one_coefficient.Backlash,
        "coupling": one_coefficient.Coupling,
        "drift": one_coefficient.Drift,
        "temperature": one_coefficient.Temperature,
        "compliance": one_coefficient.Compliance,
        "bending": one_coefficient.Bending,
        "gravity_backlash": one_coefficient.GravityBacklash,
    },
    either=("columns", "formula"),
)

if TYPE_CHECKING:
    AnyTerm = TermSection
else:
    AnyTerm = Annotated[TermSection, *entry("term", TERMS)]
    """The entry of a joint term in a robot description."""


def condition_columns(terms: Iterable[JointTerm] = ()) -> dict[str, Dimension | None]:
    """Return columns of a file for the conditions of a visit, and those that terms read, with their dimensions.

    Columns of a term that cannot be loaded are left out; the error is raised when that term is used.
    """
    columns = dict(CONTEXT) | dict.fromkeys(column for term in terms for column in term.reads())
    for name in TERMS:
        with suppress(DescriptionError):
            for condition in TERMS[name].depends_on:
                if condition.column:
                    columns.setdefault(condition.column, condition.dimension)
    return columns


def terms_text(terms: str | Sequence[str]) -> str:
    """Return a choice of terms as text: names or `JOINT=TERM` with commas between; text is returned unchanged.

    `InputError` if the choice is neither text nor a list of texts, or is empty.
    """
    if isinstance(terms, str):
        return terms
    if not isinstance(terms, Sequence) or not all(isinstance(item, str) for item in terms):
        raise InputError(f"terms {terms!r:.60}: must be text, or a list of texts such as 'elbow=backlash'")
    if not terms:
        raise InputError("terms: the list is empty; leave it out for the description's terms, or give 'none' for none")
    return ",".join(terms)


def parse_terms(text: str) -> tuple[TermSection, ...]:
    """Return the entries of a list of terms, such as `curve,backlash` for every joint, or `curve,elbow=backlash`.

    `InputError` if there is no such term, or only a description can state it.
    """
    sections = []
    for item in text.split(","):
        joint, _, term = (part.strip() for part in item.rpartition("="))
        if term not in TERMS:
            raise InputError(f"terms '{text}': no term '{term}'{hint_for(term, 'joint terms') or nearest(term, TERMS)}")
        try:
            sections.append(TERMS[term].section(joint=joint or "all", term=term))
        except ValidationError:
            raise InputError(
                f"terms '{text}': '{term}' needs further values; write it into the robot description"
            ) from None
    return tuple(sections)


def stored_terms(entries: object) -> tuple[TermSection, ...]:
    """Return the entries that a result stores; `ValueError` if they are no list of terms."""
    return TypeAdapter(tuple[AnyTerm, ...]).validate_python(entries)
