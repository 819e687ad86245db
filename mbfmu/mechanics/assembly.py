"""Assembly: consistent positions and velocities from approximate ones, or the loop that cannot close.

Gauss-Newton with the least change of the free coordinates that are not held (minimum norm), the step limited so that
the loops close on the branch the user meant. Run once per start, so plain linear algebra serves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mbfmu.errors import AssemblyError
from solvers.system import Array, System, TreeSystem

CLOSED = 1e-11  # m or rad; a loop is closed
LARGEST_STEP = 0.5  # rad or m in one coordinate and iteration
RANK = 1e-9  # singular values below this part of the largest count as zero
MASSLESS = 1e-12  # ... the same for the mass matrix


def assemble_positions(system: System, t: float, start: Array, held: NDArray[np.bool_]) -> Array:
    """Return positions (nq,) with Phi = 0 near ``start``; ``held`` (n,) coordinates stay."""
    if system.m == 0:
        return start.copy()
    terms = system.allocate_terms()
    q, best, since = start.copy(), np.inf, 0
    dq = np.zeros(system.n)
    for _ in range(200):
        system.fill_position(t, q, terms)
        error = float(np.abs(terms.Phi).max(initial=0.0))
        if error < CLOSED:
            return q
        since = 0 if error < 0.5 * best else since + 1
        best = min(best, error)
        if since > 30:
            break
        dq[:] = 0.0
        dq[~held] = -np.linalg.lstsq(terms.J[:, ~held], terms.Phi, rcond=RANK)[0]
        dq *= min(1.0, LARGEST_STEP / max(float(np.abs(dq).max(initial=0.0)), 1e-300))
        system.apply(q, dq)
    worst = int(np.argmax(np.abs(terms.Phi)))
    raise AssemblyError(
        f"loop cannot close: {system.constraint_names[worst]!r} stays off by {abs(terms.Phi[worst]):.3g} "
        f"(best {best:.3g}); check lengths and start positions, or hold fewer joints fixed"
    )


def assemble_velocities(system: System, t: float, q: Array, start: Array, held: NDArray[np.bool_]) -> Array:
    """Return velocities (n,) with J v = nu, the least change from ``start``; ``held`` coordinates stay."""
    if system.m == 0:
        return start.copy()
    terms = system.allocate_terms()
    system.fill(t, q, start, terms)
    v = start.copy()
    off = terms.J @ v - terms.nu
    v[~held] -= np.linalg.lstsq(terms.J[:, ~held], off, rcond=RANK)[0]
    off = terms.J @ v - terms.nu
    worst = int(np.argmax(np.abs(off))) if system.m else 0
    if system.m and abs(off[worst]) > 1e-8 * max(1.0, float(np.abs(v).max())):
        raise AssemblyError(
            f"start velocities are not consistent: {system.constraint_names[worst]!r} opens at {abs(off[worst]):.3g} "
            "per second; hold fewer joints fixed or give consistent rates"
        )
    return v


def check_inertia(system: System | TreeSystem, t: float, q: Array, v: Array) -> None:
    """Raise AssemblyError where a motion the constraints allow moves no mass.

    Of a large tree the solver finds that out.
    """
    if isinstance(system, TreeSystem):
        return
    terms = system.allocate_terms()
    system.fill(t, q, v, terms)
    basis = np.eye(system.n)
    if system.m and system.n:
        _, sigma, Vt = np.linalg.svd(terms.J)
        rank = int(np.sum(sigma > RANK * max(float(sigma[0]), 1e-300)))
        basis = Vt[rank:].T
    if basis.shape[1] == 0:
        return
    values, vectors = np.linalg.eigh(basis.T @ terms.M @ basis)
    if values[0] <= MASSLESS * max(float(values[-1]), 1e-300):
        mode = np.abs(basis @ vectors[:, 0])
        names = [system.coordinate_names[i] for i in np.flatnonzero(mode > 0.1 * mode.max())]
        raise AssemblyError(
            f"no inertia: coordinate(s) {', '.join(map(repr, names))} can move without moving mass; "
            "give a body mass or inertia there, or drive or weld the joint"
        )


def dependent_rows(system: System, t: float, q: Array) -> tuple[str, ...]:
    """Return names of constraint rows that depend on the others at q: redundant there."""
    terms = system.allocate_terms()
    system.fill_position(t, q, terms)
    chosen: list[int] = []
    for i in range(system.m):
        sigma = np.linalg.svd(terms.J[[*chosen, i]], compute_uv=False)
        if sigma[-1] > RANK * max(float(sigma[0]), 1.0) and len(chosen) < system.n:
            chosen.append(i)
    return tuple(name for i, name in enumerate(system.constraint_names) if i not in chosen)
