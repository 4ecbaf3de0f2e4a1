"""The fitting examples at a tiny size improve and leave picture and figures; their parts are what they say they are."""

import runpy
import subprocess
import sys

import numpy as np
import pytest
import torch

from .example_scripts import EXAMPLES, figures, scripts

FITTING = EXAMPLES / "fitting"


@pytest.fixture
def load():
    with scripts(FITTING) as imported:
        yield imported


def test_earth(load, tmp_path):
    sizes = ["--texture-size", "8", "--resolution", "16", "--supersampling", "4", "--farthest", "10"]
    load("earth").main(["--output", str(tmp_path), *sizes, "--iterations", "250", "--first-rate", "0.03"])
    found = figures(tmp_path, "earth")
    for name, curve in found["convergence"].items():
        assert curve[0][0] == 0 and curve[-1] == [250, found[f"psnr {name}"]]
        assert curve[-1][1] > curve[0][1] + 6


def test_cube(load, tmp_path):
    sizes = ["--resolutions", "8", "--runs", "3", "--iterations", "120", "--success", "0.25"]
    load("cube").main(["--output", str(tmp_path), *sizes, "--first-rate", "0.03", "--last-rate", "0.01"])
    found = figures(tmp_path, "cube")
    assert set(found) == {"8 x 8, continuous", "8 x 8, discontinuous"}
    for result in found.values():
        assert len(result["errors"]) == result["runs"] == 3
        assert np.isclose(result["mean error"], np.mean(result["errors"]), atol=1e-5)
        assert result["successful"] == np.count_nonzero(np.array(result["errors"]) < 0.25)
        assert result["mean error"] < 0.8 * result["mean error at the start"]


def test_pose(load, tmp_path):
    load("pose").main(["--output", str(tmp_path), "--trials", "6", "--resolution", "16", "--iterations", "150"])
    found = figures(tmp_path, "pose")
    assert all(len(result["errors"]) == 6 for result in found.values())
    start = found.pop("start")
    for result in found.values():
        assert result["mean loss"] < 0.5 * start["mean loss"]
    assert found["symmetry"]["mean error"] < start["mean error"]


def test_capture(load, tmp_path):
    sizes = ["--frames", "3", "--cameras", "2", "--resolution", "32", "--texture-size", "16", "--steps", "4"]
    many = ["--performances", "2", "--iterations", "300", "--rate", "0.01"]
    load("capture").main(["--output", str(tmp_path), *sizes, *many])
    found = figures(tmp_path, "capture")
    assert list(found) == ["one performance", "2 performances"]
    for each in found.values():
        assert each["mean distance"] < 0.9 * each["of the base mesh"]
        assert each["convergence"][-1] == [300, each["mean distance"]]


def test_envphong(load, tmp_path):
    sizes = ["--texture-size", "16", "--resolution", "48", "--iterations", "80", "--rate", "0.05"]
    load("envphong").main(["--output", str(tmp_path), *sizes])
    found = figures(tmp_path, "envphong")
    for name, sign in (("texture, dB", 1), ("colour, error", -1), ("exponent, error", -1)):
        curve = found["convergence"][name]
        assert sign * curve[-1][1] > sign * curve[0][1], name


@pytest.mark.long
def test_minimal(load, capsys):
    runpy.run_path(str(FITTING / "minimal.py"), run_name="__main__")
    assert float(capsys.readouterr().out.split()[-2]) > 35


def test_options(load, tmp_path):
    """Every field is an option; --full takes the paper's size, and what is given beside it wins."""
    report, earth = load("report"), load("earth")
    arguments = ["--full", "--iterations", "7", "--output", str(tmp_path)]
    settings, folder = report.parse("", earth.Settings(), earth.FULL, arguments)
    assert (settings.texture_size, settings.iterations, folder) == (512, 7, tmp_path)
    settings, _ = report.parse("", load("cube").Settings(), None, ["--resolutions", "5", "6"])
    assert settings.resolutions == (5, 6)
    with pytest.raises(SystemExit):
        report.parse("", load("cube").Settings(), None, ["--full"])


