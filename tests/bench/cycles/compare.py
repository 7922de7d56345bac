#!/usr/bin/python3
"""Lightmill beside Cycles, on scenes made in Blender (scenes.py).

Each renders the same scenes on one thread, in turns, to linear EXR, without denoising, clamping and adaptive sampling. Each is
measured against its own converged image, since materials are not equal to the last digit: relMSE as `lightmill compare` has
it, less what the converged image's own noise makes. Of the CPU time that of an image of one sample is taken off: reading the
scene, building trees, starting Blender. The product of error and CPU time does not depend on the number of samples. Cycles'
over ours says how many times as long Cycles takes for an image as good.

usage: compare.py [--folder FOLDER] [--rounds N] [--build BUILD] [--add NAME=OPTIONS] [SCENE...]

--folder keeps scenes and converged images, so that the next call has them. --add puts another row beside ours, for example
--add "path=--integrator path", or with another program: --add "old=build=/elsewhere/build".
"""
import argparse
import math
import os
import re
import resource
import shutil
import subprocess
import sys
import tempfile

TOP = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "..", "..")
HERE = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(TOP, "python"))

import numpy as np  # noqa: E402
from lightmill.exr import read_image  # noqa: E402

SIZE = "192x108"
MAX_DEPTH = 13  # Cycles' 12 bounces
SCENES = {  # options of Lightmill, samples of Lightmill and of Cycles for a few seconds each
    "product": (["--environment", "product.hdr"], 32, 64),
    "room": ([], 32, 64),
    "still": ([], 32, 64),
    "hall": (["--environment", "hall.hdr"], 32, 32),
}
EPS, TRIM = 0.01, 0.001


