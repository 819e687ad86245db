"""The page of hard cases: ``python benchmarks/hard_cases.py`` writes ``docs/hard_cases.md`` and its picture.

Every mechanism of ``mechanisms.py`` and ``hard_trees.py`` in ``tests/loops``, and both four-bars that miss a singular
position, at every gap, with every solver and tolerance, compared with references that share no code with the
solvers. ``--cases`` and ``--solvers`` restrict what is run; then nothing is written.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "tests" / "loops")]

import matplotlib as mpl  # noqa: E402

mpl.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
from hard_trees import TREES  # noqa: E402
from judge import Verdict, judge, truth  # noqa: E402
from mechanisms import CASES, GAPS, Case, grashof, n_four_bar, parallelogram  # noqa: E402
from overconstrained import OVERCONSTRAINED  # noqa: E402

import mbfmu as mb  # noqa: E402
from mbfmu.mechanics import Mechanism  # noqa: E402

SOLVERS = ("ida", "adams", "hybrid", "radau", "esdirk")
LOOPS_AT_ONCE = (*range(1, 13), 15, 20, 25, 30, 35, 40)
LARGE_TREE = 60  # coordinates up to which solvers use dense matrices
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
POINTS = 81
PAGE, PICTURE = ROOT / "docs" / "hard_cases.md", ROOT / "docs" / "images" / "near_misses.png"

INTRODUCTION = """# Hard cases: singular, redundant and ill-conditioned mechanisms

This page is written by `benchmarks/hard_cases.py`. Each case is run with each solver and compared with a reference
that shares no code with the solvers: the motion in closed form or from equations derived by hand if available,
otherwise maximal coordinates with redundant constraints removed by rank, integrated by SciPy's DOP853 at 1e-11 with
projection. The results of a run are classified as follows:

- **right**: the error is below 100 rtol A(t), where rtol is the tolerance and A(t) the factor by which errors grow
  in this motion. The table gives the largest error (in lengths of the mechanism or rad) and the time of the run on
  the machine that wrote this page. Errors are compared while 100 rtol A is below 0.1; after that the loops must be
  closed and the energy must be conserved.
- **warned**: the error is larger, and the run reports that its result may be wrong.
- **refused**: the run stops with an error message, which is printed below the table.
- **wrong**: none of these.

If a singular configuration is missed by 1e-8 or less, rounding errors have a larger influence than a tolerance of
1e-10: `adams` and `hybrid` then use a larger tolerance, report it, and are compared at that tolerance. `mbfmu check
SCENE` reports whether a scene is such a case."""

LOOPS = """## Loops that are singular, redundant, driven or long

A four-bar *+ 1e-5* has a rod that is 10 um too long for its singular configuration. A case named *singular* passes
exactly through a singular configuration."""

WITHOUT_LOOPS = """## Trees: ill-conditioned mass matrices, many coordinates, turning bases, stops

Above 60 coordinates the solvers use the structure of the tree and no dense matrices. Cases on both sides of this
limit are included."""

AT_ONCE = """## Loops that are singular at the same instant

Benchmark A02 of the IFToMM library: N four-bars in a row, 2 s, with the exact motion of one degree of freedom. All
loops are singular at the same instant, first at 0.7 s. *Serial*: the tree is a chain with a loop-closing joint (cut
joint) at the foot of each column. *Grounded*: the columns are connected to the ground, with a cut joint at the end
of each coupler. Cells give the number of runs over N = {counts}, and the largest error of those that are right."""

MISSES = """## Near misses

![Error against the gap, for every solver and tolerance](images/near_misses.png)

