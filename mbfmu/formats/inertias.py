"""Masses and inertias that MuJoCo refuses, although the mechanism is well defined.

MuJoCo requires of bodies with joints a mass and principal moments I1 <= I2 <= I3 above 1e-15 kg and kg m^2, with
I1 + I2 >= I3. Here masses may be small. In URDF files bodies without mass may be between joints, point masses and
slender rods (I1 = 0) are allowed, the inertia of bodies that do not move has no meaning, and numbers may be rounded.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mbfmu.util.errors import UserError

from .description import Matrix
from .losses import listed, printable

MAX_INERTIA_ERROR = 1e-3  # of I1 + I2 >= I3 relative to I3, by rounding
ROUNDING_SIZE = 1e-16  # m^2, of an impossible inertia relative to the mass: smaller ones are rounding errors
PLACEHOLDER = 1e-12  # kg and kg m^2, of bodies that MuJoCo would refuse
BOUNDARY = 1e-12  # of I1 + I2 - I3 relative to I3: below it, the rounding errors of MuJoCo decide


class ReplacedInertia(NamedTuple):
    """Mass (kg) and inertia that replace those of MuJoCo.

    Attributes
    ----------
    mass
        Mass, kg.
    inertia
        Inertia (3, 3) about the center of mass, body axes; None: that of MuJoCo divided by ``factor``.
    correction
        Change of the moment I3 of the file, relative to it.
    factor
        Factor by which the inertia is too large in MuJoCo.
    """

    mass: float
    inertia: Matrix | None = None
    correction: float = 0.0
    factor: float = 1.0


def has_own_inertia(mujoco: Any, spec: Any, body: Any) -> bool:
    """Whether MuJoCo uses the inertia of the file and not that of the shapes of the body."""
    always = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    return bool(body.explicitinertial) and not (always and list(body.geoms))


def changes_inertias(spec: Any) -> bool:
    """Whether the file requests that MuJoCo changes masses and inertias."""
    settings = spec.compiler
    return bool(settings.boundmass or settings.boundinertia or settings.settotalmass > 0.0 or settings.balanceinertia)


def replace_refused(what: str, kind: str, mujoco: Any, spec: Any) -> dict[str, ReplacedInertia]:
    """Replace masses and inertias that MuJoCo refuses; return those to be used instead, by the name of the body.

    Raises
    ------
    UserError
        Bodies of a URDF file that move have an impossible inertia, or move no mass.
    """
    found: dict[str, ReplacedInertia] = {}
    if changes_inertias(spec):
        return found
    impossible = []
    for body in spec.bodies:
        if body.name == "world" or body.mass < 0.0:
            continue
        if list(body.geoms) and not has_own_inertia(mujoco, spec, body):
            continue
        principal, axes = principal_moments(body)
        correction = 0.0
        if kind == "URDF" and does_not_move(body):
            principal = np.zeros(3)
        elif is_possible(principal):
            if body.name and list(body.joints) and min(body.mass, principal[0]) < PLACEHOLDER:
                found[body.name] = _enlarge(body, principal[0])
            continue
        elif kind == "MJCF":
            continue
        elif np.abs(principal).max() <= ROUNDING_SIZE * body.mass:
            principal = np.zeros(3)
        else:
            lacking = max(-2.0 * principal[0], principal[2] - principal[0] - principal[1])
            if lacking > MAX_INERTIA_ERROR * principal[2]:
                moments = ", ".join(f"{value:.3g}" for value in principal)
                impossible.append(f"{printable(body.name)} ({moments})")
                continue
            correction = max(0.0, lacking / principal[2])
            principal = np.maximum(principal, 0.0)
            principal[2] = min(principal[2], principal[0] + principal[1])
        found[body.name] = ReplacedInertia(float(body.mass), axes @ np.diag(principal) @ axes.T, correction)
        body.fullinertia, body.explicitinertial = np.full(6, np.nan), True
        least = PLACEHOLDER if list(body.joints) else 0.0
        body.mass, body.inertia = max(body.mass, least), np.full(3, max(float(principal.mean()), least))
    if impossible:
        raise UserError(
            f"{what}: inertias of bodies are impossible ({listed(impossible)}, principal moments in kg m^2); allowed: "
            "no negative moment, and none larger than the sum of the two others. Correct the file"
        )
    if kind == "URDF":
        check_moved_mass(what, spec, found)
    return found


def is_possible(principal: Matrix) -> bool:
    """Whether MuJoCo accepts principal moments (3,) in rising order: they are positive and those of a body."""
    return bool(principal[0] > 0.0 and principal[0] + principal[1] - principal[2] > BOUNDARY * principal[2])


def principal_moments(body: Any) -> tuple[Matrix, Matrix]:
    """Return the principal moments (3,) of a body in rising order, and their axes as columns (3, 3) in its frame."""
    full, frame = np.array(body.fullinertia, float), rotation_of(body.iquat)
    if not np.all(np.isfinite(full)):
        order = np.argsort(body.inertia)
        return np.array(body.inertia, float)[order], frame[:, order]
    xx, yy, zz, xy, xz, yz = full
    moments, axes = np.linalg.eigh(np.array(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))))
    return moments, frame @ axes


def check_moved_mass(what: str, spec: Any, replaced: dict[str, ReplacedInertia]) -> None:
    """Raise UserError if a joint moves only bodies without mass and inertia."""
    carrying = set()
    for body in spec.bodies:
        own = replaced.get(body.name)
        above = body if own is None or own.mass or own.inertia is None or np.any(own.inertia) else None
        while above is not None and above.name not in carrying:
            carrying.add(above.name)
            above = above.parent
    without = [printable(body.name) for body in spec.bodies if list(body.joints) and body.name not in carrying]
    if without:
        raise UserError(
            f"{what}: joints move no mass (those of {listed(without)}); give these bodies a mass and an inertia "
            "(<inertial>), or fix them to their parents"
        )


def rotation_of(quaternion: Any) -> Matrix:
    """Return the rotation matrix of a quaternion, scalar first, of any length."""
    w, *vector = np.asarray(quaternion, float) / np.linalg.norm(quaternion)
    x = np.asarray(vector)
    turned: Matrix = (w * w - x @ x) * np.eye(3) + 2.0 * np.outer(x, x) + 2.0 * w * np.cross(np.eye(3), x)
    return turned


def does_not_move(body: Any) -> bool:
    """Whether no joint is between a body and the ground."""
    while body is not None and body.name != "world":
        if list(body.joints):
            return False
        body = body.parent
    return True


def _enlarge(body: Any, smallest: float) -> ReplacedInertia:
    """Enlarge mass and inertia of a body to what MuJoCo accepts; return what they are."""
    factor, mass = max(1.0, PLACEHOLDER / smallest), float(body.mass)
    body.mass = max(mass, PLACEHOLDER)
    body.inertia, body.fullinertia = factor * np.array(body.inertia), factor * np.array(body.fullinertia)
    return ReplacedInertia(mass, factor=factor)
