"""Whole people from file to registration with no landmarks given: simulated ones, whose truth is known.

    python benchmarks/body_registration.py [--people 8] [--out DIR] [--json FILE] [--only a-pose | free]

Every person is registered twice, from an A-pose and from a frame of recorded motion, by the command line
(``corporeal register --model body``), turned at random about the vertical; every second one lies z up, in
millimetres, the others y up, in metres. The people are the body simulator's: another mesh, other skinning and
other identities than the model's. A scan is what 14 cameras see of the skin, with noise along the normals
(0.8 mm, neighbours alike) and three patches of 10 cm lost. Distances in millimetres, times in seconds. v2v:
registration to the true places of the model's vertices, without the eyeballs; ``hands`` and ``rest`` are its
parts on the hands and elsewhere, ``model`` (behind it) is that of the fitted model without free vertices.
``--out DIR`` keeps all results, pictures included.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.sparse as sp
import trimesh

from corporeal.geometry.cameras import Pinhole
from corporeal.geometry.normals import vertex_normals
from corporeal.geometry.rasteriser import rasterise
from corporeal.model.files import open_model
from corporeal.scans.simulation.bodies.files import BodySimulator, load_body_simulator
from corporeal.scans.simulation.bodies.motion import BodyMotion, body_motion
from corporeal.scans.simulation.bodies.people import body_subject
from corporeal.scans.simulation.bodies.person import MovingPerson

NOISE, LEAST_COSINE = 0.8e-3, 0.25
LOST_PATCHES, PATCH = 3, 0.05
CAMERAS, PIXELS, DISTANCE, SHADOW = 14, 1600, 2.6, 6e-3
FEWEST_PIECE = 50
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


@dataclass(frozen=True, eq=False)
class Capture:
    """A scan in metres, y up, and where the model's vertices truly are."""

    points: np.ndarray
    faces: np.ndarray
    truth: np.ndarray


def motion_of(simulator: BodySimulator, kind: str, number: int) -> BodyMotion:
    """An A-pose, or a second of a recorded clip, fingers as recorded; the middle frame is scanned."""
    generator = np.random.default_rng([7, number])
    clip = simulator.clips[number % len(simulator.clips)]
    motion = body_motion(simulator, clip, 61, generator)
    if kind == "free":
        return motion
    pose = motion.pose[30:31].copy()
    pose[:, :22] = generator.normal(scale=0.04, size=(1, 22, 3))
    pose[:, 0] = 0, generator.uniform(0, 2 * np.pi), 0
    for joint, sign in ((16, -1.0), (17, 1.0)):
        pose[:, joint, 2] += 0.8 * sign
    return BodyMotion(pose, np.zeros((1, 3)))


