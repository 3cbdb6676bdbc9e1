"""The image of a map file, checked before it is decoded, so that a broken one costs neither time nor memory.

Samples are what SDL_image gives to map_server: 8 bits each, a netpbm image scaled from its maxval, a PNG of 16 bits cut
to the upper 8. A netpbm image of 16 bits, which SDL_image refuses, is scaled too, and a palette means its colours.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import cv2
import numpy as np
import numpy.typing as npt

MAX_PIXELS = 200_000_000
FORMATS = "a PGM, PNG or BMP image of 8 or 16 bits a channel"

ByteArray = npt.NDArray[np.uint8]

_BAND_BYTES = 1 << 18
_MAX_HEADER = 1 << 16
_SPACE, _DIGITS = b" \t\r\n\v\f", b"0123456789"
_DEFLATE_RATIO = 1032  # no byte of a deflate stream stands for more
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# Of each colour type: samples a pixel, and the bits that one may have.
_PNG_GREY, _PNG_RGB, _PNG_PALETTE = 0, 2, 3
_PNG_TYPES = {0: (1, (1, 2, 4, 8, 16)), 2: (3, (8, 16)), 3: (1, (1, 2, 4, 8)), 4: (2, (8, 16)), 6: (4, (8, 16))}
# Of each pass: the first column and row, and the steps to the next ones.
_INTERLACED = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
_BMP_MASKS = (0xFF0000, 0xFF00, 0xFF)


class ImageError(Exception):
    """The image cannot be used; the text says what was expected."""


@dataclass(frozen=True, eq=False)
class MapImage:
    """Pixels in ``buffer`` (H * W * channels,), top row first, which is the caller's to change.

    One channel is grey, three are colours, of four the last is alpha. ``sdl_last`` is the channel that comes last in a
    pixel of SDL, whose order of colours is not the same for each format.
    """

    buffer: ByteArray
    height: int
    width: int
    channels: int
    sdl_last: int


def read_image(file: Path) -> MapImage:
    """Read an image file.

    Raises:
        ImageError: it is no such image, is incomplete or too large.
        OSError: it cannot be read.
    """
    with file.open("rb") as stream:
        start, size = stream.read(len(_PNG_SIGNATURE)), file.stat().st_size
        if start[:1] == b"P" and start[1:2] in (b"1", b"2", b"3", b"4", b"5", b"6"):
            stream.seek(2)
            return _read_netpbm(stream, size, int(start[1:2]))
        if start[:2] == b"BM":
            return _read_bmp(stream, size)
        if start == _PNG_SIGNATURE:
            return _read_png(stream, size, file)
    raise ImageError(FORMATS)


def _check_size(width: int, height: int) -> None:
    if not (width > 0 and height > 0 and width * height <= MAX_PIXELS):
        raise ImageError(f"an image of 1 to {MAX_PIXELS} pixels, not of {width} x {height}")


def _check_complete(needed: int, there: int) -> None:
    if there < needed:
        raise ImageError(f"a complete image: of at least {needed} bytes of pixels {there} are there")


# netpbm: PBM, PGM and PPM, plain and raw


def _read_netpbm(stream: IO[bytes], size: int, kind: int) -> MapImage:
    width, height = _header_number(stream, "width"), _header_number(stream, "height")
    is_bitmap, is_plain, channels = kind in (1, 4), kind <= 3, 3 if kind in (3, 6) else 1
    maxval = 1 if is_bitmap else _header_number(stream, "maxval")
    if not 1 <= maxval <= 65535:
        raise ImageError(f"a netpbm image with a maxval of 1 to 65535, not of {maxval}")
    _check_size(width, height)
    samples, row = width * height * channels, width * channels * (2 if maxval > 255 else 1)
    if is_plain:
        _check_complete(samples if is_bitmap else 2 * samples - 1, size - stream.tell())
        bands = _plain_bits(stream) if is_bitmap else _plain_samples(stream)
    else:
        row = (width + 7) // 8 if is_bitmap else row
        _check_complete(row * height, size - stream.tell())
        bands = _raw_samples(stream, row, height, maxval, width if is_bitmap else None)
    buffer, filled = np.empty(samples, dtype=np.uint8), 0
    for band in bands:
        used = band[: samples - filled]
        if used.size and used.max() > maxval:
            raise ImageError(f"a netpbm image with samples of at most {maxval}, its maxval, not of {used.max()}")
        scaled = used if maxval == 255 else used.astype(np.uint32) * 255 // maxval
        buffer[filled : filled + used.size] = 255 - scaled if is_bitmap else scaled
        filled += used.size
        if filled == samples:
            return MapImage(buffer, height, width, channels, channels - 1)
    raise ImageError(f"a complete image: of {samples} samples {filled} are there")


def _header_number(stream: IO[bytes], name: str) -> int:
    """The next number of the header, read with the one byte behind it; ``#`` begins a comment."""
    digits = b""
    while stream.tell() < _MAX_HEADER:
        byte = stream.read(1)
        if byte == b"#":
            stream.readline(_MAX_HEADER)
            byte = b"\n"
        if byte.isdigit() and len(digits) < 10:
            digits += byte
        elif not byte or byte not in _SPACE:
            break
        elif digits:
            return int(digits)
    raise ImageError(f"{FORMATS}; the header of this one has no number as {name}")


