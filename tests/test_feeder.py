"""The feeder and what it is made of: sensors of sheets against geometry, paths, skew, jams, bad input, its FMU."""

from __future__ import annotations

from pathlib import Path as File
from typing import Any

import numpy as np
import pytest
from fmpy import simulate_fmu

import mbfmu as mb
from fmus.feeder import Feeder
from fmus.feeder.path import Arc, Path, lay_out
from mbfmu.fmi import export
from mbfmu.mechanics import Mechanism
from mbfmu.modeling.scene import load_scene, scenes
from mbfmu.session.simulation import Settings, Simulation
from mbfmu.sheets import add_sheet, jammed
from mbfmu.sheets.contact.surface_contact import SurfaceContact
from mbfmu.util.errors import UserError

SMALL: dict[str, Any] = {"nx": 7, "nz": 5, "bend_radius": 0.1, "spacing": 0.2}  # cells that follow their bends
ANGLE, TILT = 0.3, 0.4  # rad
PLACE = np.array([0.1, 0.2, 0.3])  # m


def rotation() -> Any:
    """About y, and then about z."""
    c, s, k, j = np.cos(ANGLE), np.sin(ANGLE), np.cos(TILT), np.sin(TILT)
    return np.array([[k, -j, 0.0], [j, k, 0.0], [0.0, 0.0, 1.0]]) @ [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]


def told(sensors: dict[str, Any], m: Mechanism) -> dict[str, float]:
    """Return the values of sensors at the start."""
    for name, sensor in sensors.items():
        m.output(name, sensor)
    found = Simulation(m, Settings(solver="esdirk"))
    return dict(zip(sensors, found.outputs(), strict=False))


def test_sensors_of_a_rigid_sheet_return_its_geometry() -> None:
    """Sheet of an even number of nodes, so that no middle is a node."""
    m, R = Mechanism(), rotation()
    kind = {"thickness": 1e-4, "youngs_modulus": 4e9, "density": 800.0, "grid": (4, 6), "tree": "master"}
    sheet = add_sheet(m, "sheet", length=0.3, width=0.2, at=PLACE, rotation=R, membrane=True, **kind)  # type: ignore[arg-type]
    sensors = {"skew": sheet.skew(), "aligned": sheet.skew("x0", across=R[:, 2])}
    middles = {"x0": (0.0, 0.0, 0.1), "x1": (0.3, 0.0, 0.1), "z0": (0.15, 0.0, 0.0), "z1": (0.15, 0.0, 0.2)}
    sensors |= {f"{name}.{axis}": sheet.edge(name).position(axis) for name in middles for axis in "xyz"}
    sensors |= {f"point.{axis}": sheet.point(0.07, 0.11).position(axis) for axis in "xyz"}
    found = told(sensors, m)
    assert found["skew"] == pytest.approx(ANGLE, abs=1e-12)
    assert found["aligned"] == pytest.approx(0.0, abs=1e-12)
    for name, flat in {**middles, "point": (0.07, 0.0, 0.11)}.items():
        np.testing.assert_allclose([found[f"{name}.{axis}"] for axis in "xyz"], PLACE + R @ flat, atol=1e-12)


def test_a_beam_is_covered_where_the_sheet_is_and_partly_at_its_edges() -> None:
    m, R = Mechanism(), rotation()
    kind = {"thickness": 1e-4, "youngs_modulus": 4e9, "density": 800.0, "grid": (4, 6), "tree": "master"}
    sheet = add_sheet(m, "sheet", length=0.3, width=0.2, at=PLACE, rotation=R, membrane=True, **kind)  # type: ignore[arg-type]
    wanted = {  # of the flat sheet: 3 u^2 - 2 u^3 with u = 1/2 + distance / 1 mm at an edge
        (0.15, 0.1): 1.0, (0.1, 0.08): 1.0, (0.2999, 0.1): 0.648, (0.3, 0.1): 0.5, (0.3001, 0.1): 0.352,
        (0.302, 0.1): 0.0, (-0.0002, 0.1): 0.216, (0.1, 0.0): 0.5, (0.1, 0.2002): 0.216, (0.0, 0.0): 0.25,
        (0.5, 0.5): 0.0,
    }  # fmt: skip
    beams = {
        str(place): sheet.covers(PLACE + R @ (place[0], 0.0, place[1]) + 0.05 * k * R[:, 1], R[:, 1])
        for k, place in enumerate(wanted)
    }
    beams["askew"] = sheet.covers(PLACE + R @ (0.15, 0.2, 0.1), R @ (0.25, 1.0, 0.0))  # meets it at x = 0.1
    beams["beside"] = sheet.covers(PLACE + R @ (0.15, 0.2, 0.1), R @ (0.8, 1.0, 0.0))  # at x = -0.01
    beams["along"] = sheet.covers(PLACE, R[:, 0])  # in its plane, where it is no shadow
    found = told(beams, m)
    for place, value in wanted.items():
        assert found[str(place)] == pytest.approx(value, abs=1e-9), place
    assert (found["askew"], found["beside"], found["along"]) == pytest.approx((1.0, 0.0, 0.0), abs=1e-12)


