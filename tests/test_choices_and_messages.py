"""A choice of the user is used or refused, and a message names only what the model has."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import read_model_description
from scipy.spatial.transform import Rotation

import mbfmu as mb
from fmus.feeder import Feeder
from fmus.fourbar import FourBar
from fmus.governor import Governor
from fmus.pendulum import SwingPendulum
from fmus.sheet import Sheet
from mbfmu.cli import main
from mbfmu.ensemble.study_target import make_target
from mbfmu.fmi import export
from mbfmu.fmi.native_fmu import NATIVE_SOLVERS, _with_solver, describe_constants
from mbfmu.modeling.model import as_model
from mbfmu.native.data import native_model
from mbfmu.plotting.steady_states import STABILITY_STYLES
from mbfmu.session.failure_diagnosis import advise
from solvers import OneStepSolver
from solvers.outcome import Code, Status
from solvers.statics.spectrum import Stability
from solvers.steppers import SOLVER_NAMES, UNLISTED_SOLVERS, drop_unlisted

# exit code of check


def test_a_check_ends_with_the_exit_code_of_a_run(
    command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    short = ("pendulum", "--stop-time", "0.1")
    assert command("check", *short)[0] == 0
    assert command("check", *short, "--max-steps", "1")[0] == 1
    assert command("run", *short, "--max-steps", "1", "--direct", "-o", str(tmp_path / "out"))[0] == 1
    model = tmp_path / "open.py"
    model.write_text(
        "import mbfmu as mb\n\nclass Open(mb.Model):\n    def build(self):\n        m = mb.Mechanism()\n"
        "        arm = m.body('arm', m.ground, mb.Revolute(), **mb.rod(mass=1.0, length=1.0))\n"
        "        m.cut('far', mb.SphericalCutJoint(at_a=(3.0, 0.0, 0.0)), m.ground, arm)\n        return m\n"
    )
    code, out, _ = command("check", f"{model}:Open")
    assert (code, "does not start" in out) == (1, True)
    lost = mb.Diagnostic.warning("energy-balance", "the energy error is too large")
    monkeypatch.setattr(mb.Simulation, "diagnostics", property(lambda _: (lost,)))
    assert command("check", *short)[0] == 1


# an interval that is longer than the run


def by_simulate(_: Callable[..., Any], folder: Path) -> None:
    mb.simulate(SwingPendulum(), 0.1, interval=1.0)


def by_study(_: Callable[..., Any], folder: Path) -> None:
    make_target("pendulum", "simulation", 0.1, 1.0)


def by_study_of_an_fmu(_: Callable[..., Any], folder: Path) -> None:
    path = export(SwingPendulum(), folder / "pendulum.fmu", native=False)
    try:
        make_target(path, "simulation", 0.1, 1.0)
    finally:
        path.unlink()


def by_command(name: str) -> Callable[..., None]:
    def call(command: Callable[..., Any], folder: Path) -> None:
        out = folder / {"run": "out", "export": "out.fmu", "view": "out.html"}[name]
        code, _, err = command(name, "pendulum", "--stop-time", "0.1", "--interval", "1", "-o", str(out))
        assert code == 2
        raise mb.UserError(err)

    return call


@pytest.mark.parametrize(
    "way", [by_simulate, by_study, by_study_of_an_fmu, by_command("run"), by_command("export"), by_command("view")]
)
def test_an_interval_that_was_given_and_is_longer_than_the_run_is_refused(
    way: Callable[..., None], command: Callable[..., Any], tmp_path: Path
) -> None:
    with pytest.raises(mb.UserError, match=r"interval is 1.0 s, longer than the run of 0.1 s"):
        way(command, tmp_path)
    assert not list(tmp_path.iterdir())


def test_an_interval_of_the_model_may_be_longer_than_the_run() -> None:
    assert SwingPendulum.output_interval > 1e-3
    assert list(mb.simulate(SwingPendulum(), 1e-3).t) == [0.0, 1e-3]
    assert list(mb.simulate(SwingPendulum(), 0.1, interval=0.1).t) == [0.0, 0.1]


# a solver that native FMUs do not have


@dataclass(frozen=True, kw_only=True)
class Preferred(FourBar):
    """A four-bar whose author prefers a solver of native FMUs."""

    default_solver = "adams"


class Mine(OneStepSolver):
    """A user-defined solver."""

    order = 1

    def step(self, f: Any, t: float, y: Any, h: float) -> Any:
        """Euler's method."""
        return y + h * f(t, y)


