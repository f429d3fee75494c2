"""Makes the embedded demo scan: python assets/demo/build_scan.py [--out DIR]; seeded.

A right hand that the open model does not hold (other mesh, identity, skinning and pose), scanned with noise
and holes, in millimetres, turned at random. ``truth.npz`` beside it holds the surface without noise and
holes: tests read it, registration never does.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from pathlib import Path

import numpy as np
import trimesh
from posed_arm import Arm, posed_arm
from scipy.spatial.transform import Rotation
from virtual_scanner import capture, smooth_surface

from corporeal.export.meshes import write_ply

_SEED = 7
_POINTS, _NOISE = 13_000, 0.25e-3
# Elevations and azimuths of the scanner's stops, degrees: an operator walks round the hand and leaves gaps.
_STOPS = [(20, a) for a in (0, 60, 120, 200, 280)] + [(-35, a) for a in (30, 250)]
_DISTANCE = 0.45
_ARM_SCANNED = 0.09  # metres behind the wrist
# The open model's shapes come from the same phenotypes as this person; a slow relief of its own puts it
# outside that space (model-alone s2m 0.55 mm instead of 0.36): standard deviation and wavelength in metres.
_RELIEF, _RELIEF_WAVE = 0.9e-3, 0.045


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent)
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "corporeal-anny-cache")
    options = parser.parse_args()
    generator = np.random.default_rng(_SEED)
    arm = with_relief(posed_arm(options.cache), generator)
    fine, fine_faces = scanned_part(arm, 3)
    centre = fine.mean(0)
    scan = capture(fine, fine_faces, centre + _stops(), _POINTS, _NOISE, generator)
    R = Rotation.random(random_state=_SEED).as_matrix()
    shift = np.array([120.0, -40.0, 650.0])

    def in_scanner_frame_mm(points: np.ndarray) -> np.ndarray:
        return 1e3 * (points - centre) @ R.T + shift

    points = in_scanner_frame_mm(scan.points)
    colours = skin_colours(scan.clean, generator)
    comment = "corporeal demo scan: simulated right hand, millimetres; from MakeHuman assets (CC0)"
    write_ply(
        options.out / "scan.ply", points.astype(np.float32), scan.faces, colours=colours, comments=(comment,)
    )
    truth, truth_faces = smooth_surface(arm.vertices, arm.faces, 1)
    np.savez_compressed(
        options.out / "truth.npz",
        vertices_mm=in_scanner_frame_mm(truth).astype(np.float32),
        faces=truth_faces.astype(np.uint16),
    )
    print(f"{options.out / 'scan.ply'}: {len(points)} vertices, {len(scan.faces)} faces")


def with_relief(arm: Arm, generator: np.random.Generator) -> Arm:
    """The arm moved along its normals by a sum of slow waves."""
    normals = trimesh.Trimesh(arm.vertices, arm.faces, process=False).vertex_normals
    height = _RELIEF * slow_waves(arm.vertices, _RELIEF_WAVE, generator)
    return dataclasses.replace(arm, vertices=arm.vertices + height[:, None] * normals)


def slow_waves(
    points: np.ndarray, wavelength: float, generator: np.random.Generator, count: int = 24
) -> np.ndarray:
    """(N,) smooth random numbers of about unit variance: plane waves of random direction and phase."""
    directions = generator.normal(size=(count, 3))
    directions *= 2 * np.pi / wavelength / np.linalg.norm(directions, axis=1, keepdims=True)
    phases = generator.uniform(0, 2 * np.pi, count)
    return np.sqrt(2 / count) * np.sin(points @ directions.T + phases).sum(axis=1)


def scanned_part(arm: Arm, times: int) -> tuple[np.ndarray, np.ndarray]:
    """The surface, subdivided so many times, as far as the scanner gets: hand and a part of the forearm."""
    fine, fine_faces = smooth_surface(arm.vertices, arm.faces, times)
    kept = (fine - arm.wrist) @ arm.along > -_ARM_SCANNED
    used, renumbered = np.unique(fine_faces[kept[fine_faces].all(axis=1)], return_inverse=True)
    return fine[used], renumbered.reshape(-1, 3)


def _stops() -> np.ndarray:
    elevation, azimuth = np.deg2rad(np.array(_STOPS, dtype=float)).T
    flat = np.stack([np.cos(azimuth), np.sin(azimuth)]) * np.cos(elevation)
    return _DISTANCE * np.stack([*flat, np.sin(elevation)], axis=1)


def skin_colours(points: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """(N, 3) uint8: a skin tone with slow blotches and sensor noise."""
    blotches = slow_waves(points, 0.05, generator)
    tone = np.array([214.0, 160.0, 134.0])
    colours = (
        tone + blotches[:, None] * np.array([4.0, 7.0, 6.0]) + generator.normal(size=(len(points), 3)) * 3
    )
    return np.clip(np.round(colours), 0, 255).astype(np.uint8)


if __name__ == "__main__":
    main()
