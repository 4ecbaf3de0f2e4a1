"""What is said of what people have in their downloads: what was meant, and what to type next."""

from __future__ import annotations

import json
import shutil
import zipfile
from pathlib import Path

import pytest

import mipbake
from mipbake.cli.main import main

from .source_tree import ROOT

SET = ROOT / "examples" / "hammered_copper"


def archived(path: Path, *names: str) -> Path:
    """An archive of copies of the set."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        for name in names:
            for file in SET.iterdir():
                archive.write(file, f"{name}/{file.name}")
    return path


def test_a_folder_of_folders(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    library = Path("my library")
    for place in ("metals/copper", "metals/worn/copper", "other"):
        shutil.copytree(SET, library / place)
    archived(library / "two.zip", "one", "two")
    assert main(["inspect", str(library)]) == 3
    told = capsys.readouterr()
    assert told.out == f"3 texture sets and 1 archive below {library}: mipbake bake '{library}' -o baked --recursive\n"
    expected = f"holds no images: expected the maps of one texture set as in {library / 'other'}, {library / 'two.zip'}"
    assert expected in told.err
    with pytest.raises(mipbake.InputError, match=r"`mipbake bake --recursive` bakes all that lies below"):
        mipbake.bake(library)
    assert main(["bake", str(library), "-o", "out"]) == 3
    assert "the same command with --recursive bakes all of it" in capsys.readouterr().out
    assert main(["inspect", str(library), "--json"]) == 3
    assert "exit_code" in json.loads(capsys.readouterr().out)


def test_a_set_beside_other_sets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = shutil.copytree(SET, tmp_path / "copper")
    archived(folder / "same.zip", "copper")
    assert main(["inspect", str(folder)]) == 0
    assert f"1 archive below {folder}: mipbake bake {folder} -o baked --recursive\n" in capsys.readouterr().out


@pytest.mark.parametrize("loose", [False, True])
def test_what_can_be_baked_says_how(loose: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A set with a `textures` folder, or two sets in one folder."""
    for name in ("one_", "two_") if loose else ("textures/",):
        for file in SET.iterdir():
            (tmp_path / f"{name}{file.name}").parent.mkdir(exist_ok=True)
            shutil.copy(file, tmp_path / f"{name}{file.name}")
    assert main(["inspect", str(tmp_path)]) == 0
    assert capsys.readouterr().out.endswith(f"to bake what was found: mipbake bake {tmp_path} -o baked\n")


def test_what_holds_nothing_is_told_apart(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "readme.txt").write_text("none")
    for source, said in (
        ("empty", "is empty: expected the maps of one texture set, such as wood_normal.png"),
        ("notes", "holds no images: expected the maps of one texture set"),
        ("none", "does not exist"),
    ):
        assert main(["inspect", str(tmp_path / source)]) == 3
        told = capsys.readouterr()
        assert said in told.err and told.out == ""
