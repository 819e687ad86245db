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
:func:`.tree_memory.refine_tolerances`.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import records
from solvers.compiled.tuple_pointer import pin, unpin
from solvers.diagnostics import Diagnostic
from solvers.energy_account import EnergyScales
from solvers.inertia import describe_large_growth
from solvers.options import Options
from solvers.outcome import CODES, Code
from solvers.projection.saddle import Accelerations, count_freedom
from solvers.resolution import require_resolution
from solvers.steppers.step_loop import Integration
from solvers.system import MAX_SOLVER_DENSE_COORDINATES, Array, TreeSystem

from . import tree_loop
from .binding import BoundIDA
from .calls import KRYLOV_DIMENSION, LINEAR_TOLERANCE, STICKING_LINEAR_TOLERANCE
from .driver import IDADriver
from .loop import MAX_CONVERGENCE_FAILURES
from .sundials import DirectIDA, is_library_supported
from .tree_c import EXACT_TREE_CALLBACKS, TREE_CALLBACKS, WEIGHING_TREE_CALLBACKS, step_until
from .tree_callbacks import (
    ComplexStep,
    ResidualData,
    Scratch,
    accept_step,
    apply_preconditioner,
    evaluate_residual,
    set_up_preconditioner,
)
from .tree_memory import (
    MAX_MESH_ORDER,
    TreeIDAMemory,
    Work,
    end_start,
    fill_start,
    report_unknowns,
    set_options,
    set_up,
)

# Factor of the error of a mesh; error in tolerances from which on it is reported.
MESH_ERROR_FACTOR, MIN_REPORTED_ERROR = 0.18, 30.0
MIN_RTOL = 1e-12


