#!/usr/bin/python3
"""The Python package (python/) on a real farm, whose master is killed meanwhile; its reader of OpenEXR files; and the lines of
its documentation, as they are written.

make copies this to BUILD/tests/farm/test_python, for tests/run.sh. It runs by Debian's Python, which has Debian's numpy.
"""
import contextlib
import hashlib
import os
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import threading
import time
import unittest
import unittest.mock
import zlib

BUILD = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(sys.argv[0]))))
TOP = os.getcwd()
sys.path[:0] = [f"{TOP}/python", f"{TOP}/tests"]
sys.dont_write_bytecode = True

import numpy as np  # noqa: E402

import lightmill  # noqa: E402
import ports  # noqa: E402
from lightmill.events import read_events  # noqa: E402

PATIENCE = 60  # seconds for anything, on a machine that does other things too


def wait_for(what, ask):
    deadline = time.monotonic() + PATIENCE
    while not (answer := ask()):
        if time.monotonic() > deadline:
            raise AssertionError(f"there is no {what}")
        time.sleep(0.05)
    return answer


def read(path):
    with open(path, encoding="utf-8") as file:
        return file.read()


def lightmill_command(*arguments, **more):
    return subprocess.run([f"{BUILD}/lightmill", *arguments], check=True, stdout=subprocess.PIPE, text=True, **more).stdout


