"""Makes the scenes of cycles.py in Blender: for each a .blend for Cycles and a .glb for Lightmill, and the image of the
product shot's surroundings.

usage: blender -b --factory-startup -P scenes.py -- FOLDER

  product   things of plastic, metal and glass on a backdrop, under an image with a small bright sun and soft windows
  room      furniture in a closed room, by the light of one window, a lamp under the ceiling and a floor lamp
  still     glasses and a metal bowl on a table, by a lamp in a shade
  hall      desks in a room with three openings, by sun and sky through them

What is used is what both take alike: Blender's Principled BSDF with plain values, meshes that emit, lamps without a
radius, and an image of the surroundings, which is no part of a .glb.
"""
import math
import os
import sys

import addon_utils
import bpy
import numpy as np

BOUNCES = 12
SIZE = (192, 108)


# ---- materials ----------------------------------------------------------------------------------------------------------


def material(name, colour, roughness=0.5, metallic=0.0, specular=0.5, glass=False):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    shader = made.node_tree.nodes["Principled BSDF"].inputs
    shader["Base Color"].default_value = (*colour, 1)
    shader["Roughness"].default_value = roughness
    shader["Metallic"].default_value = metallic
    shader["Specular"].default_value = specular
    if glass:
        shader["Transmission"].default_value = 1
        shader["IOR"].default_value = 1.5
        mark_as_solid(made)
    return made


def mark_as_solid(made):
    """The node group by which Blender's exporter knows that what is transparent has a thickness."""
    group = bpy.data.node_groups.get("glTF Material Output")
    if group is None:
        group = bpy.data.node_groups.new("glTF Material Output", "ShaderNodeTree")
        group.inputs.new("NodeSocketFloat", "Occlusion")
        group.inputs.new("NodeSocketFloat", "Thickness")
        group.nodes.new("NodeGroupInput")
    node = made.node_tree.nodes.new("ShaderNodeGroup")
    node.node_tree = group
    node.inputs["Thickness"].default_value = 1


def emitter(name, colour, strength):
    made = material(name, (0, 0, 0), specular=0)
    shader = made.node_tree.nodes["Principled BSDF"].inputs
    shader["Emission"].default_value = (*colour, 1)
    shader["Emission Strength"].default_value = strength
    return made


# ---- shapes -------------------------------------------------------------------------------------------------------------


def add(name, vertices, faces, made, smooth=False):
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([tuple(v) for v in vertices], [], faces)
    for polygon in mesh.polygons:
        polygon.use_smooth = smooth
    mesh.materials.append(made)
    mesh.update()
    thing = bpy.data.objects.new(name, mesh)
    bpy.context.collection.objects.link(thing)
    return thing


def quad(name, corner, side_x, side_y, made):
    """Its front is where side_x x side_y points."""
    corner, side_x, side_y = map(np.array, (corner, side_x, side_y))
    return add(name, [corner, corner + side_x, corner + side_x + side_y, corner + side_y], [(0, 1, 2, 3)], made)


def box(name, low, high, made):
    corners = [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return add(name, corners, faces, made)


def turned(name, profile, centre, made, steps=96, closed=False):
    """A profile of (radius, height) turned about the vertical: from outside below to the top, if it is to be seen from outside.
    closed: its end joins its beginning."""
    vertices, faces, count = [], [], len(profile)
    for k in range(steps):
        angle = 2 * math.pi * k / steps
        for radius, height in profile:
            vertices.append((centre[0] + radius * math.cos(angle), centre[1] + radius * math.sin(angle), centre[2] + height))
    for k in range(steps):
        here, there = k * count, (k + 1) % steps * count
        for i in range(count if closed else count - 1):
            j = (i + 1) % count
            faces.append((here + i, there + i, there + j, here + j))
    return add(name, vertices, faces, made, smooth=True)


def ball(name, centre, radius, made, rings=48):
    profile = [(radius * math.sin(a) + 1e-6, -radius * math.cos(a)) for a in np.linspace(0, math.pi, rings)]
    return turned(name, profile, centre, made, steps=2 * rings)


def ring(name, centre, radius, thickness, made):
    angles = np.linspace(0, 2 * math.pi, 48, endpoint=False)
    profile = [(radius + thickness * math.cos(a), thickness * math.sin(a)) for a in angles]
    return turned(name, profile, centre, made, closed=True)


def head(name, centre, size, made):
    bpy.ops.mesh.primitive_monkey_add(size=size, location=centre, rotation=(-0.6, 0, 0.4))
    thing = bpy.context.object
    thing.name = name
    thing.modifiers.new("smooth", "SUBSURF").render_levels = 2
    thing.modifiers["smooth"].levels = 2
    thing.data.materials.append(made)
    for polygon in thing.data.polygons:
        polygon.use_smooth = True
    return thing


def lamp(kind, name, place, watts, colour=(1, 1, 1), direction=None):
    data = bpy.data.lights.new(name, kind)
    data.energy, data.color = watts, colour
    if kind == "SUN":
        data.angle = 0
    else:
        data.shadow_soft_size = 0
    thing = bpy.data.objects.new(name, data)
    thing.location = place
    if direction is not None:
        look_along(thing, direction)
    bpy.context.collection.objects.link(thing)


def look_along(thing, direction):
    from mathutils import Vector
    thing.rotation_euler = Vector(direction).to_track_quat("-Z", "Y").to_euler()


def camera(place, target, degrees):
    data = bpy.data.cameras.new("camera")
    data.angle = math.radians(degrees)
    thing = bpy.data.objects.new("camera", data)
    thing.location = place
    look_along(thing, np.array(target) - np.array(place))
    bpy.context.collection.objects.link(thing)
    bpy.context.scene.camera = thing


# ---- surroundings -------------------------------------------------------------------------------------------------------


def directions(width, height):
    """Of each pixel of a latitude-longitude image, top row first."""
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    phi, theta = -2 * math.pi * (u - 0.5), math.pi * (0.5 - v)
    return np.stack([np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), np.sin(theta)], -1)


