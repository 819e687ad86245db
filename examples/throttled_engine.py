"""An engine as a plain PythonFMU slave: a throttled torque on a flywheel, a load that steps, and an elastic shaft.

    inertia * d speed/dt = throttle * max_torque - load - T
    T = shaft_stiffness * (angle - spindle angle) + shaft_damping * (speed - spindle speed)

The shaft turns the spindle of a governor, whose collar closes the throttle as it rises. Two choices make this a good
partner in a co-simulation, whatever the host does with its inputs:

- between communication points the spindle's angle is extrapolated at its speed. Held instead, it would lag behind by
  speed * step / 2, and the shaft would twist by that much even where nothing changes;
- ``shaft_torque`` is the mean over the last step, so that what the engine gives to the shaft the spindle receives.
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


class ThrottledEngine(DescribedSlave):
    """Engine with flywheel, load and shaft, throttled by the collar of a governor."""

    FILE = Path(__file__)
    TEXT = "Engine with flywheel, load and shaft, throttled by the collar of a governor"
    EXPERIMENT = Experiment(stop_time=6.0, step_size=1e-3, tolerance=1e-6)
    VARIABLES = {  # noqa: RUF012
        Fmi2Causality.parameter: {
            "inertia": (4.0, "kg.m2", "inertia of the flywheel"),
            "max_torque": (40.0, "N.m", "torque of the engine at full throttle"),
            "open_height": (0.0475, "m", "height of the collar at full throttle"),
            "closed_height": (0.0525, "m", "height of the collar at which the throttle is shut"),
            "load_before": (10.0, "N.m", "torque of the load before its step"),
            "load_after": (25.0, "N.m", "torque of the load after its step"),
            "load_time": (1.0, "s", "when the load steps"),
            "shaft_stiffness": (1500.0, "N.m/rad", "stiffness of the shaft"),
            "shaft_damping": (20.0, "N.m.s/rad", "damping of the shaft"),
            "start_speed": (
                11.294743,
                "rad/s",
                "speed at the start; default: what the governor holds against load_before",
            ),
        },
        Fmi2Causality.input: {
            "spindle_angle": (0.0, "rad", "angle of the governor's spindle"),
            "spindle_speed": (0.0, "rad/s", "speed of the governor's spindle"),
            "collar_height": (0.0, "m", "height of the governor's collar"),
        },
        Fmi2Causality.output: {
            "shaft_torque": (0.0, "N.m", "torque of the shaft on the spindle, mean over the last step"),
            "angle": (0.0, "rad", "angle of the flywheel"),
            "speed": (0.0, "rad/s", "speed of the flywheel"),
            "throttle": (0.0, "1", "opening of the throttle, 0 to 1"),
            "load": (0.0, "N.m", "torque of the load"),
        },
    }

    def begin(self) -> None:
        """Start as the parameters say, the shaft without twist."""
        self.angle, self.speed = self.spindle_angle, self.start_speed
        self.throttle = self.throttle_at(self.collar_height)
        self.load = self.load_before

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Integrate flywheel and shaft over one communication step (Runge-Kutta of order 4)."""
        if step_size == 0.0:
            return True
        self.throttle = self.throttle_at(self.collar_height)
        count = ceil(step_size / SUBSTEP)
        h = step_size / count
        y = np.array([self.angle, self.speed, 0.0])
        for i in range(count):
            s = i * h  # time into the step
            self.load = self.load_before if current_time + s + 0.5 * h < self.load_time else self.load_after
            k1 = self._rates(s, y)
            k2 = self._rates(s + 0.5 * h, y + 0.5 * h * k1)
            k3 = self._rates(s + 0.5 * h, y + 0.5 * h * k2)
            k4 = self._rates(s + h, y + h * k3)
            y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        self.angle, self.speed, impulse = y.tolist()
        self.shaft_torque = impulse / step_size
        return True

    def _rates(self, s: float, y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the rates of angle, speed and impulse of the shaft, ``s`` (s) after the communication point."""
        angle, speed, _ = y
        shaft = self.torque_of_shaft(angle - self.spindle_angle - s * self.spindle_speed, speed - self.spindle_speed)
        return np.array([speed, self.acceleration(self.throttle, self.load, shaft), shaft])

    # ---- the laws of the engine, also of use without an FMU -----------------------------------------------------

    def throttle_at(self, height: float) -> float:
        """Return the throttle's opening with the collar at ``height`` (m)."""
        return min(1.0, max(0.0, (self.closed_height - height) / (self.closed_height - self.open_height)))

    def torque_of_shaft(self, twist: float, rate: float) -> float:
        """Return the torque of the shaft on the spindle (N.m) for its twist (rad) and the rate of it (rad/s)."""
        return self.shaft_stiffness * twist + self.shaft_damping * rate

    def acceleration(self, throttle: float, load: float, shaft: float) -> float:
        """Return the acceleration of the flywheel, rad/s2; torques in N.m."""
        return (throttle * self.max_torque - load - shaft) / self.inertia
