"""A job on a farm: how it is, what it looks like, and orders to it."""
import contextlib
import os
import tempfile
import time
from typing import NamedTuple

import numpy as np

from .connection import with_query
from .errors import JobFailed, Problem, Unreachable
from .events import listen
from .exr import Image
from .report import Report
from .tiles import LiveImage, fetch_tiles

OVER = ("done", "cancelled", "failed", "deleted")
PATIENCE = 30  # seconds that a master may be busy with the images of others,
WRITING = 600  # and that it may take to write a large one


class History(NamedTuple):
    """How the estimated relative error fell: arrays of the same length, by seconds of work and pixel samples."""
    elapsed: np.ndarray
    samples: np.ndarray
    error: np.ndarray


class Job:
    """`number` is the job's number; `last` the last Report that was seen of it, or None."""

    def __init__(self, connection, number, last=None):
        self.connection, self.number, self.last = connection, int(number), last
        self._kept = None  # (path, tag, Image): the last image

    def __repr__(self):
        seen = f" '{self.last.name}', {self.last.state}" if self.last else ""
        return f"<Job {self.number}{seen}>"

    def _path(self, what=""):
        return f"/api/v1/jobs/{self.number}{what}"

    def _seen(self, members):
        self.last = Report.of(members)
        return self.last

    # ---- how it is ----

    def status(self):
        """How the job is now: a Report with state, samples_done, samples_total, elapsed, remaining, error, ..."""
        return self._seen(self.connection.get(self._path()))

    def history(self):
        """How its error fell: History(elapsed, samples, error), empty before the first estimate."""
        points = self.connection.get(self._path("/history"))["points"]
        return History(np.array([point["elapsed"] for point in points], np.float64),
                       np.array([int(point["samples"]) for point in points], np.int64),
                       np.array([point["error"] for point in points], np.float64))

    def _status_or_deleted(self):
        try:
            return self.status()
        except Problem as problem:
            if problem.status != 404 or self.last is None:
                raise
            return self._seen({**self.last, "state": "deleted"})

    def _after(self, event):
        """The status after an event; None: the event says nothing of this job."""
        if event.kind == "job" and event.data.get("job") == self.number and self.last:
            status = self._seen({**self.last, **event.data})
            return self._status_or_deleted() if status.state in OVER else status  # with why and when
        if event.kind not in ("connected", "lost", "away"):
            return None
        try:
            return self._status_or_deleted()
        except Unreachable:
            return None

    def watch(self, timeout=None):
        """Gives a Report now and whenever the job has changed, at most once a second, until the job is over. Goes on when
        the master is restarted. TimeoutError after `timeout` seconds."""
        deadline = None if timeout is None else time.monotonic() + timeout
        before = None
        with contextlib.closing(listen(self.connection, deadline)) as events:
            for event in events:
                status = self._after(event)
                if status is None or status == before:
                    continue
                before = status
                yield status
                if status.state in OVER:
                    return

    def wait(self, timeout=None):
        """Waits until the job is done, and returns its last Report. JobFailed when it ends in another way; TimeoutError
        after `timeout` seconds."""
        for status in self.watch(timeout):
            pass
        if status.state != "done":
            raise JobFailed(status)
        return status

    # ---- what it looks like ----

    def _send_patiently(self, path, headers=()):
        """A master writes images for so many at a time only."""
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                return self.connection.send("GET", path, headers=headers, timeout=max(WRITING, self.connection.timeout))
            except Problem as problem:
                if problem.status != 503 or time.monotonic() > deadline:
                    raise
            time.sleep(0.5)

    def exr(self, at=None, halves=False):
        """The Image with all layers, as it is now, or as it was `at` so many samples a pixel (save_at); with `halves` also
        those of its even and odd samples, half0 and half1. It is fetched again only when it has changed."""
        path, headers = with_query(self._path("/image.exr"), {"at": at, "halves": 1 if halves else None}), {}
        if self._kept and self._kept[0] == path:
            headers["If-None-Match"] = self._kept[1]
        opened, response = self._send_patiently(path, headers)
        with contextlib.closing(opened):
            if response.status != 304:
                self._kept = (path, response.headers.get("ETag", ""), Image(_read_whole(response)))
        return self._kept[2]

    def image(self, layer="picture", at=None, halves=False):
        """A layer of the image as an array [height][width][channels] of float32, linear. layers() has the names."""
        return self.exr(at, halves).layer(layer)

    def layers(self):
        """{layer: its channels} of the image."""
        return self.exr().layers()

    def save(self, path, at=None, half=False, halves=False, exposure=None):
        """Writes the image to a file, whole or not at all: OpenEXR (`half`: with half floats; `halves` as in exr()), or PNG
        if the name ends with .png (`exposure`: brighter by so many stops)."""
        kind = "png" if os.fspath(path).lower().endswith(".png") else "exr"
        query = {"at": at, "half": 1 if half else None, "halves": 1 if halves else None, "exposure": exposure}
        opened, response = self._send_patiently(with_query(self._path(f"/image.{kind}"), query))
        with contextlib.closing(opened):
            _write_whole(path, response)

    def tiles(self, layer="picture", level=0, since=0, rectangle=None):
        """What has changed of the image since a version, while it converges: Tiles(version, width, height, level, tiles).
        `level` 0 is the image, each next is half as large; rectangle is (x0, y0, x1, y1). Version 0: it is being prepared,
        ask again."""
        return fetch_tiles(self.connection, self.number, layer, level, since, rectangle)

    def live(self, layer="picture", level=0):
        """A LiveImage, which keeps an array up to date by tiles: call its update()."""
        return LiveImage(self.connection, self.number, layer, level)

    # ---- orders ----

    def _order(self, name, members=None):
        return self._seen(self.connection.post(self._path(f"/{name}"), members))

    def pause(self):
        """No more work of it is handed out, until resume()."""
        return self._order("pause")

    def resume(self):
        """Goes on after pause()."""
        return self._order("resume")

    def cancel(self):
        """Ends it; its image so far stays."""
        return self._order("cancel")

    def extend(self, spp=None, error=None, time=None):
        """Goes on to `spp` samples a pixel, an error of `error` (0.01 is 1 %), or for `time` seconds; also when it is over."""
        goals = {"spp": spp, "error": error, "time": time}
        return self._order("extend", {name: goal for name, goal in goals.items() if goal is not None})

    def priority(self, priority):
        """Jobs of a higher priority go first: -1000 to 1000."""
        return self._order("priority", {"priority": priority})

    def mixed(self):
        """Machines whose bits differ may work on it from now on."""
        return self._order("mixed")

    def rebind(self):
        """The kind of machines that has most threads now goes on with it."""
        return self._order("rebind")

    def retain(self):
        """Keeps it until it is deleted."""
        return self._order("retain")

    def release(self):
        """Takes back retain()."""
        return self._order("release")

    def delete(self):
        """Removes it, when it is over, with its image."""
        self.connection.ask("DELETE", self._path())


def _blocks(response):
    """The body of an answer in pieces; an error unless it comes whole."""
    wanted, got = response.headers.get("Content-Length"), 0
    while block := response.read(1 << 20):
        got += len(block)
        yield block
    if wanted is not None and got != int(wanted):
        raise Unreachable(f"the image broke off after {got} of {wanted} bytes")


def _read_whole(response):
    try:
        return b"".join(_blocks(response))
    except OSError as error:
        raise Unreachable(f"the image broke off: {error}") from error


def _write_whole(path, response):
    """The file appears when it is complete."""
    path = os.fspath(path)
    with tempfile.NamedTemporaryFile(dir=os.path.dirname(path) or ".", prefix=".lightmill-", delete=False) as file:
        try:
            for block in _blocks(response):
                file.write(block)
            file.flush()
            os.chmod(file.name, 0o666 & ~_umask())
            os.replace(file.name, path)
        except BaseException:
            os.unlink(file.name)
            raise


def _umask():
    mask = os.umask(0o077)
    os.umask(mask)
    return mask
