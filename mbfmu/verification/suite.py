"""All problems of the suite, and their run."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from fnmatch import fnmatch

from mbfmu.util.errors import UserError, suggest
from mbfmu.util.text_table import format_count

from .problem import Problem
from .problems import (
    bicycle,
    flexible_bodies,
    friction,
    pendulums,
    planar_loops,
    published,
    rotors,
    sheets,
    shells,
    spatial_beams,
    spatial_loops,
    steady,
)
from .verdict import RIGHT, WRONG, Line, check, methods_of

PROBLEMS: tuple[Problem, ...] = (
    *pendulums.PENDULUM_PROBLEMS,
    *rotors.ROTOR_PROBLEMS,
    *planar_loops.PLANAR_LOOP_PROBLEMS,
    *spatial_loops.SPATIAL_LOOP_PROBLEMS,
    *published.PUBLISHED_PROBLEMS,
    *bicycle.BICYCLE_PROBLEMS,
    *friction.FRICTION_PROBLEMS,
    *steady.STEADY_STATE_PROBLEMS,
    *spatial_beams.SPATIAL_BEAM_PROBLEMS,
    *flexible_bodies.FLEXIBLE_PROBLEMS,
    *shells.SHELL_PROBLEMS,
    *sheets.SHEET_PROBLEMS,
)
TOLERANCES, QUICK_TOLERANCES = (1e-6, 1e-8), (1e-6,)
NOT_COVERED = (
    "Convergence of shells with the mesh, and motions of sheets: `benchmarks/shells.py` and tests.",
    "Roller nips, guides and drums other than the capstan: `benchmarks/transport.py` compares them with the elastica.",
    "Flexible bodies from meshes (tests), motions of beams in three dimensions, and of free beams that bend far, such "
    "as the flexible pendulum.",
    "The wheelset of the IVP test set: its wheels are surfaces of revolution that roll with creep forces on profiled "
    "rails, and such a contact does not exist here.",
    "Circular motions of the bicycle: only its straight motion is compared with published numbers.",
    "Stops with elastic contact (`docs/hard_cases.md`), and locks, releases and impulses of events (tests).",
    "Native FMUs: the tests compare them bit by bit with simulations in Python.",
    "Motions with loops in other engines: `benchmarks/peers.py` compares their errors and computing times.",
    "Computing times: they are measured, but no verdict depends on them.",
)


def select(only: Sequence[str] = (), *, quick: bool = False) -> list[Problem]:
    """Return the problems whose names match.

    Parameters
    ----------
    only
        Names, patterns with ``*`` or beginnings of names; empty: all.
    quick
        Whether only problems that need little time are returned.

    Raises
    ------
    UserError
        No problem matches one of the names.
    """
    known = [problem.name for problem in PROBLEMS]
    for name in only:
        if not name:
            raise UserError("the name of a problem is empty; allowed: the beginning of a name, or '*' for all")
        if not any(is_named(problem, name) for problem in PROBLEMS):
            raise UserError(f"there is no problem {name!r}{suggest(name, known)}")
    chosen = [p for p in PROBLEMS if not only or any(is_named(p, name) for name in only)]
    return [p for p in chosen if p.is_quick or not quick]


def is_named(problem: Problem, name: str) -> bool:
    """Return whether a name, a pattern or the beginning of a name selects a problem."""
    return fnmatch(problem.name.lower(), name.lower()) or problem.name.lower().startswith(name.lower())


def verify(
    problems: Sequence[Problem],
    *,
    solvers: Sequence[str] = (),
    tolerances: Sequence[float] = TOLERANCES,
    progress: Callable[[str, float], None] | None = None,
) -> Iterator[Line]:
    """Run problems; yield a line for each problem, solver and tolerance.

    Parameters
    ----------
    problems
        Problems, see :func:`select`.
    solvers
        Names of solvers; empty: all that accept the problem.
    tolerances
        Tolerances of the simulations.
    progress
        Called with the name of a problem and the part (0 to 1) of the suite that was finished by it.
    """
    for problem in problems:
        methods = methods_of(problem, solvers)
        yield from check(problem, methods, tolerances)
        if progress is not None:
            progress(problem.name, 1.0 / len(problems))


def has_wrong(lines: Sequence[Line]) -> bool:
    """Return whether a result is wrong without a warning."""
    return any(line.verdict == WRONG for line in lines)


def summarize(lines: Sequence[Line]) -> str:
    """Return the number of problems, lines and verdicts as one sentence."""
    counts = {word: sum(line.verdict == word for line in lines) for word in (RIGHT, "stopped", "warned", WRONG)}
    problems, results = (
        format_count(len({line.problem for line in lines}), "problem"),
        format_count(len(lines), "result"),
    )
    return f"{problems}, {results}: " + ", ".join(f"{n} {word}" for word, n in counts.items())