def captured(simulator: BodySimulator, kind: str, number: int) -> Capture:
    """Person of a number in an A-pose or a free one."""
    motion = motion_of(simulator, kind, number)
    person = MovingPerson(simulator, body_subject(simulator, number, seed=5), motion)
    skin = person.posed(len(motion.pose) // 2).vertices
    points, faces = trimesh.remesh.subdivide(skin, simulator.faces)
    normals = vertex_normals(points, faces)
    generator = np.random.default_rng([8, number])
    seen = _seen(points, faces, normals)
    lost = points[generator.choice(np.flatnonzero(seen), size=LOST_PATCHES)]
    seen &= np.linalg.norm(points[:, None] - lost, axis=2).min(1) > PATCH
    noisy = points + _noise(faces, len(points), generator)[:, None] * normals
    own = faces[seen[faces].all(1)]
    pieces = trimesh.graph.connected_component_labels(trimesh.graph.face_adjacency(own), node_count=len(own))
    own = own[np.bincount(pieces)[pieces] >= FEWEST_PIECE]
    used, own = np.unique(own, return_inverse=True)
    return Capture(noisy[used], own.reshape(-1, 3), simulator.on_template(skin))


def _seen(points: np.ndarray, faces: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """What a ring of cameras at two heights sees, not too obliquely: no soles, little of armpits."""
    centre, seen = (points.min(0) + points.max(0)) / 2, np.zeros(len(points), dtype=bool)
    for camera in range(CAMERAS):
        angle, high = 2 * np.pi * camera / CAMERAS, (0.8, -0.5)[camera % 2]
        eye = centre + DISTANCE * np.array([np.cos(angle), 0, np.sin(angle)]) + [0, high, 0]
        view = Pinhole.look_at(eye, centre, np.array([0, 1.0, 0]), np.deg2rad(55.0), (PIXELS, PIXELS))
        pixels, depth = view.project(points)
        inside = np.clip(np.floor(pixels).astype(int), 0, PIXELS - 1)
        nearest = rasterise(points, faces, view).depth[inside[:, 1], inside[:, 0]]
        away = eye - points
        cosine = np.einsum("na,na->n", normals, away) / np.linalg.norm(away, axis=1)
        seen |= (depth < nearest + SHADOW) & (cosine > LEAST_COSINE)
    return seen


def _noise(faces: np.ndarray, count: int, generator: np.random.Generator) -> np.ndarray:
    """Metres; neighbours alike, as stereo makes it."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    links = sp.csr_matrix((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
    white = generator.normal(size=count)
    noise = white + links @ white / np.sqrt(np.maximum(np.asarray(links.sum(1)).ravel(), 1))
    return NOISE * noise / noise.std()


def registered(capture: Capture, name: str, folder: Path, *, z_up: bool) -> dict:
    """Write one scan, register it by the command line, and measure."""
    turn, scale = (Z_UP, 1e3) if z_up else (np.eye(3), 1.0)
    scan, result = folder / f"{name}.ply", folder / f"{name}.json"
    trimesh.Trimesh(scale * capture.points @ turn.T, capture.faces, process=False).export(scan)
    command = [sys.executable, "-m", "corporeal.cli.main", "register", "--model", "body", str(scan)]
    begun = time.perf_counter()
    run = subprocess.run(
        [*command, "-o", str(folder), "--json", str(result)], capture_output=True, text=True, check=False
    )
    wall = time.perf_counter() - begun
    if not result.exists():
        return {"name": name, "status": "crashed", "reason": run.stderr[-300:], "wall": wall}
    row = json.loads(result.read_text())["items"][0] | {"name": name, "wall": wall}
    if row["s2m_mm"] is not None:
        with np.load(folder / name / "registration.npz") as stored:
            row["v2v_mm"] = errors_mm(stored["vertices"], stored["model_vertices"], capture.truth @ turn.T)
    return row


def errors_mm(vertices: np.ndarray, fitted: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Mean distances of the model's vertices from their true places, by part of the body."""
    body, placed = open_model("body"), load_body_simulator().template_placed
    hands = np.zeros(len(truth), dtype=bool)
    for side in ("left", "right"):
        hands[body.parts[f"{side}_hand"]] = True
    off, off_fitted = (1e3 * np.linalg.norm(found - truth, axis=1) for found in (vertices, fitted))
    return {
        "all": float(off[placed].mean()),
        "model": float(off_fitted[placed].mean()),
        "p95": float(np.percentile(off[placed], 95)),
        "rest": float(off[placed & ~hands].mean()),
        "hands": float(off[placed & hands].mean()),
    }


def line(row: dict) -> str:
    """One row of the table."""
    if "v2v_mm" not in row:
        return f"{row['name']:12} {row['status']:9} {row['reason']}"
    v2v, seconds = row["v2v_mm"], row["seconds"]
    return (
        f"{row['name']:12} {row['status']:9} {row['s2m_mm']['mean']:6.2f} {row['model_s2m_mm']['mean']:7.2f} "
        f"{v2v['all']:7.1f} {v2v['p95']:6.1f} {v2v['rest']:7.1f} {v2v['hands']:6.1f} {v2v['model']:7.1f} "
        f"{seconds['landmarks']:7.1f} {seconds['fit']:6.1f}  {row['reason'] if row['status'] != 'ok' else ''}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--people", type=int, default=8)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--only", choices=("a-pose", "free"))
    options = parser.parse_args()
    rows, simulator = [], load_body_simulator()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.out or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        print("scan         status       s2m   model     v2v    p95    rest  hands   model  landm.    fit")
        for kind in ("a-pose", "free") if options.only is None else (options.only,):
            for number in range(options.people):
                capture = captured(simulator, kind, number)
                rows.append(registered(capture, f"{kind}-{number}", folder, z_up=number % 2 == 1))
                print(line(rows[-1]), flush=True)
    measured = [row for row in rows if "v2v_mm" in row]
    for kind in ("a-pose", "free"):
        own = [row for row in measured if row["name"].startswith(kind)]
        if own:
            v2v = np.array([row["v2v_mm"]["all"] for row in own])
            print(
                f"{kind}: {len(own)} registered, v2v mean {v2v.mean():.1f}, median {np.median(v2v):.1f}, "
                f"largest {v2v.max():.1f}; s2m {np.mean([r['s2m_mm']['mean'] for r in own]):.2f}; "
                f"{np.mean([r['seconds']['total'] for r in own]):.1f} s"
            )
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
