"""The page of a comparison of results, which `calib.fleets.comparing_results` makes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.core.base.arrays import FloatArray
from calib.core.base.words import as_data, count_noun, listing, plain_text, text_table
from calib.core.numerics.chances import HARDLY

_SHOWN = 20
_LIKELIEST = 5  # parameters to show where none differs
_WIDTH = 118


@dataclass(frozen=True)
class Difference:
    """One parameter in the results.

    Attributes:
        rows: Its row in the `result.json` of each result, in its unit; None if the result has no such parameter.
        p_values: Chance of so large a difference to the first result, for each of the others, corrected for the number
            of tests of all pairs; NaN where there is no test.
        is_place: Whether it says where base, target or instrument stand, and not what the robot is.
    """

    name: str
    rows: tuple[dict[str, Any] | None, ...]
    p_values: tuple[float, ...]
    is_place: bool = False

    @property
    def real(self) -> tuple[bool, ...]:
        """Whether each of the other results differs from the first."""
        return tuple(p < HARDLY for p in self.p_values)


@dataclass(frozen=True)
class Pair:
    """Two of the results.

    Attributes:
        names: Names of the two.
        real: Parameters of the robot that differ.
        moved: Places of base, targets or instruments that differ.
        together: p-value of all parameters of the robot together, without places, corrected for the number of pairs;
            NaN where there is no test.
        tested: Whether any parameter was tested.
    """

    names: tuple[str, str]
    real: tuple[str, ...]
    moved: tuple[str, ...]
    together: float
    tested: bool = True

    def sentence(self) -> str:
        """Return a sentence on the differences."""
        if not self.tested:
            return f"{' and '.join(self.names)}: not tested."
        if np.isnan(self.together):  # places alone were sought
            moved = f"put elsewhere: {listing(self.moved)}" if self.moved else "nothing was put elsewhere"
            return f"{' and '.join(self.names)}: {moved}."
        if self.real:
            outcome = f"{count_noun(len(self.real), 'parameter')} of the robot differ{'s' * (len(self.real) == 1)}"
            outcome += f", {listing(self.real)}"
        elif self.together < HARDLY:
            outcome = "the robot differs, but no single parameter is proven to"
        else:
            outcome = "no parameter of the robot differs"
        places = f"; put elsewhere: {listing(self.moved)}" if self.moved else ""
        return f"{' and '.join(self.names)}: {outcome} (all together p {p_text(self.together)}){places}."


@dataclass(frozen=True, eq=False)
class ComparedResult:
    """One of the results.

    Attributes:
        name: The part of its folder's name that the others do not have; `fit 1` for a fit.
        folder: Its folder, as the caller wrote it; None for a fit.
        verdict, n_poses: Its verdict and number of poses.
        rms, unit: Root mean square error after calibration, on unused readings where there are any.
        on: Readings of this error.
        sizes: Error of each reading after calibration, in that unit, on common readings that no result used, (n,);
            empty where there are none.
    """

    name: str
    folder: str | None
    verdict: str
    n_poses: int
    rms: float
    unit: str
    on: str
    sizes: FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class ResultComparison:
    """Results side by side, compared in pairs.

    Attributes:
        results: The results.
        differences: One for each parameter.
        pairs: Differences of the two results of each pair, pairs with the first result first.
        notes: Remarks for users.
    """

    results: tuple[ComparedResult, ...]
    differences: tuple[Difference, ...]
    pairs: tuple[Pair, ...]
    notes: tuple[str, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the results."""
        return tuple(result.name for result in self.results)

    @property
    def joint_p_values(self) -> tuple[float, ...]:
        """Joint p-value of all parameters of the robot, against the first result, for each of the others."""
        return tuple(pair.together for pair in self.pairs[: len(self.results) - 1])

    def __repr__(self) -> str:
        real = sum(any(difference.real) for difference in self.differences)
        return f"<comparison of {len(self.results)} results: {real} of {len(self.differences)} parameters differ>"

    def __str__(self) -> str:
        return self.report()

    def report(self) -> str:
        """Return the comparison as text: the differences in words, then a table of them, the surest first."""
        heads = [f"{r.name}: {r.verdict}, {r.n_poses} poses, {r.rms:.4g} {r.unit} RMS on {r.on}" for r in self.results]
        ranked = self.rank_differences()
        table = text_table(("parameter", "unit", *self.names, "p"), ("parameter", "unit"), plain=True)
        for column in table.columns:
            column.overflow = "fold"
        real = sum(any(difference.real) for difference in ranked)
        shown = ranked[: min(real, _SHOWN) or _LIKELIEST]
        for difference in shown:
            marks = (False, *difference.real)
            cells = [_cell(row, mark) for row, mark in zip(difference.rows, marks, strict=True)]
            unit = next(str(row["unit"]) for row in difference.rows if row is not None)
            table.add_row(difference.name, unit, *cells, ", ".join(p_text(p) for p in difference.p_values))
        more = len(self.differences) - len(shown)
        tested = self.tested_pairs()
        kinds = "with less certain differences, or without a test" if tested else "without a test"
        lines = [f"... and {count_noun(more, 'parameter')} {kinds}"] if more else []
        answer = [*tested, *self.notes]
        key = f"values ± 95 %; * differs from {self.names[0]}; p is corrected for the number of tests"
        return plain_text(["\n".join([*answer, "", *heads]) + "\n", table, *lines, key], _WIDTH, wrap=True)

    def rank_differences(self) -> list[Difference]:
        """Return the tested differences, the surest first; if none was tested, all differences, the largest first."""
        tested = [difference for difference in self.differences if np.any(np.isfinite(difference.p_values))]
        if not tested:
            return sorted(self.differences, key=lambda difference: -_distance_in_half_widths(difference))
        return sorted(tested, key=lambda difference: np.nanmin([*difference.p_values, 2.0]))

    def tested_pairs(self) -> list[str]:
        """Return a sentence on each two results that were tested; a note says why others were not."""
        return [pair.sentence() for pair in self.pairs if pair.tested]

    def conclusion(self) -> str:
        """Return a line on the differences of each two results, and a key of the marks; empty without a test."""
        key = (
            f"Marked *: differs from {self.names[0]}; values ± 95 %; p is corrected; a difference is real if p is below"
            f" {HARDLY:g}."
        )
        tested = self.tested_pairs()
        return "\n".join([*tested, key] if tested else [])

    def to_dict(self) -> dict[str, object]:
        """Return the comparison for `--json`, in the units of tables; null where there is no test."""
        results = [{key: value for key, value in vars(r).items() if key != "sizes"} for r in self.results]
        return as_data(
            {
                "results": results,
                "parameters": [
                    {"name": one.name, "results": one.rows, "p_values": one.p_values, "real": one.real}
                    for one in self.differences
                ],
                "p_values_together": self.joint_p_values,
                "pairs": [
                    {"results": pair.names, "real": pair.real, "moved": pair.moved, "p_together": pair.together}
                    for pair in self.pairs
                ],
                "chance": HARDLY,
                "notes": self.notes,
            }
        )


def _distance_in_half_widths(difference: Difference) -> float:
    """Return the largest distance to the first result in half widths of both intervals; 0 where one has none."""
    first, *others = difference.rows
    known = [row for row in others if row is not None and row["high95"] is not None]
    if first is None or first["high95"] is None or not known:
        return 0.0
    widths = [first["high95"] - first["value"] + row["high95"] - row["value"] for row in known]
    pairs = zip(known, widths, strict=True)
    return max(abs(row["value"] - first["value"]) / width if width > 0 else 0.0 for row, width in pairs)


def _cell(row: dict[str, Any] | None, real: bool) -> str:
    if row is None or row["value"] is None:
        return "-"
    if row["high95"] is None:
        return f"{row['value']:.4f} {row['status']}"
    return f"{row['value']:.4f} +- {row['high95'] - row['value']:.4f}{' *' if real else ''}"


def p_text(value: float) -> str:
    """Return a p-value as tables show it; a dash where there is none."""
    return "-" if np.isnan(value) else f"{value:.2g}" if value >= 1e-4 else "<0.0001"
