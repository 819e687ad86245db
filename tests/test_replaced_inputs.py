"""Inputs that signals replace: by ``Model.with_inputs`` and by ``--input`` of the commands."""

import pickle
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import PPoly

import mbfmu as mb
from mbfmu.cli import main
from mbfmu.ensemble.definition import define, read_study
from mbfmu.ensemble.worker import Outcome, forget_job, run_batch
from mbfmu.fmi.harness import Fmu
from mbfmu.modeling.replaced_inputs import read_value
from mbfmu.modeling.scene import read_scene


@dataclass(frozen=True, kw_only=True)
class Cart(mb.Model):
    """A mass on a rail, which a force moves."""

    stop_time = 1.0
    mass: float = mb.parameter(2.0, unit="kg", min=0.1, doc="mass")

    def build(self) -> mb.Mechanism:
        """Return the mechanism."""
        m = mb.Mechanism()
        cart = m.body("cart", m.ground, mb.Translational(axis="x"), mass=self.mass)
        m.force("push", mb.JointForce(mb.Input(name="force", unit="N")), cart)
        m.output("x", cart.coordinate())
        return m


@dataclass(frozen=True, kw_only=True)
class HeldCart(Cart):
    """A mass on a rail, which a force moves against a spring."""

    def build(self) -> mb.Mechanism:
        """Return the mechanism."""
        m = super().build()
        m.force("spring", mb.JointSpring(stiffness=100.0), m.bodies[1])
        return m

    def exact_equilibrium(self) -> dict[str, float]:
        """Return the position without a force."""
        return {"x": 0.0}


def test_expressions_and_tables_replace_an_input_and_stay_if_parameters_change(tmp_path: Path) -> None:
    """Closed form: m x'' = F with F = 6 t gives x = t^3 / m; a table in kN over minutes gives the same."""
    path = tmp_path / "push.csv"
    path.write_text("time [min],force [kN]\n0,0\n1,0.36\n")
    for value in ("6*t", mb.read_table(path), ([0.0, 10.0], [0.0, 60.0])):
        model = Cart().with_inputs({"force": value})
        assert not model.compile().inputs.variables
        for mass in (2.0, 3.0):
            found = mb.simulate(model.with_values({"mass": mass}), solver="adams", tolerance=1e-9)
            np.testing.assert_allclose(found["x"], found.t**3 / mass, atol=1e-8)
    assert Cart().compile().inputs.variables  # the model itself did not change


def test_what_cannot_replace_an_input_is_refused(tmp_path: Path) -> None:
    """The messages name the input, the value and what is allowed."""
    with pytest.raises(mb.UserError, match="no input 'fore'; allowed: force"):
        Cart().with_inputs({"fore": 1.0})
    with pytest.raises(mb.UserError, match="input 'force' is nan; allowed: a finite number, an expression"):
        Cart().with_inputs({"force": float("nan")})
    with pytest.raises(mb.UserError, match=r"allowed: .*a pair \(times, values\) of two sequences, a Table"):
        Cart().with_inputs({"force": [(0.0, 0.0), (1.0, 6.0), (2.0, 12.0)]})
    with pytest.raises(mb.UserError, match="'force'"):
        Cart().with_inputs({"force": ([0.0, 1.0], [0.0, 6.0, 12.0])})
    scene = tmp_path / "scene.toml"
    for line, problem in (("force = {times=[0, 1], values=[0, 1], knd='linear'}", "'knd'"), ("a.b = 1", "in quotes")):
        scene.write_text(f"model = '{__file__}:Cart'\n[inputs]\n{line}\n")
        with pytest.raises(mb.UserError, match=problem):
            read_scene(scene)


