@tool
extends EditorPlugin
## Two entries of Project > Tools: one makes materials, one switches the roughness limiter off.
##
## This is no import plugin. Those go by the last extension of a file, and one for .json would take
## every JSON file of the project. DDS files need no import: Godot loads them with their levels.

const StackMaterial := preload("stack_material.gd")
const MAKE := "mipbake: Make or Update Materials"
const LIMITER_OFF := "mipbake: Switch the Roughness Limiter Off"


func _enter_tree() -> void:
	add_tool_menu_item(MAKE, _make_all)
	add_tool_menu_item(LIMITER_OFF, _switch_limiter_off)


func _exit_tree() -> void:
	remove_tool_menu_item(MAKE)
	remove_tool_menu_item(LIMITER_OFF)


func _make_all() -> void:
	var found := StackMaterial.manifests("res://")
	for manifest in found:
		var maker := StackMaterial.new()
		var place := maker.save(manifest)
		if place:
			print("mipbake: made ", place)
			EditorInterface.get_resource_filesystem().update_file(place)
		else:
			push_error("mipbake: " + maker.problem)
	if found.is_empty():
		var wanted := "bake a set into it with mipbake bake SET -o FOLDER --preset godot."
		push_warning("mipbake: this project has no stack.json: " + wanted)
	elif ProjectSettings.get_setting(StackMaterial.LIMITER):
		var entry := "choose Project > Tools > %s." % LIMITER_OFF
		push_warning("mipbake: the roughness limiter is on, so bumps count twice: " + entry)


func _switch_limiter_off() -> void:
	ProjectSettings.set_setting(StackMaterial.LIMITER, false)
	ProjectSettings.save()
	RenderingServer.screen_space_roughness_limiter_set_active(false, 0.25, 0.18)  # until a restart
	print("mipbake: the screen-space roughness limiter is off in this project.")
