"""Renders the open scene with Cycles.

usage: blender -b SCENE.blend -P render.py -- SAMPLES SEED IMAGE.exr
"""
import sys

import bpy

samples, seed, image = sys.argv[sys.argv.index("--") + 1:]
scene = bpy.context.scene
scene.cycles.samples, scene.cycles.seed = int(samples), int(seed)
scene.render.use_file_extension = False
scene.render.filepath = image
bpy.ops.render.render(write_still=True)
