#!/usr/bin/python3
"""A worker that delivers sums that no light makes is found, it ends no job, and nothing of them is in the image.

The workers are real ones, whose sums the second implementation changes on their way (tests/kit). make copies this to
BUILD/tests/farm/test_kit_sums, for tests/run.sh.
"""
import os
import sys

BUILD = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(sys.argv[0]))))
sys.path[:0] = ["tests", f"{BUILD}/tests/kit"]
sys.dont_write_bytecode = True

from kit import client, lies  # noqa: E402
from kit.farm import Case, Programs, main, wait_for  # noqa: E402


class Sums(Case):
    def test_sums_that_no_light_makes_condemn_their_sender(self):
        settings = client.settings(spp=64)
        told = [lies.overflow, lies.claimed_overflow, lies.poison, lies.splat_poison, lies.negative]
        farm = self.farm(names=["honest", *(lie.__name__ for lie in told)])
        farm.start_worker()
        for lie in told:
            middle = farm.start_between(lie.__name__, change=lies.In(lie, times=1))
            wait_for("liar", lambda middle=middle: middle.hello_message)
            job = farm.submit(settings)
            self.assert_undisturbed(farm, job, settings)
            self.assertEqual(middle.changed, 1, lie)
            self.assertNotEqual(farm.aside(lie.__name__), "", f"{lie}\n{farm.log()}")
        self.assertEqual(farm.aside("honest"), "")


if __name__ == "__main__":
    main(Sums, Programs(BUILD))
