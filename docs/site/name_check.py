"""Say where names and docstrings of the code break the rules of docs/glossary.md; `make lint` runs it.

    python docs/site/name_check.py

Each finding can be met by better words alone. Names that read files, columns and entries of other programs are theirs.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("calib", "viz", "medrue")
WORDS = re.compile(r"(?:^|_)(told|said|asked|foretold|felt|unsaid|untold|likewise|whence)(?:_|$)")
"""In no name of a function, a class, an attribute, a parameter or a variable."""
ALONE = re.compile(
    r"(of|at|by|along|across|beside|aside|beyond|about|above|against|around|between|off|in|on|out|over|through|within"
    r"|inside|until|otherwise|elsewhere|alone|apart|ways?|bent|stood|looked_at|wanted|judged|believed|freed|held_fast"
    r"|settled|stepped|stretched|improved|begun|learned|laid|slid|spelt|sent|taken|lost|shifted|turned|moved|grown"
    r"|narrowed|exchanged|extended|unfolded|folded|polished|widened|weighed|condensed)"
)
"""No name of a function by themselves: a function is a verb, or the thing that it returns."""
FIRST = re.compile(r"(of|at|by|along|across|beside|beyond)_")
"""No function begins with these: the thing comes first."""
OPENINGS = re.compile(r"(What|That|Those|Whether it|As there|As of|Likewise)\b")
REFERRING = re.compile(r"(?:: |\n)\s*(As there|As of|Likewise)\b")
TYPED = {"by_pose": "`fit.plot.by_pose()` is what users type"}
"""Names of functions that stay although they begin with a preposition, each with its reason."""
TWICE: dict[str, str] = {}
"""Class names that stand in several modules, each with its reason."""


def _words(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()


def _variables(node: ast.AST) -> Iterator[tuple[int, str]]:
    for part in ast.walk(node):
        if isinstance(part, ast.arg):
            yield part.lineno, part.arg
        elif isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store):
            yield part.lineno, part.id
        elif isinstance(part, ast.Attribute) and isinstance(part.ctx, ast.Store):
            yield part.lineno, part.attr


def findings(text: str) -> Iterator[tuple[int, str]]:
    """Yield line and finding of each name and docstring of a module that breaks a rule."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if not isinstance(node, ast.FunctionDef | ast.ClassDef):
            continue
        plain = node.name.strip("_")
        if isinstance(node, ast.FunctionDef) and not node.name.startswith("__"):
            if ALONE.fullmatch(plain):
                yield node.lineno, f"'{node.name}' is no verb and no thing"
            elif FIRST.match(plain) and plain not in TYPED:
                yield node.lineno, f"'{node.name}' begins with a preposition"
        if WORDS.search(_words(node.name)):
            yield node.lineno, f"'{node.name}' has a forbidden word"
        docstring = ast.get_docstring(node) or ""
        if opening := OPENINGS.match(docstring):
            yield node.lineno, f"the docstring of '{node.name}' begins with '{opening[1]}'"
        if referring := REFERRING.search(docstring):
            yield node.lineno, f"the docstring of '{node.name}' says '{referring[1]}'"
    for line, name in _variables(tree):
        if WORDS.search(_words(name)):
            yield line, f"'{name}' has a forbidden word"


def twice(texts: Iterable[tuple[str, str]]) -> list[str]:
    """Return class names that stand in several modules (name, text) and have no reason, and reasons of none."""
    places = defaultdict(list)
    for module, text in texts:
        for node in ast.parse(text).body:
            if isinstance(node, ast.ClassDef):
                places[node.name].append(module)
    several = {name: modules for name, modules in places.items() if len(modules) > 1}
    found = [f"class '{name}' in {', '.join(several[name])}" for name in sorted(several.keys() - TWICE.keys())]
    return found + [f"'{name}' needs no reason any more" for name in sorted(TWICE.keys() - several.keys())]


def all_findings() -> list[str]:
    """Return every finding in the three packages, with file and line."""
    texts = [
        (path.relative_to(ROOT).as_posix(), path.read_text(encoding="utf-8"))
        for package in PACKAGES
        for path in sorted((ROOT / package).rglob("*.py"))
    ]
    here = [f"{module}:{line}: {text}" for module, source in texts for line, text in sorted(set(findings(source)))]
    return here + twice(texts)


if __name__ == "__main__":
    found = all_findings()
    print("\n".join(found))
    sys.exit(bool(found))
