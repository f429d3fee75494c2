"""Fills the open body's template with tetrahedra, for its soft simulation; see README.md beside this file.

python assets/tetrahedralise_body.py [--out FILE]

fTetWild does not promise the same numbers on every machine: the result is kept in the repository, and has
to be made again only when the template changes.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import numpy as np
from hand_simulator.tetrahedra import meshed
from open_body.soft_person import TETRAHEDRA, template_digest
from scipy.spatial import cKDTree

from corporeal.atomic import write_bytes
from corporeal.model.files import open_model
from corporeal.model.surface_model import SurfaceModel

# Lengths of edges, metres: fine in the limbs, where joints are thin; coarse in what is rigid or thick.
_ARM, _LEG, _TRUNK, _RIGID, _OUTSIDE = 0.014, 0.018, 0.024, 0.03, 0.12
_ENVELOPE = 2e-3
# Fingers, toes and face are rigid: their detail is drawn together in cells of this size, metres.
_CELL = 0.014
_ARMS, _RIGID_PARTS = ("upper_arm", "forearm"), ("head", "left_hand", "right_hand")
_LEGS, _DETAILED = ("calf", "foot"), (*_RIGID_PARTS, "left_foot", "right_foot")


def coarse_surface(model: SurfaceModel) -> tuple[np.ndarray, np.ndarray]:
    """The template with vertices of detailed parts that share a cell drawn together."""
    template = model.template
    detailed = np.zeros(len(template), dtype=bool)
    for name in _DETAILED:
        detailed[model.parts[name]] = True
    own = np.where(detailed, -1, np.arange(len(template)))
    cells = np.where(detailed[:, None], np.floor(template / _CELL).astype(int), 0)
    _, number = np.unique(np.column_stack([cells, own]), axis=0, return_inverse=True)
    number = number.ravel()
    count = np.bincount(number)
    vertices = np.stack([np.bincount(number, template[:, a]) / count for a in range(3)], axis=1)
    faces = number[model.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    return vertices, faces[np.sort(first)]


def edge_lengths(model: SurfaceModel) -> tuple[np.ndarray, np.ndarray]:
    """A grid (n, 3) round the body, and the length of edges wanted at its corners."""
    low, high = model.template.min(0) - 0.15, model.template.max(0) + 0.15
    counts = np.ceil((high - low) / 0.06).astype(int) + 1
    axes = [np.linspace(low[a], high[a], counts[a]) for a in range(3)]
    corners = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    wanted = np.full(model.vertex_count, _TRUNK)
    for name, part in model.parts.items():
        _, _, rest = name.partition("_")
        for names, length in ((_ARMS, _ARM), (_LEGS, _LEG)):
            if rest in names:
                wanted[part] = length
        if name in _RIGID_PARTS:
            wanted[part] = _RIGID
    distance, nearest = cKDTree(model.template).query(corners)
    return corners, np.where(distance < 0.06, wanted[nearest], _OUTSIDE)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=TETRAHEDRA)
    options = parser.parse_args()
    model = open_model("body")
    vertices, tets = meshed(*coarse_surface(model), *edge_lengths(model), _ENVELOPE)
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer, tet_vertices=vertices, tets=tets, template_sha256=np.array(template_digest(model))
    )
    write_bytes(options.out, buffer.getvalue())
    print(f"{options.out}: {len(buffer.getvalue()) / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
