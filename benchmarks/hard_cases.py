"""The page of hard cases: ``python benchmarks/hard_cases.py`` writes ``docs/hard_cases.md`` and its picture.

Every mechanism of ``mechanisms.py`` and ``hard_trees.py`` in ``tests/loops``, and both four-bars that miss a singular
position, at every gap, with every solver and tolerance, compared with references that share no code with the
solvers. ``--cases`` and ``--solvers`` restrict what is run; then nothing is written.
"""

from __future__ import annotations

import argparse
import platform
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from datetime import date
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
from mbfmu.mechanics import CompiledMechanism, Mechanism  # noqa: E402
from mbfmu.util.text_table import format_tolerance  # noqa: E402

SOLVERS = ("ida", "adams", "hybrid", "radau", "esdirk")
LOOPS_AT_ONCE = (*range(1, 13), 15, 20, 25, 30, 35, 40)
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
POINTS = 81
PAGE, PICTURE = ROOT / "docs" / "hard_cases.md", ROOT / "docs" / "images" / "near_misses.png"

INTRODUCTION = """# Hard cases: validation of singular, redundant and ill-conditioned mechanisms

This page is written by `benchmarks/hard_cases.py`. Each mechanism is simulated with each solver that accepts it. The
results are compared with a reference that shares no code with mbfmu:

- *hand-derived*: the motion in closed form, or from equations of motion that were derived by hand;
- *maximal coordinates*, for all other mechanisms: position and orientation of each body, integrated by SciPy's DOP853
  at a tolerance of 1e-11 with projection. Redundant constraint equations are removed by rank.

`mbfmu check SCENE` reports whether a mechanism of your own is such a case. [Choosing a solver](choosing.md) helps to
select a solver, and [limitations](limitations.md#loops) lists what is known to fail.

## How runs are classified

A(t) is the factor by which errors grow in the motion. To compute it, the reference is repeated with random errors
of 1e-7 (at each output time if it is hand-derived, otherwise after each step). A(t) is the largest deviation until
t, divided by 1e-7. Positions are compared until 100 rtol A(t) exceeds 0.1, where rtol is the relative tolerance of
the run. After that time errors may have grown so far that a difference of positions has no meaning; a change to
another branch is then detected only by its energy. A run is

- **right** if its error is at most 100 rtol A(t) as long as positions are compared (plus ten times the uncertainty
  of the reference), its loops remain closed, and the energy of a system without damping and drives is conserved
  within 2 %,
- **stopped** if it is right until it stops with an error message, which it also does after 20 000 steps between two of
  its 81 output times,
- **warned** if it is neither, but reports that its result may be wrong, or stops with an error message,
- **wrong** otherwise.

A cell such as *2e-4 until 3.9 s, 14 ms* contains the largest error, in rad or in [lengths of the
mechanism](glossary.md), the time until which positions are compared if this is not the whole run, and the CPU time
without compilation. The CPU time is a single measurement, which may be wrong by a factor of two. Runs at small
tolerances are compared for a longer time, so that an error may be larger in a column further to the right.

If a singular configuration is missed by 1e-7 m or less, rounding errors may exceed a small tolerance. `adams`,
`hybrid` and `radau` then use a larger tolerance and report it. Models with loops are simulated by `ida` at a tolerance
of at least 1e-9, and of 1e-8 if they are large, which is reported too. Runs are compared at the tolerance that is
reported, which is in the cell: *3e-5 at 8e-9*."""

LOOPS = """## Loops that are singular, redundant, driven or long

Columns give the relative tolerance. *+ 1e-5*: the rod of the slider-crank is 1e-5 m longer than the crank, so that
the mechanism misses its singular configuration; *- 1e-5*: it is shorter."""

WITHOUT_LOOPS = """## Trees: light bodies, many coordinates, driven rotating bases, stops

Mechanisms without loops and with more than 60 coordinates are solved by recursions along the tree and not by dense
matrices. Cases on both sides of this limit are included. `esdirk` accepts large models only."""

