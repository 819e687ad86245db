"""Exudyn: rigid bodies with redundant coordinates, joints as constraints, equal steps."""

from __future__ import annotations

from collections.abc import Iterator
from math import cos, pi, sin
from typing import Any

import exudyn as exu
import numpy as np
from exudyn.utilities import (
    Force,
    MarkerBodyPosition,
    RevoluteJoint2D,
    Rigid2D,
    RigidBody2D,
    RigidBodyInertia,
    SensorBody,
)

from .problems import END, FOURBAR, GOVERNOR, GRAVITY, LARGE_INERTIA, PENDULUM, TIMES, Array, Run

NAME = f"Exudyn {exu.GetVersionString()}"
SETTINGS = (
    "`GeneralizedAlpha` (default spectral radius) and `TrapezoidalIndex2`, 1 to 32 equal steps in 10 ms; tolerances of "
    "Newton's method 1e-10 (relative) and 1e-12 (absolute), modified Newton; a hub of 1e9 kg m^2 in place of a "
    "prescribed speed"
)
TINY = 1e-9  # kg and kg m^2, of a body without mass
Vector = tuple[float, float, float]


def turned(angle: float) -> list[list[float]]:
    """Return the axes of a body that is rotated about z."""
    c, s = cos(angle), sin(angle)
    return [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]


class Builder:
    """A system of bodies."""

    def __init__(self, gravity: float) -> None:
        self.container = exu.SystemContainer()
        self.mbs: Any = self.container.AddSystem()
        self.gravity = [0.0, -gravity, 0.0]
        self.ground = self.mbs.CreateGround()

    def body(self, place: Vector, angle: float, mass: float, inertia: Vector, velocity: Vector, spin: Vector) -> Any:
        """Add a body, whose frame is in its center of mass."""
        solid = RigidBodyInertia(mass=mass, com=[0, 0, 0], inertiaTensor=np.diag(inertia))
        return self.mbs.CreateRigidBody(
            referencePosition=list(place),
            referenceRotationMatrix=turned(angle),
            initialVelocity=list(velocity),
            initialAngularVelocity=list(spin),
            inertia=solid,
            gravity=self.gravity,
        )

    def bar(
        self, end: tuple[float, float], angle: float, mass: float, size: float, velocity: Vector, rate: float
    ) -> Any:
        """Add a uniform bar in the plane from one end; ``velocity`` is that of its center."""
        x, y = end[0] + 0.5 * size * cos(angle), end[1] + 0.5 * size * sin(angle)
        node = self.mbs.AddNode(
            Rigid2D(referenceCoordinates=[x, y, angle], initialVelocities=[velocity[0], velocity[1], rate])
        )
        body = self.mbs.AddObject(
            RigidBody2D(physicsMass=mass, physicsInertia=mass * size * size / 12.0, nodeNumber=node)
        )
        center = self.mbs.AddMarker(MarkerBodyPosition(bodyNumber=body, localPosition=[0, 0, 0]))
        self.mbs.AddLoad(Force(markerNumber=center, loadVector=[mass * x for x in self.gravity]))
        return body

    def pin(self, a: Any, at_a: float | Vector, b: Any, at_b: float) -> None:
        """Connect two bars, or the ground and a bar, by a hinge in the plane; points are on the axes of the bars."""
        places = [list(at_a) if isinstance(at_a, tuple) else [at_a, 0, 0], [at_b, 0, 0]]
        markers = [
            self.mbs.AddMarker(MarkerBodyPosition(bodyNumber=body, localPosition=place))
            for body, place in zip((a, b), places, strict=True)
        ]
        self.mbs.AddObject(RevoluteJoint2D(markerNumbers=markers))

    def hinge(self, a: Any, b: Any, place: Vector, axis: Vector = (0.0, 0.0, 1.0)) -> None:
        """Connect two bodies by a hinge at a global place."""
        self.mbs.CreateRevoluteJoint(bodyNumbers=[a, b], position=list(place), axis=list(axis), show=False)


