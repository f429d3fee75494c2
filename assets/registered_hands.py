"""The registrations of 31 simulated people that a hand is learned from, as one small file; see README.md.

    python assets/registered_hands.py unpack REG            # a folder as corporeal register writes it
    corporeal learn REG -o hand.npz --name hand --start-shape-weight 1
    python assets/registered_hands.py pack REG [--start soft_hand] [--file FILE]

Simulating and registering the session takes hours; its records take 40 MB, this file seven. Vertices are kept
as offsets from the fitted model, rounded to a tenth of a millimetre, and of these the differences to the
vertex before in a walk over the mesh, which are nearly all a few steps. Landmarks, signals and rejected scans
are left out. ``pack`` takes what is accepted in a registered session. Where another model made its
registrations than learning is to start from, one that was learned in an earlier round, ``--start`` lays the
start onto every one of them, vertex by vertex: their poses and shapes are then its own.
"""

from __future__ import annotations

import argparse
import io
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import breadth_first_order

from corporeal.atomic import write_bytes
from corporeal.geometry.topology import unique_edges
from corporeal.learning.evaluation.fit_start import start_on
from corporeal.learning.evaluation.protocols import PoseAndShape
from corporeal.learning.training_set import training_set
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.session.files import (
    MANIFEST,
    read_decisions,
    read_json_file,
    read_records,
    record_path,
    write_record,
)
from corporeal.registration.session.model_digest import model_digest
from corporeal.registration.session.records import SessionRecord

FILE = Path(__file__).with_name("registered_hands.npz")
STEP = 1e-4
"""Metres; half of it is a quarter of a scan's noise."""
_KEPT_OF_ROW = ("name", "status", "side", "subject", "protocol_pose", "scan", "s2m_mm")
_KEPT_OF_MANIFEST = ("format", "model", "round", "versions")


