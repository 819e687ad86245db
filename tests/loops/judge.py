"""One mechanism, one solver, one tolerance: right, stopped or wrong.

**Right** is a run within  c rtol A(t)  of the truth. A(t) is the growth of errors in this motion: the deviation of the
truth per unit of error if every step has a small random error. If c rtol A(t) becomes large, positions are no longer
compared, but loops must stay closed, and a motion without drives and damping must keep its energy.

rtol is the requested tolerance, or a larger one that the solver reports to have used.

**Refused** is a run that stops with a message, and was right until then. Anything else is **wrong**: a raw error of an
array library too.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from linecache import getline
from pathlib import Path
from traceback import walk_tb
from typing import Any

import numpy as np
from reference import RESOLUTION, distance, integrate
from ties import cut_ties
from tree import forward, units

import mbfmu
import solvers
from mbfmu.mechanics import CompiledMechanism, JointForce, JointSpring, LineForce, Mechanism, PointForce, Spring, Torque
from mbfmu.util.errors import UserError
from solvers import Options, stepper

FACTOR = 100.0  # c: errors of a right run, in rtol and amplifications
LIMIT = 0.1  # of a length of the mechanism or rad: up to here positions are compared
OPEN = 1e-4  # of a length of the mechanism, or rad: a loop that gapes so far is open
LOST = 0.02  # of the largest kinetic energy: so much may be lost where positions are no longer compared
NUDGE = 1e-7  # error of every step of the runs that measure the growth of errors


@dataclass(frozen=True)
class Truth:
    """The motion to compare with.

    Attributes
    ----------
    times, q
        (k,) s, (k, nq) in the compiled mechanism's order; fewer than requested where the reference ended.
    v
        (k, n).
    amplification
        (k,) what errors of one in every step have grown to, at least one, never falling.
    doubt
        (k,) difference of two runs of the reference, in the mechanism's lengths and rad.
    start
        (q, v) as the compiled mechanism assembles.
    ended
        Why the reference ended early; empty: it did not.
    seconds
        What it took.
    """

    times: Any
    q: Any
    v: Any
    amplification: Any
    doubt: Any
    start: tuple[Any, Any]
    ended: str
    seconds: float


@dataclass(frozen=True)
class Verdict:
    """What became of a run.

    Attributes
    ----------
    word
        ``right``, ``stopped`` or ``wrong``.
    why
        Of a refusal its message, of what is wrong what is.
    error
        Largest error while positions are compared, lengths of the mechanism or rad.
    ratio
        The largest part of  rtol A(t)  that it was.
    energy
        Largest error of the energy over all times, by the largest kinetic energy.
    until
        Up to when positions were compared, s.
    evaluations, seconds
        What the run took.
    rtol
        Tolerance with which the run was compared; larger than the requested one if the solver has reported so.
    """

    word: str
    why: str = ""
    error: float = np.nan
    ratio: float = np.nan
    energy: float = np.nan
    until: float = 0.0
    evaluations: int = 0
    seconds: float = 0.0
    rtol: float = np.nan

    def __str__(self) -> str:
        return (
            f"{self.word:8s} error {self.error:.1e} = {self.ratio:.1e} rtol A, energy {self.energy:.1e}, judged until "
            f"{self.until:.4g} s, {self.evaluations} evaluations in {self.seconds:.2f} s  {self.why}"
        )


def truth(mechanism: Mechanism, times: Any, exact: Any = None) -> Truth:
    """The truth at ``times`` (k,): the exact motion where it is given, else the reference."""
    begin = time.process_time()
    compiled = CompiledMechanism(mechanism)
    start = compiled.assemble(float(times[0]))
    times = np.asarray(times, float)
    if exact is not None:
        q, v = exact(times)
        moved = [exact(times, nudge)[0] for nudge in (NUDGE, -NUDGE)]
        doubt, ended = np.full(len(times), 1e-11), ""
        near = q
    else:
        best = integrate(mechanism, times, start, tolerance=1e-11)
        loose = {"tolerance": 1e-9, "resolution": 0.5 * RESOLUTION}
        other = integrate(mechanism, best.times, start, **loose)
        k = len(other.times)
        q, v, near, ended, times = best.q[:k], best.v[:k], other.q, best.ended or other.ended, best.times[:k]
        doubt = distance(mechanism, start[1], q, near)
        moved = [integrate(mechanism, times, start, **loose, nudge=NUDGE).q]
    grown = np.ones(len(times))
    for there in moved:
        k = len(there)
        grown[:k] = np.maximum(grown[:k], distance(mechanism, start[1], near[:k], there) / NUDGE)
    return Truth(times, q, v, np.maximum.accumulate(grown), doubt, start, ended, time.process_time() - begin)


def judge(
    mechanism: Mechanism,
    known: Truth,
    solver: str,
    rtol: float,
    *,
    factor: float = FACTOR,
    max_steps: int = 20_000,
    restart: float | None = None,
) -> Verdict:
    """Run a solver at a tolerance from the truth's start to its end, and compare the result with the truth.

    At the time ``restart`` (s), one of the truth's, the solver restarts, as it does after a jump of an input.
    """
    begin = time.process_time()
    compiled = CompiledMechanism(mechanism)
    k = len(known.times)
    q, v = np.full((k, known.q.shape[1]), np.nan), np.full((k, known.v.shape[1]), np.nan)
    q[0], v[0], done, why, evaluations = *known.start, 1, "", 0
    used = rtol
    try:
        options = Options(rtol=rtol, max_steps=max_steps)
        motion = stepper(solver, compiled.system, float(known.times[0]), *known.start, options)
        for i in range(1, k):
            rows = motion.sample(known.times[i : i + 1])
            if len(rows.q) == 0:
                why = motion.status.message
                assert why, "stopped without a message"
                break
            q[i], v[i], done = rows.q[0], rows.v[0], i + 1
            if known.times[i] == restart:
                motion.restart()
        used = max(rtol * motion.statistics.coarser, motion.min_rtol)
        evaluations = motion.statistics.rhs_evals
    except (ArithmeticError, LookupError, MemoryError, TypeError, ValueError, AssertionError) as error:
        if not meant(error):
            return Verdict("wrong", f"raw {type(error).__name__}: {error}")
        why = str(error)
    seconds = time.process_time() - begin
    return _weigh(mechanism, compiled, known, q[:done], v[:done], used, factor, why, evaluations, seconds)


def meant(error: Exception) -> bool:
    """Whether an error is a sentence of the package's own: raised by it, and not by what it calls."""
    if isinstance(error, UserError):
        return True
    frame, line = list(walk_tb(error.__traceback__))[-1]
    origin = frame.f_code.co_filename
    ours = any(Path(origin).is_relative_to(Path(str(package.__file__)).parent) for package in (mbfmu, solvers))
    return ours and getline(origin, line).strip().startswith("raise")


