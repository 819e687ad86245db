"""The builder of flexible sheets: a grid of nodal bodies on geodesic joints, with plate elements between them.

>>> m = Mechanism(gravity=(0, -9.81, 0))
>>> sheet = add_sheet(
...     m, "sheet", length=0.3, width=0.21, thickness=0.3e-3, youngs_modulus=1e10, poisson=0.3, density=1000.0,
...     grid=(7, 5), supports=[Support("x1", "clamped")],
... )
>>> m.output("tip", sheet.node(0, 2).position("y"), "height of the free edge")

In its own frame the flat sheet fills 0 <= x <= length, 0 <= z <= width; its normal is y. Node (i, k) of the grid lies
at x = i a, z = k b. A node has the mass of its cell, half a cell at a border and a quarter at a corner, the center of
mass in the middle of the cell (so off the node at a border) and the rotary inertia m (c^2 + t^2) / 12 of a rigid one,
which leaves explicit steps 12 to 95 times as long as the plate's own m t^2 / 12.

**Trees.** ``spine`` and ``rows`` grow from the first support, whose nodes are connected to its body: ``rows`` as chains
across the sheet; ``spine`` as one chain from the middle of the support, with ribs to both sides. ``master`` is the
paper's: a node in the middle floats, or is connected to a given body, with spine and ribs around it, and every support
is made of cut joints. A chain cannot stretch, so what resists stretching (membrane) matters across chains only.
``rows`` is the tree for load in the plane, which every row carries; of ``spine`` the spine carries it alone.

**Effects.** Bending is always included; membrane, damping, drag and pressure are optional. Bending alone
converges to a sheet that resists no Gaussian curvature, because nothing resists shear in its plane nor stretching
across the chains; membrane does, and leaves out the strain along rows or ribs, of which there is none. It may see the
strain along a chain only with joints that keep the length of the sheet (:mod:`.joints.geodesic`): those of projected
length would lock.

**Stretch.** Along its chains the sheet cannot stretch, which is right where it bends one way, and wrong where it is
held twice or curved both ways. With ``stretch`` a node has all six motions against its neighbor in the tree
(:mod:`.joints.stretching`), and elements are shells (:class:`.Shell`). Supports hold their nodes by joints of their
own, and edges may be held against each other. Waves in the plane are hundreds of times faster than bending, so it takes
an implicit solver. (Nodes on the ground, each by itself, would be as many unknowns; but a sheet that hardly stretches
moves along curves in those, and Newton takes five times as many steps to its rest.)

**Paper.** Of a material with a grain, stiffness differs along and across it, and a grain askew couples bending with
twist (:mod:`.elements.material`). A curled sheet is not flat where nothing bends it; it starts flat all the same, under
stress, or at rest if an equilibrium is computed. Thickness and curl may be functions of the place: a cell takes
them at its center, and the mass of a node at the center of its area. Creases are lines that bend more easily
(:mod:`.section_properties`).

**Rows of cells.** An element measures stretching by means over its edges. One row of cells across the chains has one
mean for the whole width: the sheet folds along its chain, is then stiff as an angle bar, and stays so though it would
hang lower and with less energy unfolded. With membrane two rows of cells are the least.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.builder.mechanism import Mechanism
from mbfmu.mechanics.checks import Vector, flag, one_of
from mbfmu.mechanics.joints import Joint
from mbfmu.mechanics.numbers import array_of, is_whole, positive
from mbfmu.sheets.elements import Plate
from mbfmu.sheets.joints import Geodesic, OutOfPlane, Stretching
from mbfmu.util.errors import UserError

from .mesh_builder import SheetMeshBuilder
from .section_properties import Crease, Curl, SheetProperties, Thickness
from .sheet_handle import Sheet
from .supports import Support, check_support

TREES = ("spine", "rows", "master")
JOINTS: dict[str, type[Joint]] = {"geodesic": Geodesic, "paper": OutOfPlane}


def add_sheet(
    mechanism: Mechanism,
    name: str,
    *,
    length: float,
    width: float,
    thickness: Thickness,
    youngs_modulus: float | tuple[float, float],
    density: float,
    poisson: float = 0.3,
    shear_modulus: float | None = None,
    angle: float = 0.0,
    grid: tuple[int, int],
    tree: str = "spine",
    supports: Sequence[Support] = (),
    at: Vector = (0.0, 0.0, 0.0),
    rotation: Any = None,
    master: Body | None = None,
    rate: Vector | None = None,
    joint: str = "geodesic",
    membrane: bool | str = False,
    stretch: bool = False,
    curl: Curl = (0.0, 0.0),
    creases: Sequence[Crease] = (),
    damping: float = 0.0,
    drag: float = 0.0,
    pressure: Any = 0.0,
) -> Sheet:
    """Add a flexible sheet to a mechanism.

    Parameters
    ----------
    mechanism
        Mechanism to which the sheet is added.
    name
        Name of the sheet; its nodes are the bodies ``name.i.k``.
    length, width, thickness
        Dimensions along x, z and y, m; the thickness may be a function of x and z.
    youngs_modulus, poisson, density
        Young's modulus, Pa, Poisson's ratio, density, kg/m^3; moduli (E1, E2) along and across the grain, and Poisson's
        ratio nu12: contraction across the grain under tension along it.
    shear_modulus
        In-plane shear modulus, Pa; None: isotropic material, or estimate for paper, sqrt(E1 E2) / (2 (1 + sqrt(nu12
        nu21))).
    angle
        Angle of the grain (machine direction) from x towards z, rad.
    grid
        Numbers of nodes along x and z, at least 2 each; with membrane at least 3 across the chains (in both directions
        if the tree is ``master``).
    tree
        ``spine``, ``rows`` or ``master``; see the module.
    supports
        Supports of the edges; the trees ``spine`` and ``rows`` start at the first, which must not slide.
    at, rotation
        Frame of the flat sheet in the frame of a support's body, of ``master``, or of the ground: m and 3x3 axes.
    master
        Body to which the master node is fixed; None: it floats. For the tree ``master`` only.
    rate
        Velocity of a floating master node at the start, m/s and rad/s in the axes of the flat sheet, which moves like a
        rigid body.
    joint
        ``geodesic`` keeps the lengths and angles of the sheet; ``paper`` the projected length of its chains.
    membrane
        Whether shear and stretching across rows or ribs have stiffness; or the names of such strains, out of ``x``,
        ``z``, ``s`` (shear), as
        in :class:`.Plate`.
    stretch
        In-plane deformation: nodes with six coordinates and shell elements. It has other joints, has stiffness for all
        strains, and its tree follows from its supports: around a ``master`` or, without support, a floating one, else
        as a ``spine``. Another ``tree``, a ``joint`` and single strains of a ``membrane`` are refused.
    curl
        Curvatures (w,xx, w,zz) or (w,xx, w,zz, w,xz) of the unloaded sheet, 1/m, or a function of x and z
        that returns them; positive ones bend its edges up, along y.
    creases
        Lines along which it bends more easily; see :class:`Crease`.
    damping, drag
        Damping time of the material, s, and density times drag coefficient of the air, kg/m^3.
    pressure
        Pressure on the sheet, along the normal of the deformed sheet, Pa: number (zero: none), signal or input.

    Returns
    -------
    Sheet
        Handle of the sheet: its nodes carry joints and loads, its points and cells have sensors.

    Raises
    ------
    UserError
        A value is invalid, or options exclude each other; the message names both.
    """
    what = f"sheet {name!r}"
    shape = _grid(what, grid)
    for key, value in (("length", length), ("width", width), ("density", density)):
        positive(f"{key} of {what}", value)
    one_of(f"tree of {what}", tree, TREES)
    one_of(f"joint of {what}", joint, JOINTS)
    if not isinstance(supports, Sequence):
        raise UserError(f"supports of {what} are {supports!r}; allowed: a list of them")
    for support in supports:
        check_support(what, support)
    if flag(f"stretch of {what}", stretch):
        _refuse_what_stretches(what, tree, joint, membrane, held=bool(supports) and master is None)
    plate = Plate(
        a=length / (shape[0] - 1),
        b=width / (shape[1] - 1),
        thickness=1.0,
        youngs_modulus=_moduli(what, youngs_modulus),
        poisson=poisson,
        shear_modulus=shear_modulus,
        angle=angle,
        membrane=_active_strains(what, membrane, tree, joint, supports),
        damping=damping,
        drag=drag,
    )
    properties = SheetProperties(what, plate, shape, thickness, curl, creases)
    plate.check(what)
    properties.check()
    builder = SheetMeshBuilder(
        mechanism, name, properties, density, (at, rotation), Stretching if stretch else JOINTS[joint]
    )
    if stretch:
        builder.build_stretchable(list(supports), master, rate, pressure)
    else:
        _refuse_one_row(what, shape, plate, tree, supports)
        builder.build(tree, list(supports), master, rate, pressure)
    nodes = tuple(tuple(builder.bodies[i, k] for k in range(shape[1])) for i in range(shape[0]))
    cuts = tuple(builder.cuts)
    sheet = Sheet(name, nodes, plate.a, plate.b, properties.middle, properties, builder.cells, cuts, builder.along)
    mechanism.meshes.append(sheet)
    return sheet


def _moduli(what: str, value: Any) -> float | tuple[float, float]:
    """Return one modulus, or two as a tuple."""
    moduli = array_of(f"youngs_modulus of {what}", value)
    return (float(moduli[0]), float(moduli[1])) if moduli.shape == (2,) else value


def _refuse_what_stretches(what: str, tree: str, joint: str, membrane: bool | str, *, held: bool) -> None:
    """Refuse what a sheet with stretch would not follow; ``held``: it grows from a support."""
    if tree == "rows" or (tree == "master" and held):
        grows = "from its first support" if held else "from its middle"
        raise UserError(f"tree of {what} is {tree!r}, but with stretch=True it grows {grows}; leave out tree")
    if joint != "geodesic":
        raise UserError(
            f"joint of {what} is {joint!r}, but with stretch=True the joints are determined; leave out joint"
        )
    if isinstance(membrane, str):
        raise UserError(
            f"membrane of {what} is {membrane!r}, but with stretch=True all in-plane strains have "
            "stiffness; leave out membrane"
        )


def _active_strains(what: str, membrane: bool | str, tree: str, joint: str, supports: Sequence[Support]) -> str:
    """Membrane strains that the elements resist, refused where they lock."""
    if not isinstance(membrane, str):
        flag(f"membrane of {what}", membrane)
    spine = supports[0].edge[0] if tree != "master" and supports else "x"
    across = "z" if spine == "x" else "x"
    chain = spine if tree == "rows" else across  # along rows or ribs nothing stretches
    strains = membrane if isinstance(membrane, str) else "xzs".replace(chain, "") * membrane
    locked = set(strains) & ({spine} if tree == "rows" else {"x", "z"})
    if joint == "paper" and locked:
        raise UserError(
            f"{what} has membrane {membrane!r} on chains of projected length, which causes locking (several "
            "times too stiff); use joint 'geodesic' or no membrane"
        )
    return strains


def _refuse_one_row(what: str, shape: tuple[int, int], plate: Plate, tree: str, supports: Sequence[Support]) -> None:
    """Refuse a membrane on one row of cells; see the module."""
    along = supports[0].edge[0] if tree != "master" and supports else ""
    for axis, count in zip("xz", shape, strict=True):
        if plate.strains and axis != along and count < 3:
            raise UserError(
                f"grid of {what} is {shape}: only one row of cells across its chains, along {axis}, which with "
                f"membrane folds instead of bending; allowed: at least 3 nodes along {axis}, or no membrane"
            )


def _grid(what: str, grid: Any) -> tuple[int, int]:
    """Check two numbers of nodes."""
    counts = tuple(grid) if isinstance(grid, Sequence) else (grid,)
    if len(counts) != 2 or not all(is_whole(n) and n >= 2 for n in counts):
        raise UserError(f"grid of {what} is {grid!r}; allowed: two whole numbers of nodes, at least 2 each")
    return int(counts[0]), int(counts[1])
