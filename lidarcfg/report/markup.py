"""The building blocks of a page: one HTML file that fetches nothing, for the screen and for print.

Every text is escaped here, unless it is Html already.
"""

import html
from collections.abc import Sequence
from dataclasses import dataclass


class Html(str):
    """A text that is HTML already."""

    __slots__ = ()


STYLE = """
:root { color-scheme: light; --line: #d5d9de; --soft: #f4f6f8; --ink: #1b1f24; --grey: #57606a; --blue: #0b5a94; }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0 auto; padding: 2rem 1.5rem 4rem; max-width: 60rem; color: var(--ink); background: #fff;
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "DejaVu Sans", sans-serif; }
h1 { margin: 0; font-size: 1.75rem; line-height: 1.25; overflow-wrap: anywhere; }
h2 { margin: 2.75rem 0 .6rem; padding-bottom: .25rem; border-bottom: 2px solid var(--ink); font-size: 1.3rem; }
h3 { margin: 1.5rem 0 .4rem; font-size: 1.05rem; }
p { margin: .5rem 0; max-width: 46rem; }
a { color: var(--blue); }
.about { margin: .3rem 0 1.2rem; color: var(--grey); }
nav { margin: 1.2rem 0; }
nav ol { margin: 0; padding: 0; list-style: none; display: flex; flex-wrap: wrap; gap: .1rem 1.1rem; }
.summary { border: 1px solid var(--line); border-left: 6px solid var(--blue); border-radius: 4px;
  padding: .9rem 1.2rem 1rem; background: var(--soft); }
.summary h2 { margin: 0 0 .6rem; border: 0; padding: 0; font-size: 1.05rem; }
.summary dl { display: grid; grid-template-columns: repeat(auto-fit, minmax(12.5rem, 1fr)); gap: .9rem 1.5rem;
  margin: 0; }
.summary dt { color: var(--grey); font-size: .87rem; overflow-wrap: anywhere; }
.summary dd { margin: 0; }
.summary dd b { display: block; font-size: 1.35rem; line-height: 1.3; font-variant-numeric: tabular-nums; }
.summary dd span { color: var(--grey); font-size: .87rem; }
.wide { overflow-x: auto; margin: .8rem 0 1.2rem; }
table { border-collapse: collapse; font-size: .87rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; color: var(--grey); padding-bottom: .3rem; }
th, td { padding: .25rem .75rem .25rem 0; border-bottom: 1px solid var(--line); text-align: left;
  vertical-align: top; overflow-wrap: anywhere; }
thead th { border-bottom: 1.5px solid var(--ink); vertical-align: bottom; }
th.number, td.number { text-align: right; overflow-wrap: normal; white-space: nowrap; }
tbody th { font-weight: 600; min-width: 8rem; max-width: 18rem; }
tbody th.short { min-width: 0; white-space: nowrap; }
td.best { font-weight: 700; background: #e3f1ea; }
figure { margin: 1rem 0 1.5rem; }
figure svg { display: block; width: 100%; height: auto; }
figcaption { color: var(--grey); font-size: .87rem; max-width: 46rem; margin-top: .3rem; }
pre { margin: .5rem 0; padding: .7rem .9rem; background: var(--soft); border: 1px solid var(--line);
  border-radius: 4px; font: 12.5px/1.45 ui-monospace, "DejaVu Sans Mono", Menlo, Consolas, monospace;
  white-space: pre-wrap; overflow-wrap: anywhere; }
summary { cursor: pointer; }
@media print {
  @page { margin: 14mm 15mm; }
  body { max-width: none; padding: 0; font-size: 10pt; }
  a { color: inherit; text-decoration: none; }
  h1 { font-size: 18pt; }
  h2 { break-after: avoid; margin-top: 1.4rem; font-size: 13pt; }
  table, figcaption { font-size: 8pt; }
  th, td { padding-right: .5rem; }
  tbody th { min-width: 5.5rem; }
  figure svg { max-height: 21cm; }
  h3, caption, summary { break-after: avoid; }
  figure, tr, .wide, .summary { break-inside: avoid; }
  thead { display: table-header-group; break-after: avoid; }
  tbody tr:first-child { break-before: avoid; }
  .summary dd b { font-size: 12pt; }
  .wide { overflow: visible; }
  .summary, pre, td.best { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  pre { font-size: 7pt; }
  details pre { columns: 2; }
  details::details-content { content-visibility: visible; block-size: auto; }
}
"""


