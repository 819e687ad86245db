"""A flexible body of finite elements: its construction from matrices, meshes and files, and its own files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics.checks import flag
from mbfmu.util.errors import UserError

from .construction import Frame, ReductionOptions, reduced_values
from .matrix_files import read_model
from .mesh import assemble
from .reduced_body import ReducedBody
from .saved_bodies import OPTIONAL_ARRAYS, invariants_of, read_body, write_body

Array = NDArray[np.float64]

_SAVED = ("com", "inertia", "frequencies", "damping", "nodes", "shapes", "stiffening", "modal_masses")


@dataclass(frozen=True, kw_only=True, eq=False)
class FlexibleBody(ReducedBody):
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
