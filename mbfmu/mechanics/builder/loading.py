"""Forces and other loads on the bodies of a mechanism."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.elements import Plate, Shell
from mbfmu.mechanics.kind import check_element_type
from mbfmu.mechanics.loads import Drag, Force, Load, Pressure
from mbfmu.util.errors import UserError

from .bodies import Body
from .handles import ForceHandle
from .members import Members


class Acting(NamedTuple):
    """A load, what messages call it, and the bodies it acts on."""

    what: str
    load: Load
    bodies: tuple[Body, ...]

    @property
    def tied(self) -> tuple[Body, ...]:
        """Those that the structured tangent ties to each other."""
        return self.bodies[: len(self.bodies) - self.load.n_untied_bodies]


class Loading(Members):
    """Base of :class:`.Mechanism`: forces, plate elements, pressures and other loads."""

    def __init__(self) -> None:
        super().__init__()
        self.forces: list[tuple[str, Load, Body, Body]] = []
        self.plates: list[tuple[Plate | Shell, tuple[Body, Body, Body, Body]]] = []
        self.pressures: list[tuple[str, Pressure, list[tuple[Body, ...]]]] = []
        self.others: list[Acting] = []  # loads, by their name

    def force(self, name: str, force: Force, a: Body, b: Body | None = None) -> ForceHandle:
        """Add a force on body a (and b); joint forces act on the tree joint of a.

        Parameters
        ----------
        name
            Unique name among the forces and loads.
        force
            Force element, such as :class:`.Spring` or :class:`.JointForce`.
        a, b
            Bodies of this mechanism; b is the ground by default. Elements of a joint coordinate, such as
            :class:`.JointForce`, act on the tree joint of a, which has one coordinate.

        Returns
        -------
        ForceHandle
            Handle whose sensors give the force.

        Raises
        ------
        UserError
            The name is used already, a body is not one of this mechanism, or the element is invalid.
        """
        self._new_name("force", name, self._loads_named())
        check_element_type(f"force {name!r}", force, Force)
        self._member(a, f"body a of force {name!r}")
        other = self.ground if b is None else b
        self._member(other, f"body b of force {name!r}")
        if force.on_joint and a.joint.nv != 1:
            raise UserError(f"force {name!r} needs a joint of one coordinate; that of {a.name!r} has {a.joint.nv}")
        if not force.on_joint and a is other:
            raise UserError(f"force {name!r} acts between body {a.name!r} and itself; it needs two bodies")
        force.check(f"force {name!r}")
        self.forces.append((name, force, a, other))
        return ForceHandle(name, len(self.forces) - 1, force, a, other)

    def plate(self, plate: Plate | Shell, a: Body, b: Body, c: Body, d: Body) -> None:
        """Add a plate element between bodies at its corners (0, 0), (a, 0), (a, b), (0, b) of their x-z plane.

        Parameters
        ----------
        plate
            Plate or shell element.
        a, b, c, d
            Four different bodies at the corners, in this order.
        """
        if not isinstance(plate, Plate | Shell):
            raise UserError(f"plate is {plate!r}; it must be a Plate or a Shell")
        plate.check("a plate")
        nodes = (a, b, c, d)
        self._corners("a plate", nodes)
        self.plates.append((plate, nodes))

    def pressure(self, name: str, magnitude: Any, faces: Iterable[Sequence[Body]]) -> None:
        """Add a pressure on surfaces, along their normals in the deformed position.

        Parameters
        ----------
        name
            Unique name among the pressures.
        magnitude
            Pressure, Pa: number, signal or input; positive along y of a flat face.
        faces
            Four bodies per face, in the order of the corners of a plate.
        """
        self._new_name("pressure", name, [p[0] for p in self.pressures])
        quads = [tuple(face) for face in faces]
        for corners in quads:
            self._corners(f"a face of pressure {name!r}", corners)
        self.pressures.append((name, Pressure(magnitude=magnitude), quads))

    def load(self, name: str, load: Load, *bodies: Body) -> None:
        """Add a load of any type on the required number of bodies; :meth:`force` and :meth:`plate` are shorter.

        Parameters
        ----------
        name
            Unique name among the forces and loads.
        load
            Load, for instance a user-defined element.
        bodies
            Bodies of this mechanism, in the order that the load requires.
        """
        self._new_name("load", name, self._loads_named())
        check_element_type(f"load {name!r}", load, Load)
        for body in bodies:
            self._member(body, f"a body of load {name!r}")
        if not bodies:
            raise UserError(f"load {name!r} acts on no body; give it the bodies it acts on")
        load.check(f"load {name!r}")
        self.others.append(Acting(name, load, bodies))

    def load_all(self, name: str, loads: Sequence[tuple[Load, tuple[Body, ...]]]) -> int:
        """Add loads of one name, each on its bodies, such as those of the cells of a sheet.

        Parameters
        ----------
        name
            Unique name among the forces and loads.
        loads
            Pairs of a load and the bodies on which it acts.

        Returns
        -------
        int
            Number of the first of these loads among ``others``.
        """
        self._new_name("load", name, self._loads_named())
        for load, bodies in loads:
            check_element_type(f"load {name!r}", load, Load)
            for body in bodies:
                self._member(body, f"a body of load {name!r}")
        self.others += [Acting(name, load, bodies) for load, bodies in loads]
        return len(self.others) - len(loads)

    def _loads_named(self) -> list[str]:
        return [*(f[0] for f in self.forces), *(a.what for a in self.others)]

    def loads(self) -> Iterator[Acting]:
        """Yield the loads: forces, then plates, then pressures, then other loads."""
        for name, force, a, b in self.forces:
            yield Acting(f"force {name!r}", force, (a, b))
        for plate, corners in self.plates:
            yield Acting("a plate", plate, corners)
        for plate, corners in self.plates:
            if plate.drag > 0.0:
                yield Acting("drag on a plate", Drag(density=plate.drag, area=plate.area), corners)
        for name, pressure, faces in self.pressures:
            for face in faces:
                yield Acting(f"pressure {name!r}", pressure, face)
        for name, load, bodies in self.others:
            yield Acting(f"load {name!r}", load, bodies)

    @property
    def cells(self) -> NDArray[np.int64]:
        """(P, 4), bodies at the corners of the plates."""
        return np.array([[body.index for body in corners] for _, corners in self.plates], np.int64).reshape(-1, 4)

    def _corners(self, what: str, nodes: tuple[Body, ...]) -> None:
        """Refuse what does not span a surface."""
        for body in nodes:
            self._member(body, f"corner of {what}")
        if len({body.index for body in nodes}) < 4 or len(nodes) > 4:
            raise UserError(f"corners of {what} are {[body.name for body in nodes]}; it needs four bodies")
