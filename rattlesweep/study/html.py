"""Pages that need nothing but themselves: no script, no font, no picture from elsewhere."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

# Larger vector pictures are shown as PNG, or a page of seven would pass 5 MB.
MOST_SVG = 400_000

STYLE = """
:root { color-scheme: light dark; --ink: #1b1b1b; --soft: #5a5a5a; --paper: #ffffff;
  --line: #d9d9d9; --band: #f5f5f3; --good: #00624a; --half: #8a5a00; --bad: #a33b00; }
@media (prefers-color-scheme: dark) { :root { --ink: #e8e6e1; --soft: #a9a6a0; --paper: #17181a;
  --line: #3a3b3e; --band: #202225; --good: #4fc9a4; --half: #e9b04a; --bad: #ff9466; } }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 2.5rem 1.25rem 4rem; max-width: 62rem; color: var(--ink);
  background: var(--paper); font: 16px/1.55 Charter, "Bitstream Charter", Georgia, serif; }
h1, h2, h3, th, nav, .mark, .small { font-family: system-ui, -apple-system, "Segoe UI", Roboto,
  "Helvetica Neue", sans-serif; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .4rem; overflow-wrap: anywhere; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .8rem; padding-top: .9rem;
  border-top: 1px solid var(--line); }
p { margin: .6rem 0; max-width: 46rem; }
nav { margin: 1rem 0; font-size: .92rem; display: flex; flex-wrap: wrap; gap: .2rem 1rem; }
a { color: inherit; }
.soft { color: var(--soft); }
.small { font-size: .84rem; }
figure { margin: 1.2rem 0 2rem; }
figure img { display: block; max-width: 100%; height: auto; background: #fff; padding: .6rem;
  border: 1px solid var(--line); border-radius: 4px; }
figcaption { margin-top: .5rem; font-size: .94rem; color: var(--soft); max-width: 46rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; line-height: 1.42; }
th { text-align: left; font-size: .8rem; font-weight: 600; color: var(--soft);
  vertical-align: bottom; }
th, td { padding: .45rem .7rem .45rem 0; border-bottom: 1px solid var(--line); }
td { vertical-align: top; overflow-wrap: break-word; }
.number { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
td.key { white-space: nowrap; font-weight: 600; padding-right: 1.2rem; }
td p { margin: .35rem 0 0; max-width: none; }
sub, sup { font-size: .72em; line-height: 0; }
.mark { white-space: nowrap; font-size: .84rem; font-weight: 600; }
.agree { color: var(--good); } .partly { color: var(--half); } .disagree { color: var(--bad); }
pre { background: var(--band); padding: .9rem 1rem; overflow-x: auto; font-size: .8rem;
  line-height: 1.45; border-radius: 4px; }
@media (max-width: 40rem) { .stack thead { display: none; }
  .stack tr { display: block; padding: .7rem 0; border-bottom: 1px solid var(--line); }
  .stack td { display: block; border: 0; padding: .12rem 0; } }
@media print { @page { margin: 16mm; }
  :root { --ink: #000; --soft: #444; --paper: #fff; --line: #bbb; --band: #f4f4f4;
    --good: #00624a; --half: #8a5a00; --bad: #a33b00; }
  body { max-width: none; padding: 0; font-size: 10.5pt; } nav { display: none; }
  figure, tr { break-inside: avoid; } h2 { break-after: avoid; } pre { white-space: pre-wrap; } }
"""

NUMBER = '<td class="number">'
# A sign beside the word: colour alone says nothing to some.
MARKS = {"agree": "✓", "partly": "◐", "disagree": "✗"}


@dataclass(frozen=True)
class Html:
    """Markup; whatever is not one of these is text, and is escaped."""

    text: str


def markup(value: object) -> str:
    """Markup of a value: as it is if it is :class:`Html`, else escaped text."""
    return value.text if isinstance(value, Html) else escape(str(value))


def join(parts: Iterable[Html]) -> Html:
    """Markup after markup."""
    return Html("\n".join(part.text for part in parts))


def paragraph(*parts: object, kind: str = "") -> Html:
    """A paragraph of text and markup, with a class if ``kind`` is one."""
    attribute = f' class="{escape(kind)}"' if kind else ""
    return Html(f"<p{attribute}>{''.join(markup(part) for part in parts)}</p>")


def section(name: str, title: str, *parts: Html) -> Html:
    """A part of the page with a heading that links can name."""
    return Html(
        f'<section id="{escape(name)}"><h2>{escape(title)}</h2>\n{join(parts).text}</section>'
    )


def mark(verdict: str) -> Html:
    """A verdict with its sign and colour."""
    word = escape(verdict)
    return Html(f'<span class="mark {word}">{MARKS.get(verdict, "")} {word}</span>')


def table(head: Sequence[str], rows: Iterable[Sequence[object]], *, stack: bool = False) -> Html:
    """A table; numbers stand to the right.

    Parameters
    ----------
    head
        Headings of the columns.
    rows
        Cells: text, numbers as text made by the caller, or :class:`Html`.
    stack
        Whether cells stand below each other on a narrow screen.
    """
    cells = [[_cell(cell) for cell in row] for row in rows]
    right = [cell.startswith(NUMBER) for cell in cells[0]] if cells else []
    top = "".join(
        f'<th scope="col"{" class=number" if place < len(right) and right[place] else ""}>'
        f"{escape(name)}</th>"
        for place, name in enumerate(head)
    )
    body = "\n".join(f"<tr>{''.join(row)}</tr>" for row in cells)
    kind = ' class="stack"' if stack else ""
    return Html(
        f'<div class="wide"><table{kind}><thead><tr>{top}</tr></thead>\n<tbody>{body}</tbody>'
        "</table></div>"
    )


def key(text: str) -> Html:
    """A cell that names its row."""
    return Html(f'<td class="key">{escape(text)}</td>')


def number(text: str) -> Html:
    """A cell that holds a number."""
    return Html(f"{NUMBER}{escape(text)}</td>")


def _cell(value: object) -> str:
    text = markup(value)
    whole = isinstance(value, Html) and text.startswith("<td")
    return text if whole else f"<td>{text}</td>"


def picture(svg: bytes, png: bytes, alt: str, caption: object) -> Html:
    """A figure with its caption; the picture is part of the page.

    An image, and not markup of the page: its names cannot meet those of other pictures, and
    nothing in it is run.
    """
    small = len(svg) <= MOST_SVG
    kind, data = ("svg+xml", svg) if small else ("png", png)
    code = base64.b64encode(data).decode("ascii")
    return Html(
        f'<figure><img src="data:image/{kind};base64,{code}" alt="{escape(alt)}">'
        f"<figcaption>{markup(caption)}</figcaption></figure>"
    )


def code(text: str) -> Html:
    """Text as it was typed."""
    return Html(f"<pre>{escape(text)}</pre>")


def page(title: str, head: Iterable[Html], sections: Sequence[tuple[str, str, Html]]) -> bytes:
    """A whole page.

    Parameters
    ----------
    title
        Of the page and its first heading.
    head
        What stands below it.
    sections
        Name, title and contents of each section; they are listed at the top.
    """
    links = "".join(f'<a href="#{escape(n)}">{escape(t)}</a>' for n, t, _ in sections)
    parts = join(section(n, t, contents) for n, t, contents in sections)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        # Whatever may have slipped into the text: the page loads nothing and runs nothing.
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
        "img-src data:; style-src 'unsafe-inline'\">\n"
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style></head>\n"
        f"<body><h1>{escape(title)}</h1>\n{join(head).text}\n<nav>{links}</nav>\n{parts.text}\n"
        "</body></html>\n"
    ).encode()
