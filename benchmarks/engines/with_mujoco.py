"""MuJoCo: relative coordinates, loops by soft equality constraints, equal steps by `rollout`."""

from __future__ import annotations

from collections.abc import Iterator
from math import pi

import mujoco
import numpy as np
from mujoco import rollout

from .problems import FOURBAR, GOVERNOR, GRAVITY, LARGE_INERTIA, PENDULUM, TIMES, Array, Run

NAME = f"MuJoCo {mujoco.__version__}"
SETTINGS = (
    "integrators `RK4` and `implicitfast`, steps of 10 ms divided by 1 to 64; equality constraints with `solref` = "
    "(2 steps, 1) and `solimp` = (0.9999, 0.9999, 0.001), Newton solver with 100 iterations, tolerance 1e-14; a hub of "
    "1e9 kg m^2 in place of a prescribed speed"
)
TINY = 1e-9  # kg and kg m^2, of a body without mass
Model = tuple[str, list[float], list[float], int]


def bar(name: str, at: str, mass: float, size: float, inside: str = "") -> str:
    """Return a uniform bar with a hinge about z."""
    across = mass * size * size / 12.0
    inertia = f'<inertial mass="{mass}" pos="{0.5 * size} 0 0" diaginertia="{TINY} {across} {across}"/>'
    return f'<body name="{name}" pos="{at}"><joint name="{name}" axis="0 0 1"/>{inertia}{inside}</body>'


def bodies(problem: str, loops: int) -> Model:
    """Return bodies and constraints as text, positions and velocities at the start, and the number of the angle."""
    hub = f'<inertial mass="1" pos="0 0 0" diaginertia="{LARGE_INERTIA} {LARGE_INERTIA} {LARGE_INERTIA}"/>'
    if problem == "fourbar":
        p = FOURBAR
        coupler = bar("coupler", f"{p.crank_length} 0 0", p.coupler_mass, p.coupler_length)
        crank = bar("crank", "0 0 0", p.crank_mass, p.crank_length, coupler)
        rocker = bar("rocker", f"{p.ground_length} 0 0", p.rocker_mass, p.rocker_length)
        sites = f'<connect body1="coupler" body2="rocker" anchor="{p.coupler_length} 0 0"/>'
        angle, rate = p.start_angle, p.start_rate
        return f"{crank}{rocker}|{sites}|{p.gravity}", [angle, -angle, angle], [rate, -rate, rate], 0
    if problem == "governor":
        g, tendons, text = GOVERNOR, "", ""
        for k, side in enumerate((-1.0, 1.0)):
            ball = f'diaginertia="{g.ball_inertia} {g.ball_inertia} {g.ball_inertia}"'
            inertial = f'<inertial mass="{g.ball_mass}" pos="{side * g.arm_length} 0 0" {ball}/>'
            site = f'<site name="pin{k}" pos="{side * g.rod_position} 0 0"/>'
            text += f'<body name="arm{k}"><joint axis="0 0 {-side}"/>{inertial}{site}</body>'
            tendons += f'<spatial name="rod{k}"><site site="pin{k}"/><site site="collar"/></spatial>'
        spring = f'stiffness="{g.stiffness}" springref="{g.free_length}"'
        J = g.collar_inertia
        inertial = f'<inertial mass="{g.collar_mass}" pos="0 0 0" diaginertia="{0.6 * J} {J} {0.6 * J}"/>'
        text += (
            f'<body name="collar"><joint type="slide" axis="0 -1 0" {spring}/>{inertial}<site name="collar"/></body>'
        )
        text = f'<body name="hub"><joint axis="0 1 0"/>{hub}{text}</body>'
        equal = "".join(f'<tendon tendon1="rod{k}"/>' for k in range(2))
        start = [0.0, g.start_angle, g.start_angle, g.below_pivot(g.start_angle)]
        return f"{text}|{equal}|0|{tendons}", start, [g.spindle_speed, 0.0, 0.0, 0.0], 1
    if problem == "pendulum":
        s = PENDULUM
        point = f'diaginertia="{TINY} {TINY} {TINY}"'
        spring = f'stiffness="{s.slider_stiffness}" springref="{s.free_length}"'
        slider = f'<joint type="slide" axis="1 0 0" {spring}/><inertial mass="{s.slider_mass}" pos="0 0 0" {point}/>'
        swing = f'<joint axis="0 0 1" stiffness="{s.swing_stiffness}"/><inertial mass="{TINY}" pos="0 0 0" {point}/>'
        rod = f'<body pos="{s.crank_length} 0 0">{swing}<body>{slider}</body></body>'
        text = f'<body name="hub"><joint axis="0 0 1"/>{hub}{rod}</body>'
        return f"{text}||0", [0.0, s.start_angle, s.start_distance], [s.drive_speed, 0.0, 0.0], 1
    text, equal, q = "", "", list[float]()
    for i in range(loops + 1):
        beam = bar(f"beam{i}", "1 0 0", 1.0, 1.0) if i < loops else ""
        text += bar(f"column{i}", f"{i} 0 0", 1.0, 1.0, beam)
        q += [0.5 * pi, -0.5 * pi]
        if i < loops:
            equal += f'<connect body1="beam{i}" body2="column{i + 1}" anchor="1 0 0"/>'
    return f"{text}|{equal}|{GRAVITY}", q[:-1], ([-1.0, 1.0] * (loops + 1))[:-1], 0


def load(problem: str, loops: int, integrator: str, step: float) -> tuple[mujoco.MjModel, Array, int]:
    """Return the model, its state at the start, and the place of the angle in states."""
    text, q, v, angle = bodies(problem, loops)
    tree, equal, gravity, *tendons = text.split("|")
    soft = f'solref="{2.0 * step} 1" solimp="0.9999 0.9999 0.001"'
    option = f'timestep="{step}" integrator="{integrator}" gravity="0 -{gravity} 0" tolerance="1e-14" iterations="100"'
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option {option}><flag contact="disable"/></option>'
        f"<default><equality {soft}/></default><worldbody>{tree}</worldbody>"
        f"<tendon>{''.join(tendons)}</tendon><equality>{equal}</equality></mujoco>"
    )
    data = mujoco.MjData(model)
    if problem == "governor":
        data.qpos[:] = q
        mujoco.mj_forward(model, data)
        model.tendon_length0[:] = data.ten_length
    if "connect" in equal:  # anchors in the second body, which the compiler computes in the reference position
        p = FOURBAR
        ends = [(p.rocker_length, 0.0, 0.0)] if problem == "fourbar" else [(1.0, 0.0, 0.0)] * loops
        model.eq_data[:, 3:6] = ends
    data.qpos[:], data.qvel[:], data.time = q, v, 0.0
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(model, kind))
    mujoco.mj_getState(model, data, state, kind)
    return model, state, 1 + angle


def runs(problem: str, loops: int) -> Iterator[tuple[str, Run]]:
    """Yield a setting and what runs the problem with it."""
    for integrator in ("RK4", "implicitfast"):
        for parts in (1, 2, 4, 8, 16, 32, 64):
            model, state, place = load(problem, loops, integrator, float(TIMES[1]) / parts)
            data = mujoco.MjData(model)

            def run(
                model: mujoco.MjModel = model,
                data: mujoco.MjData = data,
                state: Array = state,
                place: int = place,
                parts: int = parts,
            ) -> Array:
                found, _ = rollout.rollout(model, data, state[np.newaxis], nstep=parts * (len(TIMES) - 1))
                return np.concatenate((state[place : place + 1], found[0, parts - 1 :: parts, place]))

            yield f"{integrator} {parts}", run
