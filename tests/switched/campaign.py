"""Compare random mechanisms with friction, stops and events with SciPy, count the verdicts and print what is not right.

    python -m tests.switched.campaign --seeds 0:300

Even seeds have soft bristles, whose law the reference integrates: the allowed error is ERROR_FACTOR times tolerance
times sensitivity. Odd seeds have stiff bristles, and the reference is set-valued friction with exact stick: the allowed
error contains that of the bristle, by its stiffness (see :func:`allowance`).

A motion is compared until the allowed error exceeds LOST_PART of the range of an output, or a change of the start by
NUDGE gives other events. If this is before COMPARED_PART of the time, the case is excluded. Both follow from the
reference alone.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

import mbfmu as mb
from mbfmu.fmi import export
from mbfmu.util.errors import UserError

from . import absolute
from .drawn import SPHERICAL, Drawn, draw
from .models import DrawnModel
from .switching import BRISTLE, SET_VALUED, Motion, Run, Unresolved
from .tree import finish

POINTS = 41
TOLERANCE = {BRISTLE: 1e-8, SET_VALUED: 1e-7}
SOLVERS = ("radau", "ida", "auto", "adams", "hybrid")
IMPLICIT = ("radau", "ida", "auto")
ERROR_FACTOR, LOST_PART, COMPARED_PART = 100.0, 0.1, 0.5
NUDGE, NUDGES = 1e-6, 2
SMALLEST_RANGE = 0.1  # of an output that hardly moves, in its unit
KICKS, STOPS = 3.0, 5.0  # factors of the errors of a bristle: of rates and of positions
FINER, FINER_ERROR = 0.1, 0.5  # deflection, and error that is due to it: in proportion to its square root
SAME_TIME = 1e-12  # difference of times of outputs, of the stop time
RIGHT, REFUSED, WARNED, WRONG, EXCLUDED = "right", "refused", "warned", "WRONG", "excluded"


class Row(NamedTuple):
    """What became of one seed."""

    seed: int
    law: int
    solver: str
    verdict: str
    ratio: float  # of error and allowed error
    until: float  # part of the time that is compared
    joints: int
    events: int
    text: str
    seconds: float


class Truth(NamedTuple):
    """Reference with the errors that are allowed."""

    motion: Motion
    allowed: Any  # (k, m)
    allowed_times: Any  # (e,), of the events
    until: float


def units(d: Drawn) -> Any:
    """Units (m,) of the outputs."""
    sizes = []
    for k, p in enumerate(d.parts):
        sizes.extend([d.length] * 3 if p.kind == SPHERICAL else [d.unit(k)] * len(p.start))
    return np.array(sizes)


def nudged(d: Drawn, rng: np.random.Generator) -> Drawn:
    """Return the mechanism with another start; driven joints keep theirs."""
    other = deepcopy(d)
    for k, p in enumerate(other.parts):
        if p.kind != SPHERICAL:
            p.start = p.start + NUDGE * d.unit(k) * rng.normal(size=len(p.start))
        p.rate = p.rate + NUDGE * d.unit(k) / d.time * rng.normal(size=len(p.rate))
    return other


def allowance(d: Drawn, law: int, tolerance: float, runs: int = NUDGES, rtol: float = 1e-10) -> Truth:
    """Integrate a reference, and ``runs`` times with other starts and, if it is set-valued, with what bristles do.

    A bristle stores an energy that changes the rate after each change of the direction of friction by up to
    sqrt(8 F d / m), and yields before a joint breaks away, with an effect of the same size. Joints stop several
    deflections from the place. Where this is exceeded, :func:`judge` examines whether the error decreases with the
    deflection. With runs = 0 the errors do not grow with time.
    """
    rng = np.random.default_rng(d.seed)
    base = Run(d, law, rtol).motion(POINTS)
    size = units(d)
    starts = [Run(nudged(d, rng), law, 10.0 * rtol).motion(POINTS) for _ in range(runs)]
    sensitivity = np.max([np.zeros_like(base.values), *(difference(m, base) for m in starts)], axis=0) / NUDGE
    early = np.max([np.zeros(len(base.events)), *(time_differences(m, base, d) for m in starts)], axis=0) / NUDGE
    allowed = ERROR_FACTOR * tolerance * (sensitivity + size)
    allowed_times = ERROR_FACTOR * tolerance * (early + d.time)
    others = list(starts)
    if law == SET_VALUED:
        soft = [Run(d, law, 10.0 * rtol, kick=rng).motion(POINTS) for _ in range(max(runs, 1))]
        deflection = max([f.deflection / d.unit(f.part) for f in d.frictions], default=0.0)
        stops = STOPS * deflection * (1.0 + len(base.switches))
        allowed = allowed + KICKS * np.max([difference(m, base) for m in soft], axis=0) + stops * size
        allowed_times = (
            allowed_times + KICKS * np.max([time_differences(m, base, d) for m in soft], axis=0) + stops * d.time
        )
        others += soft
    until = min([base.rests, base.ended, d.stop_time, *(same_until(m, base) for m in others)])
    extent = np.maximum(np.ptp(base.values[base.times <= until], axis=0), SMALLEST_RANGE * size)
    lost = np.flatnonzero(~(allowed <= LOST_PART * extent).all(axis=1))
    if len(lost):
        until = min(until, float(base.times[lost[0]]))
    return Truth(base, allowed, allowed_times, until)


def difference(one: Motion, other: Motion) -> Any:
    """Largest difference (k, m) of outputs until each time."""
    return np.maximum.accumulate(np.nan_to_num(np.abs(one.values - other.values), nan=np.inf), axis=0)


def time_differences(one: Motion, other: Motion, d: Drawn) -> Any:
    """Largest difference (e,) of the times of the first events."""
    found = np.full(len(other.events), d.time)
    for k, (a, b) in enumerate(zip(one.events, other.events, strict=False)):
        found[k] = abs(a[1] - b[1])
    return np.maximum.accumulate(found) if len(found) else found


def same_until(one: Motion, other: Motion) -> float:
    """Time until which two motions have the same events."""
    for a, b in zip(one.events, other.events, strict=False):
        if a[0] != b[0]:
            return min(a[1], b[1])
    count = min(len(one.events), len(other.events))
    longer = one.events[count:] or other.events[count:]
    end = min(one.rests, other.rests)
    return min(longer[0][1], end) if longer else end


def solver_of(d: Drawn) -> str:
    """Solver of a seed."""
    if not d.frictions:
        return SOLVERS[d.seed // 2 % len(SOLVERS)]
    return (SOLVERS if d.has_bristles else IMPLICIT)[d.seed // 2 % (len(SOLVERS) if d.has_bristles else len(IMPLICIT))]


def judge(seed: int, solver: str | None = None, native: bool = False) -> Row:
    """Compare one mechanism, simulated in Python or as a native FMU."""
    begin = time.perf_counter()
    d = finish(draw(seed))
    law = BRISTLE if d.has_bristles else SET_VALUED
    solver = solver or solver_of(d)
    tolerance = TOLERANCE[law]

    def row(verdict: str, text: str, ratio: float = 0.0, until: float = 0.0, events: int = 0) -> Row:
        seconds = time.perf_counter() - begin
        return Row(seed, law, solver, verdict, ratio, until, len(d.parts), events, text, seconds)

    try:
        truth = allowance(d, law, tolerance)
    except Unresolved as why:
        return row(EXCLUDED, f"reference: {why}")
    base = truth.motion
    wanted = min(d.stop_time, base.ended, base.rests)
    part = truth.until / wanted
    if part < COMPARED_PART:
        return row(EXCLUDED, "sensitive", until=part)
    try:
        result = (simulate_fmu if native else simulate)(d, solver, tolerance)
    except UserError as refusal:
        return row(REFUSED, str(refusal))
    except Exception as error:  # an error without a message for the user is wrong, whatever it is
        return row(WRONG, f"{type(error).__name__}: {error}")
    ratio, text = compare(d, truth, result)
    if law == SET_VALUED and 1.0 < ratio < np.inf:
        finer = [replace(f, deflection=FINER * f.deflection) for f in d.frictions]
        less, _ = compare(d, truth, other := simulate(replace(d, frictions=finer), solver, FINER * tolerance))
        if less <= FINER_ERROR * ratio and len(other.t) == len(result.t):
            text = f"error of the bristle, {less / ratio:.2f} times as large with {FINER} times the deflection: {text}"
            return row(RIGHT, text, ratio, part, len(base.events))
    counts = sum(t <= truth.until for _, t in base.events)
    messages = [str(m) for m in result.diagnostics if m.severity != "note"]
    if ratio > 1.0:
        return row(WARNED if messages else WRONG, "; ".join([text, *messages]), ratio, part, counts)
    reached = result.t[-1] >= truth.until - 1e-9 * d.stop_time or "resting-bounce" in result.failure
    if "resting-bounce" in result.failure and not np.isfinite(base.rests):
        return row(WRONG, f"rests, the reference does not; {messages}", ratio, part, counts)
    if not reached:
        return row(REFUSED, "; ".join(messages), ratio, part, counts)
    return row(RIGHT, "; ".join(messages), ratio, part, counts)


def simulate(d: Drawn, solver: str, tolerance: float) -> Any:
    """Simulate a mechanism with mbfmu."""
    interval = d.stop_time / (POINTS - 1)
    return mb.simulate(DrawnModel(drawn=d), d.stop_time, interval=interval, solver=solver, tolerance=tolerance)


class FmuResult(NamedTuple):
    """Outputs of an FMU, which does not list its events."""

    t: Any
    values: Any
    events: None = None
    diagnostics: tuple[Any, ...] = ()
    failure: str = ""


def simulate_fmu(d: Drawn, solver: str, tolerance: float) -> FmuResult:
    """Simulate a mechanism by a native FMU in co-simulation, with FMPy."""
    import fmpy

    with TemporaryDirectory() as folder:
        settings = mb.Settings(solver=solver, tolerance=tolerance)
        path = export(DrawnModel(drawn=d), Path(folder) / "drawn.fmu", settings, stop_time=d.stop_time, native=True)
        found = fmpy.simulate_fmu(str(path), stop_time=d.stop_time, output_interval=d.stop_time / (POINTS - 1))
    names = [name for name in found.dtype.names if name.startswith("body")]
    return FmuResult(found["time"], np.column_stack([found[name] for name in names]))


def compare(d: Drawn, truth: Truth, result: Any) -> tuple[float, str]:
    """Return the largest ratio of an error and what is allowed, and where it is."""
    base, worst, text = truth.motion, 0.0, ""
    at = [
        k
        for k in range(min(len(result.t), POINTS))
        if base.times[k] <= truth.until and abs(result.t[k] - base.times[k]) <= SAME_TIME * d.stop_time
    ]
    columns = base.values.shape[1]
    if at:
        error = np.abs(result.values[at, :columns] - base.values[at])
        ratios = np.where(np.isfinite(error), error / truth.allowed[at], np.inf)
        k, c = np.unravel_index(int(np.argmax(ratios)), ratios.shape)
        worst, text = float(ratios[k, c]), f"output {c} at t = {base.times[at[k]]:.6g} of {d.stop_time:.6g} s"
        text += f" is {result.values[at[k], c]:.9g}, expected {base.values[at[k], c]:.9g}"
    margin = max(truth.allowed_times, default=0.0)
    if result.events is None:
        return worst, text
    expected = [e for e in base.events if e[1] < truth.until - margin]
    found = [(e.name, e.time) for e in result.events]
    for k, (name, t) in enumerate(expected):
        if t > result.t[-1]:
            break
        if k >= len(found) or found[k][0] != name:
            return np.inf, f"event {name} at {t:.9g} s is {found[k] if k < len(found) else 'missing'}"
        ratio = abs(found[k][1] - t) / truth.allowed_times[k]
        if ratio > worst:
            worst, text = float(ratio), f"event {name} at {t:.9g} s is at {found[k][1]:.9g} s"
    if len(found) > len(base.events) and found[len(base.events)][1] < truth.until - margin:
        return np.inf, f"event {found[len(base.events)]} does not occur"
    return worst, text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0:300", help="first:last, or first:last:step")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--solver", help="solver of all seeds")
    parser.add_argument("--native", action="store_true", help="simulate by native FMUs")
    options = parser.parse_args()
    absolute.compile_equations()
    seeds = range(*(int(s) for s in options.seeds.split(":")))
    count: Counter[tuple[int, str]] = Counter()
    with ProcessPoolExecutor(options.workers) as pool:
        for row in pool.map(judge, seeds, [options.solver] * len(seeds), [options.native] * len(seeds)):
            count[row.law, row.verdict] += 1
            print(
                f"{row.seed:4d} {'bristle   ' if row.law == BRISTLE else 'set-valued'} {row.solver:7s} {row.verdict:8s}"
                f" {row.ratio:8.2g} {row.until:5.2f} {row.joints} {row.events:3d} {row.seconds:6.1f} s  {row.text}",
                flush=True,
            )
    for law, name in ((BRISTLE, "bristle"), (SET_VALUED, "set-valued")):
        kinds = ", ".join(f"{count[law, v]} {v}" for v in (RIGHT, REFUSED, WARNED, WRONG, EXCLUDED))
        print(f"{name}: {sum(count[law, v] for v in (RIGHT, REFUSED, WARNED, WRONG, EXCLUDED))} tried, {kinds}")


if __name__ == "__main__":
    main()
