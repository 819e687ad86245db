"""Natural modes of a large tree about an equilibrium: K phi = omega^2 M phi by shifted inverse iteration (Lanczos)."""

from __future__ import annotations

import numpy as np
from scipy.sparse.linalg import ArpackError, ArpackNoConvergence, LinearOperator, eigsh

from solvers.projection.saddle import Saddle
from solvers.system import Array

RESTARTS = 100
PRECISE = 1e-12  # of omega^2; full precision may not be within the reach of rounding
SHIFT = 1.0  # (rad/s)^2 below zero, so that rigid motions do not make K singular


def natural_modes(saddle: Saddle, count: int) -> tuple[Array, Array]:
    """Return the lowest ``count`` omega^2, (rad/s)^2, and the modes (n, count), of unit modal mass.

    The steady state is that of ``saddle``'s last residual; of constrained motions those that J allows.
    LinAlgError where they are not found.
    """
    system = saddle.system
    tangent, n, still = system.tangent, system.n, np.zeros(system.m)
    if not saddle.factor(0.0, SHIFT):
        raise np.linalg.LinAlgError("stiffness and mass are singular together")
    mass = LinearOperator((n, n), matvec=tangent.inertia, dtype=float)
    inverse = LinearOperator((n, n), matvec=lambda f: saddle.solve(f, still)[0], dtype=float)
    start = saddle.solve(tangent.inertia(np.random.default_rng(0).normal(size=n)), still)[0]
    options = {"sigma": -SHIFT, "OPinv": inverse, "which": "LM", "v0": start, "tol": PRECISE, "maxiter": RESTARTS}
    try:
        values, modes = eigsh(mass, k=count, M=mass, **options)
    except ArpackNoConvergence as stuck:
        raise np.linalg.LinAlgError(f"{len(stuck.eigenvalues)} of {count} converged") from stuck
    except ArpackError as error:
        raise np.linalg.LinAlgError("stiffness and mass are too far apart") from error
    order = np.argsort(values)
    return values[order], modes[:, order]