class Farm:
    """A master and workers in a folder, of real processes."""

    def __init__(self, *options):
        self.folder = tempfile.mkdtemp(prefix="lightmill-")
        self.data, self.options, self.processes, self.port = f"{self.folder}/lightmill-data", options, [], ports.choose_pair()
        self.start_master()

    def start(self, name, *arguments):
        with open(f"{self.folder}/{name}.log", "ab") as log:
            process = subprocess.Popen(arguments, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
        self.processes.append(process)
        return process

    def start_master(self):
        log = f"{self.folder}/master.log"
        said_before = len(read(log)) if os.path.exists(log) else 0
        self.master = self.start("master", f"{BUILD}/lightmill-master", "--listen", f"127.0.0.1:{self.port}", "--data", self.data,
                                 "--http", "0", "--batch-interval", "0.3", "--checkpoint", "0.5", "--heartbeat", "0.2", *self.options)
        wait_for("master", lambda: "the page is at" in read(log)[said_before:])

    def kill_master(self):
        self.master.kill()
        self.master.wait()

    def start_worker(self):
        self.start("worker", f"{BUILD}/lightmill-worker", f"127.0.0.1:{self.port}", "--threads", "1", "--cache",
                   f"{self.folder}/cache")

    def submit(self, *settings):
        return int(lightmill_command("submit", "scenes/cornell", "--master", f"127.0.0.1:{self.port}", "--resolution", "100x72",
                                     *settings))

    def close(self):
        for process in self.processes:
            process.kill()
            process.wait()
        shutil.rmtree(self.folder)


class Case(unittest.TestCase):
    def folder(self):
        folder = tempfile.mkdtemp(prefix="lightmill-")
        self.addCleanup(shutil.rmtree, folder)
        return folder

    def farm(self, *options):
        farm = Farm(*options)
        self.addCleanup(farm.close)
        return farm

    @contextlib.contextmanager
    def refused(self, status, text=""):
        with self.assertRaises(lightmill.Problem) as caught:
            yield
        self.assertEqual(caught.exception.status, status)
        self.assertIn(text, str(caught.exception))


# ---- OpenEXR files ----


def pixel_hash(image):
    """What `lightmill info --hash` prints."""
    state = hashlib.blake2b(struct.pack("<ii", image.width, image.height), digest_size=32)
    for name, plane in sorted(image.planes(image.channels).items()):
        state.update(name.encode() + b"\0" + plane.astype("<f4").tobytes())
    return state.hexdigest()


def attribute(name, kind, value):
    return name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value


def zipped(data):
    """As the file format's description says it, byte by byte."""
    data = bytes(data[0::2]) + bytes(data[1::2])
    return zlib.compress(bytes([data[0]] + [(b - a + 128) & 255 for a, b in zip(data, data[1:])]))


def exr_file(compression, lines, pack, top=-3, left=5):
    """A file of 3 x 5 pixels with an uint, a half and a float channel, chunks in falling order; and its planes."""
    planes = {"a": np.arange(15, dtype="<u4").reshape(5, 3) + 4000000000, "b.X": (np.arange(15).reshape(5, 3) / 7).astype("<f2"),
              "b.Y": (np.arange(15).reshape(5, 3) * 1e10).astype("<f4")}
    kinds = {"a": 0, "b.X": 1, "b.Y": 2}
    channels = b"".join(name.encode() + b"\0" + struct.pack("<iIii", kind, 0, 1, 1) for name, kind in kinds.items()) + b"\0"
    head = struct.pack("<iI", 20000630, 2) + attribute(b"channels", b"chlist", channels) + \
        attribute(b"compression", b"compression", bytes([compression])) + \
        attribute(b"dataWindow", b"box2i", struct.pack("<4i", left, top, left + 2, top + 4)) + \
        attribute(b"owner", b"string", b"who") + b"\0"
    chunks = []
    for y in range(0, 5, lines):
        raw = b"".join(plane[row].tobytes() for row in range(y, min(5, y + lines)) for plane in planes.values())
        packed = pack(raw)
        packed = packed if len(packed) < len(raw) else raw
        chunks.append(struct.pack("<ii", top + y, len(packed)) + packed)
    at, table = len(head) + 8 * len(chunks), {}
    for i in reversed(range(len(chunks))):
        table[i] = at
        at += len(chunks[i])
    return head + b"".join(struct.pack("<Q", table[i]) for i in range(len(chunks))) + b"".join(reversed(chunks)), planes


class ExrFiles(Case):
    def test_every_bit_of_a_written_file_is_read(self):
        path = f"{self.folder()}/a.exr"
        for more in ([], ["--half"]):
            lightmill_command("render", "scenes/cornell", "--resolution", "61x47", "--spp", "4", "--quiet", "-o", path, *more)
            image = lightmill.read_image(path)
            self.assertEqual((image.width, image.height, len(image.channels)), (61, 47, 26))
            self.assertEqual(pixel_hash(image), lightmill_command("info", "--hash", path).split()[0])
            self.assertEqual(image.attributes["lightmill.scene"], "cornell")
        self.assertEqual(image.layers()["normal"], ["normal.X", "normal.Y", "normal.Z"])
        self.assertEqual(image.layers()["picture"], ["R", "G", "B"])
        self.assertEqual(image.layer().shape, (47, 61, 3))
        self.assertEqual(image.layer("depth").shape, (47, 61, 1))
        np.testing.assert_array_equal(image.layer("eye.G")[..., 0], image.layer("eye")[..., 1])
        with self.assertRaisesRegex(lightmill.ImageError, "no layer 'glow'.*albedo"):
            image.layer("glow")

    def test_all_kinds_of_channels_and_compression_are_read(self):
        for compression, lines, pack in ((0, 1, bytes), (2, 1, zipped), (3, 16, zipped)):
            data, planes = exr_file(compression, lines, pack)
            image = lightmill.Image(data)
            self.assertEqual(image.attributes["owner"], "who")
            for name, plane in image.planes(["a", "b.X", "b.Y"]).items():
                np.testing.assert_array_equal(plane, planes[name])
        with self.assertRaisesRegex(lightmill.ImageError, "PIZ is not read: use ZIP"):
            lightmill.Image(exr_file(4, 16, zipped)[0])

    def test_a_damaged_file_is_an_error_and_nothing_else(self):
        whole, _ = exr_file(3, 16, zipped)
        random = np.random.default_rng(1)
        errors = 0
        for i in range(len(whole) + 2000):
            data = bytearray(whole[:i]) if i < len(whole) else bytearray(whole)
            if i >= len(whole):
                data[random.integers(len(data))] ^= 1 << random.integers(8)
            try:
                lightmill.Image(data).planes(["b.Y"])
            except lightmill.ImageError:
                errors += 1
        self.assertGreater(errors, len(whole))

    def test_lines_that_come_twice_do_not_stand_for_others(self):
        whole, _ = exr_file(2, 1, zipped)
        table = lightmill.Image(whole)._offsets.tobytes()
        with self.assertRaisesRegex(lightmill.ImageError, "lines of the image are missing"):
            lightmill.Image(whole.replace(table, table[:8] + table[:8] + table[16:])).planes(["a"])

    def test_a_file_without_channels_is_an_error(self):
        whole, _ = exr_file(3, 16, zipped)
        start = whole.index(b"chlist\0") + 7
        size = struct.unpack_from("<i", whole, start)[0]
        with self.assertRaisesRegex(lightmill.ImageError, "no channels"):
            lightmill.Image(whole[:start] + struct.pack("<i", 1) + b"\0" + whole[start + 4 + size:])


# ---- the farm ----


class Events(Case):
    def test_a_stream_is_read_as_the_standard_says(self):
        stream = b"retry: 1000\n\n:\n\nid: 7-1\nevent: job\ndata: {\"job\":\ndata: 1}\n\nid: 7-2\nevent: lost\r\ndata: {}\r\n\r\ndata: {"
        events = [event and (event.kind, event.data, event.name) for event in read_events(stream.splitlines(keepends=True))]
        self.assertEqual(events, [None, ("job", {"job": 1}, "7-1"), ("lost", {}, "7-2")])


class OnAFarm(Case):
    def test_a_job_is_watched_through_the_death_of_its_master(self):
        farm = self.farm()
        farm.start_worker()
        number = farm.submit("--time", "8", "--save-at", "16,64")
        job = lightmill.Master(data=farm.data).job(number)
        again = threading.Thread(target=lambda: (time.sleep(0.7), farm.start_master()))
        seen = []
        for status in job.watch(timeout=PATIENCE):
            seen.append(status)
            if len(seen) == 2:
                farm.kill_master()
                again.start()
        again.join()
        self.assertEqual([status.job for status in seen], [number] * len(seen))
        self.assertEqual(seen[-1].state, "done")
        self.assertGreater(len(seen), 4)
        self.assertGreater(seen[-1].ended, 0)
        self.assertEqual(job.wait(timeout=PATIENCE), job.last)
        self.check_history(job)
        self.check_images(farm, job)
        self.check_orders(farm, job)

    def check_history(self, job):
        history = job.history()
        self.assertGreater(len(history.error), 2)
        self.assertEqual(len(history.elapsed), len(history.samples))
        self.assertTrue((np.diff(history.samples) > 0).all())
        self.assertGreater(history.error[0], history.error[-1])
        self.assertEqual(history.samples[-1], job.last.samples_done)

    def check_images(self, farm, job):
        fetched, saved = f"{farm.folder}/fetched.exr", f"{farm.folder}/saved.exr"
        lightmill_command("fetch", str(job.number), "--master", f"127.0.0.1:{farm.port}", "--quiet", "-o", fetched)
        image = job.exr()
        self.assertEqual(pixel_hash(image), lightmill_command("info", "--hash", fetched).split()[0])
        self.assertIs(job.exr(), image, "an image that has not changed is fetched again")
        job.save(saved)
        self.assertEqual(lightmill_command("info", "--hash", saved), lightmill_command("info", "--hash", fetched))
        job.save(f"{farm.folder}/a.png", exposure=1)
        with open(f"{farm.folder}/a.png", "rb") as file:
            self.assertEqual(file.read(8), b"\x89PNG\r\n\x1a\n")
        self.assertEqual([name for name in os.listdir(farm.folder) if name.startswith(".")], [])
        self.assertEqual(job.layers(), image.layers())
        np.testing.assert_allclose(job.image("eye") + job.image("light"), job.image(), atol=1e-4)
        self.assertTrue((job.image("samples", at=16) == 16).all())
        with self.refused(409):
            job.exr(at=17)
        self.check_live(farm, job)

    def check_live(self, farm, job):
        picture = job.image()
        live = job.live()
        self.assertGreater(live.update(timeout=PATIENCE), 0)
        self.assertEqual(live.array.shape, (72, 100, 4))
        wait_for("last tiles", lambda: live.update() == 0 and np.allclose(live.array[..., :3], picture, rtol=2e-3, atol=1e-5))
        small = job.live("albedo", level=1)
        small.update(timeout=PATIENCE)
        self.assertEqual(small.array.shape, (36, 50, 4))
        albedo = job.image("albedo").reshape(36, 2, 50, 2, 3).mean((1, 3))
        np.testing.assert_allclose(small.array[..., :3], albedo, rtol=4e-3, atol=1e-4)
        tiles = job.tiles(rectangle=(0, 0, 64, 64))
        self.assertEqual([(x, y, texels.shape) for x, y, texels in tiles.tiles], [(0, 0, (64, 64, 4))])
        farm.kill_master()
        farm.start_master()
        before = live.array.copy()
        live.array[:] = 0  # as if it were of batches that the master has lost
        live.update(timeout=PATIENCE)
        np.testing.assert_array_equal(live.array, before)

    def check_orders(self, farm, job):
        with self.refused(409, "done"):
            job.pause()
        self.assertTrue(job.retain().retained)
        self.assertFalse(job.release().retained)
        self.assertEqual(job.priority(7).priority, 7)
        self.assertIn(job.extend(spp=1000000).state, ("queued", "running"))
        self.assertEqual(job.pause().state, "paused")
        with self.assertRaises(TimeoutError):
            job.wait(timeout=0.5)
        with self.refused(400):
            job.extend(error=2)
        self.assertNotEqual(job.resume().state, "paused")
        self.assertIn(job.cancel().state, ("finishing", "cancelled"))
        with self.assertRaisesRegex(lightmill.JobFailed, "cancelled"):
            job.wait(timeout=PATIENCE)
        watched = job.watch(timeout=PATIENCE)
        next(watched)
        master = lightmill.Master(data=farm.data)
        self.assertEqual([(each.number, each.last.state) for each in master.jobs()], [(job.number, "cancelled")])
        wait_for("worker", lambda: [(worker.threads, worker.connected) for worker in master.workers()] == [(1, True)])
        self.assertEqual(master.farm().jobs["cancelled"], 1)
        self.assertEqual(master.demand(), 0)
        job.delete()
        self.assertEqual(master.jobs(), [])
        with self.refused(404, "there is no job"):
            master.job(job.number)

    def test_a_job_that_is_deleted_is_no_longer_watched(self):
        farm = self.farm()
        job = lightmill.Master(data=farm.data).job(farm.submit("--spp", "64"))
        states = []
        for status in job.watch(timeout=PATIENCE):
            if not states:
                job.cancel()
                job.delete()
            states.append(status.state)
        self.assertEqual((states[0], states[-1]), ("queued", "deleted"))

    def test_a_scene_is_submitted_and_sent_once(self):
        farm = self.farm()
        master = lightmill.Master(data=farm.data)
        job = master.submit("scenes/cornell", program=f"{BUILD}/lightmill", spp=np.int64(16), width=50, height=40, seed=2**64 - 1,
                            save_at=[4, 8], priority=3, halves=True)
        self.assertEqual((job.last.name, job.last.spp, job.last.width, job.last.height, job.last.seed, job.last.priority),
                         ("cornell", 16, 50, 40, 2**64 - 1, 3))
        blob = f"{farm.folder}/a.blob"
        lightmill_command("import", "scenes/cornell", "--quiet", "-o", blob)
        with unittest.mock.patch("lightmill.scene._send_piece", side_effect=AssertionError("it is sent again")):
            self.assertEqual(master.submit(blob, name="again", spp=4, width=50, height=40).last.scene, job.last.scene)
        farm.start_worker()
        job.wait(timeout=PATIENCE)
        self.assertTrue((job.image("samples", at=8) == 8).all())
        halves = job.exr(halves=True)
        np.testing.assert_allclose((halves.layer("half0") + halves.layer("half1")) / 2, halves.layer(), atol=1e-3)
        os.mkdir(f"{farm.folder}/room")
        os.rename(blob, f"{farm.folder}/room/scene.blob")
        blob = f"{farm.folder}/room/scene.blob"
        self.assertEqual(master.submit(blob).last.name, "room")
        with self.refused(400, "knows no 'samples'"):
            master.submit(blob, samples=4)
        with self.assertRaisesRegex(lightmill.LightmillError, "nothing.pbrt"):
            master.submit(f"{farm.folder}/nothing.pbrt", program=f"{BUILD}/lightmill")
        with self.assertRaisesRegex(lightmill.LightmillError, "make install"):
            master.submit("scenes/cornell", program=f"{farm.folder}/nothing")

    def test_an_upload_goes_on_when_the_master_comes_back(self):
        farm = self.farm()
        blob, send, sent = f"{farm.folder}/a.blob", lightmill.scene._send_piece, []
        lightmill_command("import", "scenes/cornell", "--quiet", "-o", blob)

        def send_and_kill(connection, name, file, first, size):
            sent.append(first)
            if len(sent) == 3:
                farm.kill_master()
                farm.start_master()
            return send(connection, name, file, first, size)

        piece = os.path.getsize(blob) // 7
        with unittest.mock.patch("lightmill.scene._send_piece", send_and_kill), unittest.mock.patch("lightmill.scene.PIECE", piece):
            job = lightmill.Master(data=farm.data).submit(blob, spp=4, width=50, height=40)
        self.assertEqual(job.last.name, "a")
        self.assertEqual(sent, sorted(set(sent)), "what was there is sent again")
        self.assertGreaterEqual(len(sent), 7)

    def test_everything_that_happens_is_told(self):
        farm = self.farm()
        events = lightmill.Master(data=farm.data).events(timeout=PATIENCE)
        self.assertEqual(next(events).kind, "connected")
        farm.start_worker()
        event = next(event for event in events if event.kind == "worker")
        self.assertEqual(event.data["what"], "joined")

    def test_who_may_is_told_clearly(self):
        farm = self.farm()
        number = farm.submit("--spp", "64")
        page = read(f"{farm.data}/http").strip()
        view = lightmill_command("open", "--print", "--view", "--data", farm.data).strip()
        job = lightmill.Master(view).job(number)
        with self.refused(403):
            job.cancel()
        with self.refused(403):
            lightmill.Master(view).submit("scenes/cornell", program=f"{BUILD}/lightmill", seed=5)
        with self.refused(401, "token"):
            lightmill.Master(page, token="0" * 64).jobs()
        with self.refused(409):
            job.image()
        with self.assertRaisesRegex(lightmill.LightmillError, "wants a token"):
            lightmill.Master(page)
        with self.assertRaisesRegex(lightmill.LightmillError, "use https"):
            lightmill.Master("http://farm.example:7480", token="0" * 64)
        farm.kill_master()
        with self.assertRaisesRegex(lightmill.Unreachable, "no master answers"):
            job.status()
        with self.assertRaisesRegex(lightmill.Unreachable, "--http 7480"):
            lightmill.Master(data=farm.data)  # its address is still there; it may be another program's

    def test_tls_needs_the_right_certificate(self):
        folder = self.folder()
        for name in ("farm", "other"):
            subprocess.run(["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
                            "-subj", "/CN=localhost", "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", f"{folder}/{name}.key",
                            "-out", f"{folder}/{name}.pem"], check=True, stderr=subprocess.DEVNULL)
        farm = self.farm("--http-cert", f"{folder}/farm.pem", "--http-key", f"{folder}/farm.key")
        self.assertEqual(lightmill.Master(data=farm.data, ca=f"{folder}/farm.pem").jobs(), [])
        with self.assertRaisesRegex(lightmill.Unreachable, "certificate"):
            lightmill.Master(data=farm.data, ca=f"{folder}/other.pem").jobs()
        with self.assertRaisesRegex(lightmill.Unreachable, "certificate"):
            lightmill.Master(data=farm.data).jobs()


# ---- the package ----


class ThePackage(Case):
    def run_lines(self, document, farm):
        """The first indented lines that begin with "import lightmill", in a folder like the top of the tree."""
        lines = re.search(r"^    import lightmill\b.*\n(?:    .*\n)+", read(document), re.MULTILINE)[0]
        for name, target in (("scenes", f"{TOP}/scenes"), ("build", BUILD)):
            os.symlink(target, f"{farm.folder}/{name}")
        lines = re.sub("^    ", "", lines, flags=re.MULTILINE)
        return subprocess.run(["/usr/bin/python3", "-c", lines], cwd=farm.folder, check=True, stdout=subprocess.PIPE, text=True,
                              env={**os.environ, "PYTHONPATH": f"{TOP}/python"}).stdout

    def test_the_lines_of_the_readme_run_as_written(self):
        farm = self.farm()
        farm.start_worker()
        said = self.run_lines("README.md", farm)
        self.assertRegex(said, r"(?s)running: \d+ samples, error \d.*done: .*mean \[0\.\d")
        self.assertEqual(lightmill.read_image(f"{farm.folder}/cornell.exr").attributes["lightmill.spp"], 64)

    def test_the_lines_of_its_own_readme_run_as_written(self):
        farm = self.farm()
        farm.start_worker()
        farm.submit("--time", "2")
        said = self.run_lines("python/README.md", farm)
        self.assertRegex(said, r"(?s)running: \d+ samples, error \d.*done: .*albedo.*the error fell \d")
        self.assertEqual(lightmill.read_image(f"{farm.folder}/picture.exr").width, 100)

    def test_it_is_installed_by_pip(self):
        folder = self.folder()
        shutil.copytree(f"{TOP}/python", f"{folder}/python")
        subprocess.run(["/usr/bin/python3", "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--no-build-isolation",
                        "--disable-pip-version-check", "--root-user-action", "ignore", "--target", f"{folder}/there",
                        f"{folder}/python"], check=True, env={**os.environ, "HOME": folder})
        version = subprocess.run(["/usr/bin/python3", "-c", "import lightmill; print(lightmill.__file__, lightmill.__version__)"],
                                 check=True, env={**os.environ, "PYTHONPATH": f"{folder}/there"}, cwd=folder, text=True,
                                 stdout=subprocess.PIPE).stdout.split()
        self.assertEqual(version[0], f"{folder}/there/lightmill/__init__.py")
        self.assertEqual(version[1], lightmill_command("--version").split()[-1])


def main():
    tests = unittest.defaultTestLoader.loadTestsFromModule(sys.modules[__name__])
    result = unittest.TextTestRunner(stream=sys.stdout, verbosity=2).run(tests)
    bad = len(result.failures) + len(result.errors)
    print(f"[  PASSED  ] {result.testsRun - bad} tests")
    if bad:
        print(f"[  FAILED  ] {bad} tests")
    sys.exit(bad > 0)


main()