def _weigh(
    mechanism: Mechanism,
    compiled: Any,
    known: Truth,
    q: Any,
    v: Any,
    rtol: float,
    factor: float,
    why: str,
    evaluations: int,
    seconds: float,
) -> Verdict:
    """Compare the k rows a run has given."""
    k = len(q)
    times, amplification = known.times[:k], known.amplification[:k]
    off = distance(mechanism, known.start[1], q, known.q[:k])
    bound = factor * rtol * amplification + 10.0 * known.doubt[:k]
    judged = np.logical_and.accumulate(bound <= LIMIT)
    last = int(np.sum(judged))
    error = float(off[:last].max(initial=0.0))
    ratio = float((off / (rtol * amplification))[:last].max(initial=0.0))
    lost = energy_error(mechanism, compiled, known, q, v)
    gaping = max(opening(mechanism, float(t), a, known.start[1]) for t, a in zip(times[::-4], q[::-4], strict=True))
    faults = []
    late = np.flatnonzero(~(off <= bound) & judged)
    if len(late):
        i = late[0]
        faults.append(f"off by {off[i]:.1e} where {bound[i]:.1e} is allowed at t = {times[i]:.4g} s")
    if not gaping <= max(OPEN, rtol):
        faults.append(f"a loop gapes by {gaping:.1e}")
    if conservative(mechanism) and not lost.max(initial=0.0) <= max(LOST, factor * rtol):
        i = int(np.argmax(lost > max(LOST, factor * rtol)))
        faults.append(f"energy off by {lost.max():.1e}, from t = {times[i]:.4g} s on")
    word = "wrong" if faults else "stopped" if why else "right"
    until = float(times[last - 1]) if last else float(times[0])
    return Verdict(
        word,
        "; ".join([*faults, why] if why else faults),
        error,
        ratio,
        float(lost.max()),
        until,
        evaluations,
        seconds,
        rtol,
    )


def energy_error(mechanism: Mechanism, compiled: Any, known: Truth, q: Any, v: Any) -> Any:
    """Error of the energy (k,) by the largest kinetic energy of the truth; only while it is compared if driven."""
    k, zero = len(known.times), 0.0 * known.start[1]
    true = np.array([compiled.energy(t, a, b) for t, a, b in zip(known.times, known.q, known.v, strict=True)])
    rest = np.array([compiled.energy(t, a, zero) for t, a in zip(known.times, known.q, strict=True)])
    own = np.array([compiled.energy(t, a, b) for t, a, b in zip(known.times[: len(q)], q, v, strict=True)])
    largest = float(np.max(true - rest)) if k else 0.0
    return np.abs(own - true[: len(q)]) / max(largest, 1e-300)


def conservative(mechanism: Mechanism) -> bool:
    """Whether the mechanism keeps its energy."""
    if any(b.joint.drive is not None for b in mechanism.bodies):
        return False
    for _, force, _, _ in mechanism.forces:
        if isinstance(force, JointForce | LineForce | PointForce | Torque):
            return False
        if isinstance(force, Spring | JointSpring) and force.damping != 0.0:
            return False
    return True


def opening(mechanism: Mechanism, t: float, q: Any, v0: Any) -> float:
    """How far the worst cut joint is from closed: in lengths of the mechanism, or rad."""
    poses, L, worst = forward(mechanism, t, q, 0.0 * v0), units(mechanism, v0).length, 0.0
    for tie in cut_ties(mechanism):
        A, B = poses[tie.a], poses[tie.b]
        if tie.kind == "hinge":
            off = np.linalg.norm(np.cross(A.R @ tie.pa, B.R @ tie.pb))
        elif tie.kind == "lock":
            off = np.linalg.norm(A.R @ tie.pa - B.R @ tie.pb)
        elif tie.kind == "slide":
            e, at = tie.pa
            off = abs((A.R @ e) @ (B.o + B.R @ tie.pb - A.o - A.R @ at)) / L
        else:
            off = abs(np.linalg.norm(B.o + B.R @ tie.pb - A.o - A.R @ tie.pa) - tie.length) / L
        worst = max(worst, float(off))
    return worst
