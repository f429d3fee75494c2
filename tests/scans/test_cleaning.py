import numpy as np
import pytest
import trimesh

from corporeal.geometry.topology import signed_volume
from corporeal.scans.cleaning import LEAST_CLOUD, clean
from corporeal.scans.raw import RawScan, no_faces


def ball(centre=(0.0, 0.0, 0.0), radius=100.0, subdivisions=3) -> RawScan:
    mesh = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return RawScan(np.asarray(mesh.vertices) + centre, np.asarray(mesh.faces, dtype=np.int64))


def together(*parts: RawScan) -> RawScan:
    offsets = np.cumsum([0, *(len(part.points) for part in parts)])
    return RawScan(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.faces + offset for part, offset in zip(parts, offsets, strict=False)]),
    )


def soup(mesh: RawScan) -> RawScan:
    return RawScan(mesh.points[mesh.faces].reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3))


def test_a_clean_mesh_is_left_alone():
    mesh = ball()
    cleaned = clean(mesh)
    np.testing.assert_array_equal(cleaned.points, mesh.points)
    np.testing.assert_array_equal(cleaned.faces, mesh.faces)
    assert cleaned.notes == ()
    np.testing.assert_allclose(cleaned.normals, mesh.points / 100, atol=5e-3)


def test_a_soup_is_welded_through_float32_noise(rng):
    mesh = ball()
    loose = soup(mesh)
    noisy = RawScan(loose.points + rng.uniform(-1e-5, 1e-5, loose.points.shape), loose.faces)
    cleaned = clean(noisy)
    assert cleaned.points.shape == mesh.points.shape
    assert trimesh.Trimesh(cleaned.points, cleaned.faces, process=False).is_watertight
    assert f"Points welded: {len(loose.points)} to {len(mesh.points)}." in cleaned.notes


def test_colours_follow_their_points(rng):
    mesh = ball()
    colours = rng.integers(0, 256, mesh.points.shape).astype(np.uint8)
    loose = soup(mesh)
    cleaned = clean(RawScan(loose.points, loose.faces, colours[mesh.faces].reshape(-1, 3)))
    of_place = {tuple(point): tuple(colour) for point, colour in zip(mesh.points, colours, strict=True)}
    assert all(of_place[tuple(p)] == tuple(c) for p, c in zip(cleaned.points, cleaned.colours, strict=True))


def test_specks_are_dropped_and_parts_are_kept():
    hand, finger, speck = ball(), ball((250, 0, 0), 20.0, 2), ball((0, 250, 0), 5.0, 1)
    cleaned = clean(together(speck, hand, finger))
    assert len(cleaned.points) == len(hand.points) + len(finger.points)
    assert cleaned.points[:, 1].max() < 150
    (note,) = cleaned.notes
    assert note == "Parts with less than 2% of the area of the largest dropped: 1."


def test_broken_coordinates_are_dropped_with_their_faces():
    mesh = ball()
    points = mesh.points.copy()
    points[0], points[40], points[80] = [np.nan, 0, 0], [0, -np.inf, 0], [3e38, 0, 0]
    cleaned = clean(RawScan(points, mesh.faces))
    touched = np.isin(mesh.faces, [0, 40, 80]).any(axis=1)
    assert len(cleaned.points) == len(points) - 3
    assert len(cleaned.faces) == len(mesh.faces) - touched.sum()
    assert cleaned.notes[0].endswith("infinite coordinates dropped: 2.")
    assert cleaned.notes[1] == "Points far outside of the scan dropped: 1."


def test_bad_faces_and_unused_points_are_dropped():
    mesh = ball()
    extra = np.array([[1, 1, 2], mesh.faces[5][[1, 2, 0]], mesh.faces[6][::-1]])
    points = np.concatenate([mesh.points, [[1.0, 2.0, 3.0]]])
    cleaned = clean(RawScan(points, np.concatenate([mesh.faces, extra])))
    np.testing.assert_array_equal(cleaned.faces, mesh.faces)
    np.testing.assert_array_equal(cleaned.points, mesh.points)