def _raw_samples(
    stream: IO[bytes], row: int, height: int, maxval: int, bits: int | None
) -> Iterator[npt.NDArray[np.integer]]:
    """Samples of rows of ``row`` bytes; or their first ``bits`` bits, when these are the samples."""
    rows = max(1, _BAND_BYTES // row)
    for first in range(0, height, rows):
        data = stream.read(row * min(rows, height - first))
        if bits is None:
            yield np.frombuffer(data, ">u2" if maxval > 255 else np.uint8)
        else:
            yield np.unpackbits(np.frombuffer(data, np.uint8).reshape(-1, row), axis=1, count=bits).ravel()


def _plain_bits(stream: IO[bytes]) -> Iterator[npt.NDArray[np.integer]]:
    for text in _plain_text(stream):
        yield np.frombuffer(text.translate(None, _SPACE), np.uint8) - np.uint8(ord("0"))


def _plain_samples(stream: IO[bytes]) -> Iterator[npt.NDArray[np.integer]]:
    rest = b""
    for text in _plain_text(stream):
        whole = (rest + text).rstrip(_DIGITS)
        rest = (rest + text)[len(whole) :]
        if len(rest) > _BAND_BYTES:
            raise ImageError("a plain netpbm image with samples, not with one long number")
        yield _numbers(whole)
    yield _numbers(rest)


def _numbers(text: bytes) -> npt.NDArray[np.int64]:
    return np.fromstring(text.decode("ascii"), np.int64, sep=" ") if text.strip() else np.empty(0, np.int64)


def _plain_text(stream: IO[bytes]) -> Iterator[bytes]:
    """Digits and white space in pieces, without comments."""
    in_comment = False
    while chunk := stream.read(_BAND_BYTES):
        pieces = []
        for i, piece in enumerate(chunk.split(b"#")):
            if in_comment or i > 0:
                _, newline, after = piece.partition(b"\n")
                in_comment = not newline
                pieces.append(newline + after)
            else:
                pieces.append(piece)
        text = b"".join(pieces)
        if text.translate(None, _SPACE + _DIGITS):
            raise ImageError("a plain netpbm image that has digits only")
        yield text


# BMP


def _read_bmp(stream: IO[bytes], size: int) -> MapImage:
    stream.seek(0)
    header = stream.read(66).ljust(66, b"\0")
    start, header_size, width, height, _, depth, compression = struct.unpack_from("<IIiiHHI", header, 10)
    used = struct.unpack_from("<I", header, 46)[0]
    has_masks = compression == 3 and depth == 32 and struct.unpack_from("<III", header, 54) == _BMP_MASKS
    if header_size < 40 or depth not in (1, 4, 8, 24, 32) or not (compression == 0 or has_masks):
        raise ImageError("an uncompressed BMP image of 1, 4, 8, 24 or 32 bits a pixel")
    is_upright, height = height > 0, abs(height)
    _check_size(width, height)
    row = (width * depth + 31) // 32 * 4
    _check_complete(row * height, size - start)
    palette, channels = np.arange(256, dtype=np.uint8)[:, None], depth // 8
    if depth <= 8:
        stream.seek(14 + header_size)
        entries = min(used or 2**depth, 2**depth)
        colours = np.frombuffer(stream.read(4 * entries).ljust(4 * entries, b"\0"), np.uint8).reshape(-1, 4)[:, :3]
        is_grey = bool((colours == colours[:, :1]).all())
        channels = 1 if is_grey else 3
        palette = np.zeros((256, channels), np.uint8)
        palette[:entries] = colours[:, :channels]
    buffer = np.empty(width * height * channels, dtype=np.uint8)
    pixels, rows = buffer.reshape(height, width * channels), max(1, _BAND_BYTES // row)
    pixels = pixels[::-1] if is_upright else pixels
    stream.seek(start)
    for first in range(0, height, rows):
        last = min(height, first + rows)
        band = np.frombuffer(stream.read(row * (last - first)), np.uint8).reshape(-1, row)
        if depth <= 8:
            bits = np.unpackbits(band, axis=1).reshape(len(band), -1, depth)[:, :width]
            band = palette[np.packbits(bits, axis=2)[:, :, 0] >> (8 - depth)].reshape(len(band), -1)
        pixels[first:last] = band[:, : width * channels]
    return MapImage(buffer, height, width, channels, channels - 1)


# PNG: checked here, decoded by OpenCV


def _read_png(stream: IO[bytes], size: int, file: Path) -> MapImage:
    header = _chunk_header(stream, size)
    fields = stream.read(13)
    if header != (13, b"IHDR") or not _has_check_sum(stream, zlib.crc32(b"IHDR" + fields)):
        raise ImageError("a PNG image that begins with its header")
    width, height, depth, kind, compression, method, interlaced = struct.unpack(">IIBBBBB", fields)
    samples, depths = _PNG_TYPES.get(kind, (0, ()))
    if depth not in depths or compression or method or interlaced > 1:
        raise ImageError("a PNG image with a header of the standard")
    _check_size(width, height)
    needed = 0
    for x, y, dx, dy in _INTERLACED if interlaced else ((0, 0, 1, 1),):
        columns, rows = max(0, -(-(width - x) // dx)), max(0, -(-(height - y) // dy))
        needed += rows * (1 + (columns * samples * depth + 7) // 8) if columns else 0
    _check_complete(needed, _DEFLATE_RATIO * size)
    extras = _check_pixels(stream, size, needed)
    if kind == _PNG_PALETTE and b"PLTE" not in extras:
        raise ImageError("a PNG image with its palette")
    if kind == _PNG_GREY:
        return _decoded(file, width, height, 1, cv2.IMREAD_GRAYSCALE)
    if kind == _PNG_RGB or (kind == _PNG_PALETTE and b"tRNS" not in extras):
        return _decoded(file, width, height, 3, cv2.IMREAD_COLOR)
    return _decoded(file, width, height, 4, cv2.IMREAD_UNCHANGED, depth)


def _check_pixels(stream: IO[bytes], size: int, needed: int) -> set[bytes]:
    """The kinds of the chunks up to the end, when these are sound and ``needed`` bytes of pixels are in them."""
    inflater, there, kinds = zlib.decompressobj(), 0, set[bytes]()
    while b"IEND" not in kinds:
        length, kind = _chunk_header(stream, size)
        if kind == b"acTL":
            raise ImageError("a PNG image that is not animated")
        check_sum = zlib.crc32(kind)
        for first in range(0, length, _BAND_BYTES):
            data = stream.read(min(_BAND_BYTES, length - first))
            check_sum = zlib.crc32(data, check_sum)
            try:
                while kind == b"IDAT" and data and there < needed:
                    there += len(inflater.decompress(data, _BAND_BYTES))
                    data = inflater.unconsumed_tail
            except zlib.error as exc:
                raise ImageError(f"a PNG image with sound pixels ({exc})") from exc
        if not _has_check_sum(stream, check_sum):
            raise ImageError(f"a PNG image whose chunk {kind!r} has the right check sum")
        kinds.add(kind)
    _check_complete(needed, there)
    return kinds


def _chunk_header(stream: IO[bytes], size: int) -> tuple[int, bytes]:
    """Length and kind of the next chunk."""
    length, kind = struct.unpack(">I4s", stream.read(8).ljust(8, b"\0"))
    if length + 4 > size - stream.tell():
        raise ImageError(f"a complete PNG image: it ends within chunk {kind!r}")
    return length, kind


def _has_check_sum(stream: IO[bytes], expected: int) -> bool:
    return stream.read(4) == expected.to_bytes(4, "big")


def _decoded(file: Path, width: int, height: int, channels: int, flags: int, depth: int = 8) -> MapImage:
    """Decoded into memory of our own, as OpenCV's would be a second copy. Only alpha brings 16 bits with it."""
    samples = width * height * channels
    buffer = np.zeros(samples, np.uint16) if depth == 16 else np.zeros(samples, np.uint8)
    pixels = buffer.reshape((height, width, channels) if channels > 1 else (height, width))
    if flags != cv2.IMREAD_UNCHANGED:
        flags |= cv2.IMREAD_IGNORE_ORIENTATION
    try:
        found = cv2.imread(str(file), pixels, flags)
    except cv2.error as exc:
        raise ImageError(f"a PNG image that can be decoded ({exc.err})") from exc
    if found is None or not np.shares_memory(found, pixels):
        raise ImageError("a PNG image that can be decoded")
    octets = (buffer >> 8 if depth == 16 else buffer).astype(np.uint8, copy=False)
    return MapImage(octets, height, width, channels, 3 if channels == 4 else 0)
