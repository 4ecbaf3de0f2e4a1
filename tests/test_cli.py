"""The command line: what it prints, what it writes, how it ends as a process."""

from __future__ import annotations

import inspect
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import pytest

import mipbake
from mipbake.baking.methods import METHODS
from mipbake.base import errors
from mipbake.base.options import options_of
from mipbake.cli.bake_output import measured_lines
from mipbake.cli.batch_options import BatchFlags
from mipbake.cli.commands import SUMMARIES, loaded
from mipbake.cli.main import main
from mipbake.material.pixel_filter import FILTERS
from mipbake.source.options import LoadOptions
from mipbake.stack.containers import DEFAULT_FORMAT, FORMATS
from mipbake.stack.measured import Measured, MeasuredLevel
from mipbake.stack.packing import PACKINGS
from mipbake.stack.presets import PRESETS
from mipbake.stack.stack import Provenance

from .command_line import fails, tree, write_set

PIPELINE = import_module("mipbake.baking.pipeline")


def test_bake_writes_what_it_says(folder, tmp_path, capsys):
    arguments = ["bake", str(folder), "-o", str(tmp_path / "out"), "--method", "lean", "--format", "tx,png"]
    assert main([*arguments, "--verbose"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    for role in ("base_color", "normal", "roughness", "metallic"):
        assert role in out
    assert "constant 0" in out  # metallic is missing, and said to be assumed
    assert re.search(r"time: read \d+\.\d\d s, prefilter .* write ", out) and str(tmp_path / "out" / "metal") in out
    stack = mipbake.open_stack(tmp_path / "out" / "metal")
    assert (stack.provenance.method, stack.provenance.pixel_filter, stack.model) == ("lean", "gaussian", "gltf")
    assert set(stack.provenance.sources) == {"base_color.png", "normal.png", "roughness.png"}


def test_a_bake_says_in_few_lines_what_it_found_and_wrote(folder, tmp_path, capsys):
    arguments = ["--method", "lean", "--normal-convention", "opengl"]
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), *arguments]) == 0
    found, wrote = capsys.readouterr().out.splitlines()
    assert found == "metal: 16 x 16; base_color, normal, roughness; metallic 0"
    assert wrote.startswith(f"wrote {tmp_path / 'out' / 'metal'}: 5 files, 0.0 MB")


@pytest.mark.parametrize(
    ("visible", "changed", "said"),
    [
        (0.5, (), "Calmer and truer to the source at every distance. 0.0 MB. Recommended."),
        (0.99, (), "0.0 MB. Plain MIP maps look the same on this set: --method linear --filter box writes them."),
        (None, ("strength 0.5",), "No verdict: it was changed after it was measured (strength 0.5)."),
    ],
)
def test_a_bake_ends_with_a_verdict(folder, tmp_path, capsys, monkeypatch, visible, changed, said):
    figures = ({"sharp": 10.0}, {"sharp": 0.1}, {"sharp": "lean (box)"}, {"sharp": 10.0}, {"sharp": 0.1})
    measured = Measured((MeasuredLevel(*figures, 0, ("neural",), 0.0),), 8, 8, visible=visible)
    promise = None if changed else measured

    def measured_so(stack, *_):
        return replace(stack, provenance=replace(stack.provenance, method="auto", promise=promise, adjustments=changed))

    monkeypatch.setattr("mipbake.baking.sets.adjusted", measured_so)
    arguments = ["--method", "lean", "--normal-convention", "opengl"]
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), *arguments]) == 0
    _, verdict, wrote = capsys.readouterr().out.splitlines()
    assert verdict.endswith(said) and wrote.startswith("wrote ")