def test_a_column_of_another_quantity_is_refused_and_one_of_several_is_chosen(tmp_path: Path) -> None:
    """The messages name file, column and both units, and list the columns."""
    path = tmp_path / "push.csv"
    path.write_text("time [s],left [kN],right [mm]\n0,0,0\n1,0.006,1\n")
    found = Cart().with_inputs({"force": read_value("force", f"{path}:left")})
    assert mb.simulate(found, solver="adams")["x"][-1] == pytest.approx(0.5, rel=1e-5)
    refused = (
        r"input 'force' has the unit N, but column 'right' of file .*push.csv' has the unit mm; allowed: a unit of"
    )
    for right in (read_value("force", f"{path}:right"), mb.read_table(path, "right")):
        with pytest.raises(mb.UserError, match=refused):
            Cart().with_inputs({"force": right})
    with pytest.raises(mb.UserError, match=refused):
        mb.simulate(Cart(), inputs={"force": mb.read_table(path, "right")})
    listed = (
        r"push.csv' has no column 'force', but the columns 'left', 'right'; give the name of one .* as in push.csv:left"
    )
    with pytest.raises(mb.UserError, match=listed):
        read_value("force", str(path))
    with pytest.raises(mb.UserError, match="has no column 'lft'; did you mean 'left'"):
        read_value("force", "push.csv:lft", tmp_path)
    path.write_text("time [s],left [kN]\n0,0\n1,1\n")
    assert read_value("force", str(path)).source == f"column 'left' of file {str(path)!r}"
    m = mb.Mechanism(gravity=(0.0, 0.0, mb.Input(name="gravity", unit="m/s2", start=-9.81)))
    m.output("x", m.body("cart", m.ground, mb.Translational(axis="x"), mass=1.0).coordinate())
    with pytest.raises(mb.UserError, match="input 'gravity' has the unit m/s2, but column 'left'"):
        mb.simulate(m, 1.0, inputs={"gravity": mb.read_table(path)})


FAST = {  # times in s, forces in N, and the most steps of a run
    "jump": ((0.0, 5.0, 5.000001, 20.0), (0.0, 0.0, 10.0, 10.0), 200),
    "spike": ((0.0, 5.0, 5.001, 5.002, 20.0), (0.0, 0.0, 1e4, 0.0, 0.0), 200),
    "spikes": (
        [k + x for k in range(20) for x in (0.0, 0.5, 0.5001, 0.5002)] + [20.0],
        [0.0, 0.0, 1e4, 0.0] * 20 + [0.0],
        3000,
    ),
}


@pytest.mark.parametrize("solver", ["ida", "adams", "hybrid", "radau"])
@pytest.mark.parametrize("name", FAST)
def test_jumps_and_spikes_of_a_file_are_followed_in_few_steps(tmp_path: Path, name: str, solver: str) -> None:
    """The exact motion is the second integral of the lines through the points, divided by the mass."""
    times, forces, most = FAST[name]
    (tmp_path / "push.csv").write_text(
        "t,force\n" + "".join(f"{t!r},{f!r}\n" for t, f in zip(times, forces, strict=True))
    )
    model = Cart().with_inputs({"force": read_value("force", "push.csv", tmp_path)})
    result = mb.simulate(model, 20.0, interval=1.0, solver=solver, tolerance=1e-6)
    slopes = np.diff(forces) / np.diff(times)
    exact = PPoly(np.array([slopes, forces[:-1]]), np.array(times)).antiderivative(2)(result.t) / 2.0
    np.testing.assert_allclose(result["x"], exact, atol=5e-6 * exact.max())
    assert result.statistics.steps < most
    assert result.warning == ""


def test_every_command_states_the_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A comparison runs the driven model, whose exact motion ends at x = 0.5."""
    given = [f"{__file__}:Cart", "--input", "force=6*t"]
    compared = ["--solver", "adams", "--tolerance", "1e-4", "--tolerance", "1e-6", "--repeats", "1"]
    pages = ["-o", str(tmp_path / "page.html")]
    for command in (["check", *given], ["compare", *given, *compared, "-o", str(tmp_path)], ["view", *given, *pages]):
        assert main(command) == 0, command
        assert "input force: 6*t" in capsys.readouterr().out, command
    (table,) = tmp_path.rglob("table.txt")
    assert "input force: 6*t" in table.read_text()
    assert main(["view", str(tmp_path / "motion.npz"), "--input", "force=1"]) == 2
    assert "--input changes a run" in capsys.readouterr().err


def test_the_command_states_the_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """x = t^3 / 2 at the end of the run; a table that ends before the run is refused."""
    model = f"{__file__}:Cart"
    where = ["--direct", "--solver", "adams", "-o", str(tmp_path)]
    assert main(["run", model, "--input", "force=6*t", *where]) == 0
    assert "input force: 6*t" in capsys.readouterr().out
    (file,) = tmp_path.rglob("result.npz")
    assert mb.Result.load(file)["x"][-1] == pytest.approx(0.5, abs=1e-5)
    (scene,) = tmp_path.rglob("default.toml")
    assert '"force" = "6*t"' in scene.read_text()
    scene.write_text(scene.read_text().replace('"6*t"', "{times = [0, 1], values = [0, 6]}"))
    assert main(["run", str(scene), "-o", str(tmp_path / "fmu")]) == 0  # as an FMU
    (file,) = (tmp_path / "fmu").rglob("result.npz")
    assert mb.Result.load(file)["x"][-1] == pytest.approx(0.5, abs=1e-5)
    assert mb.Result.load(file).inputs == ("force: points, evaluated at the solver's times",)
    short = tmp_path / "short.csv"
    short.write_text("time,force [N]\n0,0\n0.5,1\n")
    assert main(["run", model, "--input", f"force={short}", *where]) == 2
    assert "input 'force' is given from 0 to 0.5 s, but the run is from 0 to 1 s" in capsys.readouterr().err


def test_steady_states_are_those_of_the_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Closed form: x = F / k, and the frequency sqrt(k / m) / 2 pi; an input that is replaced cannot be varied."""
    given = [f"{__file__}:HeldCart", "--input", "force=5"]
    folder = ["-o", str(tmp_path)]
    commands = (
        ["equilibrium", *given],
        ["modes", *given, *folder],
        ["linearize", *given, "-o", str(tmp_path / "a.npz")],
    )
    for command in (*commands, ["equilibrium", *given, "--sweep", "mass=1:2:1", *folder]):
        assert main(command) == 0, command
        shown = capsys.readouterr().out
        assert "input force: 5\n" in shown, command
        assert "0.05" in shown or "1.125" in shown, command
    assert main(["path", *given, "--over", "force=0:1", *folder]) == 2
    assert "force" in capsys.readouterr().err
    assert main(["equilibrium", given[0], "--input", "force=6*t"]) == 2
    assert "does not end at a constant value" in capsys.readouterr().err


