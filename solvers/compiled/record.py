"""Records that kernels work on: one declaration gives the fields in memory and the types that mypy checks.

    class Body(Record):
        parent: i8
        mass: f8  # kg
        com: Vec3  # m

``Body.dtype`` has these fields, in this order and aligned; ``Body.zeros(n)`` is an array of them. Kernels are annotated
with the class, so that a misspelled field is an error of mypy: ``def momentum(body: Body) -> float``. Kernels reach
fields as attributes, other code by their names: ``bodies["mass"]``. Fields of other shapes are declared as
``Annotated[Reals, (4, 3)]`` or ``Annotated[Integers, (2,)]``.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Generic, Self, TypeVar, get_args, get_type_hints, overload

import numpy as np
from numpy.typing import NDArray

from .kernel import records

Reals = NDArray[np.float64]
Integers = NDArray[np.int64]
ARRAY_TYPES: dict[Any, type[Any]] = {Reals: np.float64, Integers: np.int64}  # number types of array fields
f8 = Annotated[float, np.float64]
i8 = Annotated[int, np.int64]
Vec3 = Annotated[Reals, (3,)]
Vec6 = Annotated[Reals, (6,)]
Mat3 = Annotated[Reals, (3, 3)]
Mat6 = Annotated[Reals, (6, 6)]

R = TypeVar("R", bound="Record")


class Record:
    """Base of all records.

    Attributes
    ----------
    dtype
        Fields, made of the annotations of the class.
    """

    dtype: ClassVar[np.dtype[Any]]

    def __init_subclass__(cls) -> None:
        """Make the dtype."""
        hints = get_type_hints(cls, include_extras=True)
        cls.dtype = np.dtype([_field(name, hint) for name, hint in hints.items() if name != "dtype"], align=True)

    @classmethod
    def zeros(cls, count: int) -> Table[Self]:
        """Return ``count`` zeroed records."""
        return records(count, cls.dtype)  # type: ignore[return-value]

    if TYPE_CHECKING:

        def __getitem__(self, name: str) -> Any: ...
        def __setitem__(self, name: str, value: Any) -> None: ...


def _field(name: str, hint: Any) -> tuple[str, type[Any], tuple[int, ...]]:
    """Return a field of a dtype: its name, number type and shape."""
    base, meant = get_args(hint)
    if isinstance(meant, tuple):
        return name, ARRAY_TYPES[base], meant
    return name, meant, ()


if TYPE_CHECKING:

    class Table(np.ndarray[tuple[int], np.dtype[Any]], Generic[R]):
        """Array of records (n,): an element is a record, and a name gives the array of one field."""

        @overload  # type: ignore[override]
        def __getitem__(self, key: int | np.integer[Any]) -> R: ...
        @overload
        def __getitem__(self, key: Any) -> NDArray[Any]: ...
        def __getitem__(self, key: Any) -> Any: ...
        def __iter__(self) -> Iterator[R]: ...

else:
    Table = NDArray  # what it is when the program runs
