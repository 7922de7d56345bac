"""The live image: what has changed of it, in tiles (docs/http.md, Tiles)."""
import struct
import time
from typing import NamedTuple

import numpy as np

from .connection import with_query
from .errors import ImageError

SIDE = 64
HEAD = struct.Struct("<4s6I")
TILE = struct.Struct("<4H")


class Tiles(NamedTuple):
    """An answer: the version that it shows, width and height of the whole image, the level, and a list of
    (x, y, texels) with texels [height][width][4] of float32: red, green, blue, standard error."""
    version: int
    width: int
    height: int
    level: int
    tiles: list


def decode_tiles(data):
    """Tiles of the bytes of an answer."""
    if len(data) < HEAD.size or data[:4] != b"LMT1":
        raise ImageError("these bytes are no tiles")
    _, version, width, height, level, side, count = HEAD.unpack_from(data)
    if side == 0:
        raise ImageError("tiles of no size")
    tiles, at = [], HEAD.size
    for _ in range(count):
        if len(data) - at < TILE.size:
            raise ImageError("the tiles are cut short")
        column, row, wide, high = TILE.unpack_from(data, at)
        at += TILE.size
        if len(data) - at < 8 * wide * high:
            raise ImageError("the tiles are cut short")
        texels = np.frombuffer(data, "<f2", 4 * wide * high, at).reshape(high, wide, 4).astype(np.float32)
        tiles.append((column * side, row * side, texels))
        at += 8 * wide * high
    return Tiles(version, width, height, level, tiles)


def fetch_tiles(connection, job, layer="picture", level=0, since=0, rectangle=None):
    """Asks for the tiles of a layer that have changed since a version; rectangle is (x0, y0, x1, y1) of the level."""
    x0, y0, x1, y1 = rectangle or (None,) * 4
    path = with_query(f"/api/v1/jobs/{job}/tiles",
                      {"layer": layer, "level": level, "since": since, "x0": x0, "y0": y0, "x1": x1, "y1": y1})
    return decode_tiles(connection.ask("GET", path).body)


def side_of(side, level):
    """Texels along a side of a level."""
    return max(1, -(-side >> level))


class LiveImage:
    """The image of a job as it converges. `array` is [height][width][4] of float32: red, green, blue and the standard
    error of the luminance; None until the master has prepared the first one. `version` grows with the image."""

    def __init__(self, connection, job, layer="picture", level=0):
        self.connection, self.job, self.layer, self.level = connection, job, layer, level
        self.array, self.version, self._asked = None, 0, None

    def _distrust_after_restart(self):
        """The versions of a master that was restarted may count other batches."""
        now = time.monotonic()
        uptime = self.connection.get("/api/v1/farm")["uptime"]
        if self._asked is not None and uptime < now - self._asked + 1:
            self.version = 0
        self._asked = now

    def _take(self, answer):
        shape = (side_of(answer.height, self.level), side_of(answer.width, self.level), 4)
        if self.array is None or self.array.shape != shape:
            self.array = np.zeros(shape, np.float32)
        for x, y, texels in answer.tiles:
            target = self.array[y:y + texels.shape[0], x:x + texels.shape[1]]
            if target.shape != texels.shape:
                raise ImageError("a tile lies outside of its image")
            target[:] = texels

    def _bands(self, width, height):
        """Rectangles of at most 1024 tiles, which an answer may have."""
        wide, high = side_of(width, self.level), side_of(height, self.level)
        rows = max(1, 1024 // -(-wide // SIDE)) * SIDE
        return [(0, y, wide, min(high, y + rows)) for y in range(0, high, rows)]

    def update(self, timeout=10):
        """Fetches what has changed, and returns the number of tiles. The first call waits for the first image; it raises
        TimeoutError when there is none within `timeout` seconds, since nothing was rendered yet. While the master restarts it
        raises Unreachable: call it again later."""
        deadline = time.monotonic() + timeout
        self._distrust_after_restart()
        while True:
            status = self.connection.get(f"/api/v1/jobs/{self.job}")
            bands = [fetch_tiles(self.connection, self.job, self.layer, self.level, self.version, band)
                     for band in self._bands(status["width"], status["height"])]
            versions = [band.version for band in bands]
            if min(versions) > 0:
                break
            if time.monotonic() > deadline:
                raise TimeoutError(f"job {self.job} has no image yet")
            time.sleep(0.1)
        for band in bands:
            self._take(band)
        self.version = min(versions)
        return sum(len(band.tiles) for band in bands)
