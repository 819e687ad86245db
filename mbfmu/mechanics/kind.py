"""Base class of element types: joints, cut joints, couplings, loads, signals, sensors and surfaces.

An element type (kind) is a class in a separate file, of this package or of a user. It has a *record* of parameters,
which ``fill`` writes, and *kernels*, which read them; its role (:class:`.joints.Joint`, :class:`.cuts.CutJoint`,
:class:`.couplings.Coupling`, :class:`.loads.Load`, :class:`.signals.Signal`, :class:`.sensors.Sensor`, or one of
another package) specifies them. The rest of the package is independent of the existing element types: the recursions
call kernels by their address (:mod:`.dispatch`).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from mbfmu.util.errors import UserError, require_arguments, short
from solvers.compiled.kernel import COMPILED, has_raise, is_kernel
from solvers.compiled.record import Record

RecordType = np.dtype[Any] | type[Record]
EMPTY_RECORD = np.dtype([("nothing", np.int64)])  # record of a kind without parameters


class Attachment(Protocol):
    """Where something of a kind is: what ``fill`` may ask."""

    name: str  # as messages call it
    bodies: tuple[int, ...]  # numbers of the bodies it was given
    q: int  # where the position of the first body's joint is in State.q
    v: int  # ... its velocity in State.v
    joint: Any  # tree joint of the first body; None: there is no body
    first_state: int  # where the first of the load's first-order states is in State.v; the others follow

    def state_place(self, state: Any) -> int:
        """Return where a first-order state that :meth:`.Mechanism.state` has returned is in State.v."""

    def signal(self, value: Any, what: str) -> int:
        """Return the number of a signal that is used here: a number, a signal, an input or a function of time."""

    def part(self, part: Any) -> int:
        """Return the number of a part that is used here: an element of a role that the package or a user adds."""

    def scratch(self, dtype: np.dtype[Any]) -> int:
        """Return the place of scratch memory with these fields, see :func:`.dispatch.scratch_record`; kernels that
        declare the same fields share it.
        """

    def bearing(self) -> int:
        """Return the number of a new record in ``State.bearings``."""

    def numbers(self, values: Any) -> int:
        """Keep numbers, as many as there are, in ``Arrays.numbers``; return where they begin."""

    def history(self, count: int, shared: str = "") -> int:
        """Keep ``count`` numbers in ``Arrays.numbers``; return where they begin. They are zero before a run, and the
        kernel ``longest_step`` changes them at its start and at the end of every accepted step. Elements that give the
        same name as ``shared`` share them.
        """


class ElementType:
    """Base of all roles.

    Attributes
    ----------
    record
        Fields of the numbers that kernels read, whole or real, of any shape: a class of
        :class:`solvers.compiled.record.Record` or a dtype.
    kernels
        Of a role: names of the kernels and what they are called with after the record, see :mod:`.dispatch`.
    variants
        Types that have the record and the kernels of some objects of this type, see :meth:`become`: native FMUs
        contain these kernels, too.
    records
        Of a role: further words that this may have, each a record with these fields.
    """

    record: ClassVar[RecordType] = EMPTY_RECORD
    kernels: ClassVar[dict[str, str]]
    records: ClassVar[dict[str, np.dtype[Any]]] = {}
    variants: ClassVar[tuple[type[ElementType], ...]] = ()

    def __new__(cls, *_: Any, **given: Any) -> Self:
        """Check the names of the parameters; raises UserError."""
        require_arguments(cls, given)
        return super().__new__(cls)

    def become(self, variant: type[ElementType]) -> None:
        """Take the record and the kernels of a variant: its parameters require others than those of the class."""
        object.__setattr__(self, "record", variant.record)
        for name in self.kernels:
            object.__setattr__(self, name, kernel_of(variant, name))

    def check(self, what: str) -> None:
        """Raise UserError if a parameter is not allowed; ``what`` names the element."""

    def check_declaration(self, said: str) -> None:
        """Raise UserError if what the class declares does not fit together; ``said`` begins the message."""

    def fill(self, record: Any, site: Attachment) -> None:
        """Write the numbers into a zeroed record: here the parameters that have the name of a field."""
        for field in record.dtype.names:
            if field in vars(self):
                value, declared = vars(self)[field], record.dtype[field]
                given = np.asarray(value)
                if given.shape != declared.shape or not np.can_cast(given.dtype, declared.base, "same_kind"):
                    number = "a whole number" if declared.base == np.int64 else "a number"
                    raise UserError(
                        f"{field} of {site.name} is {short(value)}; allowed: "
                        f"{f'numbers of the shape {declared.shape}' if declared.shape else number}, or a method fill "
                        f"of {type(self).__name__} that writes the record"
                    )
                record[field] = given


def _fields(record: Any) -> Any:
    """Return the dtype of a class of records; anything else is returned unchanged."""
    return record.dtype if isinstance(record, type) and issubclass(record, Record) else record


def record_of(item: ElementType | type[ElementType]) -> np.dtype[Any]:
    """Return the fields of something's record, aligned as kernels want them."""
    return _aligned(_fields(item.record))


