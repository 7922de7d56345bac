#!/usr/bin/python3
"""The second implementation of the protocol (tests/kit), written from PROTOCOL.md alone, is understood by real masters and workers:
it submits, fetches, and tells on what a real worker delivers without a bit's difference.

make copies this to BUILD/tests/farm/test_kit, for tests/run.sh. It runs by Debian's Python, which has Debian's zmq and protobuf.
"""
import os
import sys
import unittest

BUILD = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(sys.argv[0]))))
sys.path[:0] = ["tests", f"{BUILD}/tests/kit"]
sys.dont_write_bytecode = True

from kit import client, keys, payload, wire  # noqa: E402
from kit.farm import Case, Programs, main  # noqa: E402
from kit.peer import Peer  # noqa: E402
from kit.wire import lm  # noqa: E402


def recoded(sums, result, settings):
    """Delivers the same sums, read by the kit and written anew in the other codec."""
    assert payload.content(settings, Kit.blob) == result.content, "the hash of the content is another"
    return True


class Kit(Case):
    def test_checksum(self):
        self.assertEqual(wire.crc32c(b"123456789"), 0xE3069283)
        data = os.urandom(100000)
        self.assertEqual(wire.crc32c(data[70001:], wire.crc32c(data[:70001])), wire.crc32c(data))

    def test_keys_that_lightmill_makes_are_read(self):
        farm = self.farm()
        self.programs.run("keygen", "node", "--out", farm.folder)
        public, secret = keys.read_secret(f"{farm.folder}/node.secret")
        self.assertEqual(keys.read_public(f"{farm.folder}/node.key"), public)
        self.assertEqual((len(public), len(secret)), (40, 40))

    def test_an_image_through_the_kit_has_the_undisturbed_hash(self):
        settings = client.settings(features=True, cryptomatte=True, light_groups="all=area", spp=40, width=140, height=100)
        farm = self.farm()
        Kit.blob = farm.blob
        middle = farm.start_between(change=recoded)
        job = farm.submit(settings)
        status = farm.client.wait(job)
        self.assertEqual((status.state, status.batches_refused, status.message), (client.DONE, 0, ""))
        self.assertGreater(middle.changed, 0)
        self.assertEqual(farm.hash(job), self.programs.undisturbed(settings))

    def test_batches_that_were_held_back_and_added_up_count(self):
        settings = client.settings(integrator=payload.PATH, spp=64)
        farm = self.farm()
        middle = farm.start_between(gather=True)
        job = farm.submit(settings)
        self.assertEqual(farm.client.wait(job).state, client.DONE)
        self.assertEqual(middle.refusals, [])
        self.assertEqual(farm.hash(job), self.programs.undisturbed(settings))

    def test_what_is_wrong_is_refused_with_its_code(self):
        farm = self.farm()
        worker = farm.make_worker()
        worker.hello()
        self.assertTrue(worker.beat())
        worker.id += 1
        self.assertFalse(worker.beat())
        for question, code in [(lm.JobStatusRequest(), wire.DENIED), (lm.WorkRequest(worker=worker.id), wire.UNREACHABLE),
                               (lm.Hello(protocol_version=wire.VERSION + 1), wire.PROTOCOL)]:
            with self.assertRaises(wire.Refused) as caught:
                worker.control.ask(question)
            self.assertEqual(caught.exception.code, code, question)
        for spoil in (lambda head: head[:5] + bytes([head[5] ^ 1]) + head[6:], lambda head: head[:-1], lambda head: b"LMIL"):
            head = wire.pack(lm.Heartbeat(worker=worker.id))[0]
            worker.control.socket.send(spoil(head))
            request, body, _ = worker.control.next(10)
            self.assertEqual((request, body.code), (0, wire.PROTOCOL))

    def test_settings_out_of_their_range_are_refused(self):
        farm = self.farm()
        for wrong in (dict(integrator=6), dict(integrator=0), dict(merge_radius=1), dict(sampler=0), dict(sampler=3), dict(width=0), dict(height=32769),
                      dict(width=32768, height=4097), dict(max_depth=101), dict(spp=0), dict(spp=2**30 + 1), dict(tile_size=7),
                      dict(tile_size=257), dict(film_scale=41), dict(time_limit=-1), dict(error=1), dict(strategy_s=1, strategy_t=1),
                      dict(unweighted=True), dict(cryptomatte=True, integrator=payload.LIGHT)):
            with self.assertRaises(wire.Refused) as caught:
                farm.submit(client.settings(**wrong))
            self.assertEqual(caught.exception.code, wire.USAGE, wrong)
        for terms in (dict(priority=1001), dict(verify=1.5)):
            with self.assertRaises(wire.Refused) as caught:
                farm.submit(client.settings(), **terms)
            self.assertEqual(caught.exception.code, wire.USAGE, terms)

    def test_a_frame_over_the_limit_ends_a_connection_and_a_header_over_its_own_is_refused(self):
        farm = self.farm()
        peer = Peer(f"tcp://127.0.0.1:{farm.port}", farm.keys["client"], farm.master_key)
        self.addCleanup(peer.close)
        peer.ask(lm.JobStatusRequest())
        peer.socket.send(bytes(17000))
        with self.assertRaises(TimeoutError):
            peer.ask(lm.JobStatusRequest(), timeout=0.1)  # it was lost with the connection
        peer.ask(lm.JobStatusRequest())
        farm.client.bulk.socket.send(wire.MAGIC + bytes([wire.VERSION]) + bytes(1 << 20))
        request, body, _ = farm.client.bulk.next(10)
        self.assertEqual((request, body.code), (0, wire.PROTOCOL))

    def test_a_key_that_is_not_listed_gets_no_answer(self):
        farm = self.farm()
        stranger = keys.make(farm.folder, "stranger")
        peer = Peer(f"tcp://127.0.0.1:{farm.port}", stranger, farm.master_key)
        self.addCleanup(peer.close)
        with self.assertRaises(TimeoutError):
            peer.ask(lm.Hello(protocol_version=wire.VERSION), timeout=0.7)


if __name__ == "__main__":
    main(Kit, Programs(BUILD))
