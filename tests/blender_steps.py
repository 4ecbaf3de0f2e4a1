"""What a user does in Blender, one step a process: `python blender_steps.py STEP JOB.json` with the package bpy.

The job: `extension` (a .zip), `command` (mipbake), `folder` (of the .blend file), `sets`, `result` (a JSON file that is
written).
"""

import json
import sys
from pathlib import Path

import bpy

JOB = json.loads(Path(sys.argv[2]).read_text(encoding="utf-8"))
SETS = Path(JOB["sets"])
ROLES = ("base_color", "roughness", "metallic", "normal")
SOCKETS = {"base_color": "Base Color", "roughness": "Roughness", "metallic": "Metallic", "opacity": "Alpha"}


def separate():
    """Four images, one a map: bake, look at it, undo, bake twice."""
    material = made({role: SETS / "plain" / f"{role}.png" for role in ROLES})
    said = [fails(bpy.ops.material.mipbake)]
    bpy.ops.wm.save_as_mainfile(filepath=f"{JOB['folder']}/scene.blend")
    bpy.ops.ed.undo_push(message="before")
    result = {"unsaved": said, "original": links(material)}
    bpy.ops.material.mipbake("EXEC_DEFAULT", True)
    material = bpy.data.materials["Old Leather.001"]
    result |= {"baked": links(material), "levels": material.mipbake.levels, "render": {}}
    result["render"]["after"] = render("after")
    material.mipbake.shown = "BEFORE"
    result |= {"before": links(material)}
    result["render"]["before"] = render("before")
    material.mipbake.shown, material.mipbake.one_level = "AFTER", True
    result["render"]["level 0"] = render("level 0")
    material.mipbake.level = 2
    result |= {"level 2": links(material)}
    result["render"]["level 2"] = render("level 2")
    material.mipbake.level = 20
    result |= {"last level": [material.mipbake.level, links(material)]}
    material.mipbake.one_level = False
    nodes = len(material.node_tree.nodes)
    bpy.ops.material.mipbake()
    result |= {"again": links(material), "more nodes": len(material.node_tree.nodes) - nodes}
    bpy.ops.ed.undo()
    material = bpy.data.materials["Old Leather.001"]
    return result | {"undone": links(material), "switches": material.mipbake.switches, "cache": cache()}


def gltf():
    """What Blender makes of a glTF document: packed images, factors, a mask, texture transforms."""
    bpy.ops.import_scene.gltf(filepath=str(SETS / "scene.gltf"))
    bpy.context.view_layer.objects.active = next(each for each in bpy.data.objects if each.type == "MESH")
    material = bpy.context.object.active_material
    bpy.context.scene.mipbake_folder = JOB["folder"]
    bpy.ops.material.mipbake()
    images = [node for node in material.node_tree.nodes if "mipbake" in node]
    mapped = [node.inputs["Vector"].links[0].from_node.bl_idname for node in images]
    return {
        "baked": links(material),
        "mapped": mapped,
        "strength": normal_map(material).inputs["Strength"].default_value,
    }


def tiles():
    """UDIM tiles, roughness and metallic in two channels of one image."""
    material = made({"base_color": SETS / "tiles" / "base.1001.png", "normal": SETS / "tiles" / "n.1001.png"})
    tree, shader = material.node_tree, shader_of(material)
    packed, separated = image(tree, SETS / "tiles" / "packed.1001.png"), tree.nodes.new("ShaderNodeSeparateColor")
    tree.links.new(packed.outputs["Color"], separated.inputs[0])
    tree.links.new(separated.outputs["Red"], shader.inputs["Roughness"])
    tree.links.new(separated.outputs["Blue"], shader.inputs["Metallic"])
    for each in [node.image for node in tree.nodes if node.bl_idname == "ShaderNodeTexImage"]:
        each.source = "TILED"
        each.filepath = each.filepath.replace("1001", "<UDIM>")
        each.tiles.new(1002)
    bpy.context.scene.mipbake_folder = JOB["folder"]
    bpy.ops.material.mipbake()
    baked = links(material)
    material.mipbake.one_level, material.mipbake.level = True, 1
    found = [node.image for node in tree.nodes if "mipbake" in node]
    return {
        "baked": baked,
        "level 1": links(material),
        "tiles": [[tile.number for tile in each.tiles] for each in found],
        "sizes": [[list(tile.size) for tile in each.tiles] for each in found],
    }


