"""A reader of the OpenEXR files that Lightmill writes, with zlib and numpy.

It reads what is one image of scanlines: compression none, ZIPS or ZIP; channels of half, float or uint. Other files
are an ImageError. Only the channels that are asked for are unpacked. The format: "OpenEXR File Layout", openexr.com.
"""
import os
import struct
import zlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from .errors import ImageError

MAGIC = 20000630
MULTIPART, DEEP, TILED = 1 << 12, 1 << 11, 1 << 9
LINES = {0: 1, 2: 1, 3: 16}  # of a chunk, by compression
NAMES = {1: "RLE", 4: "PIZ", 5: "PXR24", 6: "B44", 7: "B44A", 8: "DWAA", 9: "DWAB"}
TYPES = {0: np.dtype("<u4"), 1: np.dtype("<f2"), 2: np.dtype("<f4")}
MAX_SIDE = 1 << 20
ORDER = {name: place for place, name in enumerate("RGBAXYZ")}


def _undo_prediction(data):
    """Bytes were stored as differences, those of even places first."""
    sums = np.frombuffer(data, np.uint8).copy()
    sums[1:] -= 128  # modulo 256
    np.cumsum(sums, dtype=np.uint8, out=sums)
    out = np.empty_like(sums)
    half = (len(sums) + 1) // 2
    out[0::2], out[1::2] = sums[:half], sums[half:]
    return out.tobytes()


def _unpack_zip(data, size):
    unpacker = zlib.decompressobj()
    try:
        out = unpacker.decompress(data, size)
    except zlib.error as error:
        raise ImageError(f"the image is damaged: {error}") from error
    return _undo_prediction(out)


UNPACK = {0: lambda data, size: data, 2: _unpack_zip, 3: _unpack_zip}