@pytest.mark.parametrize(
    ("option", "text", "said"),
    [
        ("--iterations", "-3", "expected a whole number above 0, got '-3'"),
        ("--iterations", "0", "expected a whole number above 0, got '0'"),
        ("--iterations", "2.5", "expected a whole number above 0, got '2.5'"),
        ("--first-rate", "nan", "expected a number above 0, got 'nan'"),
        ("--farthest", "inf", "expected a number above 0, got 'inf'"),
        ("--seed", "-1", "expected a whole number of at least 0, got '-1'"),
        ("--device", "toaster", "torch cannot use 'toaster'"),
    ],
)
def test_values_that_no_experiment_has_are_refused(load, capsys, option, text, said):
    with pytest.raises(SystemExit) as ended:
        load("report").parse("", load("earth").Settings(), None, [option, text])
    assert ended.value.code == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert f"error: argument {option}: {said}" in last


def test_a_planet_is_seen_from_outside(load, tmp_path):
    with pytest.raises(SystemExit, match="--nearest is 1: expected more than 1, the planet's radius"):
        load("earth").main(["--output", str(tmp_path), "--nearest", "1"])


def test_meshes_are_closed_and_face_outward(load):
    meshes = load("meshes")
    knot, normals = meshes.bumpy_knot(60, 12)
    for mesh in (meshes.cube()[0], meshes.sphere(4), knot):
        triangles = mesh.triangles.numpy()
        edges = {tuple(edge) for t in triangles for edge in (t[[0, 1]], t[[1, 2]], t[[2, 0]])}
        assert len(edges) == 3 * len(triangles) and all((b, a) in edges for a, b in edges)
        corners = mesh.positions.double().numpy()[triangles]
        assert np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) > 0  # six times the volume
    face = np.cross(*(knot.positions.numpy()[knot.triangles.numpy()[:, k]] - corners[:, 0] for k in (1, 2)))
    assert (face * normals.numpy()[knot.triangles.numpy()[:, 0]]).sum(-1).min() > 0
    _, corners_of_faces = meshes.cube()
    assert sorted(set(corners_of_faces.flatten().tolist())) == list(range(24))


def test_quaternions(load):
    camera = load("camera")
    a, b = camera.random_quaternions(2 * 50, torch.Generator().manual_seed(1)).view(2, 50, 4)
    product = camera.rotation_matrix(camera.multiply(a, b))
    assert torch.allclose(product, camera.rotation_matrix(a) @ camera.rotation_matrix(b), atol=1e-6)
    between = camera.angle_degrees(a, b)
    assert torch.allclose(camera.angle_degrees(a, camera.slerp(a, b, 0.25)), between / 4, atol=0.1)
    assert torch.allclose(camera.angle_degrees(b, camera.slerp(a, b, 0.25)), between * 0.75, atol=0.1)
    trace = camera.rotation_matrix(a).mT @ camera.rotation_matrix(b)
    cosine = (trace.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    assert torch.allclose(torch.cos(torch.deg2rad(between)), cosine, atol=1e-5)


@pytest.mark.long
@pytest.mark.skipif(not torch.distributed.is_available(), reason="this torch has no torch.distributed")
def test_two_processes_learn_what_one_learns(tmp_path):
    textures = []
    for count in (1, 2):
        launch = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={count}"]
        script = [str(FITTING / "several.py"), "--iterations", "30", "--output", str(tmp_path / f"{count}.pt")]
        run = subprocess.run([*launch, *script], capture_output=True, text=True, check=False, timeout=600)
        assert run.returncode == 0, run.stderr
        assert f"processes: {count}, PSNR" in run.stdout
        textures.append(torch.load(tmp_path / f"{count}.pt"))
    assert (textures[0] - 0.5).abs().mean() > 0.05  # something was learned
    assert (textures[0] - textures[1]).abs().max() < 1e-5  # sums of the same gradients in another order
