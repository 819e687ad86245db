"""The linearized motion about a steady state: exact state matrices by complex step.

    x' = A x + B u,    y = C x + D u

x are the changes of the independent coordinates and of their rates, u those of the inputs, y those of the outputs. The
position of a joint that is driven at a speed which is an input is a state too, where anything depends on it: its
derivative is that input.
Every column is one solution of the equations of motion on complex numbers (see :mod:`solvers.statics.dense`), so no
difference quotient is involved and the constraints hold to first order.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.mechanics.arrays.closing import check_inertia
from mbfmu.util.diagnostics import Diagnostic
from mbfmu.util.errors import EquilibriumError, UserError
from mbfmu.util.extras import import_optional
from mbfmu.util.files import replacing
from mbfmu.util.text_table import format_table
from solvers.projection.products import PRODUCT_STEP_SIZE
from solvers.system import Array

EIGENVALUE_ROUNDING = 1e-12  # of the largest eigenvalue
ZERO_ENTRY_RATIO = 1e-12  # of the largest entry of the state matrices
DERIVATIVES = ("position", "rate", "acceleration")

Direction = tuple[Array, Array, "tuple[Any, int, float] | None"]  # of coordinates, of rates, and where numbers change


@dataclass(frozen=True, kw_only=True)
class StateSpace:
    """State matrices with the names of states, inputs and outputs.

    Attributes
    ----------
    A, B, C, D
        (s, s), (s, inputs), (outputs, s), (outputs, inputs) for s states: f independent positions, as many rates, the
        first-order states, and the driven positions that are states, last. With nonholonomic constraints there are
        fewer independent rates than positions.
    states, inputs, outputs
        Names; the rate of state ``x`` is ``der(x)``.
    coordinates
        Derivatives of all coordinates with respect to the independent ones (n, f); zero for first-order states.
    n_rates
        Number of independent rates; None: f.
    n_states
        Number of first-order states.
    periodic
        Names of the matrices that depend on the positions of the drives; the values are those at time zero.
    diagnostics
        Notes on derivatives of inputs that are left out.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    coordinates: Array
    n_rates: int | None = None
    n_states: int = 0
    periodic: tuple[str, ...] = ()
    diagnostics: tuple[Diagnostic, ...] = ()

    @property
    def free(self) -> Array:
        """The part (k, k) of A without driven positions, k = n_moving + n_states."""
        size = self.n_moving + self.n_states
        return self.A[:size, :size]

    @property
    def n_moving(self) -> int:
        """Number of independent positions and rates."""
        positions = int(self.coordinates.shape[1])
        return positions + (positions if self.n_rates is None else self.n_rates)

    def modes(self) -> list[Mode]:
        """Return the eigenvalues, slowest first; for a conjugate pair the one with positive imaginary part."""
        values = scipy.linalg.eigvals(self.free) if self.free.size else np.zeros(0)
        return [Mode(complex(values[k])) for k in slowest_first(values)]

    def shapes(self) -> list[tuple[Mode, NDArray[np.complex128]]]:
        """Return the modes in the order of :meth:`modes` with their shapes (n,), arbitrarily scaled."""
        values, vectors = scipy.linalg.eig(self.free) if self.free.size else (np.zeros(0), np.zeros((0, 0)))
        freedom = self.coordinates.shape[1]
        motions = self.coordinates @ vectors[:freedom]
        motions[len(motions) - self.n_states :] = vectors[self.n_moving :]
        return [(Mode(complex(values[k])), motions[:, k]) for k in slowest_first(values)]

    def to_scipy(self) -> Any:
        """Return a ``scipy.signal.StateSpace``."""
        from scipy.signal import StateSpace as Continuous

        return Continuous(self.A, self.B, self.C, self.D)

    def to_control(self) -> Any:
        """Return a ``StateSpace`` of python-control with names; requires the package ``control``."""
        control = import_optional("control")
        named = {"states": list(self.states), "inputs": list(self.inputs), "outputs": list(self.outputs)}
        return control.ss(self.A, self.B, self.C, self.D, **named)

    def write(self, path: Path | str) -> None:
        """Write the matrices and the names to a file for NumPy, MATLAB or Octave.

        Parameters
        ----------
        path
            Path of the file, with the suffix ``.npz`` (NumPy) or ``.mat`` (MATLAB, Octave).

        Raises
        ------
        UserError
            The suffix is another one, or the file cannot be written.

        Examples
        --------
        >>> # with numpy.load(path) as f: control.ss(f["A"], f["B"], f["C"], f["D"])
        """
        matrices = {"A": self.A, "B": self.B, "C": self.C, "D": self.D}
        names = {"states": self.states, "inputs": self.inputs, "outputs": self.outputs}
        path = Path(path)
        if path.suffix not in (".npz", ".mat"):
            raise UserError(f"file is {str(path)!r}; its name must end in .npz or .mat")
        with replacing(path) as unfinished, unfinished.open("wb") as file:
            if path.suffix == ".npz":
                np.savez(file, allow_pickle=False, **matrices, **{k: np.array(v, str) for k, v in names.items()})
            else:
                scipy.io.savemat(file, {**matrices, **{k: np.array(v, object) for k, v in names.items()}})


