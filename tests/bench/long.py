#!/usr/bin/python3
"""What learning brings to long jobs, on scenes that are hard for short ones: the table of docs/performance.md.

For each scene and program it renders

    long    one job of --seconds CPU seconds
    short   --seeds jobs of --short CPU seconds
    plain   two jobs of half of --seconds with --no-learn, by the first program only

and prints error x CPU seconds of each. Without learning that product does not depend on the length of a job. So a long job
that has learned more than a short one has a lower product; the ratio is what one has to compare.

The error is relMSE as `lightmill compare` has it, without the worst 0.1 % of the pixels, but needs no converged reference.
The other images of a scene, and the reference where one is stored, are pooled to two, R and S, by their CPU seconds. Then
the mean of (A - R)(A - S) is the mean squared error of image A, however noisy R and S are, since A, R and S are independent
and right on average. Light that A has missed counts as an error when the others found it. The pixels left out are the worst
of A against the mean of R and S, so noise of these takes part of the 0.1 %. What stands behind a ratio is its standard error
as far as pixels tell it (jackknife over blocks of 8 x 8); another seed of the long job may differ by more.

    make bench-long                             # SECONDS, SHORT, SEEDS, BUILDS, SCENES, FOLDER
    tests/bench/long.py --seconds 60 --short 6 --build build ajar
    tests/bench/long.py --build /before/build --build build --folder /tmp/long     # two programs, before and after

A scene takes twice --seconds and what the short jobs take: by default all four take 45 minutes on two cores, and 25 more for each
further --build. --folder keeps the images: a program that has not changed is not asked again.
"""
import argparse
import hashlib
import itertools
import json
import os
import resource
import statistics
import struct
import subprocess
import sys
import tempfile
import zlib

HERE = os.path.dirname(os.path.abspath(__file__))
TOP = os.path.join(HERE, "..", "..")
sys.path.insert(0, os.path.join(TOP, "python"))

import numpy as np  # noqa: E402
from lightmill.exr import read_image  # noqa: E402

EPS, TRIM, BLOCK = 0.01, 0.001, 8  # client/image/agreement.h
GROUPS = 16  # of blocks, for the jackknife
REFERENCE_SEED = 1001  # no measured job has it, so references are independent of all
HEAD = ("| scene | program | spp | CPU s | error | long: error x s | short: error x s | no-learn: error x s | long / short | "
        "long / no-learn | long / first program |")
RULE = "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |"


def scene_files(scene):
    """The scene, and where its reference is, if it has one."""
    own = f"{HERE}/long/{scene}"
    if os.path.exists(own):
        return f"{own}/scene.pbrt", f"{own}/ref.exr"
    return f"{TOP}/scenes/{scene}/scene.pbrt", f"{TOP}/tests/references/{scene}/ref.exr"


# CPU seconds of the references: how much they weigh in a pool. Those of the first three are the mean of five jobs each.
SCENES = {"ajar": 487, "windows": 389, "pool": 456, "seed-hidden": 20000}


# ---- rendering


class Image:
    def __init__(self, pixels, cpu, spp=0):
        self.pixels, self.cpu, self.spp = pixels, cpu, spp


def read(path):
    return read_image(path).layer()[..., :3].astype(np.float64)


class Program:
    def __init__(self, build, threads, folder):
        self.name, self.threads, self.folder = build, threads, folder
        self.path = os.path.join(build, "lightmill")
        with open(self.path, "rb") as file:
            self.hash = hashlib.sha256(file.read()).hexdigest()[:12]
        self.paces = {}

    def run(self, scene, spp, seed, options, image):
        """CPU seconds."""
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([self.path, "render", scene_files(scene)[0], "--spp", str(spp), "--seed", str(seed), "--threads",
                               str(self.threads), "--quiet", "--no-layers", *options, "-o", image],
                              stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)  # fmt: skip
        if done.returncode != 0:
            sys.exit(f"long: {self.path} render {scene}: exit code {done.returncode}\n{done.stdout.strip()}")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime

    def samples(self, scene, options, seconds):
        """So many that a job takes about `seconds`: by a job of a twentieth of that or three seconds, and what it takes to
        start. What is learned changes what a sample costs, so the job is long enough to have learned something."""
        key = (scene, *options)
        if key not in self.paces:
            image = f"{self.folder}/part.exr"
            start, few = self.run(scene, 1, 1, options, image), self.run(scene, 17, 1, options, image)
            spp = 17 + int(min(3, seconds / 20) * 16 / max(few - start, 0.01))
            self.paces[key] = start, (self.run(scene, spp, 1, options, image) - start) / (spp - 1)
        start, pace = self.paces[key]
        return max(2, round((seconds - start) / pace))

    def render(self, scene, kind, seconds, seed):
        options = ["--no-learn"] if kind == "plain" else []
        name = f"{self.folder}/{scene}-{kind}-{self.hash}-{seconds:g}-{seed}"
        if not os.path.exists(name + ".json"):
            spp = self.samples(scene, options, seconds)
            cpu = self.run(scene, spp, seed, options, name + ".exr")
            with open(name + ".json", "w", encoding="utf-8") as file:
                json.dump({"spp": spp, "cpu": cpu}, file)
        with open(name + ".json", encoding="utf-8") as file:
            told = json.load(file)
        return Image(read(name + ".exr"), told["cpu"], told["spp"])