def spot(d, towards, degrees):
    towards = np.array(towards) / np.linalg.norm(towards)
    return (d @ towards > math.cos(math.radians(degrees)))[..., None]


def window(d, towards, half_x, half_y):
    """A soft rectangle across a direction."""
    z = np.array(towards) / np.linalg.norm(towards)
    x = np.cross((0, 0, 1), z)
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    along = np.maximum(d @ z, 1e-6)
    edge = np.minimum(half_x - abs(d @ x / along), half_y - abs(d @ y / along))
    return (np.clip(edge / 0.05, 0, 1) * (d @ z > 0))[..., None]


def sky(d, zenith, horizon, ground):
    up = d[..., 2:3]
    zenith, horizon, ground = map(np.array, (zenith, horizon, ground))
    return np.where(up > 0, horizon + (zenith - horizon) * np.sqrt(np.maximum(up, 0)), ground)


def studio(d):
    light = sky(d, (0.15, 0.25, 0.5), (0.5, 0.5, 0.5), (0.12, 0.1, 0.09))
    light = light + window(d, (1, -0.6, 0.7), 0.45, 0.3) * np.array((7, 6.5, 6))
    light = light + window(d, (-1, -0.4, 0.45), 0.25, 0.5) * np.array((3, 3.5, 4.5))
    return light + spot(d, (-0.6, -0.35, 0.8), 1.2) * np.array((2600, 2300, 1900))


def day(d):
    return sky(d, (0.35, 0.6, 1.3), (1.1, 1.2, 1.3), (0.25, 0.22, 0.2))


