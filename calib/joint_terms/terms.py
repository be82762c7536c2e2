"""Every term of a joint's error, by the name that robot descriptions use: the one place that knows them all."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Union

from pydantic import Discriminator, Tag

from calib.joint_terms.backlash import Backlash
from calib.joint_terms.compliance import Compliance
from calib.joint_terms.coupling import Coupling
from calib.joint_terms.curve import Curve
from calib.joint_terms.drift import Drift, Temperature
from calib.joint_terms.gain import Gain
from calib.joint_terms.harmonics import Harmonics
from calib.joint_terms.term import JointTerm, TermSection

TERMS: dict[str, type[JointTerm]] = {
    "gain": Gain,
    "harmonics": Harmonics,
    "curve": Curve,
    "backlash": Backlash,
    "coupling": Coupling,
    "drift": Drift,
    "temperature": Temperature,
    "compliance": Compliance,
}


def _term_of(value: Any) -> str | None:
    return str(value.get("term")) if isinstance(value, dict) else getattr(value, "term", None)


if TYPE_CHECKING:
    AnyTerm = TermSection
else:
    _tagged = tuple(Annotated[kind.section, Tag(name)] for name, kind in TERMS.items())
    AnyTerm = Annotated[Union[_tagged], Discriminator(_term_of)]  # noqa: UP007  # a tuple, known only when it runs
    """The entry of a joint term in a robot description."""
