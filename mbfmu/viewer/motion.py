"""A recorded motion: where every body was at every output time, and what the bodies look like. A file ``.npz``."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbfmu.mechanics import CompiledMechanism, Mechanism
from mbfmu.mechanics.builder.bodies import Body
from mbfmu.mechanics.numbers import positive
from mbfmu.session.simulation import Simulation
from mbfmu.util.array_files import read_arrays, write_arrays
from mbfmu.util.errors import UserError

from .drawing import bodies_with_hulls, check_fields, draw
from .forces import Arrow, Source, read, shown, sources
from .hulls import Hull
from .picture import Bar, Picture, as_tuples

Array = NDArray[np.float64]
Single = NDArray[np.float32]

MOTION_FORMAT = 4
MOTION_ARRAYS = ("times", "r", "e", "p", "values", "forces")  # of a pose file


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Poses of every body, the ground first, in global axes, and amplitudes of flexible bodies; outputs and forces.

    Single precision, as pictures need no more, but for times and outputs.
    """

    title: str
    times: Array  # (T,) s
    names: tuple[str, ...]  # (nb,)
    parents: tuple[int, ...]  # (nb,)
    joints: tuple[str, ...]  # (nb,) joint between a body and its parent, as text
    r: Single  # (T, nb, 3) origins, m
    e: Single  # (T, nb, 4) unit quaternions, scalar first, body to global
    p: Single  # (T, na) amplitudes of the bars of the picture and of its hulls, one after the other, m
    outputs: tuple[tuple[str, str], ...]  # names and units
    values: Array  # (T, outputs)
    arrows: tuple[Arrow, ...]
    forces: Single  # (T, arrows, 3) global axes, N or N m
    picture: Picture
    scale: float = 1.0  # by which pictures magnify the deflection of flexible bodies; not in a pose file

    def point(self, body: int, at: Any, frames: Any = slice(None)) -> Array:
        """Return points (..., k, 3) of a body, given in its axes (k, 3), in global axes at some frames."""
        r, e = self.r[frames, body].astype(float), self.e[frames, body].astype(float)
        turned: Array = r[..., None, :] + np.einsum("...ij,kj->...ki", matrices(e), np.atleast_2d(at))
        return turned

    def axis(self, bar: Bar, frames: Any = slice(None)) -> Array:
        """Return the bent axis (..., k, 3) of a bar, magnified by ``scale``, in global axes at some frames."""
        r, e = self.r[frames, bar.body].astype(float), self.e[frames, bar.body].astype(float)
        local = bar.axis(self.p[frames, bar.modes].astype(float), self.scale)
        turned: Array = r[..., None, :] + np.einsum("...ij,...kj->...ki", matrices(e), local)
        return turned

    def hull_points(self, hull: Hull, frames: Any = slice(None)) -> Array:
        """Return the points (..., n, 3) of a hull, displacements magnified by ``scale``, in global axes."""
        local = hull.displaced(self.p[frames, hull.modes].astype(float), self.scale)
        r, e = self.r[frames, hull.body].astype(float), self.e[frames, hull.body].astype(float)
        turned: Array = r[..., None, :] + np.einsum("...ij,...kj->...ki", matrices(e), local)
        return turned

    @property
    def caption(self) -> str:
        """What a picture has to say of itself: that deflections are not what they were."""
        return "" if self.scale == 1.0 else f"deflection × {self.scale:g}"

    def reading(self, frame: int) -> str:
        """Return what the shown_outputs are at a frame, a line each."""
        values = {name: (unit, x) for (name, unit), x in zip(self.outputs, self.values[frame], strict=True)}
        lines = []
        for name in self.picture.shown_outputs:
            unit, value = values[name]
            lines.append(f"{name} {value:.4g}{'' if unit == '1' else f' {unit}'}")
        return "\n".join(lines)

    def scaled(self, scale: float) -> Motion:
        """Return the motion with the deflection of its flexible bodies magnified in pictures."""
        positive("scale of the deflection", scale)
        if not self.picture.bars and not self.picture.hulls:
            raise UserError(
                f"scale of the deflection is {scale:g}, but {self.title!r} has no flexible body; leave the scale out"
            )
        return replace(self, scale=scale)

    def frame(self, time: float) -> int:
        """Return the recorded frame nearest to a time (s); raises UserError outside the motion."""
        if not self.times[0] <= time <= self.times[-1]:
            raise UserError(
                f"time {time:g} s is outside the motion, {self.times[0]:g} to {self.times[-1]:g} s; give a time "
                "within it"
            )
        return int(np.argmin(np.abs(self.times - time)))

    def save(self, path: Path) -> None:
        """Write a pose file."""
        about = {
            "format": MOTION_FORMAT,
            "title": self.title,
            "names": self.names,
            "parents": self.parents,
            "joints": self.joints,
            "outputs": self.outputs,
            "arrows": [asdict(arrow) for arrow in self.arrows],
            "picture": self.picture.as_dict(),
        }
        write_arrays(path, {"about": json.dumps(about), **{name: getattr(self, name) for name in MOTION_ARRAYS}})

    @classmethod
    def load(cls, path: Path) -> Motion:
        """Read a pose file; raises UserError where there is none."""
        try:
            file = read_arrays(path)
            about = json.loads(str(file["about"]))
            motion = cls._of_file(about, file) if about["format"] == MOTION_FORMAT else None
        except OSError as error:
            raise UserError(
                f"pose file {str(path)!r} cannot be read: {error.strerror or error}; check path and permissions"
            ) from error
        except (ValueError, KeyError, TypeError) as error:
            raise UserError(
                f"{str(path)!r} is not a pose file; give a file that `mbfmu run` has written, named *.npz"
            ) from error
        if motion is None or not motion._complete:
            raise UserError(f"{str(path)!r} is a pose file of another version of mbfmu; make it again with `mbfmu run`")
        return motion

    @classmethod
    def _of_file(cls, about: dict[str, Any], arrays: Any) -> Motion:
        return cls(
            title=about["title"],
            names=tuple(about["names"]),
            parents=tuple(about["parents"]),
            joints=tuple(about["joints"]),
            outputs=tuple((name, unit) for name, unit in about["outputs"]),
            arrows=tuple(Arrow(**as_tuples(arrow)) for arrow in about["arrows"]),
            picture=Picture.from_dict(about["picture"]),
            **{name: arrays[name] for name in MOTION_ARRAYS},
        )

    @property
    def _complete(self) -> bool:
        """Whether every array has the shape the others and the names ask for, and outputs that are shown are there."""
        frames, bodies = len(self.times), len(self.names)
        amplitudes = sum(len(bar.shapes[0]) for bar in self.picture.bars)
        amplitudes += sum(len(hull.shapes) for hull in self.picture.hulls)
        shapes = ((frames, bodies, 3), (frames, bodies, 4), (frames, amplitudes))
        poses = (self.r.shape, self.e.shape, self.p.shape) == shapes
        value_shapes = (frames, len(self.outputs)), (frames, len(self.arrows), 3)
        outputs = {name for name, _ in self.outputs}
        requested = (self.picture.shown_outputs, *(skin.outputs for skin in self.picture.skins))
        complete = all(map(outputs.issuperset, requested))
        return frames > 0 and poses and complete and (self.values.shape, self.forces.shape) == value_shapes