# ---- errors


def pool(images):
    total = sum(image.cpu for image in images)
    return Image(sum(image.cpu * image.pixels for image in images) / total, total)


def split(images):
    """Two pools of about equal CPU seconds."""
    sides = [], []
    for image in sorted(images, key=lambda image: -image.cpu):
        min(sides, key=lambda side: sum(one.cpu for one in side)).append(image)
    return [pool(side) for side in sides]


def errors(image, others):
    """The relative squared error of each pixel; NaN for the worst 0.1 %."""
    r, s = split(others)
    mean = pool([r, s]).pixels
    value = ((image.pixels - r.pixels) * (image.pixels - s.pixels) / (mean**2 + EPS)).mean(-1)
    badness = ((image.pixels - mean) ** 2 / (mean**2 + EPS)).mean(-1).ravel()
    worst = np.argsort(badness)[badness.size - int(TRIM * badness.size):]
    value.ravel()[worst] = np.nan
    return value


class Product:
    """Error x CPU seconds of jobs of one kind: the mean, and the means without each group of blocks."""

    def __init__(self, images, every):
        maps = [errors(image, [other for other in every if other is not image]) for image in images]
        cpu = statistics.mean(image.cpu for image in images)
        height, width = maps[0].shape
        y, x = np.mgrid[:height, :width] // BLOCK
        group = (y * 5 + x) % GROUPS
        self.error = float(np.mean([np.nanmean(one) for one in maps]))
        self.value = self.error * cpu
        self.without = np.array([np.mean([np.nanmean(one[group != g]) for one in maps]) for g in range(GROUPS)]) * cpu

    def over(self, other):
        """The ratio and its standard error."""
        ratios = self.without / other.without
        return self.value / other.value, float(np.sqrt((GROUPS - 1) / GROUPS * ((ratios - ratios.mean()) ** 2).sum()))


# ---- the table


def measure(scene, programs, told):
    """Prints a row a program; returns their three ratios."""
    every, kinds = [], {}
    plan = [("plain", told.seconds / 2, 2), ("short", told.short, told.seeds), ("long", told.seconds, 1)]
    for kind, seconds, seeds in plan:
        for seed, program in itertools.product(range(1, seeds + 1), programs if kind != "plain" else programs[:1]):
            # Each job has a seed of its own, so that no two images share random numbers.
            number = seed + 100 * programs.index(program) + {"plain": 300, "short": 0, "long": 600}[kind]
            image = program.render(scene, kind, seconds, number)
            every.append(image)
            kinds.setdefault((kind, program), []).append(image)
    reference = scene_files(scene)[1]
    pooled = every + ([Image(read(reference), SCENES[scene])] if os.path.exists(reference) else [])
    products = {key: Product(images, pooled) for key, images in kinds.items()}
    plain, first = products["plain", programs[0]], products["long", programs[0]]
    rows = []
    for program in programs:
        long, short, image = products["long", program], products["short", program], kinds["long", program][0]
        ratios = [long.over(short), long.over(plain), long.over(first)]
        rows.append([ratio for ratio, _ in ratios])
        cells = [scene, program.name, str(image.spp), f"{image.cpu:.0f}", f"{long.error:.3g}",
                 *(f"{product.value:.3g}" for product in (long, short, plain)),
                 *(f"{ratio:.3f} ± {deviation:.3f}" for ratio, deviation in ratios)]
        print("| " + " | ".join(cells) + " |", flush=True)
    return rows


