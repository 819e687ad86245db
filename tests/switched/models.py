"""The mechanisms of :mod:`drawn` as models of mbfmu."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any

import mbfmu as mb

from .drawn import FREEDOM, GROUND, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL, Drawn, Friction, Part, Sensor, Wave

JOINTS: dict[str, Any] = {
    REVOLUTE: mb.Revolute,
    PRISMATIC: mb.Translational,
    UNIVERSAL: mb.Universal,
    SPHERICAL: mb.Spherical,
}
DIRECTIONS = {1: "up", -1: "down", 0: "both"}


@dataclass(frozen=True, kw_only=True)
class DrawnModel(mb.Model):
    """A drawn mechanism; the stiffness of its joint springs can be changed by a factor."""

    name = "drawn"
    drawn: Any = None
    stiffness: float = mb.parameter(1.0, min=0.0, tunable=True)

    def build(self) -> mb.Mechanism:
        d: Drawn = self.drawn
        m = mb.Mechanism(gravity=tuple(d.gravity))
        bodies: list[Any] = []
        for k, part in enumerate(d.parts):
            parent = m.ground if part.parent == GROUND else bodies[part.parent]
            options = {"com": tuple(part.com), "inertia": part.inertia}
            body = m.body(f"body{k}", parent, joint(d, part), mass=part.mass, **options)
            bodies.append(body)
            add_outputs(m, d, k, body)
        add_forces(m, d, bodies, self.stiffness)
        for event in d.events:
            then = [action(bodies, a) for a in event.actions]
            if event.sensor is None:
                m.event(event.name, at=event.value, then=then)
            else:
                seen = sensor(bodies, event.sensor)
                m.event(event.name, seen, crosses=event.value, direction=DIRECTIONS[event.direction], then=then)
        return m


def wave(w: Wave) -> Any:
    return mb.Harmonic(mean=w.mean, amplitude=w.amplitude, frequency=w.frequency / (2.0 * pi), phase=w.phase)


def joint(d: Drawn, part: Part) -> Any:
    options: dict[str, Any] = {"at": tuple(part.at), "rotation": part.frame}
    if part.kind != SPHERICAL:
        options["axis"] = tuple(part.axes[0])
    if part.kind == UNIVERSAL:
        options["second"] = tuple(part.axes[1])
    if part.kind == PRISMATIC:
        options["nominal"] = d.length
    if part.drive:
        return JOINTS[part.kind](**options, drive=wave(part.drive))
    start, rate = (float(x[0]) if len(x) == 1 else tuple(x) for x in (part.start, part.rate))
    return JOINTS[part.kind](**options, start=start, rate=rate)


def add_outputs(m: mb.Mechanism, d: Drawn, k: int, body: Any) -> None:
    """Coordinates of joints, and for ball joints the center of mass."""
    if d.parts[k].kind == SPHERICAL:
        for axis in "xyz":
            m.output(f"body{k}.{axis}", body.position(axis, point=tuple(d.parts[k].com)))
        return
    for c in range(FREEDOM[d.parts[k].kind]):
        m.output(f"body{k}.q{c}", body.coordinate(c))


def add_forces(m: mb.Mechanism, d: Drawn, bodies: list[Any], factor: float) -> None:
    for k, part in enumerate(d.parts):
        if part.elastic:
            stiffness, damping, free = part.elastic
            m.force(f"spring{k}", mb.JointSpring(stiffness=factor * stiffness, damping=damping, free=free), bodies[k])
        if part.load:
            push = mb.Input(name=f"load{k}", unit="N" if part.kind == PRISMATIC else "N.m", start=part.load.mean)
            m.force(f"push{k}", mb.JointForce(push), bodies[k])
            if part.load.amplitude:
                shaken = Wave(0.0, part.load.amplitude, part.load.frequency, part.load.phase)
                m.force(f"shake{k}", mb.JointForce(wave(shaken)), bodies[k])
        if part.limits:
            lower, upper, stiffness, damping = part.limits
            stop = mb.JointStop(lower=lower, upper=upper, stiffness=stiffness, damping=damping)
            m.force(f"limit{k}", stop, bodies[k])
    for i, friction in enumerate(d.frictions):
        m.force(f"friction{i}", rubbed(d, i, friction), bodies[friction.part])
    for i, line in enumerate(d.lines):
        a, b = (m.ground if end == GROUND else bodies[end] for end in line.ends)
        ends = {"at_a": tuple(line.points[0]), "at_b": tuple(line.points[1])}
        law = mb.Spring(stiffness=line.stiffness, damping=line.damping, free=line.free, **ends)
        m.force(f"line{i}", law, a, b) if a is not m.ground else m.force(
            f"line{i}",
            mb.Spring(
                stiffness=line.stiffness,
                damping=line.damping,
                free=line.free,
                at_a=ends["at_b"],
                at_b=ends["at_a"],
            ),
            b,
            a,
        )


def rubbed(d: Drawn, i: int, f: Friction) -> Any:
    options: dict[str, Any] = {"coulomb": f.coulomb, "viscous": f.viscous, "deflection": f.deflection}
    if f.static > f.coulomb:
        options |= {"static": f.static, "stribeck": f.stribeck}
    if f.normal.amplitude:
        options["normal_force"] = wave(f.normal)
    else:
        options["normal_force"] = mb.Input(name=f"grip{i}", unit="N", start=f.normal.mean)
    if d.parts[f.part].kind == SPHERICAL:
        return mb.SphericalFriction(**options)
    return mb.JointFriction(**options, coordinate=f.coordinate)


def sensor(bodies: list[Any], s: Sensor) -> Any:
    body = bodies[s.part]
    if s.kind == "position":
        return body.position("xyz"[s.axis], point=tuple(s.point))
    return body.rate() if s.kind == "rate" else body.coordinate()


def action(bodies: list[Any], a: tuple[Any, ...]) -> Any:
    what, *rest = a
    if what == "bounce":
        return mb.Bounce(rest[0])
    if what == "load":
        return mb.SetInput(f"load{rest[0]}", rest[1])
    if what == "grip":
        return mb.SetInput(f"grip{rest[0]}", rest[1])
    if what == "impulse":
        return mb.Impulse(bodies[rest[0]], rest[1])
    if what == "stiffness":
        return mb.SetParameter("stiffness", rest[0])
    if what == "end":
        return mb.EndRun()
    return mb.Lock(bodies[rest[0]]) if what == "lock" else mb.Release(bodies[rest[0]])