class Recorder:
    """Notes the pose of every body, outputs and forces; give it to :func:`mbfmu.session.run.run` as ``watch``."""

    def __init__(self) -> None:
        self._mechanism: Mechanism | None = None
        self._sources: list[Source] = []
        self._outputs: tuple[tuple[str, str], ...] = ()
        self._times: list[float] = []
        self._r: list[Single] = []
        self._A: list[Single] = []
        self._p: list[Single] = []
        self._values: list[Array] = []
        self._forces: list[Array] = []

    def __call__(self, simulation: Simulation) -> None:
        """Note where the bodies are, and what was read of them; raises UserError for a mechanism it cannot draw."""
        compiled = simulation.compiled
        bodies = compiled.data.state.bodies
        if self._mechanism is not compiled.mechanism:
            check_fields(compiled.mechanism)
            self._mechanism, self._sources = compiled.mechanism, sources(compiled.mechanism)
            self._outputs = tuple((variable.name, variable.unit) for variable in simulation.variables)
        self._times.append(simulation.t)
        self._r.append(bodies["r"].astype(np.float32))
        self._A.append(bodies["A"].astype(np.float32))
        self._p.append(amplitudes(compiled).astype(np.float32))
        self._values.append(simulation.last_outputs)
        self._forces.append(read(compiled, self._sources, simulation.t))

    @property
    def used(self) -> bool:
        """Whether anything was noted."""
        return bool(self._times)

    def motion(self, title: str) -> Motion:
        """Return what was noted."""
        mechanism = self._mechanism
        assert mechanism is not None
        r, A = np.stack(self._r), np.stack(self._A)
        span = float(np.linalg.norm(np.ptp(r[:, 1:].reshape(-1, 3), axis=0)))
        arrows, forces = shown(self._sources, np.stack(self._forces), span)
        return Motion(
            title=title,
            times=np.array(self._times),
            names=tuple(body.name for body in mechanism.bodies),
            parents=tuple(body.parent for body in mechanism.bodies),
            joints=tuple(joint_of(body) for body in mechanism.bodies),
            r=r,
            e=quaternions(A).astype(np.float32),
            p=np.stack(self._p),
            outputs=self._outputs,
            values=np.stack(self._values),
            arrows=arrows,
            forces=forces.astype(np.float32),
            picture=draw(mechanism, span, (r, A)),
        )