def slowest_first(values: Any) -> list[int]:
    """Return the order of eigenvalues (k,) by size, without those below the real axis."""
    floor = EIGENVALUE_ROUNDING * np.abs(values).max(initial=0.0)
    return [int(k) for k in np.argsort(np.abs(values), kind="stable") if values[k].imag >= -floor]


@dataclass(frozen=True)
class Mode:
    """An eigenvalue s of the linearized motion, 1/s; with a positive imaginary part it stands for a pair."""

    eigenvalue: complex

    @property
    def frequency(self) -> float:
        """Damped frequency |Im s|, at which the motion oscillates, rad/s."""
        return abs(self.eigenvalue.imag)

    @property
    def natural_frequency(self) -> float:
        """Undamped natural frequency |s|, to which the damping ratio belongs, rad/s."""
        return abs(self.eigenvalue)

    @property
    def damping_ratio(self) -> float:
        """-Re s / |s|: 1 for a decaying real mode, -1 for a growing one, 0 where nothing moves."""
        size = abs(self.eigenvalue)
        return -self.eigenvalue.real / size if size > 0.0 else 0.0


def modes_as_text(modes: list[Mode]) -> str:
    """Return a table of eigenvalues for people; a real part that is rounding is written as zero."""
    floor = EIGENVALUE_ROUNDING * max((abs(m.eigenvalue) for m in modes), default=0.0)
    rows = [
        (
            f"{m.eigenvalue.real:.6g}" + (f" ± {m.frequency:.6g}i" if m.frequency else ""),
            f"{m.frequency:.6g}",
            f"{m.frequency / (2.0 * np.pi):.6g}",
            f"{m.natural_frequency:.6g}",
            f"{m.damping_ratio + 0.0:.4g}",
        )
        for m in (without_rounding(mode, floor) for mode in modes)
    ]
    titles = ("eigenvalue s [1/s]", "damped frequency |Im s| [rad/s]", "[Hz]", "natural frequency |s| [rad/s]")
    return format_table((*titles, "damping ratio -Re s/|s|"), rows)


def without_rounding(mode: Mode, floor: float) -> Mode:
    """Return a mode whose real part, 1/s, is zero where it is not above the floor."""
    s = mode.eigenvalue
    return mode if abs(s.real) > floor else Mode(complex(0.0, s.imag))


