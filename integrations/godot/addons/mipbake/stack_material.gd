@tool
extends RefCounted
## A material from a stack that `mipbake bake SET --preset godot` wrote. It needs no editor.

const AGAIN := "bake the set again with mipbake bake SET --preset godot"

## The limiter that widens roughness by bumps, which the levels of mipbake have done already.
const LIMITER := "rendering/anti_aliasing/screen_space_roughness_limiter/enabled"

## What is wrong, in one sentence; empty where all went well.
var problem := ""


## The manifests of a folder and the folders in it: stack.json, or stack.1001.json of a UDIM tile.
static func manifests(folder: String) -> PackedStringArray:
	var found := PackedStringArray()
	for file in DirAccess.get_files_at(folder):
		if file == "stack.json" or file.match("stack.1???.json"):
			found.append(folder.path_join(file))
	for inside in DirAccess.get_directories_at(folder):
		if not inside.begins_with("."):
			found.append_array(manifests(folder.path_join(inside)))
	return found


## Where a material belongs: beside the folder of its stack, because mipbake replaces that folder.
static func material_path(manifest: String) -> String:
	var folder := manifest.get_base_dir()
	if folder == "res://":
		folder = "res://material"
	return folder + manifest.get_file().trim_prefix("stack").trim_suffix(".json") + ".tres"


## Makes the material of a manifest where it belongs, or updates it, and keeps what else the user
## set there. Returns its path; an empty one where there is a `problem`.
func save(manifest: String) -> String:
	var place := material_path(manifest)
	var material := ORMMaterial3D.new()
	if ResourceLoader.exists(place):
		material = load(place) as ORMMaterial3D
		if material == null:
			problem = "%s is no ORMMaterial3D: rename it to make room for the material." % place
			return ""
	if not fill(material, manifest):
		return ""
	var failed := ResourceSaver.save(material, place)
	if failed:
		problem = "%s cannot be written: %s." % [place, error_string(failed)]
		return ""
	return place


## Gives a material what a manifest says; false where there is a `problem`.
func fill(material: ORMMaterial3D, manifest: String) -> bool:
	var stack := _read(manifest)
	if problem:
		return false
	var files: Dictionary = stack["map_files"]
	var textures := {}
	for map: String in ["base_color", "normal", "roughness", "emissive"]:
		if files.has(map):
			var path := manifest.get_base_dir().path_join(files[map])
			textures[map] = load(path) as Texture2D if ResourceLoader.exists(path) else null
			if textures[map] == null:
				problem = "%s cannot be loaded: %s." % [path, AGAIN]
				return false
	material.albedo_texture = textures.get("base_color")
	material.normal_enabled = textures.has("normal")
	material.normal_texture = textures.get("normal")
	material.orm_texture = textures.get("roughness")
	material.ao_enabled = files.has("occlusion")
	material.emission_enabled = textures.has("emissive")
	material.emission_texture = textures.get("emissive")
	material.diffuse_mode = BaseMaterial3D.DIFFUSE_LAMBERT
	material.texture_repeat = stack["wrap"] != {"u": "clamp", "v": "clamp"}
	material.texture_filter = BaseMaterial3D.TEXTURE_FILTER_LINEAR_WITH_MIPMAPS
	var sampler: Variant = stack["provenance"]["sampler"]
	if sampler is Dictionary and sampler["lookups"] > 1:
		material.texture_filter = BaseMaterial3D.TEXTURE_FILTER_LINEAR_WITH_MIPMAPS_ANISOTROPIC
	if files.has("opacity"):
		var cutoff: Variant = stack["provenance"]["alpha_cutoff"]
		material.transparency = BaseMaterial3D.TRANSPARENCY_ALPHA
		if cutoff != null:
			material.transparency = BaseMaterial3D.TRANSPARENCY_ALPHA_SCISSOR
			material.alpha_scissor_threshold = cutoff
	return true


## What a manifest says, once its files are known to be what Godot loads as they are.
func _read(manifest: String) -> Dictionary:
	problem = ""
	var stack: Variant = JSON.parse_string(FileAccess.get_file_as_string(manifest))
	if not stack is Dictionary or stack.get("schema") != "mipbake-stack":
		problem = "%s does not describe a stack of mipbake: %s." % [manifest, AGAIN]
		return {}
	for output: Dictionary in stack.get("outputs", []):
		var kind := [output.get("format"), output.get("packing"), output.get("normal_convention")]
		if kind == ["dds", "orm", "OpenGL"] and output.has("map_files"):
			stack["map_files"] = output["map_files"]
	if not stack.has("map_files"):
		problem = "%s is not of files for Godot: %s." % [manifest, AGAIN]
		return {}
	for side: int in [stack["width"], stack["height"]]:
		if nearest_po2(side) != side:
			problem = "%s has a side of %d, and Godot needs powers of two: " % [manifest, side]
			problem += "resize the maps of the set and bake it again."
			return {}
	return stack