def joint_of(body: Body) -> str:
    """Return the joint of a body as text, ``revolute, driven``; nothing for the ground."""
    words = re.sub(r"(?<!^)(?=[A-Z])", " ", type(body.joint).__name__).lower()
    return f"{words}{', driven' * (body.joint.drive is not None)}" if body.index else ""


def amplitudes(compiled: CompiledMechanism) -> Array:
    """Return the amplitudes (na,) of the beams of a compiled mechanism whose bodies are in place, in their
    order, m; after them those of the bodies of finite elements that have hulls.
    """
    handles = [handle for handle, _ in (*compiled.mechanism.beams(), *bodies_with_hulls(compiled.mechanism))]
    owners = [compiled.data.arrays.bodies[handle.modes.index] for handle in handles]
    q = compiled.data.state.q
    return np.array([q[own["qi"] + k] for own in owners for k in range(own["nv"])])


def quaternions(A: Array | Single) -> Array:
    """Return unit quaternions (..., 4), scalar first, of rotation matrices (..., 3, 3).

    Each is the normalized row with the largest diagonal entry of the matrix 4 e e^T, whose entries are sums of those
    of A (Shepperd 1978): no cancellation near any angle, and no import of SciPy.
    """
    (a, b, c), (d, f, g), (h, i, j) = np.moveaxis(np.asarray(A, float), (-2, -1), (0, 1))
    rows = (
        (1 + a + f + j, i - g, c - h, d - b),
        (i - g, 1 + a - f - j, b + d, c + h),
        (c - h, b + d, 1 - a + f - j, g + i),
        (d - b, c + h, g + i, 1 - a - f + j),
    )
    products = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    largest = np.argmax(np.diagonal(products, axis1=-2, axis2=-1), axis=-1)
    e = np.take_along_axis(products, largest[..., None, None], axis=-2)[..., 0, :]
    return np.asarray(e / np.linalg.norm(e, axis=-1, keepdims=True))


def matrices(e: Array) -> Array:
    """Return rotation matrices (..., 3, 3) of unit quaternions (..., 4), scalar first."""
    w, x, y, z = np.moveaxis(e, -1, 0)
    rows = (
        (w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
