#!/usr/bin/env python3
"""Compares effigy's path tracer with Blender's Cycles on simple scenes; for developers, not for CI.

    apt-get install blender python3-numpy
    blender --background --python scripts/compare_cycles.py -- build/release/bin/effigy [FOLDER]

Every scene is a sphere on a plate under an environment light. Prints the mean relative error over
the pixels that both cover, and fails when one is above a per cent. Cycles' materials are the ones
that mean the same as ours: Diffuse BSDF without roughness is Lambert, Glossy BSDF is GGX with F = 1.
"""
import json
import math
import os
import subprocess
import sys
import tempfile

import bpy
import numpy as np

SIZE, SAMPLES, LIMIT = 96, 1024, 0.01
EYE, FOV = (1.2, 1.4, 3.6), 40.0


def sphere(rings=96, radius=1.0):
    points, faces = [], []
    segments = 2 * rings
    for r in range(rings + 1):
        for s in range(segments):
            t, p = math.pi * r / rings, 2 * math.pi * s / segments
            points.append((radius * math.sin(t) * math.sin(p), radius * math.cos(t),
                           radius * math.sin(t) * math.cos(p)))
    for r in range(rings):
        for s in range(segments):
            a, b = r * segments + s, r * segments + (s + 1) % segments
            c, d = a + segments, b + segments
            if r > 0:
                faces.append((a, c, b))
            if r + 1 < rings:
                faces.append((b, c, d))
    return points, faces


def plate(half=2.5, height=-1.0):
    return ([(-half, height, half), (half, height, half), (half, height, -half),
             (-half, height, -half)], [(0, 1, 2), (0, 2, 3)])


def write_obj(path, mesh):
    with open(path, "w") as out:
        for p in mesh[0]:
            out.write("v %.9g %.9g %.9g\n" % p)
        for f in mesh[1]:
            out.write("f %d %d %d\n" % tuple(i + 1 for i in f))


def to_blender(p):
    """Our world (y up, an environment's middle at -z) to Blender's (z up, its middle at +x)."""
    return (-p[2], -p[0], p[1])


def environment():
    """A bright soft lamp, a blue sky, a brown ground: 64 x 32, linear."""
    y, x = np.mgrid[0:32, 0:64]
    theta, phi = math.pi * (y + 0.5) / 32, 2 * math.pi * ((x + 0.5) / 64 - 0.5)
    d = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), -np.sin(theta) * np.cos(phi)], -1)
    lamp = np.array([0.5, 0.7, 0.5]) / np.linalg.norm([0.5, 0.7, 0.5])
    up = d[..., 1:2]
    image = np.where(up > 0, np.array([0.3, 0.5, 0.9]), np.array([0.25, 0.18, 0.1]))
    return image + np.exp(12 * (d @ lamp - 1))[..., None] * np.array([9.0, 8.0, 6.0])


def save_exr(path, pixels):
    image = bpy.data.images.new("light", pixels.shape[1], pixels.shape[0], float_buffer=True)
    image.colorspace_settings.name = "Linear"
    rgba = np.ones(pixels.shape[:2] + (4,), np.float32)
    rgba[..., :3] = pixels
    image.pixels.foreach_set(rgba[::-1].ravel())
    image.filepath_raw = path
    image.file_format = "OPEN_EXR"
    image.save()
    bpy.data.images.remove(image)


def load_exr(path):
    image = bpy.data.images.load(path)
    image.colorspace_settings.name = "Linear"
    pixels = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(image.size[1], image.size[0], 4)[::-1].copy()
    bpy.data.images.remove(image)
    return pixels.astype(np.float64)


def cycles_material(name, kind, colour, roughness):
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    nodes.clear()
    out = nodes.new("ShaderNodeOutputMaterial")
    if kind == "lambert":
        shader = nodes.new("ShaderNodeBsdfDiffuse")
        shader.inputs["Roughness"].default_value = 0
    else:
        shader = nodes.new("ShaderNodeBsdfGlossy")
        shader.distribution = "GGX"
        shader.inputs["Roughness"].default_value = roughness
    shader.inputs["Color"].default_value = tuple(colour) + (1,)
    links.new(shader.outputs[0], out.inputs["Surface"])
    return material


