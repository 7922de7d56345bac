#!/usr/bin/env python3
"""Error and CPU time of the renderer beside those of pbrt-v3: the table and the plot of docs/performance.md.

Each scene of a folder of references (tests/references/README.md) is rendered with several seeds by `lightmill render`,
and `lightmill compare` says how far the image is from the reference. The error is relMSE, without what the noise of the
reference adds. It falls as 1 / samples, so error x time does not depend on the number of samples: a renderer with half of
it needs half the time for the same image.

CPU time is user and system time of the whole command. CPU seconds of two machines are compared through what Embree does
on each (bench_embree): calibrated seconds are those that the work would take where Embree traces 7.5 million rays a
second. That is asked again around each render, since a machine that others use does not keep its speed.

    make bench                      # the table; REFERENCES, SEEDS, SPP, INTEGRATORS, SCENES
    make bench-plot                 # docs/performance.svg
    tests/bench/performance.py --help
"""
import argparse
import collections
import itertools
import json
import math
import os
import resource
import statistics
import subprocess
import sys
import tempfile

MRAYS = 7.5  # of the machine of calibrated seconds
RULE = "| --- | --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |"
HEAD = "| scene | integrator | spp | CPU s | Mrays/s | calibrated s | error | error x s | pbrt's best | ratio |"

# Calibrated seconds and the error after that many samples a pixel.
Figure = collections.namedtuple("Figure", "integrator spp seconds error")
# What was measured here: the mean over the seeds. `cpu` is not calibrated, `mrays` is the calibration.
Run = collections.namedtuple("Run", "scene figure cpu mrays")


def cost(figure):
    return figure.error * figure.seconds


# ---- pbrt's figures


def pbrt_figures(entry):
    """What a scene's entry in figures.json says of pbrt. The figures of media were taken on another machine."""
    mrays = 7.0 if "volpath_same_cpu" in entry else 7.5
    floor = entry["reference"]["relmse_floor"]
    return [Figure(name.split("_")[0], told["spp"], told["cpu_s"] * mrays / MRAYS, told["relmse"] - floor)
            for name, told in entry.items() if name in ("bdpt_16spp", "bdpt_64spp", "path_same_cpu", "volpath_same_cpu")]


def pbrt_best(figures):
    """The lesser error x time of its bdpt at 64 samples and of its path tracer at the cost of that; None without figures.
    What there is at 16 samples is for the plot only."""
    return min((cost(figure) for figure in figures if figure.spp > 16), default=None)


# ---- measuring


class Failed(Exception):
    """What a command says that failed."""


class Bench:
    def __init__(self, build, references, threads):
        self.build, self.references, self.threads = build, references, threads
        self.folder = tempfile.TemporaryDirectory(prefix="lightmill-bench-")

    def run(self, *command, codes=(0,)):
        """Its output."""
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, check=False)
        if done.returncode not in codes:
            raise Failed(f"{' '.join(command)}: exit code {done.returncode}\n{done.stderr.strip()}")
        return done.stdout

    def scene_file(self, scene):
        own = f"{self.references}/{scene}/scene.pbrt"
        return own if os.path.exists(own) else f"scenes/{scene}/scene.pbrt"

    def mrays(self):
        return float(self.run(f"{self.build}/tests/bench/bench_embree", "2"))

    def render(self, scene, integrator, spp, seed):
        """CPU seconds and the error of one image."""
        image = f"{self.folder.name}/image.exr"
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        self.run(f"{self.build}/lightmill", "render", self.scene_file(scene), "--integrator", integrator, "--spp", str(spp),
                 "--seed", str(seed), "--threads", str(self.threads), "--quiet", "-o", image)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        # Exit code 8: noise does not explain the difference. Under a caustic that happens (tests/references/README.md).
        told = json.loads(self.run(f"{self.build}/lightmill", "compare", image, f"{self.references}/{scene}", "--json",
                                   codes=(0, 8)))
        return (after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime,
                told["relmse"] - told["relmse_floor"])

    def measure(self, scene, integrator, spp, seeds):
        mrays = [self.mrays()]
        renders = []
        for seed in range(1, seeds + 1):
            renders.append(self.render(scene, integrator, spp, seed))
            mrays.append(self.mrays())
        cpu, error = map(statistics.mean, zip(*renders))
        seconds = statistics.mean(render[0] * (before + after) / 2 / MRAYS
                                  for render, before, after in zip(renders, mrays, mrays[1:]))
        return Run(scene, Figure(integrator, spp, seconds, error), cpu, statistics.mean(mrays))


