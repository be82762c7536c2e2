"""A certificate as a digital calibration certificate: XML by PTB's schema DCC 3.2.0, quantities in D-SI 2.1.

The order of elements, the required elements, and the units follow the schemas (https://ptb.de/dcc/v3.2.0/dcc.xsd,
https://ptb.de/si/v2.1.0/SI_Format.xsd); `tests/quality/test_certificate.py` checks the rules. Required elements without
a statement are written as "not stated", a country as ZZ (ISO 3166-1 reserves it for users); a date must be stated.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

from calib.core.base.errors import InputError, require_package
from calib.core.base.units import PER_SI
from calib.core.base.version import DISTRIBUTION, VERSION
from calib.quality.certificate import LEGAL, MEASURAND

DCC, SI = "https://ptb.de/dcc", "https://ptb.de/si"
SCHEMA = "3.2.0"
_UNITS = {
    "length": r"\metre",
    "angle": r"\radian",
    "time": r"\second",
    "temperature": r"\kelvin",
    "mass": r"\kilogram",
    "acceleration": r"\metre\second\tothe{-2}",
    "number": r"\one",
}
_UNIT_OF = {unit: _UNITS[dimension] for dimension, units in PER_SI.items() if dimension in _UNITS for unit in units}
_UNSTATED, _NOWHERE = "not stated", "ZZ"

Node: TypeAlias = tuple[str, "str | Sequence[Node]"]
"""Name of an XML element, and its text or its children; names of D-SI begin with `si:`."""


def xml(content: Mapping[str, Any]) -> bytes:
    """Return a certificate as XML, from its data.

    Raises:
        InputError: lxml is not installed, or the description does not give the day of the measurements.
    """
    missing = f"a digital certificate needs lxml: pip install '{DISTRIBUTION}[certificate]'"
    etree = require_package("lxml.etree", missing)
    stated = content["traceability"]
    if not stated.get("date"):
        raise InputError(
            "a digital certificate needs the day of the measurements: write 'traceability: {date: 2026-01-31}' into the"
            " robot description, or into a file for --traceability"
        )
    root = etree.Element(f"{{{DCC}}}digitalCalibrationCertificate", nsmap={"dcc": DCC, "si": SI})
    root.set("schemaVersion", SCHEMA)
    for node in (("administrativeData", _administrative(content)), ("measurementResults", _results(content))):
        _append(etree, root, node)
    return bytes(etree.tostring(root, xml_declaration=True, encoding="UTF-8", pretty_print=True))


def _append(etree: Any, parent: Any, node: Node) -> None:
    name, inside = node
    space = SI if name.startswith("si:") else DCC
    element = etree.SubElement(parent, f"{{{space}}}{name.removeprefix('si:')}")
    if isinstance(inside, str):
        element.text = inside
    else:
        for child in inside:
            _append(etree, element, child)


def _text(name: str, text: str | None) -> Node:
    return name, [("content", _word(text))]


def _word(text: str | None) -> str:
    return " ".join((text or "").split()) or _UNSTATED


def _identifications(values: Mapping[str, str | None], issuers: Sequence[str] = ("manufacturer", "other")) -> Node:
    """Identification numbers by name, each with its issuer."""
    return "identifications", [
        ("identification", [("issuer", issuer), ("value", _word(value)), _text("name", name)])
        for (name, value), issuer in zip(values.items(), issuers, strict=False)
    ]


def _administrative(content: Mapping[str, Any]) -> list[Node]:
    stated, item = content["traceability"], content["traceability"].get("item", {})
    country = stated.get("country") or _NOWHERE
    location: Node = ("location", [("countryCode", country), _text("further", stated.get("site"))])
    software: Node = ("software", [_text("name", DISTRIBUTION), ("release", VERSION), ("type", "application")])
    core: Node = (
        "coreData",
        [
            ("countryCodeISO3166_1", country),
            ("usedLangCodeISO639_1", "en"),
            ("mandatoryLangCodeISO639_1", "en"),
            ("uniqueIdentifier", content["identifier"]),
            ("beginPerformanceDate", stated["date"]),
            ("endPerformanceDate", stated["date"]),
            ("performanceLocation", "other"),
        ],
    )
    robot: Node = (
        "item",
        [
            _text("name", content["robot"]),
            ("manufacturer", [_text("name", item.get("maker"))]),
            ("model", _word(item.get("type"))),
            _identifications({"serial number": item.get("serial")}),
        ],
    )
    return [
        ("dccSoftware", [software]),
        core,
        ("items", [robot]),
        ("calibrationLaboratory", [("contact", [_text("name", stated.get("laboratory")), location])]),
        (
            "respPersons",
            [("respPerson", [("person", [_text("name", stated.get("operator"))]), ("mainSigner", "true")])],
        ),
        ("customer", [_text("name", stated.get("customer")), ("location", [_text("further", None)])]),
        ("statements", [("statement", [_text("declaration", LEGAL)])]),
    ]


def _results(content: Mapping[str, Any]) -> list[Node]:
    found = content["budget"]
    method = "Parameters by least squares, uncertainty by the GUM (JCGM 100)"
    expanded = _quantity(
        f"deviation of {MEASURAND}",
        0.0,
        r"\metre",
        (found["expanded_uncertainty"], found["coverage_factor"], found["coverage_probability"]),
    )
    rows = [_quantity(row["quantity"], row["contribution"], r"\metre") for row in found["rows"] if row["counts"]]
    rows.append(_quantity("combined standard uncertainty", found["combined_standard_uncertainty"], r"\metre"))
    if "monte_carlo" in content:
        drawn = content["monte_carlo"]["combined"]
        rows.append(_quantity("combined standard uncertainty by Monte Carlo", drawn, r"\metre"))
    k = content["coverage_factor_of_parameters"]
    parameters = [
        _quantity(p["name"], p["value_si"], _UNIT_OF.get(p["unit"], ""), (k * p["std_si"], k, 0.95))
        for p in content["parameters"]
    ]
    grown = _quantity("expansion of lengths in use, to be corrected", content["expansion_to_correct"], r"\one")
    results = [
        _result("Tool position", [expanded, grown]),
        _result("Uncertainty budget: contributions", [("list", rows)]),
        _result("Parameters of the robot", [("list", parameters)] if parameters else []),
    ]
    figures = [_quantity(f"{f['name']} {f['pose']}", f["value"], r"\metre") for f in content["iso9283"]]
    results.append(_result("AP and RP by ISO 9283", [("list", figures)] if figures else []))
    return [
        (
            "measurementResult",
            [
                _text("name", "Calibration of a robot"),
                ("usedMethods", [("usedMethod", [_text("name", method), ("norm", "JCGM 100:2008")])]),
                *_equipment(content["traceability"]),
                *_conditions(content["traceability"]),
                ("results", [result for result in results if result is not None]),
            ],
        )
    ]


def _result(name: str, data: Sequence[Node]) -> Node | None:
    return ("result", [_text("name", name), ("data", data)]) if data else None


def _quantity(name: str, value: float, unit: str, uncertainty: tuple[float, float, float] | None = None) -> Node:
    """A quantity in D-SI, from a value in SI; `uncertainty`: expanded uncertainty, coverage factor and probability."""
    if not unit:
        return "quantity", [_text("name", name), _text("noQuantity", f"{value!r} (its unit is none of D-SI)")]
    real: list[Node] = [("si:value", repr(float(value))), ("si:unit", unit)]
    if uncertainty is not None and all(map(math.isfinite, uncertainty)):
        expanded, k, probability = uncertainty
        parts = (("uncertainty", repr(float(expanded))), ("coverageFactor", f"{k:.6f}"))
        elements = [(f"si:{key}", text) for key, text in (*parts, ("coverageProbability", repr(probability)))]
        real.append(("si:expandedUnc", elements))
    return "quantity", [_text("name", name), ("si:real", real)]


def _equipment(stated: Mapping[str, Any]) -> list[Node]:
    instrument = stated.get("instrument")
    if not instrument:
        return []
    equipment = [
        _text("name", instrument.get("type")),
        ("manufacturer", [_text("name", instrument.get("maker"))]),
        _identifications({"serial number": instrument.get("serial"), "certificate": instrument.get("certificate")}),
    ]
    return [("measuringEquipments", [("measuringEquipment", equipment)])]


def _conditions(stated: Mapping[str, Any]) -> list[Node]:
    heat = stated.get("temperature", {})
    named = {"calibration": "temperature at calibration", "use": "temperature in use"}
    quantities = [
        _quantity(name, heat[key] + 273.15, r"\kelvin") for key, name in named.items() if heat.get(key) is not None
    ]
    if not quantities:
        return []
    condition = ("influenceCondition", [_text("name", "temperature of the robot"), ("data", quantities)])
    return [("influenceConditions", [condition])]
