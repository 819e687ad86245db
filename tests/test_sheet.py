"""The flexible sheet against independent results: statics, frequencies, release; hard cases; its FMU."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy.validation import validate_fmu

from fmus.sheet import Sheet
from fmus.sheet.model import RELEASE_DATA
from mbfmu.fmi import Fmu, export
from mbfmu.mechanics import CompiledMechanism, Mechanism, Weld
from mbfmu.mechanics.loads import Drag
from mbfmu.mechanics.recursions.rnea import momentum
from mbfmu.session.run import run
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.sheets import Plate, Support, add_sheet
from mbfmu.steady import rigid_body_modes
from mbfmu.steady.equilibrium import build_problem, equilibrium
from mbfmu.util.errors import EquilibriumError, UserError
from mbfmu.viewer.mode_shapes import without_rounding

DATA = Path(__file__).parent / "data" / "sheet"
CLAMPED = [1.7544, 5.6901, 10.8989, 19.3376, 25.0568, 31.0848, 39.8990, 40.8125]  # Hz, flat
FREE = [9.7272, 10.8575, 22.6659, 23.0186, 28.3701, 32.5645, 42.5163, 47.4405]


@pytest.mark.parametrize(
    ("grid", "within"), [((7, 5), 1.2e-3), ((15, 11), 0.4e-3), ((33, 23), 0.15e-3), ((51, 35), 0.1e-3)]
)
def test_static_tip_on_the_papers_grids(grid: tuple[int, int], within: float) -> None:
    found = equilibrium(Sheet(nx=grid[0], nz=grid[1]))
    assert found.outputs["tip.y"] == pytest.approx(-0.10822, abs=within)
    assert found.stability == "undamped"
    weight = 1000.0 * 0.3 * 0.21 * 0.3e-3 * 9.81
    assert found.outputs["reaction.y"] == pytest.approx(weight, rel=1e-9)


def test_static_center_line_lies_on_both_shell_codes() -> None:
    model = Sheet(nx=51, nz=35, grid_outputs=True)
    found = equilibrium(model)
    line = np.array([[found.outputs[f"node[{i},17].{axis}"] for axis in "xy"] for i in range(51)])
    table = np.genfromtxt(DATA / "cantilever_static_centerline.csv", delimiter=",", names=True)
    names = table.dtype.names
    assert names is not None
    for x, y in zip(names[1::2], names[2::2], strict=True):
        station = np.column_stack((table[x], table[y]))
        gaps = [np.linalg.norm(line - point, axis=1).min() for point in station]
        assert max(gaps) < 0.15e-3, (x, y)


def test_thin_and_thick_sheets_hang_as_they_should() -> None:
    thin = equilibrium(Sheet(thickness=0.1e-3)).outputs
    assert -0.3 < thin["tip.y"] < -0.25  # almost straight down
    fine = equilibrium(Sheet(thickness=0.1e-3, nx=33, nz=23)).outputs
    assert thin["tip.y"] == pytest.approx(fine["tip.y"], abs=1e-3)
    thick = equilibrium(Sheet(thickness=1e-3)).outputs
    stiffness = 1e10 * 1e-9 / (12.0 * (1.0 - 0.09))
    assert thick["tip.y"] == pytest.approx(-1000.0 * 1e-3 * 9.81 * 0.3**4 / (8.0 * stiffness), rel=0.03)


def test_rounding_in_a_heavy_plate_is_no_force_that_changes_with_time() -> None:
    """4600 N of steel leave 2e-7 N."""
    plate = Sheet(length=3.0, width=2.0, thickness=0.01, youngs_modulus=2.1e11, density=7800.0)
    assert equilibrium(plate).stability == "undamped"


def test_downhill_ends_lower_than_the_unstable_state_next_to_the_start() -> None:
    """Gravity along the sheet, towards its clamp: Newton alone finds it standing, long steps led there too."""
    balance = build_problem(Sheet(gravity_x=9.81, gravity_y=-0.05, thickness=0.15e-3))
    standing = balance.solve()
    assert standing.stability == "unstable"
    (fallen,) = balance.others(standing, 1)[:1]
    assert fallen.stability == "undamped"
    assert fallen.outputs["energy"] < standing.outputs["energy"]


def test_a_clamp_over_part_of_the_edge_lets_the_sheet_sag_further() -> None:
    part = equilibrium(Sheet(held_part=0.3)).outputs
    assert part["tip.y"] < -0.12
    assert part["corner1.y"] == pytest.approx(part["corner2.y"], rel=1e-6)


def field_of(model: Sheet) -> Any:
    """The field of a sheet at rest, (nx - 1, nz - 1)."""
    outputs = equilibrium(model).outputs
    return np.array([[outputs[name] for name in row] for row in model.arrays()[model.field]])


@pytest.mark.parametrize("stretch", [False, True])
def test_cells_carry_the_weight_of_the_sheet_beyond_them(stretch: bool) -> None:
    moment = field_of(Sheet(nx=9, nz=7, gravity_y=-0.01, field="moment.xx", stretch=stretch))
    x = (np.arange(8) + 0.5) * 0.3 / 8
    beyond = 1000.0 * 0.3e-3 * 0.21 * 0.01 * x**2 / 2.0
    assert moment.sum(axis=1) * 0.21 / 6 == pytest.approx(-beyond, rel=1e-3)


def test_fields_of_a_stretched_sheet_are_one_state_by_hooke() -> None:
    held = {"support": "two_edges", "stretch": True, "slide": False, "pressure": 50.0, "gravity_y": 0.0}
    names = ("strain.xx", "strain.zz", "force.xx", "moment.xx", "stress_top.xx", "stress_bottom.xx")
    along, across, force, moment, top, bottom = (field_of(Sheet(nx=6, nz=5, field=name, **held)) for name in names)
    t = 0.3e-3
    assert force == pytest.approx(1e10 * t / (1.0 - 0.3**2) * (along + 0.3 * across), rel=1e-9)
    assert top + bottom == pytest.approx(2.0 * force / t, rel=1e-9)
    assert bottom - top == pytest.approx(12.0 * moment / t**2, rel=1e-6)
    assert (force > 0.0).all()


def test_sheet_without_a_field_publishes_none() -> None:
    plain, told = (CompiledMechanism(Sheet(nx=5, nz=4, field=field).build()).outputs for field in ("none", "moment.zz"))
    assert told[: len(plain)] == plain
    assert [v.name for v in told[len(plain) :]] == [f"moment.zz[{i},{k}]" for i in range(4) for k in range(3)]
    with pytest.raises(UserError, match="use stretch=True"):
        Sheet(field="force.xx").build()


def test_bending_alone_lets_the_sheet_curl() -> None:
    assert equilibrium(Sheet(membrane=False)).outputs["tip.y"] == pytest.approx(-0.1114, abs=3e-4)


@pytest.mark.parametrize(("support", "expected", "rigid"), [("clamped", CLAMPED, 0), ("free", FREE, 6)])
def test_frequencies_flat(support: str, expected: list[float], rigid: int) -> None:
    from mbfmu.steady.modes import shapes

    errors = []
    for nx, nz in ((17, 12), (33, 23)):
        compiled = CompiledMechanism(Sheet(nx=nx, nz=nz, support=support, gravity_y=0.0).build())
        found = shapes(compiled, compiled.assembly.start_positions(), rigid + 8, np.zeros(0))
        frequencies = np.array([shape.mode.frequency for shape in found]) / (2.0 * np.pi)
        assert (frequencies[:rigid] < 1e-3 * expected[0]).all()
        errors.append(np.abs(frequencies[rigid:] / expected - 1.0))
    assert (errors[1] < 0.015).all()
    assert errors[1][-1] < 0.35 * errors[0][-1]  # second order: a quarter


def release(grid: tuple[int, int], solver: str, tolerance: float) -> tuple[Any, Any]:
    """Return a run of half a second and the tip's errors relative to its swing."""
    table = np.genfromtxt(RELEASE_DATA, delimiter=",", names=True)
    result = run(Sheet(nx=grid[0], nz=grid[1]), Settings(solver=solver, tolerance=tolerance), table["t_s"])
    assert not result.failure
    return result, (result["tip.y"] - table["y_shell_m"]) / np.ptp(table["y_shell_m"])


