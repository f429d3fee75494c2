import numpy as np
import pytest

from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.rasteriser import flat_picture, rasterise, shade, splat


def pixel_camera(width: int = 8, height: int = 6) -> Pinhole:
    """At depth 1, one metre is one pixel and the world origin is the picture's corner."""
    return Pinhole(width, height, np.ones(2), np.zeros(2), np.eye(4))


def triangles(*corners: list[list[float]]) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.array(corners, float).reshape(-1, 3)
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def random_soup(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
    centres = rng.normal(size=(count, 1, 3)) * 0.3
    return (centres + rng.normal(size=(count, 3, 3)) * 0.15).reshape(-1, 3), np.arange(3 * count).reshape(
        -1, 3
    )


def cast_rays(vertices: np.ndarray, faces: np.ndarray, camera: Pinhole) -> tuple[np.ndarray, np.ndarray]:
    """Moeller-Trumbore over every face: the oracle."""
    y, x = np.mgrid[: camera.height, : camera.width]
    pixels = np.stack([x, y], axis=-1).reshape(-1, 2) + 0.5
    rays = np.c_[(pixels - camera.centre) / camera.focal, np.ones(len(pixels))]
    local = camera.to_camera(vertices)
    depth, index = np.full(len(rays), np.inf), np.full(len(rays), -1)
    for f, (a, b, c) in enumerate(local[faces]):
        cross = np.cross(rays, c - a)
        determinant = cross @ (b - a)
        u = cross @ -a / determinant
        q = np.cross(-a, b - a)
        v = rays @ q / determinant
        z = (c - a) @ q / determinant
        hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (z > 1e-3) & (z < depth)
        depth[hit], index[hit] = z[hit], f
    shape = (camera.height, camera.width)
    return depth.reshape(shape), index.reshape(shape)


def test_a_triangle_covers_exactly_the_pixel_centres_inside():
    vertices, faces = triangles([[1, 1, 1], [5, 1, 1], [1, 5, 1]])
    raster = rasterise(vertices, faces, pixel_camera())
    y, x = np.mgrid[:6, :8] + 0.5
    expected = (x >= 1) & (y >= 1) & (x + y <= 6)  # centres on the slanted edge belong to it
    np.testing.assert_array_equal(raster.covered, expected)
    np.testing.assert_array_equal(raster.depth[expected], 1.0)
    assert np.isinf(raster.depth[~expected]).all()


def test_equal_depth_goes_to_the_lower_index_and_no_gap_is_left_between_neighbours(rng):
    grid = np.stack(np.meshgrid(np.arange(9.0), np.arange(7.0)), -1).reshape(-1, 2)
    grid[:] += rng.uniform(-0.3, 0.3, grid.shape) * ((grid > 0) & (grid < [8, 6]))
    corner = (np.arange(6)[:, None] * 9 + np.arange(8)).ravel()
    faces = np.concatenate([np.c_[corner, corner + 1, corner + 10], np.c_[corner, corner + 10, corner + 9]])
    vertices = np.c_[grid * 2.5, np.full(63, 2.5)]
    raster = rasterise(vertices, faces, pixel_camera())
    assert raster.covered.all()
    twice = rasterise(vertices, np.concatenate([faces, faces]), pixel_camera())
    np.testing.assert_array_equal(twice.face, raster.face)


def test_depth_face_and_weights_agree_with_ray_casting(rng):
    vertices, faces = random_soup(rng, 60)
    camera = Pinhole.look_at(np.array([0.3, 0.2, -2.0]), np.zeros(3), np.array([0.1, 1.0, 0]), 0.8, (70, 50))
    raster = rasterise(vertices, faces, camera)
    depth, index = cast_rays(vertices, faces, camera)
    np.testing.assert_array_equal(raster.face, index)
    np.testing.assert_allclose(raster.depth, depth, rtol=1e-10)
    seen = raster.covered
    assert 0.2 < seen.mean() < 1.0
    points = np.einsum("nk,nkd->nd", raster.barycentric[seen], vertices[faces[raster.face[seen]]])
    pixels, z = camera.project(points)
    y, x = np.nonzero(seen)
    np.testing.assert_allclose(pixels, np.c_[x, y] + 0.5, atol=1e-9)
    np.testing.assert_allclose(z, raster.depth[seen], rtol=1e-12)


def test_faces_that_reach_behind_the_camera_are_cut_not_lost(rng):
    vertices, faces = random_soup(rng, 200)
    camera = Pinhole.look_at(np.zeros(3), np.array([0, 0, 1.0]), np.array([0, 1.0, 0]), 1.2, (60, 60))
    behind = camera.to_camera(vertices)[faces][:, :, 2] < 0
    assert (behind.any(1) & ~behind.all(1)).sum() > 20
    raster = rasterise(vertices, faces, camera)
    depth, index = cast_rays(vertices, faces, camera)
    np.testing.assert_array_equal(raster.face, index)
    np.testing.assert_allclose(raster.depth, depth, rtol=1e-9)


def test_the_near_plane_hides_what_is_closer():
    vertices, faces = triangles([[0, 0, 1], [9, 0, 1], [0, 9, 1]], [[0, 0, 3], [30, 0, 3], [0, 30, 3]])
    assert (rasterise(vertices, faces, pixel_camera()).face[:3, :3] == 0).all()
    assert (rasterise(vertices, faces, pixel_camera(), near=2.0).face[:3, :3] == 1).all()


def test_empty_degenerate_and_wrong_input():
    camera = pixel_camera()
    assert not rasterise(np.zeros((0, 3)), np.zeros((0, 3), int), camera).covered.any()
    flat, faces = triangles([[1, 1, 1], [2, 2, 1], [3, 3, 1]])
    assert not rasterise(flat, faces, camera).covered.any()
    with pytest.raises(ValueError, match="faces"):
        rasterise(flat, np.array([[0, 1, 3]]), camera)
    with pytest.raises(ValueError, match="near"):
        rasterise(flat, faces, camera, near=0.0)
    with pytest.raises(ValueError, match="radius"):
        splat(flat, None, camera, 0.0)


def test_a_disc_covers_its_circle_and_the_nearest_wins():
    points = np.array([[4.0, 3.0, 1.0], [8.0, 6.0, 2.0]])
    raster = splat(points, np.array([[0, 0, 1.0], [0, 0, -1.0]]), pixel_camera(), 0.9)
    y, x = np.mgrid[:6, :8] + 0.5
    near, far = np.hypot(x - 4, y - 3) <= 0.9, np.hypot(2 * x - 8, 2 * y - 6) <= 0.9
    np.testing.assert_array_equal(raster.face == 0, near)
    np.testing.assert_array_equal(raster.covered, near | far)
    tilted = splat(points[:1], np.array([[1.0, 0, 2.0]]), pixel_camera(), 0.9)
    np.testing.assert_allclose(tilted.depth[tilted.covered], (6 / (x + 2))[tilted.covered])
    assert tilted.covered.sum() >= 2


def test_discs_of_a_sphere_show_the_sphere(rng):
    points = rng.normal(size=(4000, 3))
    points *= 0.1 / np.linalg.norm(points, axis=1, keepdims=True)
    camera = Pinhole.fit_to_frame(
        points, np.array([0, 0, 1.0]), np.array([0, 1.0, 0]), fov=0.5, size=(64, 64), fill=0.8
    )
    for normals, error in ((points, 0.004), (None, 0.0085)):  # discs facing the camera stick out at the rim
        raster = splat(points, normals, camera, 0.008)
        y, x = np.nonzero(raster.covered)
        seen = camera.unproject(np.c_[x, y] + 0.5, raster.depth[raster.covered])
        np.testing.assert_allclose(np.linalg.norm(seen, axis=1), 0.1, atol=error)
        inside = np.hypot(*(np.mgrid[:64, :64] + 0.5 - 32)) < 24
        assert raster.covered[inside].all()
        assert (raster.depth[inside] < np.linalg.norm(camera.eye)).all()


def test_shading_is_lambert_on_both_sides():
    vertices, faces = triangles([[-9, -9, 1], [9, -9, 1], [0, 9, 1]])
    camera = Pinhole(3, 3, np.full(2, 2.0), np.full(2, 1.5), np.eye(4))
    for winding in (faces, faces[:, ::-1]):
        raster = rasterise(vertices, winding, camera)
        picture = shade(raster, vertices, winding, colours=(1.0, 0.5, 0.0))
        np.testing.assert_array_equal(picture[1, 1], [255, 128, 0])
        slanted = 0.25 + 0.75 / np.sqrt(1 + 0.5**2)
        assert picture[1, 2, 0] == round(255 * slanted)
    side = shade(raster, vertices, faces, colours=(1.0, 1.0, 1.0), light=np.array([1.0, 0, -1.0]))
    assert side[1, 1, 0] == round(255 * (0.25 + 0.75 * np.sqrt(0.5)))
    dark = shade(raster, vertices, faces, colours=(1.0, 1.0, 1.0), light=np.array([0, 0, 1.0]))
    assert dark[1, 1, 0] == round(255 * 0.25)


def test_colours_are_interpolated_and_the_background_shows():
    vertices, faces = triangles([[0, 0, 1], [4, 0, 1], [0, 4, 1]])
    raster = rasterise(vertices, faces, pixel_camera())
    ambient = shade(
        raster, vertices, faces, colours=np.eye(3), light=np.array([0, 0, 1.0]), background=(0.0, 1.0, 0.0)
    )
    np.testing.assert_array_equal(ambient[5, 7], [0, 255, 0])
    weights = np.array([1 - 2 / 4, 1.5 / 4, 0.5 / 4])  # the centre (1.5, 0.5)
    np.testing.assert_allclose(ambient[0, 1], 255 * 0.25 * weights, atol=0.51)


def test_smooth_normals_are_used():
    vertices, faces = triangles([[-9, -9, 1], [9, -9, 1], [0, 9, 1]])
    camera = Pinhole(3, 3, np.full(2, 2.0), np.full(2, 1.5), np.eye(4))
    raster = rasterise(vertices, faces, camera)
    tilted = np.tile([0.0, np.sin(1.0), -np.cos(1.0)], (3, 1))
    picture = shade(raster, vertices, faces, normals=tilted, colours=(1.0, 1.0, 1.0))
    assert picture[1, 1, 0] == round(255 * (0.25 + 0.75 * np.cos(1.0)))


def test_the_fast_flat_picture_is_the_one_of_the_two_steps(rng):
    vertices = rng.uniform([-1, -1, 2], [1, 1, 5], size=(60, 3))
    faces = rng.integers(0, 60, size=(80, 3))
    camera = Pinhole.fit_to_frame(
        vertices, np.array([0.1, 0.2, 1.0]), np.array([0, 1.0, 0]), fov=0.8, size=(90, 70), fill=1.0
    )
    colours = {"background": (0.1, 0.5, 1.0)}
    two = shade(rasterise(vertices, faces, camera), vertices, faces, None, (0.9, 0.4, 0.2), **colours)
    one = flat_picture(vertices, faces, camera, (0.9, 0.4, 0.2), **colours)
    assert len(np.unique(one.reshape(-1, 3), axis=0)) > 5
    # A rounding of the last bit may fall to either side.
    assert np.abs(one.astype(int) - two.astype(int)).max() <= 1
    with pytest.raises(ValueError, match="faces"):
        flat_picture(vertices, np.array([[0, 1, 60]]), camera)
    with pytest.raises(ValueError, match="near"):
        flat_picture(vertices, faces, camera, near=0.0)
