"""A motor with its speed loop as a plain PythonFMU slave; ``feeder_motor.py`` turns rollers by two of them.

    inertia * d speed/dt = torque - load
    torque = gain * e + reset * integral of e, within max_torque, with e = wanted - reads * speed

``reads`` is what the tachometer makes of the speed: above 1 the roller is slow, and its loop does not know.
"""

from __future__ import annotations

import ctypes
from math import ceil
from pathlib import Path

import numpy as np
from described_slave import DescribedSlave
from numpy.typing import NDArray
from pythonfmu import Fmi2Causality

from mbfmu.fmi.description import Experiment

# PythonFMU 0.7 drops one reference to this module's names at every instantiation and would free them.
ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))

SUBSTEP = 1e-3  # s, the longest step of the integration


class RollerMotor(DescribedSlave):
    """Rotor and roller with a proportional and integral speed loop."""

    FILE = Path(__file__)
    TEXT = "Motor of a roller with a proportional and integral speed loop"
    EXPERIMENT = Experiment(stop_time=0.4, step_size=1e-3, tolerance=1e-6)
    VARIABLES = {  # noqa: RUF012
        Fmi2Causality.parameter: {
            "inertia": (2e-5, "kg.m2", "inertia of rotor and roller"),
            "gain": (4e-3, "N.m.s/rad", "torque for the error of the speed"),
            "reset": (0.2, "N.m/rad", "torque for the integral of that error"),
            "max_torque": (0.1, "N.m", "largest torque of the motor"),
            "reads": (1.0, "1", "what the tachometer reads, to the speed"),
        },
        Fmi2Causality.input: {
            "wanted": (50.0, "rad/s", "speed that the tachometer shall read"),
            "load": (0.0, "N.m", "torque that the roller needs"),
        },
        Fmi2Causality.output: {
            "speed": (0.0, "rad/s", "speed of the roller"),
            "torque": (0.0, "N.m", "torque of the motor"),
        },
    }
    HIDDEN = ("integral",)
    integral = 0.0  # rad, of the error of the speed

    def begin(self) -> None:
        """Start at the wanted speed, whatever the tachometer reads: a sheet that comes at it is not jerked."""
        self.speed = self.wanted

    def do_step(self, _current_time: float, step_size: float) -> bool:
        """Integrate the rotor and its loop over one communication step (Runge-Kutta of order 4)."""
        count = ceil(step_size / SUBSTEP)
        y = np.array([self.speed, self.integral])
        for _ in range(count):
            h = step_size / count
            k1 = self._rates(y)
            k2 = self._rates(y + 0.5 * h * k1)
            k3 = self._rates(y + 0.5 * h * k2)
            k4 = self._rates(y + h * k3)
            y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        self.speed, self.integral = y.tolist()
        self.torque = self._torque(self.wanted - self.reads * self.speed, self.integral)
        return True

    def _rates(self, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the rates of the speed and of the integral."""
        speed, integral = y
        error = self.wanted - self.reads * speed
        return np.array([(self._torque(error, integral) - self.load) / self.inertia, error])

    def _torque(self, error: float, integral: float) -> float:
        """Return the torque of the motor (N.m) for the error of the speed (rad/s) and its integral (rad)."""
        return min(self.max_torque, max(-self.max_torque, self.gain * error + self.reset * integral))
