"""Models for the export of MJCF and URDF files, and comparison of their equations of motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import mbfmu as mb
from mbfmu.mechanics import CompiledMechanism


@dataclass(frozen=True, kw_only=True)
class Given(mb.Model):
    """A model whose mechanism a function makes."""

    name = "given"
    make: Any = None

    def build(self) -> mb.Mechanism:
        m: mb.Mechanism = self.make()
        return m


def solid(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    R = Rotation.random(rng=rng).as_matrix()
    return {"mass": 1.0 + seed, "com": rng.standard_normal(3), "inertia": R @ np.diag((0.2, 0.3, 0.4)) @ R.T}


CONTROLS = {"push": 3.0, "push.force": 3.0, "b.force": 3.0, "pull": 0.7, "pull.control": 0.7}  # push: beyond its limit


def terms_of(compiled: CompiledMechanism, q: np.ndarray, v: np.ndarray) -> Any:
    for index, variable in enumerate(compiled.inputs.variables):
        compiled.inputs.start(index, CONTROLS.get(variable.name, 0.0))
    terms = compiled.system.allocate_terms()
    compiled.system.fill(0.0, q, v, terms)
    return terms


def random_state(nq: int, nv: int, quaternions: list[int]) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    q, v = rng.standard_normal(nq), rng.standard_normal(nv)
    for k in quaternions:
        q[k : k + 4] /= np.linalg.norm(q[k : k + 4])
    return q, v


def close(found: Any, expected: Any, size: float = 1e-13) -> None:
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=size * float(np.abs(expected).max()))


def check_equal(own: CompiledMechanism, other: CompiledMechanism) -> None:
    """Mass matrix and forces at a random state; bodies of both are in the same order."""
    assert own.system.n == other.system.n
    records = own.data.arrays.bodies
    with_quaternion = [int(records[b.index]["qi"]) + b.joint.nq - 4 for b in own.mechanism.bodies if b.joint.quaternion]
    q, v = random_state(own.system.n + len(with_quaternion), own.system.n, with_quaternion)
    first, second = terms_of(own, q, v), terms_of(other, q, v)
    close(second.M, first.M)
    close(second.h, first.h)
