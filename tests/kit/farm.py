"""Real masters and workers, with a key for each, and the things that tests of them need."""
import os
import shutil
import subprocess
import sys
import tempfile
import time
import unittest

import ports
from kit import between, client, keys, worker

PATIENCE = 120  # seconds for anything, on a machine that does other things too, or with programs under a sanitizer
SCENE = "scenes/cornell"


def wait_for(what, ask, timeout=PATIENCE):
    deadline = time.monotonic() + timeout
    while not (answer := ask()):
        if time.monotonic() > deadline:
            raise AssertionError(f"there is no {what}")
        time.sleep(0.05)
    return answer


def read(path):
    with open(path, encoding="utf-8", errors="replace") as file:
        return file.read()


class Programs:
    """What was built in a folder, and what it makes of a scene when nobody disturbs it."""

    def __init__(self, build):
        self.build = build
        self.folder = tempfile.mkdtemp(prefix="lightmill-kit-")
        self.blob = f"{self.folder}/scene.blob"
        self.run("import", SCENE, "-o", self.blob, "--quiet")
        self.hashes = {}

    def run(self, *arguments):
        return subprocess.run([f"{self.build}/lightmill", *arguments], check=True, stdout=subprocess.PIPE, text=True).stdout

    def hash(self, path):
        return self.run("info", "--hash", path).strip()

    def undisturbed(self, settings):
        """The hash of the image that `lightmill render` makes with these settings."""
        integrator = ("bdpt", "path", "light", "ao")[settings.integrator - 1]
        options = ["--integrator", integrator, "--spp", str(settings.spp), "--max-depth", str(settings.max_depth), "--seed",
                   str(settings.seed), "--resolution", f"{settings.width}x{settings.height}", "--tile-size", str(settings.tile_size),
                   "--film-scale", str(settings.film_scale), "--sampler", ("sobol", "independent")[settings.sampler - 1]]
        options += [] if settings.features else ["--no-layers"]
        options += ["--cryptomatte"] if settings.cryptomatte else []
        options += [] if settings.learn else ["--no-learn"]
        options += ["--spectral"] if settings.spectral else []
        options += ["--light-groups", settings.light_groups] if settings.light_groups else []
        if (named := " ".join(options)) not in self.hashes:
            path = f"{self.folder}/undisturbed.exr"
            self.run("render", self.blob, "--quiet", "-o", path, *options)
            self.hashes[named] = self.hash(path)
        return self.hashes[named]

    def close(self):
        shutil.rmtree(self.folder)


