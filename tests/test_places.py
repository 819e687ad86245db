"""A kind of every role in a file outside the package goes wherever those of the package do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu
from scipy.integrate import solve_ivp

from mbfmu import UserError, equilibrium, linearize, simulate
from mbfmu.fmi import export
from mbfmu.mechanics import Force, Mechanism, Revolute, Spring, rod
from mbfmu.modeling.registry import load
from mbfmu.modeling.settings import Settings
from mbfmu.viewer.drawing import draw
from solvers.compiled.kernel import COMPILED

FILE = """
from dataclasses import dataclass

import numpy as np

from mbfmu.mechanics import (
    Coupling, CutJoint, Force, Joint, Load, Mechanism, Sensor, Signal, Translational, kernel, rod, signal_value
)
from mbfmu.mechanics.spatial import arm
from mbfmu.modeling import Model, parameter


@kernel
def slide(joint, qi, state):
    rel = state.rel[0]
    for i in range(3):
        rel.S[0, i], rel.S[0, 3 + i] = 0.0, 0.0
        for j in range(3):
            rel.R[i, j] = 1.0 if i == j else 0.0
        rel.p[i] = 0.0
    rel.S[0, 1] = 2.0 * joint.bend * state.q[qi]
    rel.S[0, 0] = 1.0
    rel.p[0], rel.p[1] = state.q[qi], joint.bend * state.q[qi] ** 2


@kernel
def slide_bias(joint, qi, vi, state):
    for k in range(6):
        state.rel[0].bias[k] = 0.0 * state.v[vi]
    state.rel[0].bias[1] = 2.0 * joint.bend * state.v[vi] ** 2


@dataclass(frozen=True, kw_only=True)
class Parabola(Joint):
    record = np.dtype([("bend", np.float64)])
    place, bias = slide, slide_bias
    nq, nv = 1, 1
    coordinates, units = ("",), ("m",)
    bend: float  # 1/m

    def fill(self, record, site):
        record["bend"] = self.bend


@kernel
def level(cut, A, B, row, arrays, state):
    out = state.rows[row]
    ax, ay, az = arm(A, cut.Pa)
    bx, by, bz = arm(B, cut.Pb)
    out.Phi = B.r[1] + by - A.r[1] - ay
    out.bias = B.Y[5] * (B.Y[3] * by - B.Y[4] * bx) - B.Y[3] * (B.Y[4] * bz - B.Y[5] * by)
    out.bias -= A.Y[5] * (A.Y[3] * ay - A.Y[4] * ax) - A.Y[3] * (A.Y[4] * az - A.Y[5] * ay)
    for k in range(6):
        out.Ga[k], out.Gb[k] = 0.0, 0.0
    out.Gb[1], out.Gb[3], out.Gb[5] = 1.0, -bz, bx
    out.Ga[1], out.Ga[3], out.Ga[5] = -1.0, az, -ax


@dataclass(frozen=True, kw_only=True)
class LevelCut(CutJoint):
    rows, units = ("y",), ("N",)
    evaluate = level


@kernel
def square(coupling, x, arrays):
    return coupling.bend * x * x, 2.0 * coupling.bend * x, 2.0 * coupling.bend + 0.0 * x


@dataclass(frozen=True, kw_only=True)
class Squares(Coupling):
    record = np.dtype([("bend", np.float64)])
    evaluate = square
    bend: float  # 1/m

    def fill(self, record, site):
        record["bend"] = self.bend


@kernel
def pull(force, t, arrays, state):
    f = signal_value(force.signal, t, arrays)
    for k in range(3):
        state.bodies[force.body].F[k] -= f * force.strength * state.bodies[force.body].r[k] ** 3


@kernel
def pull_potential(force, arrays, state):
    r = state.bodies[force.body].r
    return 0.25 * force.strength * (r[0] ** 4 + r[1] ** 4 + r[2] ** 4)


