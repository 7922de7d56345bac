"""Stands between a real worker and the master: a small master to the one, a worker to the other.

So it has true sums, and tells them on as they are, changed, or all at once. It serves one worker. Control messages pass
through; batches are opened, and their sums can be changed on the way.
"""
import threading

import zmq

from kit import payload, wire
from kit.peer import CONTEXT, dial
from kit.wire import lm

OWN = 1 << 40  # numbers of its own requests, beyond those of any worker that counts from 1


class Between:
    """`change(sums, result, settings)` gets every batch and may alter its sums in place; it returns True when it did. With
    `gather` batches are kept until the master has no more work to give, and then delivered as one.
    """

    def __init__(self, host, port, keys=None, master_key=None, change=None, gather=False, name=None):
        self.host, self.keys, self.master_key = host, keys, master_key
        self.change, self.gather, self.name = change, gather, name
        self.up = dial(f"tcp://{host}:{port}", keys, master_key)
        self.up_bulk, self.down, self.down_bulk = None, CONTEXT.socket(zmq.ROUTER), CONTEXT.socket(zmq.ROUTER)
        for socket in (self.down, self.down_bulk):
            socket.setsockopt(zmq.LINGER, 0)
        self.port = self.down.bind_to_random_port("tcp://127.0.0.1")
        self.bulk_port = self.down_bulk.bind_to_random_port("tcp://127.0.0.1")
        self.settings = {}  # of a job: those of its last assignment
        self.held = {}  # of a job: the BatchResult and the Sums that wait
        self.sending = None  # what was offered: (result, sums)
        self.batches, self.changed, self.refusals, self.requests = 0, 0, [], OWN
        self.lies, self.told = set(), 0  # requests with batches that were changed, and how many of these were accepted
        self.hello_message, self.assignments, self.error = None, [], None
        self.over = threading.Event()
        self.thread = threading.Thread(target=self._run, daemon=True)

    def start(self):
        self.thread.start()
        return self

    def stop(self):
        self.over.set()
        self.thread.join()
        for socket in (self.up, self.up_bulk, self.down, self.down_bulk):
            if socket is not None:
                socket.close()
        if self.error is not None:
            raise self.error

    def _run(self):
        try:
            poller = zmq.Poller()
            handlers = {self.down: self._from_worker, self.up: self._from_master, self.down_bulk: self._bulk_from_worker}
            for socket in handlers:
                poller.register(socket, zmq.POLLIN)
            self.worker_at = {}  # of a socket: the identity of the worker's connection
            while not self.over.is_set():
                if self.up_bulk is not None and self.up_bulk not in handlers:
                    handlers[self.up_bulk] = self._bulk_from_master
                    poller.register(self.up_bulk, zmq.POLLIN)
                for socket, _ in poller.poll(100):
                    frames = socket.recv_multipart()
                    if socket in (self.down, self.down_bulk):
                        self.worker_at[socket], frames = frames[0], frames[1:]
                    handlers[socket](*wire.unpack(frames))
        except Exception as error:  # pylint: disable=broad-except
            self.error = error

    # ---- control ----

    def _to_worker(self, request, body, payloads=(), socket=None):
        socket = socket or self.down
        if socket in self.worker_at:
            socket.send_multipart([self.worker_at[socket], *wire.pack(body, request, payloads)], copy=False)

    def _from_worker(self, request, body, payloads):
        if isinstance(body, lm.Hello):
            self.hello_message = lm.Hello()
            self.hello_message.CopyFrom(body)
            if self.name is not None:
                body.name = self.name
        if isinstance(body, lm.Heartbeat):
            waiting = [result for result, _ in self.held.values()] + ([self.sending[0]] if self.sending else [])
            body.units_held += sum(len(result.units) for result in waiting)
        self.up.send_multipart(wire.pack(body, request, payloads))

    def _from_master(self, request, body, payloads):
        if isinstance(body, lm.Welcome):
            self.held, self.sending = {}, None  # what an earlier number had in hand is given out again
            if self.up_bulk is None:
                self.up_bulk = dial(f"tcp://{self.host}:{body.bulk_port}", self.keys, self.master_key)
            self.worker, body.bulk_port = body.worker, self.bulk_port
        if isinstance(body, lm.Assignment):
            self.settings[body.job] = body.settings
            self.assignments.append(body)
        if isinstance(body, lm.NoWork):
            self._deliver()
        if isinstance(body, lm.JobOver):
            if body.flush:
                self._deliver()
            else:
                self.held.pop(body.job, None)
        self._to_worker(request, body, payloads)

    # ---- bulk ----

    def _bulk_from_worker(self, request, body, payloads):
        if isinstance(body, lm.BatchResult):
            sums = payload.Sums(self.settings[body.job], body.units, payloads)
            if self.gather and not body.check:
                self._hold(body, sums)
                self._to_worker(request, lm.BatchReply(sequence=body.sequence, accepted=True), socket=self.down_bulk)
                return
            payloads = self._altered(request, body, sums, payloads)
        elif isinstance(body, lm.BatchOffer) and self.gather:
            self._to_worker(request, lm.BatchGrant(), socket=self.down_bulk)
            return
        self.up_bulk.send_multipart(wire.pack(body, request, payloads), copy=False)

    def _altered(self, request, result, sums, payloads):
        self.batches += 1
        if self.change is None or not self.change(sums, result, self.settings[result.job]):
            return payloads
        self.changed += 1
        self.lies.add(request)
        return sums.payloads()

    def _answered(self, request, reply):
        accepted = isinstance(reply, lm.BatchReply) and reply.accepted
        if not accepted:
            self.refusals.append(reply.reason)
        self.told += accepted and request in self.lies

    def _bulk_from_master(self, request, body, payloads):
        if request < OWN:
            if isinstance(body, lm.BatchReply):
                self._answered(request, body)
            self._to_worker(request, body, payloads, socket=self.down_bulk)
        elif isinstance(body, lm.BatchGrant) and self.sending:
            result, sums = self.sending
            self._ask_bulk(result, self._altered(self.requests + 1, result, sums, sums.payloads()))
        else:
            self._answered(request, body)
            self.sending = None

    # ---- batches that wait ----

    def _hold(self, result, sums):
        if result.job not in self.held:
            self.held[result.job] = result, sums
            return
        into, into_sums = self.held[result.job]
        into_sums.add(sums)
        into.units.extend(result.units)
        for field in into.counts.DESCRIPTOR.fields:
            setattr(into.counts, field.name, getattr(into.counts, field.name) + getattr(result.counts, field.name))
        into.sequence = result.sequence

    def _deliver(self):
        if self.held and self.sending is None:
            job = min(self.held)
            self.sending = self.held.pop(job)
            result, sums = self.sending
            size = sum(map(len, sums.payloads()))
            self._ask_bulk(lm.BatchOffer(worker=self.worker, job=job, bytes=size, content=result.content))

    def _ask_bulk(self, body, payloads=()):
        self.requests += 1
        self.up_bulk.send_multipart(wire.pack(body, self.requests, payloads), copy=False)
