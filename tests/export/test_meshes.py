import numpy as np
import pytest
import trimesh

from corporeal.atomic import write_bytes
from corporeal.export.meshes import write_obj, write_ply


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_ply_is_read_back_bit_for_bit(model, rng, tmp_path, dtype):
    vertices = model.template.astype(dtype)
    colours = rng.integers(0, 256, size=(len(vertices), 3), dtype=np.uint8)
    error = rng.random(len(vertices)).astype(np.float32)
    path = tmp_path / "new" / "mesh.ply"
    write_ply(
        path, vertices, model.faces, colours=colours, properties={"error_mm": error}, comments=("in metres",)
    )
    mesh = trimesh.load(path, process=False)
    np.testing.assert_array_equal(mesh.vertices, vertices)
    np.testing.assert_array_equal(mesh.faces, model.faces)
    np.testing.assert_array_equal(mesh.visual.vertex_colors[:, :3], colours)
    stored = mesh.metadata["_ply_raw"]["vertex"]["data"]["error_mm"]
    np.testing.assert_array_equal(np.ravel(stored), error)


def test_ply_of_points(rng, tmp_path):
    points = rng.standard_normal((10, 3))
    write_ply(tmp_path / "points.ply", points)
    np.testing.assert_array_equal(trimesh.load(tmp_path / "points.ply").vertices, points)


def test_obj_is_read_back_bit_for_bit(model, tmp_path):
    write_obj(tmp_path / "mesh.obj", model.template, model.faces, comments=("in metres",))
    mesh = trimesh.load(tmp_path / "mesh.obj", process=False, maintain_order=True)
    np.testing.assert_array_equal(mesh.vertices, model.template)
    np.testing.assert_array_equal(mesh.faces, model.faces)


def test_what_a_file_cannot_hold_is_refused(model, tmp_path):
    path = tmp_path / "mesh.ply"
    vertices, faces = model.template, model.faces
    with pytest.raises(ValueError, match="vertices: hold NaN"):
        write_ply(path, vertices * np.nan, faces)
    with pytest.raises(ValueError, match=r"faces: indices must lie in 0\.\.79"):
        write_obj(path, vertices, faces + 1)
    with pytest.raises(ValueError, match="must be one word"):
        write_ply(path, vertices, faces, properties={"error mm": np.zeros(len(vertices))})
    with pytest.raises(ValueError, match="must be one line"):
        write_ply(path, vertices, faces, comments=("a\nend_header",))
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "file"
    write_bytes(path, b"old")

    def broken(*_):
        raise OSError("disk full")

    monkeypatch.setattr("corporeal.atomic.os.replace", broken)
    with pytest.raises(OSError, match="disk full"):
        write_bytes(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]
