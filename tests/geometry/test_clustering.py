import numpy as np
import pytest

from corporeal.geometry.clustering import clustered
from corporeal.geometry.normals import face_areas, face_normals
from corporeal.geometry.topology import signed_volume


def sheet(side: int) -> tuple[np.ndarray, np.ndarray]:
    """A closed torus of side x side vertices, radii 0.1 and 0.04."""
    u, v = np.meshgrid(2 * np.pi * np.arange(side) / side, 2 * np.pi * np.arange(side) / side)
    around = 0.1 + 0.04 * np.cos(v)
    vertices = np.stack([around * np.cos(u), around * np.sin(u), 0.04 * np.sin(v)], axis=2).reshape(-1, 3)
    i, j = (x.ravel() for x in np.meshgrid(np.arange(side), np.arange(side), indexing="ij"))
    at = [side * ((i + a) % side) + (j + b) % side for a, b in ((0, 0), (0, 1), (1, 1), (1, 0))]
    return vertices, np.concatenate([np.stack(at[:3], 1), np.stack([at[0], at[2], at[3]], 1)])


@pytest.mark.parametrize("count", [2000, 5000])
def test_a_coarser_copy_has_the_count_the_volume_and_the_winding(count):
    vertices, faces = sheet(150)
    few, fewer = clustered(vertices, faces, count)
    assert 0.75 * count < len(few) < 1.25 * count
    assert signed_volume(few, fewer) == pytest.approx(signed_volume(vertices, faces), rel=0.03)
    distance = np.abs(np.hypot(np.hypot(few[:, 0], few[:, 1]) - 0.1, few[:, 2]) - 0.04)
    assert distance.max() < 1e-3
    areas = face_areas(few, fewer)
    middle = few[fewer].mean(1)
    ring = np.stack([middle[:, 0], middle[:, 1], 0 * middle[:, 0]], 1)
    ring *= 0.1 / np.linalg.norm(ring, axis=1, keepdims=True)
    outward = np.sign(signed_volume(vertices, faces)) * np.einsum(
        "fa,fa->f", face_normals(few, fewer), middle - ring
    )
    assert areas[outward < 0].sum() < 0.01 * areas.sum()


def test_noise_is_averaged_and_small_meshes_stay(rng):
    vertices, faces = sheet(150)
    noisy = vertices + 3e-4 * rng.normal(size=vertices.shape)
    few, _ = clustered(noisy, faces, 1500)
    radius = np.hypot(np.hypot(few[:, 0], few[:, 1]) - 0.1, few[:, 2])
    assert radius.std() < 3e-4
    same, faces_too = clustered(vertices, faces, 22_500)
    assert same is vertices and faces_too is faces
    with pytest.raises(ValueError, match="count"):
        clustered(vertices, faces, 0)
