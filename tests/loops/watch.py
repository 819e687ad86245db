"""What a solver makes of positions without integrating: critical points, and which steps are accepted."""

from __future__ import annotations

import numpy as np

from mbfmu.mechanics import CompiledMechanism, Mechanism
from solvers import Options
from solvers.compiled.kernel import kernel
from solvers.projection import branch, singular
from solvers.projection.workspace import factor
from solvers.steppers.adams.dense import AdamsStepper
from solvers.system import System


@kernel
def begin(eqs, q, rank, work):
    """Let q be the last good position; return the kind of the critical point next to it."""
    c = work.critical[0]
    c.kind, c.failed_search_ratio, work.branch_history[0].pivot_ratio = singular.NO_CRITICAL_POINT, 0.0, 0.0
    eqs.position(0.0, q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    kind = singular.classify_singularity(eqs, 0.0, q, rank, work)
    singular.record_accepted(eqs, 0.0, q, 0.0, 0.0, rank, work)
    return kind


@kernel
def passes(eqs, q, rank, work):
    """Whether a step from the last good position to q is accepted."""
    eqs.position(0.0, q, eqs.data, eqs.terms)
    factor(eqs.terms, work)
    return branch.on_same_branch(eqs, 0.0, q, branch.BRANCH_RESOLUTION, rank, work)


class Watch:
    """The part of a stepper that follows the branch of a motion, without steps."""

    def __init__(self, mechanism: Mechanism) -> None:
        compiled = CompiledMechanism(mechanism)
        assert isinstance(compiled.system, System)
        self.motion = AdamsStepper(compiled.system, 0.0, *compiled.assemble(), Options(rtol=1e-6))

    def begin(self, q) -> int:
        """As the function."""
        return begin(self.motion.formulation.equations, q, self.motion.formulation.rank, self.motion.formulation.work)

    def passes(self, q) -> bool:
        """As the function, for a closed position q."""
        form = self.motion.formulation
        accepted = passes(form.equations, q, form.rank, form.work)
        assert np.abs(form.terms.Phi).max() < 1e-12
        return bool(accepted)
