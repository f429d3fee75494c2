import numpy as np
import pytest
from PIL import Image

from corporeal.export.overview import Overview, error_colours, write_overview
from corporeal.export.shading import soft_shaded
from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.normals import vertex_normals
from corporeal.geometry.rasteriser import rasterise

BACKGROUND = (0.9, 0.9, 0.9)
X, Y, Z = np.eye(3)


@pytest.fixture
def overview(model):
    points = model.template
    return Overview(
        scan_points=points,
        scan_faces=model.faces,
        scan_normals=None,
        model_vertices=points,
        registration_vertices=points,
        faces=model.faces,
        point_errors_mm=np.zeros(len(points)),
        views=((Z, X), (-Z, X)),
        title=("a scan: ok", "figures"),
    )


def panel(path, column, row=0):
    """One panel of the page, as numbers."""
    left, top = 14 + column * 354, 84 + row * 434
    with Image.open(path) as page:
        return np.asarray(page.convert("RGB"))[top : top + 420, left : left + 340].astype(int)


def drawn(pixels):
    """Pixels that are not the neutral field; the corner with the view's name is left out."""
    away = np.abs(pixels - pixels[-1, -1]).max(axis=-1) > 12
    away[:30, :90] = False
    return away


def with_fields(overview, **changes):
    return Overview(**{**vars(overview), **changes})


def test_all_panels_show_the_surface_in_the_same_place(overview, tmp_path):
    path = tmp_path / "new" / "overview.png"
    write_overview(path, overview)
    with Image.open(path) as page:
        assert page.size == (14 + 4 * 354 + 92, 84 + 2 * 434)
    for row in range(2):
        silhouettes = [drawn(panel(path, column, row)) for column in range(4)]
        assert 0.1 < silhouettes[0].mean() < 0.9
        for silhouette in silhouettes[1:]:
            # Only antialiased rims, mixed with the field, may fall on either side of the threshold.
            assert (silhouette != silhouettes[0]).mean() < 0.01


def test_errors_have_the_colours_of_the_scale(overview, tmp_path):
    path = tmp_path / "overview.png"
    count = len(overview.scan_points)
    channel = {}
    for name, error in (("none", 0.0), ("large", 9.0), ("unscored", np.nan)):
        write_overview(path, with_fields(overview, point_errors_mm=np.full(count, error)))
        pixels = panel(path, 3)
        channel[name] = pixels[drawn(pixels)].mean(axis=0)
    assert channel["none"].argmax() == 2
    assert channel["large"].argmax() == 0
    assert np.ptp(channel["unscored"]) < 2


def test_point_clouds_are_drawn_with_and_without_normals(overview, model, rng, tmp_path):
    corners = model.template[model.faces[rng.integers(len(model.faces), size=20000)]]
    points = np.einsum("nk,nkd->nd", rng.dirichlet(np.ones(3), size=20000), corners)
    path = tmp_path / "overview.png"
    for normals in (None, rng.standard_normal(points.shape)):
        cloud = with_fields(
            overview, scan_points=points, scan_faces=None, scan_normals=normals,
            point_errors_mm=np.zeros(len(points)),
        )  # fmt: skip
        write_overview(path, cloud)
        surface, splats = drawn(panel(path, 1)), drawn(panel(path, 0))
        assert (surface & splats).sum() > 0.9 * surface.sum()
        assert (splats & ~surface).mean() < 0.05


def test_an_arm_beyond_the_scored_points_does_not_shrink_the_hand(overview, tmp_path):
    far = overview.scan_points + [0.5, 0, 0]
    longer = with_fields(
        overview,
        scan_points=np.concatenate([overview.scan_points, far]),
        scan_faces=np.concatenate([overview.scan_faces, overview.scan_faces + len(far)]),
        point_errors_mm=np.concatenate([overview.point_errors_mm, np.full(len(far), np.nan)]),
    )
    write_overview(tmp_path / "a.png", overview)
    write_overview(tmp_path / "b.png", longer)
    np.testing.assert_array_equal(panel(tmp_path / "a.png", 2), panel(tmp_path / "b.png", 2))


def test_views_and_names_must_pair(overview, tmp_path):
    with pytest.raises(ValueError, match="view_names: 2 names for 1 views"):
        write_overview(tmp_path / "o.png", with_fields(overview, views=((Z, X),)))
    with pytest.raises(ValueError, match="parallel"):
        write_overview(tmp_path / "o.png", with_fields(overview, views=((Z, Z), (Z, X))))
    assert list(tmp_path.iterdir()) == []


def test_the_scale_tells_errors_apart_and_clamps():
    colours = error_colours(np.array([0.0, 3.0, 50.0, np.nan]))
    np.testing.assert_array_equal(colours[1], colours[2])
    assert colours[0].argmax() == 2
    assert colours[1].argmax() == 0
    assert np.ptp(colours[3]) == 0
    # No colour stands for two errors: half a millimetre apart they differ visibly, wherever on the scale.
    scale = error_colours(np.linspace(0, 3, 61))
    difference = np.linalg.norm(scale[:, None] - scale[None], axis=-1)
    apart = np.abs(np.subtract.outer(np.arange(61), np.arange(61))) >= 10
    assert difference[apart].min() > 0.15


def test_flipped_normals_give_the_same_picture_and_rims_are_dark():
    # A small square 3 cm before a large one.
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    vertices = np.concatenate([0.1 * square, 0.04 * square - [0, 0, 0.03]])
    faces = np.array([[0, 2, 1], [0, 3, 2], [4, 6, 5], [4, 7, 6]])
    camera = Pinhole.look_at(np.array([0, 0, -0.5]), np.zeros(3), -Y, fov=0.3, size=(100, 100))
    raster = rasterise(vertices, faces, camera)
    normals = vertex_normals(vertices, faces)
    picture = soft_shaded(raster, faces, normals, (0.8, 0.8, 0.8), BACKGROUND)
    np.testing.assert_allclose(
        picture, soft_shaded(raster, faces, -normals, (0.8, 0.8, 0.8), BACKGROUND), atol=1e-12
    )
    depth, shade = raster.depth[50], picture[50, :, 0]
    jump = int(np.flatnonzero(np.diff(depth) > 0.01)[0])
    assert shade[jump + 1] < 0.8 * shade[50]
    assert abs(shade[50] - shade[jump + 8]) < 0.05
