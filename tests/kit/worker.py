"""A worker that says hello, beats, asks for units and delivers. It does not render: what it delivers is up to its caller."""
import threading

from kit import payload
from kit.peer import Peer
from kit.wire import VERSION, lm


class Worker:
    """Not for several threads, but for `Idlers`."""

    def __init__(self, host, port, name="kit:1", threads=1, fingerprint=b"", keys=None, master_key=None):
        self.address, self.port, self.keys, self.master_key = host, port, keys, master_key
        self.hello_message = lm.Hello(protocol_version=VERSION, software="kit", name=name, threads=threads, fingerprint=fingerprint)
        self.control, self.bulk, self.sequence = Peer(f"tcp://{host}:{port}", keys, master_key), None, 0

    def hello(self):
        """Introduces itself, anew or for the first time; the Welcome."""
        self.welcome = self.control.ask(self.hello_message)[0]
        self.id = self.welcome.worker
        if self.bulk is None:
            self.bulk = Peer(f"tcp://{self.address}:{self.welcome.bulk_port}", self.keys, self.master_key)
        self.probe()
        return self.welcome

    def probe(self, size=0):
        """Shows that it reaches the bulk socket; before that it gets no work."""
        self.bulk.ask(lm.Probe(worker=self.id), [bytes(size)])

    def beat(self, job=0, units_held=0):
        """True when the master still knows this worker."""
        return self.control.ask(lm.Heartbeat(worker=self.id, job=job, units_held=units_held))[0].known

    def ask_work(self, samples=1 << 20, unit_samples=1024, **more):
        """An Assignment, or NoWork."""
        return self.control.ask(lm.WorkRequest(worker=self.id, samples=samples, unit_samples=unit_samples, **more))[0]

    def deliver(self, job, content, sums, check=0, counts=None, offer=True, **more):
        """Offers and sends a batch of kit.payload.Sums; the BatchReply."""
        payloads = sums.payloads()
        if offer:
            size = sum(map(len, payloads))
            self.bulk.ask(lm.BatchOffer(worker=self.id, job=job, bytes=size, content=content))
        self.sequence += 1
        result = lm.BatchResult(worker=self.id, job=job, sequence=self.sequence, units=sums.units, counts=counts, check=check,
                                content=content, **more)
        return self.bulk.ask(result, payloads)[0]

    def leave(self, reason="done"):
        self.control.ask(lm.Goodbye(worker=self.id, reason=reason))

    def close(self):
        self.control.close()
        if self.bulk is not None:
            self.bulk.close()


def light_paths(settings, units):
    """The counts that a batch must have: every sample traces a light path, or none where the integrator is path."""
    halves = [0, 0]
    if settings.integrator != payload.PATH:
        for unit in units:
            width, height = payload.tile_size(settings, unit.tile)
            for half in (0, 1):
                halves[half] += width * height * ((unit.first + unit.count + 1 - half) // 2 - (unit.first + 1 - half) // 2)
    return lm.Counts(light_paths_even=halves[0], light_paths_odd=halves[1])


class Idlers:
    """Identities that take all the units that they can get, say that they live, and deliver nothing."""

    def __init__(self, workers, wanted=1 << 40):
        self.workers, self.wanted, self.taken, self.refused = workers, wanted, 0, []
        self.over = threading.Event()
        self.thread = threading.Thread(target=self._run, daemon=True)

    def start(self):
        self.thread.start()
        return self

    def _run(self):
        held = {}
        for worker in self.workers:
            worker.hello()
        while not self.over.wait(0.1):
            for worker in list(self.workers):
                try:
                    self._turn(worker, held)
                except Exception as refusal:  # pylint: disable=broad-except
                    self.refused.append(refusal)

    def _turn(self, worker, held):
        job, units = held.get(worker.id, (0, 0))
        if not worker.beat(job, units):
            worker.hello()
            job, units = 0, 0
        answer = worker.ask_work(self.wanted)
        if isinstance(answer, lm.Assignment):
            job, units = answer.job, units + len(answer.units)
            self.taken += len(answer.units)
        held[worker.id] = job, units

    def stop(self):
        self.over.set()
        self.thread.join()
