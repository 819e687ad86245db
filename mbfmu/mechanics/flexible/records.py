"""Records of flexible bodies: planar beams, and bodies of finite elements."""

from __future__ import annotations

from typing import Annotated

from solvers.compiled.record import Reals, Record, f8, i8

MODES = 12  # most of one beam


class FlexibleRecord(Record):
    """A flexible body by its modes; everything about the origin of its frame. The data of a body of finite elements are
    in Arrays.numbers (:mod:`.solid`), the fields from ``mass`` on are those of a beam (:mod:`.planar`).
    """

    body: i8  # its first node: the frame
    modes: i8
    qi: i8  # the amplitudes in State.q and State.v
    vi: i8
    at: i8  # of a body of finite elements: place of its data in Arrays.numbers; -1: a beam
    shortens: i8  # 0: no geometric stiffening, else the number of modes
    mass: f8  # kg
    X1: f8  # kg m, first and second moment along the axis
    X2: f8  # kg m^2
    a: Annotated[Reals, (MODES,)]  # kg, momentum of a mode
    c: Annotated[Reals, (MODES,)]  # kg m, its angular momentum about the origin
    mu: Annotated[Reals, (MODES,)]  # kg, modal mass
    kappa: Annotated[Reals, (MODES,)]  # N/m, modal stiffness
    beta: f8  # s, damping time of the material
    g0: Annotated[Reals, (MODES, MODES)]  # kg/m, kg: shortening in the first and second moment
    g1: Annotated[Reals, (MODES, MODES)]


class NodeRecord(Record):
    """A section of a flexible body: a cross-section of a beam, or an interface of a body of finite elements."""

    at: i8  # of an interface: place of its data in Arrays.numbers; -1: a cross-section
    shortens: i8
    x: f8  # place on the axis, m; of an interface, a length of the body
    phi: Annotated[Reals, (MODES,)]  # deflection of each mode at amplitude 1
    slope: Annotated[Reals, (MODES,)]  # 1/m, turn
    moment: Annotated[Reals, (MODES,)]  # N, bending moment per amplitude
    G: Annotated[Reals, (MODES, MODES)]  # 1/m, shortening from the frame to here
