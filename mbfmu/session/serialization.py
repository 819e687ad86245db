"""States as bytes that can be trusted: framed with whose they are, their length, and a checksum of all of it.

A state is a head, which JSON holds, and a body of bytes.
"""

from __future__ import annotations

import json
from hashlib import blake2b
from typing import Any
from zlib import crc32

from mbfmu.util.errors import UserError

STATE_MAGIC = b"mbfmu4th"
CHECKSUM_BYTES, KEY_BYTES, LENGTH_BYTES = 4, 16, 8  # bytes
CHECKED_OFFSET = len(STATE_MAGIC) + CHECKSUM_BYTES  # where what is checked begins
HEADER_BYTES = CHECKED_OFFSET + KEY_BYTES + LENGTH_BYTES  # what stands before the content


def encode_state(key: str, head: dict[str, Any], body: bytes) -> bytes:
    """Return a state as bytes; ``key`` identifies what can restore it."""
    text = json.dumps(head).encode()
    content = len(text).to_bytes(LENGTH_BYTES, "little") + text + body
    checked = _digest(key) + len(content).to_bytes(LENGTH_BYTES, "little")
    return b"".join((STATE_MAGIC, crc32(content, crc32(checked)).to_bytes(CHECKSUM_BYTES, "little"), checked, content))


def decode_state(key: str, data: bytes) -> tuple[dict[str, Any], bytes]:
    """Return head and body of :func:`encode_state`; raises UserError where the state is damaged or another owner's."""
    if not isinstance(data, bytes):
        raise UserError(f"a saved state is {data!r}; allowed: bytes that save() returned", "saved-state")
    if len(data) < HEADER_BYTES or data[: len(STATE_MAGIC)] != STATE_MAGIC:
        raise UserError(
            f"a saved state of {len(data)} bytes is not one of this version of mbfmu; save it again", "saved-state"
        )
    length = int.from_bytes(data[CHECKED_OFFSET + KEY_BYTES : HEADER_BYTES], "little")
    if length != len(data) - HEADER_BYTES:
        raise UserError(
            f"a saved state is damaged: it has {len(data) - HEADER_BYTES} bytes instead of {length}; save it again",
            "saved-state",
        )
    if crc32(memoryview(data)[CHECKED_OFFSET:]) != int.from_bytes(data[len(STATE_MAGIC) : CHECKED_OFFSET], "little"):
        raise UserError("a saved state is damaged: its checksum differs; save it again", "saved-state")
    if data[CHECKED_OFFSET : CHECKED_OFFSET + KEY_BYTES] != _digest(key):
        raise UserError(
            "a saved state belongs to another model, to other values of fixed parameters, or to another solver; "
            "restore "
            "a state of the same model, parameters and solver",
            "saved-state",
        )
    split = HEADER_BYTES + LENGTH_BYTES + int.from_bytes(data[HEADER_BYTES : HEADER_BYTES + LENGTH_BYTES], "little")
    return json.loads(data[HEADER_BYTES + LENGTH_BYTES : split]), data[split:]


def _digest(key: str) -> bytes:
    return blake2b(key.encode(), digest_size=KEY_BYTES).digest()
