"""A reduced flexible body: its modes, what the dynamics need of them, and displacements and stresses by amplitudes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.numbers import array_of, is_whole
from mbfmu.util.errors import UserError

from .construction import Frame, extent
from .invariants import PAIRS, Invariants
from .recovery import von_mises

Array = NDArray[np.float64]
Keep = Callable[[Any], int]  # keeps numbers in Arrays.numbers, returns where they begin


@dataclass(frozen=True, kw_only=True, eq=False)
class ReducedBody:
    """Body whose displacements are combinations of modes.

    The attributes are described in :class:`.FlexibleBody`, whose constructors set them.
    """

    frame: str
    mass: float
    com: Array
    inertia: Array
    frequencies: Array
    damping: Array
    nodes: Array
    shapes: Array
    interfaces: Mapping[str, Frame]
    stiffening: bool
    modal_masses: Array
    _invariants: Invariants
    triangles: NDArray[np.int64] | None = None
    stress_shapes: Array | None = None

    @property
    def modes(self) -> int:
        """Number of modes."""
        return len(self.frequencies)

    @property
    def size(self) -> float:
        """Largest extent of the mesh along an axis, m."""
        return extent(self.nodes)

    @property
    def is_damped(self) -> bool:
        """Whether a mode is damped."""
        return bool(np.any(self.damping))

    def interface(self, name: Any) -> Frame:
        """Return the frame of an interface.

        Parameters
        ----------
        name
            Name of the interface.

        Raises
        ------
        UserError
            No interface has this name.
        """
        if not isinstance(name, str) or name not in self.interfaces:
            raise UserError(f"interface is {name!r}; allowed: {', '.join(map(repr, self.interfaces))}")
        return self.interfaces[name]

    def displaced(self, amplitudes: Any, scale: float = 1.0) -> Array:
        """Return the positions of the nodes of the deformed body.

        Parameters
        ----------
        amplitudes
            Amplitudes (modes,) of the modes, m.
        scale
            Factor of the displacements.

        Returns
        -------
        Array
            Positions (n, 3) in the frame of the body, m.
        """
        p = array_of("amplitudes", amplitudes)
        if p.shape != (self.modes,):
            raise UserError(f"amplitudes have the shape {p.shape}; allowed: ({self.modes},)")
        return self.nodes + scale * self.shapes @ p

    def stress(self, amplitudes: Any) -> Array:
        """Return the stresses at all nodes.

        Parameters
        ----------
        amplitudes
            Amplitudes (..., modes) of the modes, m, such as those of all times of a result.

        Returns
        -------
        Array
            Components xx, yy, zz, xy, xz, yz (..., n, 6) in the frame of the body, Pa.

        Raises
        ------
        UserError
            The body was made without stresses, or there are not as many amplitudes as modes.
        """
        p = array_of("amplitudes", amplitudes)
        if p.ndim == 0 or p.shape[-1] != self.modes:
            raise UserError(f"amplitudes have the shape {p.shape}; allowed: (..., {self.modes})")
        return np.asarray(np.moveaxis(np.tensordot(self._stresses(), p, (2, -1)), (0, 1), (-2, -1)))

    def von_mises_stress(self, amplitudes: Any) -> Array:
        """Return the equivalent stresses of von Mises (..., n) at all nodes, Pa; arguments as for :meth:`stress`.

        Parameters
        ----------
        amplitudes
            Amplitudes (..., modes) of the modes, m.
        """
        return von_mises(self.stress(amplitudes))

    def stress_weights(self, node: Any) -> Array:
        """Return the stresses (6, modes) at a node by unit amplitudes, Pa/m.

        Parameters
        ----------
        node
            Number of a node, or a position (3,) in the frame of the body, m, whose nearest node is used.
        """
        shapes = self._stresses()
        place = array_of("node", node)
        if place.shape == (3,) and np.all(np.isfinite(place)):
            return shapes[np.argmin(np.linalg.norm(self.nodes - place, axis=1))]
        if not is_whole(node) or not 0 <= node < len(self.nodes):
            raise UserError(
                f"node is {node!r}; allowed: a number from 0 to {len(self.nodes) - 1}, or a position x, y, z, m"
            )
        return shapes[int(node)]

    def _stresses(self) -> Array:
        if self.stress_shapes is None:
            raise UserError(
                "the flexible body has no stresses; they are computed by FlexibleBody.from_mesh(..., stresses=True)"
            )
        return self.stress_shapes

    def fill(self, record: Any, keep: Keep) -> None:
        """Write inertia and stiffness for kernels.

        Parameters
        ----------
        record
            Record of the type ``FlexibleRecord``.
        keep
            Function that keeps numbers and returns where they begin.
        """
        found, mu, omega = self._invariants, self.modal_masses, self.frequencies
        J0 = [found.J0[pair] for pair in PAIRS]
        own = np.vstack([found.S1, found.h1, found.J1, mu, mu * omega**2, 2.0 * self.damping * mu * omega])
        matrices = [found.J2, found.C, *((found.G, found.H) if self.stiffening else ())]
        parts = [[found.mass], found.S0, J0, own.T, *matrices]
        record["at"] = keep(np.concatenate([np.ravel(part) for part in parts]))
        record["modes"], record["shortens"] = self.modes, self.modes if self.stiffening else 0

    def fill_frame(self, record: Any, keep: Keep) -> None:
        """Write the frame of the body as a section for kernels.

        Parameters
        ----------
        record
            Record of the type ``NodeRecord``.
        keep
            As for :meth:`fill`.
        """
        record["at"] = keep(np.zeros(3 + 6 * self.modes))
        record["x"] = self.size

    def fill_node(self, name: Any, record: Any, keep: Keep) -> None:
        """Write an interface for kernels.

        Parameters
        ----------
        name
            Name of the interface.
        record
            Record of the type ``NodeRecord``.
        keep
            As for :meth:`fill`.
        """
        frame = self.interface(name)
        record["at"] = keep(
            np.concatenate([frame.at, frame.motion.T.ravel(), self.stiffening * frame.shortening.ravel()])
        )
        record["shortens"], record["x"] = self.modes if self.stiffening else 0, np.linalg.norm(frame.at)
