"""Section: a cross-section or an interface of a flexible body; :meth:`Mechanism.flexible_body` makes these.

Its coordinates are the amplitudes of the body's modes, shared by all sections of the body. The first one, the frame
itself, owns them. How it moves is in :mod:`mbfmu.mechanics.flexible.modal`; the recursions ask for the role of the body
and call no kernel of the joint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mbfmu.mechanics.flexible import Beam, FlexibleBody

from .base import Joint


@dataclass(frozen=True, kw_only=True)
class Section(Joint):
    """A cross-section of a beam, or an interface of a body of finite elements.

    Parameters
    ----------
    elastic
        The flexible body.
    key
        Place on the axis of a beam, m, or name of an interface.
    frame
        Body of the first section; None: this is the first, the frame, which does not move when the body deforms.
    """

    place = None

    elastic: Beam | FlexibleBody
    key: float | str = 0.0
    frame: Any = None

    @property
    def nq(self) -> int:  # type: ignore[override]
        """Amplitudes this section owns."""
        return self.elastic.modes if self.frame is None else 0

    @property
    def nv(self) -> int:  # type: ignore[override]
        """Amplitudes that move it."""
        return self.elastic.modes

    @property
    def coordinates(self) -> tuple[str, ...]:  # type: ignore[override]
        """Modes, counted from 1."""
        return tuple(str(k + 1) for k in range(self.elastic.modes))

    @property
    def units(self) -> tuple[str, ...]:  # type: ignore[override]
        """An amplitude is the largest displacement of its mode."""
        return ("m",) * self.elastic.modes
