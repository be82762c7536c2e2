"""A document of tables with lines to sign, as a page (HTML) and as PDF (fpdf2, extra `certificate`)."""

from __future__ import annotations

import io
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import matplotlib

from calib.core.base.errors import require_package
from calib.core.base.version import DISTRIBUTION

_STYLE = """\
body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:62rem;padding:0 1rem;color:#1b1f24;background:#fff}
h1{font-size:1.6rem}h2{font-size:1.15rem;margin-top:2rem}table{border-collapse:collapse;width:100%}
th,td{border:1px solid #c8ced6;padding:.3rem .5rem;text-align:left;vertical-align:top;overflow-wrap:anywhere}
th{background:#eef1f5}thead th{white-space:nowrap}
.FAIL{color:#a40000;font-weight:700}.PASS{color:#0b6b2e}.NOTED{color:#6a5200}
.wide{overflow-x:auto}.line{border-bottom:1px solid #1b1f24;height:2.4rem}
@media(prefers-color-scheme:dark){body{color:#e4e7eb;background:#15181c}th{background:#22272e}th,td{border-color:#444c56}
.FAIL{color:#ff8a80}.PASS{color:#7fd99a}.NOTED{color:#e2c16b}.line{border-color:#e4e7eb}}
@media print{body{margin:0;max-width:none;font-size:11px}}
"""
_WIDE = 34  # a cell with more letters is broken into lines
_EDGE = 4  # width of a cell's edges and of bold type, in letters
_WHOLE = 30  # largest number of rows of a table that is kept on one page
_ROOM = 130  # letters in a line of a page


@dataclass(frozen=True)
class DocumentRows:
    """A table with its title: column names, and cells of text row by row."""

    title: str
    columns: tuple[str, ...]
    cells: tuple[tuple[str, ...], ...]

    def draw(self, pdf: Any) -> None:
        """Draw the table at the end of a PDF, with column widths that follow the widths of words and cells."""
        widths = [
            max(_EDGE + max(len(word) for word in name.split()), *(min(len(cell), _WIDE) for cell in cells))
            for name, *cells in zip(self.columns, *self.cells, strict=True)
        ]
        _head(pdf, self.title, 11)
        pdf.set_font("sans", "", 7)
        with pdf.table(text_align="LEFT", line_height=4, padding=0.8, col_widths=widths) as table:
            for row in (self.columns, *self.cells):
                longest = (max(int(_ROOM * width / sum(widths)) - 1, 4) for width in widths)
                table.row([_breakable(cell, most) for cell, most in zip(row, longest, strict=True)])


@dataclass(frozen=True)
class Document:
    """A document: the answer in one line, tables that support it, lines for signers, and a mark on each page."""

    title: str
    answer: str
    tables: tuple[DocumentRows, ...]
    signatures: tuple[str, ...]
    mark: str = ""

    def html(self) -> str:
        """Return the document as one HTML page that loads no other files."""
        parts = [f"<h1>{escape(self.title)}</h1><p><strong>{escape(self.answer)}</strong></p>"]
        for table in self.tables:
            head = "".join(f'<th scope="col">{escape(name)}</th>' for name in table.columns)
            body = "".join(f"<tr>{''.join(map(_cell, row))}</tr>" for row in table.cells)
            parts.append(
                f'<h2>{escape(table.title)}</h2><div class="wide" tabindex="0"><table><thead><tr>{head}</tr></thead>'
                f"<tbody>{body}</tbody></table></div>"
            )
        if self.signatures:
            lines = "".join(
                f'<tr><th scope="row">{escape(who)}</th><td class="line"></td></tr>' for who in self.signatures
            )
            parts.append(f"<h2>Signatures: name, date, signature</h2><table><tbody>{lines}</tbody></table>")
        return (
            f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{escape(self.title)}</title>'
            '<meta name="viewport" content="width=device-width,initial-scale=1">'
            f"<style>{_STYLE}</style></head><body><main>{''.join(parts)}</main></body></html>\n"
        )

    def pdf(self) -> bytes:
        """Return the document as PDF, A4.

        Raises:
            InputError: fpdf2 is not installed.
        """
        missing = f"a PDF needs fpdf2: pip install '{DISTRIBUTION}[certificate]', or print the HTML"
        fpdf, mark = require_package("fpdf", missing), self.mark

        class Page(fpdf.FPDF):  # type: ignore[name-defined,misc]
            def footer(self) -> None:
                self.set_y(-12)
                self.set_font("sans", "", 7)
                self.cell(0, 5, f"{mark}  page {self.page_no()} of {{nb}}", align="C")

        pdf = Page(format="A4")
        pdf.set_title(self.title)
        fonts = Path(matplotlib.get_data_path(), "fonts", "ttf")
        pdf.add_font("sans", "", fonts / "DejaVuSans.ttf")
        pdf.add_font("sans", "B", fonts / "DejaVuSans-Bold.ttf")
        pdf.set_auto_page_break(True, margin=15)
        pdf.add_page()
        _head(pdf, self.title, 15)
        _head(pdf, self.answer, 10)
        for rows in self.tables:
            with pdf.offset_rendering() as trial:
                rows.draw(trial)
            if trial.page_break_triggered and len(rows.cells) <= _WHOLE:
                pdf.add_page()
            rows.draw(pdf)
        if self.signatures:
            _head(pdf, "Signatures: name, date, signature", 11)
            pdf.set_font("sans", "", 9)
            for who in self.signatures:
                pdf.cell(40, 12, who)
                pdf.cell(0, 12, "", border="B", new_x="LMARGIN", new_y="NEXT")
        out = io.BytesIO()
        pdf.output(out)
        return out.getvalue()


def _head(pdf: Any, text: str, size: int) -> None:
    pdf.ln(2)
    pdf.set_font("sans", "B", size)
    pdf.multi_cell(0, size * 0.55, text, align="L", new_x="LMARGIN", new_y="NEXT")


def _cell(text: str) -> str:
    grade = f' class="{text}"' if text in ("PASS", "FAIL", "NOTED") else ""
    return f"<td{grade}>{escape(text)}</td>"


def _breakable(text: str, longest: int) -> str:
    """Break words that are too long for a cell, such as digests."""
    return " ".join(
        " ".join(word[k : k + longest] for k in range(0, len(word), longest)) or word for word in text.split(" ")
    )
