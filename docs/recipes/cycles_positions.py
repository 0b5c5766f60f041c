"""Cycles' positions of a scene as rays and hits, in Blender: python cycles_positions.py IN.npz OUT_RAYS OUT_HITS

IN.npz is what scene_arrays.py writes.
"""

import sys
import tempfile
from pathlib import Path

import bpy
import hits_of_positions
import numpy as np
from mathutils import Matrix

PASSES = {"Position": "use_pass_position", "Normal": "use_pass_normal", "Depth": "use_pass_z"}


def add_mesh(corners):
    mesh = bpy.data.meshes.new("all")
    vertices = corners.reshape(-1, 3)
    mesh.from_pydata(vertices.tolist(), [], np.arange(len(vertices)).reshape(-1, 3).tolist())
    bpy.context.scene.collection.objects.link(bpy.data.objects.new("all", mesh))


def add_camera(eye, ahead, up, half, size):
    back = -ahead / np.linalg.norm(ahead)
    right = np.cross(up, back) / np.linalg.norm(np.cross(up, back))
    axes = np.eye(4)
    axes[:3] = np.column_stack([right, np.cross(back, right), back, eye])
    data = bpy.data.cameras.new("camera")
    camera = bpy.data.objects.new("camera", data)
    camera.matrix_world = Matrix(axes.tolist())
    data.sensor_fit = "HORIZONTAL"
    data.angle = 2 * np.arctan(half[0])
    data.clip_start, data.clip_end = 1e-6, 1e9
    scene = bpy.context.scene
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = (int(n) for n in size)
    scene.render.resolution_percentage = 100


def render(folder):
    """Pass -> (h, w, 3), the first row at the top."""
    scene, layer = bpy.context.scene, bpy.context.view_layer
    scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 1, False
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 0.01
    for option in PASSES.values():
        setattr(layer, option, True)
    scene.use_nodes = True
    nodes = scene.node_tree.nodes
    nodes.clear()
    layers, files = nodes.new("CompositorNodeRLayers"), nodes.new("CompositorNodeOutputFile")
    files.base_path, files.format.file_format, files.format.color_depth = str(folder), "OPEN_EXR", "32"
    files.file_slots.clear()
    for name in PASSES:
        files.file_slots.new(name)
        scene.node_tree.links.new(layers.outputs[name], files.inputs[name])
    bpy.ops.render.render()
    return {name: pixels_of(next(folder.glob(f"{name}*.exr"))) for name in PASSES}


def pixels_of(file):
    image = bpy.data.images.load(str(file))
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(height, width, 4)[::-1, :, :3]


def main(given, rays_file, hits_file):
    scene = np.load(given)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    add_mesh(scene["corners"])
    add_camera(scene["eye"], scene["ahead"], scene["up"], scene["half"], scene["size"])
    with tempfile.TemporaryDirectory() as folder:
        found = render(Path(folder))
    hit = found["Depth"][:, :, 0] < 1e9
    hits_of_positions.write(rays_file, hits_file, scene["eye"], found["Position"], found["Normal"], hit)


main(*sys.argv[1:])
