"""User-defined kinds whose declaration does not fit, and kernels that use an index outside an array."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from mbfmu import Mechanism, Revolute, UserError, rod, simulate
from mbfmu.mechanics import CompiledMechanism, Coupling, CutJoint, Force, Joint, Sensor, Signal, kernel

KEPT = np.dtype([("far", np.int64)], align=True)


@kernel
def place(joint: Any, qi: int, state: Any) -> None:
    """A hinge about z that writes its column at ``far``."""
    c, s, rel = np.cos(state.q[qi]), np.sin(state.q[qi]), state.rel[0]
    for i in range(6):
        rel.S[joint.far, i] = 1.0 if i == 5 else 0.0
    for i in range(3):
        for j in range(3):
            rel.R[i, j] = 0.0
        rel.p[i] = 0.0
    rel.R[0, 0], rel.R[0, 1], rel.R[1, 0], rel.R[1, 1], rel.R[2, 2] = c, -s, s, c, 1.0


@kernel
def evaluate_cut(cut: Any, A: Any, B: Any, row: int, arrays: Any, state: Any) -> None:
    """A row at ``far``."""
    state.rows[row + cut.far].Phi = 0.0


@kernel
def evaluate_coupling(coupling: Any, q: float, arrays: Any) -> tuple[float, float, float]:
    """The coordinate itself, and a body that may not be there."""
    return q + 0.0 * arrays.bodies[coupling.far].mass, 1.0 + 0.0 * q, 0.0 * q


@kernel
def evaluate_signal(signal: Any, t: float, arrays: Any) -> tuple[float, float, float]:
    """Nothing, and a body that may not be there."""
    none = 0.0 * arrays.world[0].gravity[0] + 0.0 * arrays.bodies[signal.far].s[0]
    return none, none, none


@kernel
def apply(load: Any, t: float, arrays: Any, state: Any) -> None:
    """Push a coordinate that may not be there."""
    state.Q[load.far] += 1e-3


@kernel
def apply_to_body(load: Any, t: float, arrays: Any, state: Any) -> None:
    """Push a component of a wrench that may not be there."""
    state.bodies[1].F[load.far] += 1e-3


@kernel
def read(sensor: Any, lam: Any, arrays: Any, state: Any) -> float:
    """A coordinate that may not be there."""
    return state.q[sensor.far]


@dataclass(frozen=True, kw_only=True)
class Far:
    """Has a record of one index."""

    record = KEPT
    far: int = 0

    def fill(self, record: Any, site: Any) -> None:
        """Write it."""
        record["far"] = self.far


def own(role: type, **said: Any) -> Any:
    """Return a kind of this role with an index."""
    return dataclass(frozen=True, kw_only=True)(type("Own", (Far, role), said))


OwnJoint = own(Joint, place=place, nq=1, nv=1, coordinates=("",), units=("rad",))
OwnCut = own(CutJoint, evaluate=evaluate_cut, rows=("x",), units=("N",))
OwnCoupling = own(Coupling, evaluate=evaluate_coupling)
OwnSignal = own(Signal, evaluate=evaluate_signal)
OwnForce, OwnBodyForce, OwnSensor = own(Force, apply=apply), own(Force, apply=apply_to_body), own(Sensor, read=read)


def built(role: str, far: int) -> Mechanism:
    """Two arms with one thing that has the index ``far``."""
    m = Mechanism(gravity=(0, -9.81, 0))
    first = m.body("first", m.ground, OwnJoint(far=far) if role == "joint" else Revolute(), **rod(mass=1, length=1))
    drive = OwnSignal(far=far) if role == "signal" else None
    second = m.body("second", m.ground, Revolute(drive=drive), **rod(mass=1, length=1))
    if role == "cut":
        m.cut("loop", OwnCut(far=far), first, second)
    if role == "coupling":
        m.couple("pair", OwnCoupling(far=far), first, second)
    if role in ("force", "wrench"):
        m.force("push", (OwnForce if role == "force" else OwnBodyForce)(far=far), first)
    m.output("angle", OwnSensor(far=far, item=first, unit="rad") if role == "sensor" else first.angle())
    return m


FIRST_OUTSIDE = {"joint": 9, "cut": 1, "coupling": 3, "signal": 3, "force": 2, "wrench": 6, "sensor": 2}
NAMED = {
    "joint": "joint of body 'first'", "cut": "cut 'loop'", "coupling": "coupling 'pair'", "signal": "a signal",
    "force": "force 'push'", "wrench": "force 'push'", "sensor": "output 'angle'",
}  # fmt: skip


@pytest.mark.parametrize("role", FIRST_OUTSIDE)
@pytest.mark.parametrize("off", [0, 1000])
def test_an_index_outside_an_array_is_refused_before_the_first_compiled_call(role: str, off: int) -> None:
    with pytest.raises(UserError, match=f"{NAMED[role]}: kernel '.*' .* uses an index outside an array"):
        CompiledMechanism(built(role, FIRST_OUTSIDE[role] + off))


@pytest.mark.parametrize("role", ["joint", "signal", "force", "wrench", "sensor"])
def test_an_index_inside_is_not(role: str) -> None:
    inside = {"joint": 0}.get(role, FIRST_OUTSIDE[role] - 1)
    assert np.isfinite(simulate(built(role, inside), 0.01, solver="adams")["angle"]).all()


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ({"nq": 3, "nv": 2}, r"nq = 3 and nv = 2; allowed: as many positions as velocities .*rolling wheel"),
        ({"nq": 4, "nv": 4, "quaternion": True}, r"nq = 4 and nv = 4; allowed: one position more"),
        ({"nq": 3, "nv": 2, "quaternion": True}, r"nv is 2; allowed: 3 to 6"),
        ({"nq": 7, "nv": 7}, r"nv is 7; allowed: 0 to 6"),
        ({"nq": -1, "nv": -1}, r"nq is -1; allowed: a whole number"),
        ({"nq": 1.0, "nv": 1}, r"nq is 1\.0; allowed: a whole number"),
        ({"nq": 1, "nv": True}, r"nv is True; allowed: a whole number"),
        ({"nq": 1, "nv": 1, "units": ("deg",)}, r"units are \('deg',\); allowed: 'm' or 'rad'"),
        ({"nq": 2, "nv": 2, "units": ("m",)}, r"units are \('m',\); allowed: 'm' or 'rad' for each of 2"),
        ({"nq": 1, "nv": 1, "units": "m"}, r"units are 'm'; allowed: a tuple of 1 texts"),
        (
            {"nq": 2, "nv": 2, "units": ("m", "m"), "coordinates": ("x",)},
            r"coordinates are \('x',\); allowed: one suffix",
        ),
        ({"nq": 1, "nv": 1, "quaternion": 1}, r"quaternion is 1; allowed: True or False"),
    ],
)
def test_declarations_that_do_not_fit_are_refused(said: dict[str, Any], message: str) -> None:
    told = {"units": ("rad",) * abs(int(said["nv"])), "coordinates": tuple("abcdefg"[: abs(int(said["nv"]))])} | said
    kind = own(Joint, place=place, **told)
    m = Mechanism()
    with pytest.raises(UserError, match=message):
        m.body("sled", m.ground, kind(), mass=1.0)


@kernel
def along_a_curve(joint: Any, qi: int, state: Any) -> None:
    """A bead on y = k x^2 that does not turn."""
    x, rel = state.q[qi], state.rel[0]
    for i in range(3):
        rel.S[0, i], rel.S[0, 3 + i] = 0.0, 0.0
        for j in range(3):
            rel.R[i, j] = 1.0 if i == j else 0.0
        rel.p[i] = 0.0
    rel.S[0, 0], rel.S[0, 1] = 1.0, joint.slope * joint.k * x
    rel.S[0, 5] = joint.turn
    rel.p[0], rel.p[1] = x, joint.k * x * x


@kernel
def centripetal(joint: Any, qi: int, vi: int, state: Any) -> None:
    """See ``along_a_curve``."""
    for i in range(6):
        state.rel[0].bias[i] = 0.0
    state.rel[0].bias[1] = joint.bias * joint.k * state.v[vi] ** 2


@dataclass(frozen=True, kw_only=True)
class Bead(Joint):
    """A bead on y = k x^2; right with 2, 0 and 2."""

    record = np.dtype([(name, np.float64) for name in ("k", "slope", "turn", "bias")])
    place, bias = along_a_curve, centripetal
    nq = nv = 1
    coordinates, units = ("",), ("m",)
    k: float
    given: dict[str, float]

    def fill(self, record: Any, site: Any) -> None:
        """Write the numbers."""
        record["k"] = self.k
        for name, value in ({"slope": 2.0, "turn": 0.0, "bias": 2.0} | self.given).items():
            record[name] = value


@pytest.mark.parametrize("k", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("wrong", [{"slope": 1.0}, {"turn": 1.0}, {"bias": 0.0}, {"bias": -2.0}])
def test_velocities_that_are_not_those_of_the_pose_are_refused(wrong: dict[str, float], k: float) -> None:
    m = Mechanism(gravity=(0, -9.81, 0))
    m.body("bead", m.ground, Bead(k=k, given=wrong), mass=1.0)
    name = "bias" if "bias" in wrong else "place"
    with pytest.raises(UserError, match=f"joint of body 'bead': kernel '{name}' of Bead contradicts the pose"):
        CompiledMechanism(m)


@pytest.mark.parametrize("k", [1e-3, 1.0, 1e3])
def test_a_bead_on_a_curve_keeps_its_energy(k: float) -> None:
    m = Mechanism(gravity=(0, -9.81, 0))
    m.body("bead", m.ground, Bead(k=k, given={}, start=0.3 / k), mass=1.0)
    m.output("energy", m.energy, "")
    energy = simulate(m, 1.0 / k**0.5, solver="adams", tolerance=1e-9)["energy"]
    assert np.ptp(energy) < 1e-6 * abs(energy[0])
