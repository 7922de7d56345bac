"""The sums of a batch, as numpy arrays of int64: reads all codecs, writes the raw one."""
import hashlib
import struct

import numpy as np
import zstandard

from kit.wire import Malformed

CHUNK = 65536  # pixels
BDPT, PATH, LIGHT = 1, 2, 3  # Settings.integrator
LAYERED_SAMPLES = 32  # features and mattes are of the first so many

# The values of a pixel, and how they are shared out to the bands of a chunk. Frames are like tiles but for the colours.
PLAIN = [range(0, 3)]
FRAME = [range(0, 3)]
LESSONS = [range(0, 1)]
LESSON_PLACES = 131072
FEATURES = [range(0, 3), range(3, 6), range(6, 9), range(9, 10), range(10, 12), range(12, 14)]
MATTES = [range(0, 3), range(3, 6), range(6, 9), range(9, 12), range(12, 15), range(15, 16)]


def content(settings, blob):
    """The hash of all that a sample depends on."""
    text = (f"scene {blob.hex()} integrator {settings.integrator} sampler {settings.sampler} seed {settings.seed} "
            f"size {settings.width}x{settings.height} depth {settings.max_depth} tile {settings.tile_size} "
            f"scale {settings.film_scale} strategy {settings.strategy_s} {settings.strategy_t} "
            f"unweighted {int(settings.unweighted)} features {int(settings.features)}")
    text += " cryptomatte" if settings.cryptomatte else ""
    text += " learn" if settings.learn else ""
    text += f" groups {settings.light_groups}" if settings.light_groups else ""
    text += f" merge {settings.merge_radius:.17g}" if settings.merge_radius else ""
    text += " spectral" if settings.spectral else ""
    return hashlib.blake2b(text.encode(), digest_size=32).digest()


