"""A calibration certificate of a robot: laboratory, robot, instruments, uncertainty; as data and as a document."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from calib.core.base.units import in_unit
from calib.core.base.version import PROGRAM
from calib.core.base.words import as_data
from calib.core.judging.repeatability import doubtful_repeats, iso_figures
from calib.core.results.loaded_result import LoadedResult
from calib.core.results.saved_fit import SAVED
from calib.quality.documents import Document, DocumentRows
from calib.quality.traceability import TraceabilitySection
from calib.quality.uncertainty_budget import PROBABILITY, Budget

LEGAL = (
    "This certificate was written by software from the data of its user. Only an accredited laboratory, within its"
    " scope of accreditation, gives a calibration certificate legal force."
)
FEW_CYCLES = "ISO 9283 asks for thirty cycles of five poses; even these are few, as the 95 % intervals say."
MEASURAND = "one coordinate of the tool's position, as the calibrated robot gives it, at poses like those measured"
_NOT_STATED = "not stated"
_SHOWN_IN = {
    "scale": (1e6, "um/m"),
    "offset": (1e6, "um"),
    "offset_angle": (1e6, "urad"),
    "focal_length": (1e6, "um/m"),
    "principal_point": (1.0, "px"),
    "centring": (1e6, "um"),
    "diameter": (1e3, "mm"),
    "calibration": (1.0, "degC"),
    "use": (1.0, "degC"),
    "uncertainty": (1.0, "K"),
    "expansion": (1e6, "um/m/K"),
    "expansion_uncertainty": (1e6, "um/m/K"),
}
"""Factor and unit of numbers of `traceability`, in tables."""
_UNITS = {
    "m": (1e6, "um", 1.0, ""),
    "rad": (1e6, "urad", 1.0, "m/rad"),
    "px": (1.0, "px", 1e6, "um/px"),
    "1": (1.0, "", 1e6, "um"),
    "m/m": (1e6, "um/m", 1.0, "m"),
    "K": (1.0, "K", 1e6, "um/K"),
    "1/K": (1e6, "um/m/K", 1.0, "m K"),
}
"""Factor and unit of standard uncertainties in the table, and of their sensitivity coefficients: products are in um."""
_LEAST = 1e-4  # smaller numbers are shown as 0
_SIGNED_BY = ("Calibrated by", "Approved by")


def certificate_content(result: LoadedResult, stated: TraceabilitySection, found: Budget) -> dict[str, Any]:
    """Return the data of a result's certificate as JSON has them, in SI units."""
    fit = result.fit
    figures, _ = iso_figures(fit.identification, np.random.default_rng(fit.seed))
    digest = hashlib.sha256(Path(result.path, SAVED).read_bytes()).hexdigest()
    free = [fit.parameters[name] for name in fit.free_names]
    content = {
        "identifier": f"calib-{digest[:24]}",
        "robot": result.robot.name,
        "program": PROGRAM,
        "legal_force": LEGAL,
        "verdict": result.verdict.grade,
        "traceability": stated.model_dump(mode="json", exclude_unset=True),
        "n_poses": fit.identification.data.n_poses,
        "measurand": MEASURAND,
        "expansion_to_correct": stated.temperature.expansion * stated.temperature.difference,
        "budget": found.to_dict(),
        "parameters": [
            {"name": p.name, "unit": p.unit, "per_si": p.per_si, "value_si": p.value_si, "std_si": p.std_si}
            for p in free
        ],
        "coverage_factor_of_parameters": fit.statistics.coverage_factor,
        "iso9283": [
            {"name": f.name, "pose": f.poses, "cycles": f.cycles, **vars(f.figure)}
            for f in figures
            if f.name in ("AP", "RP")
        ],
        "iso9283_doubt": doubtful_repeats(fit.identification),
    }
    return dict(as_data(content))


