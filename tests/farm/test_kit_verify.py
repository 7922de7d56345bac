#!/usr/bin/python3
"""A worker that lies in some of its batches of a verified job is found before the job is done, and nothing of it is in the image.

The workers are real ones, whose sums the second implementation changes on their way (tests/kit). make copies this to
BUILD/tests/farm/test_kit_verify, for tests/run.sh; `make hostile` repeats the tests of lies that are a matter of chance.
"""
import os
import random
import sys

BUILD = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(sys.argv[0]))))
sys.path[:0] = ["tests", f"{BUILD}/tests/kit"]
sys.dont_write_bytecode = True

from kit import client, lies  # noqa: E402
from kit.farm import Case, Programs, main  # noqa: E402

RUNS = int(os.environ.get("HOSTILE_RUNS", "1"))


class Verified(Case):
    def lied(self, **how):
        """One job beside a liar; whether a lie of it was taken at all before the job was done."""
        settings = client.settings(spp=256)
        farm = self.farm("--batch-interval", "0.1")
        middle = farm.start_between(**how)
        farm.start_worker()
        farm.start_worker("second")  # decides when two disagree
        job = farm.submit(settings, verify=0.05)
        self.assert_undisturbed(farm, job, settings)
        told = middle.told
        if told:
            self.assertNotEqual(farm.aside("liar"), "", f"{told} lies of {middle.batches} batches\n{farm.log()}")
        self.assertEqual(farm.aside("honest") + farm.aside("second"), "")
        print(f"{middle.batches} batches, {told} of them lies", flush=True)
        farm.close()
        return told > 0

    def lied_often(self, lie, **how):
        found = runs = 0
        while found < RUNS:
            self.assertLess(runs, 5 * RUNS + 10, "the liar hardly ever comes to lie")
            found, runs = found + self.lied(change=lie(), **how), runs + 1
        print(f"{found} of {found} liars were found", flush=True)

    def test_lies_in_a_tenth_of_the_batches_are_found(self):
        self.lied_often(lambda: lies.In(random.choice([lies.grey, lies.bit_flip]), every=10))

    def test_a_lie_in_one_batch_of_everything_is_found(self):
        self.lied_often(lambda: lies.In(lies.grey, every=3, times=1), gather=True)


if __name__ == "__main__":
    main(Verified, Programs(BUILD))