@dataclass(frozen=True, kw_only=True)
class Cubic(Force):
    record = np.dtype([("body", np.int64), ("signal", np.int64), ("strength", np.float64)])
    apply, potential = pull, pull_potential
    strength: float
    part: object = 1.0

    def fill(self, record, site):
        record["body"], record["strength"] = site.bodies[0], self.strength
        record["signal"] = site.signal(self.part, f"part of {site.name}")


@kernel
def gather(load, t, arrays, state):
    for k in range(3):
        mean = 0.0 * load.stiffness
        for i in range(3):
            mean = mean + state.bodies[load.node[i]].r[k] / 3.0
        for i in range(3):
            state.bodies[load.node[i]].F[k] -= load.stiffness * (state.bodies[load.node[i]].r[k] - mean)


@dataclass(frozen=True, kw_only=True)
class Gather(Load):
    record = np.dtype([("node", np.int64, (3,)), ("stiffness", np.float64)])
    apply = gather
    stiffness: float

    def fill(self, record, site):
        record["node"], record["stiffness"] = site.bodies, self.stiffness


@kernel
def rise(signal, t, arrays):
    x = np.exp(-t / signal.lag)
    return 1.0 - x, x / signal.lag, -x / signal.lag**2


@dataclass(frozen=True, kw_only=True)
class Lag(Signal):
    record = np.dtype([("lag", np.float64)])
    evaluate = rise
    lag: float

    def fill(self, record, site):
        record["lag"] = self.lag


@kernel
def squared(sensor, lam, arrays, state):
    r = state.bodies[sensor.index].r
    return r[0] ** 2 + r[1] ** 2 + r[2] ** 2


@dataclass(frozen=True, kw_only=True)
class Squared(Sensor):
    read = squared


def add(m, count, lag):
    bead = m.body("bead", m.ground, Parabola(bend=0.5, start=0.6, fixed=True), mass=1.0)
    last = bead
    for i in range(count):
        last = m.body(f"link{i}", last, Parabola(bend=0.1, start=0.01, at=(0.02, 0, 0)), mass=0.1)
    other = m.body("other", m.ground, Parabola(bend=0.5, start=-0.4, at=(0.0, 0.0, 0.5)), mass=2.0)
    m.cut("level", LevelCut(at_b=(0, 0.1, 0)), bead, other)
    lift = m.body("lift", m.ground, Translational(axis="y", at=(0.0, 0.0, 1.0)), mass=0.5)
    ties = m.couple("ties", Squares(bend=0.3), lift, other)
    m.force("cubic", Cubic(strength=3.0, part=Lag(lag=lag) if lag else 1.0), bead)
    m.load("gather", Gather(stiffness=5.0), bead, last, m.bodies[1])
    m.output("x", bead.coordinate(), "of the bead")
    m.output("other", other.coordinate(), "of the other bead")
    m.output("lift", lift.coordinate(), "of what rises with the other bead")
    m.output("pull", ties.effort(), "of the coupling on it")
    m.output("squared", Squared(unit="m2", item=bead), "distance of the bead squared")
    return m


@dataclass(frozen=True, kw_only=True)
class Beads(Model):
    links: int = parameter(0, min=0, doc="links of a chain", structural=True)
    lag: float = parameter(0.2, unit="s", min=0.0, doc="of the force; 0: it does not change", structural=True)

    def build(self):
        return add(Mechanism(gravity=(0, -9.81, 0)), self.links, self.lag)
