"""What a comparison of results says: parameters with their intervals, errors, and which differences are real.

`calib.reporting.result_differences` makes it, and derives its tests.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.table import Table

from calib.arrays import FloatArray
from calib.words import counted, plain_text

CHANCE = 0.05
"""Chance that anything is called real that is not."""
_SHOWN = 20
_WIDTH = 118


@dataclass(frozen=True)
class Difference:
    """One parameter in the results.

    Attributes:
        name: Its name.
        rows: Its row in `result.json` of each result, in its unit; None where it has no such parameter.
        p_values: Chance of a difference to the first result as large as this, for each of the others, corrected for
            their number; NaN where there is no test.
    """

    name: str
    rows: tuple[dict[str, Any] | None, ...]
    p_values: tuple[float, ...]

    @property
    def real(self) -> tuple[bool, ...]:
        """Whether each of the other results differs from the first."""
        return tuple(p < CHANCE for p in self.p_values)


@dataclass(frozen=True, eq=False, repr=False)
class ResultComparison:
    """Results side by side, the first against the others.

    Attributes:
        names: Of the results.
        verdicts, n_poses: Of each.
        errors: Root mean square error after calibration of each, on readings not used where there are any.
        unit: Unit of these errors.
        errors_on: On which readings each was found.
        sizes: Size of the error of each reading after calibration, in that unit, of each result on the same readings
            that none of them used; empty where there are none.
        differences: One for each parameter.
        together: p-value of all differences to the first, for each of the others; NaN where there is no test.
        notes: What to know before believing it.
    """

    names: tuple[str, ...]
    verdicts: tuple[str, ...]
    n_poses: tuple[int, ...]
    errors: tuple[float, ...]
    unit: str
    errors_on: tuple[str, ...]
    sizes: tuple[FloatArray, ...]
    differences: tuple[Difference, ...]
    together: tuple[float, ...]
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        real = sum(any(one.real) for one in self.differences)
        return f"<comparison of {len(self.names)} results: {real} of {len(self.differences)} parameters differ>"

    def __str__(self) -> str:
        return self.report()

    def report(self) -> str:
        """Return the comparison as text: one table, the surest differences first."""
        heads = [
            f"{name}: {verdict}, {poses} poses, {error:.4g} {self.unit} RMS on {where}"
            for name, verdict, poses, error, where in zip(
                self.names, self.verdicts, self.n_poses, self.errors, self.errors_on, strict=True
            )
        ]
        ranked = self.ranked()
        table = Table(box=None, pad_edge=False)
        for head in ("parameter", "unit", *self.names, "p"):
            table.add_column(head, justify="left" if head in ("parameter", "unit") else "right", overflow="fold")
        for one in ranked[:_SHOWN]:
            marks = (False, *one.real)
            cells = [_cell(row, mark) for row, mark in zip(one.rows, marks, strict=True)]
            unit = next(str(row["unit"]) for row in one.rows if row is not None)
            table.add_row(one.name, unit, *cells, ", ".join(p_text(p) for p in one.p_values))
        more = len(self.differences) - len(ranked[:_SHOWN])
        lines = [f"... and {counted(more, 'parameter')} with less certain differences, or none to test"] if more else []
        return plain_text(
            ["\n".join(heads) + "\n", table, *lines, "\n" + self.conclusion(), *self.notes], _WIDTH, wrap=True
        )

    def ranked(self) -> list[Difference]:
        """Return the differences that were tested (all, if none was), the surest first."""
        tested = [one for one in self.differences if np.any(np.isfinite(one.p_values))]
        return sorted(tested or self.differences, key=lambda one: np.nanmin([*one.p_values, 2.0]))

    def conclusion(self) -> str:
        """Return in a sentence which differences are real."""
        real = [one.name for one in self.differences if any(one.real)]
        found = counted(len(real), "parameter differs", "parameters differ") if real else "No single parameter differs"
        all_of_them = ", ".join(p_text(p) for p in self.together)
        return (
            f"{found} from {self.names[0]} (marked *; values +- 95 %; p corrected for their number, real below"
            f" {CHANCE:g}). All together: p {all_of_them}."
        )

    def to_dict(self) -> dict[str, object]:
        """Return the comparison for `--json`, in the units of tables; null where there is no test."""
        results = zip(self.names, self.verdicts, self.n_poses, self.errors, self.errors_on, strict=True)
        return {
            "results": [
                {
                    "name": name,
                    "verdict": verdict,
                    "n_poses": poses,
                    "rms": _number(rms),
                    "unit": self.unit,
                    "on": where,
                }
                for name, verdict, poses, rms, where in results
            ],
            "parameters": [
                {"name": one.name, "results": one.rows, "p_values": [*map(_number, one.p_values)], "real": one.real}
                for one in self.differences
            ],
            "p_values_together": [*map(_number, self.together)],
            "chance": CHANCE,
            "notes": self.notes,
        }


def _cell(row: dict[str, Any] | None, real: bool) -> str:
    if row is None or row["value"] is None:
        return "-"
    if row["high95"] is None:
        return f"{row['value']:.4f} {row['status']}"
    return f"{row['value']:.4f} +- {row['high95'] - row['value']:.4f}{' *' if real else ''}"


def p_text(value: float) -> str:
    """Return a p-value as tables show it; a dash where there is none."""
    return "-" if np.isnan(value) else f"{value:.2g}" if value >= 1e-4 else "<0.0001"


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