@pytest.mark.long
def test_bake_says_what_was_measured(folder, tmp_path, capsys):
    arguments = ["bake", str(folder), "-o", str(tmp_path / "out"), "--method", "refine", "--budget", "0.01s"]
    assert main([*arguments, "--verbose"]) == 0
    out = capsys.readouterr().out
    provenance = mipbake.open_stack(tmp_path / "out" / "metal").provenance
    promise = provenance.promise
    assert provenance.budget == "0.01s"
    for name in ("near-mirror", "hemisphere"):
        assert f"compared with the best closed form there, {name}: {promise.summary(name)}" in out
    assert main([*arguments, "--json"]) == 0
    levels = json.loads(capsys.readouterr().out)["results"][0]["stack"]["provenance"]["promise"]["levels"]
    assert [each["level"] for each in levels] == list(range(len(promise.levels)))
    assert set(levels[0]["snr"]) == {"near-mirror", "hemisphere"}


def test_bake_equals_the_library(folder, tmp_path, capsys):
    arguments = ["--method", "linear", "--target", "ggx", "--filter", "mitchell", "--map", "metallic=1"]
    arguments += ["--normal-convention", "directx", "--wrap-u", "clamp", "--gloss", "--colour-space", "linear Rec.709"]
    assert main(["bake", str(folder), "-o", str(tmp_path / "out"), *arguments, "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    options = LoadOptions(
        maps={"metallic": 1.0},
        normal_convention="directx",
        wrap=("clamp", "wrap"),
        roughness_is_gloss=True,
        colour_space="linear Rec.709",
    )
    expected = mipbake.bake(mipbake.load(folder, options), "linear", "ggx", "mitchell")
    expected.save(tmp_path / "library")
    for name in tree(tmp_path / "library"):
        mine, theirs = ((folder / name).read_bytes() for folder in (tmp_path / "library", tmp_path / "out" / "metal"))
        if name == "stack.json":  # the command measures what it has written besides
            mine, theirs = json.loads(mine), json.loads(theirs)
            assert all(output.pop("measured")["dips"] == [] for output in theirs["outputs"])
            assert mine["provenance"].pop("recipe") == {} != theirs["provenance"].pop("recipe")
        assert mine == theirs, name


def test_bake_json(folder, tmp_path, capsys):
    missing = tmp_path / "missing"
    code = main(["bake", str(folder), str(missing), "-o", str(tmp_path / "out"), "--method", "linear", "--json"])
    out, err = capsys.readouterr()
    report = json.loads(out)
    assert code == report["exit_code"] == 3
    good, bad = report["results"]
    assert good["ok"] and good["out"] == str(tmp_path / "out" / "metal")
    assert good["bytes"] == sum(Path(f["path"]).stat().st_size for f in good["files"])
    assert good["stack"]["model"] == "gltf" and good["set"]["maps"]["normal"]["depth"] == "uint8"
    assert set(good["seconds"]) >= {"read", "prefilter", "write"}
    assert not bad["ok"] and bad["exit_code"] == 3 and str(missing) in bad["error"]
    assert err.count("\n") == 1 and str(missing) in err


def test_exit_code_is_the_worst(tmp_path, capsys):
    bad, blocked = write_set(tmp_path / "bad", normal=None), write_set(tmp_path / "blocked")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "blocked").write_text("in the way")
    assert main(["bake", str(blocked), str(bad), "-o", str(tmp_path / "out"), "--method", "linear"]) == 4
    assert capsys.readouterr().err.count("\n") == 2


