"""Compare solvers with references on many random loops: count right, stopped and wrong runs, print wrong seeds.

    python tests/loops/campaign.py --seeds 0:100 --solvers ida,adams,hybrid --tolerances 1e-6 --cache DIR

With a cache the references are computed once: they depend on this directory's formulation, not on the package.
"""

from __future__ import annotations

import argparse
import hashlib
import pickle
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from traceback import walk_tb
from typing import Any, NamedTuple

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

from judge import Truth, Verdict, judge, truth  # noqa: E402
from mechanisms import parallelogram  # noqa: E402
from random_loops import FAMILIES, draw  # noqa: E402

from mbfmu.util.errors import UserError  # noqa: E402

POINTS = 41  # at which runs are compared
PATIENCE = 120  # s, for one run
SOURCES = sorted(p for p in HERE.glob("*.py") if not p.name.startswith(("campaign", "stored", "test_")))


class Task(NamedTuple):
    """One seed to be compared."""

    seed: int
    family: str | None
    solvers: tuple[str, ...]
    tolerances: tuple[float, ...]
    cache: Path | None


class Row(NamedTuple):
    """What became of one run."""

    seed: int
    family: str
    text: str  # of the mechanism
    solver: str
    rtol: float
    verdict: Verdict


class Late(Exception):
    """A run took too long."""


@contextmanager
def patience(seconds: int) -> Iterator[None]:
    """Raise Late after a time limit (s); a compiled loop is not interrupted before it returns."""

    def ring(*_: Any) -> None:
        raise Late

    before = signal.signal(signal.SIGALRM, ring)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


FINGERPRINT = hashlib.sha256(b"".join(path.read_bytes() for path in SOURCES)).hexdigest()[:12]


def known(task: Task) -> Truth:
    """The truth of a seed, from the cache if it is there."""
    drawn = draw(task.seed, task.family)
    times = np.linspace(0.0, drawn.case.stop_time, POINTS)
    if task.cache is None:
        return truth(drawn.case.mechanism, times, drawn.case.exact)
    file = task.cache / f"{FINGERPRINT}-{drawn.family}-{task.seed}.pickle"
    if not file.exists():
        found = truth(drawn.case.mechanism, times, drawn.case.exact)
        task.cache.mkdir(parents=True, exist_ok=True)
        file.write_bytes(pickle.dumps(found))
    return pickle.loads(file.read_bytes())  # type: ignore[no-any-return]


@cache
def compiled(solvers: tuple[str, ...]) -> None:
    """Have all kernels compiled: an alarm must not ring in the compiler, and its time is not a run's."""
    case = parallelogram()
    found = truth(case.mechanism, np.linspace(0.0, 0.1, 3), case.exact)
    for solver in solvers:
        judge(case.mechanism, found, solver, 1e-4)


def examine(task: Task) -> list[Row]:
    """Compare every solver and tolerance with the reference of one seed."""
    compiled(task.solvers)
    drawn, rows = draw(task.seed, task.family), []
    found: Truth | None = None
    trouble = Verdict("stopped")
    try:
        with patience(10 * PATIENCE):
            found = known(task)
    except UserError as error:
        trouble = Verdict("stopped", f"{error}")
    except (ArithmeticError, ValueError, LookupError) as error:
        places = {Path(frame.f_code.co_filename).name for frame, _ in walk_tb(error.__traceback__)}
        ours = "compiled_mechanism.py" in places
        trouble = Verdict("wrong" if ours else "skipped", f"{type(error).__name__}: {error}")
    except Late:
        trouble = Verdict("skipped", "the reference takes too long")
    for solver in task.solvers:
        for rtol in task.tolerances:
            verdict = trouble
            if found is not None:
                try:
                    with patience(PATIENCE):
                        verdict = judge(drawn.case.mechanism, found, solver, rtol)
                except Late:
                    verdict = Verdict("wrong", f"no answer within {PATIENCE} s")
            rows.append(Row(task.seed, drawn.family, str(drawn), solver, rtol, verdict))
    return rows


def summary(rows: list[Row]) -> str:
    """A table of counts by family, solver and tolerance."""
    keys = sorted({(r.family, r.solver, -r.rtol) for r in rows}) + sorted({("all", r.solver, -r.rtol) for r in rows})
    lines = ["family     solver      rtol  right  stopped  wrong  largest ratio of a right one"]
    for family, solver, minus in keys:
        here = [r.verdict for r in rows if r.solver == solver and -r.rtol == minus and family in ("all", r.family)]
        count = Counter(v.word for v in here)
        ratio = max((v.ratio for v in here if v.word == "right" and np.isfinite(v.ratio)), default=np.nan)
        counts = f"{count['right']:6d} {count['stopped']:8d} {count['wrong']:6d}"
        lines.append(f"{family:10s} {solver:9s} {-minus:6.0e} {counts}  {ratio:.1e}")
    return "\n".join(lines)


def main() -> int:
    """Return 1 where a run was wrong."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", default="0:100", help="first:last, or a list with commas")
    parser.add_argument("--family", choices=list(FAMILIES), help="draw only these")
    parser.add_argument("--solvers", default="ida,adams,hybrid")
    parser.add_argument("--tolerances", default="1e-6")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--cache", type=Path, help="directory for references")
    parser.add_argument("--stopped", action="store_true", help="print what was stopped, too")
    options = parser.parse_args()
    if ":" in options.seeds:
        seeds = range(*map(int, options.seeds.split(":")))
    else:
        seeds = [int(s) for s in options.seeds.split(",")]
    names, tolerances = tuple(options.solvers.split(",")), tuple(float(x) for x in options.tolerances.split(","))
    tasks = [Task(seed, options.family, names, tolerances, options.cache) for seed in seeds]
    begin, rows = time.perf_counter(), []
    shown = ("wrong", "stopped", "skipped") if options.stopped else ("wrong", "skipped")
    with ProcessPoolExecutor(options.processes) as pool:
        for found in pool.map(examine, tasks):
            rows += found
            for row in found:
                if row.verdict.word in shown:
                    print(f"{row.text}\n    {row.solver} {row.rtol:.0e} {row.verdict}", flush=True)
    print(summary(rows))
    print(f"{len(tasks)} seeds in {time.perf_counter() - begin:.0f} s")
    return int(any(row.verdict.word == "wrong" for row in rows))


if __name__ == "__main__":
    sys.exit(main())
