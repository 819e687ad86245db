"""Inputs that are given as functions of time, or by points, for a whole run: they become signals of the mechanism.

What a host sets holds from one communication point to the next. What is known before the run needs no such points: the
solver evaluates it at its own times, so that the times of the outputs have no influence.

A load is the function. A driven coordinate is the function too, and needs its first two derivatives, so that its rate
must not jump; where only the rate is given, the coordinate is its integral. What cannot be evaluated in this way is
``held``: it has to be set at every output.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics import law
from mbfmu.mechanics.checks import signal_of
from mbfmu.mechanics.curve import curve
from mbfmu.mechanics.numbers import finite, is_finite
from mbfmu.mechanics.signals import Function, Input, Signal, SpeedInput, Table
from mbfmu.mechanics.signals.fitting import Pieces, UnresolvedError, find_jump, fit
from mbfmu.mechanics.signals.followed import Followed
from mbfmu.mechanics.signals.measured import MeasuredTable
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import UserError, short

Array = NDArray[np.float64]

ALLOWED_INPUTS = (
    "a finite number, a function or an expression of time, a pair (times, values), a Table or another signal"
)
Given = float | str | Callable[[float], float] | Sequence[Any] | Signal
RATE_TOLERANCE = 1e-6  # deviation of the given rate from that of the given position, relative to the largest
NOISY_LOAD_TOLERANCE_RATIO = 1e-2  # approximation error of a load that has noise, to the tolerance of the solver
N_REPEATED_CALLS = 64  # times at which functions are called again after the run,
START_RATE_SPAN = 1e-7  # time over which the rate at the start is a difference, relative to the run
REPEAT_TOLERANCE = 1e-9  # ... and deviation from the first call, relative to the largest value
MAX_MARKS = 100_000  # output times at which approximations are compared with functions


class GivenInput:
    """What one input is given by: ``given`` over the ``times`` of the outputs, s.

    Attributes
    ----------
    held
        Why it is set at outputs and held between them; empty: it is a signal.
    used
        Whether an input of the mechanism has its name.
    """

    def __init__(self, name: str, given: Any, times: Array) -> None:
        self.name, self.times, self.held, self.used = name, times, "", False
        self._what, self._given = f"input {name!r}", given
        self.jerk = ""  # message about a drive that is held and does not begin at rest
        self._noted: Array | None = None
        if isinstance(given, Signal):
            if given.variables():
                raise UserError(f"{self._what} is {short(given)}; allowed: {ALLOWED_INPUTS}")
        elif callable(given):
            self._function = given
        elif isinstance(given, str):
            self._function = law.from_text(self._what, given, ("t",))
        else:
            self._table("linear")  # refuses what is none

    @property
    def is_function(self) -> bool:
        """Whether it is a function of time that can be called."""
        return callable(self._given) or isinstance(self._given, str)

    @property
    def kind(self) -> str:
        """Description of the value for messages."""
        if self.is_function or isinstance(self._given, Function):
            return "function of time"
        if isinstance(self._given, MeasuredTable):
            return self._given.source or "points"
        return type(self._given).__name__ if isinstance(self._given, Signal) else "points"

    def use(self, unit: str) -> None:
        """Note that an input with this unit has the name; raises UserError if the values are of another quantity."""
        self.used = True
        if isinstance(self._given, MeasuredTable):
            self._given.check_unit(self._what, unit)

    def _table(self, kind: str) -> Table:
        """Return the table it is given by, or a table of this kind through its points."""
        if isinstance(self._given, Table):
            return self._given
        try:
            x, y = self._given
        except (TypeError, ValueError) as error:
            raise UserError(f"{self._what} is {short(self._given)}; allowed: {ALLOWED_INPUTS}") from error
        table = Table(x, y, kind, "hold" if kind == "linear" else "linear")
        table.rows(self._what)
        self._check_span(table)
        return table

    def _check_span(self, table: Table) -> None:
        first, last, begin, end = table.x[0], table.x[-1], self.times[0], self.times[-1]
        if begin < first or end > last:
            raise UserError(
                f"{self._what} is given by points from {first:g} to {last:g} s, but the run is from {begin:g} to "
                f"{end:g} s; give points for the whole run, or mbfmu.Table(times, values, beyond=...)"
            )

    def value(self, t: float) -> float:
        """Return its value at t, s; UserError where that is no finite number."""
        if self.is_function:
            try:
                with np.errstate(all="ignore"):  # a value that is not finite is reported below
                    found = self._function(t)
            except Exception as error:
                raise UserError(
                    f"{self._what}: its function fails at t = {t:.9g} s ({type(error).__name__}: {error}). A function "
                    "is called at any time of the run; give values at single times as a pair (times, values)"
                ) from error
            if not is_finite(found) or np.ndim(found):
                raise UserError(f"{self._what} is {short(found)} at t = {t:.9g} s; allowed: a finite number")
            return float(found)
        if isinstance(self._given, Signal) and not isinstance(self._given, Table):
            raise UserError(f"{self._what} is {short(self._given)}; allowed: a number, function, points or Table")
        table = self._table("linear")
        rows = table.rows(self._what)
        return float(curve(rows.ravel(), 0, -len(rows) if table.beyond == "periodic" else len(rows), float(t))[0])

    @property
    def signal(self) -> Signal | None:
        """The signal it is given by; None: it is a function or points."""
        return self._given if isinstance(self._given, Signal) else None

    def spline(self) -> Pieces:
        """Return a cubic spline through the points it is given by; with natural ends where there are less than four."""
        table = self._table("linear")
        found = scipy.interpolate.CubicSpline(table.x, table.y, bc_type="not-a-knot" if len(table.x) > 3 else "natural")
        return Pieces.of_cubics(found.x, found.c)

    def pieces(self, tolerance: float, *, smooth: bool) -> Pieces:
        """Return it over the run; raises what :func:`.signals.fitting.fit` does."""
        begin, end = float(self.times[0]), float(self.times[-1])
        if self.is_function:
            marks = self.times[:: 1 + len(self.times) // MAX_MARKS]
            return fit(self.value, begin, end, marks, NOISY_LOAD_TOLERANCE_RATIO * tolerance, smooth=smooth)
        table = self._table("linear")
        self._check_span(table)
        rows = table.rows(self._what)
        rows = rows[rows[:, 0] >= table.x[0]]
        return Pieces.of_cubics(rows[:, 0], rows[:-1, 4:0:-1].T)

    def note_start(self) -> None:
        """Note that a drive which is held starts at rest, if it does not."""
        t = float(self.times[0])
        step = START_RATE_SPAN * float(self.times[-1] - t)
        values = [self.value(float(time)) for time in self.times[:: 1 + len(self.times) // N_REPEATED_CALLS]]
        rate = (self.value(t + step) - self.value(t)) / step
        if abs(rate) * step > RATE_TOLERANCE * START_RATE_SPAN * float(np.ptp(values)):
            self.jerk = (
                f"The joint that it moves starts at rest although the input starts with the rate {rate:.4g}, so "
                "that the bodies connected to the joint receive an impulse at the first output. Give a function whose "
                "derivative is continuous and zero at the start. "
            )

    def note(self) -> None:
        """Keep what the function returns now, for :meth:`check_repeats`."""
        if self.is_function:
            self._noted = self._values()

    def _values(self) -> Array:
        k = np.linspace(0, len(self.times) - 1, min(len(self.times), N_REPEATED_CALLS)).astype(int)
        return np.array([self.value(float(t)) for t in self.times[k]])

    def check_repeats(self) -> list[Diagnostic]:
        """Return a warning if the function returns something else than before the run."""
        if self._noted is None or self.held:
            return []
        off = np.abs(self._values() - self._noted).max(initial=0.0)
        if not off > REPEAT_TOLERANCE * np.abs(self._noted).max(initial=0.0):
            return []
        return [
            Diagnostic.warning(
                "sampled-input",
                f"the function of {self._what} does not depend on time alone: called again for the same times it "
                f"returned values that differ by {off:.3g}",
                "It is called before the run; set values that depend on the run by Simulation.set_input in the "
                "function `watch`",
                subject=self.name,
            )
        ]


class GivenInputs:
    """What the inputs of a mechanism are given by, for one run with this relative tolerance.

    ``set_later``: the inputs given by ``numbers`` may be set during the run.

    Attributes
    ----------
    by_name
        Inputs given over time.
    numbers
        Constant inputs by name.
    """

    def __init__(
        self,
        given: Mapping[str, Any],
        numbers: Mapping[str, float],
        times: Array,
        tolerance: float,
        *,
        set_later: bool = False,
    ) -> None:
        self.by_name = {name: GivenInput(name, value, times) for name, value in given.items()}
        self.numbers, self._tolerance, self._begin = numbers, tolerance, float(times[0])
        self._sampled = times[np.linspace(0, len(times) - 1, min(len(times), N_REPEATED_CALLS)).astype(int)]
        self._set_later, self._contradictions = set_later, dict[str, Diagnostic]()
        self._made: dict[tuple[str, bool], Signal | None] = {}
        self.replaced: set[str] = set()  # names of all values and rates of inputs that are signals in this run

    def replace(self, signal: Input | SpeedInput, *, drive: bool) -> Signal:
        """Return the signal that an input follows in this run, or the input itself."""
        names = {k: name for k, (name, *_) in enumerate(signal.variables()) if name in self.by_name}
        if not names:
            if not self._set_later:
                self._compare(signal, None)
            return signal
        for k, name in names.items():
            self.by_name[name].use(signal.variables()[k][1])
        key = (next(iter(names.values())), drive)
        if key not in self._made:
            self._made[key] = self._make(signal, names, drive)
        found = self._made[key]
        if found is None:
            return signal
        self.replaced.update(name for name, *_ in signal.variables() if name)
        return found

    def starts(self) -> dict[str, float]:
        """Return the values at the begin of all inputs that are used."""
        return {name: given_input.value(self._begin) for name, given_input in self.by_name.items() if given_input.used}

    def diagnostics(self) -> list[Diagnostic]:
        """Return warnings about inputs that are not evaluated exactly or contradict each other, after a run."""
        found = [
            Diagnostic.warning(
                "sampled-input",
                f"input {given_input.name!r} cannot be evaluated at the solver's times ({given_input.held}): it was "
                "set at every output only, and the result depends on the interval between outputs",
                f"{given_input.jerk}Reduce the interval, or give a smooth function",
                subject=given_input.name,
            )
            for given_input in self.held
        ]
        found += self._contradictions.values()
        found += [diagnostic for given_input in self.by_name.values() for diagnostic in given_input.check_repeats()]
        return found

    def summary(self, interpolation: str) -> tuple[str, ...]:
        """Return how each input was treated; ``interpolation`` is that of loads which are held."""
        between = {"hold": "held", "linear": "extrapolated"}[interpolation]
        return (
            *(f"{name}: constant" for name in self.numbers),
            *(
                f"{given_input.name}: {given_input.kind}, "
                + (f"set at outputs, {between} between them" if given_input.held else "evaluated at the solver's times")
                for given_input in self.by_name.values()
            ),
        )

    @property
    def unused(self) -> list[str]:
        """Names that no input of the mechanism has."""
        return [name for name, given_input in self.by_name.items() if not given_input.used]

    @property
    def driving(self) -> list[str]:
        """Names of those that move joints."""
        return [name for name, drive in self._made if drive]

    @property
    def held(self) -> list[GivenInput]:
        """Those that have to be set at every output."""
        return [given_input for given_input in self.by_name.values() if given_input.held]

    def hold(self, name: str, unit: str, reason: str) -> None:
        """Let an input with this unit be set at outputs, for a reason."""
        if name in self.by_name:
            self.by_name[name].use(unit)
            self.by_name[name].held = reason

    def _make(self, signal: Input | SpeedInput, names: dict[int, str], drive: bool) -> Signal | None:
        """Return the signal; None where the input has to be held."""
        given_inputs = {k: self.by_name[name] for k, name in names.items()}
        for given_input in given_inputs.values():
            given_input.note()
        try:
            if 0 in given_inputs and (own := given_inputs[0].signal) is not None:
                if isinstance(own, MeasuredTable):
                    own = own.for_use(drive=drive)
                if isinstance(own, Table):
                    self._compare(signal, own)
                return signal_of(own, f"input {given_inputs[0].name!r}", drive=drive)
            if 0 in given_inputs:
                found = self._followed(given_inputs[0], drive)
            elif 1 in given_inputs:
                found = self._integrated(given_inputs[1], signal, drive)
            else:
                raise UnresolvedError("neither its value nor its rate is given for the whole run")
        except UnresolvedError as reason:
            for given_input in given_inputs.values():
                given_input.held = str(reason)
            if drive and 0 in given_inputs:
                given_inputs[0].note_start()
            return None
        self._compare(signal, found)
        return found

    def _followed(self, given_input: GivenInput, drive: bool) -> Followed:
        points = drive and not given_input.is_function
        value = given_input.spline() if points else given_input.pieces(self._tolerance, smooth=drive)
        rate = value.derivative()
        if drive:
            refuse_jump(value, "it")
            refuse_jump(rate, "its rate")
        joined = value.joined_derivative() if drive else rate
        return Followed(value=value, rate=joined, acceleration=rate.derivative(), smooth=drive)

    def _integrated(self, given_input: GivenInput, signal: Input | SpeedInput, drive: bool) -> Followed:
        """Return the integral of a rate from where the input starts."""
        name, _, _, start = signal.variables()[0]
        rate = given_input.pieces(self._tolerance, smooth=drive)
        if drive:
            refuse_jump(rate, "it")
        value = rate.integral(float(self.numbers.get(name, start)) if name else 0.0)
        return Followed(value=value, rate=rate, acceleration=rate.derivative(), smooth=drive)

    def _compare(self, signal: Input | SpeedInput, found: Followed | Table | None) -> None:
        """Note where given derivatives of an input are not those of what it follows; None: of constants."""
        names = enumerate(name for name, *_ in signal.variables())
        given = {k: name for k, name in names if name in self.by_name or name in self.numbers}
        varying = [k for k, name in given.items() if name in self.by_name]
        for k, name in list(given.items())[1:]:
            of = min(varying) if varying and min(varying) < k else min(given)
            values, exact = self._values(name), np.zeros(len(self._sampled))
            used = f"Input {given[of]!r} is the value at the start, and {name!r} is used from then on"
            if of in varying:
                exact, used = self._derivative(found, k), "The derivative is used"
            off = np.abs(exact - values)
            i = int(
                np.argmax(off > (1.0 - RATE_TOLERANCE) * off.max())
            )  # the first time at which rounding alone decides
            if off[i] > RATE_TOLERANCE * max(np.abs(exact).max(), np.abs(values).max()):
                what = "second derivative" if k - of == 2 else "derivative"
                self._contradictions[name] = Diagnostic.warning(
                    "sampled-input",
                    f"input {name!r} is {values[i]:.6g} at t = {self._sampled[i]:.6g} s, but the {what} of input "
                    f"{given[of]!r} is {exact[i]:.6g} at this time",
                    f"{used}; do not give {name!r}, or give consistent values",
                    subject=name,
                    time=float(self._sampled[i]),
                )

    def _values(self, name: str) -> Array:
        """Return an input that is given, at some of the times of the outputs."""
        if name in self.numbers:
            return np.full(len(self._sampled), finite(f"input {name!r}", self.numbers[name]))
        return np.array([self.by_name[name].value(float(t)) for t in self._sampled])

    def _derivative(self, found: Followed | Table | None, order: int) -> Array:
        """Return the first or second derivative of what an input follows, at some of the times of the outputs."""
        if isinstance(found, Followed):
            return (found.rate if order == 1 else found.acceleration).at(self._sampled)
        if isinstance(found, Table):
            rows = found.rows("a table")
            count = -len(rows) if found.beyond == "periodic" else len(rows)
            return np.array([curve(rows.ravel(), 0, count, float(t))[order] for t in self._sampled])
        return np.zeros(len(self._sampled))


def refuse_jump(pieces: Pieces, what: str) -> None:
    """Raise UnresolvedError where what drives a joint jumps."""
    time = find_jump(pieces)
    if time is not None:
        raise UnresolvedError(f"{what} jumps at t = {time:.9g} s")
