"""What cannot start is not exported: the same error as a simulation gives."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from fmus.pendulum import SwingPendulum
from mbfmu.fmi import export
from mbfmu.fmi.description import Experiment
from mbfmu.fmi.identity import identify
from mbfmu.mechanics import JointSpring, Mechanism, Revolute, SphericalCutJoint, Translational, rod
from mbfmu.modeling import Model, models
from mbfmu.modeling.settings import Settings
from mbfmu.session.simulation import Simulation
from mbfmu.util.errors import EquilibriumError, UserError
from solvers.steppers import SOLVER_NAMES, describe_refusal, stepper

SMALL: dict[str, dict[str, Any]] = {
    "sheet": {"nx": 9, "nz": 7},
    "feeder": {"nx": 9, "nz": 5, "path": "straight", "nips": 1},
}
REFUSED = {  # explicit solvers by the stiff nips, esdirk by matrices
    *(("feeder", name) for name in ("adams", "hybrid", "adams-lu")),
    *((name, "esdirk") for name in ("fourbar", "governor", "pendulum")),
}


@pytest.mark.parametrize("name", sorted(models()))
def test_a_solver_that_does_not_suit_a_model_is_refused_as_a_run_refuses_it(name: str, tmp_path: Path) -> None:
    model = models()[name](**SMALL.get(name, {}))
    system = model.compile().system
    start = (0.0, *model.compile().assemble())
    for solver in SOLVER_NAMES:
        why, path = describe_refusal(solver, system), tmp_path / f"{solver}.fmu"
        assert bool(why) == ((name, solver) in REFUSED), (solver, why)
        if why:
            with pytest.raises(ValueError) as said:  # noqa: PT011  # the message is compared
                stepper(solver, system, *start)
            with pytest.raises(UserError) as error:
                export(model, path, Settings(solver=solver), native=False)
            assert str(error.value) == f"model {name!r}: {said.value}"
            assert not path.exists()


def test_one_that_does_is_exported(tmp_path: Path) -> None:
    for name, solver in (("fourbar", "adams"), ("fourbar", "auto"), ("sheet", "esdirk")):
        model = models()[name](**SMALL.get(name, {}))
        assert export(model, tmp_path / f"{name}-{solver}.fmu", Settings(solver=solver), native=False).is_file()


@pytest.mark.parametrize(("name", "solver"), [("feeder", "adams"), ("fourbar", "esdirk")])
def test_the_command_reports_it(command: Any, name: str, solver: str, tmp_path: Path) -> None:
    values = [f"--set={parameter}={value}" for parameter, value in SMALL.get(name, {}).items()]
    code, _, err = command("export", name, *values, "--solver", solver, "-o", str(tmp_path / "model.fmu"))
    assert code != 0
    assert "solver" in err
    assert not list(tmp_path.iterdir())


@dataclass(frozen=True, kw_only=True)
class Festoon(Model):
    """A chain between two hooks, which is a large tree with constraints."""

    def build(self) -> Mechanism:
        m = Mechanism(gravity=(0.0, -9.81, 0.0))
        link = m.ground
        for k in range(110):
            joint = Revolute(at=(0.1 if k else 0.0, 0.0, 0.0), start=0.01 if k else -0.55)
            link = m.body(f"link{k}", link, joint, **rod(mass=0.1, length=0.1))
        m.cut("hook", SphericalCutJoint(at_a=(10.5, 0.0, 0.0), at_b=(0.1, 0.0, 0.0)), m.ground, link)
        m.output("angle", link.angle())
        return m


@pytest.mark.parametrize("native", [False, True])
def test_a_large_tree_that_a_solver_has_too_large_matrices_for_is_refused(
    native: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("solvers.steppers.MAX_RADAU_COORDINATES", 100)
    expected = r"is given 110 joint coordinates and 2 constraints; allowed: at most 100 "
    with pytest.raises(UserError, match=expected):
        export(Festoon(), tmp_path / "model.fmu", Settings(solver="radau"), native=native)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("native", [False, True])
def test_a_steady_state_that_is_not_there_is_refused(native: bool, tmp_path: Path) -> None:
    """A pendulum under gravity on a crank that turns never rests."""
    with pytest.raises(EquilibriumError, match="no steady state"):
        export(
            SwingPendulum(gravity=9.81),
            tmp_path / "model.fmu",
            Settings(solver="adams", start_at_equilibrium=True),
            native=native,
        )
    assert not list(tmp_path.iterdir())


@dataclass(frozen=True, kw_only=True)
class Shelf(Model):
    """A body on a spring, with fields that are no parameters."""

    stiffness: float = 10.0
    places: list[float] = field(default_factory=lambda: [0.5])

    def build(self) -> Mechanism:
        m = Mechanism()
        body = m.body("body", m.ground, Translational(axis="x", start=self.places[0], nominal=1.0), mass=1.0)
        m.force("spring", JointSpring(stiffness=self.stiffness), body)
        m.output("x", body.coordinate())
        return m


@pytest.mark.parametrize(("given", "name"), [({"stiffness": 11.0}, "stiffness"), ({"places": [0.4]}, "places")])
def test_values_that_an_fmu_would_not_contain_are_refused(given: dict[str, Any], name: str, tmp_path: Path) -> None:
    path = tmp_path / "shelf.fmu"
    with pytest.raises(UserError, match=f"field {name!r} of model 'shelf' is .*, and no parameter: the FMU would"):
        export(Shelf(**given), path, Settings(solver="adams"), native=False)
    assert not path.exists()


def test_native_fmus_of_other_values_have_other_identities() -> None:
    about = Settings(solver="adams"), Experiment(stop_time=1.0, step_size=0.1, tolerance=1e-6)
    assert identify(Shelf(), *about) != identify(Shelf(stiffness=11.0), *about)
    assert identify(Shelf(), *about) == identify(Shelf(stiffness=10.0), *about)


def test_fields_with_their_defaults_are_exported(tmp_path: Path) -> None:
    assert export(Shelf(), tmp_path / "shelf.fmu", Settings(solver="adams"), native=False).is_file()


def test_states_of_models_with_other_fields_are_refused() -> None:
    state = Simulation(Shelf(), Settings(solver="adams")).save()
    with pytest.raises(UserError, match="state"):
        Simulation(Shelf(stiffness=11.0), Settings(solver="adams")).restore(state)
