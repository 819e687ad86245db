"""ESDIRK3(2) on a large tree: 'esdirk'; the method is in :mod:`.formulas`.

For meshes of elements, whose fastest modes an explicit method must follow and this one damps. Newton's matrix is the
structured tangent, factored where the steps change or where corrections fall slowly, and kept over steps, times at
output and, where forces are smooth, jumps of the loads. It is taken as symmetric, which halves what a correction reads,
but where there is friction; loads that follow the bodies cost some more of them. Corrections are accelerated, which
makes up for most of what has changed since: a factorization costs as much as twenty of them. Cut joints are held by the
accelerations of every stage, with the tree's saddle system; where a step ends it is brought onto them.

The errors of positions are controlled. They are filtered by (c^2 M + c D + K)^-1 c^2 M, which leaves out of them what
the method damps. In meshes they are measured at the nodes, as displacement and rotation: the error of a node is the sum
of those of all joints before it, and that of one joint depends on the distance of its nodes. So the steps do not depend
on how fine a mesh is.

Errors of velocities are controlled only at corners of the forces: in steps in which they are far above the error that
follows from the last step if the motion is smooth. A corner causes an error of the position that is small in its step
and grows afterwards. In smooth motion, vibrations that the method damps would make the steps short. So would the forces
on meshes, which begin and end in most steps: velocities are not controlled where there is a mesh.

A step is kept as long as the last one unless it must be shorter or may be twice as long, since another length needs
other factors.

A step may pass the requested time, and is interpolated. After a jump of the loads the next ones end there: what a step
needs of the one before it are its accelerations alone.

**Which solver for which size.** In small mechanisms, by their matrices, Radau IIA needs less CPU time for the same
error. A compiled trial of this method on the loop of 'radau', with its Newton matrices, had an evaluation count per
step of 0.7 to 1 times that of 'radau', but errors of order 3: 1.3 to 1.8 times the CPU time of 'radau' at an error of
1e-3, 2 to 4 times at 1e-5 (four-bar, with and without a singular configuration, governor, triple pendulum and chain of
40 links with stiff joints). Radau IIA on trees would need T for a complex c in addition, at four times the work of a
real factorization, and five real solutions for a correction of its three stages, where this method needs three. At the
errors of meshes, 1e-3 to 1e-4, that costs more than the two to four times fewer steps save.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import records
from solvers.compiled.tuple_pointer import pin, unpin
from solvers.diagnostics import Diagnostic
from solvers.energy_account import WORK, EnergyScales
from solvers.inertia import describe_large_growth
from solvers.options import Options, Statistics
from solvers.outcome import CODES, Code
from solvers.projection.saddle import Accelerations, count_freedom
from solvers.resolution import require_resolution
from solvers.stepper import Stepper, validated_vector
from solvers.steppers.compiled_loop import COUNTED, MethodKernels
from solvers.steppers.step_control import TRUNCATED_STEPS
from solvers.steppers.step_loop import Integration, one_step_at_most
from solvers.system import MAX_SOLVER_DENSE_COORDINATES, Array, TreeSystem

from . import loop
from .formulas import Memory
from .steps import Work

ESDIRK_KERNELS = MethodKernels(loop.start, loop.limit_steps, loop.count)


class TreeESDIRKStepper(Stepper):
    """ESDIRK3(2) on a large tree."""

    loop: ClassVar = loop
    min_rtol = loop.MIN_RTOL

    def __init__(self, system: TreeSystem, t0: float, q0: Array, v0: Array, options: Options | None = None) -> None:
        explicit = ("adams",) if system.elimination or system.n <= MAX_SOLVER_DENSE_COORDINATES else ()
        self.fallback_solvers = (*explicit, "ida") if system.m else ("adams", "ida")
        super().__init__(system, t0, q0, v0, options)
        self.system, n, options = system, system.n, self.options
        self._settings, self._memory = records(1, loop.SETTINGS), Memory.allocate(system.nq, n, system.m)
        loop.set_options(options.record(), self._settings)
        self._settings["is_symmetric"] = system.tangent.symmetric
        self._settings["is_smooth"] = not system.nonsmooth_reason
        work = Work.allocate(system.nq, n, system.m, system.placed)
        if system.mesh_motion is not None and system.mesh_mask is not None and system.mesh_mask.any():
            work.mesh_mask[:], self._settings["mesh_length"] = system.mesh_mask, system.mesh_length
        work.size[:], work.inertia["watched"] = system.size, system.can_compute_rate_growth
        unpin(work.constraints).row_size[:] = system.row_size
        self._motion, self._inertia = Accelerations(system), work.inertia
        self._scales = EnergyScales.of(options.rtol, np.zeros(n), np.zeros(n))
        own = system.equations, self._settings, pin(self._memory), pin(work), pin(self._scales)
        self.integration = pin(Integration(*own, self._q, self._v, self._energy_account))
        code = loop.set_up(self.integration, self._t, system.rate, options.duration)
        rtol, rate = float(self._settings["rtol"][0]), float(self._settings["rate"][0])
        require_resolution(self._t, rate, self._q, work.size_q, rtol, system.coordinate_names)
        self.status = self._status(CODES[code])
        self.restart()

    def advance_to(self, t: float) -> Code:
        """As :meth:`solvers.stepper.Stepper.advance_to`."""
        code = CODES[loop.advance_reported(self.integration, t)]
        self._t = t if code is Code.OK else float(self._memory.control["t"][0])
        return code

    def _take_one_step(self, t: float) -> Code:
        with one_step_at_most(self._settings):
            return super()._take_one_step(t)

    @property
    def has_dense_output(self) -> bool:
        """As :attr:`solvers.stepper.Stepper.has_dense_output`."""
        return True

    @property
    def own_time(self) -> float:
        """As :attr:`solvers.stepper.Stepper.own_time`."""
        return float(self._memory.control["t"][0])

    def limit_step(self, longest: float) -> None:
        """As :meth:`solvers.stepper.Stepper.limit_step`."""
        self._settings["max_step"] = longest

    @property
    def freedom(self) -> int:
        """In how many ways the constraints let the mechanism move at most."""
        return count_freedom(self.system, self._t, self._q)

    def evaluate(self) -> tuple[Code, Array, Array]:
        """As :meth:`solvers.stepper.Stepper.evaluate`."""
        code = self._motion.solve(self._t, self._q, self._v)
        return code, self._motion.a.copy(), self._motion.lam.copy()

    def restart(self) -> None:
        """Restart at the reported state, without its history."""
        self._start(0)

    def continue_after_event(self) -> None:
        """Continue in steps that end at the requested time, at which the next change may occur."""
        self._start(TRUNCATED_STEPS)

    def _start(self, truncated_steps: int) -> None:
        self._settings["works"] = self.options.energy_check and self.system.works()
        state = self._t, self._q, self._v, float(self._energy_account[WORK])
        ESDIRK_KERNELS.start(unpin(self.integration).memory, *state, truncated_steps, False)

    def jump(self, dv: Array) -> None:
        """Add dv (n,) to the reported velocities, and continue as after :meth:`continue_after_event`."""
        self._v += validated_vector("dv", dv, self.system.n)
        self.continue_after_event()

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Whether the tolerance is larger than requested, or errors may be far above it: the order is low for a nearly
        singular mass matrix.
        """
        found = list(super().diagnostics)
        if large := describe_large_growth(self._inertia):
            text = f"{large}, and errors of 'esdirk' (order 3) may be 100 times the tolerance"
            remedy, since = "Use 'adams' or 'ida'", float(self._inertia[0]["large_since"])
            found.append(Diagnostic.warning("ill-conditioned-mass", text, remedy, subject="esdirk", time=since))
        return tuple(found)

    def arrays(self) -> list[NDArray[Any]]:
        """As :meth:`solvers.stepper.Stepper.arrays`."""
        own = self.clock, self._q, self._v, self._energy_account, self._settings
        return [*self._memory, *own, self._scales.bound_results, self._inertia]

    def restore(self, data: bytes) -> None:
        """Return to the state in which ``data`` was saved, bit for bit: factors are made again from their data."""
        super().restore(data)
        loop.discard_factors(self.integration, self._settings)

    @property
    def statistics(self) -> Statistics:
        """What the run has cost so far."""
        counts, control = np.zeros(len(COUNTED), np.int64), self._memory.control[0]
        ESDIRK_KERNELS.count(unpin(self.integration).memory, counts)
        return Statistics(
            **dict(zip(COUNTED, counts.tolist(), strict=True)),
            order=3,
            step_size=float(control["hold"]),
            coarser=float(self._settings["rtol"][0]) / self.options.rtol,
            rate_growth=float(self._inertia["largest"][0]),
            rate_growth_at=float(self._inertia["at"][0]),
        )
