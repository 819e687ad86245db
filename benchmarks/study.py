"""What a study adds to its runs: time over that of the runs alone, memory, and a cluster started by hand.

python benchmarks/study.py [RUNS]
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

import mbfmu as mb
from mbfmu.util.processes import count_processors

RUNS = 10_000
VARIED = {"crank_length": "1 m +- 5 mm", "crank_mass": "8.019 kg +- 1 %"}
MEASURED = {"fastest": "largest crank.rate"}


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[str]:
    """Start a scheduler and workers as separate processes; yield the address."""
    told, dask = folder / "scheduler.json", [sys.executable, "-m", "dask"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder}
    started = [
        subprocess.Popen([*dask, "scheduler", "--port", "0", "--scheduler-file", str(told), "--no-dashboard"], **quiet)
    ]
    worker = [*dask, "worker", "--scheduler-file", str(told), "--nthreads", "1", "--no-dashboard"]
    started += [subprocess.Popen(worker, **quiet) for _ in range(workers)]
    try:
        while not told.exists():
            time.sleep(0.1)
        yield json.loads(told.read_text())["address"]
    finally:
        for process in reversed(started):
            process.terminate()
            process.wait()


class Memory:
    """Largest memory of this process and of those below it, MB, from time to time."""

    def __init__(self) -> None:
        self.seen: list[float] = []
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    def _watch(self) -> None:
        while not self._ends.wait(1.0):
            own = psutil.Process()
            with psutil_gone():
                self.seen.append(sum(p.memory_info().rss for p in (own, *own.children(recursive=True))) / 1e6)

    def end(self) -> None:
        """Stop looking."""
        self._ends.set()
        self._thread.join()


@contextmanager
def psutil_gone() -> Iterator[None]:
    """Ignore processes that end while they are looked at."""
    try:
        yield
    except psutil.NoSuchProcess:
        pass


def measure(name: str, runs: int, folder: Path, scheduler: str = "") -> None:
    """Make the study and print what it cost."""
    memory = Memory()
    study = mb.study(
        "fourbar", VARIED, MEASURED, count=runs, fixed={"solver": "adams", "tolerance": 1e-6}, folder=folder,
        scheduler=scheduler,
    )  # fmt: skip
    memory.end()
    ideal = study.summed_time / count_processors()
    third = len(memory.seen) // 3
    print(
        f"{name}: {study!r}, {study.wall_time:.1f} s; runs {study.summed_time:.1f} s of CPU time, "
        f"{1e3 * study.summed_time / runs:.2f} ms each; {study.wall_time / ideal:.2f} times the ideal; "
        f"memory {memory.seen[third]:.0f} MB after a third, {memory.seen[-2]:.0f} at the end"
    )


def main() -> None:
    """Measure a pool, and a cluster."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else RUNS
    with tempfile.TemporaryDirectory() as place:
        measure("pool", runs, Path(place) / "pool")
        with cluster(Path(place), count_processors()) as address:
            measure("cluster", runs, Path(place) / "cluster", address)


if __name__ == "__main__":
    main()