@pytest.mark.parametrize(("grid", "tolerance", "within"), [((15, 11), 1e-5, 0.01), ((51, 35), 1e-4, 0.005)])
def test_release_from_flat(grid: tuple[int, int], tolerance: float, within: float) -> None:
    result, errors = release(grid, "ida", tolerance)
    assert np.abs(errors).max() < within
    if tolerance <= 1e-5:
        drift = np.ptp(result["energy"]) / np.ptp(result["kinetic_energy"])
        assert drift < 1e-3


def twisting(**values: Any) -> float:
    """Frequency of the first mode that moves the corners apart, Hz: the second one."""
    found = equilibrium(Sheet(**values))
    return found.modes[1].frequency / (2.0 * np.pi)


def test_twist_of_a_bent_sheet_does_not_lock() -> None:
    """Joints that turn about the normal as they bend and twist made it 8.05 and 6.56 Hz on the last two grids."""
    coarse, middle, fine = (twisting(nx=nx, nz=nz) for nx, nz in ((9, 7), (15, 11), (33, 23)))
    assert middle == pytest.approx(fine, rel=0.01)
    assert (coarse - fine) / (middle - fine) > (14 / 8) ** 3


def test_bent_sheet_twists_as_a_developable_surface() -> None:
    """A thin sheet that is bent twists by curving along a tilted ruling: the stiffness is 2 D, flat it is 2 (1 - nu) D.

    Vlasov's rod by Ritz: energy (D b^3/12 theta''^2 + 2 D b theta'^2) / 2, one end clamped.
    """
    L, b, t = 0.3, 0.21, 0.03e-3
    D = 1e10 * t**3 / (12.0 * 0.91)
    x, weight = np.polynomial.legendre.leggauss(20)
    x = 0.5 * (x + 1.0)
    terms = [np.polynomial.Polynomial([0.0] * k + [1.0]) for k in range(2, 10)]
    theta, slope, bend = (np.array([p.deriv(d)(x) if d else p(x) for p in terms]) for d in range(3))
    K = D * b**3 / (12.0 * L**4) * (bend * weight) @ bend.T + 2.0 * D * b / L**2 * (slope * weight) @ slope.T
    M = 1000.0 * t * b**3 / 12.0 * (theta * weight) @ theta.T
    expected = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).real.min()) / (2.0 * np.pi)
    found = twisting(tree="rows", thickness=t, gravity_y=-0.01, nx=15, nz=11)
    assert found == pytest.approx(expected, rel=0.01)


