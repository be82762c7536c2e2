"""Remarks in the comments of measurement files, such as that they are simulated.

The pages show them in the files' own words. Lines such as `# operator: J. Doe` are the record of the measurement, which
the report has in a table of its own.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import numpy as np

from calib import Fit, Measurements
from calib.core.judging.repeatability import CONDITIONS, conditions

_SIGNATURES, _TEMPERATURE, _TOLERANCE = "signatures", "temperature", "tolerance"
_RECORD = ("serial number", "instrument", "certificate", "operator", "temperature", "load", "speed", "warm-up")
_KEYS = (*_RECORD, *CONDITIONS, _SIGNATURES, _TOLERANCE)
_MOST_LINES, _LONGEST = 6, 240
_SIMULATED = re.compile(r"\bsimulat", re.IGNORECASE)


def remarks(*comments: Iterable[str]) -> dict[str, Any]:
    """Return the comments of measurement files for pages: each line once, shortened if long, on simulation first.

    `more`: number of further comments. `simulated`: whether a shown line mentions simulation.
    """
    lines = list(dict.fromkeys(text for lines in comments for line in lines if (text := " ".join(line.split()))))
    lines.sort(key=lambda line: not _SIMULATED.search(line))
    shown = [line if len(line) <= _LONGEST else line[: _LONGEST - 1].rstrip() + "…" for line in lines[:_MOST_LINES]]
    return {"lines": shown, "more": len(lines) - len(shown), "simulated": any(map(_SIMULATED.search, shown))}


def fit_remarks(fit: Fit, *, beside_record: bool = False) -> dict[str, Any]:
    """Return the comments of a fit's files; with `beside_record`, without those in `record` and `signatures`."""
    files = (data.comments for data in _files(fit))
    if not beside_record:
        return remarks(*files)
    return remarks(*([line for line in lines if not conditions([line], _KEYS)] for lines in files))


def record(fit: Fit) -> list[tuple[str, str]]:
    """Return the stated conditions of the measurement: names and texts."""
    stated = {key: _stated_texts(fit, key) for key in _RECORD}
    stated[_TEMPERATURE] = stated[_TEMPERATURE] or _temperatures(fit)
    return [(key.capitalize(), "; ".join(values)) for key, values in stated.items() if values]


def signatures(fit: Fit) -> list[str]:
    """Return the roles that sign, a line for each."""
    lines = [part.strip() for text in _stated_texts(fit, _SIGNATURES) for part in text.split(";")]
    return list(dict.fromkeys(line for line in lines if line))


def tolerance(fit: Fit) -> str:
    """Return the required tolerance as stated in the files; empty if they state none or several."""
    stated = _stated_texts(fit, _TOLERANCE)
    return stated[0] if len(stated) == 1 else ""


def _files(fit: Fit) -> list[Measurements]:
    return [errors.data for errors in (fit.identification, fit.validation) if errors is not None]


def _stated_texts(fit: Fit, key: str) -> list[str]:
    """Texts of the files under a key, each once."""
    texts = [conditions(data.comments, _KEYS).get(key, "") for data in _files(fit)]
    return [text for text in dict.fromkeys(texts) if text]


def _temperatures(fit: Fit) -> list[str]:
    values = np.concatenate([data.context.get(_TEMPERATURE, np.zeros(0)) for data in _files(fit)])
    known = values[np.isfinite(values)]
    if not len(known):
        return []
    ends = list(dict.fromkeys(f"{value:.1f}".replace("-", "−") for value in (known.min(), known.max())))
    return [f"{' to '.join(ends)} degC, as read at the poses"]
