"""TCP ports for the farms of tests."""
import contextlib
import os
import random
import socket


def choose_pair():
    """A port, chosen by chance, of which the next one is free too. It is one of those that $TEST_PORTS gives to this program alone
    (tests/run.sh), or of those that the system does not give away by itself."""
    first, last = map(int, os.environ.get("TEST_PORTS", "20000-31999").split("-"))
    for port in random.SystemRandom().choices(range(first, last, 2), k=1000):
        with contextlib.suppress(OSError), socket.socket() as one, socket.socket() as two:
            one.bind(("127.0.0.1", port))
            two.bind(("127.0.0.1", port + 1))
            return port
    raise AssertionError("there are no free ports")