*Largest error over the time in which errors are compared, which is shorter at large tolerances. Circles: parallel
four-bar; squares: Grashof four-bar.*"""


class Hard(NamedTuple):
    """A case to be run; ``gap`` (m) is the distance by which it misses a singular position, if that is its purpose."""

    name: str
    make: Callable[[], Case]
    section: str
    gap: float | None = None


class Run(NamedTuple):
    """One cell of the table."""

    name: str
    section: str
    gap: float | None
    solver: str
    rtol: float
    verdict: Verdict


def cases() -> Iterator[Hard]:
    """Every named mechanism, and both four-bars at every gap."""
    for name, make in {**CASES, **OVERCONSTRAINED}.items():
        yield Hard(name, make, LOOPS)
    for name, make in TREES.items():
        yield Hard(name, make, WITHOUT_LOOPS)
    for grounded in (False, True):
        for loops in LOOPS_AT_ONCE:
            name = f"{'grounded' if grounded else 'serial'}, N = {loops}"
            yield Hard(name, partial(at_once, loops, grounded), AT_ONCE)
    for gap in GAPS:
        yield Hard(f"1/3/1{gap:+.0e}/3", partial(parallelogram, gap), MISSES, gap)
        yield Hard(f"1/2.5/2/3.5{gap:+.0e}", partial(grashof, gap), MISSES, gap)


def at_once(loops: int, grounded: bool) -> Case:
    """Return N four-bars, for a shorter time."""
    return n_four_bar(loops, grounded=grounded)._replace(stop_time=2.0)


def solvers_of(mechanism: Mechanism, chosen: Sequence[str]) -> list[str]:
    """Return the chosen solvers that this mechanism can have: `esdirk` is for large trees, `hybrid` for loops."""
    large = len(mechanism.bodies) > LARGE_TREE
    return [
        s for s in chosen if not (s == "esdirk" and not large) and not (s == "hybrid" and not mechanism.constraints)
    ]


def run(name: str, solvers: Sequence[str]) -> list[Run]:
    """Run a case with every solver and tolerance."""
    hard = next(hard for hard in cases() if hard.name == name)
    mechanism, exact, stop_time = hard.make()
    known = truth(mechanism, np.linspace(0.0, stop_time, POINTS), exact)
    rows = []
    for solver in solvers_of(mechanism, solvers):
        judge(mechanism, known, solver, 1e-3)  # compiles
        for rtol in TOLERANCES:
            verdict = judge(mechanism, known, solver, rtol)
            if verdict.word == "wrong":
                warning = warning_of(mechanism, stop_time, solver, rtol)
                verdict = replace(verdict, word="warned", why=warning) if warning else verdict
            print(f"{hard.name:32s} {solver:7s} {rtol:.0e} {verdict}", flush=True)
            rows.append(Run(hard.name, hard.section, hard.gap, solver, rtol, verdict))
    return rows


def warning_of(mechanism: Mechanism, stop_time: float, solver: str, rtol: float) -> str:
    """Return the warning that a run through the public interface reports; empty if there is none."""
    result = mb.simulate(mechanism, stop_time, interval=stop_time / (POINTS - 1), solver=solver, tolerance=rtol)
    return result.warning or result.failure


def table(rows: list[Run]) -> str:
    """The runs as Markdown, one line a case and solver; messages below."""
    lines = [
        "| case | solver | " + " | ".join(f"{rtol:.0e}" for rtol in TOLERANCES) + " |",
        "|---|---|" + "---|" * len(TOLERANCES),
    ]
    messages: list[str] = []
    for case, solver in dict.fromkeys((r.name, r.solver) for r in rows):
        cells = [cell(r, messages) for r in rows if (r.name, r.solver) == (case, solver)]
        lines.append(f"| {case} | {solver} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", *(f"{k}. {text}" for k, text in enumerate(messages, 1))]).rstrip()


def families(rows: list[Run]) -> str:
    """The runs of families as Markdown: one line a family and solver, whose members are the part before the comma."""
    lines = [
        "| tree | solver | " + " | ".join(f"{rtol:.0e}" for rtol in TOLERANCES) + " |",
        "|---|---|" + "---|" * len(TOLERANCES),
    ]
    messages: list[str] = []
    for family, solver in dict.fromkeys((r.name.split(",")[0], r.solver) for r in rows):
        cells = []
        for rtol in TOLERANCES:
            members = [r for r in rows if (r.name.split(",")[0], r.solver, r.rtol) == (family, solver, rtol)]
            counts = Counter(r.verdict.word for r in members)
            worst = max((r.verdict.error for r in members if r.verdict.word == "right"), default=np.nan)
            cells.append(", ".join(f"{n} {word}" for word, n in counts.items()) + f"; {worst:.0e}")
            messages += [
                f"- {r.name}, {r.solver} at {r.rtol:.0e}, {r.verdict.word}: {r.verdict.why}."
                for r in members
                if r.verdict.word != "right"
            ]
        lines.append(f"| {family} | {solver} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", *messages]).rstrip()


def cell(row: Run, messages: list[str]) -> str:
    """Error and time of a run, or the number of its message."""
    v = row.verdict
    if v.word == "right":
        return f"{v.error:.0e}, {1e3 * v.seconds:.0f} ms"
    messages.append(f"{row.name}, {row.solver} at {row.rtol:.0e}: {v.why}.")
    return f"**{v.word}** ({len(messages)})"


def draw(rows: list[Run]) -> None:
    """Error against gap of both four-bars, a panel a solver."""
    solvers = tuple(dict.fromkeys(r.solver for r in rows))
    figure, axes = plt.subplots(1, len(solvers), figsize=(12.0, 4.0), sharey=True, layout="constrained")
    for axis, solver in zip(axes, solvers, strict=True):
        for k, rtol in enumerate(TOLERANCES):
            chosen = [r for r in rows if r.solver == solver and r.rtol == rtol and r.verdict.word == "right"]
            for mark, kind in (("o", "1/3/1"), ("s", "1/2.5")):
                alike = [r for r in chosen if r.name.startswith(kind)]
                gaps = [abs(r.gap or np.nan) for r in alike]
                errors = [r.verdict.error for r in alike]
                axis.loglog(gaps, errors, mark, ms=4, color=f"C{k}", label=f"rtol {rtol:.0e}" if mark == "o" else None)
        axis.set_title(solver)
        axis.set_xlabel("gap to the singular position, m")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("largest error, rad")
    figure.legend(*axes[-1].get_legend_handles_labels(), loc="outside right upper")
    figure.savefig(PICTURE, dpi=120)


def main() -> None:
    """Run the chosen cases; write the page if all were run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", help="substring of the names of cases; the page is not written")
    parser.add_argument("--solvers", help="names with commas; the page is not written")
    parser.add_argument("--jobs", type=int, default=1, help="processes; times in the table are best measured by one")
    options = parser.parse_args()
    solvers = options.solvers.split(",") if options.solvers else SOLVERS
    names = [hard.name for hard in cases() if not options.cases or options.cases in hard.name]
    with ProcessPoolExecutor(options.jobs, get_context("fork")) as pool:
        rows = [row for found in pool.map(partial(run, solvers=solvers), names) for row in found]
    counts = Counter(r.verdict.word for r in rows)
    summary = ", ".join(f"{counts[word]} {word}" for word in ("right", "warned", "refused", "wrong"))
    print(summary)
    if options.cases or options.solvers:
        return
    draw([r for r in rows if r.gap])
    by_section = {s: [r for r in rows if r.section == s] for s in (LOOPS, WITHOUT_LOOPS, AT_ONCE, MISSES)}
    parts = [f"{INTRODUCTION}\n{summary}.\n", f"{LOOPS}\n{table(by_section[LOOPS])}\n"]
    parts.append(f"{WITHOUT_LOOPS}\n{table(by_section[WITHOUT_LOOPS])}\n")
    at_once = AT_ONCE.format(counts=", ".join(map(str, LOOPS_AT_ONCE)))
    parts.append(f"{at_once}\n{families(by_section[AT_ONCE])}\n")
    parts.append(f"{MISSES}\n{table(by_section[MISSES])}\n")
    PAGE.write_text("\n".join(parts))


if __name__ == "__main__":
    main()
