"""Times that can be compared on a busy machine."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable


def median_times(*functions: Callable[[], object], repeats: int = 15) -> list[float]:
    """Return the median CPU time of each, s, run in turn, after one run of each that is not counted."""
    times: list[list[float]] = [[] for _ in functions]
    for i in range(repeats + 1):
        for own, function in zip(times, functions, strict=True):
            begin = time.process_time()
            function()
            if i:
                own.append(time.process_time() - begin)
    return [statistics.median(own) for own in times]