def outcomes(content: dict[str, object]) -> list[Outcome]:
    """Make the runs of a study in this process, as a worker makes them."""
    definition = define(content)
    job = pickle.loads(pickle.dumps(definition.job()))  # what a scheduler sends
    try:
        return run_batch(job, list(enumerate(definition.points())))
    finally:
        forget_job(job)


@pytest.mark.parametrize("method", ["simulation", "fmu"])
def test_runs_of_a_study_have_the_input(tmp_path: Path, method: str) -> None:
    """Closed form: x = t^3 / m by F = 6 t, from a file with its path relative to the study, or from the scene."""
    (tmp_path / "push.csv").write_text("time [min],force [kN]\n0,0\n1,0.36\n")
    (tmp_path / "scene.toml").write_text(f"model = '{__file__}:Cart'\nsolver = 'adams'\n")
    (tmp_path / "given.toml").write_text(
        f"scene = 'scene.toml'\nwith = '{method}'\n[inputs]\nforce = 'push.csv'\n"
        "[vary]\nmass = [2.0, 4.0]\n[measure]\nx = 'end x'\n"
    )
    content = read_study(tmp_path / "given.toml")
    found = outcomes(content)
    assert [outcome.message for outcome in found] == ["", ""]
    assert [outcome.measures[0] for outcome in found] == pytest.approx([0.5, 0.25], rel=1e-5)
    assert define(content).target.replaced_inputs == (
        f"input force: column 'force' of file {str(tmp_path / 'push.csv')!r}, 2 points from 0 to 60 s",
    )
    with pytest.raises(mb.UserError, match="'force'"):
        define(content | {"vary": {"force": [1.0]}})
    with pytest.raises(mb.UserError, match="input 'force' is given from 0 to 60 s, but the run is from 0 to 61 s"):
        define(content | {"stop_time": 61.0})


def test_studies_refuse_inputs_that_they_cannot_replace(tmp_path: Path) -> None:
    """The messages name the input; stop times that vary must be within a table. The model is sent without a file."""
    model = Cart().with_inputs({"force": mb.Table([0.0, 60.0], [0.0, 360.0])})
    content: dict[str, object] = {"scene": model, "measure": {"x": "end x"}, "fixed": {"solver": "adams"}}
    (found,) = outcomes(content | {"vary": {"mass": [2.0]}, "inputs": {"force": "12*t"}})
    assert found.measures[0] == pytest.approx(1.0, rel=1e-5)
    with pytest.raises(
        mb.UserError, match="input 'force' of 'cart/default' is replaced by a signal, so that it cannot"
    ):
        define(content | {"vary": {"force": [1.0]}})
    with pytest.raises(mb.UserError, match="input 'force' is given from 0 to 60 s, but the run is from 0 to 61 s"):
        define(content | {"vary": {"stop_time": [1.0, 61.0]}})
    (tmp_path / "any.fmu").touch()
    with pytest.raises(mb.UserError, match="inputs force and an FMU are given"):
        define({"fmu": str(tmp_path / "any.fmu"), "vary": {"force": [1.0]}, "inputs": {"force": 1.0}})


