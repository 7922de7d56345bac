"""A second implementation of the protocol of Lightmill, written from proto/wire/PROTOCOL.md and lightmill.proto alone.

It is what tests use to be a worker that no worker of ours would be: one that hoards, makes units up, or lies about sums.
It shares no code with the product, so it also tests that PROTOCOL.md is enough to write a worker and a client.

    wire      headers, checksums, the schema
    keys      CURVE keys and their files
    payload   the sums of a batch, as numpy arrays
    peer      a connection: questions and their answers
    client    submits, asks and fetches
    worker    says hello, beats, asks for units, delivers; it does not render
    between   stands between a real worker and the master, so that it can hold back or change what is delivered
    lies      what it may do to them, and units that were never issued
    farm      real masters and workers for tests

make puts the module of the schema, lightmill_pb2, into BUILD/tests/kit; it must be on sys.path.
"""
