"""Contact of a cell of a sheet with a rigid surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mbfmu.mechanics.kind import Attachment
from mbfmu.mechanics.loads.base import Load

from .bristles import history_size
from .initial_contact import check_surface_contacts, undersampled_edges
from .passing import longest_step
from .patch import bezier_lever
from .scratch import CONTACT_REASON, CONTACT_SCRATCH
from .surface_force import SurfaceContactRecord, apply, clearance, potential, tangent
from .surfaces import Surface

if TYPE_CHECKING:
    from mbfmu.mechanics.arrays.load_groups import LoadGroup


@dataclass(frozen=True, kw_only=True)
class SurfaceContact(Load):
    """One cell of a sheet against a surface; :func:`.add_contact` makes those of a sheet."""

    record = SurfaceContactRecord
    apply = apply
    potential = potential
    tangent = tangent
    clearance = clearance
    longest_step = longest_step
    symmetric = False  # friction
    nonsmooth_reason = CONTACT_REASON

    surface: Surface
    sides: tuple[float, float]
    ends: tuple[tuple[bool, bool], tuple[bool, bool]]
    thickness: float
    samples: tuple[int, int]
    stiffness: float
    depth: float
    damping: float
    friction: float
    friction_velocity: float
    deflection: float = 0.0
    static: float = 0.0
    stribeck: float = np.inf

    @property
    def slip_scale(self) -> float:
        """Slip at which friction turns over, m/s."""
        return self.friction_velocity if self.friction > 0.0 else np.inf

    @property
    def levers(self) -> tuple[float, ...]:
        """Of the nodes."""
        return (bezier_lever(self.sides),) * 4

    @property
    def is_nonconservative(self) -> bool:
        """It does: by friction and by what is lost as the sheet leaves."""
        return True

    @classmethod
    def check_start(cls, group: LoadGroup) -> list[str]:
        """See the base: a sheet does not penetrate a surface, and no edge is so narrow that it is not felt."""
        check_surface_contacts(group)
        return undersampled_edges(group)

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the nodes, the surface and the law; the last of its bodies has the surface."""
        record["node"], record["body"] = site.bodies[:4], site.bodies[4]
        record["surface"], record["scratch"] = site.part(self.surface), site.scratch(CONTACT_SCRATCH)
        record["convex"] = self.surface.convex
        record["samples"], record["ends"] = self.samples, self.ends
        record["a"], record["b"] = self.sides
        record["half"], record["passage"] = 0.5 * self.thickness, self.surface.passing_depth()
        law = "stiffness", "depth", "damping", "friction", "friction_velocity", "deflection", "static", "stribeck"
        for key in law:
            record[key] = getattr(self, key)
        if self.deflection > 0.0:
            record["history"] = site.history(history_size(self.samples))