def build(problem: str, loops: int) -> tuple[Builder, list[tuple[Any, Vector]]]:
    """Return a system, and points of bodies by which the angle is found."""
    if problem == "fourbar":
        p = FOURBAR
        m, angle, rate = Builder(p.gravity), p.start_angle, p.start_rate
        a, size = p.crank_length, p.coupler_length
        x, y = a * cos(angle), a * sin(angle)
        swing = (-y * rate, x * rate, 0.0)
        half = (0.5 * swing[0], 0.5 * swing[1], 0.0)
        crank = m.bar((0, 0), angle, p.crank_mass, a, half, rate)
        coupler = m.bar((x, y), 0.0, p.coupler_mass, size, swing, 0.0)
        rocker = m.bar((p.ground_length, 0), angle, p.rocker_mass, p.rocker_length, half, rate)
        m.pin(m.ground, (0, 0, 0), crank, -0.5 * a)
        m.pin(crank, 0.5 * a, coupler, -0.5 * size)
        m.pin(coupler, 0.5 * size, rocker, 0.5 * p.rocker_length)
        m.pin(m.ground, (p.ground_length, 0, 0), rocker, -0.5 * p.rocker_length)
        return m, [(crank, (0.5 * a, 0, 0))]
    if problem == "governor":
        g, w, heavy = GOVERNOR, GOVERNOR.spindle_speed, (LARGE_INERTIA,) * 3
        m, turn = Builder(0.0), (0.0, GOVERNOR.spindle_speed, 0.0)
        hub = m.body((0, 0, 0), 0.0, 1.0, heavy, (0, 0, 0), turn)
        m.hinge(m.ground, hub, (0, 0, 0), (0, 1, 0))
        distance, c, s = g.below_pivot(g.start_angle), cos(g.start_angle), sin(g.start_angle)
        inertia = (0.6 * g.collar_inertia, g.collar_inertia, 0.6 * g.collar_inertia)
        collar = m.body((0, -distance, 0), 0.0, g.collar_mass, inertia, (0, 0, 0), turn)
        m.mbs.CreatePrismaticJoint(bodyNumbers=[hub, collar], position=[0, 0, 0], axis=[0, 1, 0], show=False)
        m.mbs.CreateSpringDamper(
            bodyNumbers=[hub, collar], referenceLength=g.free_length, stiffness=g.stiffness, show=False
        )
        for side in (-1.0, 1.0):
            reach, ball = side * g.arm_length * c, (g.ball_inertia,) * 3
            arm = m.body(
                (reach, -g.arm_length * s, 0), -side * g.start_angle, g.ball_mass, ball, (0, 0, -w * reach), turn
            )
            m.hinge(hub, arm, (0, 0, 0))
            m.mbs.CreateDistanceConstraint(
                bodyNumbers=[arm, collar],
                localPosition0=[side * (g.rod_position - g.arm_length), 0, 0],
                distance=g.rod_length,
                show=False,
            )
        return m, [(arm, (0, 0, 0))]
    if problem == "pendulum":
        d, w, heavy = PENDULUM, PENDULUM.drive_speed, (LARGE_INERTIA,) * 3
        m, turn = Builder(0.0), (0.0, 0.0, PENDULUM.drive_speed)
        l, far = d.crank_length, d.crank_length + d.start_distance
        hub = m.body((0, 0, 0), 0.0, 1.0, heavy, (0, 0, 0), turn)
        rod = m.body((l, 0, 0), 0.0, TINY, (TINY,) * 3, (0, w * l, 0), turn)
        slider = m.body((far, 0, 0), 0.0, d.slider_mass, (TINY,) * 3, (0, w * far, 0), turn)
        m.hinge(m.ground, hub, (0, 0, 0))
        m.hinge(hub, rod, (l, 0, 0))
        m.mbs.CreatePrismaticJoint(bodyNumbers=[rod, slider], position=[l, 0, 0], axis=[1, 0, 0], show=False)
        m.mbs.CreateTorsionalSpringDamper(
            bodyNumbers=[hub, rod], position=[l, 0, 0], axis=[0, 0, 1], stiffness=d.swing_stiffness, show=False
        )
        m.mbs.CreateSpringDamper(
            bodyNumbers=[rod, slider], referenceLength=d.free_length, stiffness=d.slider_stiffness, show=False
        )
        return m, [(hub, (l, 0, 0)), (slider, (0, 0, 0))]
    m = Builder(GRAVITY)
    columns = [m.bar((float(i), 0), 0.5 * pi, 1.0, 1.0, (0.5, 0, 0), -1.0) for i in range(loops + 1)]
    for i, column in enumerate(columns):
        m.pin(m.ground, (float(i), 0, 0), column, -0.5)
    for i in range(loops):
        beam = m.bar((float(i), 1.0), 0.0, 1.0, 1.0, (1.0, 0, 0), 0.0)
        m.pin(columns[i], 0.5, beam, -0.5)
        m.pin(beam, 0.5, columns[i + 1], 0.5)
    return m, [(columns[0], (0.5, 0, 0))]


def angle_of(problem: str, places: list[Array]) -> Array:
    """Return the angle from the places (1001, 3) of the points."""
    if problem == "governor":
        (ball,) = places
        return np.arctan2(-ball[:, 1], np.hypot(ball[:, 0], ball[:, 2]))
    if problem == "pendulum":
        tip, slider = places
        way = slider - tip
        return np.unwrap(np.arctan2(way[:, 1], way[:, 0])) - PENDULUM.drive_speed * TIMES
    return np.unwrap(np.arctan2(places[0][:, 1], places[0][:, 0]))


def runs(problem: str, loops: int) -> Iterator[tuple[str, Run]]:
    """Yield a setting and what runs the problem with it."""
    m, points = build(problem, loops)
    kind = exu.OutputVariableType.Position
    sensors = [
        m.mbs.AddSensor(SensorBody(bodyNumber=b, localPosition=list(p), outputVariableType=kind, storeInternal=True))
        for b, p in points
    ]
    m.mbs.Assemble()
    for solver in ("GeneralizedAlpha", "TrapezoidalIndex2"):
        for parts in (1, 2, 4, 8, 16, 32):
            settings = exu.SimulationSettings()
            motion = settings.timeIntegration
            motion.numberOfSteps, motion.endTime = parts * (len(TIMES) - 1), END
            motion.verboseMode = 0
            motion.newton.useModifiedNewton = True
            motion.newton.relativeTolerance, motion.newton.absoluteTolerance = 1e-10, 1e-12
            settings.solutionSettings.writeSolutionToFile = False
            settings.solutionSettings.sensorsWritePeriod = float(TIMES[1])
            settings.linearSolverType = (
                exu.LinearSolverType.EigenSparse if problem == "a02" else exu.LinearSolverType.EXUdense
            )

            def run(settings: Any = settings, solver: str = solver) -> Array:
                m.mbs.SolveDynamic(settings, solverType=getattr(exu.DynamicSolverType, solver))
                places = [np.asarray(m.mbs.GetSensorStoredData(sensor))[:, 1:] for sensor in sensors]
                return angle_of(problem, places)

            yield f"{solver} {parts}", run