def test_stiff_sheet_swings_on_at_the_tolerance_of_the_scene() -> None:
    """Its angles are small, and the tolerance is relative to them."""
    simulation = Simulation(Sheet(thickness=3e-3), Settings(tolerance=1e-5))
    names = [v.name for v in simulation.compiled.outputs]
    energy, tip = names.index("energy"), names.index("tip.y")
    before, weight = simulation.outputs()[energy], 1000.0 * 0.3 * 0.21 * 3e-3 * 9.81
    assert simulation.advance(0.5).ok
    lost = simulation.outputs()[energy] - before
    assert abs(simulation.outputs()[tip]) < 3e-3
    assert abs(lost) < 0.003 * 0.5 * weight * 1.2e-3  # of some half the weight times half the tip's swing


def test_explicit_and_implicit_agree() -> None:
    explicit, _ = release((7, 5), "adams", 1e-5)
    implicit, _ = release((7, 5), "ida", 1e-6)
    assert np.abs(explicit["tip.y"] - implicit["tip.y"]).max() < 2e-4
    assert np.ptp(explicit["energy"]) < 1e-3 * np.ptp(explicit["kinetic_energy"])


@pytest.mark.parametrize("damping", [0.005, 0.02])
def test_damped_sheet_comes_to_rest_in_the_state_of_newtons_method(damping: float) -> None:
    model = Sheet(nx=9, nz=7, damping=damping)
    result = run(model, Settings(tolerance=1e-5), np.array([0.0, 0.2, 20.0 if damping < 0.01 else 10.0]))
    assert result["energy"][1] < result["energy"][0] - 1e-4
    assert result["tip.y"][-1] == pytest.approx(equilibrium(model).outputs["tip.y"], abs=1e-4)


@pytest.mark.parametrize(("grid", "solver"), [((5, 4), "ida"), ((5, 4), "adams"), ((7, 5), "esdirk")])
def test_saved_runs_go_on(grid: tuple[int, int], solver: str) -> None:
    settings = Settings(solver=solver, tolerance=1e-5)
    first, second = (Simulation(Sheet(nx=grid[0], nz=grid[1]), settings) for _ in range(2))
    first.advance(0.02)
    second.stepper.restore(first.stepper.save())
    first.advance(0.03)
    second.advance(0.03)
    np.testing.assert_allclose(first.outputs(), second.outputs().copy(), atol=1e-4 if solver == "ida" else 0.0)


