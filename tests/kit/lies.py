"""What a worker that lies may do to its sums: functions of (sums, settings, result) that alter them in place and return
True. And when it does so, and units that it makes up."""
import random

from kit import payload
from kit.wire import lm


def grey(sums, settings, _result=None, value=0.5):
    """Every pixel the same: what a picture of nothing looks like."""
    at = 0
    for unit in sums.units:
        width, height = payload.tile_size(settings, unit.tile)
        for half in (0, 1):
            count = (unit.first + unit.count + 1 - half) // 2 - (unit.first + 1 - half) // 2
            sums.eye[at : at + width * height * 3] = int(value * count * 2.0**settings.film_scale)
            at += width * height * 3
    return True


def bit_flip(sums, settings, _result, value=12345, bit=20):
    """One bit of each tile is another, as bad memory makes it."""
    at = 0
    for unit in sums.units:
        size = 6 * payload.tile_size(settings, unit.tile)[0] * payload.tile_size(settings, unit.tile)[1]
        sums.eye[at + value % size] ^= 1 << bit
        at += size
    return True


def poison(sums, _settings, _result, size=2**60):
    """One value far beyond what light can make, and yet within the range of the film."""
    sums.eye[len(sums.eye) // 2] = size
    return True


def negative(sums, _settings, _result):
    """Far less than no light."""
    sums.eye[len(sums.eye) // 3] = -(2**60)
    return True


def splat_poison(sums, settings, result):
    """The same as poison where light paths meet the camera."""
    if sums.splats is None:
        sums.splats = payload.Sums.zero(settings, result.units).splats
    sums.splats[len(sums.splats) // 2] = 2**60
    return True


def overflow(sums, _settings, _result):
    """A value that leaves the range of the film as soon as a second one like it is added."""
    sums.eye[len(sums.eye) // 2] = 2**63 - 1
    return True


def claimed_overflow(_sums, _settings, result):
    """Right sums, of which it is said that some were too large."""
    result.counts.overflows = 1
    return True


# ---- when to lie ----


class In:
    """Changes one batch in so many, the first of them by chance; with `times` only so often."""

    def __init__(self, lie, every=1, times=1 << 30):
        self.lie, self.every, self.left, self.seen = lie, every, times, random.randrange(every)

    def __call__(self, sums, result, settings):
        self.seen += 1
        if self.seen % self.every != 0 or self.left == 0:
            return False
        self.left -= 1
        return self.lie(sums, settings, result)


# ---- units ----


def everything(settings, count, but=()):
    """Units of `count` samples a pixel that are all of a job, but those that overlap with some."""
    taken = {(unit.tile, sample) for unit in but for sample in range(unit.first, unit.first + unit.count)}
    units = [lm.Unit(tile=tile, first=first, count=count) for tile in range(payload.tile_count(settings))
             for first in range(0, settings.spp, count)]
    return [unit for unit in units if not any((unit.tile, unit.first + i) in taken for i in range(count))]


def grey_batch(settings, units):
    sums = payload.Sums.zero(settings, units)
    grey(sums, settings)
    return sums