def test_inside_out_is_turned_closed_or_with_a_cut_wrist():
    mesh = ball()
    for kept in (np.ones(len(mesh.faces), dtype=bool), mesh.points[mesh.faces].mean(axis=1)[:, 2] < 80):
        cleaned = clean(RawScan(mesh.points, mesh.faces[kept][:, ::-1]))
        assert signed_volume(cleaned.points, cleaned.faces) > 0
        assert (np.einsum("ni,ni->n", cleaned.normals, cleaned.points) > 0).all()
        assert "inside out" in cleaned.notes[-1]


def test_a_mirrored_scan_faces_outward():
    mesh = ball()
    cleaned = clean(RawScan(mesh.points * [-1, 1, 1], mesh.faces))
    assert (np.einsum("ni,ni->n", cleaned.normals, cleaned.points) > 0).all()


def test_a_sheet_is_never_turned():
    mesh = ball()
    sheet = mesh.points[mesh.faces].mean(axis=1)[:, 2] > 70
    for faces in (mesh.faces[sheet], mesh.faces[sheet][:, ::-1]):
        cleaned = clean(RawScan(mesh.points, faces))
        used = np.unique(faces)
        np.testing.assert_array_equal(cleaned.points[cleaned.faces], mesh.points[faces])
        assert len(cleaned.points) == len(used)


def test_crowded_and_conflicting_edges_are_stated():
    mesh = ball()
    fin = np.array([[*mesh.faces[0][:2], len(mesh.points)]])
    flipped = mesh.faces.copy()
    flipped[300] = flipped[300][::-1]
    points = np.concatenate([mesh.points, [[0.0, 0.0, 0.0]]])
    cleaned = clean(RawScan(points, np.concatenate([flipped, fin])))
    assert "Edges with more than two faces kept: 1." in cleaned.notes
    assert "Edges whose two faces have opposite windings kept: 3." in cleaned.notes
    assert len(cleaned.faces) == len(flipped) + 1


def cloud(rng, count: int, centre=(0.0, 0.0, 0.0), radius=100.0) -> np.ndarray:
    points = rng.normal(size=(count, 3))
    return radius * points / np.linalg.norm(points, axis=1, keepdims=True) + centre


def test_cloud_loses_specks_and_doubles_and_gains_normals(rng):
    hand, group, single = cloud(rng, 4000), cloud(rng, 30, (300.0, 0, 0), 3.0), np.array([[0.0, 0.0, 190.0]])
    cleaned = clean(RawScan(np.concatenate([group, hand, hand[:50], single]), no_faces()))
    np.testing.assert_array_equal(cleaned.points, hand)
    assert (np.einsum("ni,ni->n", cleaned.normals, hand) > 95).all()
    assert any("welded" in note for note in cleaned.notes)
    assert any("dropped: 31 (groups: 2)" in note for note in cleaned.notes)
    assert any("Normals estimated" in note for note in cleaned.notes)


def test_uneven_cloud_keeps_its_sparse_side(rng):
    points = cloud(rng, 20000)
    points = points[(points[:, 0] > 0) | (rng.uniform(size=len(points)) < 0.05)]
    assert len(clean(RawScan(points, no_faces())).points) == len(points)


def test_cloud_keeps_the_normals_of_its_file(rng):
    points = cloud(rng, 300)
    cleaned = clean(RawScan(points, no_faces(), normals=-3.0 * points))
    np.testing.assert_allclose(cleaned.normals, -points / 100, atol=1e-12)


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (RawScan(np.full((9, 3), np.nan), no_faces()), "finite"),
        (RawScan(np.ones((900, 3)), no_faces()), "no extent"),
        (RawScan(np.eye(3) * 1e200, np.array([[0, 1, 2]])), "no extent"),
        (RawScan(np.arange(9.0).reshape(3, 3), np.array([[0, 1, 2]])), "no face with an area"),
        (RawScan(np.eye(3), no_faces()), f"at least {LEAST_CLOUD}"),
    ],
)
def test_nothing_left_is_an_error(raw, message):
    with pytest.raises(ValueError, match=message):
        clean(raw)