def summary(program, ratios):
    """A line of geometric means; an error of which the noise left nothing has no logarithm."""
    means = [statistics.geometric_mean(column) if min(column) > 0 else float("nan") for column in zip(*ratios)]
    return (f"{program.name}, {len(ratios)} scenes: geometric mean {means[0]:.3f} of short jobs, {means[1]:.3f} of --no-learn, "
            f"{means[2]:.3f} of the first program.")


# ---- references


def chunk(name, kind, value):
    return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<I", len(value)) + value


def write_halves(path, pixels):
    """An EXR of R, G and B in half floats, packed (ZIP, 16 lines a block), so that it stays small."""
    height, width, _ = pixels.shape
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    channels = b"".join(name + b"\0" + struct.pack("<iB3xii", 1, 0, 1, 1) for name in (b"B", b"G", b"R")) + b"\0"
    header = struct.pack("<II", 20000630, 2) + b"".join([
        chunk("channels", "chlist", channels), chunk("compression", "compression", b"\3"), chunk("dataWindow", "box2i", window),
        chunk("displayWindow", "box2i", window), chunk("lineOrder", "lineOrder", b"\0"),
        chunk("pixelAspectRatio", "float", struct.pack("<f", 1)), chunk("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        chunk("screenWindowWidth", "float", struct.pack("<f", 1))]) + b"\0"  # fmt: skip
    blocks = []
    for top in range(0, height, 16):
        raw = np.frombuffer(pixels[top:top + 16, :, ::-1].astype("<f2").transpose(0, 2, 1).tobytes(), np.uint8)
        halves = np.concatenate([raw[0::2], raw[1::2]]).astype(np.int16)
        halves[1:] = (np.diff(halves) + 128) & 255
        packed = zlib.compress(halves.astype(np.uint8).tobytes(), 9)
        data = packed if len(packed) < raw.size else raw.tobytes()
        blocks.append(struct.pack("<2i", top, len(data)) + data)
    at = np.cumsum([len(header) + 8 * len(blocks), *(len(block) for block in blocks[:-1])])
    with open(path, "wb") as file:
        file.write(header + struct.pack(f"<{len(at)}Q", *at) + b"".join(blocks))


def make_reference(scene, program, seconds):
    image = program.render(scene, "reference", seconds, REFERENCE_SEED)
    write_halves(scene_files(scene)[1], image.pixels)
    print(f"{scene}: {image.cpu:.0f} CPU s, {image.spp} samples a pixel; enter the seconds in SCENES", flush=True)


# ---- the program


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", action="append", metavar="DIR",
                        help="the folder of a program, more than once to compare several (default: build)")  # fmt: skip
    parser.add_argument("--seconds", type=float, default=600, help="CPU seconds of a long job (default: 600)")
    parser.add_argument("--short", type=float, help="CPU seconds of a short job (default: a thirtieth of --seconds)")
    parser.add_argument("--seeds", type=int, default=6, help="how many short jobs (default: 6)")
    parser.add_argument("--threads", type=int, default=2, help="of a render (default: 2)")
    parser.add_argument("--folder", help="keeps the images, and takes those that are there of the same program and seconds")
    parser.add_argument("--reference", action="store_true",
                        help="measure nothing: make references, of --seconds each, by the first program")  # fmt: skip
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=f"of {', '.join(SCENES)} (default: all)")
    told = parser.parse_args()
    told.short = told.short or told.seconds / 30
    if told.seeds < 1 or told.seeds > 99 or min(told.seconds, told.short, told.threads) <= 0:
        parser.error("--seconds, --short, --threads and --seeds (at most 99) are more than 0")
    if unknown := [scene for scene in told.scenes if scene not in SCENES]:
        parser.error(f"no such scene: {', '.join(unknown)}")
    return told


def main():
    told = arguments()
    temporary = tempfile.TemporaryDirectory(prefix="lightmill-long-")
    folder = told.folder or temporary.name
    os.makedirs(folder, exist_ok=True)
    programs = [Program(build, told.threads, folder) for build in told.build or ["build"]]
    scenes = told.scenes or list(SCENES)
    if told.reference:
        for scene in scenes:
            make_reference(scene, programs[0], told.seconds)
        return
    print(HEAD, RULE, sep="\n", flush=True)
    rows = [measure(scene, programs, told) for scene in scenes]
    print("", *(summary(program, [row[index] for row in rows]) for index, program in enumerate(programs)), sep="\n")


if __name__ == "__main__":
    main()
