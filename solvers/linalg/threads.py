"""Number of threads of BLAS."""

from __future__ import annotations

from typing import Any

from threadpoolctl import ThreadpoolController

_threads = ThreadpoolController()


def one_thread() -> Any:
    """Return a context in which BLAS keeps to one thread: matrices of some hundred rows only lose by more."""
    return _threads.limit(limits=1, user_api="blas")
