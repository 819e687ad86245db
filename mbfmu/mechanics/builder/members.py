"""The bodies of a mechanism and the names that are taken."""

from __future__ import annotations

from collections.abc import Collection

from mbfmu.mechanics.joints import Weld
from mbfmu.util.errors import UserError

from .bodies import Body


class Members:
    """Base of :class:`.Mechanism`: bodies by number and by name, the ground first.

    Attributes
    ----------
    compiled
        Nothing can be added any more.
    """

    def __init__(self) -> None:
        self.ground = Body("ground", 0, 0, Weld())
        self.bodies: list[Body] = [self.ground]
        self.compiled = False
        self._bodies_named = {"ground": self.ground}

    def _append(self, body: Body) -> Body:
        self.bodies.append(body)
        self._bodies_named[body.name] = body
        return body

    def _member(self, body: Body, role: str) -> None:
        if not isinstance(body, Body) or body.index >= len(self.bodies) or self.bodies[body.index] is not body:
            raise UserError(
                f"{role} is {getattr(body, 'name', body)!r}, which is not a body of this mechanism; allowed: "
                "its ground, and what its method body() has returned"
            )

    def _new_name(self, what: str, name: str, taken: Collection[str]) -> None:
        if self.compiled:
            raise UserError(f"{what} {name!r} cannot be added: the mechanism is compiled already; build a new one")
        if not isinstance(name, str) or not name.isprintable() or not name or name in taken:
            raise UserError(
                f"{what} is named {name!r}; allowed: printable text, not empty, that is no other {what}'s name"
            )
