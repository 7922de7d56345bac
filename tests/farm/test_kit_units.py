#!/usr/bin/python3
"""Only units that were issued to who delivers them are counted.

The workers are those of the second implementation (tests/kit). make copies this to BUILD/tests/farm/test_kit_units, for tests/run.sh.
"""
import os
import sys

BUILD = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(sys.argv[0]))))
sys.path[:0] = ["tests", f"{BUILD}/tests/kit"]
sys.dont_write_bytecode = True

from kit import client, payload, wire  # noqa: E402
from kit.farm import Case, Programs, main  # noqa: E402
from kit.lies import everything, grey_batch  # noqa: E402
from kit.wire import lm  # noqa: E402
from kit.worker import light_paths  # noqa: E402


class Units(Case):
    def test_units_that_were_not_issued_are_refused(self):
        settings = client.settings()

        def like(unit, **changed):
            made = lm.Unit()
            made.CopyFrom(unit)
            for name, value in changed.items():
                setattr(made, name, value)
            return [made]

        lies = {  # by the name of who tells it: what it makes of the unit that it was given
            "everything": lambda unit: [unit, *everything(settings, 8, [unit])],
            "tile": lambda unit: like(unit, tile=(unit.tile + 1) % payload.tile_count(settings)),
            "mac": lambda unit: like(unit, mac=unit.mac ^ 1),
            "longer": lambda unit: like(unit, count=unit.count + 1),
            "shorter": lambda unit: like(unit, count=1),
            "next": lambda unit: like(unit, first=unit.first + unit.count),
            "shifted": lambda unit: like(unit, first=unit.first + 1, before=1),
            "stretched": lambda unit: like(unit, count=1, after=unit.count),
            "wrapped": lambda unit: like(unit, first=unit.first + unit.count, before=unit.count, after=2**32 - unit.count),
            "check": lambda unit: [unit], "other": lambda unit: [unit], "future": lambda unit: everything(settings, 64)}
        farm = self.farm(names=["honest", "thief", *lies])
        job, queued = farm.submit(settings), farm.submit(settings, priority=-1)
        content, fingerprint = payload.content(settings, farm.blob), farm.fingerprint()

        def deliver(worker, job, units, **more):
            worker.hello()
            try:
                counts = light_paths(settings, units)
                return worker.deliver(job, content, grey_batch(settings, units), counts=counts, **more).accepted
            except wire.Refused as refusal:
                self.assertNotIn(refusal.code, (wire.LIMIT, wire.UNREACHABLE, wire.CANCELLED), refusal)
                return False

        for name, lie in lies.items():
            liar = farm.make_worker(name, fingerprint=fingerprint)
            liar.hello()
            unit = liar.ask_work(samples=1, unit_samples=4096).units[0]
            self.assertGreater(unit.count, 1)
            told = deliver(liar, queued if name in ("other", "future") else job, lie(unit), check=7 if name == "check" else 0)
            self.assertFalse(told, name)
            liar.leave()
        thief = farm.make_worker("thief", fingerprint=fingerprint)
        self.assertFalse(deliver(thief, job, [unit]))  # it was issued to another
        thief.leave()
        self.assertEqual(farm.client.status(job).samples_counted, 0)
        self.assertEqual(farm.client.status(queued).state, client.QUEUED)
        farm.start_worker()
        self.assert_undisturbed(farm, job, settings)
        self.assert_undisturbed(farm, queued, settings)

    def test_what_was_issued_may_come_in_pieces_and_under_another_name(self):
        settings = client.settings()
        farm = self.farm()
        job, content, fingerprint = farm.submit(settings), payload.content(settings, farm.blob), farm.fingerprint()
        first, again = (farm.make_worker(call=name, fingerprint=fingerprint) for name in ("a:1", "b:2"))
        first.hello()
        unit = first.ask_work(samples=1, unit_samples=4096).units[0]
        farm.kill_master()
        farm.start_master()
        again.hello()
        for before in range(2):  # the third sample and those after it never come
            piece = lm.Unit(tile=unit.tile, first=unit.first + before, count=1, mac=unit.mac, before=before,
                            after=unit.count - before - 1)
            reply = again.deliver(job, content, grey_batch(settings, [piece]), counts=light_paths(settings, [piece]))
            self.assertTrue(reply.accepted, reply.reason)
        self.assertEqual(farm.client.status(job).samples_counted, 2 * payload.unit_samples(settings, unit) // unit.count)


if __name__ == "__main__":
    main(Units, Programs(BUILD))
