"""Handle of a flexible body that the builder returns, with its sections and sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from mbfmu.mechanics.checks import one_of
from mbfmu.mechanics.flexible import Beam, FlexibleBody
from mbfmu.mechanics.flexible.recovery import STRESS_COMPONENTS, VON_MISES
from mbfmu.mechanics.joints import Section
from mbfmu.mechanics.sensors import BendingMoment, Deflection, NodeStress, Sensor, VonMisesStress
from mbfmu.util.errors import UserError

from .bodies import Body

if TYPE_CHECKING:
    from .mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class FlexibleHandle:
    """Flexible body of a mechanism, as returned by :meth:`Mechanism.flexible_body`.

    Attributes
    ----------
    name, index
        Name, and number among the flexible bodies.
    elastic
        Beam, or body of finite elements, with its modes.
    body
        Frame of the flexible body as a body of the tree without mass, connected to the parent by the joint.
    modes
        First section: coordinate k is the amplitude of mode k + 1, m.
    """

    name: str
    index: int
    elastic: Beam | FlexibleBody
    body: Body
    modes: Body
    _mechanism: Mechanism
    _sections: dict[float | str, Body] = field(init=False, repr=False, default_factory=dict)

    def section(self, x: float | str) -> Body:
        """Return a cross-section or an interface as a body, for joints, cut joints, loads and outputs.

        Parameters
        ----------
        x
            Position along a beam from its origin, m, or name of an interface of a body of finite elements.

        Returns
        -------
        Body
            Body without mass, whose frame moves and rotates with the cross-section or the interface.
        """
        if x not in self._sections:
            self._sections[x] = self._new_section(x)
        return self._sections[x]

    def sections(self) -> list[Body]:
        """Return the sections that are in use, in the order of their creation, without the frame."""
        return [body for body in self._sections.values() if body is not self.body]

    def _new_section(self, x: float | str) -> Body:
        if isinstance(self.elastic, FlexibleBody):
            self.elastic.interface(x)
            if x == self.elastic.frame:
                return self.body
            joint, label = Section(elastic=self.elastic, key=x, frame=self.modes), str(x)
        else:
            self.elastic.shape(x)  # type: ignore[arg-type]
            joint, label = Section(elastic=self.elastic, key=float(x), frame=self.modes), f"{x:g}"
        return self._mechanism.add_section(f"{self.name}[{label}]", self.modes, joint)

    def deflection(self, x: float) -> Sensor:
        """Deflection of a beam along y at x, m.

        Parameters
        ----------
        x
            Position along the beam from its origin, m.
        """
        self._require_beam("deflection")
        return Deflection(unit="m", item=self.section(x))

    def moment(self, x: float) -> Sensor:
        """Bending moment E I w'' of a beam about z, N m; without the damping of the material.

        Parameters
        ----------
        x
            Position along the beam from its origin, m.
        """
        self._require_beam("moment")
        return BendingMoment(unit="N.m", item=self.section(x))

    def stress(self, node: int | Sequence[float], component: str = VON_MISES) -> Sensor:
        """Stress at a node of a body of finite elements, Pa, in the frame of the body.

        Parameters
        ----------
        node
            Number of the node, from 0, or a position (3,) in the frame of the body, m, whose nearest node is used.
        component
            ``"xx"``, ``"yy"``, ``"zz"``, ``"xy"``, ``"xz"``, ``"yz"``, or ``"von Mises"``: the equivalent stress.

        Raises
        ------
        UserError
            The body is a beam or was made without stresses, or has no such node.
        """
        if not isinstance(self.elastic, FlexibleBody):
            raise UserError(
                f"stress of flexible body {self.name!r}: it is a Beam; allowed for bodies of FlexibleBody.from_mesh. "
                "The bending moment is moment(x)"
            )
        one_of(f"component of the stress in {self.name!r}", component, (*STRESS_COMPONENTS, VON_MISES))
        weights = self.elastic.stress_weights(node)
        if component == VON_MISES:
            return VonMisesStress(unit="Pa", item=self.modes, weights=weights)
        return NodeStress(unit="Pa", item=self.modes, component=STRESS_COMPONENTS.index(component), weights=weights)

    def _require_beam(self, what: str) -> None:
        if isinstance(self.elastic, FlexibleBody):
            raise UserError(
                f"{what} of flexible body {self.name!r}: it is a body of finite elements; allowed for a Beam. "
                "Displacements of an interface are Mechanism.relative_position(handle.section(name), handle.body, axis)"
            )
