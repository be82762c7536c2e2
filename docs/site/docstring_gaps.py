"""List public functions whose docstring leaves out the shape of an array or an error that they raise themselves.

    python docs/site/docstring_gaps.py

That docstrings exist, and their form, is checked by ruff. A function passes if its docstring shows some shape such as
`(n, 3)`, names every error class of its own `raise` statements, or says `see` another one. Commands are left out: what
their docstrings say is their help. So are errors that a context manager `_explain_errors` turns into others, and
methods that an abstract base class of the project promises: its docstring says what they take and return.
"""

from __future__ import annotations

import argparse
import ast
import re
from collections.abc import Iterator, Mapping

import api_reference

_ARRAY = re.compile(r"\b(FloatArray|BoolArray|IntArray|ArrayLike|Array)\b")
_SHAPE = re.compile(r"\((?:\w+(?: [-+*] \w+)*|\.\.\.),|\(\d")


def promises(text: str, known: Mapping[str, set[str]] | None = None) -> dict[str, set[str]]:
    """Return the methods of each abstract base class of a module, those of its abstract bases included.

    Args:
        text: The module.
        known: Those of other modules.
    """
    by_name: dict[str, set[str]] = {}
    for node in ast.parse(text).body:
        if not isinstance(node, ast.ClassDef):
            continue
        bases = [ast.unparse(base) for base in node.bases]
        methods = [method for method in node.body if isinstance(method, ast.FunctionDef)]
        if "ABC" in bases or any("abstractmethod" in map(ast.unparse, item.decorator_list) for item in methods):
            by_name[node.name] = {item.name for item in methods}.union(
                *(by_name.get(base, (known or {}).get(base, set())) for base in bases)
            )
    return by_name


def gaps(text: str, promised: Mapping[str, set[str]]) -> Iterator[tuple[int, str, str]]:
    """Return line, name and what is missing, for each function of a module that leaves something out.

    Args:
        text: The module.
        promised: Of `promises`, of all modules.
    """
    for node, name in _public(ast.parse(text), "", promised):
        docstring = ast.get_docstring(node) or ""
        if "see `" in docstring.lower():
            continue
        missing = []
        annotations = [argument.annotation for argument in (*node.args.args, *node.args.kwonlyargs)] + [node.returns]
        if any(a is not None and _ARRAY.search(ast.unparse(a)) for a in annotations) and not _SHAPE.search(docstring):
            missing.append("no shape")
        missing += [f"raises {error}" for error in sorted(_raised(node)) if error not in docstring]
        if missing:
            yield node.lineno, name, ", ".join(missing)


def _public(
    body: ast.Module | ast.ClassDef, prefix: str, promised: Mapping[str, set[str]]
) -> Iterator[tuple[ast.FunctionDef, str]]:
    bases = [ast.unparse(base) for base in body.bases] if isinstance(body, ast.ClassDef) else []
    inherited = {name for base in bases for name in promised.get(base, ())}
    for node in body.body:
        if isinstance(node, ast.FunctionDef) and node.name in inherited:
            continue
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield from _public(node, f"{prefix}{node.name}.", promised)
        elif isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and not _is_command(node):
            yield node, prefix + node.name


def _is_command(function: ast.FunctionDef) -> bool:
    return any(".command(" in ast.unparse(decorator) for decorator in function.decorator_list)


def _raised(function: ast.FunctionDef) -> set[str]:
    """Names of the error classes that its own `raise` statements make."""
    raised: set[str] = set()
    todo: list[ast.AST] = [function]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.With) and any("_explain_errors(" in ast.unparse(item) for item in node.items):
            continue
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            raised |= {
                name for name in (ast.unparse(node.exc.func),) if name[0].isupper()
            }  # no function that makes one
        todo += ast.iter_child_nodes(node)
    return raised


def all_gaps() -> list[str]:
    """Return a line for each function of the project whose docstring leaves something out."""
    texts = {
        module: api_reference.source(module)
        for package in api_reference.PACKAGES
        for module in api_reference.modules(package)
    }
    promised: dict[str, set[str]] = {}
    for text in 2 * [*texts.values()]:  # a class may stand before its base
        promised |= promises(text, promised)
    return [
        f"{module}, line {line}: {name}: {missing}"
        for module, text in texts.items()
        for line, name, missing in gaps(text, promised)
    ]


def main() -> None:
    """Run the command line."""
    argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0]).parse_args()
    for line in all_gaps():
        print(line)


if __name__ == "__main__":
    main()
