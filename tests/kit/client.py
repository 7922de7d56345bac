"""A client: puts scenes into the store, submits jobs, asks how they are, and fetches images."""
import hashlib
import time

from kit.peer import Peer
from kit.wire import lm

CHUNK = 1 << 20
QUEUED, RUNNING, FINISHING, DONE, CANCELLED, FAILED, PAUSED = range(1, 8)  # JobStatus.state


def settings(**changed):
    """Settings of a job, with defaults for what is not given."""
    values = dict(integrator=1, sampler=1, width=96, height=64, max_depth=5, spp=64, tile_size=32, film_scale=32)
    return lm.Settings(**{**values, **changed})


class Client:
    def __init__(self, host, port, keys=None, master_key=None):
        self.control = Peer(f"tcp://{host}:{port}", keys, master_key)
        bulk_port = self.control.ask(lm.JobStatusRequest())[0].bulk_port
        self.bulk = Peer(f"tcp://{host}:{bulk_port}", keys, master_key)

    def upload(self, path):
        """Puts a scene blob into the master's store; its hash."""
        with open(path, "rb") as file:
            blob = file.read()
        name = hashlib.blake2b(blob, digest_size=32).digest()
        at = self.bulk.ask(lm.BlobPut(blob=name, size=len(blob)), [b""])[0].next
        while at < len(blob):
            put = lm.BlobPut(blob=name, offset=at, size=len(blob))
            at = self.bulk.ask(put, [blob[at : at + CHUNK]])[0].next
        return name

    def submit(self, blob, chosen, name="kit", **terms):
        """A new job; its number."""
        return self.control.ask(lm.JobSubmit(name=name, settings=chosen, blob=blob, terms=lm.Terms(**terms)))[0].job

    def status(self, job):
        return self.control.ask(lm.JobStatusRequest(job=job))[0].jobs[0]

    def workers(self):
        return list(self.control.ask(lm.WorkerListRequest())[0].workers)

    def wait(self, job, until=lambda status: status.state in (DONE, CANCELLED, FAILED), timeout=300, every=0.05):
        """The status of the job as soon as it is as wished."""
        deadline = time.monotonic() + timeout
        while not until(status := self.status(job)):
            if time.monotonic() > deadline:
                raise AssertionError(f"after {timeout} s job {job} is still: {status}")
            time.sleep(every)
        return status

    def fetch(self, job, path):
        """Writes the image of the job, an OpenEXR file."""
        image, snapshot = b"", 0
        while True:
            chunk, (data,) = self.bulk.ask(lm.ImageGet(job=job, snapshot=snapshot, offset=len(image), length=CHUNK), timeout=60)
            image, snapshot = image + data, chunk.snapshot
            if len(image) == chunk.size:
                break
        with open(path, "wb") as file:
            file.write(image)

    def close(self):
        self.control.close()
        self.bulk.close()