def linearize(
    compiled: CompiledMechanism,
    t: float,
    q: Array,
    v: Array,
    rows: NDArray[np.int64],
    independent: tuple[NDArray[np.int64], ...] | None = None,
    driven: tuple[str, ...] | None = None,
) -> StateSpace:
    """Linearize about the steady state (q (nq,), v (n,)) at time t; ``rows`` are the independent constraints.

    ``independent``: numbers of the coordinates whose positions are states, and of those whose rates are, ascending,
    both with the first-order states; by default they are chosen by pivoting.
    ``driven``: names of the bodies whose driven positions are states; by default those on which anything depends.

    Raises EquilibriumError where a slope is not finite, AssemblyError where a free motion has no inertia.
    """
    check_inertia(compiled.system, t, q, v)
    line, states = LinearizedPlant(compiled, t, q, v, rows, independent), compiled.system.n_states
    positions, rates = line.positions.independent, line.rates.independent
    moving = len(positions) + len(rates)
    free, inputs = line.unit_states(), [line.along_input(k) for k in range(len(compiled.inputs))]
    supports = compiled.inputs.supports()
    speeds = [k for k, (_, _, speed) in supports.items() if speed]
    directions = [*free, *(line.along_drive(k, 0) for k in speeds), *inputs]
    columns = [np.concatenate(line.respond(*direction)) for direction in directions]
    slope = np.array(columns).reshape(len(columns), moving + states + len(compiled.outputs)).T
    moving += states
    if not np.isfinite(slope[:moving]).all():
        raise EquilibriumError(
            "the linearized motion is not finite, because forces and masses differ by too many orders of magnitude"
        )
    least = ZERO_ENTRY_RATIO * np.abs(slope[np.isfinite(slope)]).max(initial=0.0)
    matters = [True] * len(free) + [bool((np.abs(slope[:, len(free) + k]) > least).any()) for k in range(len(speeds))]
    if driven is not None:
        matters[len(free) :] = [compiled.drives.name(k) in driven for k in speeds]
    speeds = [k for k, matter in zip(speeds, matters[len(free) :], strict=True) if matter]
    slope = slope[:, matters + [True] * len(inputs)]
    seen, slope, s = slope[moving:], slope[:moving], len(free) + len(speeds)
    follows = np.zeros((len(speeds), s + len(inputs)))
    for row, k in zip(follows, speeds, strict=True):
        row[s + compiled.inputs.number(k, 1)] = 1.0
    slope = np.vstack((slope, follows))
    names = compiled.system.coordinate_names
    own = names[compiled.system.n_velocities :]
    return StateSpace(
        A=slope[:, :s],
        B=slope[:, s:],
        C=seen[:, :s],
        D=seen[:, s:],
        states=(
            *(names[k] for k in positions),
            *(f"der({names[k]})" for k in rates),
            *own,
            *(compiled.drives.name(k) for k in speeds),
        ),
        inputs=tuple(v.name for v in compiled.inputs.variables),
        outputs=tuple(v.name for v in compiled.outputs),
        coordinates=line.coordinates(),
        n_rates=len(rates) if len(compiled.system.nonholonomic) else None,
        n_states=states,
        diagnostics=tuple(
            Diagnostic.note(
                "not-examined",
                f"input {name!r} moves a support and its {DERIVATIVES[k]} is not an input: terms that depend on it "
                "are left out",
                subject=name,
            )
            for signal, (name, given, _) in supports.items()
            for k in (1, 2)
            if k not in given and (np.abs(np.concatenate(line.respond(*line.along_drive(signal, k)))) > least).any()
        ),
    )


class Partition:
    """Coordinates that are independent under some constraints, and the changes of the others with them."""

    def __init__(self, J: Array, rows: NDArray[np.int64], moving: int, independent: NDArray[np.int64] | None) -> None:
        """Take ``rows`` of J (m, n); of the coordinates the first ``moving`` can depend on others."""
        self.rows, J = rows, J[rows]
        if independent is None:  # dependent coordinates by column pivoting, as the LU partition chooses them
            columns = scipy.linalg.qr(J, pivoting=True, mode="r")[1] if len(rows) else np.arange(J.shape[1])
            independent = np.sort(columns[len(rows) :])
        self.dependent = np.setdiff1d(np.arange(J.shape[1]), independent)
        self.independent = independent[independent < moving]
        self._free = independent
        self._J_dependent, self._J_independent = J[:, self.dependent], J[:, independent]

    def spread(self, values: Array, residual: Array) -> Array:
        """Return the change (n,) of all coordinates with those ``values`` of the independent ones, first-order states
        last and zero by default, and J change = residual (rows,).
        """
        change = np.zeros(len(self.dependent) + len(self._free))
        own = np.zeros(len(self._free))
        own[: len(values)] = values
        change[self._free] = own
        if len(self.rows):
            change[self.dependent] = np.linalg.solve(self._J_dependent, residual - self._J_independent @ own)
        return change