class _Cursor:
    """Reads a header from bytes."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, count):
        if count < 0 or count > len(self.data) - self.at:
            raise ImageError("the image's header is cut short")
        self.at += count
        return self.data[self.at - count:self.at]

    def unpack(self, layout):
        return struct.unpack(layout, self.take(struct.calcsize(layout)))

    def text(self):
        end = self.data.find(b"\0", self.at, self.at + 256)
        if end < 0:
            raise ImageError("the image's header has a name without an end")
        text = self.take(end - self.at)
        self.take(1)
        return text.decode("utf-8", "replace")


def _read_channels(data):
    cursor, channels = _Cursor(data), []
    while name := cursor.text():
        kind, _, wide, high = cursor.unpack("<iIii")
        if kind not in TYPES or (wide, high) != (1, 1):
            raise ImageError(f"channel {name} has another type or resolution than Lightmill writes")
        channels.append((name, TYPES[kind]))
    if not channels:
        raise ImageError("the image has no channels")
    return channels


def _read_value(kind, data):
    """An attribute of the kinds that a person asks for; others stay bytes."""
    if kind == "string":
        return data.decode("utf-8", "replace")
    layout = {"int": "<i", "float": "<f", "double": "<d", "box2i": "<4i", "compression": "<B"}.get(kind)
    if layout is None or struct.calcsize(layout) != len(data):
        return bytes(data)
    values = struct.unpack(layout, data)
    return values[0] if len(values) == 1 else values


class Image:
    """An OpenEXR file in memory. `width`, `height`; `channels`: the names; `attributes`: what its header says, such as
    "lightmill.scene"."""

    def __init__(self, data):
        self.data = bytes(data)
        cursor = _Cursor(self.data)
        magic, version = cursor.unpack("<iI")
        if magic != MAGIC:
            raise ImageError("this is no OpenEXR file")
        if version & (MULTIPART | DEEP | TILED) or version & 255 != 2:
            raise ImageError("the OpenEXR file has tiles, deep data or several parts; this package reads one part of scanlines")
        self._read_header(cursor)
        self._read_table(cursor)

    def _read_header(self, cursor):
        self.attributes, raw = {}, {}
        while name := cursor.text():
            kind = cursor.text()
            (size,) = cursor.unpack("<i")
            raw[name] = cursor.take(size)
            self.attributes[name] = _read_value(kind, raw[name])
        if any(name not in raw for name in ("channels", "compression", "dataWindow")):
            raise ImageError("the image's header lacks what it must have")
        self._channels = _read_channels(raw["channels"])
        self.channels = [name for name, _ in self._channels]
        self._compression = self.attributes["compression"]
        if self._compression not in LINES:
            raise ImageError(f"compression {NAMES.get(self._compression, self._compression)} is not read: use ZIP")
        self._place(self.attributes["dataWindow"])

    def _place(self, window):
        if not isinstance(window, tuple):
            raise ImageError("the image's header has no data window")
        self._left, self._top, right, bottom = window
        self.width, self.height = right - self._left + 1, bottom - self._top + 1
        if not (0 < self.width <= MAX_SIDE and 0 < self.height <= MAX_SIDE):
            raise ImageError(f"the image would have {self.width} x {self.height} pixels")

    def _read_table(self, cursor):
        lines = LINES[self._compression]
        count = -(-self.height // lines)
        self._line_bytes = self.width * sum(kind.itemsize for _, kind in self._channels)
        self._offsets = np.frombuffer(cursor.take(8 * count), "<u8")

    def _chunk(self, offset):
        """(first line, bytes) of a chunk, unpacked."""
        if offset > len(self.data) - 8:
            raise ImageError("the image is cut short")
        y, size = struct.unpack_from("<ii", self.data, int(offset))
        begin, y = int(offset) + 8, y - self._top
        if size < 0 or size > len(self.data) - begin or not 0 <= y < self.height or y % LINES[self._compression]:
            raise ImageError("the image is cut short or damaged")
        wanted = self._line_bytes * min(LINES[self._compression], self.height - y)
        data = self.data[begin:begin + size]
        # What did not get smaller is stored as it is.
        data = data if size == wanted else UNPACK[self._compression](data, wanted)
        if len(data) != wanted:
            raise ImageError("the image is damaged")
        return y, data

    def planes(self, names):
        """Channels as {name: array [height][width]}, of their own types."""
        types = dict(self._channels)
        missing = [name for name in names if name not in types]
        if missing:
            raise ImageError(f"the image has no channel {', '.join(missing)}; it has {', '.join(self.channels)}")
        if len(self.data) < self.height * self._line_bytes / 1100:  # more than zlib can pack
            raise ImageError("the image is cut short")
        planes = {name: np.empty((self.height, self.width), types[name]) for name in names}
        with ThreadPoolExecutor(os.cpu_count()) as pool:  # zlib and numpy let other threads run
            seen = dict(pool.map(lambda offset: self._unpack_chunk(offset, planes), self._offsets))
        if sum(seen.values()) != self.height:
            raise ImageError("lines of the image are missing")
        return planes

    def _unpack_chunk(self, offset, planes):
        """Puts the lines of a chunk into their places; returns the first and their number. A line holds one channel after the
        other."""
        y, data = self._chunk(offset)
        rows, at = np.frombuffer(data, np.uint8).reshape(-1, self._line_bytes), 0
        for name, kind in self._channels:
            size = self.width * kind.itemsize
            if name in planes:
                planes[name][y:y + len(rows)] = np.ascontiguousarray(rows[:, at:at + size]).view(kind)
            at += size
        return y, len(rows)

    def layers(self):
        """{layer: its channels}, in the order R G B A or X Y Z; R, G and B themselves are the layer "picture"."""
        found = {}
        for name in self.channels:
            layer, _, last = name.rpartition(".")
            if not layer:
                layer = "picture" if last in ORDER else name
            found.setdefault(layer, []).append(name)
        for names in found.values():
            names.sort(key=lambda name: ORDER.get(name.rpartition(".")[2], len(ORDER)))
        return found

    def layer(self, name="picture"):
        """A layer, or a channel by its whole name, as an array [height][width][channels] of float32."""
        layers = self.layers()
        names = layers.get(name) or ([name] if name in self.channels else None)
        if names is None:
            raise ImageError(f"the image has no layer '{name}'; it has {', '.join(layers)}")
        planes = self.planes(names)
        return np.stack([planes[channel].astype(np.float32) for channel in names], axis=-1)


def read_image(path):
    """An Image of a file."""
    with open(path, "rb") as file:
        return Image(file.read())
