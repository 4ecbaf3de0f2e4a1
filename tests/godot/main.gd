extends Node
## Runs the addon on the stacks of res://stacks, in a place that can be written, and prints what
## it made.

const StackMaterial := preload("res://addons/mipbake/stack_material.gd")
const PLACE := "user://stacks"
const LEVELS := 5

## All levels of a texture as a shader reads them, one below the other.
const FETCH := """shader_type canvas_item;
render_mode blend_disabled, unshaded;
uniform sampler2D levels : filter_nearest_mipmap;
uniform int side;
void fragment() {
	ivec2 at = ivec2(UV * vec2(float(side), float(side * LEVELS)));
	COLOR = texelFetch(levels, ivec2(at.x, at.y % side), at.y / side);
}
"""


func _ready() -> void:
	copy("res://stacks", PLACE)
	var found := {}
	for manifest in StackMaterial.manifests(PLACE):
		found[manifest.trim_prefix(PLACE + "/")] = made(manifest)
	print("FOUND ", JSON.stringify(found))
	var wood: ORMMaterial3D = load(PLACE + "/wood.tres")
	var textures := {
		"albedo": wood.albedo_texture,
		"normal": wood.normal_texture,
		"orm": wood.orm_texture,
		"emission": wood.emission_texture,
	}
	for name: String in textures:
		print("LEVELS ", name, " ", Marshalls.raw_to_base64(await texels(textures[name])))
	use_plugin()
	get_tree().quit()


## Chooses both entries of the menu. The plugin's editor is a stand-in here, see editor.gd.
func use_plugin() -> void:
	var plugin: Node = load("res://addons/mipbake/plugin.gd").new()
	add_child(plugin)
	for entry: String in plugin.entries.keys():
		plugin.entries[entry].call()
	var limiter: bool = ProjectSettings.get_setting(StackMaterial.LIMITER)
	print("PLUGIN ", JSON.stringify([plugin.updated, limiter]))
	remove_child(plugin)
	print("ENTRIES ", plugin.entries.size())


func copy(from: String, to: String) -> void:
	DirAccess.make_dir_recursive_absolute(to)
	for file in DirAccess.get_files_at(from):
		var copied := FileAccess.open(to.path_join(file), FileAccess.WRITE)
		copied.store_buffer(FileAccess.get_file_as_bytes(from.path_join(file)))
	for folder in DirAccess.get_directories_at(from):
		copy(from.path_join(folder), to.path_join(folder))


func made(manifest: String) -> Dictionary:
	var maker := StackMaterial.new()
	var place := maker.save(manifest)
	if place.is_empty():
		var there := FileAccess.file_exists(StackMaterial.material_path(manifest))
		return {"problem": maker.problem, "material there": there}
	# What a user changes stays, and what the manifest says comes back.
	var changed: ORMMaterial3D = load(place)
	changed.uv1_scale = Vector3(3, 3, 3)
	changed.albedo_texture = null
	ResourceSaver.save(changed, place)
	maker.save(manifest)
	var material: ORMMaterial3D = ResourceLoader.load(place, "", ResourceLoader.CACHE_MODE_IGNORE)
	var textures: PackedStringArray = []
	for slot: String in ["albedo_texture", "normal_texture", "orm_texture", "emission_texture"]:
		var texture: Texture2D = material.get(slot)
		textures.append(texture.resource_path.get_file() if texture else "")
	return {
		"place": place.trim_prefix(PLACE + "/"),
		"textures": textures,
		"tiling": material.uv1_scale.x,
		"features": [material.normal_enabled, material.ao_enabled, material.emission_enabled],
		"lambert": material.diffuse_mode == BaseMaterial3D.DIFFUSE_LAMBERT,
		"repeat": material.texture_repeat,
		"filter": material.texture_filter,
		"transparency": material.transparency,
		"cutoff": material.alpha_scissor_threshold,
	}


## RGBA of every level, one below the other, each in a square of the side of level 0. It asks a
## shader, because Texture2D.get_image makes levels of its own in browsers.
func texels(texture: Texture2D) -> PackedByteArray:
	var side := texture.get_width()
	var view := SubViewport.new()
	view.size = Vector2i(side, side * LEVELS)
	view.transparent_bg = true
	view.render_target_update_mode = SubViewport.UPDATE_ALWAYS
	var shown := ColorRect.new()
	shown.size = view.size
	var shader := Shader.new()
	shader.code = FETCH.replace("LEVELS", str(LEVELS))
	var material := ShaderMaterial.new()
	material.shader = shader
	material.set_shader_parameter("levels", texture)
	material.set_shader_parameter("side", side)
	shown.material = material
	view.add_child(shown)
	add_child(view)
	await RenderingServer.frame_post_draw
	await RenderingServer.frame_post_draw
	var image := view.get_texture().get_image()
	image.convert(Image.FORMAT_RGBA8)
	view.queue_free()
	return image.get_data()
