"""`ida` on a large tree by interpreted kernels, as CONTRIBUTING.md proposes for debugging: it starts within seconds."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from hard_trees import G
from scipy.integrate import solve_ivp

PROGRAM = """
import sys
sys.path.insert(0, sys.argv[1])
import mbfmu
from hard_trees import pendulum_among
m = pendulum_among(61).mechanism
m.output("angle", m.bodies[1].angle())
result = mbfmu.simulate(m, 0.02, interval=0.01, solver="ida", tolerance=1e-5)
assert not result.failure, result.failure
print(*map(float, result["angle"]))
"""
ALLOWED = 10.0  # tolerances


def test_ida_runs_interpreted_on_a_large_tree() -> None:
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-c", PROGRAM, str(Path(__file__).parent)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    angles = np.array(done.stdout.split(), float)
    exact = solve_ivp(
        lambda _, y: (y[1], -1.5 * G * np.cos(y[0])), (0.0, 0.02), (1.0 - 0.5 * np.pi, 0.0), rtol=1e-12, atol=1e-12,
        t_eval=(0.0, 0.01, 0.02),
    ).y[0]  # fmt: skip
    np.testing.assert_allclose(angles, exact, rtol=0.0, atol=ALLOWED * 1e-5)
