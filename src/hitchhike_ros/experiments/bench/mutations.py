"""Files that went wrong: what a seed makes of the bytes of a sound file."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Sequence

import numpy as np

MAX_BYTES = 1_000_000

# What people and programs write where a number, a name or a structure should stand.
_NUMBERS = (
    *(b"0", b"-1", b"-0", b"nan", b".nan", b".inf", b"-.inf", b"1e400", b"1e-320", b"010", b"0x10", b"1:30", b"1_000"),
    *(
        b"9" * 20,
        b"9" * 400,
        b"2026-12-01",
        b"''",
        b'""',
        b"~",
        b"null",
        b"true",
        b"no",
        b"[]",
        b"{}",
        b"[[]]",
        b"{a: 1}",
    ),
)
_YAML = (
    *(b"!!int x", b"!!python/none", b"!!binary x", b"!!set {}", b"&a", b"*a", b"&a [*a]", b"<<: *a", b"<<: {}"),
    *(b"? ", b"- ", b"---\n", b"...\n", b"%YAML 1.1\n", b"#", b"|\n", b">\n", b"'", b'"'),
)
_XML = (
    *(b"<a>", b"</robot>", b"<!--", b"<![CDATA[", b"&lt;", b"&x;", b"<xacro:a/>", b"<joint/>", b"${x}", b"$(find x)"),
    *(b'xyz="0 0"', b'link="base_link"'),
)
_BYTES = (
    b"\t",
    b"\r",
    b"\0",
    b"\xff",
    b"\xef\xbb\xbf",
    b"\xc2\x85",
    b"\xf0\x9f\xa4\x96",
    b"../",
    b"/dev/zero",
    b"x" * 300,
)
_WORDS = (*_NUMBERS, *_YAML, *_XML, *_BYTES)
_NUMBER = re.compile(rb"-?\d+(?:\.\d*)?")
_TOKEN = re.compile(rb"[\w.]+")

Mutation = Callable[[bytes, Sequence[bytes], np.random.Generator], bytes]


def mutate(original: bytes, others: Sequence[bytes], rng: np.random.Generator) -> bytes:
    """``original`` after a few mutations, which may take pieces of ``others``; at most 1 MB."""
    data = original
    for _ in range(int(rng.integers(1, 5))):
        data = _MUTATIONS[rng.integers(len(_MUTATIONS))](data, others, rng)[:MAX_BYTES]
    return data


def mutate_png(rng: np.random.Generator) -> bytes:
    """A PNG of at most 1 M cells with right check sums, whose header and pixels may contradict each other."""
    width, height = (int(2 ** rng.uniform(0.0, 9.9)) for _ in range(2))
    depth, colour = int(rng.choice([1, 2, 4, 8, 16, 3])), int(rng.choice([0, 2, 3, 4, 6, 5]))
    samples = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}.get(colour, 1)
    size = height * (1 + (width * samples * depth + 7) // 8) + int(rng.choice([0, 0, 0, 1, -1, -7]))
    rows = rng.integers(0, 256, max(size, 0), dtype=np.uint8)
    rows[:: max(1, size // max(height, 1))] = rng.integers(0, int(rng.choice([5, 6])))
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, int(rng.random() < 0.2))
    chunks = [(b"IHDR", header)]
    if rng.random() < 0.5 or colour == 3:
        chunks.append((b"PLTE", rng.bytes(3 * int(rng.integers(0, 300)))))
    if rng.random() < 0.4:
        chunks.append((b"tRNS", rng.bytes(int(rng.integers(0, 300)))))
    if rng.random() < 0.2:
        chunks.append(
            (bytes(rng.choice([b"gAMA", b"eXIf", b"iCCP", b"sBIT", b"acTL", b"fcTL", b"abcD"])), rng.bytes(30))
        )
    chunks.append((b"IDAT", zlib.compress(rows.tobytes(), 1)))
    if rng.random() < 0.9:
        chunks.append((b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )


def _span(data: bytes, rng: np.random.Generator, most: int = 64) -> tuple[int, int]:
    first = int(rng.integers(len(data) + 1))
    return first, min(len(data), first + int(rng.integers(1, most)))


def _flip(data: bytes, _others: Sequence[bytes], rng: np.random.Generator) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        changed[rng.integers(len(data))] = rng.integers(256)
    return bytes(changed)


def _cut(data: bytes, _others: Sequence[bytes], rng: np.random.Generator) -> bytes:
    first, last = _span(data, rng)
    return data[:first] if rng.random() < 0.3 else data[:first] + data[last:]


def _repeat(data: bytes, _others: Sequence[bytes], rng: np.random.Generator) -> bytes:
    first, last = _span(data, rng)
    times = int(2 ** rng.uniform(0.0, 18.0 if rng.random() < 0.05 else 6.0))
    piece = data[first:last]
    return data[:first] + piece * min(times, MAX_BYTES // max(len(piece), 1)) + data[last:]


def _splice(data: bytes, others: Sequence[bytes], rng: np.random.Generator) -> bytes:
    other = others[rng.integers(len(others))]
    first, last = _span(other, rng, 400)
    at, end = _span(data, rng)
    return data[:at] + other[first:last] + data[at if rng.random() < 0.5 else end :]


def _insert(data: bytes, _others: Sequence[bytes], rng: np.random.Generator) -> bytes:
    at = int(rng.integers(len(data) + 1))
    return data[:at] + _WORDS[rng.integers(len(_WORDS))] + data[at:]


def _replace(pattern: re.Pattern[bytes]) -> Mutation:
    def replace(data: bytes, _others: Sequence[bytes], rng: np.random.Generator) -> bytes:
        found = list(pattern.finditer(data[:20_000]))
        if not found:
            return data
        match = found[rng.integers(len(found))]
        return data[: match.start()] + _WORDS[rng.integers(len(_WORDS))] + data[match.end() :]

    return replace


def _move_line(data: bytes, _others: Sequence[bytes], rng: np.random.Generator) -> bytes:
    lines = data[:20_000].split(b"\n")
    line = lines.pop(int(rng.integers(len(lines)))) if rng.random() < 0.5 else lines[rng.integers(len(lines))]
    lines.insert(int(rng.integers(len(lines) + 1)), line)
    return b"\n".join(lines) + data[20_000:]


def _nest(data: bytes, _others: Sequence[bytes], rng: np.random.Generator) -> bytes:
    opening, closing = ((b"[", b"]"), (b"{a: ", b"}"), (b"<link>", b"</link>"), (b"- ", b""))[rng.integers(4)]
    at, depth = int(rng.integers(len(data) + 1)), int(2 ** rng.uniform(0.0, 13.0))
    return data[:at] + opening * depth + closing * depth + data[at:]


_MUTATIONS: tuple[Mutation, ...] = (
    _flip, _cut, _repeat, _splice, _insert, _replace(_NUMBER), _replace(_NUMBER), _replace(_TOKEN), _move_line, _nest
)  # fmt: skip
