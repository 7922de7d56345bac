"""A farm's master."""
import contextlib
import time

from .connection import Connection
from .events import listen
from .job import Job
from .report import Report
from .scene import blob_of, scene_name, send_blob


class Master:
    """A master that was started with --http.

    Without arguments it is the one of the data directory `data` on this machine, whose address and token its files tell.
    For one on another machine give `url` and `token`, or as `url` the address that `lightmill open --print` prints there;
    `ca` is a file with the certificate (PEM) that its TLS certificate was signed with, if no well-known one was used.
    `timeout` is for how many seconds a request may hang."""

    def __init__(self, url=None, token=None, data="lightmill-data", ca=None, timeout=60):
        self.connection = Connection(url, token, data, ca, timeout)

    def __repr__(self):
        return f"<Master {self.connection.url or self.connection.data}>"

    def jobs(self):
        """All jobs, in the order of submission; `last` of each is its Report."""
        found = self.connection.get("/api/v1/jobs")["jobs"]
        return [Job(self.connection, members["job"], Report.of(members)) for members in found]

    def job(self, number):
        """The job of this number; Problem (404) when there is none."""
        job = Job(self.connection, number)
        job.status()
        return job

    def submit(self, scene, name=None, lenient=False, program="lightmill", **settings):
        """Submits a scene and returns its Job. The scene is what `lightmill submit` takes: a .pbrt, .gltf or .glb file, a
        folder with a scene.pbrt, or a blob. All but blobs are read by the `lightmill` command, `program`; `lenient` as
        there. `settings` are those of docs/http.md (Submitting): spp, error, time, adaptive, save_at, width and height,
        integrator, max_depth, seed, priority, halves, ..."""
        with blob_of(scene, program, lenient) as blob:
            settings["blob"] = send_blob(self.connection, blob)
        settings["name"] = scene_name(scene) if name is None else name
        if settings.get("seed") is not None:
            settings["seed"] = str(settings["seed"])  # JSON's numbers end at 2^53
        members = self.connection.post("/api/v1/jobs", {key: value for key, value in settings.items() if value is not None})
        return Job(self.connection, members["job"], Report.of(members))

    def workers(self):
        """All workers, those that are connected first: a list of Reports."""
        return [Report.of(members) for members in self.connection.get("/api/v1/workers")["workers"]]

    def farm(self):
        """The farm in all: a Report with version, uptime, workers, threads, speed, jobs by state."""
        return Report.of(self.connection.get("/api/v1/farm"))

    def demand(self):
        """How many workers would end all work in ten minutes."""
        return self.connection.get("/api/v1/demand")["workers"]

    def events(self, timeout=None):
        """What happens, for ever or for `timeout` seconds: events with `kind` and `data` (docs/http.md, Events), and two more:
        "connected" comes first and after each break, "away" while no master answers. After "lost" and a restart of the
        master events are missing: ask for the jobs again."""
        deadline = None if timeout is None else time.monotonic() + timeout
        with contextlib.closing(listen(self.connection, deadline)) as events:
            yield from events
