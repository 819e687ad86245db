"""The checksum of a model's file: CRC-64 of ECMA-182, reflected, as in the format xz."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solvers.compiled.kernel import kernel

CRC_POLYNOMIAL = 0xC96C5795D7870F42
CRC_MASK = (1 << 64) - 1


def crc64(data: bytes) -> int:
    """Return the CRC-64 of bytes as a signed whole number of eight bytes.

    It differs wherever up to 64 neighboring bits differ, and else but in one case of 2^64.
    """
    crc = np.full(1, CRC_MASK, np.uint64)
    update(crc, np.frombuffer(data, np.uint8), _table())
    return int((crc ^ np.uint64(CRC_MASK)).view(np.int64)[0])


@cache
def _table() -> NDArray[np.uint64]:
    """Return the remainders of all bytes (256,)."""
    crc = np.arange(256, dtype=np.uint64)
    for _ in range(8):
        crc = np.where(crc & np.uint64(1), crc >> np.uint64(1) ^ np.uint64(CRC_POLYNOMIAL), crc >> np.uint64(1))
    return crc


@kernel
def update(crc: Any, data: Any, table: Any) -> None:
    """Continue a checksum (1,) by bytes."""
    for byte in data:
        crc[0] = table[(crc[0] ^ byte) & np.uint64(255)] ^ (crc[0] >> np.uint64(8))
