#!/usr/bin/env python3
"""An image viewer without a window: listens as tev does, puts the image together from the packets, says what came.

It shares no code with Lightmill: the packets are read as https://github.com/Tom94/tev describes them (README.md, "Over
the Network"), and whatever is not as it should be ends it with "error: ...".

usage: tev_viewer.py PORT [--deaf]      PORT 0: a free one; --deaf: accepts connections and never reads

Lines that it prints:
  listening PORT
  connected
  create WIDTHxHEIGHT CHANNEL,CHANNEL,... NAME
  shown updates=N values=N hash=HEX     since the last such line; when nothing came for a while, or at the end of a
                                        connection. HEX is what `lightmill info --hash` prints of an equal image.
  closed
"""
import array
import hashlib
import select
import socket
import struct
import sys

PAUSE = 0.25  # seconds without packets after which the image is looked at
CREATE_IMAGE, UPDATE_IMAGE_V3 = 4, 6


def say(text):
    print(text, flush=True)


def check(condition, text):
    if not condition:
        say(f"error: {text}")
        sys.exit(1)


class Packet:
    """Reads the fields of a packet one after the other."""

    def __init__(self, data):
        self.data, self.at = data, 0

    def take(self, form):
        size = struct.calcsize("<" + form)
        check(self.at + size <= len(self.data), "a packet is too short")
        value = struct.unpack_from("<" + form, self.data, self.at)
        self.at += size
        return value if len(value) > 1 else value[0]

    def text(self):
        end = self.data.find(b"\0", self.at)
        check(end >= 0, "a text without an end")
        value = self.data[self.at : end].decode()
        self.at = end + 1
        return value

    def texts(self):
        count = self.take("i")
        check(0 < count < 10000, f"{count} channels")
        return [self.text() for _ in range(count)]

    def rest(self):
        value = self.data[self.at :]
        self.at = len(self.data)
        return value


class Image:
    def __init__(self, width, height, channels):
        check(0 < width < 65536 and 0 < height < 65536, f"an image of {width} x {height}")
        check(len(set(channels)) == len(channels), "two channels of one name")
        self.width, self.height = width, height
        self.planes = {name: bytearray(4 * width * height) for name in channels}

    def update(self, name, box, values, offset, stride):
        x, y, width, height = box
        check(name in self.planes, f"there is no channel {name}")
        check(x >= 0 and y >= 0 and width > 0 and height > 0, f"a rectangle {box}")
        check(x + width <= self.width and y + height <= self.height, f"{box} is not inside of the image")
        last = offset + (width * height - 1) * stride
        check(offset >= 0 and stride > 0 and last < len(values) // 4, "values are missing")
        words = memoryview(values).cast("I")  # not floats: every bit of them counts
        plane = memoryview(self.planes[name]).cast("I")
        for row in range(height):
            begin = offset + row * width * stride
            line = words[begin : begin + (width - 1) * stride + 1 : stride]
            start = (y + row) * self.width + x
            plane[start : start + width] = line if stride == 1 else array.array("I", line)

    def hash(self):
        state = hashlib.blake2b(struct.pack("<ii", self.width, self.height), digest_size=32)
        for name in sorted(self.planes, key=str.encode):
            state.update(name.encode() + b"\0" + self.planes[name])
        return state.hexdigest()


class Viewer:
    def __init__(self):
        self.images, self.name = {}, None
        self.updates = self.values = 0

    def packet(self, data):
        packet = Packet(data)
        kind, focus, name = packet.take("B"), packet.take("B"), packet.text()
        check(focus in (0, 1), f"a flag of {focus}")
        check(kind in (CREATE_IMAGE, UPDATE_IMAGE_V3), f"a packet of kind {kind}")
        (self.create if kind == CREATE_IMAGE else self.update)(packet, name)
        check(packet.at == len(data), "a packet is too long")
        self.name = name

    def create(self, packet, name):
        width, height = packet.take("ii")
        channels = packet.texts()
        check(not any(channel[:1].isdigit() for channel in channels), "tev reads digits in front of names as lengths")
        self.images[name] = Image(width, height, channels)
        say(f"create {width}x{height} {','.join(channels)} {name}")

    def update(self, packet, name):
        check(name in self.images, f"there is no image {name}")
        channels = packet.texts()
        box = packet.take("iiii")
        offsets = [packet.take("q") for _ in channels]
        strides = [packet.take("q") for _ in channels]
        values = packet.rest()
        check(len(values) % 4 == 0, "half a value")
        for channel, offset, stride in zip(channels, offsets, strides):
            self.images[name].update(channel, box, values, offset, stride)
        self.updates += 1
        self.values += len(values) // 4

    def show(self):
        if self.updates == 0:
            return
        say(f"shown updates={self.updates} values={self.values} hash={self.images[self.name].hash()}")
        self.updates = self.values = 0


def serve(connection, viewer):
    data = bytearray()
    while True:
        if not select.select([connection], [], [], PAUSE)[0]:
            viewer.show()
            continue
        try:
            more = connection.recv(1 << 20)
        except ConnectionResetError:
            more = b""
        if not more:
            break
        data += more
        at = 0
        while len(data) - at >= 4:
            (length,) = struct.unpack_from("<I", data, at)
            check(5 <= length < 1 << 31, f"a packet of {length} bytes")
            if len(data) - at < length:
                break
            viewer.packet(bytes(data[at + 4 : at + length]))
            at += length
        del data[:at]
    viewer.show()
    check(not data, "the connection ends inside of a packet")
    say("closed")


def main():
    port, deaf = int(sys.argv[1]), "--deaf" in sys.argv
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.bind(("127.0.0.1", port))
    listener.listen(5)
    say(f"listening {listener.getsockname()[1]}")
    kept = []
    while True:
        connection, _ = listener.accept()
        say("connected")
        if deaf:
            kept.append(connection)
        else:
            serve(connection, Viewer())


main()
