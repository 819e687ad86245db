"""URDF and MJCF files, compiled by MuJoCo, which resolves defaults, angles, frames, included files and inertias.

MuJoCo is an optional package (extra ``import``). Shapes that have no part in the motion are removed before the
compilation, so that their files need not exist.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from warnings import catch_warnings, simplefilter
from xml.etree import ElementTree

import numpy as np

from mbfmu.util.errors import UserError, shorten
from mbfmu.util.extras import import_optional

from .inertias import ReplacedInertia, does_not_move, replace_refused

MIN_MUJOCO = (4, 0)  # earlier versions ignore <mimic> of URDF without a warning
MAX_BODIES = 20_000  # MuJoCo needs minutes for more: its time is proportional to the square of the number
MAX_CHAIN = 1000  # bodies in a row: the time of MuJoCo is proportional to the third power
MAX_FILE_SIZE = 200_000_000  # bytes
XACRO = "ros.org/wiki/xacro"  # part of the namespace of macros
FORMATS = {"mujoco": "MJCF", "robot": "URDF"}
BODY_TAGS = {"MJCF": "body", "URDF": "link"}
FINITE_ARRAYS = (
    "body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia", "jnt_pos", "jnt_axis", "jnt_range",
    "jnt_stiffness", "dof_damping", "dof_armature", "dof_frictionloss", "qpos0", "qpos_spring", "eq_data", "site_pos",
    "actuator_gear", "actuator_gainprm", "actuator_biasprm",
)  # fmt: skip


@dataclass(frozen=True)
class CompiledFile:
    """File compiled by MuJoCo: its format, the model of MuJoCo (``mjModel``), the elements of a URDF file, warnings of
    MuJoCo, and masses and inertias that replace those of MuJoCo, by the name of the body.
    """

    path: Path
    format: str
    model: Any
    mujoco: Any
    robot: ElementTree.Element | None
    warnings: tuple[str, ...]
    inertias: dict[str, ReplacedInertia]

    def disables(self, *flags: str) -> bool:
        """Whether the file sets one of these flags of MuJoCo, which disable parts of its equations."""
        bits = (int(getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{flag}")) for flag in flags)
        return any(int(self.model.opt.disableflags) & bit for bit in bits)


def compile_file(path: Path, *, floating: bool = False) -> CompiledFile:
    """Read and compile a file; ``floating``: bodies of the ground of a URDF file move freely.

    Raises
    ------
    UserError
        MuJoCo is not installed, the file cannot be read, or it is not a valid model.
    """
    mujoco = _mujoco()
    text = _read(path)
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise UserError(f"{str(path)!r} is not valid XML: {error}") from error
    if root.tag not in FORMATS:
        raise UserError(
            f"{str(path)!r} has the root element <{shorten(root.tag)}>; allowed: <robot> of URDF and <mujoco> of MJCF"
        )
    kind = FORMATS[root.tag]
    _check_size(path, kind, root)
    if any(XACRO in str(element.tag) for element in root.iter()):
        raise UserError(f"{str(path)!r} contains macros of xacro; expand them: xacro robot.urdf.xacro -o robot.urdf")
    messages: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda found: messages.append(str(found)))  # MuJoCo would write a file otherwise
    try:
        with catch_warnings(record=True) as found:
            simplefilter("always")
            spec = mujoco.MjSpec.from_file(str(path))
            if len(list(spec.bodies)) > MAX_BODIES + 1:  # included files, <replicate>
                raise UserError(f"{str(path)!r} has {len(list(spec.bodies))} bodies; allowed: up to {MAX_BODIES}")
            spec.compiler.fusestatic = False  # it would remove the names of fixed bodies
            spec.compiler.LRopt.mode = mujoco.mjtLRMode.mjLRMODE_NONE.value  # it would simulate muscles
            if floating:
                _float(path, kind, spec)
            _remove_shapes(path, mujoco, spec)
            inertias = replace_refused(repr(str(path)), spec) if kind == "URDF" else {}
            model = spec.compile()
    except UserError:
        raise
    except (ValueError, mujoco.FatalError, mujoco.UnexpectedError) as error:
        raise UserError(f"{str(path)!r} is refused by the compiler of MuJoCo: {_message(error)}") from error
    finally:
        mujoco.set_mju_user_warning(before)
    messages += [str(warning.message) for warning in found]
    if any("'NaN'" in message for message in messages):  # zero is in its place
        raise UserError(f"{str(path)!r} contains numbers that are nan{_nan_place(root)}; correct the file")
    _check_finite(path, mujoco, model)
    return CompiledFile(path, kind, model, mujoco, root if kind == "URDF" else None, tuple(messages), inertias)


def _mujoco() -> Any:
    """Return the package; raises UserError if it is missing or too old."""
    mujoco = import_optional("mujoco", "import")
    version = tuple(int(part) for part in re.findall(r"\d+", mujoco.__version__)[:2])
    if version < MIN_MUJOCO:
        raise UserError(
            f"mujoco {mujoco.__version__} is installed; 4.0 or newer is required: pip install 'mbfmu[import]'"
        )
    return mujoco


def _read(path: Path) -> bytes:
    """Return the content of a file; entities are refused, since they may expand to any size."""
    try:
        size = path.stat().st_size
        if size > MAX_FILE_SIZE:
            raise UserError(f"{str(path)!r} has {size / 1e6:.0f} MB; allowed: up to {MAX_FILE_SIZE / 1e6:.0f} MB")
        text = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UserError(f"{str(path)!r} cannot be read: {reason}", "file-access") from error
    if not text.strip():
        raise UserError(f"{str(path)!r} is empty; allowed: a model in URDF or MJCF")
    if re.search(rb"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise UserError(f"{str(path)!r} contains a document type or entities; remove <!DOCTYPE ...> from the file")
    try:
        text.decode("utf-8")
    except UnicodeDecodeError as error:
        raise UserError(
            f"{str(path)!r} is not UTF-8 text at byte {error.start}; convert it: iconv -f ISO-8859-1 -t UTF-8"
        ) from error
    return text


def _check_size(path: Path, kind: str, root: ElementTree.Element) -> None:
    """Refuse models that MuJoCo would need minutes or hours for."""
    count = _count_bodies(root, BODY_TAGS[kind])
    if count > MAX_BODIES:
        raise UserError(f"{str(path)!r} has {count} bodies; allowed: up to {MAX_BODIES}. Divide the model")
    parents = {}
    for joint in root.findall("joint") if kind == "URDF" else ():
        child, parent = joint.find("child"), joint.find("parent")
        if child is not None and parent is not None:
            parents[child.get("link")] = parent.get("link")
    depths: dict[str | None, int] = {}
    for last in parents:
        chain, link = list[str | None](), last
        while link in parents and link not in depths and len(chain) <= len(parents):
            chain.append(link)
            link = parents.get(link)
        for number, name in enumerate(reversed(chain), depths.get(link, 0) + 1):
            depths[name] = number
    if max(depths.values(), default=0) > MAX_CHAIN:
        raise UserError(
            f"{str(path)!r} has a chain of {max(depths.values())} joints; allowed: up to {MAX_CHAIN}. Write such a "
            "chain as a loop in Python"
        )


def _count_bodies(root: ElementTree.Element, tag: str) -> int:
    """Return the number of bodies, those of <replicate> as often as they are repeated."""
    count, found = 0, [(root, 1)]
    while found:
        element, times = found.pop()
        if element.tag == "replicate":
            times *= int(text) if (text := element.get("count", "1").strip()).isdecimal() and len(text) < 10 else 1
        count += times * (element.tag == tag)
        found += [(child, times) for child in element]
    return count


def _remove_shapes(path: Path, mujoco: Any, spec: Any) -> None:
    """Remove shapes of files, but those that give an inertia; raises UserError if the file of one is missing."""
    kinds = mujoco.mjtGeom
    from_file = (kinds.mjGEOM_MESH, kinds.mjGEOM_SDF, kinds.mjGEOM_HFIELD)
    of_geoms = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    needed = set()
    for body in spec.bodies:
        has_inertia = (body.explicitinertial and not of_geoms) or does_not_move(body)
        for geom in body.geoms:
            if geom.type in from_file:
                if has_inertia or geom.type != kinds.mjGEOM_MESH:
                    spec.delete(geom)
                else:
                    needed.add(geom.meshname)
                    _require_mesh(path, spec, body.name, geom.meshname)
    for element in (*spec.geoms, *spec.sites, *spec.tendons):
        element.material = ""
    for group in (spec.skins, spec.hfields, spec.materials, spec.textures):
        for element in list(group):
            spec.delete(element)
    for mesh in list(spec.meshes):
        if mesh.name not in needed:
            spec.delete(mesh)


def _require_mesh(path: Path, spec: Any, body: str, name: str) -> None:
    """Raise UserError if a body has its inertia from a mesh whose file is missing."""
    mesh = next((mesh for mesh in spec.meshes if mesh.name == name), None)
    if mesh is None or not mesh.file:
        return
    file = path.parent / (spec.compiler.meshdir or "") / mesh.file
    if not file.exists():
        raise UserError(
            f"{str(path)!r}: body {body!r} has its mass and inertia from the mesh file {str(file)!r}, which does not "
            "exist; add the file, or give the body its inertia (<inertial>)"
        )


def _float(path: Path, kind: str, spec: Any) -> None:
    """Give the bodies on the ground that are fixed a free joint."""
    roots = [body for body in spec.worldbody.bodies if not list(body.joints)]
    if not roots:
        raise UserError(f"{str(path)!r} ({kind}) has no body that is fixed to the ground; leave out --floating")
    for body in roots:
        body.add_freejoint()


def _check_finite(path: Path, mujoco: Any, model: Any) -> None:
    """Refuse numbers that are not finite; MuJoCo accepts infinity and, with a warning, NaN."""
    for name in FINITE_ARRAYS:
        wrong = np.argwhere(~np.isfinite(getattr(model, name)))
        if len(wrong):
            raise UserError(f"{str(path)!r}: {name} of MuJoCo is not finite at number {wrong[0][0]}; correct the file")
    if model.nbody == 1 or model.nv == 0:
        raise UserError(f"{str(path)!r} has no joint that moves a body; allowed: one or more")


def _nan_place(root: ElementTree.Element) -> str:
    """Return where the first attribute with a number that is nan is; empty: in another file."""
    for element in root.iter():
        for key, value in element.attrib.items():
            if key != "name" and any(part.strip("+-").lower() == "nan" for part in value.split()):
                return f", such as <{element.tag} {key}={shorten(value)!r}>"
    return ""


def _message(error: Exception) -> str:
    """Return an error of MuJoCo on one line, with what to do about the most frequent one."""
    lines = [line.strip() for line in str(error).splitlines()]
    text = "; ".join(line for line in lines if line and not line.startswith("The static bodies"))
    text = re.sub(r"^(XML )?Error: ", "", text)
    if "larger than mjMINVAL" in text:
        text += ". Give this body a mass and an inertia (<inertial>), or fix it to its parent"
    return shorten(text)
