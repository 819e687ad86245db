"""Work that is given up where it would have to wait for the compiler."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from solvers.compiled import cache


class NotCompiled(BaseException):
    """Something is needed that was not compiled before; no error, so that nobody on the way takes it for one."""


@contextmanager
def compiling_nothing() -> Iterator[None]:
    """Have :class:`NotCompiled` raised in this block before anything is compiled. Who listens around it hears nothing
    of that, and is told when something is compiled after all.
    """

    def refuse() -> None:
        raise NotCompiled

    around = cache._listeners.copy()
    cache._listeners[:] = [refuse]
    try:
        yield
    finally:
        cache._listeners[:] = around
