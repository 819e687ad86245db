"""References of random loops, stored: a minute of CI instead of ten.

    python tests/loops/stored.py --seeds 0:320 --cache DIR

writes them again, after what draws mechanisms has changed. They depend on this directory's formulation alone.
"""

from __future__ import annotations

import argparse
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

from campaign import POINTS, Task, known  # noqa: E402
from judge import Truth  # noqa: E402
from random_loops import draw  # noqa: E402

FILE = HERE / "data" / "random_loops.npz"
FIELDS = ("q", "v", "amplification", "doubt", "q0", "v0")


def load() -> dict[int, Truth]:
    """The references by seed, each of the whole motion of ``draw(seed)``."""
    found = {}
    with np.load(FILE) as stored:
        for seed in stored["seeds"]:
            q, v, amplification, doubt, q0, v0 = (stored[f"{seed}.{name}"] for name in FIELDS)
            times = np.linspace(0.0, draw(int(seed)).case.stop_time, POINTS)[: len(q)]
            found[int(seed)] = Truth(times, q, v, amplification, doubt, (q0, v0), "", 0.0)
    return found


def compute(task: Task) -> Truth | None:
    """The reference of a seed; None where there is none: what cannot be assembled, or ends at once."""
    try:
        found = known(task)
    except (ArithmeticError, ValueError, LookupError):
        return None
    return found if len(found.times) > 1 else None


def main() -> None:
    """Write the file."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seeds", default="0:320", help="first:last")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--cache", type=Path, help="directory for references")
    options = parser.parse_args()
    seeds = range(*map(int, options.seeds.split(":")))
    arrays: dict[str, Any] = {}
    with ProcessPoolExecutor(options.processes) as pool:
        tasks = [Task(seed, None, (), (), options.cache) for seed in seeds]
        for seed, truth in zip(seeds, pool.map(compute, tasks), strict=True):
            if truth is not None:
                values = truth.q, truth.v, truth.amplification, truth.doubt, *truth.start
                arrays |= {f"{seed}.{name}": value for name, value in zip(FIELDS, values, strict=True)}
    stored = sorted({int(key.split(".")[0]) for key in arrays})
    FILE.parent.mkdir(exist_ok=True)
    np.savez_compressed(FILE, seeds=np.array(stored), **arrays)
    print(f"{len(stored)} of {len(seeds)} seeds in {FILE}, {FILE.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
