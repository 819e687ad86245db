"""What becomes of each number of a model of MuJoCo (``mjModel``): imported, not imported, or without effect.

MuJoCo writes all attributes of MJCF and URDF files that change the motion into the arrays of ``mjModel``, with
defaults, angles and frames resolved. The tables name each array; a test compares them with the installed version, so
that a new property of MuJoCo is not overlooked.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from .losses import Key

IMPORTED = frozenset(
    """
    body_parentid body_pos body_quat body_ipos body_iquat body_mass body_inertia body_gravcomp body_mocapid body_jntnum
    body_jntadr qpos0 qpos_spring jnt_type jnt_pos jnt_axis jnt_range jnt_limited jnt_stiffness jnt_solref jnt_solimp
    jnt_actfrclimited jnt_actfrcrange jnt_qposadr jnt_dofadr jnt_bodyid dof_damping dof_armature dof_frictionloss
    dof_jntid dof_invweight0 site_pos site_quat site_bodyid eq_type eq_obj1id eq_obj2id eq_objtype eq_active0 eq_data
    tendon_stiffness tendon_damping tendon_lengthspring tendon_adr tendon_num tendon_limited tendon_range
    tendon_solref_lim tendon_solimp_lim tendon_invweight0 tendon_actfrclimited tendon_actfrcrange wrap_type wrap_objid
    wrap_prm actuator_trntype
    actuator_trnid actuator_dyntype actuator_gaintype actuator_biastype actuator_gainprm actuator_biasprm
    actuator_ctrllimited actuator_ctrlrange actuator_forcelimited actuator_forcerange actuator_gear actuator_damping
    actuator_armature actuator_group actuator_ctrladr actuator_outadr geom_type geom_size geom_pos geom_quat
    geom_bodyid geom_contype geom_conaffinity geom_rgba geom_group
    """.split()
)


class Lost(NamedTuple):
    """Array that must be zero, since it is not imported.

    Attributes
    ----------
    array
        Name, without its kind of element.
    kind
        Kind of its elements in MuJoCo; DOF: those of the joints.
    key
        What is reported for an element whose entries are not zero.
    where
        Array whose entry is not zero, either, for the elements that are concerned; empty: all.
    flags
        Flags of MuJoCo that disable this property.
    """

    array: str
    kind: str
    key: Key
    where: str = ""
    flags: tuple[str, ...] = ()


LOST_PROPERTIES = (
    Lost("jnt_stiffnesspoly", "JOINT", "polynomial", flags=("SPRING",)),
    Lost("jnt_springyield", "JOINT", "yield", "jnt_stiffness", ("SPRING",)),
    Lost("jnt_margin", "JOINT", "range margin", "jnt_limited", ("LIMIT", "CONSTRAINT")),
    Lost("jnt_actgravcomp", "JOINT", "compensation limit", "jnt_actfrclimited", ("GRAVITY",)),
    Lost("dof_dampingpoly", "DOF", "polynomial", flags=("DAMPER",)),
    Lost("tendon_stiffnesspoly", "TENDON", "polynomial", flags=("SPRING",)),
    Lost("tendon_dampingpoly", "TENDON", "polynomial", flags=("DAMPER",)),
    Lost("tendon_springyield", "TENDON", "yield", "tendon_stiffness", ("SPRING",)),
    Lost("tendon_margin", "TENDON", "range margin", "tendon_limited", ("LIMIT", "CONSTRAINT")),
    Lost("tendon_frictionloss", "TENDON", "tendon friction", flags=("FRICTIONLOSS", "CONSTRAINT")),
    Lost("tendon_armature", "TENDON", "tendon friction"),
    Lost("actuator_dampingpoly", "ACTUATOR", "polynomial", flags=("DAMPER",)),
    Lost("actuator_delay", "ACTUATOR", "delay"),
)

CONTACT = frozenset(  # reported once, with the number of shapes
    """
    geom_condim geom_priority geom_friction geom_solmix geom_solref geom_solimp geom_margin geom_gap geom_surfacevel
    geom_adhesion pair_dim pair_geom1 pair_geom2 pair_signature pair_solref pair_solreffriction pair_solimp pair_margin
    pair_gap pair_adhesion pair_friction exclude_signature
    """.split()
)
SOFTNESS = frozenset(  # of MuJoCo's constraints, which are rigid here
    "eq_solref eq_solimp dof_solref dof_solimp".split()
)
OF_LOST_ELEMENTS = frozenset(  # of elements that are reported as a whole
    """
    tendon_solref_fri tendon_solimp_fri actuator_dynprm actuator_actlimited actuator_actrange
    actuator_actearly actuator_actadr actuator_actnum actuator_cranklength actuator_lengthrange actuator_plugin
    actuator_ctrlnum actuator_ctrlspec actuator_outnum body_plugin geom_plugin geom_fluid geom_dataid
    """.split()
)
WITHOUT_EFFECT = frozenset(  # names, pictures, user data, and what MuJoCo computes from other arrays
    """
    body_rootid body_weldid body_dofnum body_dofadr body_treeid body_geomnum body_geomadr body_simple body_sameframe
    body_subtreemass body_invweight0 body_margin body_user body_contype body_conaffinity body_bvhadr body_bvhnum
    jnt_actuatorid jnt_group jnt_plasticadr jnt_user dof_bodyid dof_parentid dof_treeid dof_Madr dof_simplenum dof_M0
    dof_length geom_matid geom_sameframe geom_castshadow geom_aabb geom_rbound geom_user tendon_type tendon_matid
    tendon_actuatorid tendon_group tendon_plasticadr tendon_treenum tendon_treeid tendon_length0
    tendon_width tendon_rgba tendon_user actuator_history actuator_historyadr actuator_user actuator_acc0
    actuator_length0
    """.split()
)
OTHER_PREFIXES = (  # flexible bodies and plugins are reported as a whole, the others have no effect
    "flex", "efm", "plugin", "bvh_", "oct_", "tree_", "ten_J", "site_", "cam_", "light_", "mesh_", "skin_",
    "hfield_", "tex_", "mat_", "sensor_", "numeric_", "text_", "tuple_", "key_", "name_", "names", "_sizes", "B_",
    "M_", "D_", "mapM2M", "mapM2D", "mapD2M",
)  # fmt: skip

OPTIONS = frozenset("gravity density viscosity wind disableflags disableactuator".split())  # imported or reported
OPTIONS_WITHOUT_EFFECT = frozenset(  # of the integration and of the solver of contacts, which are MuJoCo's own
    """
    timestep impratio tolerance ls_tolerance noslip_tolerance ccd_tolerance sleep_tolerance magnetic o_margin o_solref
    o_solimp o_friction integrator cone jacobian solver iterations ls_iterations noslip_iterations ccd_iterations
    enableflags sdf_initpoints sdf_iterations
    """.split()
)
FLAGS = frozenset(  # that disable parts of the mechanics; each is regarded where this part is imported
    "CONSTRAINT EQUALITY FRICTIONLOSS LIMIT CONTACT SPRING DAMPER GRAVITY CLAMPCTRL ACTUATION".split()
)
FLAGS_WITHOUT_EFFECT = frozenset(
    "WARMSTART FILTERPARENT REFSAFE SENSOR MIDPHASE EULERDAMP AUTORESET NATIVECCD ISLAND MULTICCD".split()
)


def find_lost(
    model: Any, is_disabled: Callable[..., bool], name_of: Callable[[str, int], str]
) -> Iterator[tuple[Key, str]]:
    """Yield what is reported, with the name of the element, for the entries of LOST_PROPERTIES that are not zero.

    Parameters
    ----------
    model
        Model of MuJoCo.
    is_disabled
        Whether the file disables one of the given flags.
    name_of
        Name of the element of a kind and a number.
    """
    for lost in LOST_PROPERTIES:
        if lost.flags and is_disabled(*lost.flags):
            continue
        values = np.asarray(getattr(model, lost.array))
        concerned = np.any(values.reshape(len(values), -1), axis=1) if values.size else np.zeros(0, bool)
        if lost.where:
            concerned &= np.asarray(getattr(model, lost.where), bool)
        for k in map(int, np.flatnonzero(concerned)):
            is_dof = lost.kind == "DOF"
            yield lost.key, name_of("JOINT" if is_dof else lost.kind, int(model.dof_jntid[k]) if is_dof else k)
