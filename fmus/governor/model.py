"""Governor (Haug 1989, section 12.6): two arms with balls on a spindle lift a sprung collar as they swing out.

The spindle turns about the vertical y axis. The arms are hinged at one point of it and swing in the plane x-y of the
spindle; two rods tie their middles to the collar. With phi the angle of both arms below the horizontal and s the
collar's distance below the arms' pivot,

    s(phi) = a sin phi + sqrt(L^2 - (a cos phi)^2),     a: pivot to rod on the arm,  L: rod

the motion at constant speed w has one degree of freedom and the potential

    V(phi) = k (s - s0)^2 / 2 - m w^2 (b cos phi)^2 - g (2 m b sin phi + m_c s),      b: pivot to ball

whose stationary points are the steady states. With the arms vertical both rods lose their hold on the arms: a singular
position, where a branch on which the arms move unequally crosses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, pi, sin, sqrt
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics import (
    DistanceCutJoint,
    Input,
    JointForce,
    JointSpring,
    Mechanism,
    Revolute,
    SpeedInput,
    Translational,
)
from mbfmu.modeling import Model, parameter


@dataclass(frozen=True, kw_only=True)
class Governor(Model):
    """Flyball governor on a spindle, driven at constant speed or free with a torque input."""

    name = "governor"
    stop_time = 10.0
    output_interval = 0.01
    settling = MappingProxyType({"damping": 100.0})

    driven: bool = parameter(
        True, structural=True, doc="Spindle driven at a speed; false: free spindle with a torque input"
    )
    spindle_speed: float = parameter(
        11.0174, unit="rad/s", doc="Initial speed of the spindle; start value of the input spindle.drive if driven"
    )
    gravity: float = parameter(9.81, unit="m/s2", doc="Acceleration of gravity, downward", tunable=True)
    start_angle: float = parameter(0.0, unit="rad", doc="Initial angle of the arms below the horizontal")
    arm_length: float = parameter(0.16, unit="m", min=1e-3, doc="Length of an arm, from pivot to ball")
    rod_position: float = parameter(
        0.08, unit="m", min=1e-3, doc="Distance on the arm from pivot to the pin of the rod"
    )
    rod_length: float = parameter(0.10922, unit="m", min=1e-3, doc="Length of a rod between arm and collar")
    pivot_height: float = parameter(0.2, unit="m", doc="Height of the pivots of the arms")
    ball_mass: float = parameter(1.0, unit="kg", min=0.0, doc="Mass of each ball")
    ball_inertia: float = parameter(
        0.1, unit="kg.m2", min=0.0, doc="Moment of inertia of each ball about any axis through its center"
    )
    collar_mass: float = parameter(1.0, unit="kg", min=0.0, doc="Mass of the collar")
    collar_inertia: float = parameter(
        0.125, unit="kg.m2", min=0.0, doc="Moment of inertia of the collar about the spindle axis"
    )
    spindle_inertia: float = parameter(
        50.0, unit="kg.m2", min=0.0, doc="Moment of inertia of the spindle about its axis; used if it is free"
    )
    stiffness: float = parameter(
        1000.0, unit="N/m", min=0.0, doc="Stiffness of the spring between spindle and collar", tunable=True
    )
    free_length: float = parameter(
        0.15, unit="m", min=0.0, doc="Free length of the spring, from the pivots of the arms", tunable=True
    )
    damping: float = parameter(
        0.0, unit="N.s/m", min=0.0, doc="Coefficient of the damper between spindle and collar", tunable=True
    )

    def build(self) -> Mechanism:
        """Return the mechanism: y upward, the spindle's foot at the origin."""
        m = Mechanism(gravity=(0.0, -self.gravity, 0.0))
        speed = SpeedInput(
            name="spindle.drive", unit="rad/s", description="Speed of the driven spindle", start=self.spindle_speed
        )
        turn: dict[str, Any] = {"drive": speed} if self.driven else {"rate": self.spindle_speed}
        inertia = (0.5 * self.spindle_inertia, self.spindle_inertia, 0.5 * self.spindle_inertia)
        spindle = m.body(
            "spindle", m.ground, Revolute(axis="y", at=(0.0, self.pivot_height, 0.0), **turn), inertia=inertia
        )
        arms = []
        for name, side in (("arm1", -1.0), ("arm2", 1.0)):  # both angles grow downward
            joint = Revolute(axis=(0.0, 0.0, -side), start=self.start_angle, fixed=True)
            com, ball = (side * self.arm_length, 0.0, 0.0), (self.ball_inertia,) * 3
            arms.append(m.body(name, spindle, joint, mass=self.ball_mass, com=com, inertia=ball))
        collar = m.body(
            "collar",
            spindle,
            Translational(axis=(0.0, -1.0, 0.0), start=self.below_pivot(self.start_angle)),
            mass=self.collar_mass,
            inertia=(0.6 * self.collar_inertia, self.collar_inertia, 0.6 * self.collar_inertia),
        )
        rods = [
            m.cut(
                f"rod{i}",
                DistanceCutJoint(at_a=(side * self.rod_position, 0.0, 0.0), length=self.rod_length),
                arms[i - 1],
                collar,
            )
            for i, side in ((1, -1.0), (2, 1.0))
        ]
        m.force("spring", JointSpring(stiffness=self.stiffness, damping=self.damping, free=self.free_length), collar)
        if not self.driven:
            torque = Input(name="spindle.torque", unit="N.m", description="Torque on the spindle")
            m.force("motor", JointForce(magnitude=torque), spindle)

        m.output("collar.height", collar.position("y"), "Height of the collar")
        m.output("collar.distance", collar.coordinate(), "Distance of the collar below the pivots of the arms")
        m.output("collar.velocity", collar.velocity("y"), "Velocity of the collar, upward")
        for arm in arms:
            m.output(f"{arm.name}.angle", arm.angle(), f"Angle of {arm.name} below the horizontal")
            m.output(f"{arm.name}.rate", arm.rate(), f"Angular velocity of {arm.name}")
        m.output("spindle.angle", spindle.angle(), "Angle of the spindle")
        m.output("spindle.speed", spindle.rate(), "Angular velocity of the spindle")
        if self.driven:
            m.output("spindle.effort", spindle.effort(), "Torque of the drive")
        for rod in rods:
            m.output(f"{rod.name}.force", rod.force(), f"Force in {rod.name}, positive in compression")
        m.output("energy", m.energy, "Kinetic and potential energy")
        m.output(
            "jacobi_integral",
            m.jacobi_integral,
            "Jacobi integral: energy minus spindle speed times angular momentum if driven",
        )
        m.output("position_residual", m.position_residual, "Largest closure error of the rods")
        m.output("velocity_residual", m.velocity_residual, "Largest rate of the closure error of the rods")
        return m

    def terminals(self) -> dict[str, Sequence[str]]:
        """Return the spindle."""
        driven = ("spindle.drive", "spindle.effort")
        return {"spindle": driven if self.driven else ("spindle.angle", "spindle.speed", "spindle.torque")}

    def below_pivot(self, angle: float) -> float:
        """Return the collar's distance below the pivot, m, with both arms at ``angle`` (rad)."""
        reach = self.rod_length**2 - (self.rod_position * cos(angle)) ** 2
        return self.rod_position * sin(angle) + sqrt(max(0.0, reach))

    def exact(self, times: NDArray[np.float64]) -> dict[str, NDArray[np.float64]] | None:
        """Return the undamped motion of phi at ``times`` (s); None with damping or a free spindle."""
        if not self.driven or self.damping > 0.0:
            return None
        start = [self.start_angle, 0.0]
        span = (float(times[0]), float(times[-1]))
        solution = scipy.integrate.solve_ivp(
            self.minimal, span, start, method="DOP853", t_eval=times, rtol=2.3e-14, atol=1e-14
        )
        angle = solution.y[0]
        return {"arm1.angle": angle, "arm2.angle": angle}

    def exact_equilibrium(self) -> dict[str, float]:
        """Return the stable state between arms horizontal and vertical, from the stationary potential."""
        phi = float(
            scipy.optimize.brentq(
                lambda x: self.minimal(0.0, [x, 0.0])[1], 0.0, 0.5 * pi - 1e-6, xtol=1e-15, rtol=1e-15
            )
        )
        return {"arm1.angle": phi, "arm2.angle": phi, "collar.distance": self.below_pivot(phi)}

    def minimal(self, _: float, y: Any) -> list[float]:
        """Return (phi', phi'') of the undamped motion at constant speed: d/dt (I phi') = I' phi'^2 / 2 - V'."""
        phi, rate = y
        c, s = cos(phi), sin(phi)
        a, b, m, mc = self.rod_position, self.arm_length, self.ball_mass, self.collar_mass
        root = sqrt(self.rod_length**2 - (a * c) ** 2)
        first = a * c + a * a * c * s / root  # ds/dphi
        second = -a * s + a * a * (c * c - s * s) / root - (a * a * c * s) ** 2 / root**3
        inertia = 2.0 * (m * b * b + self.ball_inertia) + mc * first**2
        distance = a * s + root
        force = (
            -self.stiffness * (distance - self.free_length) * first - 2.0 * m * (self.spindle_speed * b) ** 2 * c * s
        )
        force += self.gravity * (2.0 * m * b * c + mc * first)
        return [rate, (force - mc * first * second * rate**2) / inertia]

    def branch_gap(self, outputs: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64] | None:
        """Return how far the arms are from moving equally, rad."""
        return np.abs(outputs["arm1.angle"] - outputs["arm2.angle"])