@dataclass(frozen=True)
class Section:
    """A part of the page with a heading, in the contents."""

    key: str  # of its address in the page
    title: str
    body: Html


@dataclass(frozen=True)
class Cell:
    """A table's cell that is marked as the best of its row."""

    text: str


def shown(text: object) -> str:
    """A text with what cannot be printed written out, but for line ends and what joins letters."""
    return "".join(c if c.isprintable() or c in "\n\u200c\u200d" else repr(c)[1:-1] for c in str(text))


def escaped(text: object) -> Html:
    """A text as HTML."""
    return text if isinstance(text, Html) else Html(html.escape(shown(text)))


def joined(*parts: Html) -> Html:
    """HTML, one part a line."""
    return Html("\n".join(parts))


def paragraph(*texts: object) -> Html:
    """A paragraph of some sentences."""
    return Html(f"<p>{' '.join(escaped(text) for text in texts)}</p>")


def heading(text: object) -> Html:
    """A heading within a section."""
    return Html(f"<h3>{escaped(text)}</h3>")


def code(text: str) -> Html:
    """A text as it stands in a file or on a command line."""
    return Html(f"<pre><code>{escaped(text)}</code></pre>")


def folded(title: str, body: Html) -> Html:
    """What shows when it is asked for, and in print."""
    return Html(f"<details><summary>{escaped(title)}</summary>\n{body}\n</details>")


def figure(svg: Html, caption: object) -> Html:
    """A drawing with its caption."""
    return Html(f"<figure>{svg}<figcaption>{escaped(caption)}</figcaption></figure>")


def table(caption: str, head: Sequence[object], rows: Sequence[Sequence[object]], texts: Sequence[int] = ()) -> Html:
    """A table whose first column names the row; columns hold numbers, but for the first and those of `texts`."""

    def kind(column: int) -> str:
        return "" if column == 0 or column in texts else ' class="number"'

    def cell(column: int, value: object) -> str:
        if isinstance(value, Cell):
            return f'<td class="number best">{escaped(value.text)}</td>'
        return f"<td{kind(column)}>{escaped(value)}</td>"

    short = ' class="short"' if not head[0] else ""
    heads = "".join(f'<th scope="col"{kind(i)}>{escaped(value)}</th>' for i, value in enumerate(head))
    body = "\n".join(
        f'<tr><th scope="row"{short}>{escaped(row[0])}</th>'
        + "".join(cell(i, value) for i, value in enumerate(row[1:], 1))
        + "</tr>"
        for row in rows
    )
    return Html(
        f'<div class="wide"><table><caption>{escaped(caption)}</caption>\n'
        f"<thead><tr>{heads}</tr></thead>\n<tbody>\n{body}\n</tbody></table></div>"
    )


def facts(rows: Sequence[tuple[object, object]]) -> Html:
    """Names and what they are."""
    body = "\n".join(f'<tr><th scope="row">{escaped(what)}</th><td>{escaped(value)}</td></tr>' for what, value in rows)
    return Html(f'<div class="wide"><table><tbody>\n{body}\n</tbody></table></div>')


def summary(items: Sequence[tuple[object, object, object]], *below: Html) -> Html:
    """The box that comes first: what, how much, and a word on it."""
    terms = "\n".join(
        f"<div><dt>{escaped(what)}</dt><dd><b>{escaped(value)}</b><span>{escaped(word)}</span></dd></div>"
        for what, value, word in items
    )
    body = joined(Html(f"<dl>\n{terms}\n</dl>"), *below)
    return Html(f'<section class="summary" aria-labelledby="summary"><h2 id="summary">In short</h2>\n{body}</section>')


def page(title: str, about: str, first: Html, sections: Sequence[Section]) -> str:
    """The whole file. It may load nothing: its policy says so, too."""
    links = "".join(f'<li><a href="#{part.key}">{escaped(part.title)}</a></li>' for part in sections)
    bodies = "\n".join(
        f'<section aria-labelledby="{part.key}">\n<h2 id="{part.key}">{escaped(part.title)}</h2>\n'
        f"{part.body}\n</section>"
        for part in sections
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; img-src data:">
<title>{escaped(title)}</title>
<style>{STYLE}</style>
</head>
<body>
<header>
<h1>{escaped(title)}</h1>
<p class="about">{escaped(about)}</p>
</header>
{first}
<nav aria-label="Contents"><ol>{links}</ol></nav>
<main>
{bodies}
</main>
</body>
</html>
"""
