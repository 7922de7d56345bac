#!/usr/bin/python3
"""Workers that take units and deliver nothing hold up a job by little.

The workers are those of the second implementation (tests/kit). make copies this to BUILD/tests/farm/test_kit_idle, for tests/run.sh.
"""
import os
import sys
import time

BUILD = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(sys.argv[0]))))
sys.path[:0] = ["tests", f"{BUILD}/tests/kit"]
sys.dont_write_bytecode = True

from kit import client  # noqa: E402
from kit.farm import Case, Programs, main, wait_for  # noqa: E402
from kit.worker import Idlers  # noqa: E402


LEASE, SLACK = 2, 1  # seconds; what Python itself takes of two cores, and the noise of the clock
TRIES = 3  # a machine that stands still for a lease delays the job by more


class Idle(Case):
    def delay(self, settings):
        """Seconds of a job alone, and beside ten idle workers, on a farm of its own."""
        farm = self.farm("--lease", str(LEASE))
        fingerprint = farm.fingerprint()
        farm.start_worker()
        wait_for("worker", farm.client.workers)

        def seconds():
            start = time.monotonic()
            self.assert_undisturbed(farm, farm.submit(settings), settings)
            return time.monotonic() - start

        alone = seconds()
        idlers = Idlers([farm.make_worker(call=f"idle{i}:{i}", fingerprint=fingerprint) for i in range(10)]).start()
        self.addCleanup(idlers.stop)
        wait_for("idle workers", lambda: len(farm.client.workers()) == 11)
        beside = seconds()
        idlers.stop()
        alone = max(alone, seconds())
        print(f"{alone:.2f} s alone, {beside:.2f} s beside idle workers that took {idlers.taken} units", flush=True)
        self.assertGreater(idlers.taken, 0)
        return alone, beside

    def test_idle_identities_delay_a_job_by_a_lease_and_a_tenth(self):
        for spp in (64, 128):  # shorter than a lease and longer: idle workers are overtaken before they are late, or not
            settings = client.settings(spp=spp)
            self.programs.undisturbed(settings)
            self.assertTrue(any(self.is_small(*self.delay(settings)) for _ in range(TRIES)), f"{TRIES} times in a row")

    @staticmethod
    def is_small(alone, beside):
        return beside < alone * 1.1 + LEASE + SLACK


if __name__ == "__main__":
    main(Idle, Programs(BUILD))
