"""Renders a textured plane in Blender's Cycles, straight on, a texel a pixel; runs with the package bpy alone.

    python scene.py JOB.json

The job: `side` texels of the texture, `pixels` of the picture, and `renders`, each with `maps` (role to float file, or
`edge`: a file that is shown as light), `direction` towards a sun, `filter` and `width` (of the pixel filter, as Cycles
has them), `samples`, `seed`, `out` (a float EXR).
"""

import json
import sys
from pathlib import Path

import bpy


def main() -> None:
    job = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    scene = cleared(job)
    plane = bpy.context.object
    Path(sys.argv[1]).with_name("version").write_text(bpy.app.version_string, encoding="utf-8")
    for render in job["renders"]:
        plane.data.materials.clear()
        plane.data.materials.append(material(render["maps"]))
        light(render["direction"])
        cycles = scene.cycles
        cycles.pixel_filter_type, cycles.filter_width = render["filter"], render["width"]
        cycles.samples, cycles.seed = render["samples"], render["seed"]
        scene.render.filepath = render["out"]
        bpy.ops.render.render(write_still=True)


def cleared(job: dict) -> bpy.types.Scene:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.cycles.max_bounces = 0
    scene.render.threads_mode, scene.render.threads = "FIXED", 1
    scene.render.resolution_x = scene.render.resolution_y = job["pixels"]
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.view_settings.view_transform = "Raw"
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", job["pixels"]
    camera.clip_end = 1000
    seen = bpy.data.objects.new("camera", camera)
    seen.location = (0, 0, 100)
    scene.collection.objects.link(seen)
    scene.camera = seen
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.angle = 3, 0
    scene.collection.objects.link(bpy.data.objects.new("sun", sun))
    bpy.ops.mesh.primitive_plane_add(size=job["side"])
    return scene


def light(direction: list) -> None:
    from mathutils import Vector

    sun = bpy.data.objects["sun"]
    sun.rotation_euler = Vector(direction).to_track_quat("Z", "Y").to_euler()  # a sun shines along its -z


def material(maps: dict) -> bpy.types.Material:
    made = bpy.data.materials.new("material")
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    out = tree.nodes.new("ShaderNodeOutputMaterial")
    textures = {role: texture(tree, path) for role, path in maps.items()}
    if "edge" in maps:
        shader = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(textures["edge"].outputs["Color"], shader.inputs["Color"])
    else:
        shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
        shader.distribution = "GGX"
        for role, name in (("base_color", "Base Color"), ("roughness", "Roughness"), ("metallic", "Metallic")):
            tree.links.new(textures[role].outputs["Color"], shader.inputs[name])
        bump = tree.nodes.new("ShaderNodeNormalMap")
        tree.links.new(textures["normal"].outputs["Color"], bump.inputs["Color"])
        tree.links.new(bump.outputs["Normal"], shader.inputs["Normal"])
    tree.links.new(shader.outputs[0], out.inputs["Surface"])
    return made


def texture(tree: bpy.types.NodeTree, path: str) -> bpy.types.Node:
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = bpy.data.images.load(path, check_existing=True)
    node.image.colorspace_settings.name = "Non-Color"
    node.interpolation, node.extension = "Linear", "REPEAT"
    return node


main()
