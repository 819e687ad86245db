"""Report of a run of the suite: table for the terminal, JSON, and a page without external files."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from datetime import date
from html import escape
from typing import Any

import mbfmu
from mbfmu.util.text_table import format_table, format_tolerance

from .problem import NUDGE, Problem, Source
from .suite import NOT_COVERED, summarize
from .verdict import ERROR_FACTOR, LOST_PART, UNCERTAINTY_FACTOR, Line

REPORT_HEADER = (
    "problem", "source", "quantity", "method", "tolerance", "output", "t, s", "reference", "mbfmu", "error", "allowed",
    "uncertainty", "CPU ms", "verdict",
)  # fmt: skip
TEXT_COLUMNS = 3  # at the beginning: they describe the problem
WORDS = ("method", "output", "verdict")  # further columns that are no numbers
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #1b1f24; background: #fff; max-width: 96rem; margin: 2rem auto;
       padding: 0 1.5rem; }
h1 { font-size: 1.7rem; margin-bottom: .2rem; } h2 { font-size: 1.2rem; margin-top: 2.2rem; }
p, li { max-width: 50rem; } .small { color: #57606a; font-size: .85rem; }
table { border-collapse: collapse; width: 100%; font-size: .85rem; font-variant-numeric: tabular-nums; }
th { text-align: left; border-bottom: 2px solid #57606a; padding: .3rem .6rem; vertical-align: bottom; }
td { border-bottom: 1px solid #d8dee4; padding: .3rem .6rem; vertical-align: top; }
th.number, td.number { text-align: right; white-space: nowrap; } tr.first td { border-top: 2px solid #afb8c1; }
.right { color: #116329; } .stopped, .warned { color: #7d4e00; } .WRONG { color: #a40e26; font-weight: 700; }
.none { color: #57606a; }
.totals span { display: inline-block; margin-right: 2rem; font-size: 1.05rem; }
dt { font-weight: 600; margin-top: .9rem; } dd { margin-left: 1.2rem; max-width: 50rem; }
a { color: #0550ae; }
"""


def rule_text() -> str:
    """Return the rule by which a verdict is found."""
    return (
        f"A motion is right if the error of every output is at most {ERROR_FACTOR:g} tol S(t) + {UNCERTAINTY_FACTOR:g} "
        "u at all times t that are compared. tol is the tolerance that the solver used, and u the uncertainty, the "
        "largest error of the reference. S(t) is the sensitivity of the output: its change until the time t, divided "
        "by the relative change of the state that causes it. It is measured with the reference by changes of "
        f"{format_tolerance(NUDGE)} of the start, or of the state at all times (motions through singular "
        f"configurations). Motions are compared until the allowed error exceeds {LOST_PART:g} of the range of the "
        "output. The allowed error of problems with friction and beams contains the error of their model (elastic "
        "bristle, mesh). Steady states, frequencies and buckling loads have a fixed allowed error, relative to the "
        "largest number of the reference."
    )


def comparison_text() -> str:
    """Return what the numbers of a line are."""
    return (
        "Reference, number of mbfmu, error and allowed error of a line are those of the output and the time at which "
        "the ratio of error and allowed error is largest. Without a time the errors are relative to the largest "
        "number of the reference."
    )


def as_text(lines: Sequence[Line]) -> str:
    """Return the table and the number of verdicts; reasons are below the table."""
    rows = [cells(line) for line in lines]
    reasons = [f"{line.problem}, {line.method}: {line.verdict}: {line.reason}" for line in lines if line.reason]
    return "\n".join([format_table(REPORT_HEADER, rows), "", *reasons, summarize(lines)])


def cells(line: Line) -> tuple[str, ...]:
    """Return the cells of a line."""
    return (
        line.problem,
        line.source,
        f"{line.quantity} [{line.unit}]",
        line.method,
        "-" if line.tolerance is None else format_tolerance(line.tolerance),
        line.output or "-",
        number(line.time, 4),
        number(line.reference, 10),
        number(line.value, 10),
        number(line.error, 2),
        number(line.allowed, 2),
        number(line.uncertainty, 1),
        f"{1e3 * line.seconds:.0f}",
        line.verdict,
    )


def number(value: float | None, digits: int) -> str:
    """Return a number with the given number of significant digits; a dash if there is none."""
    return "-" if value is None else f"{value:.{digits}g}".replace("e-0", "e-")


