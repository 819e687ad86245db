"""What is measured of a run: a number of an output's history, of the steady state, or by a function of the user's.

A measure is written in a study file, or given from Python, as a text such as ``"largest tip.y"``, as a table such as
``{take = "crossing", output = "crank.angle", threshold = 3.14}``, as ``"file.py:function"``, or from Python as a
function; functions are given the :class:`~mbfmu.Result` of a run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isnan, nan, pi
from typing import Any

import numpy as np

from mbfmu.session.result import Result
from mbfmu.steady.state import Equilibrium
from mbfmu.util.errors import UserError, suggest
from solvers.system import Array

Take = Callable[..., float]
CROSSING_DIRECTIONS = ("any", "up", "down")


def end(t: Array, y: Array) -> float:
    """Return the last value."""
    return float(y[-1])


def largest(t: Array, y: Array) -> float:
    """Return the largest value."""
    return float(y.max())


def least(t: Array, y: Array) -> float:
    """Return the least value."""
    return float(y.min())


def peak_to_peak(t: Array, y: Array) -> float:
    """Return the distance of the largest from the least value."""
    return float(np.ptp(y))


def mean(t: Array, y: Array) -> float:
    """Return the mean over time."""
    return float(np.trapezoid(y, t) / (t[-1] - t[0])) if len(t) > 1 else float(y[0])


def rms(t: Array, y: Array) -> float:
    """Return the root of the mean square over time."""
    return float(np.sqrt(mean(t, y * y)))


def crossing(t: Array, y: Array, threshold: float, direction: str = "any", number: int = 1) -> float:
    """Return when an output passes a threshold for the first or a later time, s; NaN where it does not.

    Between two times it is taken for a straight line.
    """
    above = y - threshold
    rises, falls = (above[:-1] < 0.0) & (above[1:] >= 0.0), (above[:-1] > 0.0) & (above[1:] <= 0.0)
    found = np.flatnonzero({"any": rises | falls, "up": rises, "down": falls}[direction])
    if len(found) < number:
        return nan
    k = found[number - 1]
    return float(t[k] - above[k] * (t[k + 1] - t[k]) / (above[k + 1] - above[k]))


def settling(t: Array, y: Array, within: float = 0.0) -> float:
    """Return since when an output stays within this distance of its end, s; 0: 2 % of its range.

    NaN where some of it is no number.
    """
    if np.isnan(y).any():
        return nan
    far = np.flatnonzero(np.abs(y - y[-1]) > (within or 0.02 * np.ptp(y)))
    return float(t[far[-1] + 1]) if len(far) else float(t[0])


MEASURE_FUNCTIONS: dict[str, Take] = {
    "end": end, "largest": largest, "least": least, "range": peak_to_peak, "mean": mean, "rms": rms,
    "crossing": crossing, "settling": settling,
}  # fmt: skip
STEADY_MEASURES = ("equilibrium", "frequency", "damping")
MEASURE_OPTIONS: dict[str, dict[str, type]] = {
    "crossing": {"threshold": float, "direction": str, "number": int},
    "settling": {"within": float},
}
TIME_MEASURES = ("crossing", "settling")


@dataclass(frozen=True)
class History:
    """A number of an output over time."""

    name: str
    take: str
    output: str
    options: tuple[tuple[str, Any], ...] = ()

    def of(self, result: Result) -> float:
        """Return it."""
        return MEASURE_FUNCTIONS[self.take](result.t, result[self.output], **dict(self.options))

    def unit(self, units: Mapping[str, str]) -> str:
        """Return its unit, where those of outputs are known."""
        return "s" if self.take in TIME_MEASURES else units.get(self.output, "1")


@dataclass(frozen=True)
class Steady:
    """A number of the steady state: an output there, or the frequency (Hz) or damping ratio of a mode, from one up."""

    name: str
    take: str
    output: str = ""
    mode: int = 0

    def of(self, state: Equilibrium) -> float:
        """Return it."""
        if self.take == "equilibrium":
            return state.outputs[self.output]
        modes = [mode for mode in state.modes if mode.frequency > 0.0]
        if len(modes) < self.mode:
            return nan
        mode = modes[self.mode - 1]
        return mode.frequency / (2.0 * pi) if self.take == "frequency" else mode.damping_ratio

    def unit(self, units: Mapping[str, str]) -> str:
        """Return its unit, where those of outputs are known."""
        return {"equilibrium": units.get(self.output, "1"), "frequency": "Hz", "damping": "1"}[self.take]


@dataclass(frozen=True)
class Own:
    """What a function of the user's makes of a run."""

    name: str
    function: Callable[[Result], float]
    source: str  # where it is from, with a digest of it

    def of(self, result: Result) -> float:
        """Return it.

        Raises
        ------
        UserError
            The function fails, or returns something else than a number.
        """
        try:
            value = self.function(result)
        except (Exception, SystemExit) as error:
            raise UserError(f"measure {self.name!r} fails with {type(error).__name__}: {error}") from error
        if isinstance(value, np.ndarray) and value.shape == ():
            value = value.item()
        if isinstance(value, bool | np.bool_) or isinstance(value, int | float | np.number):
            return float(value)
        raise UserError(f"measure {self.name!r} returns {value!r}; it must return a number")

    def unit(self, _: Mapping[str, str]) -> str:
        """Return an empty unit: it is unknown."""
        return ""