def cycles(meshes, light, bounces, out):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    for i, (mesh, kind, colour, roughness) in enumerate(meshes):
        data = bpy.data.meshes.new("mesh%d" % i)
        data.from_pydata([to_blender(p) for p in mesh[0]], [], mesh[1])
        data.polygons.foreach_set("use_smooth", [len(mesh[1]) > 2] * len(mesh[1]))
        data.materials.append(cycles_material("m%d" % i, kind, colour, roughness))
        scene.collection.objects.link(bpy.data.objects.new("mesh%d" % i, data))
    world = bpy.data.worlds.new("world")
    world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    texture = nodes.new("ShaderNodeTexEnvironment")
    texture.image = bpy.data.images.load(light)
    texture.image.colorspace_settings.name = "Linear"
    texture.interpolation = "Closest"
    links.new(texture.outputs[0], nodes["Background"].inputs["Color"])
    scene.world = world
    camera = bpy.data.cameras.new("camera")
    camera.angle = math.radians(FOV)
    eye = bpy.data.objects.new("camera", camera)
    from mathutils import Vector
    place = Vector(to_blender(EYE))
    eye.location = place
    eye.rotation_euler = (-place).to_track_quat("-Z", "Y").to_euler()
    scene.collection.objects.link(eye)
    scene.camera = eye
    render = scene.render
    render.engine = "CYCLES"
    render.resolution_x = render.resolution_y = SIZE
    render.resolution_percentage = 100
    render.film_transparent = True
    render.image_settings.file_format = "OPEN_EXR"
    render.image_settings.color_depth = "32"
    render.image_settings.color_mode = "RGBA"
    render.filepath = out
    c = scene.cycles
    c.device, c.samples, c.use_adaptive_sampling, c.use_denoising = "CPU", SAMPLES, False, False
    c.pixel_filter_type = "BOX"
    c.max_bounces = c.diffuse_bounces = c.glossy_bounces = bounces - 1
    c.sample_clamp_direct = c.sample_clamp_indirect = 0
    c.caustics_reflective = True
    c.blur_glossy = 0
    bpy.ops.render.render(write_still=True)


def main():
    arguments = sys.argv[sys.argv.index("--") + 1:]
    program = os.path.abspath(arguments[0])
    folder = os.path.abspath(arguments[1]) if len(arguments) > 1 else tempfile.mkdtemp()
    os.makedirs(folder, exist_ok=True)
    light = os.path.join(folder, "light.exr")
    save_exr(light, environment())
    ball, floor = sphere(), plate()
    write_obj(os.path.join(folder, "ball.obj"), ball)
    write_obj(os.path.join(folder, "plate.obj"), floor)
    grey, red = (0.6, 0.6, 0.6), (0.8, 0.4, 0.3)
    scenes = {
        "lambert, direct": ("lambert", 0, 1),
        "lambert, 8 bounces": ("lambert", 0, 8),
        "glossy 0.2, direct": ("glossy", 0.2, 1),
        "glossy 0.4, direct": ("glossy", 0.4, 1),
        "glossy 0.4, 4 bounces": ("glossy", 0.4, 4),
    }
    failed = False
    for name, (kind, roughness, bounces) in scenes.items():
        stem = os.path.join(folder, name.replace(", ", "_").replace(" ", "_"))
        colour = red if kind == "lambert" else (1, 1, 1)
        cycles([(ball, kind, colour, roughness), (floor, "lambert", grey, 0)], light, bounces,
               stem + "_cycles.exr")
        ours = {"albedo": list(red), "specular_lobe": False} if kind == "lambert" else {
            "albedo": [0, 0, 0], "roughness": roughness, "specular": 1}
        with open(stem + ".json", "w") as out:
            json.dump({"camera": {"eye": EYE, "target": [0, 0, 0], "fov_y": FOV, "width": SIZE,
                                  "height": SIZE},
                       "materials": {"ball": ours,
                                     "plate": {"albedo": list(grey), "specular_lobe": False}},
                       "meshes": [{"file": "ball.obj", "material": "ball"},
                                  {"file": "plate.obj", "material": "plate"}],
                       "environment": {"file": "light.exr"},
                       "samples": SAMPLES, "bounces": bounces}, out)
        subprocess.run([program, "synth", "scene", stem + ".json", "-o", stem + "_effigy.exr"],
                       check=True, stdout=subprocess.DEVNULL)
        a, b = load_exr(stem + "_cycles.exr"), load_exr(stem + "_effigy.exr")
        both = (a[..., 3] > 0.999) & (b[..., 3] > 0.999)
        difference = np.abs(a - b)[both][:, :3].sum() / a[both][:, :3].sum()
        bias = b[both][:, :3].sum() / a[both][:, :3].sum() - 1
        verdict = "ok" if difference <= LIMIT else "TOO FAR"
        failed |= difference > LIMIT
        print("%-24s mean relative error %.2f %%, brightness %+.2f %%  %s" %
              (name, 100 * difference, 100 * bias, verdict), flush=True)
    sys.exit(1 if failed else 0)


main()
