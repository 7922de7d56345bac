#!/usr/bin/env python3
"""Cryptomatte layers, read by a decoder of this file's own: its OpenEXR reader, its hash and its way from a name to a
matte share nothing with the programs. The mattes must be those of a sphere and of a disk, sample by sample.

make copies this to BUILD/tests/farm/test_mattes, for tests/run.sh.
"""
import base64
import json
import math
import os
import struct
import subprocess
import sys
import tempfile
import time
import zlib

sys.path.insert(0, "tests")
sys.dont_write_bytecode = True

import ports  # noqa: E402

BUILD = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(sys.argv[0]))))
PATIENCE = 60  # seconds
SIDE = 64
RADIUS = 0.61  # of the sphere; the image is 2 wide
LINES = [
    'Camera "orthographic" "float screenwindow" [-1 1 -1 1]',
    'Integrator "path" "integer maxdepth" [2]',
    "WorldBegin",
    'LightSource "infinite"',
    'MakeNamedMaterial "clay" "string type" ["matte"]',
    'NamedMaterial "clay"',
    "Translate 0 0 5",
    f'Shape "sphere" "float radius" [{RADIUS}]',
    "Translate 0.3 0.2 2",
    'Shape "disk" "float radius" [0.6]',
    'MakeNamedMaterial "lead" "string type" ["matte"]',
    'NamedMaterial "lead"',
    # Two shapes of one line have one name, and so one matte.
    'Translate -1.1 0.5 0 Shape "disk" "float radius" [0.2] Translate 0 -0.6 0 Shape "disk" "float radius" [0.2]',
    "WorldEnd",
]


# ---- OpenEXR ---------------------------------------------------------------------------------------------------


def text_at(data, at):
    end = data.index(b"\0", at)
    return data[at:end].decode(), end + 1


def read_header(data):
    """The attributes {name: (type, bytes)} and where they end."""
    assert data[:4] == b"\x76\x2f\x31\x01"
    attributes, at = {}, 8
    while data[at]:
        name, at = text_at(data, at)
        kind, at = text_at(data, at)
        (size,) = struct.unpack_from("<i", data, at)
        attributes[name] = (kind, data[at + 4 : at + 4 + size])
        at += 4 + size
    return attributes, at + 1


def read_channels(packed):
    """Names and pixel types (1: half, 2: float), in the order of the file."""
    channels, at = [], 0
    while packed[at]:
        name, at = text_at(packed, at)
        channels.append((name, struct.unpack_from("<i", packed, at)[0]))
        at += 16
    return channels


def unzip(packed, size):
    if len(packed) == size:
        return packed
    data = bytearray(zlib.decompress(packed))
    assert len(data) == size
    for i in range(1, size):
        data[i] = (data[i - 1] + data[i] - 128) & 255
    half = (size + 1) // 2
    result = bytearray(size)
    result[0::2], result[1::2] = data[:half], data[half:]
    return bytes(result)


