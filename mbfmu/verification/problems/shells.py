"""Shells and plates: displacements and buckling loads of problems of the literature."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import Mechanism
from mbfmu.steady.equilibrium import equilibrium
from mbfmu.verification.mechanisms import plates, shells
from mbfmu.verification.mechanisms.shells import LoadedShell
from mbfmu.verification.problem import Source, Value

Array = NDArray[np.float64]
COOK = Source(
    "R. D. Cook, D. S. Malkus, M. E. Plesha", 1989, "Concepts and applications of finite element analysis. Wiley"
)
MACNEAL = Source(
    "R. H. MacNeal, R. L. Harder",
    1985,
    "A proposed standard set of problems to test finite element accuracy. Finite Elements in Analysis and Design 1, "
    "3-20",
    "https://doi.org/10.1016/0168-874X(85)90003-4",
)
SIMO = Source(
    "J. C. Simo, D. D. Fox, M. S. Rifai",
    1989,
    "On a stress resultant geometrically exact shell model, part II. Computer Methods in Applied Mechanics and "
    "Engineering 73, 53-92",
    "https://doi.org/10.1016/0045-7825(89)90098-4",
)
SZE = Source(
    "K. Y. Sze, X. H. Liu, S. H. Lo",
    2004,
    "Popular benchmark problems for geometric nonlinear analysis of shells. Finite Elements in Analysis and Design 40, "
    "1551-1569",
    "https://doi.org/10.1016/j.finel.2003.11.001",
)


class PublishedShell(NamedTuple):
    """Shell, its mesh, and the error that the mesh causes.

    Attributes
    ----------
    name, description
        See :class:`Problem`.
    build
        Returns the shell.
    source
        Publication of the displacements.
    allowed
        Largest difference from the published displacements, relative to the largest of them.
    is_quick
        Whether ``--quick`` contains the problem.
    """

    name: str
    description: str
    build: Callable[[], LoadedShell]
    source: Source
    allowed: float
    is_quick: bool = False


PUBLISHED_SHELLS = (
    PublishedShell(
        "Cook's membrane",
        "Tapered panel, clamped at one side, with a force in its plane; linear; 8 x 8 skewed cells.",
        partial(shells.cook, 8),
        COOK,
        2e-2,
        is_quick=True,
    ),
    PublishedShell(
        "sheared strip",
        "Cantilever strip of 10 x 1 x 0.1 with a force across its end, which moves by two thirds of the length; "
        "12 x 1 cells.",
        partial(shells.sheared_strip, (12, 1)),
        SZE,
        2e-3,
        is_quick=True,
    ),
    PublishedShell(
        "slit annulus",
        "Ring of radii 6 and 10 with a slit, one lip clamped and the other one lifted by 17; 30 x 6 cells.",
        partial(shells.slit_annulus, (30, 6)),
        SZE,
        1.5e-2,
    ),
    *(
        PublishedShell(
            f"twisted strip, {axis}, {thickness:g}",
            f"Cantilever strip, twisted by 90 degrees, with a force along {axis} at its end; thickness {thickness:g}; "
            "linear; 24 x 4 warped cells.",
            partial(shells.twisted_strip, (24, 4), axis, thickness),
            source,
            2e-2,
            is_quick=thickness == 0.32,
        )
        for thickness, source in ((0.32, MACNEAL), (0.0032, SIMO))
        for axis in "zy"
    ),
    PublishedShell(
        "pinched hemisphere, linear",
        "Hemisphere with a hole, which four small forces at its rim pull and push; 16 x 16 cells of a quarter.",
        partial(shells.pinched_hemisphere, 16, 0.02),
        MACNEAL,
        1e-2,
    ),
    PublishedShell(
        "pinched hemisphere",
        "The same hemisphere with forces of 400, which move points by 0.8 of the radius; 12 x 12 cells.",
        partial(shells.pinched_hemisphere, 12, 400.0),
        SZE,
        5e-2,
    ),
    PublishedShell(
        "pulled cylinder",
        "Cylinder with free ends that two forces pull apart, from bending to stretching; 8 x 12 cells of an eighth.",
        partial(shells.pulled_cylinder, (8, 12)),
        SZE,
        1.5e-2,
    ),
)


def mechanism_of(build: Callable[[], LoadedShell]) -> Mechanism:
    """Return the mechanism of a shell."""
    return build().mechanism


def displacements_of(build: Callable[[], LoadedShell], m: Mechanism) -> Array:
    """Return the displacements that were published, as computed."""
    return np.array(list(build().displacements(equilibrium(m).outputs).values()))


def published_displacements(build: Callable[[], LoadedShell]) -> Array:
    """Return the published displacements."""
    return np.array(list(build().published.values()))


BUCKLING_CELLS = 16

SHELL_PROBLEMS = (
    *(
        Value(
            name=shell.name,
            description=shell.description,
            sources=(shell.source,),
            quantity="Displacements",
            unit="unit of the source",
            derivation="published values of three or four digits",
            build=partial(mechanism_of, shell.build),
            measure=partial(displacements_of, shell.build),
            method="equilibrium",
            reference=partial(published_displacements, shell.build),
            uncertainty=1e-4,
            allowed=shell.allowed,
            is_quick=shell.is_quick,
        )
        for shell in PUBLISHED_SHELLS
    ),
    *(
        Value(
            name=f"buckling of a {edges} plate",
            description=f"Plate of {1e3 * length:g} x {1e3 * width:g} x 1 mm, compressed between {edges} edges, others "
            f"free; {BUCKLING_CELLS} cells along its length.",
            quantity="Buckling load by that of a strip (Euler)",
            unit="1",
            derivation="method of Ritz with 144 functions",
            build=partial(plates.compressed_plate, edges, BUCKLING_CELLS, 0.8, plates.ROOTS[0]),
            measure=lambda _, edges=edges: np.array(  # type: ignore[misc]
                [plates.buckling_load(edges, BUCKLING_CELLS, plates.ROOTS[0])]
            ),
            method="modes",
            reference=lambda edges=edges: np.array([plates.ritz_buckling_load(edges)]),  # type: ignore[misc]
            uncertainty=1e-6,
            allowed=2e-2,
            is_quick=False,
        )
        for edges, (length, width) in plates.PLATES.items()
    ),
)