class Farm:
    """A master that uses keys, and workers; each of `names` has a key of its own."""

    def __init__(self, programs, *options, names=("honest", "second", "liar")):
        self.programs, self.processes, self.peers = programs, [], []
        self.folder = tempfile.mkdtemp(prefix="lightmill-kit-")
        self.port = ports.choose_pair()
        self.master_key, _ = keys.make(self.folder, "master")
        self.keys = {name: keys.make(self.folder, name) for name in ("client", *names)}
        with open(f"{self.folder}/allow", "w", encoding="ascii") as allow:
            for name, (public, _) in self.keys.items():
                allow.write(f"{'client' if name == 'client' else 'worker'} {public} {name}\n")
        self.options = options
        self.start_master()
        self.client = client.Client("127.0.0.1", self.port, self.keys["client"], self.master_key)
        self.blob = self.client.upload(programs.blob)

    def _start(self, name, *arguments):
        with open(f"{self.folder}/{name}.log", "ab") as log:
            process = subprocess.Popen(arguments, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
        self.processes.append(process)
        return process

    def start_master(self):
        log = f"{self.folder}/master.log"
        before = len(read(log)) if os.path.exists(log) else 0
        self.master = self._start("master", f"{self.programs.build}/lightmill-master", "--listen", f"127.0.0.1:{self.port}", "--data",
                                  f"{self.folder}/data", "--key", f"{self.folder}/master.secret", "--allow", f"{self.folder}/allow",
                                  "--batch-interval", "0.2", "--checkpoint", "0.5", "--heartbeat", "0.2", "--lease", "2",
                                  *self.options)
        wait_for("master", lambda: "listen" in read(log)[before:])

    def kill_master(self):
        self.master.kill()
        self.master.wait()

    def log(self, name="master"):
        return read(f"{self.folder}/{name}.log")

    def start_worker(self, name="honest", port=None, threads=1):
        """A real worker, with the key of that name; at another port one without keys."""
        keyed = [] if port else ["--key", f"{self.folder}/{name}.secret", "--master-key", self.master_key]
        return self._start(f"worker-{name}", f"{self.programs.build}/lightmill-worker", f"127.0.0.1:{port or self.port}", "--threads",
                           str(threads), "--cache", f"{self.folder}/cache", "--name", f"{name}:1", "--verbose", *keyed)

    def start_between(self, name="liar", **how):
        """A real worker that comes to the master through one that may change what it delivers."""
        middle = between.Between("127.0.0.1", self.port, self.keys[name], self.master_key, **how).start()
        self.peers.append(middle)
        self.start_worker(name, middle.port)
        return middle

    def make_worker(self, name="liar", call=None, **how):
        """A worker of the kit, without a renderer."""
        made = worker.Worker("127.0.0.1", self.port, call or f"{name}:1", keys=self.keys[name], master_key=self.master_key, **how)
        self.peers.append(made)
        return made

    def fingerprint(self):
        """The fingerprint of this machine's workers: that of one which never gets to the master."""
        middle = between.Between("127.0.0.1", ports.choose_pair()).start()  # nobody is there
        process = self.start_worker("nobody", middle.port)
        hello = wait_for("hello", lambda: middle.hello_message)
        process.kill()
        middle.stop()
        return hello.fingerprint

    def submit(self, settings, **terms):
        return self.client.submit(self.blob, settings, **terms)

    def aside(self, name):
        """Why the party of that key is put aside; empty: it is not."""
        return " ".join(worker.aside for worker in self.client.workers() if worker.key == name)

    def hash(self, job):
        path = f"{self.folder}/{job}.exr"
        self.client.fetch(job, path)
        return self.programs.hash(path)

    def close(self):
        for process in self.processes:
            process.kill()
            process.wait()
        self.client.close()
        for peer in self.peers:
            (peer.stop if isinstance(peer, between.Between) else peer.close)()
        shutil.rmtree(self.folder, ignore_errors=True)
        self.processes, self.peers = [], []


# ---- tests ----


class Case(unittest.TestCase):
    """Tests on farms; `main` says of which programs."""

    programs = None

    def farm(self, *options, **more):
        farm = Farm(self.programs, *options, **more)
        self.addCleanup(farm.close)
        return farm

    def assert_undisturbed(self, farm, job, settings):
        """Waits until the job is done, and finds the image that nobody has disturbed; the job's status."""
        status = farm.client.wait(job)
        self.assertEqual(status.state, client.DONE, status.message)
        self.assertEqual(status.samples_skipped, 0)
        self.assertEqual(farm.hash(job), self.programs.undisturbed(settings))
        return status


def main(cases, programs):
    """Runs the tests of a class, and says how many passed in the words that tests/run.sh reads. Arguments choose tests by parts of
    their names."""
    cases.programs = programs
    names = [name for name in unittest.defaultTestLoader.getTestCaseNames(cases)
             if not sys.argv[1:] or any(part in name for part in sys.argv[1:])]
    try:
        result = unittest.TextTestRunner(stream=sys.stdout, verbosity=2).run(unittest.TestSuite(map(cases, names)))
    finally:
        programs.close()
    bad = len(result.failures) + len(result.errors)
    print(f"[  PASSED  ] {result.testsRun - bad} tests")
    if bad:
        print(f"[  FAILED  ] {bad} tests")
    sys.exit(bad > 0)