def document(content: Mapping[str, Any]) -> Document:
    """Return a certificate, from its data, as a document."""
    found = content["budget"]
    answer = (
        f"U = {_um(found['expanded_uncertainty'])} um (k = {found['coverage_factor']:.2f},"
        f" {100 * PROBABILITY:.0f} %) for {MEASURAND}. {LEGAL}"
    )
    facts = [("identifier", content["identifier"]), ("robot", content["robot"]), ("program", content["program"])]
    facts += [("verdict of the fit", content["verdict"]), ("poses measured", str(content["n_poses"]))]
    if content["expansion_to_correct"]:
        grown = f"{1e6 * content['expansion_to_correct']:.3g} um/m: apply this correction; the budget assumes it"
        facts.append(("expansion of lengths from the base, in use", grown))
    facts += list(_facts(content["traceability"])) or [("metrological traceability", _NOT_STATED)]
    tables = [DocumentRows("What, by whom, with what", ("what", "stated"), tuple(facts)), _budget_table(found)]
    if "monte_carlo" in content:
        tables.append(_monte_carlo_table(content["monte_carlo"]))
    parameters = tuple(
        (p["name"], f"{p['value_si'] * p['per_si']:.5f}", f"{p['std_si'] * p['per_si']:.2g}", p["unit"])
        for p in content["parameters"]
    )
    title = "Parameters of the robot, correlated: their covariance is in covariance.csv of the result"
    tables.append(DocumentRows(title, ("parameter", "estimate", "standard uncertainty", "unit"), parameters))
    if content["iso9283"]:
        figures = tuple(
            (f["name"], f["pose"], str(f["cycles"]), _um(f["value"]), f"{_um(f['low95'])} to {_um(f['high95'])}")
            for f in content["iso9283"]
        )
        columns = ("figure", "pose", "cycles", "value [um]", "coverage interval, 95 % [um]")
        doubt = content["iso9283_doubt"]
        title = f"Repeated poses. {FEW_CYCLES}{doubt and f' {doubt[0].upper()}{doubt[1:]}.'}"
        tables.append(DocumentRows(title, columns, figures))
    return Document("Calibration certificate of a robot", answer, tuple(tables), _SIGNED_BY, content["identifier"])


def _um(length: float) -> str:
    return _format_number(in_unit(length, "um"), 4)


def _format_number(number: float, digits: int = 3) -> str:
    return f"{number:.{digits}g}" if abs(number) >= _LEAST else "0"


def _facts(entry: Mapping[str, Any], where: str = "") -> Iterator[tuple[str, str]]:
    for key, value in entry.items():
        if isinstance(value, Mapping):
            yield from _facts(value, f"{where}{key}: ")
        else:
            factor, unit = _SHOWN_IN.get(key, (1.0, ""))
            shown = f"{factor * value:.6g} {unit}".strip() if isinstance(value, float) else str(value)
            yield f"{where}{key.replace('_', ' ')}", shown


def _budget_table(found: Mapping[str, Any]) -> DocumentRows:
    rows = []
    for row in found["rows"]:
        factor, unit, of_sensitivity, per = _UNITS[row["unit"]]
        contribution = _um(row["contribution"])
        rows.append(
            (
                row["quantity"],
                f"{factor * row['standard_uncertainty']:.3g} {unit}".strip(),
                f"{_format_number(of_sensitivity * row['sensitivity'])} {per}".strip(),
                contribution if row["counts"] else f"({contribution})",
                _freedom(row["freedom"]),
                row["type"],
                row["note"],
            )
        )
    effective, blank = _freedom(found["effective_degrees_of_freedom"]), ""
    combined, expanded = _um(found["combined_standard_uncertainty"]), _um(found["expanded_uncertainty"])
    note = "degrees of freedom: effective (Welch-Satterthwaite)"
    rows.append(("combined standard uncertainty", blank, blank, combined, effective, blank, note))
    coverage = f"coverage factor {found['coverage_factor']:.3f}, coverage probability {100 * PROBABILITY:.0f} %"
    rows.append(("expanded uncertainty", blank, blank, expanded, blank, blank, coverage))
    columns = (
        "input quantity",
        "standard uncertainty",
        "sensitivity coefficient",
        "uncertainty contribution [um]",
        "degrees of freedom",
        "type of evaluation",
        "source",
    )
    return DocumentRows("Uncertainty budget (GUM)", columns, tuple(rows))


def _freedom(freedom: float | None) -> str:
    return "infinite" if freedom is None else f"{freedom:.0f}"


def _monte_carlo_table(drawn: Mapping[str, Any]) -> DocumentRows:
    rows = (
        ("contributions through the fit", _um(drawn["propagated_fitted"]), _um(drawn["fitted"])),
        ("combined standard uncertainty", _um(drawn["propagated"]), _um(drawn["combined"])),
    )
    title = f"Monte Carlo (GUM Supplement 1): {drawn['draws']} draws, difference"
    title += f" {100 * drawn['relative_difference']:.1f} %"
    return DocumentRows(title, ("quantity", "propagated [um]", "drawn [um]"), rows)