def environment() -> str:
    """Return date, version and machine."""
    return (
        f"{date.today():%Y-%m-%d}, mbfmu {mbfmu.__version__}, Python {platform.python_version()}, {platform.machine()}"
    )


def as_dict(problems: Sequence[Problem], lines: Sequence[Line]) -> dict[str, Any]:
    """Return the content of ``report.json``."""
    return {
        "environment": environment(),
        "rule": rule_text(),
        "comparison": comparison_text(),
        "summary": summarize(lines),
        "problems": [
            {
                "name": p.name,
                "description": p.description,
                "sources": [source._asdict() for source in p.sources],
                "quantity": p.quantity,
                "unit": p.unit,
                "reference": p.derivation,
            }
            for p in problems
        ],
        "results": [line.as_dict() for line in lines],
        "not_covered": list(NOT_COVERED),
    }


def as_page(problems: Sequence[Problem], lines: Sequence[Line]) -> str:
    """Return the report as one page of HTML without external files."""
    counts = {word: sum(line.verdict == word for line in lines) for word in ("right", "stopped", "warned", "WRONG")}
    totals = "".join(f'<span class="{word if n else "none"}">{n} {word}</span>' for word, n in counts.items())
    described = "".join(describe(problem) for problem in problems)
    reasons = "".join(
        f'<li>{escape(line.problem)}, {escape(line.method)}, {tolerance_text(line)}: <span class="{line.verdict}">'
        f"{line.verdict}</span>. {escape(line.reason)}</li>"
        for line in lines
        if line.reason
    )
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en"><head><meta charset="utf-8"><title>Verification of mbfmu</title>',
        f"<style>{STYLE}</style></head><body>",
        f'<h1>Verification of mbfmu</h1><p class="small">{escape(environment())}</p>',
        f'<p class="totals">{totals}</p><p>{escape(rule_text())}</p>',
        f"<h2>Results</h2><p>{escape(comparison_text())}</p>",
        table(lines, problems),
        f"<h2>Messages</h2><ul>{reasons}</ul>" if reasons else "",
        f"<h2>Problems and references</h2><dl>{described}</dl>",
        "<h2>Not covered</h2><ul>" + "".join(f"<li>{escape(text.replace('`', ''))}</li>" for text in NOT_COVERED),
        "</ul></body></html>\n",
    ]
    return "\n".join(filter(None, parts))


def table(lines: Sequence[Line], problems: Sequence[Problem]) -> str:
    """Return the table of results as HTML; the first line of a problem contains its name, sources and quantity."""
    sources = {
        problem.name: "; ".join(as_link(source, source.key) for source in problem.sources) for problem in problems
    }
    is_text = [k < TEXT_COLUMNS or title in WORDS for k, title in enumerate(REPORT_HEADER)]
    styles = ["" if text else ' class="number"' for text in is_text]
    head = "".join(f"<th{style}>{title}</th>" for style, title in zip(styles, REPORT_HEADER, strict=True))
    rows, previous = [], ""
    for line in lines:
        own = [escape(text) for text in cells(line)]
        own[1] = sources[line.problem]
        if line.problem == previous:
            own[:TEXT_COLUMNS] = [""] * TEXT_COLUMNS
        own[-1] = f'<span class="{line.verdict}">{line.verdict}</span>'
        row = "".join(f"<td{style}>{text}</td>" for style, text in zip(styles, own, strict=True))
        rows.append(f"<tr>{row}</tr>" if line.problem == previous else f'<tr class="first">{row}</tr>')
        previous = line.problem
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def tolerance_text(line: Line) -> str:
    """Return the tolerance of a line for a sentence."""
    return "no tolerance" if line.tolerance is None else f"tolerance {format_tolerance(line.tolerance)}"


def describe(problem: Problem) -> str:
    """Return description, reference and sources of a problem as HTML."""
    sources = "; ".join(as_link(source) for source in problem.sources) or "devised for this suite"
    return (
        f"<dt>{escape(problem.name)}</dt><dd>{escape(problem.description)}<br>Quantity: {escape(problem.quantity)} "
        f"[{escape(problem.unit)}]. Reference: {escape(problem.derivation)}.<br>Source: {sources}.</dd>"
    )


def as_link(source: Source, text: str = "") -> str:
    """Return a source as HTML, by its whole description or another text."""
    shown = escape(text or str(source))
    return f'<a href="{escape(source.link, quote=True)}">{shown}</a>' if source.link else shown
