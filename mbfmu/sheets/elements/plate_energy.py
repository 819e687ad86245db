"""The energy of a plate element, a rectangle between four bodies, and the forces that are its exact gradient.

The element rides in its own axes (corotational), so a rigid motion of any size strains nothing. Nodes lie at
1 (0, 0), 2 (a, 0), 3 (a, b), 4 (0, b) of the (x, z) plane, their y axes along the normal. From the nodes' origins

    g1 = ((r2 - r1) + (r3 - r4)) / 2,    g2 = ((r4 - r1) + (r3 - r2)) / 2,    t = (r1 - r2 + r3 - r4) / 4,
    e_x = g1 / |g1|,    e_y = g2 x g1 / |.|,    e_z = e_x x e_y,

the corners are off the mid-plane by tau = e_y.t, with signs + - + -. A node's normal d (its y axis) leans away from e_y
by the angle theta; in element axes its slopes are

    (w_x, w_z) = -F (d_x, d_z),    F = theta / sin theta,    cos theta = d_y.

The energy depends on the normals only, so rotating a node about its normal requires no energy.

**Bending** is the rectangle of Adini, Clough and Melosh (1963). Its 12 x 12 stiffness falls apart into four classes of
symmetry of three unknowns each; of the deflections tau alone is left. With the sign patterns of the corners
x = (- + + -), z = (- - + +), xz = (+ - + -) and means over the corners <.>, the generalized strains are

    0: <x w_x>   1: <z w_z>     constant curvature     4: <w_z>   5: <xz w_x>    w ~ z, z^3, x^2 z
    2: <w_x>     3: <xz w_z>    w ~ x, x^3, x z^2      6: <z w_x> - 2 tau / a    w ~ x^3 z
    8: tau                      w ~ x z                7: <x w_z> - 2 tau / b    w ~ x z^3

and with D = Q t^3 / 12 of a material with a grain (:mod:`.material`), by curvatures (w,xx, w,zz, 2 w,xz), the energy is
half of  sum k_i e_i^2 + 2 c (e0 e1 + e2 e3 + e4 e5 + e6 e7) + 2 sum o_ij e_i e_j,

    k0 = 4 D11 b/a    k2 = 12 D11 b/a    k3 = 4/3 D22 a/b + 16/3 D66 b/a    k6 = 4 D11 b/a + 16/5 D66 a/b    c = 4 D12
    k1 = 4 D22 a/b    k4 = 12 D22 a/b    k5 = 4/3 D11 b/a + 16/3 D66 a/b    k7 = 4 D22 a/b + 16/5 D66 b/a
    k8 = 64 D66 / (a b),    o08 = 16 D16/a    o18 = 16 D26/b    o25 = 8 D16    o34 = 8 D26
    o35 = 8/3 (D16 b/a + D26 a/b);

of an isotropic one D11 = D22 = D = E t^3 / (12 (1 - nu^2)), D12 = nu D, D66 = (1 - nu) D / 2. The o are zero unless
the grain is inclined in the element.

**Curl.** A plate that nothing bends may have the curvatures (k_x, k_z, k_xz) = (w,xx, w,zz, w,xz). Its strains are then
e0 = a k_x / 2, e1 = b k_z / 2, e8 = a b k_xz / 4, exactly so for one that is curled one way, however far, since slopes
are angles. Moments are measured from there; the membrane depends on the present shape only, whose arcs keep their
length.

**Membrane**, where a scene calls for it: one stress for the element (plane stress). The strain along x is the mean over
the two edges of that direction, and an edge is the cubic that bending draws between its corners: a chord, g1 - 2 t or
g1 + 2 t, and what the arc is longer, d^2/24 + m^2/10 with the difference d and the mean m of its end slopes against it.
In the strains above, of t only what is off the plane,

    9:  E_xx = ((g1.g1 + 4 tau^2) / a^2 - 1) / 2 + (e0^2 + e5^2) / 6 + (e2^2 + e6^2) / 10,
    10: E_zz = ((g2.g2 + 4 tau^2) / b^2 - 1) / 2 + (e1^2 + e3^2) / 6 + (e4^2 + e7^2) / 10,
    11: gamma = g1.g2 / (a b),

E of an edge that is a geodesic joint is zero to fourth order, and so is gamma, free of the term curvature times twist
times a^2, where such joints carry a surface that bends and twists (:mod:`mbfmu.sheets.joints.geodesic`).

**Damping** (Kelvin, Voigt): stress = K (e + beta e'), with the exact rates e', so rigid motions are not damped.

Chain of differentials, all in element axes, for motions dr of the origins and small rotations phi of the bodies:

    omega = ((g2_x omega_z - dg2_y) / g2_z, -dg1_z / |g1|, dg1_y / |g1|)     spin of the element axes
    dd = (phi - omega) x d,     dtau = dt_y + omega_x t_z - omega_z t_x,     F' = (F cos theta - 1) / sin^2 theta.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from mbfmu.mechanics.dispatch import scratch_record
from solvers.compiled.kernel import inlined, kernel
from solvers.compiled.record import Integers, Mat3, Reals, Record, Vec3, f8, i8

if TYPE_CHECKING:
    from mbfmu.mechanics.records import Arrays, MotionRecord, State
    from solvers.compiled.record import Table


class PlateRecord(Record):
    """A plate element."""

    node: Annotated[Integers, (4,)]  # bodies at the corners 1 (0, 0), 2 (a, 0), 3 (a, b), 4 (0, b)
    scratch: i8  # place of the scratch memory
    membrane: i8  # 1: resists stretching in its plane
    damped: i8  # 1: has material damping
    grain: i8  # 0: has none, 1: along a side, 2: askew, which couples normal strains with shear
    curled: i8  # 1: is not flat where nothing bends it
    a: f8  # sides along x and z of the element, m
    b: f8
    bending: Annotated[Reals, (9,)]  # stiffness by generalized strains 0 ... 8, see the module
    coupling: f8  # ... between the first four pairs
    stretching: Annotated[Reals, (4,)]  # by E_xx, E_zz, between these two, by gamma; N m
    damping: f8  # beta of stress = K (e + beta e'), s
    oblique: Annotated[Reals, (7,)]  # between e0 e8, e1 e8, e2 e5, e3 e4, e3 e5; E_xx gamma, E_zz gamma
    curl: Annotated[Reals, (12,)]  # natural strains; of the membrane none
    is_extrapolated: i8  # 1: stresses by the extrapolated strains, in the tangent of statics
    extrapolated: Annotated[Reals, (12,)]  # generalized strains


class PlateScratch(Record):
    """An element at work, everything in element axes."""

    E: Mat3  # rows: element axes in global axes
    g1x: f8  # g1 = (g1x, 0, 0), g2 = (g2x, 0, g2z), m
    g2x: f8
    g2z: f8
    t: Vec3  # how far the corners are from one plane, m
    d: Annotated[Reals, (4, 3)]  # normals of the bodies
    F: Annotated[Reals, (4,)]  # theta / sin theta of each and its derivatives by cos theta
    dF: Annotated[Reals, (4,)]
    ddF: Annotated[Reals, (4,)]
    w: Annotated[Reals, (4, 2)]  # slopes along x and z
    strain: Annotated[Reals, (12,)]
    stress: Annotated[Reals, (12,)]
    f: Annotated[Reals, (4, 2)]  # gradient of the energy by the slopes
    m: Annotated[Reals, (4, 3)]  # ... by the rotations of the bodies
    n: Mat3  # ... by g1, g2, t
    turn: Vec3  # ... by the spin of the element axes
    dg: Mat3  # differentials along one motion: of g1, g2, t
    phi: Annotated[Reals, (4, 3)]  # ... rotations of the bodies
    omega: Vec3  # ... rotation of the element axes
    dd: Annotated[Reals, (4, 3)]
    dw: Annotated[Reals, (4, 2)]
    dstrain: Annotated[Reals, (12,)]
    dstress: Annotated[Reals, (12,)]
    df: Annotated[Reals, (4, 2)]
    dm: Annotated[Reals, (4, 3)]
    dn: Mat3


PLATE_SCRATCH = PlateScratch.dtype

SERIES_RATIOS = tuple(
    n / (2.0 * n + 1.0) for n in range(13)
)  # of successive coefficients of F in powers of 1 - cos theta
SHORT_SERIES_LIMIT, LONG_SERIES_LIMIT = 0.004, 0.1  # 1 - cos theta up to which 6 and 12 terms are exact to rounding


@inlined
def plate_scratch(item: PlateRecord, state: State) -> Any:
    """Scratch memory of an element or a sensor of it."""
    return scratch_record(item.scratch, PLATE_SCRATCH, state)


@kernel
def slope_factor(c: float) -> Any:
    """F = theta / sin theta and its first two derivatives by c = cos theta; analytic about c = 1.

    About c = 1 the series in u = 1 - c, with coefficients n!/(2n+1)!!, is summed with its derivatives.
    """
    u = 1.0 - c
    if u.real > LONG_SERIES_LIMIT:
        square = u * (1.0 + c)
        F = np.arccos(c) / np.sqrt(square)
        slope = (c * F - 1.0) / square
        return F, slope, (F + 3.0 * c * slope) / square
    F, slope, bend = 1.0 + 0.0 * u, 0.0 * u, 0.0 * u
    for n in range(6 if u.real < SHORT_SERIES_LIMIT else 12, 0, -1):
        bend = SERIES_RATIOS[n] * (2.0 * slope + u * bend)
        slope = SERIES_RATIOS[n] * (F + u * slope)
        F = 1.0 + SERIES_RATIOS[n] * u * F
    return F, -slope, bend


@kernel
def shape(plate: PlateRecord, bodies: Table[MotionRecord], here: PlateScratch) -> None:
    """Element axes, normals and slopes from positions and orientations."""
    E, t, d = here.E, here.t, here.d
    n1, n2, n3, n4 = bodies[plate.node[0]], bodies[plate.node[1]], bodies[plate.node[2]], bodies[plate.node[3]]
    r1, r2, r3, r4 = n1.r, n2.r, n3.r, n4.r
    x1 = 0.5 * (r2[0] - r1[0] + r3[0] - r4[0])
    y1 = 0.5 * (r2[1] - r1[1] + r3[1] - r4[1])
    z1 = 0.5 * (r2[2] - r1[2] + r3[2] - r4[2])
    x2 = 0.5 * (r4[0] - r1[0] + r3[0] - r2[0])
    y2 = 0.5 * (r4[1] - r1[1] + r3[1] - r2[1])
    z2 = 0.5 * (r4[2] - r1[2] + r3[2] - r2[2])
    length = np.sqrt(x1 * x1 + y1 * y1 + z1 * z1)
    x1, y1, z1 = x1 / length, y1 / length, z1 / length
    nx, ny, nz = y2 * z1 - z2 * y1, z2 * x1 - x2 * z1, x2 * y1 - y2 * x1
    height = np.sqrt(nx * nx + ny * ny + nz * nz)
    nx, ny, nz = nx / height, ny / height, nz / height
    here.g1x = length
    here.g2x, here.g2z = x2 * x1 + y2 * y1 + z2 * z1, height
    E[0, 0], E[0, 1], E[0, 2] = x1, y1, z1
    E[1, 0], E[1, 1], E[1, 2] = nx, ny, nz
    E[2, 0], E[2, 1], E[2, 2] = y1 * nz - z1 * ny, z1 * nx - x1 * nz, x1 * ny - y1 * nx
    x1 = 0.25 * (r1[0] - r2[0] + r3[0] - r4[0])
    y1 = 0.25 * (r1[1] - r2[1] + r3[1] - r4[1])
    z1 = 0.25 * (r1[2] - r2[2] + r3[2] - r4[2])
    for k in range(3):
        t[k] = E[k, 0] * x1 + E[k, 1] * y1 + E[k, 2] * z1
    for i in range(4):
        A = bodies[plate.node[i]].A
        for k in range(3):
            d[i, k] = E[k, 0] * A[0, 1] + E[k, 1] * A[1, 1] + E[k, 2] * A[2, 1]
        here.F[i], here.dF[i], here.ddF[i] = slope_factor(d[i, 1])
        here.w[i, 0], here.w[i, 1] = -here.F[i] * d[i, 0], -here.F[i] * d[i, 2]


@kernel
def bending_strain(plate: PlateRecord, w: Reals, tau: float, e: Reals) -> None:
    """e[0:9] from slopes w (4, 2) and tau, or their rates from rates: the map is linear."""
    e[0] = 0.25 * (w[1, 0] + w[2, 0] - w[0, 0] - w[3, 0])
    e[1] = 0.25 * (w[2, 1] + w[3, 1] - w[0, 1] - w[1, 1])
    e[2] = 0.25 * (w[0, 0] + w[1, 0] + w[2, 0] + w[3, 0])
    e[3] = 0.25 * (w[0, 1] - w[1, 1] + w[2, 1] - w[3, 1])
    e[4] = 0.25 * (w[0, 1] + w[1, 1] + w[2, 1] + w[3, 1])
    e[5] = 0.25 * (w[0, 0] - w[1, 0] + w[2, 0] - w[3, 0])
    e[6] = 0.25 * (w[2, 0] + w[3, 0] - w[0, 0] - w[1, 0]) - 2.0 * tau / plate.a
    e[7] = 0.25 * (w[1, 1] + w[2, 1] - w[0, 1] - w[3, 1]) - 2.0 * tau / plate.b
    e[8] = tau


@kernel
def membrane_strain(plate: PlateRecord, here: PlateScratch, e: Reals) -> None:
    """e[9:12] from the shape and e[0:9]."""
    x, z, g = here.g1x / plate.a, here.g2z / plate.b, here.g2x / plate.b
    tx, tz = 2.0 * e[8] / plate.a, 2.0 * e[8] / plate.b
    e[9] = 0.5 * (x * x + tx * tx - 1.0) + (e[0] * e[0] + e[5] * e[5]) / 6.0 + (e[2] * e[2] + e[6] * e[6]) / 10.0
    e[10] = 0.5 * (g * g + z * z + tz * tz - 1.0) + (e[1] * e[1] + e[3] * e[3]) / 6.0
    e[10] += (e[4] * e[4] + e[7] * e[7]) / 10.0
    e[11] = x * g


@kernel
def add_arcs(plate: PlateRecord, s: Reals, e: Reals, out: Reals) -> None:
    """out[0:9] += what the membrane stresses s[9:11] pull on the arcs and chords of edges with strains e, by e[0:9]."""
    x, z = s[9] / 3.0, s[10] / 3.0
    out[0] += x * e[0]
    out[5] += x * e[5]
    out[1] += z * e[1]
    out[3] += z * e[3]
    x, z = s[9] / 5.0, s[10] / 5.0
    out[2] += x * e[2]
    out[6] += x * e[6]
    out[4] += z * e[4]
    out[7] += z * e[7]
    out[8] += 4.0 * (s[9] / (plate.a * plate.a) + s[10] / (plate.b * plate.b)) * e[8]


@kernel
def strain(plate: PlateRecord, here: PlateScratch) -> None:
    """Generalized strains from the shape."""
    bending_strain(plate, here.w, here.t[1], here.strain)
    if plate.membrane == 1:
        membrane_strain(plate, here, here.strain)


@kernel
def stress(plate: PlateRecord, e: Reals, part: Any, out: Reals) -> None:
    """out (12,) += part K e; what the element does not have stays."""
    k, c = plate.bending, part * plate.coupling
    for i in range(0, 8, 2):
        out[i] += part * k[i] * e[i] + c * e[i + 1]
        out[i + 1] += part * k[i + 1] * e[i + 1] + c * e[i]
    out[8] += part * k[8] * e[8]
    if plate.membrane == 1:
        s = plate.stretching
        out[9] += part * (s[0] * e[9] + s[2] * e[10])
        out[10] += part * (s[1] * e[10] + s[2] * e[9])
        out[11] += part * s[3] * e[11]
    if plate.grain == 2:
        add_oblique(plate, e, part, out)


@kernel
def add_oblique(plate: PlateRecord, e: Reals, part: Any, out: Reals) -> None:
    """out (12,) += part times what a grain askew couples."""
    o = plate.oblique
    out[0] += part * o[0] * e[8]
    out[1] += part * o[1] * e[8]
    out[2] += part * o[2] * e[5]
    out[3] += part * (o[3] * e[4] + o[4] * e[5])
    out[4] += part * o[3] * e[3]
    out[5] += part * (o[2] * e[2] + o[4] * e[3])
    out[8] += part * (o[0] * e[0] + o[1] * e[1])
    if plate.membrane == 1:
        out[9] += part * o[5] * e[11]
        out[10] += part * o[6] * e[11]
        out[11] += part * (o[5] * e[9] + o[6] * e[10])


@kernel
def resist(plate: PlateRecord, here: PlateScratch) -> None:
    """Add the elastic stresses, K (e - e of the natural shape)."""
    if plate.is_extrapolated == 1:
        stress(plate, plate.extrapolated, 1.0, here.stress)
    else:
        stress(plate, here.strain, 1.0, here.stress)
    if plate.curled == 1:
        stress(plate, plate.curl, -1.0, here.stress)


@kernel
def clear_stress(here: PlateScratch) -> None:
    """Zero the stresses, those an element does not have among them."""
    for i in range(12):
        here.stress[i] = 0.0


@kernel
def by_slopes(s: Reals, f: Reals) -> None:
    """f (4, 2): gradient of the bending energy by the slopes, from the stresses; the transpose of bending_strain."""
    s0, s1, s2, s3 = 0.25 * s[0], 0.25 * s[1], 0.25 * s[2], 0.25 * s[3]
    s4, s5, s6, s7 = 0.25 * s[4], 0.25 * s[5], 0.25 * s[6], 0.25 * s[7]
    f[0, 0], f[0, 1] = s2 - s0 + s5 - s6, s4 - s1 + s3 - s7
    f[1, 0], f[1, 1] = s2 + s0 - s5 - s6, s4 - s1 - s3 + s7
    f[2, 0], f[2, 1] = s2 + s0 + s5 + s6, s4 + s1 + s3 + s7
    f[3, 0], f[3, 1] = s2 - s0 - s5 + s6, s4 + s1 - s3 - s7


@kernel
def gradient(plate: PlateRecord, here: PlateScratch) -> None:
    """Gradient of the energy in element axes from the stresses: f by slopes, m by rotations, n by g1, g2 and tau.

    The stresses become those by e[0:9] with what the membrane pulls on.
    """
    s, f, d, m, n, t = here.stress, here.f, here.d, here.m, here.n, here.t
    if plate.membrane == 1:
        add_arcs(plate, s, here.strain, s)
    by_slopes(s, f)
    by_tau = s[8] - 2.0 * s[6] / plate.a - 2.0 * s[7] / plate.b
    ox, oy, oz = by_tau * t[2], 0.0 * by_tau, -by_tau * t[0]
    for i in range(4):  # by the normal: (-F f_x, -F' (d_x f_x + d_z f_z), -F f_z); by rotation: d x that
        px, pz = -here.F[i] * f[i, 0], -here.F[i] * f[i, 1]
        py = -here.dF[i] * (d[i, 0] * f[i, 0] + d[i, 2] * f[i, 1])
        m[i, 0], m[i, 1], m[i, 2] = (
            d[i, 1] * pz - d[i, 2] * py,
            d[i, 2] * px - d[i, 0] * pz,
            d[i, 0] * py - d[i, 1] * px,
        )
        ox, oy, oz = ox - m[i, 0], oy - m[i, 1], oz - m[i, 2]
    here.turn[0], here.turn[1], here.turn[2] = ox, oy, oz  # by the spin omega of the element axes
    n[0, 0], n[0, 1], n[0, 2] = 0.0, (oz + ox * here.g2x / here.g2z) / here.g1x, -oy / here.g1x
    n[1, 0], n[1, 1], n[1, 2] = 0.0, -ox / here.g2z, 0.0
    n[2, 0], n[2, 1], n[2, 2] = 0.0, by_tau, 0.0
    if plate.membrane == 1:
        sx, sz, shear = s[9] / (plate.a * plate.a), s[10] / (plate.b * plate.b), s[11] / (plate.a * plate.b)
        n[0, 0] += sx * here.g1x + shear * here.g2x
        n[0, 2] += shear * here.g2z
        n[1, 0] += sz * here.g2x + shear * here.g1x
        n[1, 2] += sz * here.g2z


@kernel
def load(plate: PlateRecord, here: PlateScratch, bodies: Table[MotionRecord]) -> None:
    """Add minus the gradient to the applied wrenches F of the four bodies."""
    E, m, n = here.E, here.m, here.n
    F1, F2 = bodies[plate.node[0]].F, bodies[plate.node[1]].F
    F3, F4 = bodies[plate.node[2]].F, bodies[plate.node[3]].F
    for k in range(3):
        x = 0.5 * (E[0, k] * n[0, 0] + E[1, k] * n[0, 1] + E[2, k] * n[0, 2])
        z = 0.5 * (E[0, k] * n[1, 0] + E[1, k] * n[1, 1] + E[2, k] * n[1, 2])
        twist = 0.25 * E[1, k] * n[2, 1]
        F1[k] += x + z - twist
        F2[k] += z - x + twist
        F3[k] -= x + z + twist
        F4[k] += x - z + twist
    for k in range(3):
        F1[3 + k] -= E[0, k] * m[0, 0] + E[1, k] * m[0, 1] + E[2, k] * m[0, 2]
        F2[3 + k] -= E[0, k] * m[1, 0] + E[1, k] * m[1, 1] + E[2, k] * m[1, 2]
        F3[3 + k] -= E[0, k] * m[2, 0] + E[1, k] * m[2, 1] + E[2, k] * m[2, 2]
        F4[3 + k] -= E[0, k] * m[3, 0] + E[1, k] * m[3, 1] + E[2, k] * m[3, 2]


@kernel
def follow(plate: PlateRecord, bodies: Table[MotionRecord], here: PlateScratch) -> None:
    """Differentials of g1, g2, t (rows of dg) and rotations of the bodies, element axes, from the velocities."""
    E, dg, phi = here.E, here.dg, here.phi
    Y1, Y2 = bodies[plate.node[0]].Y, bodies[plate.node[1]].Y
    Y3, Y4 = bodies[plate.node[2]].Y, bodies[plate.node[3]].Y
    for k in range(3):
        dg[0, k], dg[1, k], dg[2, k] = 0.0, 0.0, 0.0
        for i in range(4):
            phi[i, k] = 0.0
    for j in range(3):
        x = 0.5 * (Y2[j] - Y1[j] + Y3[j] - Y4[j])
        z = 0.5 * (Y4[j] - Y1[j] + Y3[j] - Y2[j])
        twist = 0.25 * (Y1[j] - Y2[j] + Y3[j] - Y4[j])
        for k in range(3):
            dg[0, k] += E[k, j] * x
            dg[1, k] += E[k, j] * z
            dg[2, k] += E[k, j] * twist
            phi[0, k] += E[k, j] * Y1[3 + j]
            phi[1, k] += E[k, j] * Y2[3 + j]
            phi[2, k] += E[k, j] * Y3[3 + j]
            phi[3, k] += E[k, j] * Y4[3 + j]


@kernel
def differentiate(plate: PlateRecord, here: PlateScratch) -> None:
    """Spin omega, differentials of normals, slopes and strains (dd, dw, dstrain) from dg and phi."""
    dg, phi, d, dd, dw, omega, t, de = (
        here.dg, here.phi, here.d, here.dd, here.dw, here.omega, here.t, here.dstrain,
    )  # fmt: skip
    omega[1], omega[2] = -dg[0, 2] / here.g1x, dg[0, 1] / here.g1x
    omega[0] = (here.g2x * omega[2] - dg[1, 1]) / here.g2z
    for i in range(4):
        x, y, z = phi[i, 0] - omega[0], phi[i, 1] - omega[1], phi[i, 2] - omega[2]
        dd[i, 0] = y * d[i, 2] - z * d[i, 1]
        dd[i, 1] = z * d[i, 0] - x * d[i, 2]
        dd[i, 2] = x * d[i, 1] - y * d[i, 0]
        change = here.dF[i] * dd[i, 1]
        dw[i, 0] = -here.F[i] * dd[i, 0] - change * d[i, 0]
        dw[i, 1] = -here.F[i] * dd[i, 2] - change * d[i, 2]
    bending_strain(plate, dw, dg[2, 1] + omega[0] * t[2] - omega[2] * t[0], de)
    if plate.membrane == 1:
        e, aa, bb, ab = here.strain, plate.a * plate.a, plate.b * plate.b, plate.a * plate.b
        de[9] = (here.g1x * dg[0, 0] + 4.0 * e[8] * de[8]) / aa
        de[9] += (e[0] * de[0] + e[5] * de[5]) / 3.0 + (e[2] * de[2] + e[6] * de[6]) / 5.0
        de[10] = (here.g2x * dg[1, 0] + here.g2z * dg[1, 2] + 4.0 * e[8] * de[8]) / bb
        de[10] += (e[1] * de[1] + e[3] * de[3]) / 3.0 + (e[4] * de[4] + e[7] * de[7]) / 5.0
        de[11] = (dg[0, 0] * here.g2x + dg[0, 2] * here.g2z + here.g1x * dg[1, 0]) / ab


@kernel
def apply(plate: PlateRecord, t: float, arrays: Arrays, state: State) -> None:
    """See :mod:`mbfmu.mechanics.loads.base`. The power of the damping, -beta e'^T K e', is a by-product."""
    bodies, here = state.bodies, plate_scratch(plate, state)
    shape(plate, bodies, here)
    strain(plate, here)
    clear_stress(here)
    power = 0.0 * here.t[0]
    if plate.damped == 1:
        follow(plate, bodies, here)
        differentiate(plate, here)
        stress(plate, here.dstrain, plate.damping, here.stress)
        for i in range(12 if plate.membrane == 1 else 9):
            power -= here.stress[i] * here.dstrain[i]
    resist(plate, here)
    gradient(plate, here)
    load(plate, here, bodies)
    state.cached_power[0] += power


@kernel
def potential(plate: PlateRecord, arrays: Arrays, state: State) -> float:
    """Elastic energy, J."""
    here = plate_scratch(plate, state)
    shape(plate, state.bodies, here)
    strain(plate, here)
    clear_stress(here)
    resist(plate, here)
    total = 0.5 * here.stress[8] * here.strain[8]
    for i in range(8):
        total += 0.5 * here.stress[i] * here.strain[i]
    if plate.membrane == 1:
        for i in range(9, 12):
            total += 0.5 * here.stress[i] * here.strain[i]
    if plate.curled == 1:
        for i in range(9):
            total -= 0.5 * here.stress[i] * plate.curl[i]
    return total