def test_bad_sensors_are_refused() -> None:
    m = Mechanism()
    kind = {"thickness": 1e-4, "youngs_modulus": 4e9, "density": 800.0, "grid": (3, 3), "tree": "master"}
    sheet = add_sheet(m, "sheet", length=0.3, width=0.2, **kind)  # type: ignore[arg-type]
    with pytest.raises(UserError, match="edge of sheet 'sheet' is 'top'; allowed: 'x0', 'x1'"):
        sheet.edge("top")
    with pytest.raises(UserError, match="edge of the skew of sheet 'sheet' is 'z0'"):
        sheet.skew("z0")
    with pytest.raises(UserError, match="nips that jam are"):
        jammed([])


@pytest.mark.parametrize("kind", ["s_bend", "turn", "straight", "chute"])
def test_paths_go_on_where_their_parts_end(kind: str) -> None:
    """Continuous in place and direction, and as long as a polyline of small pieces is."""
    route: Path = Feeder(path=kind).route()
    s = np.linspace(-route.before, route.length, 20001)
    points, angles = np.array([route.at(x)[0] for x in s]), np.array([route.at(x)[1] for x in s])
    steps = np.diff(points, axis=0)
    assert np.linalg.norm(steps, axis=1).sum() == pytest.approx(route.length + route.before, rel=1e-6)
    along = np.column_stack((np.cos(angles), np.sin(angles)))
    assert np.abs(steps / (s[1] - s[0]) - along[1:]).max() < 1e-3
    assert route.at(0.0) == ((pytest.approx(0.0), pytest.approx(0.0)), 0.0)
    ends = {"s_bend": 0.0, "turn": 0.7854}
    assert angles[-1] == pytest.approx(ends.get(kind, 0.0), abs=1e-12)


def test_an_s_bend_lifts_the_path_according_to_its_arcs() -> None:
    route = lay_out(0.1, [0.05, (0.04, 0.6), (0.04, -0.6), 0.2])
    (_, y), _ = route.at(route.length)
    assert y == pytest.approx(2.0 * 0.04 * (1.0 - np.cos(0.6)))
    arc = route.parts[1]
    assert isinstance(arc, Arc)
    (x, z), _ = arc.at(0.5 * arc.length)
    np.testing.assert_allclose(np.add(arc.center, np.multiply(arc.radius, arc.towards)), (x, z), atol=1e-15)


@pytest.mark.parametrize("kind", ["s_bend", "turn", "straight", "chute"])
def test_a_sheet_is_fed_along_every_path(kind: str) -> None:
    """Its leading edge is within the clearance of the path, as far on as its rollers have turned."""
    model = Feeder(path=kind, nips=2, mu_guide=0.0, **(SMALL | {"nx": 15}))
    found = mb.simulate(model, 0.12, interval=0.02)
    assert not found.failure
    assert found["lead.x"][-1] > found["lead.x"][0]
    fed = model.lead + 0.5 * 0.12
    (x, y), angle = model.route().at(fed)
    off = np.array([found["lead.x"][-1] - x, found["lead.y"][-1] - y])
    assert abs(off @ (np.cos(angle), np.sin(angle))) < 1e-3  # it may cut a corner
    assert (
        abs(off @ (-np.sin(angle), np.cos(angle))) < model.clearance + model.thickness
    )  # it sinks in by some half of that
    assert np.abs(found["nip[1].left.slip"]).max() < 0.01
    assert found["jam"].max() == 0.0
    assert found["sensor[1].left.covered"][[0, -1]] == pytest.approx([0.0, 1.0], abs=1e-9)
    assert found["nip[1].left.loaded"][-1] == pytest.approx(1.0)


