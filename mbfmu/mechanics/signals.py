"""Known functions of time: what drives a joint or scales an applied force.

A signal is data, so that the compiled loop can evaluate it. An input is a polynomial about the last communication
point; its coefficients are what the host sets, or of a drive what :mod:`.motion` makes of that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, pi
from typing import Any, NamedTuple

import numpy as np

from mbfmu.errors import UserError
from solvers.kernel import kernel

from .numbers import finite, is_finite

POLYNOMIAL, HARMONIC, RUN_UP = 0, 1, 2
SEEN = 0.3  # longest step, in periods of a sine or durations of a run-up


@kernel
def running(s: float, c: Any) -> tuple[float, float]:
    """Time a run-up has taken, and time since it ended."""
    taken = min(max(s.real, 0.0), c[2].real)
    return taken, max(s.real, taken) - taken


@kernel
def value(signal: Any, t: float) -> float:
    """The signal at time t."""
    s = t - signal.t0
    c = signal.c
    if signal.kind == HARMONIC:
        return c[0] + c[1] * np.sin(c[2] * s + c[3])
    if signal.kind == RUN_UP:
        x, late = running(s, c)
        turns = (np.cos(2.0 * np.pi * x / c[2]) - 1.0) / (2.0 * np.pi) ** 2
        return c[0] + c[1] * (0.5 * x * x / c[2] + c[2] * turns + late)
    return c[0] + s * (c[1] + s * (c[2] + s * c[3]))


@kernel
def rate(signal: Any, t: float) -> float:
    """Its first derivative."""
    s = t - signal.t0
    c = signal.c
    if signal.kind == HARMONIC:
        return c[1] * c[2] * np.cos(c[2] * s + c[3])
    if signal.kind == RUN_UP:
        x = running(s, c)[0] / c[2]
        return c[1] * (x - np.sin(2.0 * np.pi * x) / (2.0 * np.pi))
    return c[1] + s * (2.0 * c[2] + s * 3.0 * c[3])


@kernel
def second(signal: Any, t: float) -> float:
    """Its second derivative."""
    s = t - signal.t0
    c = signal.c
    if signal.kind == HARMONIC:
        return -c[1] * c[2] * c[2] * np.sin(c[2] * s + c[3])
    if signal.kind == RUN_UP:
        return c[1] / c[2] * (1.0 - np.cos(2.0 * np.pi * running(s, c)[0] / c[2]))
    return 2.0 * c[2] + s * 6.0 * c[3]


class Varying(NamedTuple):
    """A signal that varies by itself."""

    kind: int
    begin: float  # s
    time: float  # s, a period or a duration


def varying(signals: Any) -> list[Varying]:
    """Return the sines and the run-ups among the records of signals."""
    found = []
    for signal in signals:
        kind, begin = int(signal["kind"]), float(signal["t0"])
        _, size, time, _ = (abs(float(x)) for x in signal["c"])
        if kind != POLYNOMIAL and size * time > 0.0:
            found.append(Varying(kind, begin, 2.0 * pi / time if kind == HARMONIC else time))
    return found


def longest_step(signal: Varying, t: float) -> tuple[float, float]:
    """Return the longest step from t on that cannot miss how a signal varies, and until when it is the longest, s.

    A solver that looks at a sine once a period, or passes a run-up in one step, sees nothing to be wrong about.
    """
    if signal.kind == HARMONIC:
        return SEEN * signal.time, inf
    end = signal.begin + signal.time
    shortest = SEEN * signal.time
    if t < signal.begin - shortest:
        half = 0.5 * (signal.begin - t)
        return half, t + half
    return (shortest, end) if t < end else (inf, inf)


@dataclass(frozen=True)
class Polynomial:
    """c0 + c1 t + c2 t^2 + c3 t^3."""

    c: Sequence[float]

    def fill(self, record: Any) -> None:
        """Write the signal into its record."""
        if np.ndim(self.c) != 1 or not 1 <= len(self.c) <= 4 or not is_finite(self.c):
            raise UserError(f"polynomial coefficients are {self.c!r}; allowed: one to four finite numbers")
        record["kind"] = POLYNOMIAL
        for i, c in enumerate(self.c):
            record["c"][i] = c


@dataclass(frozen=True, kw_only=True)
class Harmonic:
    """mean + amplitude sin(2 pi frequency t + phase); frequency in Hz, phase in rad."""

    amplitude: float
    frequency: float
    phase: float = 0.0
    mean: float = 0.0

    def fill(self, record: Any) -> None:
        """Write the signal into its record."""
        if not is_finite((self.mean, self.amplitude, self.frequency, self.phase)):
            raise UserError(f"{self!r}: every number must be finite")
        c = (self.mean, self.amplitude, 2.0 * pi * self.frequency, self.phase)
        record["kind"] = HARMONIC
        for i, x in enumerate(c):
            record["c"][i] = x


@dataclass(frozen=True, kw_only=True)
class RunUp:
    """Runs up from rest to ``speed`` (rad/s or m/s) within ``duration`` (s), with an acceleration without jumps.

    The speed is speed (x - sin(2 pi x) / (2 pi)), x = t / duration, and then stays; the coordinate starts at ``start``.
    """

    speed: float
    duration: float
    start: float = 0.0

    def fill(self, record: Any) -> None:
        """Write the signal into its record."""
        c = (self.start, self.speed, self.duration)
        if not is_finite(c) or self.duration <= 0.0:
            raise UserError(f"{self!r}: every number must be finite and the duration greater than zero")
        record["kind"] = RUN_UP
        record["c"][:3] = c


@dataclass(frozen=True, kw_only=True)
class Input:
    """A value the host sets between steps.

    A load is held, or continued with ``rate_name`` where the host gives the rate too. The drive of a joint is a motion
    instead: the coordinate moves to where the host's motion will be at the end of the step, without a jump of its
    position, see :mod:`.motion`.

    Parameters
    ----------
    name, unit, description
        Of the FMU's input variable.
    rate_name
        Name of a second input, the time derivative; without it the rate is zero.
    start
        Value until the host sets one.
    """

    name: str
    unit: str
    description: str = ""
    rate_name: str = ""
    start: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a start that is no number."""
        finite(f"start of input {self.name!r}", self.start)

    def fill(self, record: Any) -> None:
        """Write the start value into the record."""
        record["kind"] = POLYNOMIAL
        record["c"][0] = self.start

    def variables(self) -> list[tuple[str, str, str, float]]:
        """Return name, unit, description and start of what the host sets; entry k is coefficient k."""
        own = [(self.name, self.unit, self.description, self.start)]
        return [*own, (self.rate_name, self.unit + "/s", f"rate of {self.name}", 0.0)] if self.rate_name else own


@dataclass(frozen=True, kw_only=True)
class SpeedInput:
    """A drive at the speed the host sets; the driven coordinate is its integral and never jumps.

    A new value sets the speed at once, by an impulse that moves what hangs on the joint too. Held between communication
    points, a speed that changes smoothly lags behind by half a step.

    Parameters
    ----------
    name, unit, description
        Of the FMU's input variable; ``unit`` is rad/s or m/s.
    start
        Speed until the host sets one.
    """

    name: str
    unit: str
    description: str = ""
    start: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a start that is no number."""
        finite(f"start of input {self.name!r}", self.start)

    def fill(self, record: Any) -> None:
        """Write the start value into the record."""
        record["kind"] = POLYNOMIAL
        record["c"][1] = self.start

    def variables(self) -> list[tuple[str, str, str, float]]:
        """Return nothing for coefficient 0, which follows, and the speed for coefficient 1."""
        return [("", "", "", 0.0), (self.name, self.unit, self.description, self.start)]


Signal = Polynomial | Harmonic | RunUp | Input | SpeedInput


def as_signal(value_: float | Signal) -> Signal:
    """Take a number for a constant."""
    return Polynomial((float(value_),)) if isinstance(value_, int | float) else value_