def test_an_fmu_that_calls_python_contains_the_input(tmp_path: Path) -> None:
    """x = t^3 / m by F = 6 t, as an expression and as a table; other signals cannot be written."""
    for value in ("6*t", mb.Table([0.0, 60.0], [0.0, 360.0])):
        model = Cart().with_inputs({"force": value})
        path = mb.export(model, tmp_path / "cart.fmu", mb.Settings(solver="adams"), native=False)
        with Fmu(path) as fmu:
            assert not fmu.names("input")
            fmu.step_to(1.0)
            assert fmu["x"] == pytest.approx(0.5, rel=1e-5)
        with Fmu(path, {"mass": 4.0}) as fmu:
            fmu.step_to(1.0)
            assert fmu["x"] == pytest.approx(0.25, rel=1e-5)
    with pytest.raises(
        mb.UserError, match=r"input .force. is .*which a scene file and an FMU that calls Python cannot"
    ):
        mb.export(Cart().with_inputs({"force": lambda t: 6.0 * t}), tmp_path / "cart.fmu", native=False)


@pytest.mark.parametrize("solver", ["adams", "ida", "radau"])
@pytest.mark.parametrize(
    ("force", "impulse"),
    [("100*exp(-((t-5.2)/0.01)**2)", np.sqrt(np.pi)), ("(t>5.2)*(t<5.23)/0.03", 1.0)],
)
def test_pulses_that_are_shorter_than_a_step_are_not_missed(force: str, impulse: float, solver: str) -> None:
    """The cart moves uniformly after the impulse."""
    model = Cart(mass=1.0).with_inputs({"force": force})
    found = mb.simulate(model, 10.0, interval=0.1, solver=solver)
    assert found["x"][-1] - found["x"][-2] == pytest.approx(0.1 * impulse, rel=1e-5)
    assert not found.warning


def test_the_command_does_not_miss_a_pulse(tmp_path: Path) -> None:
    """It does not simulate an FMU then, which does not know the length of the run."""
    given = ["--input", "force=100*exp(-((t-5.2)/0.01)**2)", "--set", "mass=1", "--stop-time", "10"]
    assert main(["-q", "run", f"{__file__}:Cart", "--solver", "ida", *given, "-o", str(tmp_path)]) == 0
    (path,) = tmp_path.rglob("result.npz")
    assert mb.Result.load(path)["x"][-1] == pytest.approx(np.sqrt(np.pi) * (10.0 - 5.2), rel=1e-5)


@dataclass(frozen=True, kw_only=True)
class Road(mb.Model):
    """A wheel on a road, whose height is an input."""

    stop_time = 3.0

    def build(self) -> mb.Mechanism:
        """Return the mechanism."""
        m = mb.Mechanism()
        road = m.body("road", m.ground, mb.Translational(axis="z", drive=mb.Input(name="height", unit="m")))
        wheel = m.body("wheel", road, mb.Translational(axis="z"), mass=1.0)
        m.force("tire", mb.JointSpring(stiffness=100.0), wheel)
        m.output("z", wheel.position("z"))
        return m


@pytest.mark.parametrize("command", ["run", "check", "view", "export", "compare"])
def test_commands_refuse_functions_that_no_joint_can_follow(capsys: pytest.CaptureFixture[str], command: str) -> None:
    """The accelerations are infinite where the motion or its rate jumps: only `run` gave a warning."""
    for height in ("abs(t-1)", "1 if t>1 else 0", "max(0,t-2.9)"):
        assert main([command, f"{__file__}:Road", "--input", f"height={height}"]) == 2
        error = capsys.readouterr().err
        assert re.search(r"input 'height', which moves a joint, cannot be replaced by .* jumps at t = ", error)


def test_studies_refuse_functions_that_no_joint_can_follow() -> None:
    """A smooth function is allowed."""
    content: dict[str, object] = {"scene": Road(), "measure": {"z": "end z"}, "vary": {"tolerance": [1e-6]}}
    define(content | {"inputs": {"height": "0.1*sin(t)"}})
    with pytest.raises(mb.UserError, match=r"input 'height', which moves a joint, .*its rate jumps at t = 2 s"):
        define(content | {"inputs": {"height": "abs(t-2)"}})