def errors():
    """What cannot be baked, and what is said of it."""
    bpy.context.scene.mipbake_folder = JOB["folder"]
    said = {}
    plain = {role: SETS / "plain" / f"{role}.png" for role in ROLES}

    def attempt(name, spoil, maps=plain):
        material = made(maps)
        spoil(material, material.node_tree, shader_of(material))
        before = links(material)
        said[name] = fails(bpy.ops.material.mipbake)
        assert links(material) == before and not material.mipbake.switches

    def generated(_, tree, shader):
        node = tree.nodes.new("ShaderNodeTexImage")
        node.image = bpy.data.images.new("made here", 8, 8)
        tree.links.new(node.outputs["Color"], shader.inputs["Roughness"])

    def painted(_, __, shader):
        source(shader.inputs["Roughness"]).image.pixels[0] = 0.5
        source(shader.inputs["Roughness"]).image.update()

    def ramp(_, tree, shader, name="Roughness"):
        node = tree.nodes.new("ShaderNodeValToRGB")
        tree.links.new(shader.inputs[name].links[0].from_socket, node.inputs[0])
        tree.links.new(node.outputs["Color"], shader.inputs[name])

    def bump(_, tree, shader):
        node = tree.nodes.new("ShaderNodeBump")
        tree.links.new(image(tree, SETS / "plain" / "roughness.png").outputs["Color"], node.inputs["Height"])
        tree.links.new(node.outputs["Normal"], shader.inputs["Normal"])

    def two_images(_, tree, shader):
        node = tree.nodes.new("ShaderNodeMixRGB")
        for index, role in ((1, "base_color"), (2, "metallic")):
            tree.links.new(image(tree, plain[role]).outputs["Color"], node.inputs[index])
        tree.links.new(node.outputs[0], shader.inputs["Base Color"])

    def mapped(_, tree, shader):
        node = tree.nodes.new("ShaderNodeMapping")
        node.inputs["Scale"].default_value = (2, 2, 2)
        tree.links.new(node.outputs[0], source(shader.inputs["Roughness"]).inputs["Vector"])

    def unlinked(_, __, shader):
        source(shader.inputs["Roughness"]).image = None

    def coloured(_, __, shader):
        source(shader.inputs["Roughness"]).image.colorspace_settings.name = "sRGB"

    def missing(_, __, shader):
        source(shader.inputs["Roughness"]).image.filepath = f"{JOB['folder']}/nowhere.png"

    def second(_, tree, __):
        tree.nodes.new("ShaderNodeBsdfPrincipled")

    spoils = (generated, painted, ramp, bump, two_images, mapped, unlinked, coloured, missing, second)
    for spoil in spoils:
        attempt(spoil.__name__, spoil)
    first = made(plain)
    first.name = "Old Leather 014"
    ramp(first, first.node_tree, shader_of(first), "Base Color")  # which is left as it is
    bpy.ops.material.mipbake()
    assert links(first)["base_color"] == "ShaderNodeValToRGB" and "_roughness.exr" in links(first)["roughness"][0]
    bpy.context.object.active_material = first.copy()
    bpy.context.object.active_material.name = "Old Leather.014"  # its folder would be the same
    said["taken"] = fails(bpy.ops.material.mipbake)
    attempt("nothing", lambda *_: None, {})
    attempt("broken", lambda *_: None, {**plain, "normal": SETS / "broken.png"})
    preferences().command = "no such program"
    attempt("program", lambda *_: None)
    return said


def made(maps):
    """A plane with a material that shows these files."""
    for each in list(bpy.data.images):
        bpy.data.images.remove(each)
    bpy.ops.mesh.primitive_plane_add(size=2)
    material = bpy.data.materials.new("Old Leather.001")
    material.use_nodes = True
    bpy.context.object.data.materials.append(material)
    tree, shader = material.node_tree, shader_of(material)
    for role, path in maps.items():
        node = image(tree, path, "sRGB" if role == "base_color" else "Non-Color")
        if role == "normal":
            between = tree.nodes.new("ShaderNodeNormalMap")
            tree.links.new(node.outputs["Color"], between.inputs["Color"])
            tree.links.new(between.outputs["Normal"], shader.inputs["Normal"])
        else:
            tree.links.new(node.outputs["Color"], shader.inputs[SOCKETS[role]])
    return material


def image(tree, path, space="Non-Color"):
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = bpy.data.images.load(str(path), check_existing=True)
    node.image.colorspace_settings.name = space
    return node


def shader_of(material):
    return next(node for node in material.node_tree.nodes if node.bl_idname == "ShaderNodeBsdfPrincipled")


def source(socket):
    return socket.links[0].from_node


def normal_map(material):
    return source(shader_of(material).inputs["Normal"])


def links(material):
    """What feeds the shader: for images their file, colour space and width, for other nodes what they are."""
    shader, shown = shader_of(material), {}
    inputs = {role: shader.inputs[name] for role, name in SOCKETS.items()}
    if shader.inputs["Normal"].is_linked and "Color" in normal_map(material).inputs:
        inputs["normal"] = normal_map(material).inputs["Color"]
    for role, socket in inputs.items():
        if not socket.is_linked:
            continue
        node = source(socket)
        shown[role] = node.bl_idname
        if node.bl_idname == "ShaderNodeTexImage" and node.image:
            shown[role] = [node.image.filepath, node.image.colorspace_settings.name, node.image.size[0]]
    return shown


def fails(operator):
    """The sentence that an operator fails with."""
    try:
        operator()
    except RuntimeError as error:
        return str(error).removeprefix("Error: ").strip()
    return ""


def cache():
    render = bpy.context.scene.render
    return [getattr(render, name, None) for name in ("use_texture_cache", "use_auto_generate_texture_cache")]


def render(name):
    """Renders the plane from above, small, with few samples; the file."""
    scene = bpy.context.scene
    if scene.camera is None:
        scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        scene.camera.location = (0, 0, 2.8)
        sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
        sun.data.energy, sun.rotation_euler = 3, (0.4, 0.2, 0)
        for each in (scene.camera, sun):
            scene.collection.objects.link(each)
        scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", 32
        scene.cycles.use_denoising = False
        scene.render.threads_mode, scene.render.threads = "FIXED", 1
        scene.render.resolution_x = scene.render.resolution_y = 24
        scene.render.image_settings.file_format = "PNG"
        scene.view_settings.view_transform = "Standard"
    scene.render.filepath = f"{JOB['folder']}/{name}.png"
    bpy.ops.render.render(write_still=True)
    return scene.render.filepath


def preferences():
    return next(each for each in bpy.context.preferences.addons if each.module.endswith(".mipbake")).preferences


if __name__ == "__main__":
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.extensions.package_install_files(filepath=JOB["extension"], repo="user_default", enable_on_install=True)
    preferences().command = JOB["command"]
    steps = {each.__name__: each for each in (separate, gltf, tiles, errors)}
    content = {"version": list(bpy.app.version), **steps[sys.argv[1]]()}
    Path(JOB["result"]).write_text(json.dumps(content, default=list), encoding="utf-8")
