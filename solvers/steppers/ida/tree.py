"""SUNDIALS IDA on a large tree ('ida' where the system is a :class:`solvers.system.TreeSystem`).

Unknowns y = (q, v, lambda, mu), the last two where there are cut joints; residual by inverse dynamics, in the form of
:mod:`.ggl`::

    q' - N(q) (v - S^2 J^T mu) + k (q - unit(q)) = 0      M v' + h + J^T lambda = 0
    J v - nu - d0 lambda = 0                              Phi - d1 mu = 0

S are the sizes of the coordinates: what mu moves is least in units of these. d0 and d1 are TIKHONOV_FACTOR rtol over
the rate of the motion, times the inverse of each constraint's effective mass, and times its J S^2 J^T. The reaction of
a node's support would throw the node alone at hundreds of g: with a D as large as :mod:`.ggl` has, it damps the motion.

Newton's linear systems go to GMRES, whose preconditioner is the structured tangent (all but exact, so one or two
iterations do). With g the first residual as a motion, c = IDA's cj and T = c^2 M + c D + K,

    T dtheta = r2 + c M (g - S^2 J^T dmu) - J^T dlambda,    dv = c dtheta - g + S^2 J^T dmu,    dq = N dtheta.

D g is left out of the right-hand side: it only matters to the preconditioner. With X = T^-1 c M S^2 J^T, A = T^-1 J^T
and theta0 = T^-1 (r2 + c M g) the constraints, the third less c times the fourth, leave 2 m equations::

    [ J S^2 J^T + c d1  -d0  ] [ dmu     ]   [ r3 + J g - c r4 ]
    [ -(J X + d1)      -J A  ] [ dlambda ] = [ r4 - J theta0   ]

**Order.** BDF of orders 3 to 5 are unstable on undamped motions faster than the steps resolve. A mesh has thousands of
them, and its order is 2 unless a larger one is requested. Other trees use orders up to 5; who creates the solver limits
the order if the tree has such motions.

**Weights.** IDA's norm is the root of a mean square, in which one of N unknowns may have an error of sqrt(N)
tolerances. The tolerances of coordinates outside meshes are therefore multiplied by N^-1/2. Absolute tolerances are
relative to the size of each coordinate (an angle of a mesh's joint is curvature times cell, and the errors of a chain
of joints add up); those of rates are MESH_RATE_TOLERANCE_RATIO or RATE_TOLERANCE_RATIO times that in the time of the
motion. Multipliers carry no error control. Reported states are closed onto the constraints.

**Where forces are not smooth**, pressures turn within micrometers and friction within millimeters per second. IDA's own
products of Newton's matrix and a vector are differences over what tolerances allow, which is more: they are taken
exactly, by an imaginary step of the whole residual. And its weights are our own, see
:meth:`TreeIDAStepper._tolerances`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from sksundae.ida import IDAPrecond

from solvers.compiled.tuple_pointer import pin
from solvers.diagnostics import Diagnostic
from solvers.energy_account import EnergyScales
from solvers.inertia import Growth, describe_large_growth
from solvers.linalg.threads import one_thread
from solvers.options import Options
from solvers.outcome import Code
from solvers.projection.saddle import Accelerations, count_freedom, motion_rate, project
from solvers.projection.tree_constraints import set_scales
from solvers.stepper import require_resolution
from solvers.system import MAX_SOLVER_DENSE_COORDINATES, Array, TreeSystem, energy_callbacks

from .binding import BoundIDA
from .calls import KRYLOV_DIMENSION, IDAHandle
from .driver import IDADriver
from .ggl import QUATERNION_LENGTH_RATE
from .loop import JACOBIANS, MAX_CONVERGENCE_FAILURES, MAX_ORDER, N_COUNTERS, STANDSTILL_RATIO
from .sundials import Callbacks, DirectIDA, PythonSetup, is_library_supported
from .tree_callbacks import (
    ComplexStep,
    Reduced,
    Scratch,
    UserData,
    accept_step,
    apply_preconditioner,
    call_error_weights,
    call_matvec,
    call_preconditioner,
    call_residual,
    record_energy,
    step_until,
)
from .tree_callbacks import residual as residual_of_tree

MULTIPLIER_TOLERANCE = 1e100  # absolute tolerance of the multipliers, above any force in any unit
RATE_TOLERANCE_RATIO = 1.0  # absolute tolerance of a rate to that of its coordinate, in units of the motion's rate
MESH_RATE_TOLERANCE_RATIO = 150.0  # the same where the order is low, and fast motions are damped and not followed
MAX_MESH_ORDER = 2  # of BDF on meshes
# Factor of the error of a mesh; error in tolerances from which on it is reported.
MESH_ERROR_FACTOR, MIN_REPORTED_ERROR = 0.18, 30.0
MIN_RTOL = 1e-12
SLIP_TOLERANCE_RATIO = 0.3  # part of the slip at which friction turns over, to which a mesh's speed is known
TIKHONOV_FACTOR = 1e-6


class TreeIDAStepper(IDADriver):
    """IDA on a large tree."""

    def __init__(self, system: TreeSystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        dense = ("adams", "hybrid") if system.n <= MAX_SOLVER_DENSE_COORDINATES else ()
        self.fallback_solvers = dense if system.m else ("adams",)
        super().__init__(system, t0, q0, v0, options)
        self.system = system
        nq, n, m = system.nq, system.n, system.m
        self._velocity_slice = slice(nq, nq + n)
        self._scratch, self._terms = Scratch.allocate(nq, n, m), system.allocate_terms()
        z = np.zeros
        self._reduced = Reduced(
            np.ones(1), z((2, m)), system.size**2, z((m, n)), z((n, m)), z((n, m)), z((2 * m, 2 * m))
        )
        self._motion = Accelerations(system)
        self._rate = motion_rate(self._motion, self._t, self._q, self._v, self.options.duration)
        sizes, rtol = system.position_sizes(system.size), self.options.rtol
        require_resolution(self._t, self._rate, self._q, sizes, rtol, system.coordinate_names)
        self._progress["min_step"] = STANDSTILL_RATIO / self._rate
        self._growth_data = Growth.of(system, self._rate)
        self._ida = self._make_ida()
        self.status = self._status(project(system, self._t, self._q, self._v))

    def _make_ida(self) -> DirectIDA | BoundIDA:
        system, options = self.system, self.options
        mesh = self._has_mesh
        order = self._order = options.max_order or (MAX_MESH_ORDER if mesh else MAX_ORDER)
        part = 1.0 if mesh else (system.nq + system.n + 2 * system.m) ** -0.5
        sizes = options.absolute * system.size
        rates = (RATE_TOLERANCE_RATIO if order > MAX_MESH_ORDER else MESH_RATE_TOLERANCE_RATIO) * self._rate * sizes
        atol = np.concatenate(
            (part * system.position_sizes(sizes), part * rates, np.full(2 * system.m, MULTIPLIER_TOLERANCE))
        )
        self._scales = pin(self._find_scales(sizes, rates, len(atol)))
        user_data = self._user_data = pin(
            UserData(
                system.inverse, system.retract, system.position, *energy_callbacks(system), system.pinned_data,
                self._terms, system.positions, system.tangent.callbacks.solve_tangent,
                system.tangent.callbacks.multiply_mass_matrix, system.tangent.callbacks.tangent, self._scratch,
                self._reduced, QUATERNION_LENGTH_RATE * self._rate, len(atol),
                self._energy_record, self._scales, self._counts, self._progress_array,
                self._tolerances(atol, part * options.rtol),
                self._make_complex_step(len(atol)), system.parts_callback, pin(self._growth_data),
            )
        )  # fmt: skip
        ida_options: dict[str, Any] = {"rtol": part * options.rtol, "atol": atol, "max_order": order}
        if system.nonsmooth_reason and not is_library_supported():
            raise ValueError(
                Diagnostic.error(
                    "unsuitable-solver",
                    "solver 'ida' needs the C functions of SUNDIALS 7 for this model, which are not installed "
                    f"({system.nonsmooth_reason}); use 'esdirk'",
                    subject="ida",
                )
            )
        if is_library_supported():
            exact: dict[str, Any] = (
                {"error_weights": call_error_weights}
                if system.nonsmooth_reason or system.can_compute_rate_growth
                else {}
            )
            if system.nonsmooth_reason:
                exact["matvec"] = call_matvec
            callbacks = Callbacks(call_residual, PythonSetup(self._set_up, len(atol)), call_preconditioner, **exact)
            handle = IDAHandle.allocate(len(atol))
            handle.atol[:] = atol
            return DirectIDA(
                callbacks, step_until, user_data, self._progress_array, self._counts, pin(handle),
                rtol=part * options.rtol, max_order=order, max_step=options.max_step,
            )  # fmt: skip

        def residual(t: float, y: Array, yp: Array, res: Array) -> None:
            residual_of_tree(t, y, yp, res, user_data)

        def solve(t: float, y: Array, yp: Array, res: Array, r: Array, z: Array, cj: float, delta: float) -> None:
            apply_preconditioner(y, r, z, user_data)

        return BoundIDA(
            residual, lambda t, y, slopes, _: accept_step(t, y, slopes, user_data), self._counts, self._progress_array,
            linsolver="gmres", krylov_dim=KRYLOV_DIMENSION, precond=IDAPrecond(self._set_up, solve),
            max_step=0.0 if np.isinf(options.max_step) else options.max_step,
            max_conv_fails=MAX_CONVERGENCE_FAILURES, **ida_options,
        )  # fmt: skip

    def _describe_mesh_error(self) -> tuple[Diagnostic, ...]:
        """Return how large the errors of a mesh may be; empty: hardly larger than the tolerance, or there is no mesh.

        The error of a coordinate grows with the square root of their number and falls as the tolerance to the power
        2/3; the factor was measured on meshes of 35 to 165 nodes, damped and undamped.
        """
        meshed = self.system.mesh_mask
        if meshed is None or not meshed.any() or self._order > MAX_MESH_ORDER:
            return ()
        rtol, factor = self.options.rtol, MESH_ERROR_FACTOR * float(np.sum(meshed)) ** 0.5
        error, needed = factor * rtol ** (-1.0 / 3.0), (rtol / factor) ** 1.5
        if error < MIN_REPORTED_ERROR:
            return ()
        finer = f", or 'ida' at a tolerance of {needed:.0e}" if needed >= MIN_RTOL else ""
        return (
            Diagnostic.warning(
                "large-error",
                "'ida' uses only orders 1 and 2 for a model with a mesh: the errors of its coordinates may be about "
                f"{float(f'{error:.1g}'):.0f} times the tolerance of {rtol:g}, and several times that if vibrations "
                "are undamped or the run is long",
                f"If this is too large, use 'esdirk' at a tolerance of 1e-6 or more{finer}",
                subject="ida",
            ),
        )

    @property
    def _has_mesh(self) -> bool:
        return self.system.mesh_mask is not None and bool(self.system.mesh_mask.any())

    def _find_scales(self, sizes: Array, rates: Array, count: int) -> EnergyScales:
        """Return the scales of the energy error: those of the requested tolerances, independent of those of IDA.

        The stiff modes of a mesh are damped on purpose, as far as IDA's own tolerances let them be.
        """
        if self._has_mesh:
            return EnergyScales.of_mesh(self.options.rtol, sizes, rates, count, MESH_RATE_TOLERANCE_RATIO)
        return EnergyScales.of(self.options.rtol, sizes, self._rate * sizes)

    def _make_complex_step(self, count: int) -> Any:
        """Return what products of Newton's matrix are made with, where forces turn sharply."""
        system = self.system
        if not system.nonsmooth_reason or system.complex_step is None:
            return None
        (inverse, position, retract, data), z = system.complex_step(), np.zeros((3, count), complex)
        return ComplexStep(
            inverse, position, retract, data, system.allocate_terms(complex), system.positions,
            Scratch.allocate(system.nq, system.n, system.m, complex), self._reduced,
            QUATERNION_LENGTH_RATE * self._rate, np.zeros(N_COUNTERS), *z,
        )  # fmt: skip

    def _tolerances(self, atol: Array, rtol: float) -> Array:
        """Return tolerances where they are weighed (3, N): relative, absolute, the largest.

        IDA's norm is the root of a mean square, in which one of N unknowns may be off by sqrt(N) tolerances. A mesh has
        many similar ones, but few determine the position of a mesh as a whole. Their rates are accurate to a part of
        the slip at which friction turns over too: where it reverses within a step, that is what is left of it.
        """
        system, N = self.system, len(atol)
        relative = self.options.rtol if system.nonsmooth_reason else rtol
        found = np.vstack((np.full(N, relative), atol, np.full(N, np.inf)))
        if system.nonsmooth_reason and system.mesh_mask is not None and system.friction_velocity is not None:
            parts = np.where(system.mesh_mask, 1.0, N**-0.5)
            found[:2, : system.nq] *= system.position_sizes(parts) / system.position_sizes(np.ones(system.n))
            found[:2, self._velocity_slice] *= parts
            found[2, self._velocity_slice] = SLIP_TOLERANCE_RATIO * parts * system.friction_velocity
        return found

    def _set_up(self, t: float, y: Array, yp: Array, res: Array, cj: float) -> int:
        """Factor the tangent and the equations of the constraints; 1: it is singular there."""
        self._counts[JACOBIANS] += 1.0
        residual_of_tree(t, y, yp, np.empty(len(y)), self._user_data)
        self._reduced.c[0] = cj
        if not self.system.tangent.factor(cj, cj * cj):
            return 1
        self._reduce_constraints(cj)
        return 0

    def _reduce_constraints(self, cj: float) -> None:
        system, m, (d0, d1) = self.system, self.system.m, map(np.diag, self._reduced.d)
        if not m:
            return
        J = self._reduced.J
        J[:] = self._terms.J
        moved = self._reduced.metric * J
        inertia = np.array([system.tangent.inertia(row) for row in moved])
        both = system.tangent.solve(np.vstack((J, cj * inertia)).T)  # (n, 2 m)
        A, X = self._reduced.A, self._reduced.X
        A[:], X[:] = both[:, :m], both[:, m:]
        self._reduced.inverse[:] = np.linalg.inv(np.block([[J @ moved.T + cj * d1, -d0], [-J @ X - d1, -J @ A]]))

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Whether the mass matrix requires a finer tolerance, and how large the errors of a mesh may be."""
        large = describe_large_growth(self._growth_data.inertia) if isinstance(self._ida, BoundIDA) else ""
        if large:
            text = f"{large}, and 'ida' without the C functions of SUNDIALS 7 cannot compensate that"
            since = float(self._growth_data.inertia[0]["large_since"])
            mass = Diagnostic.warning("ill-conditioned-mass", text, "Use 'adams'", subject="ida", time=since)
            return (*self._describe_mesh_error(), mass)
        return self._describe_mesh_error()

    def _has_work(self) -> bool:
        return self.system.works()

    def _growth(self) -> tuple[float, float]:
        record = self._growth_data.inertia[0]
        return float(record["largest"]), float(record["at"])

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        return [*super().arrays(), self._growth_data.inertia]

    def advance_to(self, t: float) -> Code:
        """As :meth:`solvers.stepper.Stepper.advance_to`."""
        with one_thread():
            return super().advance_to(t)

    def _begin(self) -> Code:
        motion, m = self._motion, self.system.m
        code = motion.solve(self._t, self._q, self._v)
        if code is Code.OK:
            J, zeros = motion.terms.J, np.zeros(m)
            part, squares = TIKHONOV_FACTOR * self.options.rtol / self._rate, J * J @ self._reduced.metric
            set_scales(squares, self._reduced.d[1])
            self._reduced.d[0], self._reduced.d[1] = part / motion.masses, part / self._reduced.d[1]
            y = np.concatenate((self._q, self._v, motion.lam, zeros))
            yp = np.concatenate((motion.qdot, motion.a, zeros, zeros))
            self._begin_with(y, yp)
            if self.options.energy_check:
                record_energy(self._t, y, yp, self._user_data)
        return code

    @property
    def internal_state(self) -> tuple[float, Array, Array]:
        """Time (s), positions (nq,) and velocities (n,) that IDA itself has reached, which may be off the constraints.

        They are valid between two steps.
        """
        y = self._ida.y
        return float(self._progress["t_reached"]), y[: self.system.nq].copy(), y[self._velocity_slice].copy()

    def _report_unknowns(self, t: float, y: Array) -> Code:
        if not np.isfinite(y).all():
            return Code.NOT_FINITE
        q, v = y[: self.system.nq].copy(), y[self._velocity_slice].copy()
        code = project(self.system, t, q, v)
        if code is Code.OK:
            self._t, self._q, self._v = t, q, v
        return code

    @property
    def freedom(self) -> int:
        """In how many ways the constraints let the mechanism move at most."""
        return count_freedom(self.system, self._t, self._q)

    def evaluate(self) -> tuple[Code, Array, Array]:
        """As :meth:`solvers.stepper.Stepper.evaluate`."""
        code = self._motion.solve(self._t, self._q, self._v)
        return code, self._motion.a.copy(), self._motion.lam.copy()
