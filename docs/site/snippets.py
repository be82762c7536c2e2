"""Run the snippets of the pages, and compare or refresh the outputs that the pages show.

    python docs/site/snippets.py [PAGE ...]            check; exit code 1 if a page is out of date
    python docs/site/snippets.py --write [PAGE ...]    put the present outputs into the pages

A page is run from top to bottom, as a reader would, in a folder of its own that has `urdf/` and `docs/` of the
checkout in it. What a fenced block does depends on its language and title:

    sh                      its lines are typed at the top of the checkout; `calib` and `medrue` are the installed ones
    python                  runs in one interpreter for the page
    any, title="NAME.EXT"   a file that the reader writes; a Python one is run as well
    text, title="Output"    what the block before it prints; numbers may differ in their last digits, times at all,
                            and a line `...` stands for any lines

A comment on the line above a block changes that: `<!-- not run: why -->`, `<!-- exit code 2 -->`, or, for a file,
`<!-- part of docs/examples/NAME -->`: it is not written, but every line of it must be in that file, and Python
of it is run only if it has a title.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import os
import re
import shlex
import subprocess
import sys
import tempfile
import traceback
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
TESTED_ELSEWHERE = {"docs/other_tools.md": "tests/interop/test_other_tools_page.py"}
"""Pages whose snippets need programs of their own, and the tests that run them."""
_FENCE = re.compile(
    r"^(?:<!-- *(?P<comment>[^\n]*?) *-->\n)?^```(?P<language>\w*)(?P<rest>[^\n]*)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
_TITLE = re.compile(r'title="([^"]*)"')
_NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")
_DURATION = re.compile(r"\d+\.?\d*(?= s\b)")
_RELATIVE = 0.01
"""How far numbers may be apart: machines differ in the last digits, and iterations amplify that."""
_ROUNDING = 1e-10
"""Numbers below this are rounding noise, and as good as zero."""


class SnippetError(Exception):
    """A snippet failed, or printed something else than the page says."""


@dataclass(frozen=True)
class Block:
    """A fenced block.

    Attributes:
        language, title, comment, text: What is written there; "" where nothing is.
        line: Line of its fence in the page.
        span: Where `text` is in the page.
    """

    language: str
    title: str
    comment: str
    text: str
    line: int
    span: tuple[int, int]


def blocks(page: str) -> list[Block]:
    """Return the fenced blocks of a page."""
    result = []
    for match in _FENCE.finditer(page):
        title = _TITLE.search(match["rest"])
        line = page.count("\n", 0, match.start("language")) + 1
        comment = match["comment"] or ""
        result.append(
            Block(match["language"], title.group(1) if title else "", comment, match["text"], line, match.span("text"))
        )
    return result


def run_page(path: Path, *, write: bool = False) -> None:
    """Run a page's snippets.

    Args:
        path: The page.
        write: Put the outputs into the page instead of comparing them.

    Raises:
        SnippetError: The message names the page and the line.
    """
    page = path.read_text(encoding="utf-8")
    changes: list[tuple[tuple[int, int], str]] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in ("urdf", "docs"):
            (Path(folder) / name).symlink_to(ROOT / name)
        session, printed = _Session(Path(folder)), ""
        for block in blocks(page):
            where = f"{path.relative_to(ROOT)}, line {block.line}"
            try:
                if block.language == "text" and block.title == "Output":
                    expected = refreshed(block.text, printed) if write else block.text
                    changes.append((block.span, expected))
                    compare(expected, printed)
                else:
                    printed = session.run(block)
            except SnippetError as error:
                raise SnippetError(f"{where}: {error}") from None
        _forget_modules(folder)
    if write:
        for (start, end), text in reversed(changes):
            page = page[:start] + text + page[end:]
        path.write_text(page, encoding="utf-8")


def _forget_modules(folder: str) -> None:
    """Drop modules of a page's folder: another page, or a test, has its own of the same name."""
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", None) or "").startswith(folder):
            del sys.modules[name]


