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

from .inertias import ReplacedInertia, replace_refused
from .mujoco_messages import message_of
from .spec_shapes import Mesh, count_contacts, remove_shapes
from .urdf_checks import check_urdf
from .xml_files import MAX_BODIES, read_xml

MIN_MUJOCO = (4, 0)  # earlier versions ignore <mimic> of URDF without a warning
MAX_REFERENCE_ANGLE = 1e9  # rad; its rounding error is 1e-7 rad
KINDS = {"body": "BODY", "jnt": "JOINT", "dof": "JOINT", "eq": "EQUALITY", "site": "SITE", "actuator": "ACTUATOR"}
FINITE_ARRAYS = (
    "body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia", "jnt_pos", "jnt_axis", "jnt_range",
    "jnt_stiffness", "dof_damping", "dof_armature", "dof_frictionloss", "eq_data", "site_pos",
    "actuator_gear", "actuator_gainprm", "actuator_biasprm",
)  # fmt: skip


@dataclass(frozen=True)
class CompiledFile:
    """File compiled by MuJoCo.

    Attributes
    ----------
    path, format
        File, and URDF or MJCF.
    model, mujoco
        Model of MuJoCo (``mjModel``) and the package.
    robot
        Elements of a URDF file; None: an MJCF file.
    warnings
        Warnings of MuJoCo.
    inertias
        Masses and inertias that replace those of MuJoCo, by the name of the body.
    contacts
        Number of shapes that can be in contact.
    meshes
        Files of meshes by the numbers of their geometries in MuJoCo; None: a mesh without a file.
    """

    path: Path
    format: str
    model: Any
    mujoco: Any
    robot: ElementTree.Element | None
    warnings: tuple[str, ...]
    inertias: dict[str, ReplacedInertia]
    contacts: int
    meshes: dict[int, Mesh | None]

    def disables(self, *flags: str) -> bool:
        """Whether the file sets one of these flags of MuJoCo, which disable parts of its equations."""
        bits = (int(getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{flag}")) for flag in flags)
        return any(int(self.model.opt.disableflags) & bit for bit in bits)

    def name_of(self, kind: str, number: int) -> str:
        """Return the name of an element of MuJoCo; empty: it has none."""
        return self.mujoco.mj_id2name(self.model, getattr(self.mujoco.mjtObj, f"mjOBJ_{kind}"), number) or ""


def compile_file(path: Path, *, floating: bool = False) -> CompiledFile:
    """Read and compile a file; ``floating``: bodies of the ground of a URDF file move freely.

    Raises
    ------
    UserError
        MuJoCo is not installed, the file cannot be read, or it is not a valid model.
    """
    mujoco = _mujoco()
    kind, root = read_xml(path)
    if kind == "URDF":
        check_urdf(repr(str(path)), root)
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
            contacts = count_contacts(spec)
            geometries = remove_shapes(path, mujoco, spec)
            inertias = replace_refused(repr(str(path)), kind, mujoco, spec)
            model = spec.compile()
            meshes = {int(geom.id): mesh for geom, mesh in geometries}
    except UserError:
        raise
    except (ValueError, mujoco.FatalError, mujoco.UnexpectedError) as error:
        raise UserError(f"{str(path)!r} is refused by the compiler of MuJoCo: {message_of(error)}") from error
    finally:
        mujoco.set_mju_user_warning(before)
    messages += [str(warning.message) for warning in found]
    if any("'NaN'" in message for message in messages):  # zero is in its place
        raise UserError(f"{str(path)!r} contains numbers that are nan{_nan_place(root)}; correct the file")
    _check_finite(path, mujoco, model)
    robot = root if kind == "URDF" else None
    return CompiledFile(path, kind, model, mujoco, robot, tuple(messages), inertias, contacts, meshes)


def _mujoco() -> Any:
    """Return the package; raises UserError if it is missing or too old."""
    mujoco = import_optional("mujoco", "import")
    version = tuple(int(part) for part in re.findall(r"\d+", mujoco.__version__)[:2])
    if version < MIN_MUJOCO:
        raise UserError(
            f"mujoco {mujoco.__version__} is installed; 4.0 or newer is required: pip install 'mbfmu[import]'"
        )
    return mujoco


def _float(path: Path, kind: str, spec: Any) -> None:
    """Give the bodies on the ground that are fixed a free joint."""
    roots = [body for body in spec.worldbody.bodies if not list(body.joints)]
    if not roots:
        raise UserError(f"{str(path)!r} ({kind}) has no body that is fixed to the ground; leave out --floating")
    for body in roots:
        body.add_freejoint()


def _check_finite(path: Path, mujoco: Any, model: Any) -> None:
    """Refuse numbers that are not finite; MuJoCo accepts infinity and, with a warning, NaN."""
    for array in FINITE_ARRAYS:
        wrong = np.argwhere(~np.isfinite(getattr(model, array)))
        if len(wrong):
            prefix, _, what = array.partition("_")
            kind, k = KINDS[prefix], int(wrong[0][0])
            number = int(model.dof_jntid[k]) if prefix == "dof" else k
            name = mujoco.mj_id2name(model, getattr(mujoco.mjtObj, f"mjOBJ_{kind}"), number) or f"number {number + 1}"
            raise UserError(f"{str(path)!r}: {what} of {kind.lower()} {name!r} is not finite; correct the file")
    if not np.all(np.isfinite(model.qpos0)) or not np.all(np.isfinite(model.qpos_spring)):
        raise UserError(f"{str(path)!r}: ref or springref of a joint is not finite; correct the file")
    hinges = model.jnt_qposadr[model.jnt_type == int(mujoco.mjtJoint.mjJNT_HINGE)]
    if np.abs(model.qpos0[hinges]).max(initial=0.0) > MAX_REFERENCE_ANGLE:
        raise UserError(
            f"{str(path)!r}: ref of a joint is {np.abs(model.qpos0[hinges]).max():.3g} rad; allowed: angles up to "
            f"{MAX_REFERENCE_ANGLE:g} rad, since the rounding error of larger ones is an angle, too. Correct the file"
        )
    if model.nbody == 1 or model.nv == 0:
        raise UserError(f"{str(path)!r} has no joint that moves a body; allowed: one or more")


def _nan_place(root: ElementTree.Element) -> str:
    """Return where the first attribute with a number that is nan is; empty: in another file."""
    for element in root.iter():
        for key, value in element.attrib.items():
            if key != "name" and any(part.strip("+-").lower() == "nan" for part in value.split()):
                return f", such as <{element.tag} {key}={shorten(value)!r}>"
    return ""
