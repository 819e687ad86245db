"""Laws of springs and dampers with other quantities, against the same forces as a LineForce or a JointForce."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import mbfmu as mb
from mbfmu.util.errors import UserError

USES = {"p": 3.0, "w": mb.Function("1 + 0.5 * sin(4 * t)")}


def run(kind: str, *, given: bool) -> Any:
    """Return the motion of two masses with a law of the stretch x, its rate v, the other mass y and a signal w."""
    m = mb.Mechanism()
    a = m.body("a", m.ground, mb.Translational(axis="x", start=0.7, rate=0.4, nominal=1.0), mass=1.0)
    b = m.body("b", m.ground, mb.Translational(axis="x", start=-0.5, nominal=1.0), mass=2.0)
    m.force("hold", mb.JointSpring(stiffness=5.0), b)
    uses = USES | {"y": b.coordinate()}
    law = {
        "Spring": "p * x**3 * w + y + 0.1 * v", "JointSpring": "p * x**3 * w + y + 0.1 * v",
        "Damper": "p * v * w + x * y", "JointDamper": "p * v * w + x * y",
    }[kind]  # fmt: skip
    if not given:
        force: Any = {
            "Spring": lambda: mb.Spring(stiffness=law, uses=uses, free=0.2, damping=0.3, at_b=(0, 1, 0)),
            "Damper": lambda: mb.Damper(damping=law, uses=uses, at_b=(0, 1, 0)),
            "JointSpring": lambda: mb.JointSpring(stiffness=law, uses=uses, free=0.2, damping=0.3),
            "JointDamper": lambda: mb.JointDamper(damping=law, uses=uses),
        }[kind]()
    else:
        if kind.endswith("Spring"):
            law = law.replace("x", "(x - 0.2)") + " + 0.3 * v"
        if kind.startswith("Joint"):
            force = mb.JointForce(f"-({law})".replace("x", "q"), uses=uses)
        else:
            force = mb.LineForce(magnitude=f"-({law})", uses=uses, at_b=(0, 1, 0))
    bodies = (a,) if kind.startswith("Joint") else (m.ground, a)
    m.force("law", force, *bodies)
    m.output("a", a.coordinate())
    m.output("b", b.coordinate())
    result = mb.simulate(m, 2.0, interval=0.1, solver="adams", tolerance=1e-9)
    assert not result.warning  # the energy balance contains the work
    return np.array([result["a"], result["b"]])


@pytest.mark.parametrize("kind", ["Spring", "JointSpring", "Damper", "JointDamper"])
def test_laws_with_other_quantities_are_those_of_given_forces(kind: str) -> None:
    found = run(kind, given=False)
    np.testing.assert_allclose(found, run(kind, given=True), rtol=0.0, atol=1e-8)
    assert np.ptp(found[0]) > 0.1


def test_a_torsion_spring_about_a_hinge_is_a_torque_on_its_coordinate() -> None:
    motions = []
    for spring in (True, False):
        m = mb.Mechanism()
        arm = m.body("arm", m.ground, mb.Revolute(start=0.7, rate=0.4), **mb.rod(mass=1.0, length=1.0))
        uses = USES | {"y": arm.position("y", point=(1, 0, 0))}
        if spring:
            law = mb.TorsionSpring(stiffness="p * x**3 * w + y + 0.1 * v", uses=uses, free=0.2, damping=0.3)
            m.force("law", law, m.ground, arm)
        else:
            text = "-(p * (q - 0.2)**3 * w + y + 0.4 * v)"
            m.force("law", mb.JointForce(text, uses=uses), arm)
        m.output("q", arm.coordinate())
        motions.append(mb.simulate(m, 2.0, interval=0.1, solver="adams", tolerance=1e-9)["q"])
    np.testing.assert_allclose(*motions, rtol=0.0, atol=1e-8)


def test_laws_need_functions() -> None:
    with pytest.raises(UserError, match="stiffness of a JointSpring is no function or expression, and uses is given"):
        mb.JointSpring(stiffness=3.0, uses={"p": 1.0})
    with pytest.raises(UserError, match="damping of a Damper is no function or expression"):
        mb.Damper(damping=3.0, uses={"p": 1.0})
    with pytest.raises(UserError, match="uses of damping of a Damper has 'q', which the law does not contain"):
        mb.Damper(damping="3 * v", uses={"q": 1.0})
