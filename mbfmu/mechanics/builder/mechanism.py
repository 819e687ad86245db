"""The class with which users build a mechanism.

>>> from mbfmu.mechanics import Mechanism, CompiledMechanism, Revolute, rod
>>> m = Mechanism(gravity=(0, -9.81, 0))
>>> bob = m.body("bob", m.ground, Revolute(axis="z"), **rod(mass=1.0, length=1.0))
>>> m.output("bob.angle", bob.angle(), "angle from the horizontal")
>>> compiled = CompiledMechanism(m)

The tree joint places the frame of a body: if all coordinates are zero it coincides with the joint frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mbfmu.mechanics.checks import Vector, inertia_matrix, is_time_law, signal_of, vector
from mbfmu.mechanics.couplings import Coupling
from mbfmu.mechanics.cuts import CutJoint
from mbfmu.mechanics.flexible import Beam, FlexibleBody
from mbfmu.mechanics.flexible.interfaces import CENTER
from mbfmu.mechanics.joints import Floating, Joint, Section
from mbfmu.mechanics.kind import check_element_type
from mbfmu.mechanics.numbers import not_negative
from mbfmu.mechanics.sensors import (
    Energy,
    JacobiIntegral,
    KineticEnergy,
    PotentialEnergy,
    Residual,
    Sensor,
)
from mbfmu.mechanics.signals import Input, Signal, SpeedInput
from mbfmu.util.errors import UserError, missing_attribute, short

from .appearance import Appearance
from .blocks import BlockHandle, sensor_of
from .bodies import UNPLACED, Body, coordinate_of
from .events import Events
from .flexible_handle import FlexibleHandle
from .graph import check_joint
from .handles import CouplingHandle, CutHandle, Mesh
from .joint_handle import JointHandle
from .measurements import Measurements
from .states import StateHandle

# Numbers of five digits: 1.5708 for a right angle is off by 3.7e-6 rad, and a loop has several.
ASSEMBLY_TOLERANCE, MAX_ASSEMBLY_TOLERANCE = 2e-5, 1e-2


class Mechanism(Appearance, Events, Measurements):
    """Mechanism: bodies connected by tree joints from the ground, loop-closing (cut) joints, forces and drives.

    Parameters
    ----------
    gravity
        Acceleration of gravity, global axes, m/s^2; zero: none. A component may be an input without rate, which is held
        between steps, or a signal, a function or an expression of time.
    assembly_tolerance
        Largest error of redundant constraint equations, by rounding of the geometry: angles in rad, lengths relative
        to the length of the loop. Equations that no free motion changes by more than this are left out. If
        combinations of equations are redundant within it, joint frames are corrected so that they close. Both are
        reported. 0: no errors but those of floating-point numbers.

    Attributes
    ----------
    gravity
        Acceleration of gravity (3,), m/s^2; start values of inputs, and zero in place of signals.
    gravity_inputs
        Inputs of gravity, by component.
    gravity_signals
        Signals of gravity, by component. They are loads: the energy contains no potential of theirs.
    """

    def __init__(
        self,
        *,
        gravity: Vector | Sequence[float | Signal | str | Callable[[float], float]] = (0.0, 0.0, 0.0),
        assembly_tolerance: float = ASSEMBLY_TOLERANCE,
    ) -> None:
        self.assembly_tolerance = not_negative("assembly_tolerance", assembly_tolerance)
        if self.assembly_tolerance > MAX_ASSEMBLY_TOLERANCE:
            raise UserError(f"assembly_tolerance is {assembly_tolerance!r}; allowed: 0 to {MAX_ASSEMBLY_TOLERANCE:g}")
        components = np.atleast_1d(np.asarray(gravity, object))
        for given in components:
            if isinstance(given, SpeedInput) or (isinstance(given, Input) and given.rate_name):
                raise UserError(
                    f"gravity is {given!r}; allowed: a number, an input without rate_name, or a signal, a function or "
                    "an expression of time"
                )
        self.gravity_inputs = {k: g for k, g in enumerate(components) if isinstance(g, Input)}
        signals = {k: g for k, g in enumerate(components) if is_time_law(g) and not isinstance(g, Input)}
        varying = {*signals, *self.gravity_inputs}
        starts = {k: g.start for k, g in self.gravity_inputs.items()}
        self.gravity = vector("gravity", [starts.get(k, 0.0) if k in varying else g for k, g in enumerate(components)])
        super().__init__()
        self.gravity_signals = {k: signal_of(g, f"gravity along {'xyz'[k]}") for k, g in signals.items()}
        self.outputs: list[tuple[str, Sensor, str, float | None]] = []
        self.shown_outputs: list[str] = []  # outputs, by name
        self.meshes: list[Mesh] = []  # bodies that elements connect to one another
        self.energy: Sensor = Energy()
        self.kinetic_energy: Sensor = KineticEnergy()
        self.potential_energy: Sensor = PotentialEnergy()
        self.jacobi_integral: Sensor = JacobiIntegral()
        self.position_residual: Sensor = Residual(unit="m")
        self.velocity_residual: Sensor = Residual(unit="m/s", component=1)

    def body(
        self,
        name: str,
        parent: Body | None = None,
        joint: Joint | None = None,
        *,
        mass: float = 0.0,
        com: Vector = (0.0, 0.0, 0.0),
        inertia: Any = (0.0, 0.0, 0.0),
    ) -> Body:
        """Add a body, and connect it to a parent body by a joint.

        Without parent and joint the body is connected by :meth:`joint`, and the program chooses the tree.

        Parameters
        ----------
        name
            Unique name among the bodies.
        parent
            Body of this mechanism or its ground; None: :meth:`joint` connects the body.
        joint
            Tree joint, which places the frame of the body in that of the parent; None: as for ``parent``.
        mass
            Mass, kg; zero is allowed if the motion has inertia from other bodies.
        com
            Center of mass in the body's frame, m.
        inertia
            Inertia about the center of mass, body axes, kg m^2: three principal values or a 3x3 matrix.

        Returns
        -------
        Body
            Handle of the body: parent of other bodies, and source of sensors.

        Raises
        ------
        UserError
            The name is used already, the parent is not a body of this mechanism, or a value is invalid.
        """
        self._new_name("body", name, self._bodies_named)
        if (parent is None) != (joint is None):
            raise UserError(
                f"body {name!r} is given a {'joint and no parent' if parent is None else 'parent and no joint'}; "
                "allowed: both, or neither for a body that Mechanism.joint connects"
            )
        if parent is not None and joint is not None:
            self._member(parent, f"parent of body {name!r}")
            check_joint(f"joint of body {name!r}", joint)
        new = Body(
            name,
            len(self.bodies),
            UNPLACED if parent is None else parent.index,
            Floating() if joint is None else joint,
            not_negative(f"mass of body {name!r}", mass),
            vector(f"com of body {name!r}", com),
            inertia_matrix(name, inertia),
        )
        return self._append(new)

    def flexible_body(
        self,
        name: str,
        parent: Body,
        joint: Joint,
        elastic: Beam | FlexibleBody,
        *,
        start: Sequence[float] | None = None,
        rate: Sequence[float] | None = None,
    ) -> FlexibleHandle:
        """Add a flexible body (beam, or body of finite elements) that is connected to a parent body by a joint.

        Parameters
        ----------
        name
            Unique name among the bodies; its frame is a body of this name.
        parent, joint
            As for :meth:`body`; the joint places the frame of the flexible body: of a beam, whose axis is along x, or
            of the interface that carries the frame.
        elastic
            Beam or body of finite elements, with its modes.
        start, rate
            Amplitudes (modes,) of the modes at the start, m, and their rates, m/s; None: zero. Assembly changes them
            only if the loops cannot close by the other coordinates.

        Returns
        -------
        FlexibleHandle
            Handle of the flexible body: its cross-sections or interfaces carry joints, loads and sensors.

        Raises
        ------
        UserError
            As for :meth:`body`; ``elastic`` is of another class; the joint of a body whose frame is in its center of
            mass is not Floating.
        """
        if not isinstance(elastic, Beam | FlexibleBody):
            raise UserError(f"shape of flexible body {name!r} is {elastic!r}; it must be a Beam or a FlexibleBody")
        if self.gravity_signals:
            raise UserError(
                f"gravity along {'xyz'[next(iter(self.gravity_signals))]} is a signal, and body {name!r} is flexible; "
                "allowed: numbers and inputs. Use an Input, and give its values for the run"
            )
        if isinstance(elastic, FlexibleBody) and elastic.frame == CENTER and not isinstance(joint, Floating):
            raise UserError(
                f"joint of flexible body {name!r} is {type(joint).__name__}, and its frame is in the center of mass, "
                "where no joint can hold it; allowed: Floating, or a frame at an interface"
            )
        body = self.body(name, parent, joint)
        modes = self.add_section(f"{name}.mode", body, Section(elastic=elastic, start=start, rate=rate))
        self.flexible_bodies.append(FlexibleHandle(name, len(self.flexible_bodies), elastic, body, modes, self))
        return self.flexible_bodies[-1]

    def add_section(self, name: str, parent: Body, joint: Section) -> Body:
        """Append a section of a flexible body; users call :meth:`FlexibleHandle.section`.

        Parameters
        ----------
        name
            Unique name among the bodies.
        parent
            Body of the modes.
        joint
            Cross-section.
        """
        self._new_name("body", name, self._bodies_named)
        new = Body(name, len(self.bodies), parent.index, joint)
        return self._append(new)

    def cut(self, name: str, cut: CutJoint, a: Body, b: Body) -> CutHandle:
        """Close a loop with a cut joint between bodies a and b.

        Parameters
        ----------
        name
            Unique name among the cut joints and couplings.
        cut
            Loop-closing joint (cut joint), such as ``RevoluteCutJoint(at_a=..., at_b=...)``.
        a, b
            Bodies of this mechanism or its ground.

        Returns
        -------
        CutHandle
            Handle whose sensors give the forces of the joint.

        Raises
        ------
        UserError
            The name is used already, a body is not one of this mechanism, or the joint is invalid.
        """
        self._new_name("cut", name, self._constraint_names())
        check_element_type(f"cut {name!r}", cut, CutJoint)
        self._member(a, f"body a of cut {name!r}")
        self._member(b, f"body b of cut {name!r}")
        if a is b:
            raise UserError(f"cut {name!r} connects body {a.name!r} to itself; it needs two bodies")
        cut.check(f"cut {name!r}")
        self.cuts.append(CutHandle(name, len(self.cuts), cut, a, b))
        return self.cuts[-1]

    def couple(
        self,
        name: str,
        coupling: Coupling,
        a: Body | JointHandle,
        b: Body | JointHandle,
        *,
        coordinate_a: int | None = None,
        coordinate_b: int | None = None,
    ) -> CouplingHandle:
        """Constrain a coordinate of body a's joint as a function of one of body b's joint, anywhere in the tree.

        Parameters
        ----------
        name
            Unique name among the couplings and cut joints.
        coupling
            Coupling law, such as ``Gear(ratio=-2.0)`` or ``Cam(table)``.
        a, b
            Bodies of this mechanism, whose tree joints are meant, or joints; either joint may be driven.
        coordinate_a, coordinate_b
            Number of the coordinate, from 0, if the joint has several; not one of a quaternion.

        Returns
        -------
        CouplingHandle
            Handle whose sensors give the generalized forces.

        Raises
        ------
        UserError
            The name is used already, a coordinate does not exist, or the law does not fit its unit.
        """
        what = f"coupling {name!r}"
        self._new_name("coupling", name, self._constraint_names())
        check_element_type(what, coupling, Coupling)
        a = self._coordinate_owner(a, f"body a of {what}")
        b = self._coordinate_owner(b, f"body b of {what}")
        k = coordinate_of(f"coordinate_a of {what}", a, coordinate_a)
        l = coordinate_of(f"coordinate_b of {what}", b, coordinate_b)
        if a is b and k == l:
            raise UserError(f"{what} connects the coordinate of body {a.name!r} to itself; it needs two coordinates")
        coupling.check(what)
        coupling.check_unit(what, b.joint.units[l])
        self.couplings.append(CouplingHandle(name, len(self.couplings), coupling, a, b, k, l))
        return self.couplings[-1]

    @property
    def constraints(self) -> list[CutHandle | CouplingHandle]:
        """Cut joints and couplings, in the order of their constraint equations."""
        return [*self.cuts, *self.couplings]

    def output(
        self,
        name: str,
        sensor: Sensor | BlockHandle | StateHandle,
        description: str = "",
        nominal: float | None = None,
    ) -> None:
        """Add an output with a structured name such as ``crank.angle``.

        Parameters
        ----------
        name
            Unique name of the output, in the FMU and in results.
        sensor
            Sensor, such as ``body.angle()`` or ``mechanism.energy``, or a block or a state; it determines the unit.
        description
            Description of the output variable of the FMU.
        nominal
            Nominal value that the FMU states for the output: a typical size in the unit of the sensor; None: it follows
            from the unit and the mechanism.

        Raises
        ------
        UserError
            The name is used already, or the sensor is not one of this mechanism.
        """
        self._new_name("output", name, [o[0] for o in self.outputs])
        sensor = sensor_of(sensor)
        if not isinstance(sensor, Sensor):
            raise UserError(
                f"output {name!r} is {short(sensor)}; allowed: a sensor, such as Body.angle(), a block or a state"
            )
        check_element_type(f"output {name!r}", sensor, Sensor)
        if not isinstance(description, str):
            raise UserError(f"description of output {name!r} is {description!r}; allowed: text")
        self._check_sensor(f"output {name!r}", sensor)
        self.outputs.append((name, sensor, description, nominal))

    def __getattr__(self, name: str) -> object:
        raise missing_attribute("a Mechanism", name)

    def show_outputs(self, *names: str) -> None:
        """Show outputs as text in animations: large on the page, and in pictures and films.

        Parameters
        ----------
        *names
            Names of outputs.

        Raises
        ------
        UserError
            A name is not an output of this mechanism.
        """
        known = [output[0] for output in self.outputs]
        for name in names:
            if name not in known:
                raise UserError(
                    f"show_outputs is given {name!r}, which is not an output of this mechanism; add it with "
                    "output() first"
                )
        self.shown_outputs = list(dict.fromkeys((*self.shown_outputs, *names)))
