"""Requests to a master: where it is, the token that it wants, and its answers.

Each request has a connection of its own. Proxies of the environment are not asked: a token goes to its master only.
"""
import contextlib
import http.client
import json
import os
import re
import ssl
import urllib.parse

from .errors import LightmillError, Problem, Unreachable

try:
    import fcntl
except ImportError:  # not Unix: a master runs on another machine
    fcntl = None

LOOPBACK = ("localhost", "127.0.0.1", "::1")


def _is_served(file):
    """A master that lives holds a lock on the file of its address; one that was killed has left it behind."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    fcntl.flock(file, fcntl.LOCK_UN)
    return False


def read_address(data):
    """The address of the master of this data directory. The token goes to no address that a killed one has left behind."""
    try:
        with open(os.path.join(data, "http"), encoding="utf-8") as file:
            if _is_served(file):
                return file.readline().strip()
    except OSError:
        pass
    raise Unreachable(f"no master serves HTTP for {data}: start lightmill-master --data {data} --http 7480, or name its "
                      "data directory (data=...) or its address (url=...)")


def read_token(data, right="operate"):
    """The token of this right that the master of a data directory has made."""
    path = os.path.join(data, "keys", "http")
    try:
        with open(path, encoding="utf-8") as file:
            found = re.search(rf"^{right} +([0-9a-f]+)\s*$", file.read(), re.MULTILINE)
    except OSError as error:
        raise LightmillError(f"cannot read the master's token: {error}") from error
    if not found:
        raise LightmillError(f"{path} has no token for the right to {right}")
    return found[1]


def _plain(value):
    """numpy's numbers and arrays as JSON has them."""
    if not hasattr(value, "tolist"):
        raise TypeError(f"{value!r} cannot be sent to a master")
    return value.tolist()


def _problem(status, reason, body):
    try:
        told = json.loads(body)
        return Problem(status, str(told.get("title", reason)), str(told.get("detail", "")))
    except (ValueError, AttributeError):
        return Problem(status, reason, f"{status} {reason}")


class Answer:
    """An answer that was read whole."""

    def __init__(self, status, headers, body):
        self.status, self.headers, self.body = status, headers, body

    def json(self):
        try:
            return json.loads(self.body)
        except ValueError as error:
            raise LightmillError(f"the master's answer is no JSON: {error}") from error


class Connection:
    """Where a master is, and the right to ask it."""

    def __init__(self, url=None, token=None, data="lightmill-data", ca=None, timeout=60):
        self.data, self.timeout = data, timeout
        url, _, fragment = (url or "").partition("#")
        self.url = url.rstrip("/") or None
        self.token = token or urllib.parse.parse_qs(fragment).get("token", [None])[0]
        if self.url is None and self.token is None:
            self.token = read_token(data)
        if self.token is None:
            raise LightmillError("a master wants a token: token=..., or the address that `lightmill open --print` prints")
        self.tls = ssl.create_default_context(cafile=ca)
        self._split(self.address())

    def address(self):
        """Where the master is now: after a restart on port 0 it is elsewhere."""
        return self.url or read_address(self.data)

    @staticmethod
    def _split(address):
        parts = urllib.parse.urlsplit(address)
        if parts.scheme not in ("http", "https") or not parts.hostname:
            raise LightmillError(f"'{address}' is no address of a master, such as http://127.0.0.1:7480")
        if parts.scheme == "http" and parts.hostname not in LOOPBACK:
            raise LightmillError(f"{address} is not encrypted, and the token would be seen on the way: use https://, or a "
                                 "tunnel (ssh -L 7480:127.0.0.1:7480)")
        return parts

    def _open(self, timeout):
        parts = self._split(self.address())
        prefix = parts.path.rstrip("/")
        if parts.scheme == "https":
            return http.client.HTTPSConnection(parts.hostname, parts.port, timeout=timeout, context=self.tls), prefix
        return http.client.HTTPConnection(parts.hostname, parts.port, timeout=timeout), prefix

    def send(self, method, path, body=None, headers=(), timeout=None):
        """Sends a request and returns (connection, response) with its headers read; the caller closes the connection.
        A refusal is a Problem."""
        connection, prefix = self._open(timeout or self.timeout)
        try:
            connection.connect()
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # a refusal does not wait for the body
                connection.request(method, prefix + path, body, {"Authorization": f"Bearer {self.token}", **dict(headers)})
            response = connection.getresponse()
            if response.status >= 400:
                raise _problem(response.status, response.reason, response.read(1 << 16))
        except (OSError, http.client.HTTPException) as error:
            connection.close()
            raise Unreachable(f"no master answers at {self.address()}: {error or type(error).__name__}") from error
        except Problem:
            connection.close()
            raise
        return connection, response

    def ask(self, method, path, body=None, headers=(), timeout=None):
        """The whole answer to a request."""
        connection, response = self.send(method, path, body, headers, timeout)
        try:
            return Answer(response.status, response.headers, response.read())
        except (OSError, http.client.HTTPException) as error:
            raise Unreachable(f"the master's answer broke off: {error or type(error).__name__}") from error
        finally:
            connection.close()

    def get(self, path, **query):
        """A JSON answer to a question."""
        return self.ask("GET", with_query(path, query)).json()

    def post(self, path, members=None):
        """A JSON answer to an order."""
        body = b"" if members is None else json.dumps(members, default=_plain).encode()
        headers = {} if members is None else {"Content-Type": "application/json"}
        answer = self.ask("POST", path, body, headers)
        return answer.json() if answer.body else None


def with_query(path, query):
    """The path with a query of what is not None."""
    text = urllib.parse.urlencode({name: value for name, value in query.items() if value is not None})
    return f"{path}?{text}" if text else path
