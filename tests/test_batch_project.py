"""The project file: what it says of which sets, and which line is wrong."""

from __future__ import annotations

from pathlib import Path

import pytest

from mipbake.baking import BakeOptions
from mipbake.base.errors import InputError, UsageError
from mipbake.library import read_project
from mipbake.library.project import COMMAND_LINE, OPTIONS, TEMPLATE, Setting
from mipbake.source.options import LoadOptions

HEAD = 'library = "textures"\nout = "baked"\n'


def written(folder: Path, text: str, head: str = HEAD) -> Path:
    file = folder / "mipbake.toml"
    file.write_text(head + text, encoding="utf-8")
    return file


def test_rules_in_their_order(tmp_path: Path) -> None:
    file = written(
        tmp_path,
        """jobs = 3
memory = "2G"
[options]
method = "lean"
strength = 1
[[sets]]
match = "metals/*"
strength = 0.5
normal-convention = "directx"
map.roughness = "*_Rgh.png"
map.metallic = 1.0
map.occlusion = "none"
[[sets]]
match = ["*/old/*", "signs/*"]
wrap-u = "clamp"
gloss = true
filter = "box"
""",
    )
    project = read_project(file)
    assert read_project(tmp_path) == project
    assert (project.library, project.out) == (tmp_path / "textures", tmp_path / "baked")
    assert (project.jobs, project.memory) == (3, 2 << 30)
    wood = project.chosen("wood")
    assert (wood.options, wood.load) == (BakeOptions("lean", strength=1), LoadOptions())
    both = project.chosen("metals/old/iron")
    assert both.options == BakeOptions("lean", strength=0.5, pixel_filter="box")
    assert both.load == LoadOptions(
        maps={"roughness": "*_Rgh.png", "metallic": 1.0, "occlusion": None},
        normal_convention="directx",
        roughness_is_gloss=True,
        wrap=("clamp", "wrap"),
    )
    assert both.settings["strength"] == Setting(0.5, "mipbake.toml, line 10")
    assert both.settings["method"].origin == "mipbake.toml, line 6"
    maps = Setting({"metallic": "none"}, COMMAND_LINE)
    given = project.chosen("metals/iron", {"strength": Setting(0.25, COMMAND_LINE), "map": maps})
    assert given.options.strength == 0.25 and given.settings["strength"].origin == COMMAND_LINE
    assert given.load.maps == {"roughness": "*_Rgh.png", "metallic": None, "occlusion": None}  # role by role


def test_a_pattern_for_a_folder_is_about_all_in_it(tmp_path: Path) -> None:
    text = '[[sets]]\nmatch = ["metals", "[!m]*"]\nstrength = 0.5\n'
    project = read_project(written(tmp_path, text))
    halved = [
        label
        for label in ("metals", "metals/iron", "metals/props/Body", "metal", "m/a", "wood")
        if project.chosen(label).options.strength == 0.5
    ]
    assert halved == ["metals", "metals/iron", "metals/props/Body", "wood"]
    assert project.idle(["metals/iron", "wood"]) == []