def test_a_free_sheet_falls_in_statics_and_the_message_names_the_motion() -> None:
    with pytest.raises(EquilibriumError, match="nothing resists translation along y, on which the loads act"):
        equilibrium(Sheet(support="free"))


def test_failed_statics_are_reported_though_modes_fail_too(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> Any:
        raise EquilibriumError("the natural modes were not found")

    monkeypatch.setattr(rigid_body_modes, "free_motions", fail)
    with pytest.raises(EquilibriumError, match=r"no equilibrium was found for 'sheet': .* residual"):
        equilibrium(Sheet(support="free"))


@pytest.mark.parametrize("grid", [(4, 3), (15, 11)])
@pytest.mark.parametrize("tree", ["spine", "master"])
def test_pinned_sheet_swings_down_and_hangs_as_a_pendulum(grid: tuple[int, int], tree: str) -> None:
    """With the edge on cut joints too, whose planes turn with the nodes."""
    found = equilibrium(Sheet(nx=grid[0], nz=grid[1], support="pinned", tree=tree))
    welded = equilibrium(Sheet(nx=grid[0], nz=grid[1], support="pinned"))
    assert [m.frequency for m in found.modes[:4]] == pytest.approx([m.frequency for m in welded.modes[:4]], rel=1e-3)
    assert (found.outputs["tip.x"], found.outputs["tip.y"]) == pytest.approx((0.3, -0.3), abs=1e-9)
    assert found.modes[0].frequency == pytest.approx(np.sqrt(1.5 * 9.81 / 0.3), rel=3e-3)


@pytest.mark.parametrize(
    ("support", "words"),
    [
        ("clamped", ""),
        ("pinned", "rotation about z through (0.3, 0, 0.105) m"),
        ("free", "translation along x; translation along y; translation along z; rotation about every axis"),
    ],
)
@pytest.mark.parametrize("grid", [(7, 5), (33, 23)])
def test_statics_reports_what_is_free_to_move(support: str, words: str, grid: tuple[int, int]) -> None:
    found = equilibrium(Sheet(nx=grid[0], nz=grid[1], support=support, gravity_y=0.0))
    assert found.free == words
    assert found.stability == ("neutral" if words else "undamped")
    assert found.as_dict()["free_motions"] == words


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"thickness": 0.0}, "thickness"),
        ({"thickness": -1.0}, "thickness"),
        ({"thickness": float("nan")}, "thickness"),
        ({"nx": 1}, "nx"),
        ({"tree": "bush"}, "'spine', 'rows', 'master'"),
        ({"support": "glued"}, "'clamped'"),
    ],
)
def test_mistakes_are_named(values: dict[str, Any], words: str) -> None:
    with pytest.raises(UserError, match=words):
        Sheet(**values)


def inputs_of(simulation: Simulation) -> dict[str, int]:
    """Numbers of the inputs by name."""
    return {variable.name: k for k, variable in enumerate(simulation.compiled.inputs.variables)}


def test_fmu(tmp_path: Path) -> None:
    """Held, then moved, then gravity turns: as the direct run; a saved state continues with what was set."""
    model = Sheet(nx=7, nz=5, support="moved")
    path = export(model, tmp_path / "sheet.fmu", native=False)
    assert validate_fmu(str(path)) == []
    direct = Simulation(model, Settings(tolerance=1e-5))
    inputs = inputs_of(direct)
    with Fmu(path) as fmu:
        assert {name for name, v in fmu.variables.items() if v.causality == "input"} == set(inputs)
        assert "node[0,0].x" not in fmu.variables
        assert fmu.variables["gravity.y"].start == "-9.81"
        for settings in ({}, {"edge.vy": 1.0}, {"edge.vy": 0.0, "gravity.x": 5.0, "gravity.y": 2.0}):
            before = direct.outputs().copy()
            for name, value in settings.items():
                fmu[name] = value
                direct.set_input(inputs[name], value)
            fmu.step(0.05)
            assert direct.advance(fmu.t).ok
            np.testing.assert_allclose(fmu.reals(), direct.outputs(), rtol=1e-9, atol=1e-9)
            assert np.abs(direct.outputs() - before).max() > 1e-2
        saved, t = fmu.save(), fmu.t
        fmu.step(0.02)
        once = fmu["tip.x"], fmu["tip.y"]
        fmu["gravity.x"] = 0.0
        fmu.step(0.02)
        again = []
        for _ in range(2):
            fmu.restore(saved)
            fmu.t = t
            fmu.step(0.02)
            again.append((fmu["tip.x"], fmu["tip.y"]))
        assert again[1] == again[0]
        assert again[0] == pytest.approx(once, abs=5e-4)  # ida restarts among waves caused by the stop of the edge


