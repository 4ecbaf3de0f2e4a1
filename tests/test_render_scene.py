"""What mesh renders are set up from: cameras, meshes, tangents and lighting."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.base.errors import InputError, UsageError
from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.camera import Camera, orbit
from mipbake.comparing.meshes.mesh import Mesh
from mipbake.comparing.meshes.tangents import corner_normals, with_tangents
from mipbake.quality import environment


def to_pixel(camera: Camera, point: Any, resolution: tuple[int, int], **options: Any) -> Any:
    """(column, row) from the bottom, in pixels from the corner."""
    clip = camera.to_clip([point], resolution, **options)[0]
    return (clip[:2] / clip[3] + 1) / 2 * [resolution[1], resolution[0]]


def test_a_camera_sees_its_target_in_the_middle_and_its_field_of_view_to_the_edge() -> None:
    camera = Camera((0, 0, 5), field_of_view=60)
    assert to_pixel(camera, (0, 0, 0), (40, 80)) == pytest.approx([40, 20])
    edge = 5 * np.tan(np.radians(30))
    assert to_pixel(camera, (0, edge, 0), (40, 80)) == pytest.approx([40, 40])
    assert to_pixel(camera, (2 * edge, 0, 0), (40, 80)) == pytest.approx([80, 20])
    near, far = camera.to_clip([(0, 0, 5 - camera.near), (0, 0, 5 - camera.far)], (40, 80))
    assert near[2] / near[3] == pytest.approx(-1) and far[2] / far[3] == pytest.approx(1)


@pytest.mark.parametrize("elevation", [-90, -30, 60])
def test_orbit_keeps_its_distance_and_looks_at_the_target(elevation: float) -> None:
    camera = orbit(3, 130, elevation, looks_at=(1, 2, 3))
    assert np.linalg.norm(np.subtract(camera.position, (1, 2, 3))) == pytest.approx(3)
    assert to_pixel(camera, (1, 2, 3), (64, 64)) == pytest.approx([32, 32])
    matrix, point = camera.view_matrix()[:3, :3], (1.3, 2.2, 2.6)
    assert np.allclose(matrix @ matrix.T, np.eye(3)) and np.linalg.det(matrix) == pytest.approx(1)
    moved = to_pixel(camera, point, (30, 50), offset=(0.25, -2))
    assert moved == pytest.approx(to_pixel(camera, point, (30, 50)) - [0.25, -2])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"position": (0, 0, 0)}, "looks at"),
        ({"position": (0, 3, 0)}, "along its up direction"),
        ({"position": (0, 0, np.nan)}, "not finite"),
        ({"position": (0, 0, 1), "field_of_view": 180}, "field of view"),
        ({"position": (0, 0, 1), "near": 0}, "near and far"),
    ],
)
def test_what_makes_no_camera_is_named(values: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Camera(**values)


@pytest.mark.parametrize("mesh", [shapes.plane(), shapes.sphere(24)], ids=lambda m: m.name)
def test_shapes_have_orthonormal_right_handed_frames_that_follow_their_texture(mesh: Mesh) -> None:
    n, t = mesh.normals, mesh.tangents[:, :3]
    for vectors in (n, t):
        assert np.allclose(np.linalg.norm(vectors, axis=-1), 1)
    assert np.abs((n * t).sum(-1)).max() < 1e-12
    assert (mesh.tangents[:, 3] == 1).all()
    p = mesh.positions[mesh.triangles]
    face = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    assert (np.linalg.norm(face, axis=-1) > 1e-9).all()
    assert ((face[:, None] * n[mesh.triangles]).sum(-1) > 0).all()
    generated = with_tangents("same", mesh.positions, n, mesh.uv, mesh.triangles)
    a, b = mesh.tangents[mesh.triangles], generated.tangents[generated.triangles]
    assert np.array_equal(a[..., 3], b[..., 3])
    assert (a[..., :3] * b[..., :3]).sum(-1).min() > 0.99


def test_mirrored_texture_coordinates_turn_the_handedness_and_split_the_seam() -> None:
    # Two quads side by side that share an edge; u grows to the middle and falls beyond it.
    positions = np.array([[x, y, 0.0] for y in (0, 1) for x in (0, 1, 2)])
    uv = np.array([[u, 1 - y] for y in (0, 1) for u in (0, 1, 0)], np.float64)
    triangles = np.array([[0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4]], np.int32)
    mesh = with_tangents("mirrored", positions, np.tile([0.0, 0, 1], (6, 1)), uv, triangles)
    assert len(mesh.positions) == 8  # the two vertices of the middle, twice
    sides = mesh.tangents[mesh.triangles]
    assert np.allclose(sides[:2], [1, 0, 0, 1]) and np.allclose(sides[2:], [-1, 0, 0, -1])
    # The bitangent points towards smaller v: up.
    b = np.cross(mesh.normals, mesh.tangents[:, :3]) * mesh.tangents[:, 3:]
    assert np.allclose(b, [0, 1, 0])
    # Triangles without area in the texture still get a frame.
    flat = with_tangents("flat", positions, mesh.normals[:6], np.zeros((6, 2)), triangles[:1])
    assert np.allclose(np.linalg.norm(flat.tangents[:, :3], axis=-1), 1)
    assert np.allclose((flat.tangents[:, :3] * flat.normals).sum(-1), 0)


def test_tangents_weigh_corners_by_their_angle_and_join_equal_vertices() -> None:
    # A fan of a 90 and a 45 degree triangle around vertex 0 with different directions of u; its corners come twice.
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 0], [0, 1, 0], [-1, 1, 0]], np.float64)
    uv = np.array([[0, 0], [1, 0], [0, -1], [0, 0], [0.5, -1], [-1, -1]], np.float64)
    triangles = np.array([[0, 1, 2], [3, 4, 5]], np.int32)
    mesh = with_tangents("fan", positions, np.tile([0.0, 0, 1], (6, 1)), uv, triangles)
    alone = with_tangents("one", positions[3:], np.tile([0.0, 0, 1], (3, 1)), uv[3:], triangles[:1])
    expected = np.array([1.0, 0, 0]) * 90 + alone.tangents[0, :3] * 45
    expected /= np.linalg.norm(expected)
    for vertex in (mesh.triangles[0, 0], mesh.triangles[1, 0]):
        assert np.allclose(mesh.tangents[vertex, :3], expected)


def test_normals_are_smooth_up_to_the_crease_and_weighted_by_angle() -> None:
    # Three triangles around the origin: two in one plane, of 90 and 45 degrees there, the third turned by 45 degrees.
    positions = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [-1, 1, 0], [1, -1, 1]], np.float64)
    triangles = np.array([[0, 1, 2], [0, 2, 3], [0, 4, 1]], np.int32)
    turned = np.array([0, 1, 1]) / np.sqrt(2)
    flat = corner_normals(positions, triangles, 0)
    assert np.allclose(flat[:2], [0, 0, 1]) and np.allclose(flat[2], turned)
    assert np.allclose(corner_normals(positions, triangles, 44), flat)
    smooth = corner_normals(positions, triangles, 46)
    angles = np.pi / 2, np.pi / 4, np.arccos(1 / np.sqrt(3))
    expected = np.array([0, 0, 1]) * (angles[0] + angles[1]) + turned * angles[2]
    assert np.allclose(smooth[:, 0], expected / np.linalg.norm(expected))
    assert np.allclose(smooth[1, 1:], [0, 0, 1])
    lonely = corner_normals(np.zeros((3, 3)), triangles[:1], 60)
    assert np.allclose(np.linalg.norm(lonely, axis=-1), 1)


def test_meshes_that_are_none_are_refused() -> None:
    p = shapes.plane()
    with pytest.raises(InputError, match="no triangles"):
        Mesh("x", p.positions, p.normals, p.uv, p.tangents, p.triangles[:0])
    with pytest.raises(InputError, match="beyond its 4 vertices"):
        Mesh("x", p.positions, p.normals, p.uv, p.tangents, p.triangles + 1)
    with pytest.raises(InputError, match="uv have shape"):
        Mesh("x", p.positions, p.normals, p.uv[:3], p.tangents, p.triangles)
    with pytest.raises(InputError, match="normals hold a value that is not finite"):
        Mesh("x", p.positions, p.normals * np.nan, p.uv, p.tangents, p.triangles)


def irradiance(normals: Any, lighting: environment.Lighting) -> Any:
    """Of surfaces with (N, 3) unit normals."""
    return np.maximum(normals @ lighting.direction.T, 0) @ lighting.radiance


@pytest.mark.parametrize("make", [environment.studio_map, environment.sky_map], ids=lambda f: f.__name__)
def test_lights_carry_the_energy_of_their_environment_and_get_better_with_their_number(make: Any) -> None:
    values = make(64)
    looking = environment.directions_of(64, 128)
    solid = np.cos(np.arcsin(looking[:, :1, 1])) * (np.pi / 64) ** 2
    normals, errors = np.random.default_rng(0).standard_normal((256, 3)), []
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    each = environment.Lighting("texels", looking.reshape(-1, 3), (values * solid[..., None]).reshape(-1, 3))
    exact = irradiance(normals, each)
    for count in (16, 64, 256):
        lighting = environment.from_map("x", values, count, normalised=False)
        assert lighting.radiance.sum(0) == pytest.approx((values * solid[..., None]).sum((0, 1)), rel=1e-3)
        assert np.allclose(np.linalg.norm(lighting.direction, axis=-1), 1)
        off = irradiance(normals, lighting) - exact
        errors.append(np.sqrt(np.square(off).mean()) / exact.mean())
    assert errors[0] > 1.5 * errors[1] > 1.5**2 * errors[2]
    assert errors[1] < 0.025


def test_the_clear_sky_is_the_one_of_the_standard() -> None:
    """CIE S 011:2003 type 12 by hand: the zenith at 90 degrees from the sun, the sun at 60 degrees from the zenith."""
    zenith, chi = np.array([1.0, 0.5]), np.array([np.pi / 2, 0.0])
    # (1 - e^-0.32) and (1 - e^-0.64)(1 + 10 (1 - e^(-3 pi / 2)) + 0.45)
    assert environment.clear_sky(zenith, chi) == pytest.approx([0.27385096, 5.3700370], rel=1e-6)


def test_named_environments_light_a_white_matte_sphere_to_1_on_average() -> None:
    normals = np.random.default_rng(0).standard_normal((20000, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    for name in ("studio", "sky"):
        lighting, again = (environment.lighting_named(name) for _ in range(2))
        assert np.array_equal(lighting.direction, again.direction)
        luminance = irradiance(normals, lighting).mean(0) / np.pi @ [0.2126, 0.7152, 0.0722]
        assert luminance == pytest.approx(1, rel=0.02)


def test_an_environment_comes_from_a_file_and_one_with_nan_is_refused_in_a_sentence(tmp_path: Path) -> None:
    import OpenImageIO

    def write(name: str, values: Any) -> Path:
        OpenImageIO.ImageBuf(np.ascontiguousarray(values, np.float32)).write(str(tmp_path / name))
        return tmp_path / name

    values = environment.sky_map(32).astype(np.float32)
    lighting = environment.lighting_named(str(write("sky.exr", values)), 32)
    assert np.array_equal(lighting.radiance, environment.from_map("sky", values, 32).radiance)
    bad, negative = values.copy(), values.copy()
    bad[3, 5, 1], negative[3, 5, 1] = np.nan, -1
    for name, wrong, message in (
        ("bad.exr", bad, r"bad.exr holds a value that is not finite at row 3, column 5, channel 1"),
        ("negative.exr", negative, r"negative at row 3, column 5, channel 1"),
        ("square.exr", values[:, :32], "twice as wide as high"),
        ("grey.exr", values[..., :1], "fewer than three channels"),
    ):
        with pytest.raises(InputError, match=message):
            environment.from_file(write(name, wrong))
    for path in (write("whole.hdr", values), write("whole.exr", values)):
        data = path.read_bytes()
        for kept in (len(data) - 3, len(data) // 2, 0):
            path.write_bytes(data[:kept])
            with pytest.raises(InputError, match=rf"whole{path.suffix} cannot be read .*: expected a whole image"):
                environment.lighting_named(str(path))
    with pytest.raises(InputError, match=r"none\.hdr cannot be read"):
        environment.from_file(tmp_path / "none.hdr")
    with pytest.raises(InputError, match="is black"):
        environment.from_map("night", np.zeros((4, 8, 3)))
    with pytest.raises(UsageError, match="unknown lighting 'dusk'"):
        environment.lighting_named("dusk")
    with pytest.raises(UsageError, match="power of two"):
        environment.from_map("x", values, 12)


def test_lights_given_one_by_one_are_checked() -> None:
    lighting = environment.directional("two", [[0, 3, 0], [1, 0, 0]], np.ones((2, 3)))
    assert np.allclose(lighting.direction, [[0, 1, 0], [1, 0, 0]]) and (lighting.radiance == 1).all()
    with pytest.raises(UsageError, match=r"\(K, 3\)"):
        environment.directional("x", [[0, 1, 0]], [[1, 1]])
    with pytest.raises(UsageError, match="some length"):
        environment.directional("x", [[0, 0, 0]], [[1, 1, 1]])


def test_a_sun_of_one_texel_is_one_light_with_all_its_energy() -> None:
    sky = np.full((8, 16, 3), 1e-3)
    sky[1, 3] = 4000
    lights = environment.from_map("sun", sky, 64)
    brightest = int(np.argmax(lights.radiance.sum(-1)))
    assert 2 < len(lights.direction) < 64
    assert lights.radiance[brightest].sum() > 0.99 * lights.radiance.sum()
    assert np.allclose(lights.direction[brightest], environment.directions_of(8, 16)[1, 3], atol=1e-3)
    assert (lights.direction[brightest][:2] > 0).all()  # left of the middle is +x, the upper half +y (OpenEXR)