# ---- the table


def ratio(run, figures):
    best = pbrt_best(figures.get(run.scene, []))
    return None if best is None else cost(run.figure) / best


def row(run, figures):
    figure, of_pbrt = run.figure, ratio(run, figures)
    pbrt = ["", ""] if of_pbrt is None else [f"{pbrt_best(figures[run.scene]):.3g}", f"{of_pbrt:.3f}"]
    cells = [run.scene, figure.integrator, str(figure.spp), f"{run.cpu:.2f}", f"{run.mrays:.2f}", f"{figure.seconds:.2f}",
             f"{figure.error:.3g}", f"{cost(figure):.3g}", *pbrt]
    return "| " + " | ".join(cells) + " |"


def summaries(runs, figures):
    """A line for each integrator and number of samples, over the scenes that pbrt has figures for. An image that came out
    better than the reference's noise says nothing of the error."""
    groups = collections.defaultdict(list)
    for run in runs:
        if (of_pbrt := ratio(run, figures)) is not None and of_pbrt > 0:
            groups[run.figure.integrator, run.figure.spp].append((of_pbrt, run.scene))
    for (integrator, spp), ratios in groups.items():
        mean = statistics.geometric_mean(value for value, _ in ratios)
        worst, scene = max(ratios)
        yield (f"{integrator} at {spp} spp, {len(ratios)} scenes: geometric mean {mean:.3f} of pbrt's best, "
               f"largest {worst:.3f} ({scene}).")


# ---- the plot

PANEL, MARGIN, LEGEND = (400, 280), (64, 20, 30, 44), 30  # margins: left, right, top, bottom
# Of ours, lines with dots; of pbrt's, crosses.
COLOURS = collections.defaultdict(lambda: "#2e8b57", bdpt="#1f5fbf", path="#d9730d", volpath="#d9730d")


def ticks(values):
    """1, 2, 5, 10, ... from the last that is above no value to the first that is above all."""
    steps = [digit * 10.0 ** power for power in range(-9, 7) for digit in (1, 2, 5)]
    first = max(step for step in steps if step <= min(values))
    last = min(step for step in steps if step > max(values))
    return [step for step in steps if first <= step <= last]


class Panel:
    """One scene: where its values lie in the picture, and its drawing."""

    def __init__(self, scene, lines, marks, corner):
        self.scene, self.lines, self.marks = scene, lines, marks
        every = [figure for figures in (*lines.values(), marks) for figure in figures]
        self.across, self.up = ticks([figure.seconds for figure in every]), ticks([figure.error for figure in every])
        left, right, top, bottom = MARGIN
        self.x = (corner[0] + left, corner[0] + PANEL[0] - right)
        self.y = (corner[1] + PANEL[1] - bottom, corner[1] + top)

    @staticmethod
    def place(value, axis, ends):
        share = math.log(value / axis[0]) / math.log(axis[-1] / axis[0])
        return round(ends[0] + share * (ends[1] - ends[0]), 1)

    def point(self, figure):
        return self.place(figure.seconds, self.across, self.x), self.place(figure.error, self.up, self.y)

    def axes(self):
        (x0, x1), (y0, y1) = self.x, self.y
        for value in self.across:
            x = self.place(value, self.across, self.x)
            yield f'<path d="M{x} {y0}V{y1}" stroke="#ddd"/>'
            yield f'<text x="{x}" y="{y0 + 15}" text-anchor="middle">{value:g}</text>'
        for value in self.up:
            y = self.place(value, self.up, self.y)
            yield f'<path d="M{x0} {y}H{x1}" stroke="#ddd"/>'
            yield f'<text x="{x0 - 6}" y="{y + 4}" text-anchor="end">{value:g}</text>'
        yield f'<text x="{(x0 + x1) / 2}" y="{y1 - 8}" text-anchor="middle" font-weight="bold">{self.scene}</text>'
        yield f'<text x="{(x0 + x1) / 2}" y="{y0 + 32}" text-anchor="middle">calibrated CPU seconds</text>'
        x, y = x0 - 46, (y0 + y1) / 2
        yield f'<text x="{x}" y="{y}" text-anchor="middle" transform="rotate(-90 {x} {y})">error</text>'

    def draw(self):
        yield from self.axes()
        for integrator, figures in self.lines.items():
            points = [self.point(figure) for figure in figures]
            path = "L".join(f"{x} {y}" for x, y in points)
            yield f'<path d="M{path}" fill="none" stroke="{COLOURS[integrator]}" stroke-width="2"/>'
            yield from (mark("line", integrator, x, y) for x, y in points)
        for figure in self.marks:
            yield mark("pbrt", figure.integrator, *self.point(figure))


