"""Numbers of the documentation that state accuracy or speed: their list, and measuring them again."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from mbfmu.mechanics import Mechanism, Revolute, rod
from mbfmu.modeling.registry import find
from mbfmu.session.run import simulate
from mbfmu.util.errors import UserError
from mbfmu.util.text_table import format_count, format_table
from mbfmu.util.toml import read_toml

CLAIM_HOLDS, FAILS, NOT_MEASURED, OUTDATED = "holds", "FAILS", "not measured", "NOT IN THE PAGE"
CLAIM_KINDS = ("accuracy", "speed")
CLAIM_KEYS = {"page", "text", "kind", "measure", "range", "command"}


@dataclass(frozen=True, kw_only=True)
class Claim:
    """Statement of a page.

    Attributes
    ----------
    page, text
        Path of the page from the folder of the repository, and a part of its text.
    kind
        ``accuracy`` or ``speed``.
    measure
        Name of a function in ``MEASURES``; empty: ``command`` measures the number.
    range
        Smallest and largest number for which the statement holds.
    command
        Command that measures the number, from a copy of the repository.
    """

    page: str
    text: str
    kind: str
    measure: str = ""
    range: tuple[float, float] = (-np.inf, np.inf)
    command: str = ""


@dataclass(frozen=True)
class Measured:
    """Claim with the number that was measured (None: by a command only) and a verdict."""

    claim: Claim
    number: float | None
    verdict: str


def read_claims(path: Path) -> list[Claim]:
    """Return the claims of a TOML file; raises UserError if an entry is invalid."""
    claims = []
    for entry in read_toml(path, "list of claims").get("claim", []):
        what = f"claim {entry.get('text', '')!r} of {str(path)!r}"
        unknown = set(entry) - CLAIM_KEYS
        if unknown:
            raise UserError(f"{what} has the key {min(unknown)!r}; allowed: {', '.join(sorted(CLAIM_KEYS))}")
        if entry.get("kind") not in CLAIM_KINDS:
            raise UserError(f"{what} is of the kind {entry.get('kind')!r}; allowed: {', '.join(CLAIM_KINDS)}")
        if ("measure" in entry) == ("command" in entry):
            raise UserError(f"{what} must have a measure or a command, and not both")
        if "measure" in entry and entry["measure"] not in MEASURES:
            raise UserError(f"{what} has the measure {entry['measure']!r}; allowed: {', '.join(MEASURES)}")
        claims.append(Claim(**{**entry, "range": tuple(entry.get("range", Claim.range))}))
    return claims


def measure_claims(claims: list[Claim], root: Path) -> Iterator[Measured]:
    """Measure claims; the pages are in the folder ``root``."""
    for claim in claims:
        page = root / claim.page
        if not page.exists() or claim.text not in " ".join(page.read_text(encoding="utf-8").split()):
            yield Measured(claim, None, OUTDATED)
        elif not claim.measure:
            yield Measured(claim, None, NOT_MEASURED)
        else:
            number = MEASURES[claim.measure]()
            low, high = claim.range
            yield Measured(claim, number, CLAIM_HOLDS if low <= number <= high else FAILS)


def as_text(measured: list[Measured]) -> str:
    """Return a table of claims, and their number by verdict."""
    rows = [
        (
            found.claim.page,
            found.claim.text,
            "-" if found.number is None else f"{found.number:.4g}",
            f"{found.claim.range[0]:g} to {found.claim.range[1]:g}" if found.claim.measure else found.claim.command,
            found.verdict,
        )
        for found in measured
    ]
    counts = {
        word: sum(found.verdict == word for found in measured) for word in (CLAIM_HOLDS, FAILS, NOT_MEASURED, OUTDATED)
    }
    summary = f"{format_count(len(measured), 'claim')}: " + ", ".join(f"{n} {word}" for word, n in counts.items())
    return format_table(("page", "text", "measured", "range, or command", "verdict"), rows) + f"\n\n{summary}"


def has_failed(measured: list[Measured]) -> bool:
    """Return whether a claim of accuracy fails, or a page no longer contains the text of a claim."""
    return any(
        found.verdict == OUTDATED or (found.verdict == FAILS and found.claim.kind == "accuracy") for found in measured
    )


# ---- measures --------------------------------------------------------------------------------------------------------


@cache
def _four_bar_angle(solver: str) -> tuple[Any, Any, Any]:
    """Return times, s, the simulated angle of the crank and the exact one, rad, until the run ends."""
    model = find("fourbar")()
    result = simulate(model, 10.0, interval=1e-3, solver=solver, tolerance=1e-8)
    exact = model.exact(result.t)
    assert exact is not None
    return result.t, result["crank.angle"], exact["crank.angle"]


def _count_passages(angle: Any) -> int:
    """Return how often an angle passes a multiple of pi."""
    return int(np.count_nonzero(np.diff(np.floor(angle / np.pi))))


def passages_of_four_bar() -> float:
    """Return how often the simulated four-bar passes its singular configuration in 10 s."""
    return _count_passages(_four_bar_angle("adams")[1])


def passages_before_adams_lu_fails() -> float:
    """Return how often `adams-lu` passes the singular configuration before it stops or leaves the exact motion."""
    _, angle, exact = _four_bar_angle("adams-lu")
    wrong = np.flatnonzero(np.abs(angle - exact) > 0.1)
    return _count_passages(exact[: wrong[0] if len(wrong) else len(exact)])


def _growth(solver: str) -> float:
    """Return the largest error of a pendulum in 100 periods by the tolerance, for tolerances of 1e-6 and 1e-8."""
    m = Mechanism(gravity=(0.0, -9.81, 0.0))
    body = m.body("rod", m.ground, Revolute(start=-1.0, fixed=True), **rod(mass=1.0, length=1.0))
    m.output("angle", body.angle(), "Angle of the rod")
    from .references import integrated

    def right(_: float, y: Any) -> Any:
        return y[1], -1.5 * 9.81 * np.cos(y[0])

    stop_time = 100.0 * 1.65  # s; the period is 1.65 s at 0.57 rad from the vertical
    exact = integrated(right, (-1.0, 0.0), (1.0, 4.0), lambda _, y: (y[0],), stop_time)
    ratios = []
    for tolerance in (1e-6, 1e-8):
        result = simulate(m, stop_time, interval=0.05, solver=solver, tolerance=tolerance)
        ratios.append(np.abs(result["angle"] - exact.solution(np.array(exact.start), result.t)[:, 0]).max() / tolerance)
    return float(max(ratios))


def error_of_ida_after_100_periods() -> float:
    """Return the error of `ida` by the tolerance."""
    return _growth("ida")


def error_of_adams_after_100_periods() -> float:
    """Return the error of `adams` by the tolerance."""
    return _growth("adams")


MEASURES: dict[str, Callable[[], float]] = {
    f.__name__: f
    for f in (
        passages_of_four_bar,
        passages_before_adams_lu_fails,
        error_of_ida_after_100_periods,
        error_of_adams_after_100_periods,
    )
}