AT_ONCE = """## Loops that are singular at the same instant

Benchmark A02 of the IFToMM library: N four-bars in a row, 2 s, with the exact motion of one degree of freedom. All
loops are singular at the same instant, first at 0.7 s. *Serial*: the tree is a chain with a loop-closing joint (cut
joint) at the foot of each column. *Grounded*: the columns are connected to the ground, with a cut joint at the end of
each coupler. N is {counts}.
Cells contain the number of runs and the largest error of those that are right."""

MISSES = """## Near misses

![Error against the gap, for every solver and tolerance](images/near_misses.png)

*Largest error over the time in which positions are compared. At 1e-4 this time is so short that the error is often
smaller than at 1e-6. Circles: parallelogram; squares: Grashof four-bar. The gap is the length by which a link is
too long or too short; both are drawn. Runs that stop are not drawn. At gaps of 1e-8 m and more the error
decreases from 1e-6 to 1e-10 with the tolerance. At a gap of 1e-9 m rounding errors limit it to 1e-6 to 1e-4 at all
small tolerances.*

Of the parallelogram the rocker, and of the Grashof four-bar the ground link is too long (*+*) or too short (*-*)."""

SOURCES = {
    "parallelogram": (
        "four-bar, links 1, 3, 1, 3 m",
        "passes 17 times in 10 s the configuration with all links in line",
    ),
    "grashof": ("four-bar, links 1, 2.5, 2, 3.5 m", "passes near the configuration with all links in line"),
    "three cranks": (
        "coupler on three parallel cranks",
        "one crank is redundant; *singular*: passes the line of all links",
    ),
    "table": ("plate on four equal cranks, three by ball joints", "six constraint equations of rank four"),
    "double parallelogram": (
        "two parallelograms, one on the coupler of the other",
        "*singular*: one of them passes its singularity",
    ),
    "slider-crank": ("crank and rod of equal length", "the slider passes the center of the crank"),
    "bricard": ("six rods along the edges of a cube (Bricard)", "one of five constraint equations is redundant"),
    "ladder": ("parallelograms one below the other", "many loops"),
    "four-bars": ("four-bars in a row, links 1 m (IFToMM A02)", "all loops are singular at the same instant"),
    "squeezer": ("Andrews' squeezing mechanism (IVP test set)", "seven bodies, three loops, fast motion"),
    "crane": ("boom with cylinder and spring on a driven base", "loop on a rotating base"),
    "bennett": ("Bennett's linkage", "five constraint equations of rank two"),
    "sarrus": ("Sarrus' linkage", "rank four of five; *folded flat* and *straight* are singular"),
    "cart": ("pole of 1 kg on a light cart (proposed to IFToMM)", "nearly singular mass matrix at each passage"),
    "double pendulum": ("second mass 1 kg", "nearly singular mass matrix when stretched or folded"),
    "rotor": ("rotor in two rings of 1e-6 kg m2", "nearly singular mass matrix near gimbal lock"),
    "pendulum among": ("one swinging rod, the others at rest", "one moving coordinate among many"),
    "chain": ("hanging chain of 1 m, 1 kg", "dense matrices below, recursions above 60 coordinates"),
    "rods on": ("rods on hinges of a driven vertical spindle", "rotating base at 5 rad/s"),
    "slider on": ("mass falls 1 m onto a damped stop", "impacts"),
    "rod between": ("rod swings between two stiff stops", "impacts without damping"),
}  # words of a name, and the mechanism and its difficulty


class Hard(NamedTuple):
    """A case to be run; ``gap`` (m): distance by which it misses a singular configuration, if that is its purpose."""

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
    stop_time: float
    verdict: Verdict


