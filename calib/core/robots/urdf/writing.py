"""Parts of new URDFs, as text."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence


def quote_attribute(text: str) -> str:
    """Return a text as a quoted attribute value; `xml.sax.saxutils` would import a web client."""
    escaped = html.escape(text)
    for letter in "\n\r\t":
        escaped = escaped.replace(letter, f"&#{ord(letter)};")
    return f'"{escaped}"'


def robot_text(name: str, note: str, links: Sequence[str], joints: Sequence[str]) -> str:
    """Return a new URDF from names of links and texts of joints (`joint_text`); `note` is a comment at its head."""
    body = "".join([*(f"  <link name={quote_attribute(link)}/>\n" for link in links), *joints])
    return f'<?xml version="1.0"?>\n<!-- {note} -->\n<robot name={quote_attribute(name)}>\n{body}</robot>\n'


def joint_text(
    name: str,
    kind: str,
    links: tuple[str, str],
    xyz: Iterable[float],
    rpy: Iterable[float],
    axis: str,
    limits: tuple[float, float] | None,
) -> str:
    """Return the element of a joint of a new URDF; `links` are its parent and child.

    `axis` has three numbers, or none if the joint is fixed; `limits` are lowest and highest value [m or rad], or None.
    """
    parent, child = map(quote_attribute, links)
    lines = [
        f"<parent link={parent}/> <child link={child}/>",
        f'<origin xyz="{number_attribute(xyz)}" rpy="{number_attribute(rpy)}"/>',
    ]
    if axis:
        lines.append(f'<axis xyz="{axis}"/>')
    if axis and limits:
        lines.append(f'<limit lower="{limits[0]!r}" upper="{limits[1]!r}" effort="0" velocity="0"/>')
    inside = "".join(f"    {line}\n" for line in lines)
    return f'  <joint name={quote_attribute(name)} type="{kind}">\n{inside}  </joint>\n'


def number_attribute(values: Iterable[float]) -> str:
    """Return numbers as an attribute of a URDF."""
    return " ".join(shortest(value) for value in values)


def shortest(value: float) -> str:
    """Return the shortest decimal that reads back to the same number."""
    return repr(float(value)) if value != 0 else "0"
