"""The checksum of a model's file: CRC-64 of ECMA-182, reflected, as in the format xz."""

from __future__ import annotations

CRC_POLYNOMIAL = 0xC96C5795D7870F42
CRC_MASK = (1 << 64) - 1


def crc64(data: bytes) -> int:
    """Return the CRC-64 of bytes as a signed whole number of eight bytes.

    It differs wherever up to 64 neighboring bits differ, and else but in one case of 2^64.
    """
    table = []
    for k in range(256):
        crc = k
        for _ in range(8):
            crc = crc >> 1 ^ CRC_POLYNOMIAL if crc & 1 else crc >> 1
        table.append(crc)
    crc = CRC_MASK
    for byte in data:
        crc = table[(crc ^ byte) & 255] ^ crc >> 8
    crc ^= CRC_MASK
    return crc - (1 << 64) if crc >> 63 else crc