Measure = History | Steady | Own


def read_measure(name: str, given: Any, outputs: Sequence[str], steady: bool) -> Measure:
    """Return the measure that is written as a text or a table.

    ``outputs`` are the names of the outputs of a run; ``steady`` states are available for models, not for FMUs.

    Raises
    ------
    UserError
        It is written in another way, or of an output that there is not.
    """
    what = f"measure {name!r}"
    if isinstance(given, str):
        take, _, rest = given.strip().partition(" ")
        given = {"take": take} | (
            {"mode" if take in STEADY_MEASURES[1:] else "output": rest.strip()} if rest.strip() else {}
        )
    if not isinstance(given, Mapping):
        raise UserError(f'{what} is {given!r}; allowed: such as "largest tip.y", or a table {{take, output, ...}}')
    options = dict(given)
    take = options.pop("take", None)
    known = (*MEASURE_FUNCTIONS, *(STEADY_MEASURES if steady else ()))
    if take not in known:
        no = (
            f"; an FMU provides no steady states: {', '.join(MEASURE_FUNCTIONS)}"
            if take in STEADY_MEASURES
            else suggest(str(take), known)
        )
        raise UserError(f"{what} takes {take!r}{no}")
    if take in STEADY_MEASURES[1:]:
        return Steady(name, take, mode=_mode(what, options))
    output = options.pop("output", None)
    if output not in outputs:
        raise UserError(f"{what}: there is no output {output!r}{suggest(str(output), outputs)}")
    return (
        Steady(name, take, output)
        if take in STEADY_MEASURES
        else History(name, take, output, _options(what, take, options))
    )


def _mode(what: str, options: dict[str, Any]) -> int:
    mode = options.get("mode", 1)
    if isinstance(mode, str) and mode.isdecimal() and len(mode) <= 9:
        mode = int(mode)
    if set(options) - {"mode"} or isinstance(mode, bool) or not isinstance(mode, int) or mode < 1:
        raise UserError(f"{what} is of mode {mode!r}; allowed: a whole number from 1 on")
    return mode


def _options(what: str, take: str, given: dict[str, Any]) -> tuple[tuple[str, Any], ...]:
    known = MEASURE_OPTIONS.get(take, {})
    for key, value in given.items():
        if key not in known:
            raise UserError(f"{what}: {take!r} has no {key!r}{suggest(key, known) if known else ''}")
        number = isinstance(value, int | float) and not isinstance(value, bool) and not isnan(value)
        number = number and not (key == "within" and value < 0.0)
        whole = isinstance(value, int) and not isinstance(value, bool) and value >= 1
        if {float: not number, int: not whole, str: value not in CROSSING_DIRECTIONS}[known[key]]:
            allowed = {
                float: "a number" + (", at least 0" if key == "within" else ""),
                int: "a whole number from 1 on",
                str: ", ".join(CROSSING_DIRECTIONS),
            }[known[key]]
            raise UserError(f"{what}: {key} is {value!r}; allowed: {allowed}")
    if take == "crossing" and "threshold" not in given:
        raise UserError(f"{what}: take is 'crossing' without threshold; add threshold, the value that is crossed")
    return tuple(given.items())