class Image:
    """An EXR of scan lines, compressed by ZIP: planes of floats, their bits too, and the text attributes."""

    def __init__(self, path):
        with open(path, "rb") as file:
            data = file.read()
        attributes, at = read_header(data)
        assert attributes["compression"][1] == b"\x03", "not ZIP"
        left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"][1])
        self.width, self.height = right - left + 1, bottom - top + 1
        self.types = dict(read_channels(attributes["channels"][1]))
        self.texts = {n: v.decode() for n, (kind, v) in attributes.items() if kind == "string"}
        self.floats = {name: [] for name in self.types}
        self.bits = {name: [] for name in self.types}
        for y in range(0, self.height, 16):
            (place,) = struct.unpack_from("<Q", data, at + 8 * (y // 16))
            row, size = struct.unpack_from("<2i", data, place)
            assert row == top + y
            self.read_block(data[place + 8 : place + 8 + size], min(16, self.height - y))

    def read_block(self, packed, rows):
        row_bytes = sum(self.width * (2 if kind == 1 else 4) for kind in self.types.values())
        block, at = unzip(packed, rows * row_bytes), 0
        for _ in range(rows):
            for name, kind in self.types.items():
                letters = "e" if kind == 1 else "f"
                size = self.width * (2 if kind == 1 else 4)
                self.floats[name] += struct.unpack(f"<{self.width}{letters}", block[at : at + size])
                if kind == 2:
                    self.bits[name] += struct.unpack(f"<{self.width}I", block[at : at + size])
                at += size


# ---- Cryptomatte -----------------------------------------------------------------------------------------------


def murmur3(data):
    """MurmurHash3_x86_32 with seed 0."""

    def rotate(x, bits):
        return (x << bits | x >> (32 - bits)) & 0xFFFFFFFF

    def scramble(k):
        return rotate(k * 0xCC9E2D51 & 0xFFFFFFFF, 15) * 0x1B873593 & 0xFFFFFFFF

    h, whole = 0, len(data) // 4 * 4
    for (word,) in struct.iter_unpack("<I", data[:whole]):
        h = (rotate(h ^ scramble(word), 13) * 5 + 0xE6546B64) & 0xFFFFFFFF
    h ^= scramble(int.from_bytes(data[whole:], "little"))
    h ^= len(data)
    h = (h ^ h >> 16) * 0x85EBCA6B & 0xFFFFFFFF
    h = (h ^ h >> 13) * 0xC2B2AE35 & 0xFFFFFFFF
    return h ^ h >> 16


def id_of(name):
    """The bits of the float that stands for a name: the exponent stays within 1 to 254."""
    bits = murmur3(name.encode())
    exponent = min(max(bits >> 23 & 255, 1), 254)
    return bits & 0x807FFFFF | exponent << 23


def name_with_exponent(start, exponent):
    """A name whose hash would be no normal float, were it not for the clamping."""
    return next(n for n in (f"{start} {i}" for i in range(10000)) if murmur3(n.encode()) >> 23 & 255 == exponent)


class Mattes:
    """One kind of mattes of an image, found as a compositing program finds them: by the attributes."""

    def __init__(self, image, typename):
        (key,) = [n.split("/")[1] for n, v in image.texts.items() if n.endswith("/name") and v == typename]
        assert 1 <= len(key) <= 7, key
        entry = {n.split("/")[2]: v for n, v in image.texts.items() if n.startswith(f"cryptomatte/{key}/")}
        assert entry["hash"] == "MurmurHash3_32" and entry["conversion"] == "uint32_to_float32", entry
        self.manifest = json.loads(entry["manifest"])
        self.pixels = image.width * image.height
        for name, digits in self.manifest.items():
            assert int(digits, 16) == id_of(name) and len(digits) == 8, (name, digits)
        self.ranks = []  # of (bits of ids, coverages)
        for level in range(3):
            for first, second in ("RG", "BA"):
                layer = f"{typename}{level:02}."
                assert image.types[layer + first] == image.types[layer + second] == 2, "not 32-bit floats"
                self.ranks.append((image.bits[layer + first], image.floats[layer + second]))

    def of_id(self, bits):
        return [sum(c[p] for i, c in self.ranks if i[p] == bits) for p in range(self.pixels)]

    def of(self, name):
        return self.of_id(int(self.manifest[name], 16))

    def check_ranks(self, samples):
        """Shares of so many samples, the largest first, of ids that differ, and whole together."""
        known = {int(digits, 16) for digits in self.manifest.values()} | {0}
        for p in range(self.pixels):
            ids = [(i[p], c[p]) for i, c in self.ranks if c[p] > 0]
            shares = [c for _, c in ids]
            assert {i for i, _ in ids} <= known and len({i for i, _ in ids}) == len(ids), ids
            assert shares == sorted(shares, reverse=True) and math.isclose(sum(shares), 1, rel_tol=1e-6), ids
            assert all(abs(c * samples - round(c * samples)) < 1e-4 for c in shares), (samples, shares)


# ---- the tests -------------------------------------------------------------------------------------------------


def lightmill(*arguments):
    return subprocess.run([BUILD + "/lightmill", *arguments], check=True, capture_output=True, text=True).stdout


def render(folder, name, scene, *options):
    path = f"{folder}/{name}.exr"
    lightmill("render", scene, "--resolution", f"{SIDE}x{SIDE}", "--quiet", "-o", path, *options)
    return path


def wait_for(ask):
    """Asks until the answer is true; a program that fails says that it is not."""
    deadline = time.monotonic() + PATIENCE
    while True:
        try:
            if ask():
                return
        except subprocess.CalledProcessError as error:
            assert time.monotonic() < deadline, error.stderr
        assert time.monotonic() < deadline, "no answer"
        time.sleep(0.1)


def place_of(text):
    """The name of the shape in the line that has this text."""
    (line,) = [n + 1 for n, content in enumerate(LINES) if text in content]
    return f"scene.pbrt:{line}"


def write_scene(folder):
    with open(folder + "/scene.pbrt", "w", encoding="utf-8") as file:
        file.write("\n".join(LINES) + "\n")
    return folder + "/scene.pbrt"


def corner_distances(pixel):
    """The nearest and the farthest distance of a pixel's points from the middle of the image."""
    size = 2 / SIDE
    x, y = abs((pixel % SIDE + 0.5) * size - 1), abs((pixel // SIDE + 0.5) * size - 1)
    return math.hypot(x - size / 2, y - size / 2), math.hypot(x + size / 2, y + size / 2)


def mattes_are_those_of_the_shapes(folder, scene):
    path = render(folder, "shapes", scene, "--spp", "40", "--cryptomatte")
    image = Image(path)
    assert "/manifest: 3 names;" in lightmill("info", path)
    objects, materials = Mattes(image, "crypto_object"), Mattes(image, "crypto_material")
    sphere, disk, dots = (objects.of(place_of(f"[{radius}]")) for radius in (RADIUS, "0.6", "0.2"))
    for mattes in (objects, materials):
        mattes.check_ranks(32)  # the first 32 samples
    for p, share in enumerate(sphere):
        near, far = corner_distances(p)
        assert share == 1 if far < RADIUS else share == 0 if near > RADIUS else 0 <= share <= 1, (p, share)
    area = sum(sphere) * (2 / SIDE) ** 2
    assert abs(area / (math.pi * RADIUS**2) - 1) < 0.003, area
    assert abs(sum(dots) * (2 / SIDE) ** 2 / (2 * math.pi * 0.2**2) - 1) < 0.02, "two shapes of one name"
    assert len(objects.manifest) == 3 and sum(disk) > 100
    # What no object covers is nothing, whose id is 0.
    nothing = objects.of_id(0)
    assert all(abs(1 - n - c) < 1e-6 for n, c in zip(nothing, image.floats["coverage"]))
    # The id of sample 0 is one of those that are counted.
    number = max(image.floats["object.id"][p] for p in range(SIDE * SIDE) if sphere[p] == 1)
    assert all(share >= 1 / 32 for share, n in zip(sphere, image.floats["object.id"]) if n == number)
    clay, lead = materials.of("clay"), materials.of("lead")
    assert all(abs(c - s - d) < 1e-6 for c, s, d in zip(clay, sphere, disk)), "clay is sphere and disk"
    assert all(abs(l - d) < 1e-6 for l, d in zip(lead, dots))


def samples_that_are_not_there_do_not_count(folder, scene):
    image = Image(render(folder, "few", scene, "--spp", "5", "--cryptomatte", "--no-layers"))
    assert "coverage" not in image.types
    Mattes(image, "crypto_object").check_ranks(5)


def they_are_the_same_on_a_farm_and_stay_floats(folder, scene):
    options = ["--spp", "40", "--cryptomatte", "--seed", "3"]
    alone, farm = render(folder, "alone", scene, *options), render(folder, "farm", scene, *options, "--workers", "2")
    assert lightmill("info", "--hash", alone) == lightmill("info", "--hash", farm)
    whole, half = Image(alone), Image(render(folder, "half", scene, *options, "--half"))
    assert half.types["R"] == 1
    mattes = [name for name in whole.types if name.startswith("crypto")]
    assert len(mattes) == 24 and all(whole.bits[name] == half.bits[name] for name in mattes)
    assert Mattes(half, "crypto_object").manifest == Mattes(whole, "crypto_object").manifest


def names_of_gltf_are_those_of_its_nodes(folder, _):
    corners = struct.pack("<9f", -1, -1, 0, 1, -1, 0, -1, 1, 0)
    data = "data:application/octet-stream;base64," + base64.b64encode(corners).decode()
    node, rust = {"mesh": 0, "name": name_with_exponent('Störtebeker "a\\b"', 0)}, name_with_exponent("rust", 255)
    camera = {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0.1, "zfar": 9}}
    accessor = {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [-1, -1, 0], "max": [1, 1, 0]}
    scene = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1]}], "cameras": [camera],
        "nodes": [node, {"camera": 0, "translation": [0, 0, 3]}],
        "materials": [{"name": rust}, {"emissiveFactor": [1, 1, 1]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}], "accessors": [accessor],
        "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"uri": data, "byteLength": 36}],
    }  # fmt: skip
    with open(folder + "/scene.gltf", "w", encoding="utf-8") as file:
        json.dump(scene, file)
    image = Image(render(folder, "gltf", folder + "/scene.gltf", "--spp", "32", "--cryptomatte", "--lenient"))
    matte = Mattes(image, "crypto_object").of(node["name"])
    assert abs(sum(matte) / SIDE**2 - 0.5) < 0.01, sum(matte)
    assert Mattes(image, "crypto_material").of(rust) == matte