def packed(folder: Path, start: str | None = None) -> bytes:
    """The accepted registrations of a folder as the bytes of an ``.npz``.

    Args:
        folder: that ``corporeal register`` wrote.
        start: model of the box that is laid onto them; None leaves the one that they were made with.
    """
    manifest = read_json_file(folder / MANIFEST) or {}
    models = both_sides(start or manifest["model"]["name"])
    digest = model_digest(models["right"])
    if start is None and digest != manifest["model"]["sha256"]:
        raise SystemExit(f"{folder}: made with a model that is not in the box; give one of it with --start")
    found = read_records(folder)
    accepted = set(training_set(found, models["right"], read_decisions(folder)).names)
    records = [record for record in found if record.name in accepted]
    if start is not None:
        records = [laid(models, record) for record in records]
        manifest["model"] = {"name": start, "side": models["right"].side, "sha256": digest}
    rows = [{key: record.row.get(key) for key in _KEPT_OF_ROW} for record in records]
    for row in rows:
        # What a curator accepted is as good as what the verdict did: decisions do not come along.
        row |= {"scan": Path(row["scan"]).name, "status": "ok"}
    order, before = walk(models["right"])
    offsets = np.stack([record.vertices - posed(models, record) for record in records])
    steps = np.rint(offsets / STEP).astype(np.int32)
    steps[:, order[1:]] -= steps[:, before]
    if np.abs(steps).max() >= 2**15:
        raise SystemExit(f"{folder}: a registration that is far from its model; nothing was written")
    manifest = {key: manifest[key] for key in _KEPT_OF_MANIFEST}
    arrays = {
        "manifest": np.frombuffer(json.dumps(manifest).encode(), np.uint8),
        "rows": np.frombuffer(json.dumps(rows).encode(), np.uint8),
        "steps": byte_planes(steps[:, order].transpose(2, 1, 0)),
        "pose": np.stack([record.pose for record in records]).astype(np.float32),
        "shape": np.stack([record.shape for record in records]).astype(np.float32),
        "translation": np.stack([record.translation for record in records]),
    }  # fmt: skip
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def unpacked(file: Path) -> tuple[dict, Iterator[SessionRecord]]:
    """The manifest and the records of a file."""
    with np.load(file, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    manifest, rows = (json.loads(arrays[name].tobytes()) for name in ("manifest", "rows"))
    models = both_sides(manifest["model"]["name"])
    if model_digest(models["right"]) != manifest["model"]["sha256"]:
        raise SystemExit(f"{file}: made with another {manifest['model']['name']!r} than the box holds")
    order, before = walk(models["right"])
    steps = of_byte_planes(arrays["steps"]).reshape(3, len(order), len(rows)).transpose(2, 1, 0)
    for place, above in enumerate(np.argsort(order)[before], start=1):
        steps[:, place] += steps[:, above]

    def records() -> Iterator[SessionRecord]:
        for number, row in enumerate(rows):
            fitted = SessionRecord(
                row,
                pose=arrays["pose"][number],
                shape=arrays["shape"][number],
                translation=arrays["translation"][number],
                side=row["side"],
            )
            vertices = posed(models, fitted)
            vertices[order] += STEP * steps[number]
            yield replace(fitted, vertices=vertices)

    return manifest, records()


def both_sides(name: str) -> dict[str, SurfaceModel]:
    """The model of the box, of either side."""
    return {"right": open_model(name), "left": open_model(name, side="left")}


def laid(models: dict[str, SurfaceModel], record: SessionRecord) -> SessionRecord:
    """The registration with pose, shape and translation of another model that lies on its vertices."""
    pose, vertices = (np.asarray(array, dtype=np.float64) for array in (record.pose, record.vertices))
    found = start_on(models[record.side], pose, vertices, PoseAndShape())
    return replace(record, pose=found.pose, shape=found.shape, translation=found.translation)


def posed(models: dict[str, SurfaceModel], record: SessionRecord) -> np.ndarray:
    """(V, 3) the fitted model of a record, from its numbers in the precision that is kept."""
    shape, pose = (np.asarray(array, dtype=np.float32) for array in (record.shape, record.pose))
    return evaluate(models[record.side], shape, pose, record.translation).vertices


def walk(model: SurfaceModel) -> tuple[np.ndarray, np.ndarray]:
    """Vertices in the order of a walk over the mesh, and before each but the first a neighbour that came."""
    edges, V = unique_edges(model.faces), model.vertex_count
    graph = sp.coo_matrix((np.ones(len(edges)), edges.T), shape=(V, V)).tocsr()
    order, before = breadth_first_order(graph, 0, directed=False)
    return order, before[order[1:]]


def byte_planes(numbers: np.ndarray) -> np.ndarray:
    """(2, N) low and high bytes of small numbers, their sign in the lowest bit.

    So the high bytes are nearly all zero: with the sign above they made the file a third larger.
    """
    zigzag = np.where(numbers < 0, -2 * numbers - 1, 2 * numbers).astype("<u2").ravel()
    return np.ascontiguousarray(zigzag.view(np.uint8).reshape(-1, 2).T)


def of_byte_planes(planes: np.ndarray) -> np.ndarray:
    """(N,) the numbers."""
    zigzag = np.ascontiguousarray(planes.T).view("<u2").ravel().astype(np.int32)
    return np.where(zigzag % 2 == 1, -(zigzag + 1) // 2, zigzag // 2)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("pack", "unpack"))
    parser.add_argument("folder", type=Path)
    parser.add_argument(
        "--start", help="model of the box; else the one that the registrations were made with"
    )
    parser.add_argument("--file", type=Path, default=FILE)
    asked = parser.parse_args()
    if asked.what == "pack":
        write_bytes(asked.file, packed(asked.folder, asked.start))
        print(f"{asked.file}: {asked.file.stat().st_size / 1e6:.1f} MB")
        return
    manifest, records = unpacked(asked.file)
    count = 0
    for record in records:
        write_record(record_path(asked.folder, record.name), record)
        count += 1
    write_bytes(asked.folder / MANIFEST, json.dumps(manifest, indent=2).encode())
    print(f"{asked.folder}: {count} registrations")


if __name__ == "__main__":
    main()