class TreeIDAStepper(IDADriver):
    """IDA on a large tree."""

    loop: ClassVar = tree_loop

    def __init__(self, system: TreeSystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        explicit = ("adams",) if system.elimination or system.n <= MAX_SOLVER_DENSE_COORDINATES else ()
        self.fallback_solvers = explicit if system.m else ("adams",)
        super().__init__(system, t0, q0, v0, options)
        self.system = system
        nq, n, m = system.nq, system.n, system.m
        memory, settings = TreeIDAMemory.allocate(nq, n, m), records(1, tree_loop.SETTINGS)
        self._set_records(memory.counts, memory.energy_record, memory.progress)
        settings["has_mesh"], settings["is_smooth"] = self._has_mesh, not system.nonsmooth_reason
        settings["weighs_errors"] = bool(system.nonsmooth_reason) or system.can_compute_rate_growth
        settings["linear_tolerance"] = STICKING_LINEAR_TOLERANCE if system.stick_reason else LINEAR_TOLERANCE
        work = Work.allocate(nq, n, m, system.placed)
        work = work._replace(complex_step=self._make_complex_step(unpin(unpin(work.own).reduced)))
        work.size[:], work.inertia["watched"] = system.size, system.can_compute_rate_growth
        unpin(work.constraints).row_size[:] = system.row_size
        work.mesh_mask[:] = 1.0 if system.mesh_mask is None else system.mesh_mask
        if system.friction_velocity is not None:
            work.friction_velocity[:] = system.friction_velocity
        self._memory, self._settings, self._inertia = memory, settings, work.inertia
        self._motion = Accelerations(system)
        self._scales = pin(EnergyScales.of(self.options.rtol, np.zeros(n), np.zeros(n)))
        own = system.equations, settings, pin(memory), pin(work), self._scales
        self.integration = pin(Integration(*own, self._q, self._v, self._energy_account))
        set_options(self.options.record(), self.integration)
        code = set_up(self.integration, self._t, system.rate, self.options.duration)
        rtol, rate = self.options.rtol, float(settings["rate"][0])
        require_resolution(self._t, rate, self._q, work.size_q, rtol, system.coordinate_names)
        self._ida = self._make_ida()
        self.status = self._status(CODES[code])

    def _make_ida(self) -> DirectIDA | BoundIDA:
        system, options, memory, settings = self.system, self.options, self._memory, self._settings[0]
        rtol, order, problem = float(settings["rtol"]), int(settings["max_order"]), self.integration
        if is_library_supported():
            weighing = WEIGHING_TREE_CALLBACKS if settings["weighs_errors"] else TREE_CALLBACKS
            return DirectIDA(
                EXACT_TREE_CALLBACKS if system.nonsmooth_reason else weighing, step_until, problem, memory.progress,
                memory.counts, unpin(unpin(problem).memory).ida, rtol=rtol, max_order=order, max_step=options.max_step,
                linear_tolerance=float(settings["linear_tolerance"]),
            )  # fmt: skip
        if system.nonsmooth_reason:
            raise ValueError(
                Diagnostic.error(
                    "unsuitable-solver",
                    "solver 'ida' needs the C functions of SUNDIALS 7 for this model, which are not installed "
                    f"({system.nonsmooth_reason}); use 'esdirk'",
                    subject="ida",
                )
            )

        from sksundae.ida import IDAPrecond

        def residual(t: float, y: Array, yp: Array, res: Array) -> None:
            evaluate_residual(t, y, yp, res, problem)

        def set_up(t: float, y: Array, yp: Array, res: Array, cj: float) -> int:
            return int(set_up_preconditioner(t, y, yp, cj, problem))

        def solve(t: float, y: Array, yp: Array, res: Array, r: Array, z: Array, cj: float, delta: float) -> None:
            apply_preconditioner(y, r, z, problem)

        return BoundIDA(
            residual, lambda t, y, slopes, _: accept_step(t, y, slopes, problem), self._counts, self._progress_array,
            linsolver="gmres", krylov_dim=KRYLOV_DIMENSION, precond=IDAPrecond(set_up, solve),
            max_step=0.0 if np.isinf(options.max_step) else options.max_step,
            max_conv_fails=MAX_CONVERGENCE_FAILURES, rtol=rtol, atol=memory.ida.atol, max_order=order,
        )  # fmt: skip

    def _describe_mesh_error(self) -> tuple[Diagnostic, ...]:
        """Return how large the errors of a mesh may be; empty: hardly larger than the tolerance, or there is no mesh.

        The error of a coordinate grows with the square root of their number and falls as the tolerance to the power
        2/3; the factor was measured on meshes of 35 to 165 nodes, damped and undamped.
        """
        meshed = self.system.mesh_mask
        if meshed is None or not meshed.any() or int(self._settings["max_order"][0]) > MAX_MESH_ORDER:
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

    def _make_complex_step(self, reduced: Any) -> Any:
        """Return what products of Newton's matrix are made with, where forces turn sharply."""
        system = self.system
        if not system.nonsmooth_reason or system.complex_step is None:
            return None
        nq, n, m = system.nq, system.n, system.m
        scratch, terms = Scratch.allocate(nq, n, m, complex), system.allocate_terms(complex)
        own = ResidualData(scratch, terms, reduced, system.placed)
        return ComplexStep(system.complex_step(), own, *np.zeros((3, nq + n + 2 * m), complex))

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Whether the mass matrix requires a finer tolerance, and how large the errors of a mesh may be."""
        large = describe_large_growth(self._inertia) if isinstance(self._ida, BoundIDA) else ""
        if large:
            text = f"{large}, and 'ida' without the C functions of SUNDIALS 7 cannot compensate that"
            since = float(self._inertia[0]["large_since"])
            mass = Diagnostic.warning("ill-conditioned-mass", text, "Use 'adams'", subject="ida", time=since)
            return (*self._describe_mesh_error(), mass)
        return self._describe_mesh_error()

    def _has_work(self) -> bool:
        return self.system.works()

    def _growth(self) -> tuple[float, float]:
        return float(self._inertia[0]["largest"]), float(self._inertia[0]["at"])

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        return [*super().arrays(), self._inertia]

    def _begin(self) -> Code:
        self._settings["works"] = self._has_work()
        code = CODES[fill_start(self.integration, self._t)]
        if code is Code.OK:
            self._begin_with(self._memory.ida.y, self._memory.ida.slopes)
            end_start(self.integration, self._t)
        return code

    @property
    def internal_state(self) -> tuple[float, Array, Array]:
        """Time (s), positions (nq,) and velocities (n,) that IDA itself has reached, which may be off the constraints.

        They are valid between two steps.
        """
        y, nq, n = self._ida.y, self.system.nq, self.system.n
        return float(self._progress["t_reached"]), y[:nq].copy(), y[nq : nq + n].copy()

    def _report_unknowns(self, t: float, y: Array) -> Code:
        code = CODES[report_unknowns(self.integration, t, y)]
        if code is Code.OK:
            self._t = t
        return code

    @property
    def freedom(self) -> int:
        """In how many ways the constraints let the mechanism move at most."""
        return count_freedom(self.system, self._t, self._q)

    def evaluate(self) -> tuple[Code, Array, Array]:
        """As :meth:`solvers.stepper.Stepper.evaluate`."""
        code = self._motion.solve(self._t, self._q, self._v)
        return code, self._motion.a.copy(), self._motion.lam.copy()
