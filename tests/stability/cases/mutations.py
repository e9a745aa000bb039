"""Damage to files: what a broken disk, a hasty editor, another program or an attacker would make of a valid one.

`mutate(data, rng)` returns damaged bytes; where they are JSON, PNG or text with numbers, their structure is damaged.
"""

from __future__ import annotations

import json
import re
import struct
import zlib
from typing import Any

import numpy as np

# What takes the place of a number in text.
NUMBERS = (
    b"NaN nan inf -inf Infinity -1 0 1e308 -1e308 1e999 1e-320 99999999999999999999 4294967296 2147483648 -2147483649"
    b" 65536 1e7 0.5 1_000 0x10 1,5 -0 +1 1e 1.0.0 true null \xd9\xa3 \xef\xbc\x91 \xc2\xb2 \xff"
).split()
# What takes the place of a JSON value.
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, -1, 2, 0.5, 1e308, -1e308, 10**30, float("nan"), float("inf"), "", "x", "0", "NaN"),
    *("../../etc/passwd", "/", "a\x00b", "\ud800", [], {}, [[]], [None], [1, 2, 3], [[1, 2], [3]], {"0": {}}),
    *([1e308] * 16, [0.0] * 9, [float("nan")] * 16, list(range(100)), "x" * 10_000),
)
_NUMBER = re.compile(rb"(?<![\w.])[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?(?![\w.])")
DEEP = 100_000


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """Damaged once or a few times over."""
    for _ in range(int(rng.choice([1, 1, 1, 2, 4]))):
        data = _KINDS[int(rng.integers(len(_KINDS)))](data, rng)
    return data


def _flips(data: bytes, rng: np.random.Generator) -> bytes:
    if not data:
        return b"\x00"
    out = np.frombuffer(data, dtype=np.uint8).copy()
    # headers decide more than bodies do: half of the time the first bytes
    reach = len(out) if rng.random() < 0.5 else min(len(out), 128)
    for _ in range(int(rng.integers(1, 9))):
        out[rng.integers(reach)] ^= np.uint8(1 << rng.integers(8))
    return out.tobytes()


def _cut(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: int(rng.integers(len(data) + 1))]


def _without_a_piece(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = sorted(rng.integers(len(data) + 1, size=2))
    return data[:a] + data[b:]


def _a_piece_twice(data: bytes, rng: np.random.Generator) -> bytes:
    a, b = sorted(rng.integers(len(data) + 1, size=2))
    return data[:b] + data[a:b] + data[b:]


def _strange_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(data) + 1))
    piece = (
        b"\xff\xfe",
        b"\xef\xbb\xbf",
        b"\x00" * 8,
        b"\xc3\x28",
        b"\r",
        b"\n\n\n",
        b'"',
        b",",
        b"\x1a",
        rng.bytes(16),
    )
    return data[:at] + piece[int(rng.integers(len(piece)))] + data[at:]


def _other_number(data: bytes, rng: np.random.Generator) -> bytes:
    found = list(_NUMBER.finditer(data[:200_000]))
    if not found:
        return _flips(data, rng)
    # the first numbers of a file are its counts
    one = found[int(rng.integers(min(len(found), 6) if rng.random() < 0.5 else len(found)))]
    return data[: one.start()] + NUMBERS[int(rng.integers(len(NUMBERS)))] + data[one.end() :]


def _other_line(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    i, j = rng.integers(len(lines), size=2)
    kind = rng.integers(4)
    if kind == 0:
        del lines[int(i)]
    elif kind == 1:
        lines[i], lines[j] = lines[j], lines[i]
    elif kind == 2:
        lines.insert(int(i), lines[j])
    else:
        words = lines[i].split()
        lines[i] = b" ".join(words[: int(rng.integers(len(words) + 1))])
    return b"\n".join(lines)


def _other_value(data: bytes, rng: np.random.Generator) -> bytes:
    """JSON with one value of another type, a key less, or nested without end; a PNG of other sizes; else a number."""
    if data[:4] == b"\x89PNG":
        return _other_chunk(data, rng)
    if data[:1] not in (b"{", b"["):
        return _other_number(data, rng)
    if rng.random() < 0.03:
        return b"[" * DEEP + b"]" * DEEP if rng.random() < 0.5 else b'{"0":' * DEEP + b"1" + b"}" * DEEP
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        return _flips(data, rng)
    places = list(_places(content))
    if not places:
        return _flips(data, rng)
    holder, key = places[int(rng.integers(len(places)))]
    kind = rng.integers(4)
    if kind == 0:
        del holder[key]
    elif kind == 1 and isinstance(holder, dict):
        holder[("-1", "x", "00", "1e3", "", "99999999999999999999", "\u0663")[int(rng.integers(7))]] = holder[key]
    else:
        holder[key] = VALUES[int(rng.integers(len(VALUES)))]
    return json.dumps(content).encode("utf-8", errors="surrogatepass")


def _places(content: Any, most: int = 2000) -> list[tuple[Any, Any]]:
    """Every (container, key) of a JSON content, the first so many."""
    found: list[tuple[Any, Any]] = []
    pending = [content]
    while pending and len(found) < most:
        holder = pending.pop()
        if isinstance(holder, dict):
            keys: list[Any] = list(holder)
        elif isinstance(holder, list):
            keys = list(range(len(holder)))
        else:
            continue
        found += [(holder, key) for key in keys]
        pending += [holder[key] for key in keys]
    return found


def _other_chunk(data: bytes, rng: np.random.Generator) -> bytes:
    """A PNG whose header tells another size, depth or colour, its checksum right."""
    if len(data) < 33:
        return _flips(data, rng)
    header = bytearray(data[16:29])
    kind = rng.integers(3)
    if kind == 0:
        sizes = (0, 1, 7, 3000, 20_000, 46_341, 1_000_000, 2**31 - 1, 2**32 - 1)
        header[0:8] = struct.pack(">II", *(sizes[int(i)] for i in rng.integers(len(sizes), size=2)))
    elif kind == 1:
        header[8] = int(rng.choice([0, 1, 2, 4, 8, 16, 32, 255]))
    else:
        header[9] = int(rng.choice([0, 1, 2, 3, 4, 6, 7]))
    checksum = struct.pack(">I", zlib.crc32(b"IHDR" + bytes(header)))
    return data[:16] + bytes(header) + checksum + data[33:]


_KINDS = (
    _flips,
    _cut,
    _without_a_piece,
    _a_piece_twice,
    _strange_bytes,
    _other_number,
    _other_number,
    _other_line,
    _other_value,
    _other_value,
)
