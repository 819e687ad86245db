"""Controllers and motors."""

from __future__ import annotations

from typing import Any, cast

import numpy as np

from mbfmu.mechanics.loads import JointForce
from mbfmu.mechanics.loads.base import FirstOrderState
from mbfmu.mechanics.numbers import finite, positive
from mbfmu.mechanics.sensors import Sensor
from mbfmu.util.errors import UserError

from .blocks import BlockHandle, Blocks, limits_of
from .bodies import Body, effort_unit
from .joint_handle import JointHandle


class MotorHandle(BlockHandle):
    """Handle of a DC motor, as returned by :meth:`.Mechanism.dc_motor`."""

    def current(self) -> Sensor:
        """Return the current of the armature winding, A."""
        return self.value(0)

    def torque(self) -> Sensor:
        """Return the torque (N m) or force (N) on the joint coordinate, behind the gear."""
        return self.value(1)


class Controllers(Blocks):
    """Base of :class:`.Mechanism`: controllers and motors, which are blocks."""

    def pid(
        self,
        name: str,
        target: Any,
        measured: Any,
        *,
        proportional: float = 0.0,
        integral: float = 0.0,
        derivative: float = 0.0,
        rate: Any = None,
        filter_time: float | None = None,
        lower: float | None = None,
        upper: float | None = None,
        tracking_time: float | None = None,
        start: float = 0.0,
        nominal: float = 1.0,
        unit: str = "1",
    ) -> BlockHandle:
        """Add a PID controller with limits of its output and anti-windup by back-calculation.

        With the error e = target - measured the output is u = ``proportional`` e + I + D within its limits. The
        integral part is I' = ``integral`` e + (u - w) / ``tracking_time``, where w is the output without limits. The
        derivative part D is ``-derivative`` times ``rate``, or ``derivative`` times s e / (``filter_time`` s + 1).

        Parameters
        ----------
        name
            Unique name among the blocks.
        target, measured
            Inputs, both in one unit.
        proportional, integral, derivative
            Gains, in units of the output per unit of the error, the latter two per second and times seconds.
        rate
            Rate of the measured quantity, such as ``arm.rate()``; the target has no influence on D then.
        filter_time
            Time constant of the filter of the derivative, s, in place of ``rate``. D starts at a value that
            corresponds to an error of zero before the start.
        lower, upper
            Limits of the output, in its unit; None: no limit on that side.
        tracking_time
            Time constant of back-calculation, s: the integral part follows the limit with it. Default: Ti =
            ``proportional`` / ``integral`` without derivative, else sqrt(Ti Td) with Td = ``derivative`` /
            ``proportional`` (Astrom and Hagglund 2006).
        start
            Value of the integral part at the start, in the unit of the output and within its limits.
        nominal
            Typical size of the output, in its unit.
        unit
            Unit of the output in the notation of FMI.

        Returns
        -------
        BlockHandle
            Handle of the block, with the states ``integral`` and ``derivative`` as far as it has these parts.

        Raises
        ------
        UserError
            As for :meth:`lag`; or a gain is missing, or the limits or the derivative part are not defined.
        """
        what = f"block {name!r}"
        kp, ki, kd = (
            finite(f"{key} of {what}", gain)
            for key, gain in (("proportional", proportional), ("integral", integral), ("derivative", derivative))
        )
        if not (kp or ki or kd):
            raise UserError(f"{what} has no gain; give it proportional, integral or derivative")
        if kd and (rate is None) == (filter_time is None):
            raise UserError(
                f"{what} has a derivative part, with {'neither rate nor' if rate is None else 'both rate and'} "
                "filter_time; allowed: one of the two"
            )
        if not kd and (rate is not None or filter_time is not None):
            raise UserError(f"{what} has a rate or a filter_time, and no derivative part; give it derivative, too")
        limits, tracking = limits_of(what, lower, upper), np.inf
        if tracking_time is not None:
            tracking = positive(f"tracking_time of {what}", tracking_time)
        elif limits is not None and ki:
            tracking = kp / ki if not kd or not kp else np.sqrt(abs(kd / ki))
            if not tracking > 0.0:
                raise UserError(
                    f"{what} has limits, and no tracking_time follows from proportional={kp!r} and integral={ki!r}; "
                    "give it tracking_time"
                )
        T = 0.0 if filter_time is None else positive(f"filter_time of {what}", filter_time)
        if not ki and finite(f"start of {what}", start):
            raise UserError(f"{what} has a start of its integral part, and no integral part; give it integral, too")
        has_integral, direct = bool(ki), kp + (kd / T if T else 0.0)
        n = has_integral + bool(T)
        inputs = {"target": target, "measured": measured, **({} if rate is None else {"rate": rate})}
        A, B, C, D = np.zeros((n, n)), np.zeros((n, len(inputs))), np.ones((1, n)), np.zeros((1, len(inputs)))
        D[0, :2] = direct, -direct
        if rate is not None:
            D[0, 2] = -kd
        K, states = np.zeros((n, 1)), []
        if has_integral:
            B[0, :2], K[0] = (ki, -ki), 1.0 / tracking
            begin = finite(f"start of {what}", start)
            if begin and limits is not None and not limits[0] <= begin <= limits[1]:
                raise UserError(
                    f"start of {what} is {start!r}, and its output is limited to {limits[0]:g} to {limits[1]:g}; "
                    "allowed: a value within the limits. Give another start or other limits"
                )
            states.append(FirstOrderState(name="integral", unit=unit, start=begin, nominal=nominal))
        if T:  # x' = (kd e / T - x) / T, D = kd e / T - x
            A[-1, -1], B[-1, :2], C[0, -1] = -1.0 / T, (kd / T**2, -kd / T**2), -1.0
            states.append(FirstOrderState(name="derivative", unit=unit, nominal=nominal))
        return self._linear(name, inputs, A, B, C, D, None, [], [unit], limits=limits, K=K, states=states)

    def dc_motor(
        self,
        name: str,
        joint: Body | JointHandle,
        voltage: Any,
        *,
        resistance: float,
        inductance: float,
        torque_constant: float,
        ratio: float = 1.0,
        start_current: float = 0.0,
        nominal_current: float = 1.0,
    ) -> MotorHandle:
        """Add a DC motor with permanent magnets on a joint coordinate.

        With the current i and the rate w of the joint: L i' + R i + k N w = voltage, and the torque on the joint is
        k N i. Its rotor inertia J is the ``armature`` N^2 J of the joint, see :class:`.Revolute`. There is no friction.

        Parameters
        ----------
        name
            Unique name among the blocks, and among the forces and loads.
        joint
            Body whose tree joint it drives, or joint; it has one coordinate.
        voltage
            Input, V: number, signal, input, controller, ...
        resistance, inductance
            Resistance R, ohm, and inductance L, H, of the winding.
        torque_constant
            Torque constant k, N m/A, which is also the voltage constant in V s/rad.
        ratio
            Ratio N of the gear: rate of the rotor divided by that of the joint, negative for a reversal; in 1/m if the
            coordinate is a displacement.
        start_current
            Current at the start of a run, A.
        nominal_current
            Typical size of the current, A.

        Returns
        -------
        MotorHandle
            Handle with the sensors ``current`` and ``torque``.

        Raises
        ------
        UserError
            As for :meth:`lag`; or a parameter is not positive.
        """
        what = f"block {name!r}"
        if np.ndim(inductance) == 0 and inductance == 0.0:
            raise UserError(
                f"inductance of {what} is {inductance!r}; allowed: greater than zero, since the current is a state of "
                "the motor. Without inductance use a JointForce with the law k N (voltage - k N w) / R of the rate w "
                "of the joint in place of the motor, or give an inductance whose time constant L / R is short"
            )
        R, L, k = (
            positive(f"{key} of {what}", value)
            for key, value in (
                ("resistance", resistance), ("inductance", inductance), ("torque_constant", torque_constant),
            )
        )  # fmt: skip
        gear = finite(f"ratio of {what}", ratio)
        if not gear:
            raise UserError(f"ratio of {what} is 0; allowed: a number that is not zero")
        self._new_name("force", name, self._loads_named())
        owner = self._coordinate_owner(joint, f"joint of {what}")
        if owner.joint.nv != 1:
            raise UserError(f"{what} needs a joint of one coordinate; that of {owner.name!r} has {owner.joint.nv}")
        current = FirstOrderState(
            name="current",
            unit="A",
            start=finite(f"start_current of {what}", start_current),
            nominal=positive(f"nominal_current of {what}", nominal_current),
        )
        A, B = np.array([[-R / L]]), np.array([[1.0 / L, -k * gear / L]])
        C, D = np.array([[1.0], [k * gear]]), np.zeros((2, 2))
        units = ["A", effort_unit(owner.joint.units[0])]
        inputs = {"voltage": voltage, "rate": joint.rate()}
        motor = self._linear(name, inputs, A, B, C, D, None, [], units, states=[current], handle=MotorHandle)
        self.force(name, JointForce(motor.value(1)), joint)
        return cast("MotorHandle", motor)
