"""Event-driven integration of :mod:`absolute` with DOP853: stops, actions, and friction with exact stick."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations, product
from typing import Any

import numpy as np
from scipy.integrate import DOP853
from scipy.optimize import brentq

from . import absolute
from .absolute import BRISTLE, FREE, HELD, ROWS, SET_VALUED
from .drawn import Drawn
from .tree import arrays, measured, outputs, row_modes, row_of, start_state, with_inertias

PARTS, LONGEST_PART = 4, 0.01  # of a step, at whose ends guards are evaluated; in time units
# A body comes to rest if its last impacts at a stop are at shorter and shorter intervals, up to this many time units
REST_IMPACTS, REST_INTERVAL = 4, 3e-3
MAX_EVENTS, MAX_STEPS = 300, 100_000
STILL = 1e-9  # rate, of the units: a joint does not slide
SLACK = 1e-8  # of the breakaway force
HALVINGS = 30  # of an interval, until a point is found before a crossing
AHEAD = 1e-6  # time units, in which joints begin to slide


class Unresolved(Exception):
    """The reference found no unique continuation."""


@dataclass
class Motion:
    """What a reference returns: outputs (k, m) at times (k,), events by name and time, and why it ends early."""

    times: Any
    values: Any
    events: list[tuple[str, float]] = field(default_factory=list)
    switches: list[tuple[int, int, float]] = field(default_factory=list)  # friction, its new sign, time
    rests: float = np.inf  # time at which a body comes to rest at a stop
    ended: float = np.inf  # time at which an event ends the run
    drift: float = 0.0  # of the constraints, in the unit of length


class Run:
    """One motion of a mechanism.

    With ``kick`` each change of the direction of set-valued friction is followed by a random change of the rate, of the
    size sqrt(8 F d / m) that the energy of a bristle makes.
    """

    def __init__(self, d: Drawn, law: int, rtol: float = 1e-10, kick: Any = None) -> None:
        self.d, self.law, self.rtol, self.kick = d, law, rtol, kick
        tree = arrays(d)
        self.y = start_state(d, len(tree.rubbed))
        self.tree = with_inertias(d, tree, self.y)
        n = self.n = len(d.parts)
        self.modes, self.loads = row_modes(d), np.zeros(ROWS * n)
        for k, p in enumerate(d.parts):
            if p.load:
                self.loads[row_of(d, k)] = p.load.mean
        self.grips = np.array([f.normal.mean for f in d.frictions for _ in range(3 if self._is_ball(f) else 1)])
        self.signs = np.zeros(len(tree.rubbed))
        self.first = np.cumsum([0, *(3 if self._is_ball(f) else 1 for f in d.frictions)])
        self.t, self.steps = 0.0, 0
        L, T = d.length, d.time
        units = [d.unit(k) for k, p in enumerate(d.parts) for _ in range(len(p.rate))]
        self.scale = np.concatenate(
            (
                np.full(3 * n, L),
                np.ones(4 * n),
                np.full(3 * n, L / T),
                np.full(3 * n, 1.0 / T),
                units,
                np.ones(len(tree.rubbed)),
            )
        )
        self.rate_units = np.array([d.unit(int(r) // ROWS) / T for r in tree.rubbed])
        self.frozen = set[int]()  # rows of locked joints
        self.sensed = [(e, self._unit(e.sensor)) for e in d.events if e.sensor]

    def _is_ball(self, f: Any) -> bool:
        return self.d.parts[f.part].kind == "spherical"

    def _unit(self, s: Any) -> float:
        if s.kind == "position":
            return self.d.length
        return self.d.unit(s.part) / (self.d.time if s.kind == "rate" else 1.0)

    def rate(self, t: float, y: Any) -> Any:
        return absolute.evaluate(t, y, self.tree, self.modes, self.loads, self.grips, self.signs, self.law)[0]

    def normal(self, t: float) -> Any:
        """Normal forces (r,)."""
        pulse = self.tree.pulse
        return np.maximum(self.grips + pulse[:, 0] * np.sin(pulse[:, 1] * t + pulse[:, 2]), 0.0)

    # ---- guards ------------------------------------------------------------------------------------------------------

    def guards(self, t: float, y: Any) -> Any:
        """Values of all events with sensors, and for each friction what changes its sign where it becomes positive."""
        found = []
        known = absolute.kinematics(y, self.tree) if self.sensed or self.law == SET_VALUED else None
        for e, unit in self.sensed:
            found.append((measured(self.d, self.tree, y, e.sensor, known)[0] - e.value) / unit)
        if self.law == SET_VALUED and len(self.signs):
            _, holding = absolute.evaluate(t, y, self.tree, self.modes, self.loads, self.grips, self.signs, self.law)
            rates = known[3]
            limit = self.tree.friction[:, 1] * self.normal(t)
            for i, r in enumerate(self.tree.rubbed):
                if self.signs[i]:
                    found.append(-self.signs[i] * rates[r] / self.rate_units[i])
                elif self.modes[r] == HELD and r not in self.frozen:
                    found.append((abs(holding[r]) - limit[i]) / (limit[i] + 1e-12 * self.d.force))
                else:
                    found.append(-1.0)
        return np.array(found)

    # ---- jumps -------------------------------------------------------------------------------------------------------

    def jump(self, row: Any, change: float | None = None, impulse: float = 0.0, sticks: bool = False) -> None:
        """Apply an impulse along a row, or the one that changes its rate by an amount.

        Locked joints remain locked, and those that stick break away unless ``sticks``.
        """
        _, G, _, _, inverse = absolute.kinematics(self.y, self.tree)
        stuck = {int(r) for i, r in enumerate(self.tree.rubbed) if self.law == SET_VALUED and not self.signs[i]}
        held = [r for r in np.flatnonzero(self.modes) if sticks or r not in stuck or r in self.frozen]
        C = G[held]
        moved = inverse @ C.T
        admitted = inverse - moved @ np.linalg.solve(C @ moved, moved.T)
        if change is not None:
            impulse = change / (row @ admitted @ row)
        self._push(admitted @ row * impulse)

    def act(self, event: Any) -> None:
        for what, *rest in event.actions:
            if what == "bounce":
                _, rate, row = measured(self.d, self.tree, self.y, event.sensor)
                self.jump(row, change=-(1.0 + rest[0]) * rate)
            elif what == "load":
                self.loads[row_of(self.d, rest[0])] = rest[1]
            elif what == "grip":
                self.grips[self.first[rest[0]] : self.first[rest[0] + 1]] = rest[1]
            elif what == "impulse":
                self.jump(absolute.kinematics(self.y, self.tree)[1][row_of(self.d, rest[0])], impulse=rest[1])
            elif what == "stiffness":
                for k, p in enumerate(self.d.parts):
                    if p.elastic:
                        self.tree.elastic[row_of(self.d, k), 0] = rest[0] * p.elastic[0]
            elif what == "lock":
                r = row_of(self.d, rest[0])
                if r not in self.frozen:
                    _, G, _, rates, _ = absolute.kinematics(self.y, self.tree)
                    self.jump(G[r], change=-rates[r])
                    self.frozen.add(r)
                    self.modes[r] = HELD
            elif what == "release":
                r = row_of(self.d, rest[0])
                self.frozen.remove(r)
                self.modes[r] = FREE
            elif what == "end":
                self.ended = True

    # ---- modes of set-valued friction --------------------------------------------------------------------------------

    def decide(self, broken: int | None = None) -> None:
        """Choose which joints stick and which way the others slide, with as many that stick as possible.

        broken is the number of a friction whose joint breaks away now: it does not stick.
        """
        if self.law != SET_VALUED:
            return
        rates = absolute.kinematics(self.y, self.tree)[3]
        still = []
        for i, r in enumerate(self.tree.rubbed):
            if r in self.frozen:
                self.signs[i] = 0.0
            elif abs(rates[r]) > STILL * self.rate_units[i]:
                self.signs[i], self.modes[r] = np.sign(rates[r]), FREE
            else:
                still.append(i)
        way = 0.0
        if broken is not None:
            holding = absolute.evaluate(
                self.t, self.y, self.tree, self.modes, self.loads, self.grips, self.signs, self.law
            )[1]
            way = -np.sign(holding[self.tree.rubbed[broken]])
        for sticking, signs in choices([i for i in still if i != broken]):
            for i in still:
                self.signs[i] = way if i == broken else 0.0
                self.modes[self.tree.rubbed[i]] = FREE if i == broken else HELD
            for i, sign in signs.items():
                self.signs[i], self.modes[self.tree.rubbed[i]] = sign, FREE
            if self.consistent(sticking, signs):
                self._stop(list(sticking))
                return
        raise Unresolved(
            f"no mode of friction at t = {self.t / self.d.time:.6g} time units, {still=}, {broken=}, {way=}"
        )

    def consistent(self, sticking: tuple[int, ...], signs: dict[int, float]) -> bool:
        """Whether no joint that sticks is loaded too much, and those that start to slide do so the right way."""
        y_rate, holding = absolute.evaluate(
            self.t, self.y, self.tree, self.modes, self.loads, self.grips, self.signs, self.law
        )
        limit = self.tree.friction[:, 1] * self.normal(self.t)
        if any(abs(holding[self.tree.rubbed[i]]) > limit[i] * (1.0 + SLACK) for i in sticking):
            return False
        now, ahead = (absolute.kinematics(self.y + step * y_rate, self.tree)[3] for step in (0.0, AHEAD * self.d.time))
        change = (ahead - now)[self.tree.rubbed]
        return all(sign * change[i] > 0.0 for i, sign in signs.items())

    def _stop(self, sticking: list[int]) -> None:
        """Let joints that stick have no rate at all."""
        held, rows = np.flatnonzero(self.modes), self.tree.rubbed[sticking]
        _, G, _, rates, inverse = absolute.kinematics(self.y, self.tree)
        moved = inverse @ G[held].T
        self._push(moved @ np.linalg.solve(G[held] @ moved, np.where(np.isin(held, rows), -rates[held], 0.0)))

    def _push(self, jump: Any) -> None:
        """Change the velocities (6 n)."""
        dv, n = jump.reshape(self.n, 6), self.n
        self.y[7 * n : 10 * n] += dv[:, :3].ravel()
        self.y[10 * n : 13 * n] += dv[:, 3:].ravel()

    # ---- the run -----------------------------------------------------------------------------------------------------

    def motion(self, points: int) -> Motion:
        """Integrate until the stop time."""
        d = self.d
        times = np.linspace(0.0, d.stop_time, points)
        out = Motion(times, np.full((points, len(outputs(d, self.tree, self.y))), np.nan))
        out.values[0] = outputs(d, self.tree, self.y)
        sensed = [e for e in d.events if e.sensor]
        timed = sorted((e for e in d.events if not e.sensor), key=lambda e: e.value)
        self.ended = False
        self._switched(out, None)
        last: dict[str, list[float]] = {}
        hit: int | None = None  # stop that the last event was an impact at
        while self.t < d.stop_time and not self.ended:
            until = min(timed[0].value if timed else np.inf, d.stop_time)
            found = self._segment(until, sensed, out, hit)
            hit = None
            if found is None:
                if not timed or self.t < timed[0].value:
                    break
                event = timed.pop(0)
                out.events.append((event.name, self.t))
                self.act(event)
                self._switched(out, None)
                continue
            if found < len(sensed):
                event = sensed[found]
                out.events.append((event.name, self.t))
                if event.actions[0][0] == "bounce":
                    hits = last[event.name] = [*last.get(event.name, []), self.t][-REST_IMPACTS:]
                    intervals = np.diff(hits)
                    is_shrinking = len(hits) == REST_IMPACTS and np.all(np.diff(intervals) < 0.0)
                    hit = found
                    if is_shrinking and intervals[-1] < REST_INTERVAL * d.time:
                        out.rests = self.t
                        break
                self.act(event)
                self._switched(out, None)
            else:
                i = found - len(sensed)
                self._switched(out, i)
            if len(out.events) + len(out.switches) > MAX_EVENTS:
                raise Unresolved(f"more than {MAX_EVENTS} events")
        if self.ended:
            out.ended = self.t
        out.drift = self._drift()
        return out

    def _switched(self, out: Motion, i: int | None) -> None:
        """Choose the modes of friction after an event, or after friction i has changed."""
        if self.law != SET_VALUED:
            return
        before = self.signs.copy()
        sticks = i is not None and self.modes[self.tree.rubbed[i]] == HELD
        if i is not None and not sticks:  # its rate is zero now, and not a rounding error
            r = self.tree.rubbed[i]
            _, G, _, rates, _ = absolute.kinematics(self.y, self.tree)
            self.jump(G[r], change=-rates[r])
            self.signs[i] = 0.0
        self.decide(i if sticks else None)
        for k in np.flatnonzero(self.signs != before):
            out.switches.append((int(k), int(self.signs[k]), self.t))
            if self.kick is not None and self.signs[k]:
                f = self.tree.friction[k]
                rate = np.sqrt(8.0 * f[0] * self.normal(self.t)[k] * f[4] / f[5])
                G = absolute.kinematics(self.y, self.tree)[1]
                self.jump(
                    G[self.tree.rubbed[k]], change=self.signs[k] * rate * self.kick.uniform(0.5, 1.5), sticks=True
                )

    def _segment(self, until: float, sensed: list[Any], out: Motion, hit: int | None) -> int | None:
        """Integrate until a time or the first event, and return its number."""
        d = self.d
        start = self.guards(self.t, self.y)
        known = np.where(abs(start) > 1e-10, np.sign(start), 0.0)
        solver = DOP853(
            self.rate, self.t, self.y, until, rtol=self.rtol, atol=0.1 * self.rtol * self.scale, max_step=0.05 * d.time
        )
        ways = np.array([e.direction for e in sensed] + [1] * (len(start) - len(sensed)))
        if hit is not None:
            known[hit] = -ways[hit]
        if until - self.t < 1e-13 * d.stop_time:
            self.t = until
            return None
        while solver.status == "running":
            solver.step()
            self.steps += 1
            if solver.status == "failed" or self.steps > MAX_STEPS:
                raise Unresolved(f"no more than {self.steps} steps until t = {solver.t:.6g} s")
            path = solver.dense_output()
            before = solver.t_old
            parts = int(np.ceil(min((solver.t - solver.t_old) / (LONGEST_PART * d.time), PARTS)))
            for part in range(1, parts + 1):
                t = solver.t_old + (solver.t - solver.t_old) * part / parts
                values = self.guards(t, path(t))
                now = np.sign(values)
                fresh = (known == 0.0) & (abs(values) > 1e-10)
                crossed = (known * now < 0.0) & ((ways == 0) | (ways == now))
                begun = fresh & (now > 0.0) & (np.arange(len(ways)) >= len(sensed))
                if begun.any() and not crossed.any():
                    i = int(np.flatnonzero(begun)[0])
                    self._reach(self._root(i, before, t, path), path, out)
                    return i
                if crossed.any():
                    hits = []
                    for i in np.flatnonzero(crossed):
                        hits.append((self._root(int(i), before, t, path), int(i)))
                    hit, i = min(hits)
                    self._reach(hit, path, out)
                    return i
                known = np.where((known == 0.0) & ~fresh, 0.0, now)
                before = t
            self._record(path, solver.t_old, solver.t, out)
        self.t, self.y = solver.t, solver.y.copy()
        return None

    def _root(self, i: int, low: float, high: float, path: Any) -> float:
        def value(t: float) -> float:
            return float(self.guards(t, path(t))[i])

        first, beyond = low, value(high)
        for _ in range(HALVINGS):  # the quantity may be at the value, or beyond it by rounding, at the beginning
            if value(first) * beyond < 0.0:
                break
            first = low + 0.5 * ((first if first > low else high) - low)
        else:  # it passes the value right at the beginning
            return min(high, low + AHEAD * self.d.time)
        low = first
        return float(brentq(value, low, high, xtol=1e-15 * self.d.stop_time, rtol=1e-15))

    def _record(self, path: Any, low: float, high: float, out: Motion) -> None:
        for k in np.flatnonzero((out.times > low) & (out.times <= high)):
            out.values[k] = outputs(self.d, self.tree, path(out.times[k]))

    def _reach(self, t: float, path: Any, out: Motion) -> None:
        self._record(path, path.t_old, t, out)
        self.t, self.y = t, path(t)

    def _drift(self) -> float:
        """Largest distance of joints of which no translation is free, in lengths."""
        R, worst = absolute.kinematics(self.y, self.tree)[0], 0.0
        for k, p in enumerate(self.d.parts):
            Ra = np.eye(3) if p.parent < 0 else R[p.parent]
            a = np.zeros(3) if p.parent < 0 else self.y[3 * p.parent : 3 * p.parent + 3] - Ra @ self.tree.com[p.parent]
            apart = self.y[3 * k : 3 * k + 3] - R[k] @ p.com - a - Ra @ p.at
            if p.kind == "prismatic":
                n = Ra @ p.frame @ p.axes[0]
                apart = apart - n * (n @ apart)
            worst = max(worst, float(np.linalg.norm(apart)) / self.d.length)
        return worst


def choices(free: list[int]) -> Iterator[tuple[tuple[int, ...], dict[int, float]]]:
    """Yield which of some joints stick and the directions of the others, first all of them."""
    for count in range(len(free), -1, -1):
        for sticking in combinations(free, count):
            moving = [i for i in free if i not in sticking]
            for signs in product((1.0, -1.0), repeat=len(moving)):
                yield sticking, dict(zip(moving, signs, strict=True))


__all__ = ["BRISTLE", "SET_VALUED", "Motion", "Run", "Unresolved"]