@lru_cache(maxsize=1024)  # a mesh has hundreds of elements with the same record
def _aligned(fields: np.dtype[Any]) -> np.dtype[Any]:
    return np.dtype([(name, fields[name].base, fields[name].shape) for name in fields.names or ()], align=True)


def kernel_of(item: ElementType | type[ElementType], name: str) -> Any:
    """Return a kernel of something, None where it has none; it is a function, and no method of the object."""
    function = getattr(item, name)
    return getattr(function, "__func__", function)


def element_types_of(package: Any, role: type[ElementType]) -> list[Any]:
    """Return the kinds of a role that a package exports, those without kernels left out."""
    found = [getattr(package, name) for name in package.__all__]
    first = next(iter(role.kernels))
    return [kind for kind in found if isinstance(kind, type) and issubclass(kind, role) and getattr(kind, first, None)]


def check_element_type(what: str, given: Any, role: type[ElementType]) -> None:
    """Refuse what is not of a role, or of a kind that lacks what its role asks for."""
    if not isinstance(given, role):
        raise UserError(f"{what} is {short(given)}; allowed: a {role.__name__}, such as those of mbfmu.mechanics")
    said = f"{what} is of class {type(given).__name__}"
    kind: Any = type(given)
    asked: Any = role  # which has a hash, whatever mypy finds of classes of classes
    kernels = tuple(kernel_of(given, name) if hasattr(given, name) else None for name in role.kernels)
    try:
        wrong = _describe_wrong_kernels(asked, kernels)
    except TypeError:  # something that is no function, and has no hash
        wrong = _describe_wrong_kernels.__wrapped__(asked, kernels)
    if wrong:
        raise UserError(said + wrong)
    for name in _undeclared(kind, asked):
        if name not in vars(given):  # a property is not to be asked yet
            raise UserError(f"{said}, which does not say its {name!r}; see its base {role.__name__}")
    drawings, drawn = getattr(role, "drawings", ()), getattr(given, "drawn", None)
    if drawings and drawn not in drawings:
        raise UserError(f"{said}, whose `drawn` is {drawn!r}; allowed: {', '.join(map(repr, drawings))}")
    given.check_declaration(said)
    record = _fields(given.record)
    if not isinstance(record, np.dtype) or not _has_numbers(record):
        raise UserError(
            f"{said}, whose record is {record!r}; allowed: a NumPy dtype of named fields, each of one "
            "number or more, float64 or int64"
        )
    check_field_names(f"{said}, whose record", record)


@lru_cache(maxsize=1024)  # as the others: a mesh has hundreds of elements of the same few kinds
def _describe_wrong_kernels(role: type[ElementType], kernels: tuple[Any, ...]) -> str:
    """Return what is wrong with the kernels of a kind, after its name; empty: nothing."""
    for name, function in zip(role.kernels, kernels, strict=True):
        if function is None:
            if getattr(role, name, False) is not None:
                return f", which has no kernel {name!r}"
        elif COMPILED and not is_kernel(function):
            return f", whose {name!r} is not a kernel; decorate it with mbfmu.mechanics.kernel"
        elif has_raise(function):
            return (
                f", whose kernel {name!r} raises an exception, which compiled code cannot handle; write nan instead, "
                "which ends the run"
            )
    return ""


@lru_cache(maxsize=1024)
def _undeclared(kind: type, role: type[ElementType]) -> tuple[str, ...]:
    """Return the class attributes that a role asks for and a class does not have."""
    asked = vars(role).get("__annotations__", {}).items()
    return tuple(name for name, meant in asked if "ClassVar" in str(meant) and not hasattr(kind, name))


@lru_cache(maxsize=1024)
def _has_numbers(record: np.dtype[Any]) -> bool:
    """Whether a record has fields, each of numbers that kernels know."""
    fields = [record[name] for name in record.names or ()]
    return bool(fields) and all(field.base in (np.float64, np.int64) and field.itemsize for field in fields)


def check_field_names(what: str, dtype: np.dtype[Any]) -> None:
    """Refuse fields of a record that kernels cannot read as attributes when they run as plain Python."""
    for name in _reserved_names(dtype):
        raise UserError(f"{what} has a field {name!r}; NumPy's records have that name already; use another name")


@lru_cache(maxsize=1024)
def _reserved_names(dtype: np.dtype[Any]) -> tuple[str, ...]:
    return tuple(name for name in dtype.names or () if hasattr(np.record, name))
