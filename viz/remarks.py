"""What measurement files say about themselves in their comments, such as that they are simulated.

The pages show it in the files' own words, beside what was measured: who reads a page must know what its data are.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from calib import Fit

_MOST_LINES, _LONGEST = 6, 240


@dataclass(frozen=True)
class Remarks:
    """The comments of one or several measurement files.

    Attributes:
        lines: The first of them, shortened where they are long.
        more: How many follow.
    """

    lines: tuple[str, ...]
    more: int

    @property
    def simulated(self) -> bool:
        """Whether a line that is shown speaks of simulation."""
        return any(re.search(r"\bsimulat", line, re.IGNORECASE) for line in self.lines)

    def to_dict(self) -> dict[str, object]:
        """Return the remarks as the viewer's page reads them."""
        return {"lines": list(self.lines), "more": self.more, "simulated": self.simulated}


def remarks(*comments: Iterable[str]) -> Remarks:
    """Return the comments of measurement files, each line once, those that speak of simulation first.

    Args:
        comments: Of each file, line by line.
    """
    lines = list(dict.fromkeys(text for lines in comments for line in lines if (text := " ".join(line.split()))))
    lines.sort(key=lambda line: re.search(r"\bsimulat", line, re.IGNORECASE) is None)
    shown = tuple(line if len(line) <= _LONGEST else line[: _LONGEST - 1].rstrip() + "…" for line in lines)
    return Remarks(shown[:_MOST_LINES], max(0, len(lines) - _MOST_LINES))


def fit_remarks(fit: Fit) -> Remarks:
    """Return the comments of the files that a fit was made from."""
    sets = [fit.identification, *([] if fit.validation is None else [fit.validation])]
    return remarks(*(errors.data.comments for errors in sets))


NO_REMARKS = Remarks((), 0)
