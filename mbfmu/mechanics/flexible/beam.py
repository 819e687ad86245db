"""A uniform slender beam by finite elements: its modes of bending, and what the dynamics need of them.

Euler-Bernoulli elements of cubic deflection (Hermite) with consistent mass, along x of the body's frame, bending along
y. A mode is scaled so that its largest deflection is 1 m, first bulge positive: the modes of a pinned beam are
sin(k pi x / L) and the amplitudes are those of the sines. All integrals are those of the elements, by Gauss's four
points, exact for the shapes; so what is left of discretization is in the shapes, of fourth order in the element length.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics.checks import flag, whole
from mbfmu.mechanics.numbers import finite, not_negative, positive
from mbfmu.util.errors import UserError

from .records import MODES

Array = NDArray[np.float64]

BEAM_ENDS = {"pinned": (True, False), "clamped": (True, True), "guided": (False, True), "free": (False, False)}
MAX_ELEMENTS = 100  # rounding leaves their slowest frequency within 1e-7, and takes more of it the more there are
POINTS, WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, kw_only=True)
class Beam:
    """Uniform beam from x = 0 to ``length``, described by its bending modes.

    Parameters
    ----------
    length
        Length, m.
    mass
        Mass of the whole beam, kg.
    bending_stiffness
        Bending stiffness E I for deflections along y, N m^2.
    modes
        Number of modes, from the lowest.
    elements
        Number of finite elements, 1 to 100.
    ends
        Supports at x = 0 and x = length in the body's frame: ``pinned``, ``clamped``, ``guided`` (no rotation) or
        ``free``. Two pinned ends keep the chord, which is required if the body closes a loop.
    damping
        Damping time beta of the material, s: moment = E I (curvature + beta rate). Damping ratio beta omega / 2.
    stiffening
        Optional effect: axial forces stiffen or soften bending, which shortens the beam. Not for a beam in a loop by
        both ends.
    """

    length: float
    mass: float
    bending_stiffness: float
    modes: int
    elements: int = 10
    ends: tuple[str, str] = ("pinned", "pinned")
    damping: float = 0.0
    stiffening: bool = False

    def __post_init__(self) -> None:
        """Refuse what is no beam, naming it."""
        for name in ("length", "mass", "bending_stiffness"):
            positive(f"{name} of a beam", getattr(self, name))
        not_negative("damping of a beam", self.damping)
        for name in ("modes", "elements"):
            whole(f"{name} of a beam", getattr(self, name))
        if not 1 <= self.elements <= MAX_ELEMENTS:
            raise UserError(f"elements of a beam are {self.elements!r}; allowed: 1 to {MAX_ELEMENTS}")
        if not isinstance(self.ends, tuple | list) or len(self.ends) != 2:
            raise UserError(f"ends of a beam are {self.ends!r}; allowed: two of {', '.join(BEAM_ENDS)}")
        flag("stiffening of a beam", self.stiffening)
        for end in self.ends:
            if end not in BEAM_ENDS:
                raise UserError(f"end of a beam is {end!r}; allowed: {', '.join(BEAM_ENDS)}")
        if not 1 <= self.modes <= min(MODES, self._available):
            raise UserError(
                f"modes of a beam are {self.modes!r}; allowed: 1 to {min(MODES, self._available)} "
                f"with {self.elements} elements between {self.ends[0]} and {self.ends[1]} ends"
            )

    @property
    def size(self) -> float:
        """Length, m, as of every flexible body."""
        return self.length

    @cached_property
    def _free(self) -> NDArray[np.bool_]:
        """Which of (w, w') at the nodes are free."""
        free = np.ones(2 * (self.elements + 1), bool)
        for first, end in ((0, self.ends[0]), (2 * self.elements, self.ends[1])):
            free[first : first + 2] = ~np.array(BEAM_ENDS[end])
        return free

    @property
    def _available(self) -> int:
        """Number of modes the elements have."""
        return int(self._free.sum()) - self._rigid

    @property
    def _rigid(self) -> int:
        """Number of free motions w = a + b x; by rounding errors they cannot be separated from slow modes."""
        held = np.concatenate([np.array([[1, x], [0, 1]])[list(BEAM_ENDS[end])] for x, end in enumerate(self.ends)])
        return 2 - int(np.linalg.matrix_rank(held)) if len(held) else 2

    def _element(self) -> tuple[Array, Array]:
        """Stiffness and consistent mass of an element for (w1, w1', w2, w2')."""
        h = self.length / self.elements
        K = np.array(
            [
                [12.0, 6.0 * h, -12.0, 6.0 * h],
                [6.0 * h, 4.0 * h * h, -6.0 * h, 2.0 * h * h],
                [-12.0, -6.0 * h, 12.0, -6.0 * h],
                [6.0 * h, 2.0 * h * h, -6.0 * h, 4.0 * h * h],
            ]
        )
        M = np.array(
            [
                [156.0, 22.0 * h, 54.0, -13.0 * h],
                [22.0 * h, 4.0 * h * h, 13.0 * h, -3.0 * h * h],
                [54.0, 13.0 * h, 156.0, -22.0 * h],
                [-13.0 * h, -3.0 * h * h, -22.0 * h, 4.0 * h * h],
            ]
        )
        return self.bending_stiffness / h**3 * K, self.mass / self.elements / 420.0 * M

    @cached_property
    def _solved(self) -> tuple[Array, Array]:
        """Squared angular frequencies (modes,) and nodal (w, w') of each mode (2 (elements + 1), modes)."""
        Ke, Me = self._element()
        size = 2 * (self.elements + 1)
        K, M = np.zeros((size, size)), np.zeros((size, size))
        for e in range(self.elements):
            at = slice(2 * e, 2 * e + 4)
            K[at, at] += Ke
            M[at, at] += Me
        free = self._free
        squares, vectors = scipy.linalg.eigh(K[np.ix_(free, free)], M[np.ix_(free, free)])
        elastic = slice(self._rigid, self._rigid + self.modes)
        shapes = np.zeros((size, self.modes))
        shapes[free] = vectors[:, elastic]
        x = np.linspace(0.0, self.length, 40 * self.elements + 1)
        for k in range(self.modes):
            w = np.array([self._hermite(place)[0] @ shapes[:, k] for place in x])
            largest = np.abs(w).max()
            bulge = w[np.argmax(np.abs(w) > 0.1 * largest)]
            shapes[:, k] /= np.copysign(largest, bulge)
        return squares[elastic], shapes

    def _hermite(self, x: float) -> tuple[Array, Array]:
        """Rows (2 (elements + 1),) that give w and w' at x from the nodal (w, w')."""
        h = self.length / self.elements
        e = min(self.elements - 1, int(x / h))
        s = x / h - e
        w, slope = np.zeros(2 * (self.elements + 1)), np.zeros(2 * (self.elements + 1))
        w[2 * e : 2 * e + 4] = (
            1.0 - 3.0 * s**2 + 2.0 * s**3,
            h * s * (1.0 - s) ** 2,
            s**2 * (3.0 - 2.0 * s),
            h * s**2 * (s - 1.0),
        )
        slope[2 * e : 2 * e + 4] = (
            6.0 * s * (s - 1.0) / h,
            (1.0 - s) * (1.0 - 3.0 * s),
            6.0 * s * (1.0 - s) / h,
            s * (3.0 * s - 2.0),
        )
        return w, slope

    @property
    def frequencies(self) -> Array:
        """Natural frequencies (modes,) of the beam between its ends, rad/s."""
        return np.sqrt(self._solved[0])

    def shape(self, x: float) -> tuple[Array, Array]:
        """Return deflection and slope of every mode at a cross-section.

        Parameters
        ----------
        x
            Position along the beam from its origin, m.

        Returns
        -------
        tuple[Array, Array]
            Deflections (modes,), dimensionless, and slopes (modes,), 1/m, for an amplitude of 1 m.
        """
        if not 0.0 <= finite("place on a beam", x) <= self.length:
            raise UserError(f"place on a beam is {x!r} m; allowed: 0 to {self.length}")
        w, slope = self._hermite(x)
        shapes = self._solved[1]
        return w @ shapes, slope @ shapes

    def moment(self, x: float) -> Array:
        """Return the bending moment E I phi'' of every mode at a cross-section; linear between nodes.

        Parameters
        ----------
        x
            Position along the beam from its origin, m.

        Returns
        -------
        Array
            Moments (modes,), N m per m of amplitude.

        Notes
        -----
        At a node from the balance of its element with the inertia of the mode, which is of the order of the shapes;
        curvatures of the shapes themselves are of second order only.
        """
        squares, shapes = self._solved
        Ke, Me = self._element()
        h = self.length / self.elements
        e = min(self.elements - 1, int(x / h))
        s = x / h - e
        ends = np.zeros((2, self.modes))
        for k in range(self.modes):
            forces = (Ke - squares[k] * Me) @ shapes[2 * e : 2 * e + 4, k]
            ends[:, k] = -forces[1], forces[3]
        moment: Array = (1.0 - s) * ends[0] + s * ends[1]
        return moment

    def _integrate(self, upto: float) -> tuple[Array, Array, Array, Array]:
        """Gauss's points x, their lengths, and the modes' deflections and slopes there, from 0 to ``upto``."""
        h = self.length / self.elements
        borders = np.append(np.arange(0.0, upto - 1e-12 * h, h), upto)
        left, sizes = borders[:-1, None], np.diff(borders)[:, None]
        x = (left + 0.5 * sizes * (1.0 + POINTS)).ravel()
        lengths = (0.5 * sizes * WEIGHTS).ravel()
        shapes = [self.shape(float(place)) for place in x]
        return x, lengths, np.array([s[0] for s in shapes]), np.array([s[1] for s in shapes])

    def shortening(self, x: float) -> Array:
        """Return the geometric shortening of the beam by bending at a cross-section.

        Parameters
        ----------
        x
            Position along the beam from its origin, m.

        Returns
        -------
        Array
            G (modes, modes), 1/m: amplitudes p (m) shift the point at x back by p^T G p / 2.
        """
        if x == 0.0:
            return np.zeros((self.modes, self.modes))
        _, lengths, _, slope = self._integrate(x)
        G: Array = np.einsum("x,xk,xl->kl", lengths, slope, slope)
        return G

    def fill(self, record: Any, keep: Any = None) -> None:
        """Write mass, modes and stiffness into a record for kernels.

        Parameters
        ----------
        record
            Record of the type ``FlexibleRecord``.
        keep
            Not used; see :meth:`FlexibleBody.fill`.
        """
        L, n = self.length, self.modes
        x, lengths, phi, slope = self._integrate(L)
        rho = self.mass / L * lengths
        record["at"], record["modes"], record["shortens"] = -1, n, n if self.stiffening else 0
        record["mass"], record["X1"], record["X2"] = self.mass, 0.5 * self.mass * L, self.mass * L**2 / 3.0
        record["a"][:n], record["c"][:n] = rho @ phi, (rho * x) @ phi
        record["mu"][:n] = rho @ phi**2
        record["kappa"][:n] = self._solved[0] * record["mu"][:n]
        record["beta"] = self.damping
        record["g0"][:n, :n] = np.einsum("x,xk,xl->kl", rho * (L - x), slope, slope)
        record["g1"][:n, :n] = np.einsum("x,xk,xl->kl", 0.5 * rho * (L**2 - x**2), slope, slope)

    @property
    def is_damped(self) -> bool:
        """Whether the material is damped."""
        return self.damping > 0.0

    def fill_frame(self, record: Any, keep: Any = None) -> None:
        """Write the frame of the beam, which bending leaves in place, as a section for kernels.

        Parameters
        ----------
        record
            Record of the type ``NodeRecord``.
        keep
            As for :meth:`fill`.
        """
        record["at"] = -1

    def fill_node(self, x: Any, record: Any, keep: Any = None) -> None:
        """Write a cross-section into a record for kernels.

        Parameters
        ----------
        x
            Position along the beam from its origin, m.
        record
            Record of the type ``NodeRecord``.
        keep
            As for :meth:`fill`.
        """
        n = self.modes
        phi, slope = self.shape(x)
        record["at"], record["x"], record["phi"][:n], record["slope"][:n] = -1, x, phi, slope
        record["moment"][:n] = self.moment(x)
        record["shortens"] = n if self.stiffening else 0
        record["G"][:n, :n] = self.shortening(x)
