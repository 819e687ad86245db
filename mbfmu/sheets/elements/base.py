"""What plate and shell elements have in common: four corners, limits by their bending angle, damping and drag."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar

from mbfmu.mechanics.loads import Drag, Load

from .bending import describe_limit, monitor
from .corners import check_corners

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.load_groups import LoadGroup


class PlaneElement(Load):
    """Base of elements between four bodies at the corners of a cell; subclasses declare the two fields.

    Attributes
    ----------
    edge_angle
        Kernel for the angle between an edge and its direction by the orientations of the bodies, rad.
    damping
        Damping time of the material, s.
    drag
        Density of the air times drag coefficient, kg/m^3.
    """

    monitor = monitor
    n_bodies = 4
    title = "a plate"
    edge_angle: ClassVar[Any]

    damping: float
    drag: float

    @property
    def area(self) -> float:
        """Area, m^2."""
        raise NotImplementedError

    @property
    def is_nonconservative(self) -> bool:
        """Whether its material is damped."""
        return self.damping > 0.0

    def companions(self) -> tuple[Load, ...]:
        """Return the drag of the air."""
        return (Drag(density=self.drag, area=self.area),) if self.drag > 0.0 else ()

    @classmethod
    def check_positions(cls, group: LoadGroup) -> None:
        """See the base: the bodies are at the corners."""
        check_corners(group, cls.edge_angle)

    @classmethod
    def describe_limit(cls, group: LoadGroup, ratio: float, when: str = "") -> str:
        """See the base."""
        return describe_limit(group, ratio, when)
