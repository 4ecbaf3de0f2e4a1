extends Node
## What plugin.gd uses of the editor: its base class, and EditorInterface. Godot for browsers has
## neither.

var entries := {}
var updated := PackedStringArray()


func add_tool_menu_item(title: String, callable: Callable) -> void:
	entries[title] = callable


func remove_tool_menu_item(title: String) -> void:
	entries.erase(title)


func get_resource_filesystem() -> Node:
	return self


func update_file(path: String) -> void:
	updated.append(path)
