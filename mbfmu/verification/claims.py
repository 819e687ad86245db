"""Numbers of the documentation that state accuracy or speed: their list, and measuring them again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from inspect import signature
from math import inf
from pathlib import Path
from typing import Any

from mbfmu.util.errors import UserError
from mbfmu.util.text_table import format_count, format_table
from mbfmu.util.toml import read_toml

from .claim_measures import MEASURES
from .report import environment
from .verdict import finite

CLAIM_HOLDS, FAILS, DIFFERS = "holds", "FAILS", "differs"
NOT_MEASURED, OUTDATED = "not measured", "NOT IN THE PAGE"
VERDICTS = (CLAIM_HOLDS, FAILS, DIFFERS, NOT_MEASURED, OUTDATED)
CLAIM_KINDS = ("accuracy", "speed")
TEXT_KEYS = ("page", "text", "kind", "measure", "command")
CLAIM_KEYS = {*TEXT_KEYS, "arguments", "range"}


@dataclass(frozen=True, kw_only=True)
class Claim:
    """Statement of a page.

    Attributes
    ----------
    page, text
        Path of the page from the folder of the repository, and a part of its text.
    kind
        ``accuracy`` or ``speed``.
    measure, arguments
        Name of a function in ``MEASURES`` and its arguments; empty: ``command`` measures the number.
    range
        Smallest and largest number for which the statement holds.
    command
        Command that measures the number, from a copy of the repository.
    """

    page: str
    text: str
    kind: str
    measure: str = ""
    arguments: tuple[str | float, ...] = ()
    range: tuple[float, float] = (-inf, inf)
    command: str = ""

    @property
    def method(self) -> str:
        """Measure with its arguments, or the command."""
        return f"{self.measure}({', '.join(map(str, self.arguments))})" if self.measure else self.command


@dataclass(frozen=True)
class Measured:
    """Claim with the number that was measured (None: by a command only), a verdict, and why it was not measured."""

    claim: Claim
    number: float | None
    verdict: str
    reason: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name; a range without limits is None."""
        claim = self.claim
        return {
            "page": claim.page,
            "text": claim.text,
            "kind": claim.kind,
            "method": claim.method,
            "range": list(claim.range) if claim.measure else None,
            "number": finite(self.number),
            "verdict": self.verdict,
            "reason": self.reason,
        }


def read_claims(path: Path) -> list[Claim]:
    """Return the claims of a TOML file; raises UserError if an entry is invalid."""
    content = read_toml(path, "list of claims")
    if unknown := set(content) - {"claim"}:
        raise UserError(f"list of claims {str(path)!r} has the entry {min(unknown)!r}; allowed: [[claim]]")
    entries = content.get("claim", [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries) or not entries:
        raise UserError(f"list of claims {str(path)!r} contains no claim; each begins with the line [[claim]]")
    return [_read_claim(entry, f"claim {entry.get('text', '')!r} of {str(path)!r}") for entry in entries]


def _read_claim(entry: dict[str, Any], what: str) -> Claim:
    """Return a claim; ``what`` names it in messages."""
    if unknown := set(entry) - CLAIM_KEYS:
        raise UserError(f"{what} has the key {min(unknown)!r}; allowed: {', '.join(sorted(CLAIM_KEYS))}")
    for key in TEXT_KEYS:
        if (key in TEXT_KEYS[:3] or key in entry) and not (isinstance(entry.get(key), str) and entry[key]):
            raise UserError(f"{what} has the {key} {entry.get(key)!r}; allowed: a text that is not empty")
    if entry["kind"] not in CLAIM_KINDS:
        raise UserError(f"{what} is of the kind {entry['kind']!r}; allowed: {', '.join(CLAIM_KINDS)}")
    if ("measure" in entry) == ("command" in entry):
        raise UserError(f"{what} must have a measure or a command, and not both")
    if "measure" not in entry and (extra := {"arguments", "range"} & set(entry)):
        raise UserError(f"{what} has the key {min(extra)!r}, which needs a measure")
    if "measure" not in entry:
        return Claim(**entry)
    if entry["measure"] not in MEASURES:
        raise UserError(f"{what} has the measure {entry['measure']!r}; allowed: {', '.join(MEASURES)}")
    limits, arguments = entry.get("range", []), entry.get("arguments", [])
    numbers = limits if isinstance(limits, list) and all(type(limit) in (int, float) for limit in limits) else []
    if len(numbers) != 2 or not numbers[0] <= numbers[1]:
        raise UserError(f"{what} has the range {limits!r}; allowed: two numbers, the smaller one first")
    expected = list(signature(MEASURES[entry["measure"]]).parameters)
    if not isinstance(arguments, list) or len(arguments) != len(expected):
        raise UserError(f"{what} has the arguments {arguments!r}; allowed: a list of {expected}")
    return Claim(**{**entry, "range": tuple(numbers), "arguments": tuple(arguments)})


def measure_claims(claims: list[Claim], root: Path) -> Iterator[Measured]:
    """Measure claims; the pages are in the folder ``root``."""
    for claim in claims:
        page = root / claim.page
        if not page.is_file() or claim.text not in " ".join(page.read_text(encoding="utf-8").split()):
            yield Measured(claim, None, OUTDATED)
        elif not claim.measure:
            yield Measured(claim, None, NOT_MEASURED)
        else:
            yield measure(claim)


def measure(claim: Claim) -> Measured:
    """Measure a claim that has a measure."""
    try:
        number = MEASURES[claim.measure](*claim.arguments)
    except UserError as refusal:  # such as a package that is not installed
        return Measured(claim, None, NOT_MEASURED, str(refusal))
    if claim.range[0] <= number <= claim.range[1]:
        return Measured(claim, number, CLAIM_HOLDS)
    return Measured(claim, number, FAILS if claim.kind == "accuracy" else DIFFERS)


def summarize(measured: Sequence[Measured]) -> str:
    """Return the number of claims by verdict."""
    counts = {word: sum(found.verdict == word for found in measured) for word in VERDICTS}
    return f"{format_count(len(measured), 'claim')}: " + ", ".join(f"{n} {word}" for word, n in counts.items())


def as_text(measured: Sequence[Measured]) -> str:
    """Return a table of claims, and their number by verdict; reasons are below the table."""
    rows = [
        (
            found.claim.page,
            found.claim.text,
            "-" if found.number is None else f"{found.number:.4g}",
            f"{found.claim.range[0]:g} to {found.claim.range[1]:g}" if found.claim.measure else "-",
            found.claim.method,
            found.verdict,
        )
        for found in measured
    ]
    reasons = [f"{found.claim.method}: {found.reason}" for found in measured if found.reason]
    header = ("page", "text", "measured", "range", "measure or command", "verdict")
    return "\n".join([format_table(header, rows), "", *reasons, summarize(measured)])


def as_dict(measured: Sequence[Measured]) -> dict[str, Any]:
    """Return the content of a file with the result."""
    claims = [found.as_dict() for found in measured]
    return {"environment": environment(), "summary": summarize(measured), "claims": claims}


def has_failed(measured: Sequence[Measured]) -> bool:
    """Return whether a claim of accuracy fails, or a page no longer contains the text of a claim."""
    return any(found.verdict in (FAILS, OUTDATED) for found in measured)
