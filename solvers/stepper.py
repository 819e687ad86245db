"""The contract of every solver: options in, states and a status out."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .diagnostics import Diagnostic
from .energy_account import ACCOUNT_SIZE
from .options import Options, Statistics
from .outcome import OK, Code, SolverError, Status
from .system import AnySystem, Array

LIMITED_RTOL = Diagnostic.warning(  # its text is filled by native FMUs too
    "limited-tolerance",
    "The solver uses a tolerance of {used:g} instead of {requested:g}, because rounding errors allow no smaller one",
    "Use 'adams' if this is too large",
)


def advance_in_pieces_of(limit_steps: Any, advance_to: Any) -> Any:
    """Return what advances a run in pieces, in each of which no step may miss a signal; compiled if its actions are.

    Parameters
    ----------
    limit_steps
        (run, t) -> until: limit the length of steps from the reported time t (s) on by what depends on time
        explicitly; return until when the limit holds, s.
    advance_to
        (run, t) -> code: advance to time t, s.

    Returns
    -------
    callable
        (run, reached, t) -> code: advance from the reported time ``reached`` to t, s.
    """

    def advance_in_pieces(run: Any, reached: float, t: float) -> Any:
        code = OK
        while code == OK:
            until = limit_steps(run, reached)
            reached = min(t, until)
            code = advance_to(run, reached)
            if not until < t:
                break
        return code

    return advance_in_pieces


class Samples(NamedTuple):
    """A motion at k times, one row each."""

    q: Array  # (k, nq)
    v: Array  # (k, n)
    a: Array  # (k, n)  accelerations
    lam: Array  # (k, m)  multipliers
    energy_account: Array  # (k, ACCOUNT_SIZE)  as Stepper.energy_account


class Stepper(ABC):
    """Advances one motion of a :class:`System` in time.

    A solver is a subclass with the methods :meth:`advance_to`, :meth:`evaluate`, :meth:`limit_step`, :meth:`restart`,
    :meth:`arrays` and the property :attr:`statistics`. :class:`solvers.OneStepSolver` has all of them for one-step
    methods. The contract:

    1. Construction projects (q0, v0) onto the constraints and evaluates nothing else; wrong sizes raise
       ValueError.
    2. ``t``, ``q``, ``v`` are the reported state: always the last good one, always on the constraints. The
       arrays are copies.
    3. ``advance(t)`` goes to ``t`` and returns a :class:`Status`; it never raises for numerical reasons.
       After a status that is not ok the reported state is the last good one reached, and ``advance`` may be
       called again.
    4. ``advance`` to a time before the reported one raises ValueError; to the same time it does nothing.
    5. After a discontinuity of the equations (an input, a parameter) call ``restart()``: everything that has
       been computed beyond the reported time is discarded and the next step begins at the reported state. If
       the change is one of many and small, as of an input that is set at every communication point, call
       ``continue_after_event()``: the solver keeps the valid part of its history. If the velocities are discontinuous
       as well (an impulse) call ``jump(dv)`` instead, with dv that keeps J v = nu.
    6. ``accelerations()`` are those of the reported state and the present equations, with the minimum-norm
       multipliers; in a singular configuration their limit along the motion. Raises :class:`SolverError` if
       there is none.
    7. ``sample(times)`` is 3 and 6 at each of the times; a state without accelerations ends it, and ``status``
       contains the reason.
       Given an array it writes the outputs of the system at each state into a row of it.
    8. ``energy_account`` has, of the reported state, the work W that drives, dampers and given forces have done since
       construction, the bound of the energy error by the tolerance, the energy that was exchanged, the largest
       kinetic energy, and the bound of one step, now and the largest so far (see :mod:`solvers.energy_account`). No
       meaning if ``options.energy_check`` is off.
    9. ``save()`` returns bytes, ``restore()`` loads them into a stepper of the same system and options.

    Attributes
    ----------
    fallback_solvers
        Names of the solvers to try if this one cannot continue.
    needs_matrices
        Whether it is constructed with a :class:`System` even if the model is large.
    is_explicit
        Whether it is unsuitable for stiff models, which are then refused.
    undetermined_at
        Last time at which forces were requested so near a singular configuration that they are not resolved, s; else
        nan.
    starts_singular
        Whether it was constructed in a singular configuration: rates may differ from those that the loops require near
        it.
    clock
        The reported time in an array (1,), s, as saved last.
    min_rtol
        Smallest tolerance: a smaller ``options.rtol`` is run as this one, with a warning.
    max_steps
        Largest number of steps in one call of :meth:`advance_to`.
    step_limit
        Largest length of the next steps, s, in addition to that of the options.
    """

    fallback_solvers: tuple[str, ...] = ()
    needs_matrices: ClassVar[bool] = False
    is_explicit: ClassVar[bool] = False
    starts_singular: bool = False
    undetermined_at: float = math.nan
    min_rtol: float = 0.0
    step_limit: float = math.inf

    def __init__(self, system: AnySystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        self.options = options or Options()
        self.max_steps = min(self.options.max_steps, np.iinfo(np.int64).max)
        self._t = float(t0)
        self._q = validated_vector("q0", q0, system.nq)
        self._v = validated_vector("v0", v0, system.n)
        self.clock = np.array([self._t])
        self._energy_account = np.zeros(ACCOUNT_SIZE)
        self._sizes = (system.nq, system.n, system.n, system.m, ACCOUNT_SIZE)
        self._input_step_limit, self._observe = system.input_step_limit, system.observe_all
        self.status = self._status(Code.OK)

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Raise: two copies would share one history."""
        raise TypeError("a stepper cannot be copied or pickled: make another of the same system, and restore(save())")

    def _status(self, code: Code) -> Status:
        return Status(code, self._t, self.fallback_solvers)

    @property
    def t(self) -> float:
        """Reported time, s."""
        return self._t

    @property
    def q(self) -> Array:
        """Reported positions (nq,)."""
        return self._q.copy()

    @property
    def v(self) -> Array:
        """Reported velocities (n,)."""
        return self._v.copy()

    @property
    def reported(self) -> tuple[Array, Array, Array]:
        """The arrays of the reported positions, velocities and energy account, which the next step may change or
        replace.
        """
        return self._q, self._v, self._energy_account

    @property
    def freedom(self) -> int:
        """Largest number of degrees of freedom; zero if drives prescribe the motion."""
        return len(self._v)

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Warnings about deviations from the given options, and about errors that are larger than the tolerance."""
        if self.options.rtol >= self.min_rtol:
            return ()
        text = LIMITED_RTOL.text.format(used=self.min_rtol, requested=self.options.rtol)
        return (replace(LIMITED_RTOL, text=text),)

    @property
    def energy_account(self) -> Array:
        """Energy account of the reported state (ACCOUNT_SIZE,), see :func:`solvers.energy_account.fill_account_row`."""
        return self._energy_account.copy()

    def advance(self, t: float) -> Status:
        """Advance to time ``t``, s."""
        if not t >= self._t:
            raise ValueError(f"the time to advance to is {t} s, but it stands at {self._t} s; use restore() to go back")
        if t > self._t or not self.status.ok:
            self.status = self._status(_advance_in_pieces(self, self._t, float(t)))
        return self.status

    def advance_one_step(self, t: float) -> Status:
        """Advance by at most one step of the solver, or to the end of the step in which the reported time lies.

        Parameters
        ----------
        t
            Time that is not passed, later than the reported one, s.

        Returns
        -------
        Status
            As of :meth:`advance`. The reported time is later than before, except after a failure.
        """
        target = min(t, self._limit_steps(self._t))
        end = self.own_time
        if end > self._t:
            code = self.advance_to(min(end, target))
        else:
            code = self._take_one_step(target)
        self.status = self._status(code)
        return self.status

    def _take_one_step(self, t: float) -> Code:
        """Advance towards t (s) until the solver has taken a step."""
        begin, allowed, taken = self._t, self.max_steps, 0
        self.max_steps = 1
        try:
            code = self.advance_to(t)
            while code is Code.MAX_STEPS and not self.own_time > begin and taken < allowed:  # the step was rejected
                taken += 1
                code = self.advance_to(t)
        finally:
            self.max_steps = allowed
        return self.advance_to(self.own_time) if code is Code.MAX_STEPS and self.own_time > begin else code

    def return_to(self, t: float, saved: bytes | None) -> Status:
        """Make an earlier time of the last step of :meth:`advance_one_step` the reported one.

        Parameters
        ----------
        t
            Time, s.
        saved
            What :meth:`save` returned before that step, to repeat it; None: the step has a dense output.

        Returns
        -------
        Status
            Whether the state there is the reported one.
        """
        if saved is not None:
            self.restore(saved)
            return self.advance(t)
        self.status = self._status(self.advance_to(t))
        return self.status

    @property
    def has_dense_output(self) -> bool:
        """Whether any time of the last step, or of the next one if there is none, can be reported again by
        :meth:`advance_to`, without integrating again.
        """
        return False

    @property
    def own_time(self) -> float:
        """Time that the solver has reached itself, s: the reported one, or later."""
        return self._t

    def _limit_steps(self, t: float) -> float:
        """Apply the step-size limit of time-dependent inputs at the reported time t; return when it expires, s."""
        longest, until = self._input_step_limit(t)
        self.limit_step(min(longest, self.options.max_step, self.step_limit))
        return until

    @abstractmethod
    def limit_step(self, longest: float) -> None:
        """Limit the length of all later steps.

        Parameters
        ----------
        longest
            Largest step that resolves what depends on time explicitly, s. It is called before every
            :meth:`advance_to`.
        """

    @abstractmethod
    def advance_to(self, t: float) -> Code:
        """Go to time ``t`` and set the reported state ``_t``, ``_q``, ``_v`` and ``_energy_account``.

        Parameters
        ----------
        t
            Time, later than the reported one, s.

        Returns
        -------
        Code
            ``Code.OK``, or why it has stopped at the last good state, which is the reported one then.
        """

    def accelerations(self) -> tuple[Array, Array]:
        """Return v' (n,) and lambda (m,) of the reported state."""
        code, a, lam = self.evaluate()
        if code is not Code.OK:
            status = self._status(code)
            raise SolverError(status) from status.error
        if self._undetermined():
            self.undetermined_at = self._t
        return a, lam

    def _undetermined(self) -> bool:
        """Whether the forces evaluated last are not resolved."""
        return False

    @abstractmethod
    def evaluate(self) -> tuple[Code, Array, Array]:
        """Return code, v' (n,) and lambda (m,) of the reported state."""

    def sample(self, times: Array, outputs: Array | None = None) -> Samples:
        """:meth:`advance` to each of ``times`` (k,), ascending, and return state and accelerations there.

        The outputs of the system at each state are written into a row of ``outputs`` (k, outputs).

        Ends early if one of the two fails; ``status`` contains the reason.
        """
        times = np.ascontiguousarray(times)  # a column of a table would have another type in the kernels
        if not np.all(np.diff(times, prepend=-np.inf) > 0.0) or np.any(times < self._t):
            raise ValueError(f"times must ascend from {self._t}, where the stepper stands; use restore() to go back")
        out = Samples(*(np.zeros((len(times), size)) for size in self._sizes))
        given = np.zeros((len(times), 0)) if outputs is None else outputs
        outputs = np.ascontiguousarray(given)
        done, goes_on = 0, True
        while goes_on and done < len(times):
            until = self._limit_steps(self._t)
            count = int(np.searchsorted(times[done:], until, side="right"))
            if count:
                rows = slice(done, done + count)
                found = self._sample(times[rows], Samples(*(part[rows] for part in out)), outputs[rows])
                done, goes_on = done + found, found == count
            else:
                goes_on = self.advance(until).ok
        if outputs is not given:
            given[:] = outputs
        return Samples(*(rows[:done] for rows in out))

    def _sample(self, times: Array, out: Samples, outputs: Array) -> int:
        """Fill the rows of ``out`` and ``outputs``, set the reported state and ``status``; return how many rows are
        complete.
        """
        done = self._sample_states(times, out)
        if done and outputs.shape[1]:
            self._observe(times[:done], out.q[:done], out.v[:done], out.a[:done], out.lam[:done], outputs[:done])
        return done

    def _sample_states(self, times: Array, out: Samples) -> int:
        """As :meth:`_sample`, one state after the other, without outputs."""
        for i, t in enumerate(times):
            if not self.advance(float(t)).ok:
                return i
            code, out.a[i], out.lam[i] = self.evaluate()
            out.q[i], out.v[i], out.energy_account[i] = self._q, self._v, self._energy_account
            if code is not Code.OK:
                self.status = self._status(code)
                return i
            if self._undetermined():
                self.undetermined_at = self._t
        return len(times)

    @abstractmethod
    def restart(self) -> None:
        """Discard the history; the equations have changed."""

    def continue_after_event(self) -> None:
        """Continue with equations that have changed slightly."""
        self.restart()

    def jump(self, dv: Array) -> None:
        """Add dv (n,) to the reported velocities, and restart."""
        self._v += validated_vector("dv", dv, len(self._v))
        self.restart()

    @abstractmethod
    def arrays(self) -> list[NDArray[Any]]:
        """Return the arrays that contain the complete state of the stepper; ``clock`` is one of them."""

    def save(self) -> bytes:
        """Return the complete state of the stepper."""
        self.clock[0] = self._t
        return pack(self.arrays())

    def restore(self, data: bytes) -> None:
        """Restore the state in which ``data`` was saved: bit for bit if the arrays contain the solver's history."""
        unpack(data, self.arrays())
        self._t, self.undetermined_at = float(self.clock[0]), math.nan
        self.status = self._status(Code.OK)

    @property
    @abstractmethod
    def statistics(self) -> Statistics:
        """Counters of the run so far."""


def validated_vector(name: str, values: Array, size: int) -> Array:
    """Return a contiguous copy of ``values`` (size,); raise for another size or what is not finite."""
    array = np.array(values, dtype=np.float64, ndmin=1)
    if array.shape != (size,):
        raise ValueError(f"{name} has the shape {array.shape}; this system needs ({size},)")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} is {array}; it must be finite")
    return array


def pack(arrays: list[NDArray[Any]]) -> bytes:
    """Return the bytes of the arrays, one after the other."""
    return b"".join(array.tobytes() for array in arrays)


def unpack(data: bytes, arrays: list[NDArray[Any]]) -> None:
    """Fill the arrays from :func:`pack`'s bytes; raise if they are of another length."""
    needed = sum(array.nbytes for array in arrays)
    if len(data) != needed:
        raise ValueError(f"the saved state has {len(data)} bytes; allowed: one of the same system, of {needed} bytes")
    offset = 0
    for array in arrays:
        count = array.size
        array.reshape(-1)[:] = np.frombuffer(data, array.dtype, count, offset)
        offset += array.nbytes


_advance_in_pieces = advance_in_pieces_of(Stepper._limit_steps, lambda stepper, t: stepper.advance_to(t))
