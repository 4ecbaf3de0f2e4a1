"""Folders of stacks: replaced, left alone, never half written."""

from dataclasses import replace
from pathlib import Path

import pytest

from mipbake.base.errors import OutputError
from mipbake.stack.containers import FORMATS, format_named
from mipbake.stack.manifest import check_output
from mipbake.stack.saving import open_stack

from .test_stack import assert_same, make_stack, tree


def test_replaces_an_earlier_stack(tmp_path):
    make_stack(seed=1).save(tmp_path / "s", format="png")
    stack = make_stack(seed=2)
    stack.save(tmp_path / "s", format="exr")
    assert_same(open_stack(tmp_path / "s"), stack, "exr")
    assert not list((tmp_path / "s").glob("*.png"))
    assert tree(tmp_path) == ["s", *(f"s/{name}" for name in tree(tmp_path / "s"))]


@pytest.mark.parametrize("sources", [{"normal.png": "xy"}, {"n.png": "ab"}, {"normal.png": "xy", "n.png": "ab"}])
def test_a_stack_of_other_sources_is_left_alone(tmp_path, sources):
    make_stack(seed=1).save(tmp_path / "s")
    before = {name: (tmp_path / "s" / name).read_bytes() for name in tree(tmp_path / "s")}
    stack = make_stack(seed=2)
    other = replace(stack, provenance=replace(stack.provenance, sources=sources))
    with pytest.raises(OutputError, match=r"'sample' of other source files \(normal.png\).*remove"):
        other.save(tmp_path / "s")
    with pytest.raises(OutputError, match="other source files"):
        check_output(tmp_path / "s", sources)
    assert {name: (tmp_path / "s" / name).read_bytes() for name in tree(tmp_path / "s")} == before
    check_output(tmp_path / "s", {"normal.png": ""})  # not read yet


def test_a_set_with_an_edited_map_replaces_its_stack(tmp_path):
    stack = make_stack(seed=1)
    first = replace(stack, provenance=replace(stack.provenance, sources={"normal.png": "ab", "roughness.png": "cd"}))
    first.save(tmp_path / "s")
    edited = replace(first, provenance=replace(first.provenance, sources={"normal.png": "ab", "roughness.png": "ef"}))
    edited.save(tmp_path / "s")
    assert open_stack(tmp_path / "s").provenance.sources["roughness.png"] == "ef"


def test_an_output_that_cannot_be_made_is_found_before_the_bake(tmp_path, monkeypatch):
    for name in ("x" * 300, f"new/{'x' * 300}/s"):
        with pytest.raises(OutputError, match="too long"):
            check_output(tmp_path / name)
    with pytest.raises(OutputError, match="not UTF-8"):
        check_output(tmp_path / "caf\udce9")
    check_output(tmp_path / "new" / "s")
    mkdir = Path.mkdir

    def refuses(self, *arguments, **options):
        if self.parent == tmp_path:
            raise OSError(30, "Read-only file system")
        mkdir(self, *arguments, **options)

    monkeypatch.setattr(Path, "mkdir", refuses)
    for name in ("s", "new/s"):
        with pytest.raises(OutputError, match="Read-only file system"):
            check_output(tmp_path / name)
    assert tree(tmp_path) == []


@pytest.mark.parametrize(
    ("fault", "earlier", "fmt"),
    [(KeyboardInterrupt, True, "exr"), (OSError(28, "No space left"), False, "png"), (RuntimeError(), True, "ktx2")],
)
def test_an_interrupted_save_leaves_nothing(tmp_path, monkeypatch, fault, earlier, fmt):
    target = tmp_path / "new" / "s"
    if earlier:
        make_stack(seed=1).save(target, format=fmt)
    before = {p: (tmp_path / p).is_file() and (tmp_path / p).read_bytes() for p in tree(tmp_path)}
    container = type(format_named(fmt))
    write = container.write

    def breaks(self, folder, layout, levels, wrap, about, weigh):
        write(self, folder, layout, levels, wrap, about, weigh)
        if layout.name == "normal":
            raise fault

    monkeypatch.setattr(container, "write", breaks)
    expected = OutputError if isinstance(fault, OSError) else fault if isinstance(fault, type) else type(fault)
    with pytest.raises(expected) as caught:
        make_stack(seed=2).save(target, format=fmt)
    if expected is OutputError:
        assert "disk is full" in str(caught.value)
    assert {p: (tmp_path / p).is_file() and (tmp_path / p).read_bytes() for p in tree(tmp_path)} == before


@pytest.mark.parametrize("fmt", ["ktx2", "dds"])
def test_a_file_that_is_gone_when_it_is_read_back_is_no_mistake_of_the_input(tmp_path, monkeypatch, fmt):
    write = Path.write_bytes
    monkeypatch.setattr(Path, "write_bytes", lambda self, data: write(self, data) and self.unlink())
    with pytest.raises(OutputError):
        make_stack().save(tmp_path / "s", format=fmt)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("fmt", FORMATS)
def test_a_writer_that_lies_is_caught(tmp_path, monkeypatch, fmt):
    container = type(format_named(fmt))
    write = container.write

    def loses_levels(self, folder, layout, levels, wrap, about, weigh):
        write(self, folder, layout, levels[:-1], wrap, about, weigh)

    monkeypatch.setattr(container, "write", loses_levels)
    with pytest.raises(OutputError, match=r"did not read back|is not complete after writing"):
        make_stack().save(tmp_path / "s", format=fmt)

    if not format_named(fmt).exact:
        fmt = f"{fmt}:rgba8"

    def changes_a_texel(self, folder, layout, levels, wrap, about, weigh):
        changed = [level.copy() for level in levels]
        changed[1][0, 0, 0] = 0 if changed[1][0, 0, 0] else 1
        write(self, folder, layout, changed, wrap, about, weigh)

    monkeypatch.setattr(container, "write", changes_a_texel)
    with pytest.raises(OutputError, match="changed while it was written"):
        make_stack().save(tmp_path / "s", format=fmt)
    assert tree(tmp_path) == []