def test_patterns_that_match_nothing_are_told(tmp_path: Path) -> None:
    text = '[[sets]]\nmatch = ["metals/*", "wod*"]\nstrength = 0.5\n[[sets]]\nmatch = "x"\n'
    project = read_project(written(tmp_path, text))
    assert project.idle(["metals/iron", "wood"]) == [
        "mipbake.toml, line 4: 'wod*' matches none of 2 sources",
        "mipbake.toml, line 7: 'x' matches none of 2 sources",
    ]
    assert project.idle(["metals/iron", "wod", "x"]) == []


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("jobs = 0\n", "mipbake.toml, line 3: jobs is 0: expected 1 or more"),
        ("jobs = true\n", "mipbake.toml, line 3: jobs is True: expected a whole number"),
        ('memory = "much"\n', "mipbake.toml, line 3: the size of memory 'much' cannot be read"),
        ("job = 2\n", "mipbake.toml, line 3: unknown key 'job': did you mean jobs? Keys: library, out, jobs"),
        ("sets = 1\n", "mipbake.toml, line 3: sets is no list of tables"),
        ('[options]\n\n# a\nmethods = "x"\n', "mipbake.toml, line 6: unknown option 'methods': did you mean method"),
        ('[options]\nmethod = "x"\n', "mipbake.toml, line 4: unknown method 'x'"),
        ('options = { method = "linear", strength = "q" }\n', "mipbake.toml, line 3: strength is 'q'"),
        ('sets = [\n  {match = "a", strength = "x"}\n]\n', "mipbake.toml, line 3: strength is 'x'"),
        ("[options]\nstrength = true\n", "mipbake.toml, line 4: strength is True: expected a number"),
        ('[options]\nmap = "x"\n', "mipbake.toml, line 4: map is 'x': expected a table"),
        ('[options]\nwrap-u = "mirror"\n', "mipbake.toml, line 4: wrap is 'mirror'"),
        ('[[sets]]\nmatch = "a"\n[[sets]]\nmatch = 1\n', "mipbake.toml, line 6: a table of sets has no match"),
        ('[[sets]]\nmatch = "a"\nmap.rough = "x"\n', "mipbake.toml, line 5: unknown map 'rough'"),
        ("x = [\n", "is not TOML: "),
    ],
)
def test_what_is_wrong_has_a_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(UsageError) as error:
        read_project(written(tmp_path, text))
    assert said in str(error.value)


def test_a_value_of_several_lines(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="line 4: unknown option 'matches'"):
        read_project(written(tmp_path, '[[sets]]\nmatches = [\n  "a",\n  "b",\n]\nmatch = "c"\n'))


@pytest.mark.parametrize("quotes", ['"' * 3, "'" * 3])
def test_text_of_several_lines_holds_no_keys(tmp_path: Path, quotes: str) -> None:
    text = f"{quotes}\n[[sets]]\nstrength = 1\n# {quotes}"
    lines = f'[options]\nmap.roughness = {text}\nmethod = "x" # {quotes}\n'
    with pytest.raises(UsageError, match="line 8: unknown method 'x'"):
        read_project(written(tmp_path, lines))


def test_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"mipbake\.toml has no out: expected out = a folder"):
        read_project(written(tmp_path, "", 'library = "x"\n'))
    with pytest.raises(InputError, match=r"no\.toml"):
        read_project(tmp_path / "no.toml")
    (tmp_path / "mipbake.toml").write_bytes(b'library = "\xff"')
    with pytest.raises(UsageError, match="not UTF-8"):
        read_project(tmp_path)


def test_the_template_can_be_read_with_and_without_its_comments(tmp_path: Path) -> None:
    text = TEMPLATE.format(library="textures", out="baked")
    assert read_project(written(tmp_path, text, "")).rules == ()
    lines = [line.removeprefix("# ") if "=" in line or line == "# [[sets]]" else line for line in text.splitlines()]
    project = read_project(written(tmp_path, "\n".join(lines), ""))
    assert len(project.rules) == 2 and project.jobs == 2
    assert project.chosen("decals/x").load.wrap == ("clamp", "clamp")


def test_every_option_has_a_type(tmp_path: Path) -> None:
    for option in OPTIONS:
        with pytest.raises(UsageError, match=rf"line 4: {option} is \[\]: expected "):
            read_project(written(tmp_path, f"[options]\n{option} = []\n"))


def test_what_does_not_go_together_is_told_where_it_meets(tmp_path: Path) -> None:
    text = '[options]\nmethod = "linear"\n[[sets]]\nmatch = "*"\nmethod = "refine"\n'
    text += '[[sets]]\nmatch = "h/*"\nbudget = "9s"\n'
    project = read_project(written(tmp_path, text))
    assert project.chosen("h/x").options.budget == "9s"
    project = read_project(written(tmp_path, '[[sets]]\nmatch = "a"\nmethod = "lean"\nbudget = "9s"\n'))
    with pytest.raises(UsageError, match=r"^mipbake\.toml, line 5, mipbake\.toml, line 6: method lean takes no budget"):
        project.chosen("a")