@pytest.mark.parametrize(
    ("grid", "solver"),
    [((7, 5), "ida"), ((7, 5), "adams"), ((4, 3), "ida"), ((4, 3), "adams"), ((7, 5), "esdirk")],
)
def test_gravity_turns_while_the_sheet_swings(grid: tuple[int, int], solver: str) -> None:
    """Without it the energy is kept; a mirrored one mirrors the motion; saved runs go on with what was set."""
    settings = Settings(solver=solver, tolerance=1e-6)
    model = Sheet(nx=grid[0], nz=grid[1], thickness=1e-3, gravity_y=0.0)
    down, up = (Simulation(model, settings) for _ in range(2))
    for simulation, g in ((down, -9.81), (up, 9.81)):
        simulation.set_input(inputs_of(simulation)["gravity.y"], g)
        assert simulation.advance(0.02).ok
    outputs = {v.name: k for k, v in enumerate(down.compiled.outputs)}
    tip = down.outputs()[outputs["tip.y"]]
    assert tip < -1e-3
    assert up.outputs()[outputs["tip.y"]] == pytest.approx(-tip, abs=1e-6)
    down.set_input(inputs_of(down)["gravity.y"], 0.0)
    before = down.outputs()[outputs["energy"]]
    saved = down.save()
    assert down.advance(0.04).ok
    assert down.outputs()[outputs["energy"]] == pytest.approx(before, rel=1e-3)
    fresh = Simulation(model, settings)
    fresh.restore(saved)
    assert fresh.advance(0.04).ok
    np.testing.assert_allclose(fresh.outputs(), down.outputs().copy(), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(("grid", "thickness", "tip"), [((9, 7), 1e-4, -0.25), ((4, 3), 3e-4, -0.1)])
def test_statics_with_gravity_by_the_input(grid: tuple[int, int], thickness: float, tip: float) -> None:
    """Neither is found by Newton alone."""
    model = Sheet(nx=grid[0], nz=grid[1], thickness=thickness)
    expected = equilibrium(model)
    weightless = model.with_values({"gravity_y": 0.0})
    number = inputs_of(Simulation(weightless, Settings()))["gravity.y"]
    hanging = Simulation(weightless, Settings(start_at_equilibrium=True), inputs={number: -9.81})
    found = dict(zip(expected.outputs, hanging.outputs()[:-2], strict=True))
    assert found["tip.y"] < tip
    assert found == pytest.approx(expected.outputs, abs=1e-8)


def test_modes_command_draws_shapes(command: Any, tmp_path: Path) -> None:
    code, out, _ = command("modes", "sheet", "--set", "nx=9", "--set", "nz=7", "-n", "5", "-o", str(tmp_path))
    assert code == 0
    assert out.count("±") == 5
    folder = tmp_path / "sheet" / "default-modes"
    assert (folder / "shapes.png").stat().st_size > 10_000
    assert (folder / "modes.txt").read_text() + f"wrote {folder}\n" == out
    code, out, _ = command("modes", "governor", "-o", str(tmp_path))
    assert code == 0
    assert "6.552" in out
    assert not (tmp_path / "governor" / "default-modes" / "shapes.png").exists()
    assert command("modes", "sheet", "-n", "0")[0] == 2


def test_no_nodal_line_is_made_of_rounding() -> None:
    """Bending and twist of a sheet clamped at its right end, where what is left is rounding of either sign."""
    x, z = np.linspace(1.0, 0.0, 9), np.linspace(-1.0, 1.0, 7)
    noise = 1e-9 * (-1.0) ** np.add.outer(np.arange(9), np.arange(7))
    bending, twist = np.outer(x**2, np.ones(7)) + noise, np.outer(x**2, z) + noise
    assert without_rounding(bending).min() > 0.0
    settled = without_rounding(twist)
    assert np.array_equal(np.sign(settled), np.tile(np.sign(z.round(9)), (9, 1)))
    there = np.abs(twist) > 1e-4
    assert np.array_equal(settled[there], twist[there])


def test_ledger_of_effects(command: Any) -> None:
    code, out, _ = command(
        "effects", "sheet", "--set", "nx=5", "--set", "nz=4", "--stop-time", "0.01", "--show", "tip.y"
    )
    assert code == 0
    assert [line.split("  ")[0] for line in out.splitlines()[2:9]] == [
        "as defined", "without gravity", "without membrane", "with stretch", "with damping", "with drag",
        "with pressure",
    ]  # fmt: skip
    assert "tip.y (range 0.000" in out.splitlines()[0]
    assert "gravity changes tip.y by 100 % of its range: keep it on" in out
    assert command("effects", "sheet", "--stop-time", "0.01", "--show", "tipp.y")[0] == 2
    assert command("effects", "pendulum")[0] == 2


def test_the_shell_code_is_given_one_sheet_only() -> None:
    times = np.arange(0.0, 0.5001, 0.005)
    told = Sheet(nx=7, nz=5).independent(times)
    assert told is not None
    y, doubt = told["tip.y"]
    assert doubt < 1e-4
    assert np.ptp(y) == pytest.approx(0.1948, abs=1e-4)
    assert Sheet(damping=0.01).independent(times) is None
    assert Sheet().independent(times + 0.5) is None
    assert Sheet().independent(0.5 * times) is None


def test_effects_turned_off_leave_nothing_behind() -> None:
    """The arrays are those of a sheet built without any, bit for bit."""
    on = Sheet(nx=5, nz=4, damping=0.01, drag=1.0, gravity_x=1.0)
    off = on.with_values({"membrane": False, "damping": 0.0, "drag": 0.0, "gravity_x": 0.0, "gravity_y": 0.0})
    m = Mechanism()
    add_sheet(
        m, "bare", length=off.length, width=off.width, thickness=off.thickness, youngs_modulus=off.youngs_modulus,
        poisson=off.poisson, density=off.density, grid=(5, 4),
        supports=[Support("x1", body=m.body("edge", m.ground, Weld()))],
    )  # fmt: skip
    acting, quiet, bare = (CompiledMechanism(built) for built in (on.build(), off.build(), m))
    assert len(acting.records(Drag)) == len(acting.records(Plate)) == 12
    assert acting.records(Plate)["membrane"].all()
    assert acting.records(Plate)["damped"].all()
    assert len(quiet.records(Drag)) == 0
    assert quiet.records(Plate).tobytes() == bare.records(Plate).tobytes()
    for name in ("loads", "signals", "world"):
        assert len(getattr(quiet.data.arrays, name)) == len(getattr(bare.data.arrays, name))
    assert quiet.data.arrays.world.tobytes() == bare.data.arrays.world.tobytes()


@pytest.mark.parametrize(("solver", "tolerance", "within"), [("adams", 1e-9, 1e-8), ("ida", 1e-7, 5e-3)])
def test_thrown_sheet_tumbles_and_keeps_its_momentum(solver: str, tolerance: float, within: float) -> None:
    model = Sheet(nx=7, nz=5, support="free", gravity_y=0.0, start_spin=40.0, start_velocity=1.0)
    simulation = Simulation(model, Settings(solver=solver, tolerance=tolerance))
    energy = [v.name for v in simulation.compiled.outputs].index("energy")

    def kept() -> Any:
        now, out = simulation.outputs()[energy], np.zeros(6)
        compiled, stepper = simulation.compiled, simulation.stepper
        compiled.energy(stepper.t, stepper.q, stepper.v)  # places the bodies
        momentum(compiled.data.arrays, compiled.data.state, out)
        return np.append(out, now)

    start, leaned = kept(), 1.0
    for t in np.linspace(0.01, 0.4, 40):
        assert simulation.advance(float(t)).ok
        np.testing.assert_allclose(kept(), start, atol=within * np.abs(start[:3]).max())
        _, x, _, z = simulation.stepper.q[3:7]
        leaned = min(leaned, 1.0 - 2.0 * (x * x + z * z))  # cosine of the master node's normal to y
    assert leaned < -0.5  # upside down


def test_only_a_free_sheet_is_thrown() -> None:
    with pytest.raises(UserError, match="no floating master node"):
        add_sheet(
            Mechanism(), "s", length=1.0, width=1.0, thickness=1e-3, youngs_modulus=1e9, density=1e3, grid=(3, 3),
            supports=[Support("x1")], rate=(0.0,) * 6,
        )  # fmt: skip
