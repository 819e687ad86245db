"""States as bytes that can be trusted: framed with whose they are, their length, and a checksum of all of it."""

from __future__ import annotations

from hashlib import blake2b

from mbfmu.errors import UserError

MAGIC = b"mbfmu1st"
DIGEST = 16  # bytes of a checksum
HEAD = len(MAGIC) + 2 * DIGEST + 8


def frame(owner: str, content: bytes) -> bytes:
    """Return the content with its head; ``owner`` says what can take it up."""
    described = _digest(owner.encode()) + len(content).to_bytes(8, "little")
    return b"".join((MAGIC, _digest(described + content), described, content))


def unframe(owner: str, framed: bytes) -> bytes:
    """Return the content of :func:`frame`; raises UserError where it is damaged or another owner's."""
    if not isinstance(framed, bytes):
        raise UserError(f"{framed!r} was given as a saved state; allowed: bytes that were saved")
    if len(framed) < HEAD or framed[: len(MAGIC)] != MAGIC:
        raise UserError(f"{len(framed)} bytes were given as a saved state; they are none of this version of mbfmu")
    checksum, described = framed[len(MAGIC) :][:DIGEST], framed[len(MAGIC) + DIGEST : HEAD]
    length = int.from_bytes(described[DIGEST:], "little")
    if length != len(framed) - HEAD:
        raise UserError(f"a saved state of {length} bytes has {len(framed) - HEAD}: it is damaged")
    if checksum != _digest(framed[len(MAGIC) + DIGEST :]):
        raise UserError("a saved state is damaged: its checksum does not fit")
    if described[:DIGEST] != _digest(owner.encode()):
        raise UserError(
            "a saved state is that of another model, of other parameters that are fixed, or of another solver"
        )
    return framed[HEAD:]


def _digest(content: bytes) -> bytes:
    return blake2b(content, digest_size=DIGEST).digest()