def test_rollers_of_unlike_speed_turn_the_sheet() -> None:
    """Skew rate (v_right - v_left) / distance, with narrow nips, which do not resist turning."""
    free = {"path": "straight", "guides": False, "gravity_y": 0.0, "mu_guide": 0.0, "nips": 1}
    model = Feeder(**free, nip_width=0.004, speed=0.3, speed_difference=1.0 / 30.0, **SMALL)
    found = mb.simulate(model, 0.1, interval=0.02)
    assert found["sheet.skew"][-1] == pytest.approx(0.3 / 30.0 / 0.1 * 0.1, rel=0.01)


def test_a_sheet_that_meets_a_wall_jams_and_the_run_goes_on() -> None:
    """The rollers then slip at all their speed, and take the torque mu N R."""
    model = Feeder(path="straight", nips=1, lead=0.055, stop_at=0.06)
    found = mb.simulate(model, 0.04, interval=0.01)
    assert not found.failure
    assert found["jam"][0] == 0.0
    assert found["jam"][-1] == 1.0
    assert found["lead.x"][-1] == pytest.approx(model.stop_at, abs=2.0 * model.thickness)
    assert found["nip[1].left.slip"][-1] == pytest.approx(-model.speed, rel=0.01)
    assert found["roller[1].left.torque"][-1] == pytest.approx(0.5 * model.nip_force * model.radius, rel=0.01)
    assert found["stop.force.x"][-1] == pytest.approx(-model.nip_force, rel=0.2)  # the channel's friction takes some


def test_a_jam_lasts_when_the_rollers_stop() -> None:
    """With friction that sticks the thrust remains, where a sheet that creeps in its nip relaxes."""
    model = Feeder(path="straight", nips=1, lead=0.055, stop_at=0.06, deflection=1e-5)
    speed = [0.0, 0.04, 0.05, 1.0], [50.0, 50.0, 0.0, 0.0]  # s, rad/s
    inputs = {f"roller[1].{side}.speed": speed for side in ("left", "right")}
    found = mb.simulate(model, 0.3, interval=0.02, inputs=inputs)
    assert not found.failure
    thrust = found["stop.force.x"]
    assert thrust[2] == pytest.approx(-model.nip_force, rel=0.2)
    np.testing.assert_allclose(thrust[4:], thrust[4], rtol=1e-3)
    np.testing.assert_allclose(found["trail.x"][4:], found["trail.x"][4], atol=1e-7)


def test_two_speeds_pull_with_what_the_weaker_grip_has() -> None:
    free = {"guides": False, "gravity_y": 0.0, "mu_guide": 0.0, "path": "straight"}
    model = Feeder(**free, speed_ratio=1.05, lead=0.13, **(SMALL | {"spacing": 0.12}))
    found = mb.simulate(model, 0.03, interval=0.01)
    pulled = [found[f"nip[{line}].left.traction"][-1] for line in (1, 2)]
    assert pulled[0] == pytest.approx(-pulled[1], rel=0.05)  # nothing else is there to hold it


def test_the_drag_of_an_idler_is_the_traction_of_its_roller() -> None:
    """Of a sheet that nothing else holds, at a steady speed; without its mass an idler is no body."""
    free = {"guides": False, "gravity_y": 0.0, "path": "straight", "nips": 1, "lead": 0.1}
    model = Feeder(**free, **SMALL, idler_mass=0.002, idler_drag=2e-5)
    found = mb.simulate(model, 0.1, interval=0.05)
    rate = found["idler[1].left.speed"][-1]
    assert rate == pytest.approx(model.speed / model.radius, rel=2e-3)
    for side in ("left", "right"):
        assert -found[f"nip[1].{side}.traction"][-1] == pytest.approx(model.idler_drag * rate / model.radius, rel=1e-2)
    assert not any(body.name.startswith("idler") for body in Feeder(**free, **SMALL).build().bodies)


@pytest.mark.parametrize("path", ["straight", "s_bend"])
def test_pressure_of_all_cells_is_the_force_of_all_guides(path: str) -> None:
    """Without friction, times the area of a cell; pressing forces of a curved guide do not add up as vectors."""
    model = Feeder(path=path, mu_guide=0.0, field="pressure", **(SMALL | {"nx": 15}))
    found = mb.simulate(model, 0.1, interval=0.02)
    names = [name for row in model.arrays()["pressure"] for name in row]
    area = model.length / (model.nx - 1) * model.width / (model.nz - 1)
    pressing = area * np.sum([found[name] for name in names], axis=0)
    guides = {name.split(".force.")[0] for name in found.names if ".force." in name}
    forces = sum(np.linalg.norm([found[f"{name}.force.{axis}"] for axis in "xyz"], axis=0) for name in guides)
    assert pressing.max() > 0.01
    if path == "straight":
        np.testing.assert_allclose(pressing, forces, rtol=1e-9, atol=1e-12)
    else:
        assert np.all(pressing > forces - 1e-12)