def test_native_fmus_support_all_solvers_of_mbfmu_and_refuse_those_of_users() -> None:
    assert set(NATIVE_SOLVERS) == set(SOLVER_NAMES)
    message = f"solver is 'mine'; allowed in a native FMU: {', '.join(drop_unlisted(NATIVE_SOLVERS))}"
    with pytest.raises(mb.UserError, match=message) as refused:
        _with_solver(Preferred(), mb.Settings(solver=Mine), lambda _: None)
    assert refused.value.diagnostic.code == "not-native"


def test_ida_that_was_requested_for_a_large_model_with_contact_is_refused(
    command: Callable[..., Any], tmp_path: Path
) -> None:
    path, small = tmp_path / "out.fmu", ("--set=path=straight", "--set=nips=1", "--set=nx=5", "--set=nz=4")
    code, _, err = command("export", "feeder", "--native", "--solver=ida", *small, "-o", str(path))
    assert (code, path.exists()) == (2, False)
    assert "solver is 'ida'; allowed in a native FMU: adams, hybrid, esdirk, or auto" in err


def test_the_default_of_a_model_is_kept_or_refused() -> None:
    told: list[mb.Diagnostic] = []
    assert _with_solver(FourBar(), mb.Settings(), told.append).solver == "ida"
    assert told == []
    assert _with_solver(Sheet(nx=9, nz=7), mb.Settings(solver=Sheet.default_solver), told.append).solver == "ida"
    assert told == []
    with pytest.raises(mb.UserError, match="solver is 'ida'; allowed in a native FMU: adams, hybrid, esdirk, or auto"):
        _with_solver(Feeder(path="straight", nips=1, nx=5, nz=4), mb.Settings(solver="ida"), told.append)


# causes of a step that collapses, and of near branches


def chain(*masses: float, load: bool = False, drive: bool = False, loop: bool = False) -> mb.Mechanism:
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    body = m.ground
    for k, mass in enumerate(masses):
        at, signal = (1.0 if k else 0.0, 0.0, 0.0), mb.Polynomial((0.0, 1.0)) if drive and not k else None
        body = m.body(f"link{k}", body, mb.Revolute(at=at, drive=signal), **mb.rod(mass=mass, length=1.0))
    if load:
        m.force("damper", mb.JointSpring(damping=1.0), body)
    if loop:
        m.cut(
            "pin", mb.DistanceCutJoint(length=1.0, at_a=(len(masses), 1.0, 0.0), at_b=(1.0, 0.0, 0.0)), m.ground, body
        )
    return m


WORDS = {"load": "force", "drive": "drive", "loop": "singular", "light": "kg"}


@pytest.mark.parametrize("load", [False, True])
@pytest.mark.parametrize("drive", [False, True])
@pytest.mark.parametrize("loop", [False, True])
@pytest.mark.parametrize("light", [False, True])
def test_causes_are_those_that_a_model_can_have(load: bool, drive: bool, loop: bool, light: bool) -> None:
    masses = (1e-6 if light else 1.0, 1.0, 1.0)
    m = chain(*masses, load=load, drive=drive, loop=loop)
    text = advise(as_model(m).compile(), Status(Code.COLLAPSED, 0.0, ("ida",)))
    expected = {"load": load, "drive": drive and loop, "loop": loop, "light": light}
    assert {key: word in text for key, word in WORDS.items()} == expected, text
    assert ("'link0' of 1e-06 kg, which carries one of 1 kg" in text) == light
    assert text.endswith("or try 'ida'.")


@pytest.mark.parametrize("drive", [False, True])
def test_near_branches_name_drives_and_several_loops_if_there_are_any(drive: bool) -> None:
    for loops in (1, 2):
        m = chain(1.0, 1.0, 1.0, 1.0, drive=drive, loop=True)
        if loops == 2:
            m.cut("other", mb.DistanceCutJoint(length=2.0**0.5, at_a=(3.0, 1.0, 0.0)), m.ground, m.bodies[3])
        text = advise(as_model(m).compile(), Status(Code.BRANCHES, 0.0))
        assert ("drive" in text, "several" in text) == (drive, loops == 2)


# words of stability, tables


def test_every_verdict_of_stability_has_a_description_and_a_style(tmp_path: Path) -> None:
    assert list(STABILITY_STYLES) == list(Stability)
    assert all(word.text for word in Stability)
    table = Path("docs/equilibrium.md").read_text(encoding="utf-8")
    assert all(f"\n| {word} |" in table for word in Stability)


def test_states_and_modes_are_printed_as_the_command_prints_them(command: Callable[..., Any]) -> None:
    state, modes = mb.equilibrium(Governor()), mb.modes(Governor())
    for text in (str(state), command("equilibrium", "governor", "--others", "0")[1]):
        assert "collar.distance" in text
        assert "marginally stable: undamped oscillation" in text
        assert "| m " in text or " m\n" in text
        assert "array(" not in text
    rows = str(modes).splitlines()
    assert "natural frequency |s| [rad/s]" in rows[0]
    assert f"{modes[0].mode.frequency:.6g}" in str(modes)
    assert isinstance(modes, list)