"""


@pytest.fixture(scope="module")
def beads(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """The model of the file."""
    path = tmp_path_factory.mktemp("places") / "beads.py"
    path.write_text(FILE)
    return load(path)


def reference(stop: float) -> tuple[float, float]:
    """Positions of the two beads: masses 1 and 2 on y = x^2 / 2, the first 0.1 m higher, by Lagrange's equation; the
    second lifts 0.5 kg by 0.3 x^2.
    """

    def rates(t: float, y: Any) -> list[float]:
        x, v = y  # of the second; the first is at root(x^2 + 0.2)
        first = x * x + 0.2
        mass = 2.0 * (1.0 + x * x) + x * x + x * x / first + 0.5 * (0.6 * x) ** 2
        slope = 4.0 * x + 2.0 * x + 2.0 * x * 0.2 / first**2 + 0.36 * x
        pull = -3.0 * (1.0 - np.exp(-t / 0.2)) * (first + (0.5 * first) ** 3) * x
        return [v, (pull - 3.3 * 9.81 * x - 0.5 * slope * v * v) / mass]

    x = float(solve_ivp(rates, (0.0, stop), [-0.4, 0.0], rtol=1e-11, atol=1e-13).y[0, -1])
    return float(np.sqrt(x * x + 0.2)), x


@pytest.mark.parametrize("solver", ["adams", "hybrid", "ida"])
def test_runs_according_to_the_closed_equations(beads: Any, solver: str) -> None:
    result = simulate(beads(), 1.0, solver=solver, tolerance=1e-8)
    assert not result.failure
    assert [result["x"][-1], result["other"][-1]] == pytest.approx(reference(1.0), abs=2e-6)
    np.testing.assert_allclose(result["lift"], 0.3 * result["other"] ** 2, atol=1e-9)
    assert result["pull"].min() > 0.0
    np.testing.assert_allclose(result["squared"], result["x"] ** 2 + (0.5 * result["x"] ** 2) ** 2, atol=1e-9)


def test_a_large_tree_and_its_tangent(beads: Any) -> None:
    """110 links with complex steps of the joint, the cut joint, the force and the element in ida's tangent."""
    model = beads(links=110)
    assert model.compile().system.n > 100
    ends = [simulate(model, 0.05, solver=s, tolerance=1e-7)["x"][-1] for s in ("ida", "adams")]
    assert ends[0] == pytest.approx(ends[1], abs=1e-5)


def test_steady_state_and_state_matrices(beads: Any) -> None:
    state = equilibrium(beads(lag=0.0))
    assert state.positions()["other"] == pytest.approx(0.0, abs=1e-6)
    assert state.positions()["bead"] == pytest.approx(np.sqrt(0.2), abs=1e-6)
    A = linearize(beads(lag=0.0)).A
    np.testing.assert_allclose(np.abs(np.linalg.eigvals(A)), [np.sqrt((3.3 * 9.81 + 3.0 * 0.201) / 2.0)] * 2, rtol=1e-6)


def test_picture(beads: Any) -> None:
    assert len(draw(beads().build(), 1.0).middles) == 4


def test_fmu(beads: Any, tmp_path: Path) -> None:
    path = export(beads(), tmp_path / "beads.fmu", Settings(solver="adams", tolerance=1e-8), native=False)
    found = simulate_fmu(str(path), stop_time=0.5, output_interval=0.05, output=["x"])
    assert found["x"][-1] == pytest.approx(reference(0.5)[0], abs=2e-6)


def test_what_is_no_kind_is_refused() -> None:
    m = Mechanism()
    body = m.body("b", m.ground, Revolute(), **rod(mass=1, length=1))

    class Plain(Force):
        @staticmethod
        def apply(force: Any, t: float, arrays: Any, state: Any) -> None:
            """No kernel."""

    class Odd(Spring):
        record = np.dtype([("text", "U5")])

    class Clash(Spring):
        record = np.dtype([("mean", np.float64)])

    for kind, message in (
        (Odd(), "allowed: a NumPy dtype of named fields"),
        (Clash(), "field 'mean'"),
        (3, "allowed: a Force"),
    ):
        with pytest.raises(UserError, match=message):
            m.force("f", kind, body)
    if COMPILED:
        with pytest.raises(UserError, match="decorate it with"):
            m.force("f", Plain(), body)
