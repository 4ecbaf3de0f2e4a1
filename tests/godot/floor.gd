extends Node
## A floor under a sun, seen from above at a slant, with the materials of two stacks; and the same
## floor in SAMPLES x SAMPLES times as many pixels that read level 0 alone. Prints a PNG of each.

const StackMaterial := preload("res://addons/mipbake/stack_material.gd")
const SIZE := Vector2i(128, 80)
const SAMPLES := 8
const TILES := 10


func _ready() -> void:
	for stack: String in ["linear", "neural", "reference"]:
		var finest := stack == "reference"
		var material := ORMMaterial3D.new()
		var maker := StackMaterial.new()
		maker.fill(material, "res://%s/stack.json" % ("linear" if finest else stack))
		material.uv1_scale = Vector3(TILES, TILES, 1)
		if finest:
			material.texture_filter = BaseMaterial3D.TEXTURE_FILTER_LINEAR
		var view := scene(material, SIZE * (SAMPLES if finest else 1))
		add_child(view)
		for frame in 3:
			await RenderingServer.frame_post_draw
		var png := view.get_texture().get_image().save_png_to_buffer()
		print("SEEN ", stack, " ", Marshalls.raw_to_base64(png))
		view.queue_free()
	get_tree().quit()


func scene(material: ORMMaterial3D, size: Vector2i) -> SubViewport:
	var view := SubViewport.new()
	view.size = size
	view.own_world_3d = true
	view.render_target_update_mode = SubViewport.UPDATE_ALWAYS
	var floor_mesh := MeshInstance3D.new()
	floor_mesh.mesh = PlaneMesh.new()
	floor_mesh.mesh.size = Vector2(20, 20)
	floor_mesh.material_override = material
	view.add_child(floor_mesh)
	var sun := DirectionalLight3D.new()
	sun.rotation_degrees = Vector3(-45, 180, 0)
	sun.light_energy = 0.5
	view.add_child(sun)
	var camera := Camera3D.new()
	camera.position = Vector3(0, 4, 4)
	camera.rotation_degrees = Vector3(-45, 0, 0)
	camera.fov = 50
	view.add_child(camera)
	var world := WorldEnvironment.new()
	world.environment = Environment.new()
	world.environment.background_mode = Environment.BG_COLOR
	world.environment.background_color = Color.BLACK
	world.environment.ambient_light_source = Environment.AMBIENT_SOURCE_DISABLED
	view.add_child(world)
	return view