class _Session:
    """State from block to block of a page."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._names: dict[str, object] = {"__name__": "__snippet__"}

    def run(self, block: Block) -> str:
        """Do what a block asks for and return what it prints."""
        if block.comment.startswith("not run: "):
            return ""
        if block.comment.startswith("part of "):
            _require_part(block)
            if not block.title:
                return ""
        elif block.title and block.title != "Output":
            target = self._folder / block.title
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(block.text, encoding="utf-8")
        if block.language == "python":
            return self._python(block.text)
        return self._shell(block) if block.language == "sh" else ""

    def _python(self, text: str) -> str:
        printed = io.StringIO()
        here = mock.patch.object(sys, "path", [str(self._folder), *sys.path])
        with contextlib.chdir(self._folder), contextlib.redirect_stdout(printed), here:
            try:
                exec(compile(text, "snippet", "exec", dont_inherit=True), self._names)
            except Exception:  # a snippet may fail in any way; the traceback goes into the error
                raise SnippetError(f"fails:\n{traceback.format_exc()}") from None
        return printed.getvalue()

    def _shell(self, block: Block) -> str:
        expected = int(block.comment.removeprefix("exit code ")) if block.comment.startswith("exit code ") else 0
        printed = []
        for line in block.text.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if not words:
                continue
            code, text = self._program(words) if words[0] in ("calib", "medrue") else self._other(line)
            printed.append(text)
            if code != expected:
                raise SnippetError(f"`{' '.join(words)}` ended with exit code {code}, not {expected}:\n{text[-400:]}")
        return "".join(printed)

    def _program(self, words: list[str]) -> tuple[int, str]:
        """Run one of our programs in this process, which is quicker than a new one."""
        printed = io.StringIO()
        main = importlib.import_module(f"{words[0]}.cli").main
        with (
            contextlib.chdir(self._folder),
            contextlib.redirect_stdout(printed),
            contextlib.redirect_stderr(printed),
            mock.patch.object(sys, "argv", words),
        ):
            try:
                main()
            except SystemExit as end:
                return int(end.code or 0), printed.getvalue()
        return 0, printed.getvalue()

    def _other(self, line: str) -> tuple[int, str]:
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        done = subprocess.run(
            ["bash", "-c", line],
            cwd=self._folder,
            env=os.environ | {"PATH": path},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        return done.returncode, done.stdout


def _require_part(block: Block) -> None:
    source = ROOT / block.comment.removeprefix("part of ")
    lines = {line.rstrip() for line in source.read_text(encoding="utf-8").splitlines()}
    for line in block.text.splitlines():
        if line.strip() not in ("", "...") and line.rstrip() not in lines:
            raise SnippetError(f"{source.relative_to(ROOT)} has no line {line!r}")


def compare(expected: str, printed: str) -> None:
    """Raise unless what was printed is what the page says."""
    rest = [line.rstrip() for line in printed.strip("\n").splitlines()]
    skipping = False
    for line in expected.strip("\n").splitlines():
        if line.strip() == "...":
            skipping = True
            continue
        while skipping and rest and not same(line, rest[0]):
            rest.pop(0)
        if not rest or not same(line, rest[0]):
            raise SnippetError(f"prints {rest[0] if rest else 'nothing more'!r} where the page says {line!r}")
        rest.pop(0)
        skipping = False
    if rest and not skipping:
        raise SnippetError(f"prints {rest[0]!r}, which the page does not say")


def same(expected: str, printed: str) -> bool:
    """Whether two lines agree but for durations and the last digits of numbers."""
    expected, printed = (_DURATION.sub("0", line) for line in (expected, printed))
    if shape(expected) != shape(printed):
        return False
    pairs = zip(_NUMBER.findall(expected), _NUMBER.findall(printed), strict=True)
    return all(_same_number(a, b) for a, b in pairs)


def shape(line: str) -> str:
    """A line without its numbers, signs and spacing."""
    return " ".join(_NUMBER.sub("#", re.sub(r"(?<=[\s(])[-+](?=\d)", "", line)).replace("━", "").split())


def _same_number(a: str, b: str) -> bool:
    last = 10.0 ** -len(a.partition(".")[2].partition("e")[0])
    scale = 10.0 ** int(a.lower().partition("e")[2] or 0)
    x, y = float(a), float(b)
    if max(abs(x), abs(y)) < _ROUNDING:
        return True
    if "." not in a and "e" not in a.lower():
        return x == y  # counts
    return abs(x - y) <= max(_RELATIVE * abs(x), 2 * last * scale)


def refreshed(expected: str, printed: str) -> str:
    """The new text of an output block; its `...` stay where they are, if the lines between them are still there."""
    lines = [line.rstrip() for line in printed.strip("\n").splitlines()]
    if not re.search(r"^\s*\.\.\.$", expected, re.MULTILINE):
        return "".join(f"{line}\n" for line in lines)
    kept = []
    for line in expected.strip("\n").splitlines():
        if line.strip() == "...":
            kept.append(line)
            continue
        matching = [
            k for k, new in enumerate(lines) if shape(_DURATION.sub("0", new)) == shape(_DURATION.sub("0", line))
        ]
        if not matching:
            raise SnippetError(f"nothing like {line!r} is printed any more")
        kept.append(lines[matching[0]])
        lines = lines[matching[0] + 1 :]
    return "".join(f"{line}\n" for line in kept)


def all_pages() -> list[Path]:
    """Every page of the documentation, and the contributors' guide."""
    pages = [*sorted(DOCS.rglob("*.md")), ROOT / "CONTRIBUTING.md"]
    return [page for page in pages if str(page.relative_to(ROOT)) not in TESTED_ELSEWHERE]


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description="Run the snippets of the documentation.")
    parser.add_argument("--write", action="store_true", help="put the present outputs into the pages")
    parser.add_argument("pages", nargs="*", type=Path, help="pages; all if none are named")
    options = parser.parse_args()
    failed = False
    for page in options.pages or all_pages():
        try:
            run_page(page.resolve(), write=options.write)
            print(f"{page}: fine")
        except SnippetError as error:
            failed = True
            print(error, file=sys.stderr)
    sys.exit(failed)


if __name__ == "__main__":
    main()
