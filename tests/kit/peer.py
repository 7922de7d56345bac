"""A connection to one socket of a master: questions and their answers, by the number of the request."""
import time

import zmq

from kit import wire

CONTEXT = zmq.Context.instance()


def dial(endpoint, keys=None, master_key=None):
    """A DEALER that is connected to `endpoint`; `keys` is (public, secret)."""
    socket = CONTEXT.socket(zmq.DEALER)
    socket.setsockopt(zmq.LINGER, 0)
    socket.setsockopt(zmq.SNDHWM, 64)
    socket.setsockopt(zmq.RCVHWM, 64)
    if master_key:
        socket.curve_publickey, socket.curve_secretkey = (half.encode() for half in keys)
        socket.curve_serverkey = master_key.encode()
    socket.connect(endpoint)
    return socket


class Peer:
    """Not for several threads. What the master pushes in the meantime is kept in `pushed`."""

    def __init__(self, endpoint, keys=None, master_key=None):
        self.socket, self.last, self.pushed = dial(endpoint, keys, master_key), 0, []

    def tell(self, body, payloads=()):
        """Sends; the number of the request."""
        self.last += 1
        self.socket.send_multipart(wire.pack(body, self.last, payloads), copy=False)
        return self.last

    def next(self, timeout):
        """The next message as (request, body, payloads); None when there is none within `timeout` seconds."""
        if not self.socket.poll(max(0, int(timeout * 1000))):
            return None
        return wire.unpack(self.socket.recv_multipart())

    def answer(self, request, timeout=10):
        """The answer to a request, (body, payloads). Refused when it is a Refusal, TimeoutError when there is none."""
        deadline = time.monotonic() + timeout
        while True:
            message = self.next(deadline - time.monotonic())
            if message is None:
                raise TimeoutError(f"no answer within {timeout} s")
            number, body, payloads = message
            if number == request:
                if isinstance(body, wire.lm.Refusal):
                    raise wire.Refused(body)
                return body, payloads
            if number == 0:
                self.pushed.append(body)

    def ask(self, body, payloads=(), timeout=10):
        return self.answer(self.tell(body, payloads), timeout)

    def close(self):
        self.socket.close()
