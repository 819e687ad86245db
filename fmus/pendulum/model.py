"""Swing pendulum (Choi, Park and Yoo): a slider sprung along a massless rod that swings on the tip of a driven crank.

In the plane, with the crank (length l) at constant speed w, theta the rod's angle to the crank and d the slider's
distance from the tip, the Jacobi integral

    J = m (d'^2 + d^2 theta'^2) / 2 + k_r theta^2 / 2 + k_t (d - d0)^2 / 2 - m w^2 (l^2 + d^2 + 2 l d cos theta) / 2

is constant without damping and bounds theta: the undamped motion oscillates and cannot diverge. The steady
state is theta = 0, d = (k_t d0 + m w^2 l) / (k_t - m w^2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics import JointSpring, Mechanism, Revolute, SpeedInput, Translational
from mbfmu.modeling import Model, parameter


@dataclass(frozen=True, kw_only=True)
class SwingPendulum(Model):
    """Swing pendulum: a slider on springs at the tip of a crank that turns at constant speed."""

    name = "pendulum"
    stop_time = 10.0
    output_interval = 0.01
    settling = MappingProxyType({"swing_damping": 10.0, "slider_damping": 100.0})

    drive_speed: float = parameter(
        20.0, unit="rad/s", doc="Initial speed of the crank; start value of the input crank.drive"
    )
    gravity: float = parameter(0.0, unit="m/s2", doc="Acceleration of gravity, along -y", tunable=True)
    crank_length: float = parameter(1.0, unit="m", min=1e-3, doc="Length of the crank, from pivot to tip")
    crank_mass: float = parameter(1.0, unit="kg", min=0.0, doc="Mass of the crank, center of mass in its middle")
    crank_inertia: float = parameter(
        0.1, unit="kg.m2", min=0.0, doc="Moment of inertia of the crank about its center of mass"
    )
    slider_mass: float = parameter(1.0, unit="kg", min=1e-9, doc="Mass of the slider, a point mass")
    swing_stiffness: float = parameter(
        300.0, unit="N.m/rad", min=0.0, doc="Stiffness of the rotational spring of the rod", tunable=True
    )
    swing_damping: float = parameter(
        0.0, unit="N.m.s/rad", min=0.0, doc="Coefficient of the rotational damper of the rod", tunable=True
    )
    slider_stiffness: float = parameter(
        50000.0, unit="N/m", min=0.0, doc="Stiffness of the spring of the slider", tunable=True
    )
    slider_damping: float = parameter(
        0.0, unit="N.s/m", min=0.0, doc="Coefficient of the damper of the slider", tunable=True
    )
    free_length: float = parameter(1.0, unit="m", min=0.0, doc="Free length of the spring of the slider", tunable=True)
    start_angle: float = parameter(0.0, unit="rad", doc="Initial angle of the rod from the direction of the crank")
    start_distance: float = parameter(1.1, unit="m", doc="Initial distance of the slider from the tip of the crank")

    def build(self) -> Mechanism:
        """Return the mechanism: motion in the x-y plane, crank pivot at the origin."""
        m = Mechanism(gravity=(0.0, -self.gravity, 0.0))
        speed = SpeedInput(name="crank.drive", unit="rad/s", description="Speed of the crank", start=self.drive_speed)
        crank = m.body(
            "crank",
            m.ground,
            Revolute(drive=speed),
            mass=self.crank_mass,
            com=(0.5 * self.crank_length, 0.0, 0.0),
            inertia=(self.crank_inertia,) * 3,
        )
        rod = m.body("rod", crank, Revolute(at=(self.crank_length, 0.0, 0.0), start=self.start_angle))
        slider = m.body("slider", rod, Translational(axis="x", start=self.start_distance), mass=self.slider_mass)
        m.force("swing", JointSpring(stiffness=self.swing_stiffness, damping=self.swing_damping), rod)
        m.force(
            "spring",
            JointSpring(stiffness=self.slider_stiffness, damping=self.slider_damping, free=self.free_length),
            slider,
        )
        m.output("rod.angle", rod.angle(), "Angle of the rod from the direction of the crank")
        m.output("rod.rate", rod.rate(), "Angular velocity of the rod relative to the crank")
        m.output("slider.distance", slider.coordinate(), "Distance of the slider from the tip of the crank")
        m.output("slider.velocity", slider.rate(), "Velocity of the slider along the rod")
        m.output("crank.angle", crank.angle(), "Angle of the crank")
        m.output("crank.speed", crank.rate(), "Angular velocity of the crank")
        m.output("crank.effort", crank.effort(), "Torque of the drive")
        m.output("energy", m.energy, "Kinetic and potential energy")
        m.output(
            "jacobi_integral", m.jacobi_integral, "Jacobi integral: energy minus crank speed times angular momentum"
        )
        return m

    def terminals(self) -> dict[str, Sequence[str]]:
        """Return the shaft of the crank."""
        return {"crank": ("crank.drive", "crank.effort")}

    def exact(self, times: NDArray[np.float64]) -> dict[str, NDArray[np.float64]] | None:
        """Return the undamped motion without gravity at ``times`` (s); None with damping or gravity."""
        if self.swing_damping > 0.0 or self.slider_damping > 0.0 or self.gravity != 0.0:
            return None
        start = [self.start_angle, self.start_distance, 0.0, 0.0]
        span = (float(times[0]), float(times[-1]))
        solution = scipy.integrate.solve_ivp(
            self.minimal, span, start, method="DOP853", t_eval=times, rtol=2.3e-14, atol=1e-14
        )
        return {"rod.angle": solution.y[0], "slider.distance": solution.y[1]}

    def exact_equilibrium(self) -> dict[str, float] | None:
        """Return theta = 0 and d; None with gravity or at the speed where spring and centrifugal force grow alike."""
        pull = self.slider_mass * self.drive_speed**2
        if self.gravity != 0.0 or pull == self.slider_stiffness:
            return None
        distance = (self.slider_stiffness * self.free_length + pull * self.crank_length) / (
            self.slider_stiffness - pull
        )
        return {"rod.angle": 0.0, "slider.distance": distance}

    def minimal(self, _: float, y: Any) -> list[float]:
        """Return (theta', d', theta'', d'') of the undamped motion, from Lagrange's equations in the rotating frame."""
        theta, d, swing, slide = y
        w, l, m = self.drive_speed, self.crank_length, self.slider_mass
        return [
            swing,
            slide,
            -2.0 * slide * (swing + w) / d - w**2 * l * sin(theta) / d - self.swing_stiffness * theta / (m * d**2),
            d * (swing + w) ** 2 + w**2 * l * cos(theta) - self.slider_stiffness / m * (d - self.free_length),
        ]
