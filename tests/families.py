"""Families of cases of which `make test` runs some, and `make test-thorough` all."""

from collections.abc import Iterable

import pytest


def family(every: Iterable[object], quick: Iterable[object]) -> list[object]:
    """Parameters of a test: cases outside of `quick` are for the thorough run alone; a tuple has several values."""
    chosen = list(quick)
    return [
        pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.amount(case in chosen, 1))
        for case in every
    ]