def cases() -> Iterator[Hard]:
    """Every named mechanism, and both four-bars at every gap."""
    misses = {
        f"{name} {'+' if gap > 0.0 else '-'} {format_tolerance(abs(gap))}": (partial(make, gap), gap)
        for gap in GAPS
        for name, make in (("parallelogram", parallelogram), ("grashof", grashof))
    }
    for name, make in {**CASES, **OVERCONSTRAINED}.items():
        if name not in misses:
            yield Hard(name, make, LOOPS)
    for name, make in TREES.items():
        yield Hard(name, make, WITHOUT_LOOPS)
    for grounded in (False, True):
        for loops in LOOPS_AT_ONCE:
            name = f"{'grounded' if grounded else 'serial'}, N = {loops}"
            yield Hard(name, partial(at_once, loops, grounded), AT_ONCE)
    for name, (make, gap) in misses.items():
        yield Hard(name, make, MISSES, gap)


def at_once(loops: int, grounded: bool) -> Case:
    """Return N four-bars, for a shorter time."""
    return n_four_bar(loops, grounded=grounded)._replace(stop_time=2.0)


def solvers_of(mechanism: Mechanism, chosen: Sequence[str]) -> list[str]:
    """Return the chosen solvers that accept this mechanism: `esdirk` is for large trees, `hybrid` for loops."""
    small = CompiledMechanism(mechanism).system.has_matrices
    return [s for s in chosen if not (s == "esdirk" and small) and not (s == "hybrid" and not mechanism.constraints)]


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
            rows.append(Run(hard.name, hard.section, hard.gap, solver, rtol, stop_time, verdict))
    return rows


def warning_of(mechanism: Mechanism, stop_time: float, solver: str, rtol: float) -> str:
    """Return the warning that a run through the public interface reports; empty if there is none."""
    result = mb.simulate(mechanism, stop_time, interval=stop_time / (POINTS - 1), solver=solver, tolerance=rtol)
    return result.warning or result.failure


def table(rows: list[Run]) -> str:
    """The runs as Markdown, one line a case and solver; messages below."""
    lines = [
        "| case | solver | " + " | ".join(format_tolerance(rtol) for rtol in TOLERANCES) + " |",
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
        "| tree | solver | " + " | ".join(format_tolerance(rtol) for rtol in TOLERANCES) + " |",
        "|---|---|" + "---|" * len(TOLERANCES),
    ]
    messages: list[str] = []
    for family, solver in dict.fromkeys((r.name.split(",")[0], r.solver) for r in rows):
        cells = []
        for rtol in TOLERANCES:
            members = [r for r in rows if (r.name.split(",")[0], r.solver, r.rtol) == (family, solver, rtol)]
            counts = Counter(r.verdict.word for r in members)
            worst = max((r.verdict.error for r in members if r.verdict.word == "right"), default=None)
            told = "" if worst is None else f"; {format_tolerance(float(f'{worst:.0e}'))}"
            cells.append(", ".join(f"{n} {word}" for word, n in counts.items()) + told)
            messages += [
                f"- {r.name}, {r.solver} at {format_tolerance(r.rtol)}, {r.verdict.word}: {r.verdict.why}."
                for r in members
                if r.verdict.word != "right"
            ]
        lines.append(f"| {family} | {solver} | " + " | ".join(cells) + " |")
    return "\n".join([*lines, "", *messages]).rstrip()


def cell(row: Run, messages: list[str]) -> str:
    """Error and time of a run, or the number of its message."""
    v = row.verdict
    if v.word == "right":
        until = f" until {v.until:.2g} s" if v.until < (1.0 - 1e-9) * row.stop_time else ""
        coarser = f" at {format_tolerance(float(f'{v.rtol:.0e}'))}" if v.rtol > 1.01 * row.rtol else ""
        return f"{format_tolerance(float(f'{v.error:.0e}'))}{coarser}{until}, {1e3 * v.seconds:.0f} ms"
    size = f"; the largest error is {v.ratio:.0f} rtol A" if v.word != "stopped" else ""
    messages.append(f"{row.name}, {row.solver} at {format_tolerance(row.rtol)}: {v.why}{size}.")
    return f"**{v.word}** ({len(messages)})"


