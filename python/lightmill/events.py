"""Server-sent events: what happens on a farm, through restarts of its master (docs/http.md, Events)."""
import http.client
import json
import time

from .errors import LightmillError, Problem, Unreachable

SILENCE = 40  # seconds; the master sends something every 15
FIRST_DELAY, LAST_DELAY = 0.2, 5.0  # seconds between two tries to connect
PASSING = (429, 500, 502, 503, 504)  # refusals of a moment
MAX_LINE = 1 << 20


class Event:
    """`kind` is job, image, worker, note or lost (docs/http.md, Events); connected: the stream begins, after which all is to
    be asked for again; or away: there is none. `data` is a dict."""

    def __init__(self, kind, data, name=None):
        self.kind, self.data, self.name = kind, data, name

    def __repr__(self):
        return f"<Event {self.kind} {self.data}>"


def read_events(lines):
    """The events of a stream's lines (bytes with their ends), as the HTML standard defines them. Comments are None."""
    fields = {}
    for line in lines:
        text = line.decode("utf-8", "replace").rstrip("\r\n")
        if not text:
            if "data" in fields:
                yield Event(fields.get("event", "message"), json.loads(fields["data"]), fields.get("id"))
            fields = {}
            continue
        field, _, value = text.partition(":")
        value = value[1:] if value.startswith(" ") else value
        if not field:
            yield None
        elif field == "data" and "data" in fields:
            fields["data"] += "\n" + value
        else:
            fields[field] = value


def _lines(response):
    while True:
        line = response.readline(MAX_LINE)
        if not line.endswith(b"\n"):
            return  # the stream has ended; half a line is none
        yield line


def remaining(deadline):
    """Seconds until a time of time.monotonic(); None: for ever."""
    if deadline is None:
        return None
    left = deadline - time.monotonic()
    if left <= 0:
        raise TimeoutError("the time that was given is over")
    return left


def _pause(seconds, deadline):
    left = remaining(deadline)
    time.sleep(seconds if left is None else min(seconds, left))


def _stream(connection, last, deadline):
    """The events of one connection, until it ends."""
    left = remaining(deadline)
    headers = {"Accept": "text/event-stream", **({"Last-Event-ID": last} if last else {})}
    opened, response = connection.send("GET", "/api/v1/events", headers=headers,
                                       timeout=SILENCE if left is None else min(SILENCE, left))
    try:
        yield Event("connected", {})
        for event in read_events(_lines(response)):
            remaining(deadline)
            if event is not None:
                yield event
    except ValueError as error:
        raise LightmillError(f"the master sends events that are none: {error}") from error
    finally:
        opened.close()


def listen(connection, deadline=None):
    """All events until `deadline` (time.monotonic()), which raises TimeoutError. Goes on when the connection is lost or
    the master restarted. While there is none it gives "away" events, so that a caller can ask in other ways."""
    last, delay = None, FIRST_DELAY
    while True:
        try:
            for event in _stream(connection, last, deadline):
                delay = FIRST_DELAY
                last = event.name or last
                yield event
        except Problem as problem:
            if problem.status not in PASSING:
                raise
            yield Event("away", {"why": str(problem)})
        except (Unreachable, OSError, http.client.HTTPException) as error:
            remaining(deadline)
            yield Event("away", {"why": str(error)})
        _pause(delay, deadline)
        delay = min(2 * delay, LAST_DELAY)