def killed_masters_relays_and_checks_change_nothing(folder, scene):
    """A worker, and a relay with another: they check half of the units of each other, and the master is killed. The job
    has no end until then."""
    settings = ["--resolution", f"{SIDE}x{SIDE}", "--cryptomatte", "--spp"]
    processes, port, listen = [], ports.choose_pair(), ports.choose_pair()
    quick = ["--heartbeat", "0.2", "--lease", "2", "--batch-interval", "0.2"]

    def start(program, *arguments):
        with open(f"{folder}/{program}-{len(processes)}.log", "wb") as log:
            processes.append(subprocess.Popen([f"{BUILD}/lightmill-{program}", *arguments], stdout=log, stderr=log))

    def start_master():
        start("master", "--listen", f"127.0.0.1:{port}", "--data", folder + "/data", "--checkpoint", "0.1", *quick)
        wait_for(lambda: lightmill("status", "--master", f"127.0.0.1:{port}"))

    try:
        start_master()
        start("relay", f"127.0.0.1:{port}", "--listen", f"127.0.0.1:{listen}", "--data", folder + "/relay", *quick)
        for above in (port, listen):
            start("worker", f"127.0.0.1:{above}", "--threads", "1", "--cache", f"{folder}/cache-{above}")
        farm = ["--master", f"127.0.0.1:{port}"]
        job = lightmill("submit", scene, "--verify", "0.5", *settings, str(1 << 30), *farm).strip()
        done = lambda: json.loads(lightmill("status", job, "--json", *farm))["jobs"][0]

        def end_soon():
            """Fails when the farm is faster than the two commands."""
            now = done()
            reached = (now["samples_counted"] + now["samples_out"]) // SIDE**2
            lightmill("extend", job, "--spp", str(reached + 100), *farm)
            return True

        wait_for(lambda: done()["samples_done"] > 0 and done()["checkpoint_age"] >= 0)
        processes[0].kill()
        processes[0].wait()
        start_master()
        wait_for(lambda: done()["checks_passed"] > 0)
        wait_for(end_soon)
        lightmill("fetch", job, "--wait", "-o", folder + "/fetched.exr", *farm)
        spp = done()["samples_total"] // SIDE**2
    finally:
        for process in processes:
            process.kill()
            process.wait()
    alone = folder + "/alone-long.exr"
    lightmill("render", scene, "--quiet", "-o", alone, *settings, str(spp))
    assert lightmill("info", "--hash", alone) == lightmill("info", "--hash", folder + "/fetched.exr")


def they_are_there_when_asked_for(folder, scene):
    image = Image(render(folder, "without", scene, "--spp", "1"))
    assert not [n for n in [*image.types, *image.texts] if "crypto" in n]
    failed = subprocess.run([BUILD + "/lightmill", "render", scene, "--cryptomatte", "--integrator", "light", "-o",
                             folder + "/no.exr"], capture_output=True, text=True)  # fmt: skip
    assert failed.returncode != 0 and "use bdpt or path" in failed.stderr, failed.stderr


def main():
    tests = [mattes_are_those_of_the_shapes, samples_that_are_not_there_do_not_count,
             they_are_the_same_on_a_farm_and_stay_floats, names_of_gltf_are_those_of_its_nodes,
             killed_masters_relays_and_checks_change_nothing, they_are_there_when_asked_for]  # fmt: skip
    assert id_of("bunny") == 0x13851A76, "the specification's example"
    with tempfile.TemporaryDirectory(prefix="lightmill-", ignore_cleanup_errors=True) as folder:
        scene = write_scene(folder)
        for test in tests:
            test(folder, scene)
    print(f"[  PASSED  ] {len(tests)} tests")


main()