def counted_by_solver(rows: list[Run]) -> str:
    """The counts of each solver as Markdown."""
    words = ("right", "warned", "stopped", "wrong")
    lines = ["| solver | runs | " + " | ".join(words) + " |", "|---|---|" + "---|" * len(words)]
    for solver in [*dict.fromkeys(r.solver for r in rows), "all"]:
        counts = Counter(r.verdict.word for r in rows if solver in (r.solver, "all"))
        cells = [str(counts.total()), *(str(counts[word]) for word in words)]
        lines.append(f"| {solver} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def described() -> str:
    """What each mechanism is, as Markdown: one line for the cases of one kind."""
    kinds: dict[str, list[Hard]] = {}
    for hard in cases():
        if hard.section != AT_ONCE:
            kinds.setdefault(max((words for words in SOURCES if words in hard.name), key=len), []).append(hard)
    lines = [
        "| cases | mechanism | difficulty | coordinates | constraint equations | duration, s | reference |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind, own in kinds.items():
        made = [hard.make() for hard in own]
        systems = [CompiledMechanism(case.mechanism).system for case in made]
        names = [hard.name for hard in own if hard.gap is None] + [f"{kind} +, -"] * any(hard.gap for hard in own)
        columns = (
            [str(s.n) for s in systems],
            [str(s.m) for s in systems],
            [f"{case.stop_time:.3g}" for case in made],
            ["maximal coordinates" if case.exact is None else "hand-derived" for case in made],
        )
        cells = [", ".join(dict.fromkeys(column)) for column in columns]
        lines.append(f"| {'; '.join(names)} | {' | '.join((*SOURCES[kind], *cells))} |")
    return "\n".join(lines)


def machine() -> str:
    """Date, version and processor of the measurement."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    processor = names[0] if names else platform.machine()
    return f"Measured on {date.today():%Y-%m-%d} with mbfmu {mb.__version__}, one core of {processor}."


def draw(rows: list[Run]) -> None:
    """Error against gap of both four-bars, a panel a solver."""
    solvers = tuple(dict.fromkeys(r.solver for r in rows))
    figure, axes = plt.subplots(1, len(solvers), figsize=(12.0, 4.0), sharey=True, layout="constrained")
    for axis, solver in zip(axes, solvers, strict=True):
        for k, rtol in enumerate(TOLERANCES):
            chosen = [r for r in rows if r.solver == solver and r.rtol == rtol and r.verdict.word == "right"]
            for mark, kind in (("o", "parallelogram"), ("s", "grashof")):
                alike = [r for r in chosen if r.name.startswith(kind)]
                gaps = [abs(r.gap or np.nan) for r in alike]
                errors = [r.verdict.error for r in alike]
                axis.loglog(
                    gaps,
                    errors,
                    mark,
                    ms=4,
                    color=f"C{k}",
                    label=f"tolerance {format_tolerance(rtol)}" if mark == "o" else None,
                )
        axis.set_title(solver)
        axis.set_xlabel("gap [m]")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("largest error [rad]")
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
    print(counted_by_solver(rows))
    if options.cases or options.solvers:
        return
    draw([r for r in rows if r.gap])
    by_section = {s: [r for r in rows if r.section == s] for s in (LOOPS, WITHOUT_LOOPS, AT_ONCE, MISSES)}
    *first, last = map(str, LOOPS_AT_ONCE)
    at_once = AT_ONCE.format(counts=f"{', '.join(first)} and {last}")
    parts = [
        f"{INTRODUCTION}\n\n## Counts\n\n{machine()}\n\n{counted_by_solver(rows)}\n",
        f"## Mechanisms\n\n{described()}\n",
        f"{LOOPS}\n\n{table(by_section[LOOPS])}\n",
        f"{WITHOUT_LOOPS}\n\n{table(by_section[WITHOUT_LOOPS])}\n",
        f"{at_once}\n\n{families(by_section[AT_ONCE])}\n",
        f"{MISSES}\n\n{table(by_section[MISSES])}\n",
    ]
    PAGE.write_text("\n".join(parts))


if __name__ == "__main__":
    main()