def test_inspect_writes_nothing(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    before = tree(tmp_path)
    assert main(["inspect", str(folder)]) == 0
    out, err = capsys.readouterr()
    assert "normal.png" in out and "16 x 16" in out and "opengl" in out.lower() and err == ""
    assert tree(tmp_path) == before
    assert main(["inspect", str(folder), "--json", "--map", "metallic=0.5"]) == 0
    (report,) = json.loads(capsys.readouterr().out)["results"]
    assert report["ok"] and report["maps"]["metallic"]["constant"] == [0.5]
    assert report["maps"]["normal"]["path"] == str(folder / "normal.png")
    assert report["normal_convention"]["name"] == "opengl"


def test_map_option(folder, capsys):
    shutil.copy(folder / "roughness.png", folder / "wear.png")
    assert main(["inspect", str(folder), "--json", "--map", "roughness=wear.png", "--map", "base_color=none"]) == 0
    maps = json.loads(capsys.readouterr().out)["results"][0]["maps"]
    assert maps["roughness"]["path"] == str(folder / "wear.png")
    assert maps["base_color"]["path"] is None
    assert "expected ROLE=SOURCE" in fails(capsys, 2, "inspect", folder, "--map", "roughness")
    assert "expected one of base_color" in fails(capsys, 2, "inspect", folder, "--map", "shininess=wear.png")


@pytest.mark.usefixtures("quick_validation")
def test_validate(folder, tmp_path, capsys):
    mipbake.bake(mipbake.load(folder, alpha_cutoff=0.5), "lean").save(tmp_path / "out" / "metal")
    assert main(["validate", str(folder), str(tmp_path / "out" / "metal")]) == 0
    out = capsys.readouterr().out
    assert "near-mirror" in out and "hemisphere" in out and "baked" in out and "linear (box)" in out
    assert "hashes differ" not in out  # whatever opacity was tested against
    assert main(["validate", str(folder), str(tmp_path / "out" / "metal"), "--json", "--seed", "3"]) == 0
    (report,) = json.loads(capsys.readouterr().out)["results"]
    assert report["seed"] == 3 and report["points"] == 32 and report["method"] == "lean"
    assert {row["lod"] for row in report["rows"]} == {0.0, 1.0}
    assert all(isinstance(row["snr"], float) for row in report["rows"])


def test_help_lists_what_the_library_has(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "110")
    assert main(["bake", "--help-all"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for names in (METHODS, FILTERS, PRESETS, PACKINGS):
        assert "|".join(names) in text
    for name, kinds in FORMATS.items():
        assert f"(texels {', '.join(kinds)})" in text and f" {name}: " in text
    formats = f"glb for glTF sources, {DEFAULT_FORMAT} for others"
    for default in (PIPELINE.DEFAULT_METHOD, PIPELINE.DEFAULT_FILTER, PIPELINE.AUTO_TARGET, formats):
        assert f"[default: {default}]" in text or f"[default: ({default})]" in text
    codes = text.partition("Exit codes: ")[2]
    kinds = [getattr(errors, name) for name in vars(errors)]
    for kind in (k for k in kinds if isinstance(k, type) and issubclass(k, errors.MipbakeError)):
        assert f" {kind.exit_code} " in f" {codes}"
    for command in ("validate", "inspect", "compare"):
        assert main([command, "--help-all"]) == 0
        text = capsys.readouterr().out
        assert all(option in text for option in ("--map", "--normal-convention", "--gloss", "--colour-space", "--json"))
        assert "--alpha-cutoff" not in text
        for option in ("--wrap-u", "--wrap-v"):  # they change nothing that inspect tells
            assert (option in text) == (command != "inspect")
    assert main([]) == 0
    assert "Exit codes" in capsys.readouterr().out


def test_the_first_help_fits_on_a_screen(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert main(["bake", "--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) <= 50 and max(map(len, lines)) <= 80
    text = " ".join(" ".join(lines).split())
    assert text.count(" mipbake bake ") == 3 + 1 and "--strength 0..1" in text and "--keep-level0" in text
    assert all(name in text for name in (*PRESETS, *FORMATS)) and "Exit codes" not in text


def test_help_shows_few_options_and_all_of_them_when_wanted(capsys):
    shown = []
    for flag in ("--help", "--help-all"):
        assert main(["bake", flag]) == 0
        text = capsys.readouterr().out.partition("Options:")[2].partition("Exit codes")[0]
        shown.append(re.findall(r"^  (?:-\w, )?--([\w-]+)", text, re.MULTILINE))
    few, every = shown
    assert few == every[: len(few)] and few[11:] == ["verbose", "help-all", "help"]
    named = {each.name for of in (mipbake.BakeOptions, LoadOptions, BatchFlags) for each in options_of(of).values()}
    others = {"map", "wrap-u", "wrap-v", "memory", "verbose", "quiet", "json", "out", "help", "help-all"}
    assert set(every) == named | others


def test_version(capsys):
    assert main(["--version"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"mipbake {mipbake.__version__}"
    assert re.fullmatch(r"instruction set: (baseline|avx2|avx512|\w+)", lines[1])
    assert re.fullmatch("CUDA: (yes|no|compiled, but no device found)", lines[2])
    assert lines[3].startswith("weights: ")


# ---- as a process


def process(*arguments, **options):
    path = os.pathsep.join(p for p in sys.path if p)
    environment = {**os.environ, "PYTHONPATH": path, **options}
    command = [sys.executable, "-m", "mipbake.cli.main", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment)


def test_names_that_the_terminal_cannot_show_are_escaped(tmp_path):
    folder = write_set(tmp_path / "石")
    (folder / "メモ.txt").write_text("notes")
    for arguments, code in ((["inspect", folder], 0), (["inspect", folder / "木"], 3)):
        running = process(*arguments, PYTHONIOENCODING="ascii")
        out, err = running.communicate(timeout=60)
        assert running.returncode == code and "\\u77f3" in out + err, err
        assert "defect" not in err and "\x1b" not in out + err


def test_a_bake_says_how_it_compares_with_closed_forms_and_plain_maps() -> None:
    for aim, gain, visible, notes in ((0.5, -1.0, None, ["--aim 0 asks"]), (0.5, 1.0, 0.7, []), (0.0, -1.0, 0.99, [])):
        figures = ({"sharp": 10.0 + gain}, {"sharp": 0.1}, {"sharp": "lean (box)"}, {"sharp": 10.0}, {"sharp": 0.1})
        found = Measured((MeasuredLevel(*figures, 0, ("neural",), 0.0),), 8, 8, visible=visible)
        first, *others = measured_lines(Provenance("auto", "gaussian", promise=found, aim=aim))
        assert f"{gain:+.1f} in the mean" in first
        if visible is not None:
            assert f"{visible:.0%} of what plain MIP maps have" in others.pop(0)
        assert len(others) == len(notes) and all(note in line for note, line in zip(notes, others, strict=True))


SET = Path(__file__).resolve().parent.parent / "examples" / "glazed_tiles"


def loaded_by(*arguments: str) -> set[str]:
    """Modules that are loaded when a command has run."""
    script = "import sys; from mipbake.cli.main import main; main(sys.argv[1:]); print(*sys.modules, file=sys.stderr)"
    run = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True)
    return set(run.stderr.split())


def test_help_on_all_commands_loads_none() -> None:
    loaded = loaded_by("--help")
    assert "mipbake.cli.main" in loaded
    assert not loaded & {
        "numpy",
        "rich",
        "mipbake.source.images.read",
        "mipbake.baking.methods",
        *(f"mipbake.cli.{n}" for n in SUMMARIES),
    }


@pytest.mark.long
def test_a_command_loads_no_methods_that_it_does_not_use() -> None:
    loaded = loaded_by("inspect", str(SET))
    assert not loaded & {"torch", "colour", "scipy", "mipbake.baking.methods", "mipbake.comparing"}


def test_the_list_says_the_first_sentence_of_each_command() -> None:
    for name, summary in SUMMARIES.items():
        said = " ".join((inspect.getdoc(loaded(name)) or "").split())
        assert said.startswith(summary) and summary.endswith(".")


def test_the_package_offers_names_and_no_modules() -> None:
    assert dir(mipbake) == sorted([*mipbake.__all__, "__version__"])
    for name in mipbake.__all__:
        assert not inspect.ismodule(getattr(mipbake, name)), name
    with pytest.raises(AttributeError, match="no attribute 'brake'"):
        mipbake.brake  # noqa: B018
