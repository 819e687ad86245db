"""Write the tables of comparisons into the pages: ``python docs/comparison_tables.py``.

A table stands below a line ``<!-- table: NAME -->``. Its numbers are the rows of a run of ``mbfmu compare``, whose file
``rows.json`` is kept next to the picture of the same run.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

from mbfmu.util.text_table import format_tolerance
from solvers.steppers.ida.dense_memory import MIN_RTOL

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
CHOOSING, FOURBAR, GOVERNOR, PENDULUM = (
    ROOT / "docs" / "choosing.md",
    *(ROOT / "fmus" / name / "README.md" for name in ("fourbar", "governor", "pendulum")),
)
MOTIONS = {  # title in the tables of the page on solvers, by the name of the rows
    "fourbar": "four-bar",
    "governor": "governor",
    "pendulum": "pendulum",
    "fourbar_elastic": "four-bar with an elastic coupler",
}
SOLVERS = ("adams", "hybrid", "radau", "ida")
SETTLING = ("newton", "ida", "adams", "radau")
WITHOUT_LOOPS = ("pendulum",)
REQUIRED = 1e-6  # of the range of an output: error of the runs that the page on solvers compares
MARK = "<!-- table: {} -->"
Rows = list[dict[str, Any]]


def rows(name: str, study: str) -> Rows:
    """Return the rows of a comparison that belong to a study."""
    file = IMAGES / f"{name}_work_precision.json"
    return [row for row in json.loads(file.read_text()) if row["study"] == study]


def used(name: str, row: dict[str, Any]) -> float:
    """Return the tolerance that the solver of a row has used."""
    smallest = MIN_RTOL if row["solver"] == "ida" and name not in WITHOUT_LOOPS else 0.0
    return float(max(smallest, row["rtol"]))


def tolerance(name: str, row: dict[str, Any]) -> str:
    """Return the tolerance of a row, and the one that was used if it is another."""
    own = used(name, row)
    return format_tolerance(row["rtol"]) + (f" ({format_tolerance(own)} used)" if own != row["rtol"] else "")


def number(value: float | None) -> str:
    """Return an error with two digits."""
    if not value:
        return "-" if value is None else "0"
    digits, exponent = f"{value:.1e}".split("e")
    return f"{digits}e{int(exponent)}".removesuffix("e0")


def time(seconds: float) -> str:
    """Return a CPU time in ms with three digits."""
    return f"{1e3 * seconds:#.3g}".removesuffix(".")


def result(row: dict[str, Any]) -> str:
    """Return how a run ended."""
    words = [
        "on another branch" if row["branch_jump"] else "",
        "reported as inaccurate" if row["warning"] else "",
        "" if row["status"] == "ok" else f"stops after {row['end_time']:.2f} s",
    ]
    return ", ".join(filter(None, words)) or "ok"


def markdown(header: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    """Return a table."""
    return "\n".join("| " + " | ".join(line) + " |" for line in (header, *lines)).replace(
        "\n", "\n|" + "---|" * len(header) + "\n", 1
    )


def motion(name: str) -> str:
    """Return all runs of a comparison."""
    header = (
        "solver",
        "tolerance",
        "CPU time, ms",
        "steps",
        "evaluations",
        "error / range",
        "energy error, J",
        "result",
    )
    found = sorted(
        rows(name, "motion"), key=lambda row: ("ida", "adams", "hybrid", "adams-lu", "radau").index(row["solver"])
    )
    return markdown(
        header,
        [
            (
                row["solver"],
                tolerance(name, row),
                time(row["cpu_s"]),
                str(row["steps"]),
                str(row["rhs_evals"]),
                number(row["error"]),
                number(row["energy_error"]),
                result(row),
            )
            for row in found
        ],
    )


def settling(name: str) -> str:
    """Return the runs into the steady state, compared with Newton's method."""
    found = sorted(
        (r for r in rows(name, "settling") if r["solver"] in SETTLING), key=lambda r: SETTLING.index(r["solver"])
    )
    header = (
        "method",
        "tolerance",
        "CPU time, ms",
        "ratio to Newton's method",
        "steps or iterations",
        "error, rad or m",
    )
    return markdown(
        header,
        [
            (
                "Newton's method" if row["rtol"] is None else row["solver"],
                "" if row["rtol"] is None else tolerance(name, row),
                time(row["cpu_s"]),
                rounded(row["cpu_s"] / found[0]["cpu_s"]),
                str(row["steps"]),
                number(row["max_error"]),
            )
            for row in found
        ],
    )


def of_solver(name: str, solver: str) -> Rows:
    """Return the runs of a solver that reached their end on their branch."""
    own = [row for row in rows(name, "motion") if row["solver"] == solver]
    assert all(result(row) == "ok" for row in own)
    return own


def cheapest() -> str:
    """Return the fastest run of each solver whose error is small enough."""
    lines: list[tuple[str, ...]] = []
    for name, title in MOTIONS.items():
        for solver in filter(partial(of_solver, name), SOLVERS):
            own = of_solver(name, solver)
            good = [row for row in own if row["error"] < REQUIRED]
            best = min(good, key=lambda row: row["cpu_s"], default=None)
            cells = (
                (tolerance(name, best), time(best["cpu_s"]), number(best["error"]))
                if best
                else ("none", "", f"at least {number(min(row['error'] for row in own))}")
            )
            lines.append((title, f"`{solver}`", *cells))
    return markdown(("motion", "solver", "tolerance", "CPU time, ms", "error / range"), lines)


def multiples() -> str:
    """Return the smallest and the largest error of each solver, in units of its tolerance."""
    lines = []
    for name, title in MOTIONS.items():
        cells = []
        for solver in SOLVERS:
            ratios = sorted(row["error"] / used(name, row) for row in of_solver(name, solver))
            cells.append(f"{rounded(ratios[0])} to {rounded(ratios[-1])}" if ratios else "as `adams`")
        lines.append((title, *cells))
    return markdown(("motion", *(f"`{solver}`" for solver in SOLVERS)), lines)


def rounded(value: float) -> str:
    """Return two digits without an exponent."""
    return f"{float(f'{value:.1e}'):g}"


def tables() -> dict[Path, dict[str, str]]:
    """Return the tables of each page by name."""
    return {
        CHOOSING: {"fastest runs": cheapest(), "errors in tolerances": multiples()},
        FOURBAR: {"rigid coupler": motion("fourbar"), "elastic coupler": motion("fourbar_elastic")},
        GOVERNOR: {"steady state": settling("governor"), "motion": motion("governor")},
        PENDULUM: {"steady state": settling("pendulum"), "motion": motion("pendulum")},
    }


def with_tables(page: Path) -> str:
    """Return the text of a page with its tables."""
    text = page.read_text()
    for name, table in tables()[page].items():
        mark = MARK.format(name)
        found = re.findall(re.escape(mark) + r"\n\n(?:\|.*\n)+", text)
        if len(found) != 1:
            raise ValueError(f"{page} has {len(found)} tables below {mark!r} instead of one")
        text = text.replace(found[0], f"{mark}\n\n{table}\n")
    return text


if __name__ == "__main__":
    for page in tables():
        page.write_text(with_tables(page))
