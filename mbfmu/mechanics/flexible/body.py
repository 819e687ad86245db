"""A flexible body of finite elements: its reduced modes, and what the dynamics need of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.checks import flag
from mbfmu.mechanics.numbers import array_of, is_whole
from mbfmu.util.errors import UserError

from .construction import Frame, ReductionOptions, extent, reduced_values
from .invariants import PAIRS, Invariants
from .matrix_files import read_model
from .mesh import assemble
from .recovery import von_mises
from .saved_bodies import OPTIONAL_ARRAYS, invariants_of, read_body, write_body

Array = NDArray[np.float64]
Keep = Callable[[Any], int]  # keeps numbers in Arrays.numbers, returns where they begin

_SAVED = ("com", "inertia", "frequencies", "damping", "nodes", "shapes", "stiffening", "modal_masses")


@dataclass(frozen=True, kw_only=True, eq=False)
class FlexibleBody:
    """Flexible body of finite elements, reduced to modes.

    :meth:`from_fe`, :meth:`from_mesh`, :meth:`from_files` and :meth:`load` return it.

    Attributes
    ----------
    frame
        Name of the interface whose frame is the frame of the body, or ``"center"``.
    mass, com, inertia
        Mass, kg, center of mass (3,), m, and inertia about it (3, 3), kg m^2, undeformed, in the frame of the body.
    frequencies
        Natural frequencies (modes,), rad/s, with the frame fixed; with the frame in the center of mass, of the
        free body.
    damping
        Damping ratios (modes,).
    modal_masses
        Modal masses (modes,), kg, for the scale of the shapes.
    nodes
        Positions (n, 3) of the nodes in the frame of the body, m.
    shapes
        Displacements (n, 3, modes) of the nodes by unit amplitudes. The largest displacement of a mode, or the largest
        rotation of a node times the size of the body, is 1 m.
    interfaces
        Frames of the interfaces by name.
    stiffening
        Whether the body has geometric stiffening.
    triangles
        Nodes (k, 3) of the triangles of the surface, of bodies of :meth:`from_mesh`; None: unknown.
    stress_shapes
        Stresses (n, 6, modes) at the nodes by unit amplitudes, Pa/m, frame of the body: xx, yy, zz, xy, xz, yz. None:
        not computed, see ``stresses`` of :meth:`from_mesh`.
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

    @classmethod
    def from_fe(
        cls,
        mass_matrix: Any,
        stiffness_matrix: Any,
        nodes: Any,
        interfaces: Mapping[str, Any],
        *,
        modes: int | None = None,
        frequency_limit: float | None = None,
        frame: str = "",
        damping: float | Sequence[float] | Callable[[Array], Array] = 0.0,
        geometric_stiffness: Callable[[Array], Any] | None = None,
    ) -> FlexibleBody:
        """Reduce a finite element model by the method of Craig and Bampton.

        Parameters
        ----------
        mass_matrix, stiffness_matrix
            Consistent mass matrix and stiffness matrix (N, N) of the body without supports, sparse or dense, in kg, m
            and N. A node has three degrees of freedom (displacements) or six (displacements and rotations about x, y,
            z); the order is node by node.
        nodes
            Positions (n, 3) of the nodes, m; N = 3 n or 6 n.
        interfaces
            Names of the interfaces with their nodes, counted from 0, or with an :class:`Interface`. Joints, forces and
            sensors of the mechanism act on them.
        modes
            Number of modes with fixed interfaces, from the lowest; six for every interface but that of the frame are
            added to them. None without a frequency limit: 10, or as many as there are.
        frequency_limit
            Frequency up to which modes with fixed interfaces are used, rad/s; in place of ``modes``.
        frame
            Name of the interface whose frame is the frame of the body; empty: the first one. ``"center"``: the frame
            is in the center of mass and follows the mean motion of the body, for bodies that are connected by cut
            joints only, or fly freely.
        damping
            Damping ratio of the modes: one number, one for every mode, or a function of the frequencies (modes,),
            rad/s.
        geometric_stiffness
            Optional effect: function that returns the geometric stiffness matrix (N, N), symmetric, for the stresses
            of static displacements (N,), linear in these; positive for tension. It is reliable if the frame of the body
            is held or driven: if the frame moves freely and little mass is connected to it, the mass matrix may be
            indefinite at displacements of one percent of the size of the body. None: no geometric stiffening.

        Returns
        -------
        FlexibleBody
            Body for :meth:`Mechanism.flexible_body`.

        Raises
        ------
        UserError
            A matrix is not symmetric, not that of a free body, or indefinite; an interface has no nodes or too few; a
            name or a number is not allowed.

        Notes
        -----
        R. R. Craig, M. C. C. Bampton: Coupling of substructures for dynamic analyses. AIAA Journal 6 (1968), 1313-1319,
        doi:10.2514/3.4741.
        """
        values = reduced_values(
            mass_matrix,
            stiffness_matrix,
            nodes,
            interfaces,
            geometric_stiffness,
            ReductionOptions(modes=modes, frequency_limit=frequency_limit, frame=frame, damping=damping),
        )
        return cls(**values)

    @classmethod
    def from_mesh(
        cls,
        mesh: Any,
        density: float,
        young: float,
        poisson: float,
        interfaces: Mapping[str, Any],
        *,
        length_unit: str = "m",
        stiffening: bool = False,
        stresses: bool = False,
        **options: Unpack[ReductionOptions],
    ) -> FlexibleBody:
        """Assemble a solid body of one isotropic material from a mesh, and reduce it.

        Parameters
        ----------
        mesh
            Path of a mesh in a format of meshio, such as Gmsh, Abaqus, VTK or Nastran, or a ``meshio.Mesh``, of
            tetrahedra or hexahedra. The packages meshio and scikit-fem are required (extra ``fe``).
        density, young, poisson
            Density, kg/m^3, Young's modulus, Pa, and Poisson's ratio.
        interfaces
            As for :meth:`from_fe`; nodes are the name of a set of faces or nodes in the mesh, or a function that
            returns for positions (n, 3), m, which of them belong to the interface.
        length_unit
            Unit of the positions in the mesh: ``"m"``, ``"cm"``, ``"mm"`` or ``"in"``.
        stiffening
            Optional effect: geometric stiffening, with the limits of ``geometric_stiffness`` of :meth:`from_fe`.
        stresses
            Compute the stresses by the modes at all nodes, for :meth:`stress` and
            :meth:`.FlexibleHandle.stress`: six numbers for each node and mode.
        **options
            ``modes``, ``frequency_limit``, ``frame`` and ``damping`` as for :meth:`from_fe`.

        Returns
        -------
        FlexibleBody
            Body for :meth:`Mechanism.flexible_body`.

        Raises
        ------
        UserError
            The mesh cannot be read or has no solid cells, a set does not exist, or as for :meth:`from_fe`.
        """
        if not isinstance(interfaces, Mapping):
            raise UserError(f"interfaces are {interfaces!r}; allowed: names with their nodes")
        flag("stiffening", stiffening)
        flag("stresses", stresses)
        found = assemble(mesh, density, young, poisson, interfaces, length_unit)
        body = cls.from_fe(
            found.M,
            found.K,
            found.nodes,
            found.interfaces,
            geometric_stiffness=found.geometric_stiffness if stiffening else None,
            **options,
        )
        shapes = found.stresses(body.shapes.reshape(-1, body.modes)) if stresses else None
        return replace(body, triangles=found.triangles, stress_shapes=shapes)

    @classmethod
    def from_files(
        cls,
        mass: str | Path,
        stiffness: str | Path,
        deck: str | Path,
        interfaces: Mapping[str, Any],
        *,
        rows: str | Path | None = None,
        length_unit: str = "m",
        **options: Unpack[ReductionOptions],
    ) -> FlexibleBody:
        """Reduce a body whose matrices Abaqus, CalculiX or Nastran has written.

        Parameters
        ----------
        mass, stiffness
            Paths of the matrices of the body without supports: of Abaqus (``*MATRIX OUTPUT, FORMAT=MATRIX INPUT``);
            ``job.mas`` and ``job.sti`` of CalculiX (``*FREQUENCY, SOLVER=MATRIXSTORAGE``); or punch files of Nastran
            with real symmetric ``DMIG`` matrices, whose names begin with M and K, such as MAAX and KAAX. Both may be in
            one file.
        deck
            Path of the input deck, whose blocks ``*NODE`` or entries ``GRID`` give the positions of the nodes. Nodes
            that belong to no element are left out.
        interfaces
            As for :meth:`from_fe`; nodes are the numbers of the deck, or a function that returns for positions (n, 3),
            m, which of them belong to the interface.
        rows
            Path of ``job.dof`` of CalculiX; None: the matrices are those of another program.
        length_unit
            ``"m"`` (kg, m, N), or ``"mm"`` for models in t, mm and N.
        **options
            ``modes``, ``frequency_limit``, ``frame`` and ``damping`` as for :meth:`from_fe`.

        Returns
        -------
        FlexibleBody
            Body for :meth:`Mechanism.flexible_body`.

        Raises
        ------
        UserError
            A file cannot be read, or one of its lines, which the message names, is wrong; or as for :meth:`from_fe`.
        """
        found = read_model(mass, stiffness, deck, rows, length_unit)
        return cls.from_fe(
            found.M,
            found.K,
            found.nodes,
            {name: found.interface(name, given) for name, given in interfaces.items()},
            **options,
        )

    def save(self, path: str | Path) -> None:
        """Write the reduced body to a file ``.npz``; an existing file is replaced when the new one is complete.

        Parameters
        ----------
        path
            Path of the file.

        Raises
        ------
        UserError
            The file cannot be written.
        """
        frames = list(self.interfaces.values())
        arrays = {name: np.asarray(getattr(self, name), float) for name in _SAVED}
        arrays |= {name: np.array([getattr(frame, name) for frame in frames]) for name in Frame._fields}
        arrays |= {name: np.asarray(value, float) for name, value in self._invariants._asdict().items()}
        arrays |= {name: getattr(self, name) for name in OPTIONAL_ARRAYS if getattr(self, name) is not None}
        write_body(Path(path), {"frame": self.frame}, list(self.interfaces), arrays)

    @classmethod
    def load(cls, path: str | Path) -> FlexibleBody:
        """Read a body that :meth:`save` has written.

        Parameters
        ----------
        path
            Path of the file.

        Raises
        ------
        UserError
            The file cannot be read, is damaged, or has another version.
        """
        found = read_body(Path(path))
        frames = {str(name): Frame(*(found[key][k] for key in Frame._fields)) for k, name in enumerate(found["names"])}
        values = {name: found[name] for name in _SAVED} | {"stiffening": bool(found["stiffening"])}
        values |= {name: found[name] for name in OPTIONAL_ARRAYS if name in found}
        return cls(
            frame=str(found["frame"]),
            mass=float(found["mass"]),
            interfaces=frames,
            _invariants=invariants_of(found),
            **values,
        )

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
