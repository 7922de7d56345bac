"""Scenes on their way to a master: they are read by the `lightmill` command, and sent as blobs."""
import contextlib
import hashlib
import json
import os
import subprocess
import tempfile
import time

from .errors import LightmillError, Problem, Unreachable

MAGIC = b"LMscene\0"
PIECE = 16 << 20  # bytes of a request
MAX_NAME = 200  # bytes of a job's name
PATIENCE = 60  # seconds for which a master may be away or busy in the middle of an upload


def scene_name(path):
    """What `lightmill submit` would call a job of this scene: DIR/scene.pbrt is named after the folder."""
    path = os.path.realpath(os.fspath(path))
    folder, name = os.path.split(path)
    if not os.path.isdir(path):
        name = os.path.splitext(name)[0]
        name = os.path.basename(folder) if name == "scene" else name
    return name.encode()[:MAX_NAME].decode(errors="ignore") or "image"


def _is_blob(path):
    if not os.path.isfile(path):
        return False
    with open(path, "rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def _import(path, blob, program, lenient):
    arguments = [program, "import", os.fspath(path), "--quiet", "-o", blob] + (["--lenient"] if lenient else [])
    try:
        done = subprocess.run(arguments, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
                              errors="replace")
    except OSError as error:
        raise LightmillError(f"cannot run {program}, which reads scenes: put it on PATH (make install), or say where it is "
                             f"(program=\"build/lightmill\"): {error}") from error
    if done.returncode != 0:
        raise LightmillError(done.stderr.strip() or f"{program} import ended with {done.returncode}")


@contextlib.contextmanager
def blob_of(path, program="lightmill", lenient=False):
    """The path of the scene's blob: the path itself, or that of a temporary file."""
    if _is_blob(path):
        yield os.fspath(path)
        return
    with tempfile.TemporaryDirectory(prefix="lightmill-") as folder:
        blob = os.path.join(folder, "scene.blob")
        _import(path, blob, program, lenient)
        yield blob


def blob_hash(path):
    """The name of a blob."""
    state = hashlib.blake2b(digest_size=32)
    with open(path, "rb") as file:
        while block := file.read(1 << 20):
            state.update(block)
    return state.hexdigest()


def _what_is_there(connection, name):
    try:
        return connection.get(f"/api/v1/blobs/{name}")
    except Problem as problem:
        if problem.status != 404:
            raise
        return {"next": 0, "complete": False}


def _send_piece(connection, name, file, first, size):
    file.seek(first)
    piece = file.read(min(PIECE, size - first))
    if not piece:
        raise LightmillError("the scene's blob has become shorter while it was sent")
    # The master reads the whole blob after the last piece, about a second a GB.
    answer = connection.ask("PUT", f"/api/v1/blobs/{name}", piece, timeout=connection.timeout + size / 1e8,
                            headers={"Content-Type": "application/octet-stream",
                                     "Content-Range": f"bytes {first}-{first + len(piece) - 1}/{size}"})
    return json.loads(answer.body)


def send_blob(connection, path):
    """Sends the blob unless the master has it, and returns its name. Goes on where it was when the master is restarted."""
    name, size, deadline = blob_hash(path), os.path.getsize(path), time.monotonic() + PATIENCE
    there = None
    with open(path, "rb") as file:
        while True:
            try:
                there = there or _what_is_there(connection, name)
                if there["complete"]:
                    return name
                # A piece has at least a byte. All that is there, and not known to be right, is checked when it comes again.
                first = min(int(there["next"]), size - 1)
                there = _send_piece(connection, name, file, first, size)
                if int(there["next"]) <= first and not there["complete"]:
                    raise LightmillError(f"the master does not take the scene's blob beyond byte {first}")
                deadline = time.monotonic() + PATIENCE
            except (Unreachable, Problem) as error:
                passing = isinstance(error, Unreachable) or error.status in (409, 503)
                if not passing or time.monotonic() > deadline:
                    raise
                there = None
                time.sleep(0.3)