def mark(who, integrator, x, y):
    colour = COLOURS[integrator]
    if who == "line":
        return f'<circle cx="{x}" cy="{y}" r="3" fill="{colour}"/>'
    return f'<path d="M{x - 5} {y - 5}l10 10m0 -10l-10 10" stroke="{colour}" stroke-width="2"/>'


def legend(integrators, pbrt_integrators, width):
    entries = [("line", name, f"lightmill {name}") for name in integrators]
    entries += [("pbrt", name, f"pbrt-v3 {name}") for name in pbrt_integrators]
    step = width / len(entries)
    for index, (who, name, text) in enumerate(entries):
        x = index * step + step / 2 - 50
        yield mark(who, name, x, LEGEND / 2)
        yield f'<text x="{x + 10}" y="{LEGEND / 2 + 4}">{text}</text>'


def plot(runs, figures):
    """An SVG: error against calibrated time, both logarithmic, a panel a scene and two panels a row."""
    scenes = list(dict.fromkeys(run.scene for run in runs))
    integrators = list(dict.fromkeys(run.figure.integrator for run in runs))
    pbrt = list(dict.fromkeys(figure.integrator for scene in scenes for figure in figures.get(scene, [])))
    width, height = 2 * PANEL[0], LEGEND + (len(scenes) + 1) // 2 * PANEL[1]
    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif" '
             'font-size="11">', '<rect width="100%" height="100%" fill="white"/>', *legend(integrators, pbrt, width)]
    for index, scene in enumerate(scenes):
        # An error below the reference's noise is none that could be drawn.
        lines = {integrator: [run.figure for run in runs if run.scene == scene and run.figure.integrator == integrator
                              and run.figure.error > 0] for integrator in integrators}
        corner = (index % 2 * PANEL[0], LEGEND + index // 2 * PANEL[1])
        parts += Panel(scene, lines, figures.get(scene, []), corner).draw()
    return "\n".join([*parts, "</svg>", ""])


# ---- the program


def words(text):
    return text.replace(",", " ").split()


def counts(text):
    numbers = [int(word) for word in words(text)]
    if not numbers or min(numbers) < 1:
        raise ValueError
    return numbers


def count(text):
    return counts(text)[0]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--build", default="build", help="the folder of the programs (default: build)")
    parser.add_argument("--references", default="tests/references", help="a folder of references (default: tests/references)")
    parser.add_argument("--seeds", type=count, default=2, help="images for a line of the table (default: 2)")
    parser.add_argument("--spp", type=counts, default="64", metavar="N,N", help="samples a pixel; several with commas (default: 64)")
    parser.add_argument("--integrators", type=words, default="bdpt", metavar="A,B", help="several with commas (default: bdpt)")
    parser.add_argument("--threads", type=count, default=2, help="of a render (default: 2, as in pbrt's figures)")
    parser.add_argument("--plot", metavar="FILE.svg", help="also write the plot of error against time")
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help="folders of the references (default: all)")
    return parser.parse_args()


def read_figures(references):
    try:
        with open(f"{references}/figures.json", encoding="utf-8") as file:
            return {scene: pbrt_figures(entry) for scene, entry in json.load(file).items()}
    except FileNotFoundError:
        return {}


def main():
    told = arguments()
    if not os.path.isdir(told.references):
        sys.exit(f"performance: {told.references}: there is no such folder")
    figures = read_figures(told.references)
    bench = Bench(told.build, told.references, told.threads)
    scenes = told.scenes or sorted(name for name in os.listdir(told.references)
                                   if os.path.exists(f"{told.references}/{name}/ref.exr"))
    runs, failed = [], []
    print(HEAD, RULE, sep="\n", flush=True)
    for scene, integrator, spp in itertools.product(scenes, told.integrators, told.spp):
        try:
            runs.append(bench.measure(scene, integrator, spp, told.seeds))
            print(row(runs[-1], figures), flush=True)
        except Failed as failure:
            print(f"performance: {failure}", file=sys.stderr)
            failed.append(f"{scene} by {integrator} at {spp} spp")
    print("", *summaries(runs, figures), sep="\n")
    if failed:
        sys.exit(f"performance: not measured: {'; '.join(failed)}")
    if told.plot:
        with open(told.plot, "w", encoding="utf-8") as file:
            file.write(plot(runs, figures))


if __name__ == "__main__":
    main()
