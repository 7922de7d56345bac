"""Messages: a header frame with a checked envelope, and payload frames."""
import struct

import numpy as np

import lightmill_pb2 as lm

VERSION = 8
MAGIC = b"LMIL"
LARGEST_HEADER = 1 << 20

USAGE, INPUT, IO, PROTOCOL, LIMIT, UNREACHABLE, CANCELLED, MISMATCH, DENIED = range(1, 10)  # Refusal.code


class Malformed(Exception):
    """What came is no message of this protocol."""


class Refused(Exception):
    """A Refusal came in answer."""

    def __init__(self, refusal):
        super().__init__(f"refused with code {refusal.code}: {refusal.reason}")
        self.code, self.reason = refusal.code, refusal.reason


# ---- CRC-32C: many lanes at once, since Python is slow byte by byte ----


def _table():
    table = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        table = (table >> np.uint32(1)) ^ (np.uint32(0x82F63B78) * (table & np.uint32(1)))
    return table


_TABLE = _table()
_LANE = 512  # bytes


def _bytewise(state, data):
    table = _TABLE_LIST
    for byte in data:
        state = table[(state ^ byte) & 255] ^ (state >> 8)
    return state


_TABLE_LIST = [int(value) for value in _TABLE]


def _after_zeroes(count):
    """Four tables: what a state becomes after `count` zero bytes is linear in its bits, so in its bytes."""
    basis = [_bytewise(1 << bit, bytes(count)) for bit in range(32)]
    tables = []
    for place in range(4):
        table = [0] * 256
        for value in range(256):
            for bit in range(8):
                if value >> bit & 1:
                    table[value] ^= basis[8 * place + bit]
        tables.append(table)
    return tables


_SKIP = _after_zeroes(_LANE)


def crc32c(data, state=0):
    """The CRC-32C of `data`; `state` is that of what came before it."""
    data = memoryview(data).cast("B")
    state ^= 0xFFFFFFFF
    lanes = len(data) // _LANE
    if lanes > 1:
        rows = np.frombuffer(data[: lanes * _LANE], dtype=np.uint8).reshape(lanes, _LANE).T.astype(np.uint32, order="C")
        states = np.zeros(lanes, dtype=np.uint32)
        for row in rows:
            states = _TABLE[(states ^ row) & np.uint32(255)] ^ (states >> np.uint32(8))
        a, b, c, d = _SKIP
        for lane in states.tolist():
            state = a[state & 255] ^ b[state >> 8 & 255] ^ c[state >> 16 & 255] ^ d[state >> 24] ^ lane
        data = data[lanes * _LANE :]
    return _bytewise(state, data) ^ 0xFFFFFFFF


# ---- messages ----


def _checksum(packed, payloads):
    state = crc32c(packed)
    for payload in payloads:
        state = crc32c(payload, crc32c(struct.pack("<Q", len(payload)), state))
    return state


def pack(body, request=0, payloads=()):
    """The frames of a message; `body` is a message that Envelope has a field for."""
    envelope = lm.Envelope(request=request)
    getattr(envelope, FIELD[type(body)]).CopyFrom(body)
    packed = envelope.SerializeToString()
    return [MAGIC + struct.pack("<BI", VERSION, _checksum(packed, payloads)) + packed, *payloads]


def unpack(frames):
    """(request, body, payloads) of the frames of a message."""
    head = frames[0]
    if len(head) < 9 or head[:4] != MAGIC:
        raise Malformed("no header")
    if head[4] != VERSION:
        raise Malformed(f"version {head[4]}, where this is version {VERSION}")
    if struct.unpack("<I", head[5:9])[0] != _checksum(head[9:], frames[1:]):
        raise Malformed("a wrong checksum")
    envelope = lm.Envelope.FromString(head[9:])
    kind = envelope.WhichOneof("body")
    if kind is None:
        raise Malformed("no body that is known")
    return envelope.request, getattr(envelope, kind), frames[1:]


FIELD = {getattr(lm, field.message_type.name): field.name for field in lm.Envelope.DESCRIPTOR.oneofs_by_name["body"].fields}
