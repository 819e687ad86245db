"""A steady state and what is known of it: its outputs, its linearized motion, whether that stays near.

Stability is that of the exactly linearized motion.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism
from mbfmu.modeling.model import Model
from mbfmu.steady.linear import Mode, StateSpace, modes_as_text
from mbfmu.steady.modes import LISTED_MODES, ModeShapes, find_spectrum, shapes_of
from mbfmu.steady.periodic import PeriodicLinearization
from mbfmu.steady.rigid_body_modes import describe_motions, free_motions
from mbfmu.steady.sampled import explain_no_modes, multipliers, stability_of
from mbfmu.util.diagnostics import Diagnosed, Diagnostic, render
from mbfmu.util.errors import EquilibriumError
from mbfmu.util.text_table import format_table
from solvers.statics.spectrum import Spectrum, Stability, spectrum_of_states
from solvers.system import Array

MAX_PRINTED_MODES = 60  # modes that are printed


@dataclass(frozen=True, kw_only=True)
class Equilibrium(Diagnosed):
    """A steady state.

    Attributes
    ----------
    model, compiled
        Model, and its compiled mechanism with the drives and inputs of the steady state.
    q, v, lam
        Positions (nq,), velocities (n,) and multipliers (m,).
    rows
        Numbers of the constraint equations that are independent in the steady state.
    iterations
        Number of factorized Jacobians of Newton's method.
    residual
        Largest unbalanced force or moment, N or N m.
    solve_time
        Time of the solution, s, without building the mechanism.
    found_from
        Start of Newton's method, as text.
    continued
        Whether Newton's method alone failed; the state may then be far from the start.
    diagnostics
        Notes on differences from the model's start and on periodic coefficients, and warnings about forces without
        direction and about a mesh that is too coarse for the state.
    periodic
        Whether the linearized motion changes with the positions of the drives.
    cyclic
        Which coordinates (n,) the equations of motion do not depend on; they keep their rates.
    """

    model: Model
    compiled: CompiledMechanism
    q: Array
    v: Array
    lam: Array
    rows: NDArray[np.int64]
    iterations: int
    residual: float
    solve_time: float
    found_from: str
    continued: bool = False
    diagnostics: tuple[Diagnostic, ...] = ()
    periodic: bool = False
    cyclic: NDArray[np.bool_]

    @cached_property
    def outputs(self) -> dict[str, float]:
        """The model's outputs in the steady state."""
        out = np.zeros(len(self.compiled.outputs))
        self.compiled.observe(0.0, self.q, self.v, np.zeros(self.compiled.system.n), self.lam, out)
        return {v.name: float(x) for v, x in zip(self.compiled.outputs, out, strict=True)}

    @property
    def is_sampled(self) -> bool:
        """Whether the model has sampled blocks."""
        return bool(self.compiled.mechanism.sampled)

    @cached_property
    def multipliers(self) -> Array | None:
        """Eigenvalues (k,) of the map of small deviations over a common period of all sampled blocks; None: the model
        has no sampled blocks, their periods have no common multiple, or the linearized motion is periodic.
        """
        return None if self._sample_map is None else self._sample_map[0]

    @cached_property
    def _sample_map(self) -> tuple[Array, Array] | None:
        """The multipliers, and what rounding leaves open of them."""
        if not self.is_sampled or self.periodic:
            return None
        linear, blocks = self._linearized, self.compiled.mechanism.sampled
        return multipliers(blocks, linear.free, list(linear.states[: len(linear.free)]))

    @cached_property
    def state_space(self) -> StateSpace:
        """The linearized motion; EquilibriumError for a large tree, which has no dense matrices, and for a model with
        sampled blocks.
        """
        if self.is_sampled:
            raise explain_no_modes(self.model.name)
        return self._linearized

    @cached_property
    def _linearized(self) -> StateSpace:
        """The linearized motion, with the difference quotients of sampled blocks as their rates."""
        if not self.compiled.system.has_matrices:
            raise EquilibriumError(
                f"model {self.model.name!r} has {self.compiled.system.n} coordinates: too many for state matrices; "
                "its lowest modes are known (mbfmu modes)"
            )
        return PeriodicLinearization(self.compiled, self.q, self.v, self.lam, self.rows).state_space()

    @cached_property
    def spectrum(self) -> Spectrum:
        """Eigenvalues of the linearized motion, with what rounding leaves open of them; where its coefficients are
        periodic, its characteristic exponents.
        """
        if self.is_sampled:
            raise explain_no_modes(self.model.name)
        if self.periodic:
            return PeriodicLinearization(self.compiled, self.q, self.v, self.lam, self.rows).spectrum()
        if len(self.compiled.system.nonholonomic) and self.v.any():  # constraints of the rates change with positions
            linear = self.state_space
            return spectrum_of_states(linear.free, linear.coordinates, linear.n_moving)
        return find_spectrum(self.compiled, self.q, self.v, self.lam)

    @cached_property
    def modes(self) -> list[Mode]:
        """Eigenvalues of the linearized motion, slowest first; the lowest few of a very large tree, see
        :mod:`mbfmu.steady.modes`.
        """
        return [shape.mode for shape in shapes_of(self.spectrum)]

    @property
    def known_modes(self) -> list[Mode]:
        """The modes; empty if they were not found because the coefficients are periodic, and with sampled blocks."""
        return [] if self.is_sampled or self.stability is Stability.UNKNOWN else self.modes

    def shapes(self, count: int) -> ModeShapes:
        """Return the slowest natural modes with their shapes in the coordinates; ``print`` writes a table.

        Parameters
        ----------
        count
            Largest number of modes.
        """
        enough = self.spectrum.complete or count <= LISTED_MODES
        found = self.spectrum if enough else find_spectrum(self.compiled, self.q, self.v, self.lam, count)
        return ModeShapes(shapes_of(found)[:count])

    @property
    def stability(self) -> Stability:
        """Stability of the linearized motion, a text: ``stable`` (it decays), ``undamped`` (some of it oscillates
        undamped), ``neutral`` (some of it drifts), ``unstable``, or ``unknown`` if its coefficients are periodic and
        ``diagnostics`` give the reason why it was not found. With sampled blocks it is that of the motion with samples.
        """
        if self.is_sampled:
            return Stability.UNKNOWN if self._sample_map is None else stability_of(*self._sample_map)
        try:
            return self.spectrum.stability
        except EquilibriumError:
            if not self.periodic:
                raise
            return Stability.UNKNOWN

    @cached_property
    def free(self) -> str:
        """Message on the motions of a large model without resistance; empty if there are none."""
        if self.stability is not Stability.NEUTRAL or self.compiled.system.has_matrices:
            return ""
        return describe_motions(self.compiled, self.q, free_motions(self.compiled, self.q, self.lam))

    def __str__(self) -> str:
        """Return outputs with their units, stability and modes as tables."""
        units = {v.name: v.unit for v in self.compiled.outputs}
        rows = [(name, f"{x:.12g}", units[name]) for name, x in self.outputs.items()]
        lines = [
            f"{self.model.name}: steady state found from {self.found_from} in {self.effort}",
            *render(d for d in self.diagnostics if d.severity == "note"),
            format_table(("output", "value", "unit"), rows),
            "",
            self.stability.text + (f"; no force resists {self.free}" if self.free else ""),
        ]
        modes = self.known_modes
        lines += [modes_as_text(modes[:MAX_PRINTED_MODES])] if modes else []
        if len(modes) > MAX_PRINTED_MODES:
            lines.append(
                f"{len(modes) - MAX_PRINTED_MODES} modes of higher frequency not shown; as_dict() and --json have all"
            )
        if warnings := render(d for d in self.diagnostics if d.severity != "note"):
            lines += ["", *warnings]
        return "\n".join(lines)

    @property
    def effort(self) -> str:
        """Cost of the search, as text."""
        return (
            f"{self.iterations} Newton iterations ({1e3 * self.solve_time:.2f} ms), "
            f"residual {self.residual:.1e} N or N m"
        )

    def positions(self) -> dict[str, float]:
        """Return the coordinates by name; those of an orientation as its quaternion."""
        names = position_names(self.compiled)
        return dict(zip(names, map(float, self.q), strict=True))

    def states(self) -> dict[str, float]:
        """Return the values of first-order states by name."""
        first = self.compiled.system.n_velocities
        names = self.compiled.system.coordinate_names[first:]
        return dict(zip(names, map(float, self.v[first:]), strict=True))

    def as_dict(self) -> dict[str, Any]:
        """Return all results as a dictionary for JSON."""
        return {
            "model": self.model.name,
            "parameters": {p.name: getattr(self.model, p.name) for p in self.model.parameters()},
            "found_from": self.found_from,
            "diagnostics": [asdict(diagnostic) for diagnostic in self.diagnostics],
            "periodic_coefficients": self.periodic,
            "iterations": self.iterations,
            "residual": self.residual,
            "solve_time_s": self.solve_time,
            "positions": self.positions(),
            "states": self.states(),
            "outputs": self.outputs,
            "constraint_forces": dict(zip(self.compiled.system.constraint_names, map(float, self.lam), strict=True)),
            "stability": self.stability,
            "free_motions": self.free,
            "stable": self.stability.stays,
            "eigenvalues": [
                {
                    "real": m.eigenvalue.real,
                    "imag": m.eigenvalue.imag,
                    "frequency_hz": m.frequency / (2.0 * np.pi),
                    "natural_frequency_hz": m.natural_frequency / (2.0 * np.pi),
                    "damping_ratio": m.damping_ratio,
                }
                for m in self.known_modes
            ],
        }


def position_names(compiled: CompiledMechanism) -> list[str]:
    """Return a name for each position (nq,): the coordinate's, or ``body.e0`` ... for a quaternion."""
    names: list[str] = []
    for body in compiled.mechanism.bodies:
        joint = body.joint
        if joint.drive is None:
            plain = joint.nq - 4 * joint.quaternion
            names += [f"{body.name}.{c}" if c else body.name for c in joint.coordinates[:plain]]
            names += [f"{body.name}.e{k}" for k in range(4 * joint.quaternion)]
    return names