def run(command, folder):
    """CPU seconds of a command."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        sys.exit(f"compare: {' '.join(command)} failed:\n{done.stdout[-2000:]}")
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


class Lightmill:
    def __init__(self, name, build, options):
        self.name, self.build, self.options = name, os.path.abspath(build), options

    def samples(self, scene):
        return SCENES[scene][1]

    def render(self, folder, scene, spp, seed, image):
        return run([os.path.join(self.build, "lightmill"), "render", scene + ".glb", *SCENES[scene][0], "--resolution", SIZE,
                    "--max-depth", str(MAX_DEPTH), "--threads", "1", "--quiet", "--no-layers", "--spp", str(spp),
                    "--seed", str(seed), *self.options, "-o", image], folder)


class Cycles:
    name = "Cycles"

    def samples(self, scene):
        return SCENES[scene][2]

    def render(self, folder, scene, spp, seed, image):
        return run(["blender", "-b", os.path.join(folder, scene + ".blend"), "-P", os.path.join(HERE, "render.py"),
                    "--python-exit-code", "3", "--", str(spp), str(seed), os.path.join(folder, image)], folder)


def read(folder, image):
    return read_image(os.path.join(folder, image)).layer()[..., :3].astype(np.float64)


def trimmed(error2, reference):
    """relMSE without the worst 0.1 % of the pixels (client/image/agreement.h)."""
    errors = np.sort((error2 / (reference**2 + EPS)).mean(-1).ravel())
    return float(errors[:errors.size - int(TRIM * errors.size)].mean())


def converged(renderer, folder, scene, times):
    """The converged image, and the relMSE of its own noise. All rows of Lightmill share one, by bdpt."""
    halves = []
    for half in (1, 2):
        image = f"{scene}-{'cycles' if renderer.name == 'Cycles' else 'ours'}-{half}.exr"
        if not os.path.exists(os.path.join(folder, image)):
            renderer.render(folder, scene, times * renderer.samples(scene), 1000 + half, "part.exr")
            os.rename(os.path.join(folder, "part.exr"), os.path.join(folder, image))
        halves.append(read(folder, image))
    mean = (halves[0] + halves[1]) / 2
    return mean, trimmed(((halves[0] - halves[1]) / 2) ** 2, mean)


def alike(ours, theirs):
    """The median and the largest difference in brightness of 4 x 3 parts of the picture."""
    height, width = ours.shape[0] // 3, ours.shape[1] // 4
    parts = [(slice(y * height, (y + 1) * height), slice(x * width, (x + 1) * width)) for y in range(3) for x in range(4)]
    return sorted((ours[part].mean() / theirs[part].mean() - 1 for part in parts), key=abs)


def measure(renderers, folder, scene, arguments):
    """{renderer: product of error and CPU seconds}; prints a row each."""
    references = {}
    for renderer in renderers:
        same = renderers[0] if isinstance(renderer, Lightmill) else renderer
        references[renderer.name] = references.get(same.name) or converged(same, folder, scene, arguments.converged)
    parts = alike(references[renderers[0].name][0], references["Cycles"][0])
    print(f"{scene}: brightness of parts of our picture over those of Cycles: "
          f"median {parts[len(parts) // 2]:+.1%}, most {parts[-1]:+.1%}")
    start = {r.name: min(r.render(folder, scene, 1, 1, "part.exr") for _ in range(2)) for r in renderers}
    cpu, error = {r.name: [] for r in renderers}, {r.name: [] for r in renderers}
    for seed in range(1, arguments.rounds + 1):
        for renderer in renderers:
            seconds = renderer.render(folder, scene, renderer.samples(scene), seed, "part.exr")
            reference, floor = references[renderer.name]
            cpu[renderer.name].append(seconds - start[renderer.name])
            error[renderer.name].append(trimmed((read(folder, "part.exr") - reference) ** 2, reference) - floor)
    products = {name: np.mean(error[name]) * np.mean(cpu[name]) for name in cpu}
    for renderer in renderers:
        name = renderer.name
        print(f"  {name:14s} {renderer.samples(scene):5d} spp  relMSE {np.mean(error[name]):.3e}  "
              f"CPU {np.mean(cpu[name]):6.2f} s (start {start[name]:.2f} s)  product {products[name]:.3e}  "
              f"Cycles / it {products['Cycles'] / products[name]:5.2f}")
    sys.stdout.flush()
    return products


def row(text, build):
    name, _, options = text.partition("=")
    words = options.split()
    other = [word for word in words if word.startswith("build=")]
    return Lightmill(name, other[0][6:] if other else build, [word for word in words if word not in other])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--converged", type=int, default=16, help="times as many samples, in each of two halves")
    parser.add_argument("--build", default=os.path.join(TOP, "build"))
    parser.add_argument("--add", action="append", default=[])
    parser.add_argument("scenes", nargs="*", metavar="SCENE")
    arguments = parser.parse_args()
    if shutil.which("blender") is None:
        sys.exit("compare: Blender is missing, whose Cycles this compares with: apt-get install --no-install-recommends blender")
    wrong = [scene for scene in arguments.scenes if scene not in SCENES]
    if wrong:
        sys.exit(f"compare: there is no scene '{wrong[0]}', but {', '.join(SCENES)}")
    version = subprocess.run(["blender", "--version"], capture_output=True, text=True, check=True).stdout
    print("beside Cycles of", re.search(r"Blender \S+", version).group())
    folder = os.path.abspath(arguments.folder or tempfile.mkdtemp(prefix="lightmill-cycles-"))
    os.makedirs(folder, exist_ok=True)
    try:
        compare_all(arguments, folder)
    finally:
        if not arguments.folder:
            shutil.rmtree(folder)


def compare_all(arguments, folder):
    if not os.path.exists(os.path.join(folder, "hall.glb")):
        run(["blender", "-b", "--factory-startup", "-P", os.path.join(HERE, "scenes.py"), "--python-exit-code", "3", "--",
             folder], folder)
    renderers = [Lightmill("Lightmill", arguments.build, [])]
    renderers += [row(text, arguments.build) for text in arguments.add] + [Cycles()]
    gains = {r.name: [] for r in renderers}
    for scene in arguments.scenes or SCENES:
        products = measure(renderers, folder, scene, arguments)
        for name, product in products.items():
            gains[name].append(products["Cycles"] / product)
    for renderer in renderers[:-1]:
        values = gains[renderer.name]
        print(f"{renderer.name}: geometric mean {math.prod(values) ** (1 / len(values)):.2f}, worst {min(values):.2f}")


if __name__ == "__main__":
    main()
