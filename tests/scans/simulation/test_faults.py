"""Faults do what they say, and fall on the same scans each time."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from corporeal.export.meshes import write_ply
from corporeal.scans.simulation.faults import FAULTS, choose_fault, spoil, spoiled_bytes
from corporeal.scans.simulation.scanner import RawCapture


@pytest.fixture
def capture(rng: np.random.Generator) -> RawCapture:
    points = rng.normal(scale=0.05, size=(400, 3))
    faces = rng.permuted(np.tile(np.arange(400), (600, 1)), axis=1)[:, :3]
    return RawCapture(
        points, faces, rng.integers(0, 256, (400, 3)).astype(np.uint8), points.copy(), np.arange(400)
    )


def test_choice_follows_from_name_and_seed_at_the_rate_asked_for() -> None:
    names = [f"s{n:04d}" for n in range(8000)]
    chosen = [choose_fault(name, 3, 40) for name in names]
    assert chosen == [choose_fault(name, 3, 40) for name in names]
    assert chosen != [choose_fault(name, 4, 40) for name in names]
    assert np.mean([fault != "" for fault in chosen]) == pytest.approx(1 / 40, rel=0.25)
    assert set(chosen) == {"", *FAULTS}
    assert choose_fault("s0001", 3, 0) == ""


def test_moved_shifts_a_part_rigidly_by_millimetres(capture: RawCapture, rng: np.random.Generator) -> None:
    moved = spoil(capture, "moved", rng)
    shift = np.linalg.norm(moved.points - capture.points, axis=1)
    late = shift > 0
    assert 0.2 < late.mean() < 0.8
    assert 2e-3 < shift[late].mean() < 40e-3
    before, after = (scan.points[late] - scan.points[late].mean(0) for scan in (capture, moved))
    assert np.allclose(before @ before.T, after @ after.T, atol=1e-12)
    assert (late[moved.faces].all(1) | ~late[moved.faces].any(1)).all()


def test_half_keeps_half_with_its_own_faces(capture: RawCapture, rng: np.random.Generator) -> None:
    half = spoil(capture, "half", rng)
    assert len(half.points) == len(half.colours) == len(half.clean) == 200
    assert half.faces.max() < 200
    rows = {tuple(row) for row in capture.points}
    assert all(tuple(row) in rows for row in half.points)


def test_empty_has_nothing(capture: RawCapture, rng: np.random.Generator) -> None:
    empty = spoil(capture, "empty", rng)
    assert len(empty.points) == len(empty.faces) == len(empty.colours) == 0


def test_nan_spoils_the_coordinates_of_a_file_and_nothing_else(capture: RawCapture, tmp_path: Path) -> None:
    path = tmp_path / "scan.ply"
    write_ply(path, capture.points.astype(np.float32), capture.faces, colours=capture.colours)
    whole = path.read_bytes()
    path.write_bytes(spoiled_bytes(whole, "nan"))
    spoilt = trimesh.load(path, process=False)
    assert np.isnan(spoilt.vertices).all()
    np.testing.assert_array_equal(spoilt.faces, capture.faces)
    np.testing.assert_array_equal(spoilt.visual.vertex_colors[:, :3], capture.colours)


def test_truncated_spoils_bytes_and_nothing_else(capture: RawCapture, rng: np.random.Generator) -> None:
    assert spoil(capture, "truncated", rng) is capture
    assert spoil(capture, "nan", rng) is capture
    assert spoiled_bytes(b"0123456789", "truncated") == b"01234"
    assert spoiled_bytes(b"0123456789", "moved") == b"0123456789"