def write_hdr(path, pixels):
    """Radiance's format without packing, top row first."""
    most = pixels.max(-1)
    exponents = np.ceil(np.log2(np.maximum(most, 1e-30) * 256 / 255))
    mantissas = np.clip(np.round(pixels / 2.0 ** exponents[..., None] * 256), 0, 255)
    bytes4 = np.concatenate([mantissas, exponents[..., None] + 128], -1).astype(np.uint8)
    with open(path, "wb") as file:
        file.write(f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {pixels.shape[0]} +X {pixels.shape[1]}\n".encode())
        file.write(bytes4.tobytes())


def surround(folder, name, light, width=1024):
    path = os.path.join(folder, name + ".hdr")
    write_hdr(path, light(directions(width, width // 2)))
    tree = world().node_tree
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = bpy.data.images.load(path)
    tree.links.new(node.outputs["Color"], tree.nodes["Background"].inputs["Color"])


def world():
    made = bpy.context.scene.world = bpy.data.worlds.new("world")
    made.use_nodes = True
    made.node_tree.nodes["Background"].inputs["Color"].default_value = (0, 0, 0, 1)
    return made


# ---- the scenes ---------------------------------------------------------------------------------------------------------


def product(folder):
    surround(folder, "product", studio)
    paper = material("paper", (0.7, 0.69, 0.67), 0.5, specular=0.2)
    curve = [(-math.cos(a) * 2, 2 - math.sin(a) * 2) for a in np.linspace(math.pi / 2, math.pi, 24)]
    line = [(-6, 0)] + [(y + 3, z) for y, z in curve] + [(5, 6)]
    vertices = [(x, y, z) for y, z in line for x in (-9, 9)]
    add("backdrop", vertices, [(2 * i, 2 * i + 1, 2 * i + 3, 2 * i + 2) for i in range(len(line) - 1)], paper, smooth=True)
    ball("plastic", (-1.9, 0.2, 0.7), 0.7, material("red plastic", (0.6, 0.04, 0.03), 0.15))
    head("metal", (0.1, 0.6, 0.85), 1.7, material("gold", (1.0, 0.72, 0.3), 0.2, metallic=1))
    ball("glass", (1.75, -0.4, 0.65), 0.65, material("glass", (1, 1, 1), 0, glass=True))
    ball("chrome", (0.8, -1.4, 0.35), 0.35, material("chrome", (0.9, 0.9, 0.9), 0, metallic=1))
    ring("rubber", (-0.8, -1.3, 0.2), 0.5, 0.2, material("rubber", (0.05, 0.2, 0.3), 0.45))
    box("block", (2.4, 0.9, 0), (3.3, 1.8, 1.6), material("wood", (0.45, 0.27, 0.12), 0.35))
    camera((0.3, -7.2, 2.3), (0.2, 0, 0.6), 39)


def walls(low, high, plaster, floor, without=()):
    x, y, z = (high[i] - low[i] for i in range(3))
    sides = {"floor": (low, (x, 0, 0), (0, y, 0), floor),
             "ceiling": ((low[0], low[1], high[2]), (0, y, 0), (x, 0, 0), plaster),
             "left": (low, (0, y, 0), (0, 0, z), plaster),
             "right": ((high[0], low[1], low[2]), (0, 0, z), (0, y, 0), plaster),
             "front": (low, (0, 0, z), (x, 0, 0), plaster),
             "back": ((low[0], high[1], low[2]), (x, 0, 0), (0, 0, z), plaster)}
    for name, (corner, side_x, side_y, made) in sides.items():
        if name not in without:
            quad(name, corner, side_x, side_y, made)


def table(name, low, high, made, leg=0.06):
    """A board and four legs."""
    box(name, (low[0], low[1], high[2] - 0.04), high, made)
    for k in range(4):
        x = low[0] if k & 1 else high[0] - leg
        y = low[1] if k & 2 else high[1] - leg
        box(f"{name} leg {k}", (x, y, low[2]), (x + leg, y + leg, high[2] - 0.04), made)


def room(_):
    world()
    wood = material("wood", (0.4, 0.24, 0.12), 0.4)
    cloth = material("cloth", (0.15, 0.22, 0.35), 0.5, specular=0)
    walls((-2.5, -2, 0), (2.5, 2.5, 2.7), material("plaster", (0.75, 0.73, 0.68), 0.5, specular=0),
          material("parquet", (0.42, 0.28, 0.16), 0.3))
    quad("window", (-2.49, -0.6, 0.9), (0, 1.6, 0), (0, 0, 1.3), emitter("day", (0.85, 0.95, 1.0), 6))
    box("sofa seat", (-0.9, 1.5, 0.1), (1.3, 2.4, 0.45), cloth)
    box("sofa back", (-0.9, 2.2, 0.45), (1.3, 2.45, 0.95), cloth)
    table("table", (-0.4, 0.2, 0), (0.9, 0.9, 0.5), wood)
    box("shelf", (1.9, 1.3, 0), (2.49, 2.3, 2.0), wood)
    box("cube", (1.5, -0.3, 0), (1.9, 0.1, 0.4), material("lacquer", (0.5, 0.05, 0.04), 0.1))
    ball("vase", (0.2, 0.5, 0.66), 0.16, material("china", (0.8, 0.8, 0.8), 0.15))
    metal = material("steel", (0.6, 0.6, 0.6), 0.25, metallic=1)
    turned("lamp foot", [(0.15, 0.0), (0.15, 0.02), (0.02, 0.03), (0.02, 1.45)], (-1.7, 1.9, 0), metal, steps=32)
    turned("shade", [(0.25, 1.4), (0.15, 1.75)], (-1.7, 1.9, 0), material("shade", (0.7, 0.6, 0.4), 0.5, specular=0))
    ball("bulb", (-1.7, 1.9, 1.55), 0.05, emitter("bulb", (1.0, 0.75, 0.45), 120), rings=12)
    lamp("POINT", "ceiling lamp", (0.3, 0.2, 2.4), 60, (1, 0.85, 0.65))
    camera((1.6, -1.8, 1.5), (-0.3, 1.4, 0.75), 68)


def bend(points, steps=6):
    """A smooth line through points (Catmull-Rom), so that vertex normals are near those of the faces: where they are not,
    renderers make glass of it each in its own way. A point given twice stays a corner."""
    points, line = np.array(points), []
    for i in range(len(points) - 1):
        a, b, c, d = (points[min(max(k, 0), len(points) - 1)] for k in range(i - 1, i + 3))
        if (b == c).all():
            continue
        for t in np.arange(steps) / steps:
            line.append(0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3))
    return [tuple(point) for point in line + [points[-1]]]


def goblet(name, x, y, made):
    foot = [(0.001, 0), (0.2, 0), (0.28, 0.0), (0.3, 0.02), (0.28, 0.04), (0.15, 0.06), (0.05, 0.1), (0.03, 0.2), (0.03, 0.4)]
    outside = [(0.06, 0.48), (0.14, 0.54), (0.25, 0.65), (0.3, 0.85), (0.29, 1.0), (0.28, 1.09)]
    inside = [(0.27, 1.1), (0.26, 1.09), (0.27, 1.0), (0.28, 0.85), (0.23, 0.67), (0.13, 0.57), (0.05, 0.53),
              (0.001, 0.525)]
    turned(name, bend(foot + outside + inside), (x, y, 0.001), made)


def still(_):
    world()
    plaster = material("plaster", (0.6, 0.57, 0.52), 0.5, specular=0)
    walls((-3, -4, 0), (3, 2, 4), plaster, material("table", (0.35, 0.2, 0.1), 0.25, specular=0.2))
    clear = material("clear", (1, 1, 1), 0, glass=True)
    goblet("goblet", -0.7, 0.2, clear)
    goblet("second goblet", 0.9, 0.7, clear)
    ball("paperweight", (0.35, -0.5, 0.301), 0.3, clear)
    bowl = [(0.001, 0.0), (0.25, 0.01), (0.5, 0.15), (0.61, 0.39), (0.605, 0.4), (0.595, 0.39), (0.47, 0.18), (0.24, 0.05),
            (0.001, 0.04)]
    turned("bowl", bend(bowl), (-1.5, 0.8, 0.001), material("brass", (0.9, 0.65, 0.3), 0.15, metallic=1))
    ball("apple", (-1.4, 0.75, 0.33), 0.26, material("apple", (0.5, 0.06, 0.04), 0.3))
    box("book", (1.2, -0.6, 0.001), (2.2, 0.1, 0.2), material("cover", (0.1, 0.25, 0.15), 0.5))
    turned("shade", [(0.8, 0.0), (0.2, 0.5), (0.02, 0.55)], (0.3, 0.3, 2.3), material("enamel", (0.6, 0.62, 0.6), 0.5, specular=0))
    ball("bulb", (0.3, 0.3, 2.4), 0.12, emitter("bulb", (1.0, 0.85, 0.65), 150), rings=16)
    camera((0.1, -3.6, 1.7), (0.0, 0.3, 0.45), 45)


def hall(folder):
    surround(folder, "hall", day)
    plaster = material("plaster", (0.75, 0.74, 0.7), 0.5, specular=0)
    walls((-4, -3, 0), (4, 3, 3), plaster, material("floor", (0.4, 0.33, 0.25), 0.35), without=("left",))
    box("sill", (-4.2, -3, 0), (-4, 3, 0.9), plaster)
    box("lintel", (-4.2, -3, 2.4), (-4, 3, 3), plaster)
    for k, y in enumerate((-3, -1.2, 0.8, 2.6)):
        box(f"pier {k}", (-4.2, y, 0.9), (-4, y + (0.4 if k in (0, 3) else 0.5), 2.4), plaster)
    wood = material("desk", (0.5, 0.33, 0.17), 0.3)
    for k in range(9):
        x, y = -2.8 + 2 * (k % 3), -1.6 + 1.5 * (k // 3)
        table(f"desk {k}", (x, y, 0), (x + 1.2, y + 0.6, 0.75), wood)
    quad("board", (-1.5, 2.98, 0.9), (3, 0, 0), (0, 0, 1.3), material("board", (0.03, 0.08, 0.05), 0.6))
    lamp("SUN", "sun", (0, 0, 5), 12, (1, 0.92, 0.8), direction=(1, 0.25, -0.75))
    camera((3.4, -2.7, 1.7), (-1.2, 1.0, 0.8), 66)


SCENES = {"product": product, "room": room, "still": still, "hall": hall}


def settle():
    """What Cycles is to compute: all light, without clamping, denoising or roughening."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.resolution_percentage = 100
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.image_settings.exr_codec = "ZIP"
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = 0
    cycles.blur_glossy = 0
    cycles.caustics_reflective = cycles.caustics_refractive = True
    cycles.pixel_filter_type = "BOX"
    for kind in ("max", "diffuse", "glossy", "transmission"):
        setattr(cycles, kind + "_bounces", BOUNCES)


def main():
    folder = os.path.abspath(sys.argv[sys.argv.index("--") + 1])
    addon_utils.enable("io_scene_gltf2")
    for name, make in SCENES.items():
        bpy.ops.wm.read_factory_settings(use_empty=True)
        addon_utils.enable("io_scene_gltf2")
        make(folder)
        settle()
        bpy.ops.wm.save_as_mainfile(filepath=os.path.join(folder, name + ".blend"))
        bpy.ops.export_scene.gltf(filepath=os.path.join(folder, name + ".glb"), export_format="GLB", export_cameras=True,
                                  export_lights=True, export_apply=True)


main()