def tile_size(settings, tile):
    """(width, height) of a tile in pixels."""
    size = settings.tile_size
    row, column = divmod(tile, -(-settings.width // size))
    return min(size, settings.width - column * size), min(size, settings.height - row * size)


def tile_count(settings):
    return -(-settings.width // settings.tile_size) * -(-settings.height // settings.tile_size)


def unit_samples(settings, unit):
    width, height = tile_size(settings, unit.tile)
    return width * height * unit.count


class Shape:
    """What the payloads of a batch hold, which follows from the settings and the units: for each payload the values of a pixel,
    by bands, and the number of values."""

    def __init__(self, settings, units):
        pixels = [int(np.prod(tile_size(settings, unit.tile))) for unit in units]
        layered = [count for unit, count in zip(units, pixels) if unit.first < LAYERED_SAMPLES]
        groups = len(settings.light_groups.split(",")) if settings.light_groups else 0
        frame = settings.width * settings.height
        splats = settings.integrator != PATH
        self.eye = sum(pixels) * 6
        self.splats = frame * 6 if splats else 0
        self.features = sum(layered) * 14 if settings.features and settings.integrator != LIGHT else 0
        self.mattes = sum(layered) * 16 if settings.cryptomatte else 0
        self.group_eye = sum(pixels) * 3 * groups
        self.group_splats = frame * 3 * groups if splats else 0
        learns = settings.learn and settings.integrator == BDPT and settings.strategy_t == 0
        self.lessons = LESSON_PLACES * (3 if settings.adaptive else 5) if learns else 0

    def parts(self):
        return [(PLAIN, self.eye), (FRAME, self.splats), (FEATURES, self.features), (MATTES, self.mattes), (PLAIN, self.group_eye),
                (FRAME, self.group_splats), (LESSONS, self.lessons)]


def encode(values):
    """A frame of codec 0, raw. None, or no values, is an empty frame."""
    if values is None or len(values) == 0:
        return b""
    return struct.pack("<BxxxI", 0, 0) + np.ascontiguousarray(values, dtype="<i8").tobytes()


def decode(frame, bands, count):
    """The values of a frame; None when the frame is empty, which stands for zeroes. Malformed when they are not `count` many."""
    if len(frame) == 0:
        return None
    if len(frame) < 8:
        raise Malformed("a payload without its head")
    codec, number = struct.unpack_from("<BxxxI", frame)
    if codec == 0:
        values = np.frombuffer(frame, dtype="<i8", offset=8)
        if len(values) != count:
            raise Malformed(f"{len(values)} values, where {count} are expected")
        return values.copy()
    if codec not in (1, 2):
        raise Malformed(f"codec {codec}")
    return _decode_bands(frame, number, bands, count, _interleaved if codec == 1 else _coloured if bands is FRAME else _apart)


def _decode_bands(frame, number, bands, count, read):
    sizes = struct.unpack_from(f"<{number}I", frame, 8)
    width = bands[-1].stop
    pixels, rest = divmod(count, width)
    chunks = [min(CHUNK, pixels - start) for start in range(0, pixels, CHUNK)]
    if rest or number != len(chunks) * len(bands) or sum(sizes) != len(frame) - 8 - 4 * number:
        raise Malformed("bands that do not fit the array")
    values, offset, at = np.zeros((pixels, width), dtype="<i8"), 8 + 4 * number, 0
    for index, chunk in enumerate(chunks):
        for place, band in enumerate(bands):
            size = sizes[index * len(bands) + place]
            part = _decode_band(frame[offset : offset + size], chunk, len(band), read)
            if len(bands) > 1:  # differences from the pixel before
                part = np.cumsum(part, axis=0, dtype=np.int64)
            values[at : at + chunk, band.start : band.stop] = part
            offset += size
        at += chunk
    return values.reshape(-1)


def _decode_band(data, pixels, width, read):
    values = np.zeros((pixels, width), dtype=np.int64)
    if len(data) == 0:
        return values
    mask, data = _block(data, -(-pixels // 8))
    present = np.unpackbits(np.frombuffer(mask, dtype=np.uint8), bitorder="little").astype(bool)
    if present[pixels:].any():
        raise Malformed("a band with a wrong mask")
    present = present[:pixels]
    values[present], data = read(data, int(present.sum()), width)
    if len(data) != 0:
        raise Malformed("a band that goes on behind its last block")
    return values


# How the values of the pixels that are present lie in a band; each gives (them, what follows).


def _interleaved(data, number, width):
    values, data = _stream(data, number * width)
    return values.reshape(-1, width), data


def _apart(data, number, width):
    values = np.zeros((number, width), dtype=np.int64)
    for lane in range(width):
        values[:, lane], data = _stream(data, number)
    return values, data


def _coloured(data, number, _):
    if len(data) == 0 or data[0] > 63 or len(data) < 1 + 8 * data[0]:
        raise Malformed("a band with wrong colours")
    colours = np.zeros((1 + data[0], 2), dtype=np.int64)
    colours[1:] = np.frombuffer(data, dtype="<u4", count=2 * data[0], offset=1).reshape(-1, 2)
    index, data = np.zeros(number, dtype=np.uint8), data[1 + 8 * data[0] :]
    if len(colours) > 1:
        part, data = _block(data, number)
        index = np.frombuffer(part, dtype=np.uint8)
    if index.max(initial=0) >= len(colours):
        raise Malformed("a pixel of a colour that is not there")
    known = index > 0
    red, data = _stream(data, number)
    values = np.zeros((number, 3), dtype=np.int64)
    for which in (~known, known):
        rest, data = _stream(data, 2 * int(which.sum()))
        values[which, 1:] = rest.reshape(-1, 2)
    with np.errstate(over="ignore"):
        upper, lower = (red >> 32)[:, None], (red & 0xFFFFFFFF).astype(np.uint64)[:, None]
        share = (lower * colours[index].astype(np.uint64) >> np.uint64(28)).view(np.int64)
        values[:, 1:] += (upper * colours[index] << 4) + share
    values[:, 0] = red
    return values, data


def _stream(data, number):
    """(so many values, what follows them)"""
    if len(data) == 0 or data[0] > 8:
        raise Malformed("a stream with a wrong number of planes")
    planes, data = data[0], data[1:]
    zigzag = np.zeros(number, dtype=np.uint64)
    for plane in range(planes):
        part, data = _block(data, number)
        zigzag |= np.frombuffer(part, dtype=np.uint8).astype(np.uint64) << np.uint64(8 * plane)
    return ((zigzag >> np.uint64(1)) ^ (np.uint64(0) - (zigzag & np.uint64(1)))).view(np.int64), data


def _block(data, size):
    """(bytes of the first block, what follows it)"""
    if len(data) < 4:
        raise Malformed("a block without its size")
    head = struct.unpack_from("<I", data)[0]
    stored, end = head >> 31, 4 + (head & 0x7FFFFFFF)
    if end > len(data):
        raise Malformed("a block that is longer than its band")
    part = bytes(data[4:end])
    if not stored:
        part = zstandard.ZstdDecompressor().decompress(part, max_output_size=size)
    if len(part) != size:
        raise Malformed(f"a block of {len(part)} bytes, where {size} are expected")
    return part, data[end:]


class Sums:
    """The seven payloads of a batch as arrays; those that the batch does not have are None."""

    NAMES = ("eye", "splats", "features", "mattes", "group_eye", "group_splats", "lessons")
    FRAMES = ("splats", "group_splats", "lessons")

    def __init__(self, settings, units, payloads=()):
        self.units = list(units)
        frames = [*payloads, *[b""] * (7 - len(payloads))]
        for name, frame, (bands, count) in zip(self.NAMES, frames, Shape(settings, units).parts()):
            setattr(self, name, decode(frame, bands, count))

    @classmethod
    def zero(cls, settings, units):
        """Sums of the right sizes, all 0."""
        sums = cls(settings, units)
        for name, (_, count) in zip(cls.NAMES, Shape(settings, units).parts()):
            setattr(sums, name, np.zeros(count, dtype=np.int64) if count else None)
        return sums

    def add(self, other):
        """Appends another batch: tiles one after the other, frames summed."""
        self.units += other.units
        for name in self.NAMES:
            mine, theirs = getattr(self, name), getattr(other, name)
            if mine is None or theirs is None:
                setattr(self, name, theirs if mine is None else mine)
            else:
                setattr(self, name, mine + theirs if name in self.FRAMES else np.concatenate((mine, theirs)))

    def payloads(self):
        frames = [encode(getattr(self, name)) for name in self.NAMES]
        while len(frames) > 3 and not frames[-1]:
            frames.pop()
        return frames
