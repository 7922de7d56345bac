#!/usr/bin/env python3
"""Tests of tests/bench/performance.py: its table says what the programs measured, and its plot is one.

make copies this to BUILD/tests/unit/tests/test_performance, for tests/run.sh.
"""
import json
import os
import subprocess
import sys
import tempfile
import unittest
from xml.etree import ElementTree

BUILD = os.path.dirname(os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(sys.argv[0])))))
sys.path.insert(0, "tests/bench")
sys.dont_write_bytecode = True

import performance  # noqa: E402

REFERENCES = "tests/references"


def bench(*options):
    return subprocess.run(["tests/bench/performance.py", "--build", BUILD, *options], stdout=subprocess.PIPE,
                          stderr=subprocess.PIPE, text=True, check=False)  # fmt: skip


def rows(told):
    """The lines of the table, as dicts by column."""
    lines = [[cell.strip() for cell in line.strip("|").split("|")] for line in told.splitlines() if line.startswith("|")]
    return [dict(zip(lines[0], line)) for line in lines[2:]]


class Performance(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="lightmill-performance-")
        self.addCleanup(folder.cleanup)
        self.folder = folder.name

    def test_pbrts_best_is_the_lesser_of_bdpt_and_path_without_the_references_noise(self):
        entry = {"reference": {"relmse_floor": 0.01}, "bdpt_16spp": {"spp": 16, "cpu_s": 0.1, "relmse": 0.02},
                 "bdpt_64spp": {"spp": 64, "cpu_s": 4, "relmse": 0.03}, "path_same_cpu": {"spp": 99, "cpu_s": 5, "relmse": 0.02}}
        self.assertAlmostEqual(performance.pbrt_best(performance.pbrt_figures(entry)), 5 * 0.01)
        entry["path_same_cpu"]["relmse"] = 0.04
        self.assertAlmostEqual(performance.pbrt_best(performance.pbrt_figures(entry)), 4 * 0.02)
        # Figures of media come from a machine of 7 Mrays/s: 15 of its seconds are 14 of one of 7.5.
        entry["volpath_same_cpu"] = {**entry.pop("path_same_cpu"), "cpu_s": 0.15}
        self.assertAlmostEqual(performance.pbrt_best(performance.pbrt_figures(entry)), 0.14 * 0.03)

    def test_the_summary_is_the_geometric_mean_of_each_setting(self):
        figure = performance.Figure("bdpt", 64, 2, 1)
        figures = {scene: [figure._replace(error=error)] for scene, error in (("a", 4), ("b", 0.25), ("c", 1))}
        runs = [performance.Run(scene, figure._replace(error=error), 1, 1)
                for scene, error in (("a", 1), ("b", 1), ("c", -1), ("nobody", 1))]
        runs.append(runs[0]._replace(figure=figure._replace(integrator="path")))
        self.assertEqual(list(performance.summaries(runs, figures)),
                         ["bdpt at 64 spp, 2 scenes: geometric mean 1.000 of pbrt's best, largest 4.000 (b).",
                          "path at 64 spp, 1 scenes: geometric mean 0.250 of pbrt's best, largest 0.250 (a)."])

    def test_a_run_is_the_mean_of_what_compare_says_of_the_images(self):
        run, errors = performance.Bench(BUILD, REFERENCES, 2).measure("cornell", "bdpt", 1, 2), []
        for seed in "12":
            image = f"{self.folder}/{seed}.exr"
            subprocess.run([f"{BUILD}/lightmill", "render", "scenes/cornell", "--integrator", "bdpt", "--spp", "1", "--seed",
                            seed, "--quiet", "-o", image], check=True)  # fmt: skip
            told = subprocess.run([f"{BUILD}/lightmill", "compare", image, f"{REFERENCES}/cornell", "--json"],
                                  stdout=subprocess.PIPE, check=False)  # fmt: skip
            told = json.loads(told.stdout)
            errors.append(told["relmse"] - told["relmse_floor"])
        self.assertAlmostEqual(run.figure.error, sum(errors) / 2, places=12)
        self.assertTrue(0 < run.cpu < 60, run)
        # Not the same: each render has the calibration around it.
        self.assertAlmostEqual(run.figure.seconds, run.cpu * run.mrays / 7.5, delta=0.3 * run.figure.seconds)

    def test_a_row_says_what_a_run_measured_and_how_that_is_to_pbrts_best(self):
        run = performance.Run("a", performance.Figure("path", 16, 2.5, 0.01), 5.0, 3.75)
        figures = {"a": [performance.Figure("bdpt", 64, 5, 0.02), performance.Figure("path", 99, 5, 0.04)]}
        told = "\n".join([performance.HEAD, performance.RULE, performance.row(run, figures)])
        self.assertEqual(rows(told), [{
            "scene": "a", "integrator": "path", "spp": "16", "CPU s": "5.00", "Mrays/s": "3.75", "calibrated s": "2.50",
            "error": "0.01", "error x s": "0.025", "pbrt's best": "0.1", "ratio": "0.250"}])  # fmt: skip

    def test_references_without_figures_of_pbrt_are_measured_too(self):
        os.symlink(os.path.abspath(f"{REFERENCES}/cornell"), f"{self.folder}/cornell")
        plot = f"{self.folder}/plot.svg"
        done = bench("--references", self.folder, "--spp", "1,2", "--seeds", "1", "--plot", plot)
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertEqual([(row["spp"], row["ratio"]) for row in rows(done.stdout)], [("1", ""), ("2", "")])
        circles = [(float(c.get("cx")), float(c.get("cy"))) for c in ElementTree.parse(plot).iter() if c.tag.endswith("circle")]
        (x1, y1), (x2, y2) = circles[1:]  # after the legend's
        self.assertTrue(0 < x1 < x2 < 400 and 0 < y1 < y2, circles)  # more time, less error

    def test_what_cannot_be_rendered_is_told_after_the_rest(self):
        done = bench("--spp", "1", "--seeds", "1", "nowhere", "cornell")
        self.assertNotEqual(done.returncode, 0)
        self.assertEqual([row["scene"] for row in rows(done.stdout)], ["cornell"])
        self.assertIn("cannot read scenes/nowhere/scene.pbrt", done.stderr)
        self.assertIn("not measured: nowhere by bdpt at 1 spp", done.stderr)
        self.assertIn("--spp", bench("--spp", "0").stderr)


if __name__ == "__main__":
    result = unittest.main(exit=False, testRunner=unittest.TextTestRunner(stream=sys.stdout, verbosity=2)).result
    bad = len(result.failures) + len(result.errors)
    print(f"[  PASSED  ] {result.testsRun - bad} tests")
    if bad:
        print(f"[  FAILED  ] {bad} tests")
    sys.exit(bad > 0)