def test_a_field_changes_no_motion_and_is_there_if_there_is_something_to_touch() -> None:
    models = [Feeder(path="straight", field=field, **SMALL) for field in ("none", "pressure")]
    plain, told = (mb.simulate(model, 0.02, interval=0.01) for model in models)
    assert [name for name in told.names if name not in plain.names] == [
        f"pressure[{i},{k}]" for i in range(6) for k in range(4)
    ]
    assert np.array_equal(plain["lead.y"], told["lead.y"])
    bare = Feeder(path="straight", guides=False, field="pressure", **SMALL)
    assert bare.arrays() == {}
    assert bare.build().surfaces[0].field == ""


def test_effects_that_are_off_are_absent() -> None:
    bare = Feeder(path="straight", guides=False, gravity_y=0.0, mu_guide=0.0, damping=0.0, membrane=False, **SMALL)
    full = Feeder(path="straight", **SMALL)
    surfaces = [{type(acting.load).__name__ for acting in model.build().others} for model in (bare, full)]
    assert surfaces == [{"RollerNip"}, {"RollerNip", "SurfaceContact"}]
    frictions = {
        mu: {
            acting.load.friction
            for acting in Feeder(path="straight", mu_guide=mu, **SMALL).build().others
            if isinstance(acting.load, SurfaceContact)
        }
        for mu in (0.0, 0.2)
    }
    assert frictions == {0.0: {0.0}, 0.2: {0.2}}
    assert set(Feeder.effects) >= {
        "gravity",
        "friction",
        "drag",
        "membrane",
        "damping",
        "guides",
        "misalignment",
        "idler_inertia",
        "curl",
    }


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"stop_at": 0.005}, "stop_at is 0.005 m; allowed: 0 (none), or more than lead, 0.01 m"),
        ({"stop_at": 9.0}, "stop_at is 9 m; allowed"),
        ({"nx": 7}, "bend_radius is 0.04 m; allowed with cells of 0.0495 m: 0.083"),
        ({"nips": 1}, "nips is 1; allowed with path 's_bend': 2 to 4"),
        ({"spacing": 0.06}, "spacing is 0.06 m; allowed: at least 0.07283 m"),
        ({"nip_distance": 0.01}, "nip_distance is 0.01 m; allowed: at least nip_width, 0.02"),
        ({"nip_distance": 0.3}, "nip_distance is 0.3 m; allowed: below 0.23 m"),
        ({"path": "straight", "spacing": 0.01}, "spacing is 0.01 m; allowed: twice radius at least, 0.02 m"),
        ({"idler_drag": 1e-5}, "idler_drag is 1e-05 N m s/rad; allowed where idler_mass is 0: 0"),
        ({"lead": 0.05}, "lead is 0.05 m; allowed: at most 0.0286 m"),
        ({"path": "straight", "lead": 0.2}, "lead is 0.2 m; allowed: at most half the sheet"),
        ({"mu_roller": -1.0}, "parameter 'mu_roller' of 'feeder' is -1.0; allowed"),
        ({"path": "loop"}, "allowed: 'straight', 's_bend', 'turn', 'chute'"),
    ],
)
def test_bad_input_is_refused_with_a_message(given: dict[str, Any], message: str) -> None:
    with pytest.raises(UserError) as refused:
        Feeder(**given).build()
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)


def test_explicit_solvers_are_refused_and_the_default_one_is_implicit() -> None:
    assert load_scene("feeder").settings.solver == "esdirk"
    with pytest.raises(UserError, match="nip"):
        Simulation(Feeder(path="straight", **SMALL), Settings(solver="adams"))


def test_scenes_can_be_built() -> None:
    assert {"skew", "jam", "two_speeds"} <= set(scenes(Feeder))
    for name in scenes(Feeder):
        load_scene(f"feeder/{name}").model.build()


def test_the_fmu_runs_as_the_model_does(tmp_path: File) -> None:
    model = Feeder(path="straight", nips=1, **SMALL)
    fmu = export(model, tmp_path / "feeder.fmu", native=False)
    rows = simulate_fmu(str(fmu), stop_time=0.02, output_interval=0.01)
    found = mb.simulate(model, 0.02, interval=0.01)
    assert rows["time"][-1] == pytest.approx(0.02)
    for name in ("lead.x", "sheet.skew", "roller[1].left.torque", "sensor[1].left.covered"):
        np.testing.assert_allclose(rows[name], found[name], atol=1e-12, err_msg=name)