# parameters that are constant


def test_a_reason_is_given_once_for_all_parameters() -> None:
    frozen = native_model(Governor(), mb.Settings(solver="adams"), for_one_run=True).fixed
    assert len(frozen) > 3
    (found,) = describe_constants(frozen)
    assert found.text.startswith(f"parameters {', '.join(map(repr, frozen))} are constants in this FMU: ")
    assert [d.text for d in describe_constants({"a": "x", "b": "y", "c": "x"})] == [
        "parameters 'a', 'c' are constants in this FMU: x",
        "parameter 'b' is a constant in this FMU: y",
    ]


# models without @dataclass


class Bare(mb.Model):
    """A model whose author forgot the decorator."""

    length: float = mb.parameter(1.0, unit="m", doc="Length")

    def build(self) -> mb.Mechanism:
        m = mb.Mechanism()
        m.body("arm", m.ground, mb.Revolute(), **mb.rod(mass=1.0, length=self.length))
        return m


def test_the_error_of_a_model_that_is_no_dataclass_has_a_remedy() -> None:
    for call in (Bare, lambda: Bare(length=2.0), Bare.parameters):  # type: ignore[call-arg]
        with pytest.raises(mb.UserError, match=r"model Bare declares .* @dataclass\(frozen=True, kw_only=True\) above"):
            call()


def test_a_model_refuses_a_parameter_that_it_does_not_have() -> None:
    with pytest.raises(mb.UserError, match="FourBar has no argument 'crank_lenght'; did you mean 'crank_length'"):
        FourBar(crank_lenght=1.0)  # type: ignore[call-arg]


# rotations

TURN = Rotation.from_euler("zyx", [0.3, -0.5, 0.2])


def tilted(rotation: Any) -> mb.Mechanism:
    m = mb.Mechanism(gravity=(0.0, -9.81, 0.0))
    arm = m.body("arm", m.ground, mb.Revolute(rotation=rotation, start=0.4), **mb.rod(mass=1.0, length=1.0))
    slide = mb.Translational(axis="x", rotation=rotation)
    last = m.body("last", arm, slide, **mb.box(mass=1.0, size=(0.1, 0.2, 0.3), rotation=rotation))
    bushing = mb.Bushing(stiffness=(1.0, 2.0, 3.0), rotation_a=rotation, rotation_b=rotation)
    m.force("bushing", bushing, m.ground, last)
    m.cut("plane", mb.PlaneCutJoint(rotation_a=rotation), m.ground, last)
    m.output("angle", arm.angle())
    return m


def test_a_rotation_of_scipy_is_its_matrix() -> None:
    ends = [mb.simulate(tilted(given), 0.2, solver="adams").values for given in (TURN, TURN.as_matrix())]
    assert np.array_equal(*ends)
    assert np.ptp(ends[0][:, 0]) > 0.0


@pytest.mark.parametrize("wrong", [Rotation.random(2, random_state=0), "z", np.eye(4), 2.0 * np.eye(3)])
def test_what_is_no_rotation_is_refused_with_what_is_allowed(wrong: Any) -> None:
    with pytest.raises(mb.UserError, match=r"(?s)rotation.* is .*(or one scipy.spatial|needs numbers)"):
        mb.simulate(tilted(wrong), 0.2)


# solvers that are accepted and not listed


def test_an_unlisted_solver_is_in_no_list_and_is_accepted(capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    """Numbers of the other solvers are those of earlier versions: an importing tool may set them."""
    with pytest.raises(mb.UserError) as refused:
        mb.Settings(solver="euler")
    assert not any(solver in str(refused.value) for solver in UNLISTED_SOLVERS)
    for words in (("run", "--help"), ("compare", "--help"), ("models", "fourbar")):
        with suppress(SystemExit):
            main(words)
        out = capfd.readouterr().out
        assert "esdirk" in out
        assert not any(solver in out for solver in UNLISTED_SOLVERS), words
    assert mb.Settings(solver="adams-lu").solver == "adams-lu"
    for solver, numbers in (("ida", [1, 2, 3, 5, 6, 7]), ("adams-lu", [1, 2, 3, 4, 5, 6, 7])):
        path = mb.export(FourBar(), tmp_path / f"{solver}.fmu", mb.Settings(solver=solver), native=False)
        described = read_model_description(str(path))
        (kind,) = (own for own in described.typeDefinitions if own.name == "choice of solver")
        assert [int(item.value) for item in kind.items] == numbers
