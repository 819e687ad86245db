"""A solver from outside the package in a run: what its code raises, or leaves wrong, ends the run and loses nothing.

The reported state is a copy of the last good one. After every call that may change the state it is compared with what
:class:`solvers.Stepper` requires: sizes and types, finite numbers, and a time that advances to the requested one and
not beyond it. If that fails, or the code raises an exception, the status is not ok and contains the error, whose
``__cause__`` is the exception. The log has its traceback at the level INFO. Only ``save`` and ``restore`` raise errors.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from solvers.diagnostics import Diagnostic
from solvers.options import Statistics
from solvers.outcome import Code, Status, UserSolverError
from solvers.stepper import Stepper
from solvers.system import AnySystem, Array

from .plugins import ContractError, name_error

log = logging.getLogger(__name__)
T = TypeVar("T")


def require_reals(what: str, values: Any, size: int) -> None:
    """Raise ContractError unless ``values`` is an array (size,) of real numbers."""
    array = np.asarray(values)
    if array.shape != (size,) or array.dtype.kind not in "fiu":
        raise ContractError(
            f"{what} of the shape {array.shape} and the type {array.dtype}; allowed: ({size},), of real numbers"
        )


class GuardedStepper(Stepper):
    """A solver from outside the package, whose errors are statuses.

    Parameters
    ----------
    name
        Name of the solver.
    inner
        The solver itself.
    system, t0, q0, v0
        What it was created with, see :class:`solvers.Stepper`.

    Attributes
    ----------
    inner
        The solver itself.
    """

    def __init__(self, name: str, inner: Stepper, system: AnySystem, t0: float, q0: Array, v0: Array) -> None:
        self.name, self.inner = name, inner
        self._error: UserSolverError | None = None
        self._is_usable = True  # False: a call failed after which the solver cannot continue
        super().__init__(system, t0, q0, v0, inner.options)
        self.fallback_solvers, self.starts_singular = inner.fallback_solvers, inner.starts_singular
        self._change("__init__()", lambda: None)
        if self._is_usable:
            self.status = self._status(inner.status.code)

    def _status(self, code: Code) -> Status:
        status = super()._status(code)
        return status if code is Code.OK else status._replace(error=self._error)

    def _fail(self, method: str, error: Exception) -> None:
        """Make an exception the error of this solver, and its status not ok."""
        self._error = name_error(self.name, self._t, error)
        log.info("%s of solver %r", method, self.name, exc_info=error)
        self.status = self._status(Code.COLLAPSED)

    def _call(self, method: str, call: Callable[[], T], default: T) -> T:
        """Return the result of a call, or the default if it raises."""
        try:
            return call()
        except Exception as error:
            self._fail(method, error)
            return default

    def _change(self, method: str, call: Callable[[], Any]) -> None:
        """Call what begins the next step at the reported state; if it raises the solver cannot continue."""
        self._error, self._is_usable = None, True
        try:
            call()
            self._copy_state(self._t, self._t, method)
        except Exception as error:
            self._is_usable = False
            self._fail(method, error)

    def _copy_state(self, low: float, high: float, method: str = "advance_to()") -> None:
        """Make the state of the solver the reported one; ContractError if it is none at a time from ``low`` to
        ``high``, s.
        """
        inner = self.inner
        what, t = f"{method} of {type(inner).__name__}", np.asarray(inner.t)
        if t.shape or t.dtype.kind not in "fiu" or not low <= t <= high:
            allowed = f"{high:.9g} s" if low == high else f"{low:.9g} to {high:.9g} s"
            raise ContractError(f"{what} has reported the time {inner.t!r}; allowed: {allowed}")
        found = []
        for name, values, size in (
            ("q", inner.q, len(self._q)),
            ("v", inner.v, len(self._v)),
            ("energy_account", inner.energy_account, len(self._energy_account)),
        ):
            require_reals(f"{what} has reported {name}", values, size)
            if name != "energy_account" and not np.isfinite(values).all():
                raise ContractError(f"{what} has reported {name} = {values}; allowed: finite numbers")
            found.append(values)
        self._t = float(t)
        self._q[:], self._v[:], self._energy_account[:] = found

    def _keep_state(self, low: float, high: float) -> None:
        """After an error: report the state of the solver if it is a good one, else return it to the last good one."""
        try:
            self._copy_state(low, high)
        except Exception:
            inner = self.inner
            inner._t, inner._q, inner._v = self._t, self._q.copy(), self._v.copy()
            inner._energy_account = self._energy_account.copy()

    def advance_to(self, t: float) -> Code:
        """As :meth:`solvers.stepper.Stepper.advance_to`."""
        if not self._is_usable:
            return Code.COLLAPSED
        self._error, before = None, self._t
        try:
            code = self.inner.advance_to(t)
            if not isinstance(code, Code):
                raise ContractError(
                    f"advance_to() of {type(self.inner).__name__} returned {code!r}; allowed: a solvers.outcome.Code, "
                    "which is Code.OK at the requested time"
                )
            self._copy_state(t if code is Code.OK else before, t)
        except Exception as error:
            self._keep_state(before, t)
            self._fail("advance_to()", error)
            return Code.COLLAPSED
        return code

    def limit_step(self, longest: float) -> None:
        """As :meth:`solvers.stepper.Stepper.limit_step`."""
        if self._is_usable:
            self._change("limit_step()", lambda: self.inner.limit_step(longest))

    def evaluate(self) -> tuple[Code, Array, Array]:
        """As :meth:`solvers.stepper.Stepper.evaluate`."""
        _, n, _, m, _ = self._sizes
        nothing = Code.COLLAPSED, np.zeros(n), np.zeros(m)

        def checked() -> tuple[Code, Array, Array]:
            what = f"evaluate() of {type(self.inner).__name__} returned"
            code, a, lam = self.inner.evaluate()
            if not isinstance(code, Code):
                raise ContractError(f"{what} the code {code!r}; allowed: a solvers.outcome.Code")
            if code is not Code.OK:
                return code, *nothing[1:]
            for name, values, size in (("v'", a, n), ("lambda", lam, m)):
                require_reals(f"{what} {name}", values, size)
                if not np.isfinite(values).all():
                    raise ContractError(f"{what} {name} = {values}; allowed: finite numbers")
            return code, a, lam

        return self._call("evaluate()", checked, nothing)

    def _undetermined(self) -> bool:
        return self.inner._undetermined()

    def restart(self) -> None:
        """As :meth:`solvers.stepper.Stepper.restart`."""
        self._change("restart()", self.inner.restart)

    def continue_after_event(self) -> None:
        """As :meth:`solvers.stepper.Stepper.continue_after_event`."""
        self._change("continue_after_event()", self.inner.continue_after_event)

    def jump(self, dv: Array) -> None:
        """As :meth:`solvers.stepper.Stepper.jump`."""
        self._change("jump()", lambda: self.inner.jump(dv))

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        return self.inner.arrays()

    def save(self) -> bytes:
        """As :meth:`solvers.stepper.Stepper.save`."""
        return self.inner.save()

    def restore(self, data: bytes) -> None:
        """As :meth:`solvers.stepper.Stepper.restore`."""
        self.inner.restore(data)
        self._error, self._is_usable, self.undetermined_at = None, True, np.nan
        self._copy_state(-np.inf, np.inf, "restore()")
        self.status = self._status(Code.OK)

    @property
    def freedom(self) -> int:
        """As :attr:`solvers.stepper.Stepper.freedom`."""
        return self._call("freedom", lambda: self.inner.freedom, len(self._v))

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """As :attr:`solvers.stepper.Stepper.diagnostics`."""
        return self._call("diagnostics", lambda: tuple(self.inner.diagnostics), ())

    @property
    def statistics(self) -> Statistics:
        """As :attr:`solvers.stepper.Stepper.statistics`."""
        return self._call("statistics", lambda: self.inner.statistics, Statistics())
