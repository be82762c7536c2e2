"""Docstrings here may describe several arguments at once (`low, high: Limits [m].`); griffe wants each on its own."""

from __future__ import annotations

import re
from typing import Any

import griffe

_GROUP = re.compile(r"^(?P<indent> +)(?P<names>\w+(?:, \w+)+): (?P<text>.+(?:\n(?P=indent) +\S.*)*)$", re.MULTILINE)


def split_groups(docstring: str) -> str:
    """Give each name of a group its own entry."""
    head, args, rest = docstring.partition("\nArgs:\n")
    if not args:
        head, args, rest = docstring.partition("\nAttributes:\n")
    return head + args + _GROUP.sub(_each, rest)


def _each(match: re.Match[str]) -> str:
    return "\n".join(f"{match['indent']}{name}: {match['text']}" for name in match["names"].split(", "))


class GroupedNames(griffe.Extension):
    """Split groups before docstrings are parsed."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite one docstring."""
        if obj.docstring is not None:
            obj.docstring.value = split_groups(obj.docstring.value)
