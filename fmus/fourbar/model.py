"""Four-bar linkage: crank, coupler and rocker as a chain of revolutes, closed at the rocker's ground pivot.

With equal cranks and a coupler as long as the ground link it is a parallelogram. It then swings as a pendulum,

    (m_crank l^2/3 + m_rocker l^2/3 + m_coupler l^2) theta'' = tau - ((m_crank + m_rocker)/2 + m_coupler) g l cos theta,

and is singular whenever all links lie on one line: there Phi_q loses rank, and a branch on which crank and rocker turn
against each other crosses the true motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, radians
from types import MappingProxyType
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics import MODES, Beam, Body, CutHandle, Input, JointForce, Mechanism, Revolute, RevoluteCutJoint, rod
from mbfmu.modeling import Model, parameter
from mbfmu.util.errors import UserError


@dataclass(frozen=True, kw_only=True)
class FourBar(Model):
    """Four-bar linkage in a vertical plane that swings through its singular configurations."""

    name = "fourbar"
    stop_time = 10.0
    output_interval = 0.01
    effects = MappingProxyType(
        {
            "gravity": {"gravity": 9.81},
            "elastic coupler": {"coupler_modes": 2},
            "material damping": {"coupler_damping": 5e-4},
        }
    )

    ground_length: float = parameter(3.0, unit="m", min=1e-3, doc="Distance between the two ground pivots")
    crank_length: float = parameter(1.0, unit="m", min=1e-3, doc="Length of the crank, from pivot to pin")
    coupler_length: float = parameter(3.0, unit="m", min=1e-3, doc="Length of the coupler, from pin to pin")
    rocker_length: float = parameter(1.0, unit="m", min=1e-3, doc="Length of the rocker, from pin to pivot")
    crank_mass: float = parameter(8.019, unit="kg", min=0.0, doc="Mass of the crank, a uniform slender bar")
    coupler_mass: float = parameter(24.057, unit="kg", min=0.0, doc="Mass of the coupler, a uniform slender bar")
    rocker_mass: float = parameter(8.019, unit="kg", min=0.0, doc="Mass of the rocker, a uniform slender bar")
    start_angle: float = parameter(radians(10.0), unit="rad", doc="Initial angle of the crank above the horizontal")
    start_rate: float = parameter(0.0, unit="rad/s", doc="Initial angular velocity of the crank")
    gravity: float = parameter(9.81, unit="m/s2", doc="Acceleration of gravity, downward", tunable=True)
    crank_torque: float = parameter(0.0, unit="N.m", doc="Start value of the input crank.torque")
    coupler_modes: int = parameter(
        0,
        min=0,
        max=MODES,
        structural=True,
        resolution=(1, 2, 4),
        doc="Number of bending modes of the coupler, pinned at both ends; 0: rigid",
    )
    coupler_elements: int = parameter(
        10, min=1, max=1000, resolution=(5, 10, 20), doc="Number of finite elements with which the modes are computed"
    )
    coupler_height: float = parameter(
        0.03, unit="m", min=1e-6, doc="Height of the cross-section of an elastic coupler, in the plane"
    )
    coupler_width: float = parameter(
        0.03, unit="m", min=1e-6, doc="Width of the cross-section of an elastic coupler, out of the plane"
    )
    youngs_modulus: float = parameter(117e9, unit="Pa", min=1.0, doc="Young's modulus of an elastic coupler")
    coupler_damping: float = parameter(
        0.0,
        unit="s",
        min=0.0,
        doc="Damping time of the coupler material: moment = E I (curvature + damping time x curvature rate)",
    )

    def build(self) -> Mechanism:
        """Return the mechanism: motion in the x-y plane, y upward, crank pivot at the origin."""
        angle, rate, L = self.start_angle, self.start_rate, self.coupler_length
        m = Mechanism(gravity=(0.0, -self.gravity, 0.0))
        crank = m.body(
            "crank",
            m.ground,
            Revolute(start=angle, rate=rate, fixed=True),
            **rod(mass=self.crank_mass, length=self.crank_length),
        )
        pin = Revolute(at=(self.crank_length, 0.0, 0.0), start=-angle, rate=-rate)
        if self.coupler_modes == 0:
            coupler = middle = tip = m.body("coupler", crank, pin, **rod(mass=self.coupler_mass, length=L))
            at_middle, at_tip = (0.5 * L, 0.0, 0.0), (L, 0.0, 0.0)
        else:
            elastic = m.flexible_body("coupler", crank, pin, self._beam())
            m.profile(elastic, height=self.coupler_height, width=self.coupler_width)
            coupler, middle, tip = elastic.body, elastic.section(0.5 * L), elastic.section(L)
            at_middle = at_tip = (0.0, 0.0, 0.0)
        rocker = m.body(  # its x axis points from the ground pivot to the pin, as the crank's does
            "rocker",
            tip,
            Revolute(at=at_tip, start=angle, rate=rate),
            **rod(mass=self.rocker_mass, length=-self.rocker_length),
        )
        pivot = m.cut(
            "pivot",
            RevoluteCutJoint(at_a=(self.ground_length, 0.0, 0.0), at_b=(-self.rocker_length, 0.0, 0.0)),
            m.ground,
            rocker,
        )
        torque = Input(name="crank.torque", unit="N.m", description="Torque on the crank", start=self.crank_torque)
        m.force("motor", JointForce(magnitude=torque), crank)
        self._outputs(m, (crank, coupler, rocker), middle, at_middle, pivot)
        return m

    def _outputs(
        self, m: Mechanism, bars: Sequence[Body], middle: Body, at_middle: Sequence[float], pivot: CutHandle
    ) -> None:
        """Publish the bars' angles, the coupler's middle and its bending, the force at the pivot, energy, residuals."""
        for bar in bars:
            m.output(f"{bar.name}.angle", m.turn(bar), f"Angle of the {bar.name} above the horizontal")
        for bar in bars:
            m.output(f"{bar.name}.rate", m.turn_rate(bar), f"Angular velocity of the {bar.name}")
        for axis, direction in (("x", "horizontal"), ("y", "vertical")):
            m.output(
                f"coupler.position.{axis}",
                middle.position(axis, at_middle),
                f"Position of the middle of the coupler, {direction}",
            )
            m.output(
                f"coupler.velocity.{axis}",
                middle.velocity(axis, at_middle),
                f"Velocity of the middle of the coupler, {direction}",
            )
            m.output(
                f"coupler.acceleration.{axis}",
                middle.point_acceleration(axis, at_middle),
                f"Acceleration of the middle of the coupler, {direction}",
            )
            on_ground = pivot.joint_force(axis, on="a")
            m.output(f"pivot.force.{axis}", on_ground, f"Force of the rocker on its ground pivot, {direction}")
        for elastic in m.flexible_bodies:
            for k in range(self.coupler_modes):
                mode = f"coupler.mode[{k + 1}]"
                m.output(
                    f"{mode}.amplitude", elastic.modes.coordinate(k), f"Largest deflection of bending mode {k + 1}"
                )
                m.output(f"{mode}.rate", elastic.modes.rate(k), f"Rate of bending mode {k + 1}")
                m.output(f"{mode}.acceleration", elastic.modes.acceleration(k), f"Acceleration of bending mode {k + 1}")
            x = 0.5 * self.coupler_length
            m.output(
                "coupler.deflection",
                elastic.deflection(x),
                "Deflection of the middle of the coupler from its chord, to the left",
            )
            m.output("coupler.bending_moment", elastic.moment(x), "Bending moment in the middle of the coupler")
        m.output("energy", m.energy, "Kinetic and potential energy, zero at the height of the pivots")
        m.output("position_residual", m.position_residual, "Closure error of the loop")
        m.output("velocity_residual", m.velocity_residual, "largest rate at which the loop opens")

    def _beam(self) -> Beam:
        """Return the elastic coupler: its chord keeps its length, which preserves the singular configurations."""
        if self.coupler_mass == 0.0:
            raise UserError(
                f"coupler_mass is 0.0 kg; with coupler_modes = {self.coupler_modes} it must be greater than zero"
            )
        return Beam(
            length=self.coupler_length,
            mass=self.coupler_mass,
            bending_stiffness=self.youngs_modulus * self.coupler_width * self.coupler_height**3 / 12.0,
            modes=self.coupler_modes,
            elements=self.coupler_elements,
            damping=self.coupler_damping,
        )

    def arrays(self) -> dict[str, Sequence[Any]]:
        """Return the modal coordinates of an elastic coupler, their rates and accelerations."""
        modes = range(1, self.coupler_modes + 1)
        told = ("amplitude", "rate", "acceleration")
        return {f"coupler.mode.{what}": [f"coupler.mode[{k}].{what}" for k in modes] for what in told if modes}

    def terminals(self) -> dict[str, Sequence[str]]:
        """Return the shaft of the crank."""
        return {"crank": ("crank.angle", "crank.rate", "crank.torque")}

    @property
    def is_parallelogram(self) -> bool:
        """Whether the linkage swings as a pendulum."""
        return self.crank_length == self.rocker_length and self.ground_length == self.coupler_length

    def exact(self, times: NDArray[np.float64]) -> dict[str, NDArray[np.float64]] | None:
        """Return the exact angles at ``times`` (s) under the start torque; None where no closed motion is known."""
        if not self.is_parallelogram or self.coupler_modes > 0:
            return None
        l, g = self.crank_length, self.gravity
        bars = self.crank_mass + self.rocker_mass
        inertia = (bars / 3.0 + self.coupler_mass) * l**2
        weight = (0.5 * bars + self.coupler_mass) * g * l

        def pendulum(_: float, y: Any) -> list[float]:
            return [y[1], (self.crank_torque - weight * cos(y[0])) / inertia]

        start = [self.start_angle, self.start_rate]
        span = (float(times[0]), float(times[-1]))
        solution = scipy.integrate.solve_ivp(
            pendulum, span, start, method="DOP853", t_eval=times, rtol=2.3e-14, atol=1e-14
        )
        angle = solution.y[0]
        return {"crank.angle": angle, "coupler.angle": np.zeros_like(angle), "rocker.angle": angle}

    def branch_gap(self, outputs: Mapping[str, NDArray[np.float64]]) -> NDArray[np.float64] | None:
        """Return how far the motion is from the parallelogram's branch: |crank angle - rocker angle|, rad."""
        if not self.is_parallelogram:
            return None
        return np.abs(outputs["crank.angle"] - outputs["rocker.angle"])
