"""The page of hard cases: ``python benchmarks/hard_cases.py`` writes ``docs/hard_cases.md`` and its picture.

Every mechanism of ``tests/loops/mechanisms.py`` and both four-bars that miss a singular position, at every gap, with
every solver and tolerance, judged by the reference in maximal coordinates (``tests/loops``), which shares nothing with
the solvers. ``--cases`` and ``--solvers`` restrict what is run and only print.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / "loops")]

import matplotlib as mpl  # noqa: E402

mpl.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
from judge import Verdict, judge, truth  # noqa: E402
from mechanisms import CASES, GAPS, Case, grashof, parallelogram  # noqa: E402

SOLVERS = ("ida", "adams", "hybrid", "radau")
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
POINTS = 81
PAGE, PICTURE = ROOT / "docs" / "hard_cases.md", ROOT / "docs" / "images" / "near_misses.png"

INTRODUCTION = """# Hard cases

Written by `benchmarks/hard_cases.py`. Each case is run by each solver and compared with a reference that shares
nothing with them: maximal coordinates, redundant rows by rank, DOP853 at 1e-11 with projection, SciPy alone; where the
motion is known in closed form, with that. A run is

- **right** where its error stays below 100 rtol A(t); A tells how errors grow in this motion. The table gives the
  largest error (in lengths of the mechanism or rad), and the run's time on this machine. Errors are judged while
  100 rtol A is below 0.1; after that the loops must stay closed and energy must be kept.
- **refused** where it stops with a message; what it says stands below the table.

Nothing else may happen.

A four-bar *+ 1e-5* has a rod that is 10 um too long for its singular position. What is *singular* passes one exactly.
Where a singular position is missed by 1e-8 and less, rounding decides more than a tolerance of 1e-10 could: `adams` and
`hybrid` run at a coarser one there and say so, and are judged by that one.

Whether a scene of your own is such a case, `mbfmu check SCENE` tells.
"""


class Hard(NamedTuple):
    """A case to be run; ``gap`` (m) is by how much it misses a singular position, if that is what it is for."""

    name: str
    case: Case
    gap: float | None = None


class Run(NamedTuple):
    """One cell of the table."""

    case: Hard
    solver: str
    rtol: float
    verdict: Verdict


def cases() -> Iterator[Hard]:
    """Every named mechanism, and both four-bars at every gap."""
    for name, make in CASES.items():
        yield Hard(name, make())
    for gap in GAPS:
        yield Hard(f"1/3/1{gap:+.0e}/3", parallelogram(gap), gap)
        yield Hard(f"1/2.5/2/3.5{gap:+.0e}", grashof(gap), gap)


def run(hard: Hard, solvers: tuple[str, ...]) -> Iterator[Run]:
    """Judge every solver and tolerance on one case."""
    mechanism, exact, stop_time = hard.case
    known = truth(mechanism, np.linspace(0.0, stop_time, POINTS), exact)
    for solver in solvers:
        judge(mechanism, known, solver, 1e-3)  # compiles
        for rtol in TOLERANCES:
            row = Run(hard, solver, rtol, judge(mechanism, known, solver, rtol))
            print(f"{hard.name:32s} {solver:7s} {rtol:.0e} {row.verdict}", flush=True)
            yield row


def table(rows: list[Run]) -> str:
    """The runs as Markdown, one line a case and solver; refusals in sentences below."""
    lines = [
        "| case | solver | " + " | ".join(f"{rtol:.0e}" for rtol in TOLERANCES) + " |",
        "|---|---|" + "---|" * len(TOLERANCES),
    ]
    sentences: list[str] = []
    for case, solver in dict.fromkeys((r.case.name, r.solver) for r in rows):
        cells = [cell(r, sentences) for r in rows if (r.case.name, r.solver) == (case, solver)]
        lines.append(f"| {case} | {solver} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", *(f"{k}. {text}" for k, text in enumerate(sentences, 1))])


def cell(row: Run, sentences: list[str]) -> str:
    """Error and time of a run, or the number of its sentence."""
    v = row.verdict
    if v.word == "right":
        return f"{v.error:.0e}, {1e3 * v.seconds:.0f} ms"
    sentence = f"{row.case.name}, {row.solver} at {row.rtol:.0e}: {v.why}."
    sentences.append(sentence)
    return f"**{v.word}** ({len(sentences)})"


def draw(rows: list[Run]) -> None:
    """Error against gap of both four-bars, a panel a solver."""
    figure, axes = plt.subplots(1, len(SOLVERS), figsize=(12.0, 4.0), sharey=True, layout="constrained")
    for axis, solver in zip(axes, SOLVERS, strict=True):
        for k, rtol in enumerate(TOLERANCES):
            chosen = [r for r in rows if r.solver == solver and r.rtol == rtol and r.verdict.word == "right"]
            for mark, kind in (("o", "1/3/1"), ("s", "1/2.5")):
                alike = [r for r in chosen if r.case.name.startswith(kind)]
                gaps = [abs(r.case.gap or np.nan) for r in alike]
                errors = [r.verdict.error for r in alike]
                axis.loglog(gaps, errors, mark, ms=4, color=f"C{k}", label=f"rtol {rtol:.0e}" if mark == "o" else None)
        axis.set_title(solver)
        axis.set_xlabel("gap to the singular position, m")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("largest error, rad")
    figure.legend(*axes[-1].get_legend_handles_labels(), loc="outside right upper")
    figure.savefig(PICTURE, dpi=120)


def main() -> None:
    """Run what is asked for; write the page where everything was."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", help="substring of the names of cases; nothing is written")
    parser.add_argument("--solvers", help="names with commas; nothing is written")
    options = parser.parse_args()
    solvers = tuple(options.solvers.split(",")) if options.solvers else SOLVERS
    wanted = [hard for hard in cases() if not options.cases or options.cases in hard.name]
    rows = [row for hard in wanted for row in run(hard, solvers)]
    counts = {word: sum(r.verdict.word == word for r in rows) for word in ("right", "refused", "wrong")}
    print(", ".join(f"{count} {word}" for word, count in counts.items()))
    if options.cases or options.solvers:
        return
    misses = [r for r in rows if r.case.gap]
    draw(misses)
    PAGE.write_text(
        f"{INTRODUCTION}\n{', '.join(f'{count} {word}' for word, count in counts.items())}.\n\n"
        f"## Loops that are singular, redundant, driven or long\n\n{table([r for r in rows if not r.case.gap])}\n\n"
        "## Near misses\n\n"
        "![Error against the gap, for every solver and tolerance](images/near_misses.png)\n\n"
        "*Largest error while errors are judged, which at loose tolerances is a shorter time; round the parallel "
        "four-bar, square the other.*\n\n"
        f"{table(misses)}\n"
    )


if __name__ == "__main__":
    main()
