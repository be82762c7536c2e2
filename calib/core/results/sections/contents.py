"""Contributions to the measures of uncertainty of a fit (`calib.core.base.contributions`)."""

from __future__ import annotations

from calib.core.base.contributions import Contributions, Uncertainty, names_of
from calib.core.fitting.fitted import Fit
from calib.core.judging.verdict import judge


def _contents(fit: Fit) -> dict[Uncertainty, Contributions]:
    contents = {
        Uncertainty.COVARIANCE: fit.covariance.contains,
        Uncertainty.INTERVAL: fit.parameters.contains,
        Uncertainty.POSITION: fit.identification_uncertainty.contains,
    }
    claim = judge(fit).claim
    if claim is not None:
        contents |= {
            Uncertainty.CLAIM: claim.contains,
            Uncertainty.GAIN: fit.contains(Uncertainty.GAIN),
        }
    return contents


def contents_table(fit: Fit) -> dict[str, list[str]]:
    """Return the names of the contributions to each number, for `result.json`."""
    return {number.name.lower(): names_of(contains) for number, contains in _contents(fit).items()}


def contents_lines(fit: Fit) -> list[str]:
    """Return the contributions to each number in words, one line each."""
    return [
        f"{number.value[0].upper()}{number.value[1:].replace('`', '')}: counts {', '.join(names_of(contains))}"
        for number, contains in _contents(fit).items()
    ]
