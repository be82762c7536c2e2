"""The names that other packages import to extend `calib`. These names stay; other modules may change.

A package names its additions in its `pyproject.toml`, under these groups of entry points:

    calib.kinds                 a kind of measurement: a class derived from `FrameInstrument`, its `Relation`,
                                or `JointInstrument`
    calib.terms                 a term of a joint's error: a class derived from `JointTerm`
    calib.reasons               a reason of the verdict: a function of a `Fit` that yields `Reason`
    calib.parametrisations      a function that takes nominal origins by name and returns a `Parametrisation`
    calib.formats               formats of `calib export`: a tuple of `Format`
    calib.models                models by name: a mapping to files that `calib fleet` wrote, with their URDF
    calib.readers               formats of measurement files: a tuple of `OtherFormat`
    calib.robot_readers         a format of robot files, named by its ending or outermost XML element: a function of
                                path, content and arguments that returns a URDF and a `ForeignRobot`
    calib.first_descriptions    an option of `calib init` that starts from other files than a URDF: a `FirstFiles`
    calib.qualification         checks of `calib qualify`: a function without arguments that yields `Check`

A notebook registers kinds and terms in `KINDS` and `TERMS`. `check_kind` and `check_term` test them.
"""

from calib.checking import check_kind, check_term
from calib.core.base.arrays import FloatArray, IntArray
from calib.core.base.errors import ComputationError, DataError, DescriptionError, InputError, UrdfError
from calib.core.base.parameter import Parameter
from calib.core.base.sections import (
    KNOWN_ZERO,
    Component,
    FrameSection,
    LengthOrUnknown,
    OwnLength,
    PositiveAngle,
    PositiveLength,
    PositiveLengthOrUnknown,
    Quantity,
    Section,
)
from calib.core.base.units import millimetres, quantity
from calib.core.commands.common import Output
from calib.core.data.other_formats import OtherFormat, SomeFile
from calib.core.fitting.fitted import Fit
from calib.core.instruments.kind import (
    Column,
    Comparison,
    FrameInstrument,
    Guess,
    InstrumentSection,
    JointComparison,
    JointInstrument,
    Part,
    Place,
    Readings,
    Scene,
    View,
)
from calib.core.instruments.kinds import KINDS
from calib.core.instruments.noise import Noise, PartNoise
from calib.core.instruments.relation import RelatedSection, Relation
from calib.core.judging.reasons import Reason
from calib.core.robots.accuracy_of_files import Holds
from calib.core.robots.file_formats import Format, FormatFile
from calib.core.robots.parameters import Origin, Parametrisation, ResultUse, twist_of_edit
from calib.core.robots.robot import Robot
from calib.core.robots.terms.formula import Formula, Proportional, Source, WaveFormula
from calib.core.robots.terms.term import Condition, Context, Joint, JointTerm, TermSection, coefficient
from calib.core.robots.terms.terms import TERMS
from calib.core.robots.urdf.text import ForeignLoop, ForeignRobot
from calib.core.robots.urdf.writing import joint_text, robot_text
from calib.quality.protocol import Check, Phase
from calib.redundancy.named_origins import NamedComponent, NamedOrigins
from calib.shared.first_files import FirstFiles

__all__ = [
    "KINDS",
    "KNOWN_ZERO",
    "TERMS",
    "Check",
    "Column",
    "Comparison",
    "Component",
    "ComputationError",
    "Condition",
    "Context",
    "DataError",
    "DescriptionError",
    "FirstFiles",
    "Fit",
    "FloatArray",
    "ForeignLoop",
    "ForeignRobot",
    "Format",
    "FormatFile",
    "Formula",
    "FrameInstrument",
    "FrameSection",
    "Guess",
    "Holds",
    "InputError",
    "InstrumentSection",
    "IntArray",
    "Joint",
    "JointComparison",
    "JointInstrument",
    "JointTerm",
    "LengthOrUnknown",
    "NamedComponent",
    "NamedOrigins",
    "Noise",
    "Origin",
    "OtherFormat",
    "Output",
    "OwnLength",
    "Parameter",
    "Parametrisation",
    "Part",
    "PartNoise",
    "Phase",
    "Place",
    "PositiveAngle",
    "PositiveLength",
    "PositiveLengthOrUnknown",
    "Proportional",
    "Quantity",
    "Readings",
    "Reason",
    "RelatedSection",
    "Relation",
    "ResultUse",
    "Robot",
    "Scene",
    "Section",
    "SomeFile",
    "Source",
    "TermSection",
    "UrdfError",
    "View",
    "WaveFormula",
    "check_kind",
    "check_term",
    "coefficient",
    "joint_text",
    "millimetres",
    "quantity",
    "robot_text",
    "twist_of_edit",
]
