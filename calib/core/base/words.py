"""Text for people: numbers and lists in sentences, tables as plain text, for notebooks (HTML) and for pandas."""

from __future__ import annotations

import functools
import html
import io
import json
import logging
import math
import os
import textwrap
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from rich.console import Console
from rich.table import Table

from calib.core.base.errors import require_package

_LISTED = 5


@functools.lru_cache(maxsize=256)
def warn_once(text: str) -> None:
    """Warn through the logger `calib`, once for each text."""
    logging.getLogger("calib").warning("%s", text)


def count_noun(number: int, singular: str, plural: str | None = None) -> str:
    """Return a number with its noun; the plural is the singular with an s if it is not given.

    >>> count_noun(1, "pose"), count_noun(3, "pose"), count_noun(2, "minimum", "minima")
    ('1 pose', '3 poses', '2 minima')
    """
    return f"{number} {singular if number == 1 else plural or singular + 's'}"


def listing(names: Sequence[str], separator: str = ", ", shown: int = _LISTED) -> str:
    """Return the first few of many, and how many more there are.

    >>> listing(list("abcdefg")), listing(["a", "b"], "; ")
    ('a, b, c, d, e, and 2 more', 'a; b')
    """
    return separator.join(names[:shown]) + (f"{separator}and {len(names) - shown} more" if len(names) > shown else "")


def joints_named(*names: str, separator: str = ", ", shown: int = _LISTED) -> str:
    """Return the first few joints by their names, after the word `joint` unless their names begin with it.

    >>> joints_named("elbow"), joints_named("elbow", "wrist"), joints_named("joint_2")
    ('joint elbow', 'joints elbow, wrist', 'joint_2')
    """
    text = listing(names, separator, shown)
    if all(name.casefold().startswith("joint") for name in names):
        return text
    return f"{'joint' if len(names) == 1 else 'joints'} {text}"


def distinct_names(paths: Sequence[Path | str]) -> tuple[str, ...]:
    """Return the parts that differ in paths, without the folders with which all of them begin or end.

    >>> distinct_names(["/data/left/out", "/data/right/out"])
    ('left', 'right')
    """
    parts = [Path(os.path.realpath(path)).parts for path in paths]
    most = min(map(len, parts), default=1) - 1  # so that something is left of each path
    first = next((k for k in range(most) if len({path[k] for path in parts}) > 1), most)
    last = next((k for k in range(most - first) if len({path[-1 - k] for path in parts}) > 1), most - first)
    return tuple("/".join(path[first : len(path) - last]) for path in parts)


def significant(value: float, digits: int = 3) -> str:
    """Return a number with so many significant digits, and without an exponent below a million: 3060, not 3.06e+03."""
    return f"{float(f'{value:.{digits}g}'):g}"


def sentence(clause: str) -> str:
    """Return a clause with a capital and a full stop."""
    return f"{clause[0].upper()}{clause[1:]}."


def plain_text(parts: Iterable[str | Table], width: int, *, wrap: bool = False) -> str:
    """Return lines and tables as plain text, of this width in characters; `wrap` breaks lines of text there, too.

    Brackets and colons are printed as they are: `[mm]` is not markup, and `:name:` is not an emoji.
    """
    stream = io.StringIO()
    console = Console(file=stream, width=width, color_system=None, markup=False, emoji=False, highlight=False)
    for part in parts:
        broken = wrap and isinstance(part, str)
        console.print(_wrap_lines(str(part), width) if broken else part, soft_wrap=isinstance(part, str))
    return stream.getvalue()


def _wrap_lines(text: str, width: int) -> str:
    """Lines broken at a width; continuations are indented by two more blanks."""
    lines = []
    for line in text.split("\n"):
        further = " " * (len(line) - len(line.lstrip()) + 2)
        lines.append(textwrap.fill(line, width, subsequent_indent=further, break_long_words=False,
                                   break_on_hyphens=False))  # fmt: skip
    return "\n".join(lines)


def text_table(
    headers: Sequence[str], left: Collection[str] = ("",), title: str | None = None, *, plain: bool = False
) -> Table:
    """Return an empty table for `plain_text`, without lines if `plain`; columns of `left` headers are aligned left."""
    style: dict[str, Any] = {"box": None, "pad_edge": False} if plain else {}
    table = Table(title=title, title_justify="left", **style)
    for header in headers:
        justify: Literal["left", "right"] = "left" if header in left else "right"
        table.add_column(header, justify=justify)
    return table


def as_data(value: Any) -> Any:
    """Return data for JSON: NumPy's numbers become Python's; NaN and infinity become null."""
    if isinstance(value, dict):
        return {str(key): as_data(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_data(entry) for entry in value]
    number = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(number, float) and not math.isfinite(number) else number


def json_file(content: object) -> bytes:
    """Return data as the content of a JSON file; null for unknown numbers."""
    return (json.dumps(as_data(content), indent=1, allow_nan=False, ensure_ascii=False) + "\n").encode()


def table_html(rows: Sequence[dict[str, object]]) -> str:
    """Return rows as an HTML table; nothing in them is markup."""
    if not rows:
        return "<table></table>"
    head = "".join(f"<th>{html.escape(key)}</th>" for key in rows[0])
    body = "".join("<tr>" + "".join(f"<td>{_cell(cell)}</td>" for cell in row.values()) + "</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def html_with_title(title: str, lines: Sequence[str], *tables: Sequence[dict[str, object]]) -> str:
    """Return a heading, lines and tables as HTML; nothing in them is markup."""
    paragraphs = "".join(f"<p>{html.escape(line)}</p>" for line in lines)
    return f"<h3>{html.escape(title)}</h3>{paragraphs}{''.join(table_html(rows) for rows in tables)}"


def data_frame(rows: Sequence[dict[str, object]]) -> Any:
    """Return rows with the same keys, named by their `name`, as a pandas table; pandas missing is an `InputError`."""
    return pandas().DataFrame(list(rows)).set_index("name")


def pandas() -> Any:
    """Return pandas; its absence is an `InputError`."""
    return require_package("pandas", "pandas is not installed; `pip install pandas` first")


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.5g}" if math.isfinite(value) else "-"
    return html.escape(str(value))