class LinearizedPlant:
    """First-order changes of a compiled mechanism's motion along one state or input at a time.

    Attributes
    ----------
    positions, rates
        Independent coordinates by the constraints of positions, and by all.
    """

    def __init__(
        self,
        compiled: CompiledMechanism,
        t: float,
        q: Array,
        v: Array,
        rows: NDArray[np.int64],
        independent: tuple[NDArray[np.int64], ...] | None = None,
    ) -> None:
        self.compiled, self.t, self.rows = compiled, t, rows
        self.q, self.v = q.astype(complex), v.astype(complex)
        self.system = system = compiled.complex_system()
        self.terms = system.allocate_terms(complex)
        system.fill(t, self.q, self.v, self.terms)
        J, moving = self.terms.J.real, system.n_velocities
        own_positions, own_rates = independent or (None, None)
        self.rates = self.positions = Partition(J, rows, moving, own_rates)
        if len(system.nonholonomic):
            self.positions = Partition(J, np.setdiff1d(rows, system.nonholonomic), moving, own_positions)

    def unit_states(self) -> list[Direction]:
        """Return a direction for each free state; first-order states are changed as rates and have no positions."""
        f, r = len(self.positions.independent), len(self.rates.independent) + self.system.n_states
        return [*((row, np.zeros(r), None) for row in np.eye(f)), *((np.zeros(f), row, None) for row in np.eye(r))]

    def along_input(self, index: int) -> Direction:
        """Return the direction of an input."""
        data, inputs = self.system.data, self.compiled.inputs
        places = inputs.places(data.arrays, self.compiled.signals(data))
        return *self._at_rest(), (*places[index], inputs.scale(index))

    def along_drive(self, signal: int, derivative: int) -> Direction:
        """Return the direction of the position of a drive that is an input, of its rate or of its acceleration."""
        place = self.compiled.signals(self.system.data)[signal].record["c"]
        return *self._at_rest(), (place, derivative, 0.5 if derivative == 2 else 1.0)

    def respond(self, x: Array, rate: Array, place: tuple[Any, int, float] | None) -> tuple[Array, Array]:
        """Return changes of (rates, accelerations) of the independent coordinates, rates of first-order states, and
        outputs for unit changes of states or at a place.
        """
        s, T = self.system, self.terms
        if place:
            vector, k, scale = place
            vector[k] += PRODUCT_STEP_SIZE * 1j * scale
        s.fill(self.t, self.q, self.v, T)
        q, gaps = self.q.copy(), -T.Phi.imag[self.positions.rows] / PRODUCT_STEP_SIZE
        step: Any = PRODUCT_STEP_SIZE * 1j * self.positions.spread(x, gaps)
        s.apply(q, step)
        s.fill(self.t, q, self.v, T)
        opening = (T.nu - T.J @ self.v).imag[self.rows] / PRODUCT_STEP_SIZE
        v = self.v + PRODUCT_STEP_SIZE * 1j * self.rates.spread(rate, opening)
        s.fill(self.t, q, v, T)
        a, lam = self._solve()
        out = self.compiled.observe_complex(s, self.t, q, v, a, lam)
        if place:
            vector[k] = vector[k].real
        slopes = v[self.positions.independent], a[self.rates.independent], a[s.n_velocities :]
        return np.concatenate(slopes).imag / PRODUCT_STEP_SIZE, out.imag / PRODUCT_STEP_SIZE

    def coordinates(self) -> Array:
        """Return the change of all coordinates (n, f) with each of the independent ones, loops closed."""
        closed, f = np.zeros(len(self.positions.rows)), len(self.positions.independent)
        rows = [self.positions.spread(row, closed) for row in np.eye(f)]
        return np.array(rows).reshape(f, self.system.n).T

    def _at_rest(self) -> tuple[Array, Array]:
        return np.zeros(len(self.positions.independent)), np.zeros(len(self.rates.independent) + self.system.n_states)

    def _solve(self) -> tuple[Any, Any]:
        """Return accelerations (n,) and multipliers (m,) of the complex equations of motion, solved in units."""
        T, n, rank = self.terms, self.system.n, len(self.rows)
        size, row = self.system.size, self.system.row_size[self.rows]
        M, J = T.M * np.outer(size, size), T.J[self.rows] * size / row[:, np.newaxis]
        scale = np.abs(M).max() or 1.0  # kg m^2
        K = np.block([[M / scale, J.T], [J, np.zeros((rank, rank))]])
        solution = np.linalg.solve(K, np.concatenate((-T.h * size / scale, T.gamma[self.rows] / row)))
        lam = np.zeros(self.system.m, complex)
        lam[self.rows] = solution[n:] * scale / row
        return solution[:n] * size, lam
