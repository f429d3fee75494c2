"""Two forearms with the open hand's mesh at their ends, hung on the tree of SMPL+H."""

from __future__ import annotations

import importlib.util
import itertools
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import scipy.sparse as sp

from corporeal.geometry.topology import boundary_loops, vertex_adjacency
from corporeal.model.files import open_model
from corporeal.model.formats.families import FAMILIES
from corporeal.model.mirror import swap_sides
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel

RINGS, STEP = 8, 0.015
WRIST = np.array([-0.6, 0.3, 0.0])
SMPLH = next(family for family in FAMILIES if family.name == "smplh")


def _forearm(hand: SurfaceModel) -> tuple[np.ndarray, np.ndarray]:
    """The hand's template and faces, with rings of vertices behind its open end and a fan that closes it."""
    loop = boundary_loops(hand.faces)[0]
    L, V = len(loop), hand.vertex_count
    rings = [hand.template[loop] + [STEP * (ring + 1), 0, 0] for ring in range(RINGS)]
    vertices = np.concatenate([hand.template, *rings, rings[-1].mean(axis=0)[None]])
    starts = [loop, *(V + L * ring + np.arange(L) for ring in range(RINGS))]
    faces = [hand.faces]
    for inner, outer in itertools.pairwise(starts):
        after, beyond = np.roll(inner, -1), np.roll(outer, -1)
        faces += [np.stack([after, inner, outer], axis=1), np.stack([after, outer, beyond], axis=1)]
    last = starts[-1]
    faces.append(np.stack([np.roll(last, -1), last, np.full(L, len(vertices) - 1)], axis=1))
    return vertices, np.concatenate(faces)


def _weights(hand: SurfaceModel, vertices: np.ndarray, side: str) -> np.ndarray:
    """The hand's own, blurred by one ring, its root shared between wrist and elbow along the arm."""
    V, names = hand.vertex_count, SMPLH.joint_names
    near = vertex_adjacency(hand.faces, V) + sp.identity(V)
    blurred = np.asarray((near @ hand.skinning_weights) / near.sum(axis=1))
    share = np.clip(vertices[:, 0] / 0.04, 0, 1)
    weights = np.zeros((len(vertices), len(names)))
    root = np.concatenate([blurred[:, 0], np.ones(len(vertices) - V)])
    weights[:, names.index(f"{side}_elbow")] = root * share
    weights[:, names.index(f"{side}_wrist")] = root * (1 - share)
    for k in range(1, hand.joint_count):
        weights[:V, names.index(f"{side}_{hand.joint_names[k]}")] = blurred[:, k]
    return weights


def _regressor(hand: SurfaceModel, count: int) -> sp.csr_matrix:
    names, rows = SMPLH.joint_names, sp.lil_matrix((len(SMPLH.joint_names), 2 * count))
    own = hand.joint_regressor.tolil()
    for number, side in enumerate(("right", "left")):
        for k, name in enumerate(("wrist", *hand.joint_names[1:])):
            joint = names.index(f"{side}_{name}")
            rows[joint, number * count : number * count + hand.vertex_count] = own[k]
        rows[names.index(f"{side}_elbow"), number * count + count - 1] = 1
    for joint, name in enumerate(names):
        if not rows[joint].nnz:
            rows[joint, count - 1] = 0.5 + 0.1 * (name.startswith("right") - name.startswith("left"))
            rows[joint, 2 * count - 1] = 1 - rows[joint, count - 1]
    return rows.tocsr()


def _arms(hand: SurfaceModel) -> SurfaceModel:
    vertices, faces = _forearm(hand)
    n, names = len(vertices), SMPLH.joint_names
    right, left = vertices + WRIST, (vertices + WRIST) * [-1, 1, 1]
    weights = np.concatenate([_weights(hand, vertices, side) for side in ("right", "left")])
    directions = np.zeros((2 * n, 3, 2))
    directions[:, :, 0] = 0.05 * np.concatenate([right, left])
    directions[:, :, 1] = [0, 0.01, 0]
    blocks = [PoseBlock.plain(block.name, block.joints) for block in SMPLH.blocks]
    return SurfaceModel(
        name="arms",
        template=np.concatenate([right, left]),
        faces=np.concatenate([faces, n + faces[:, ::-1]]),
        shape_directions=directions,
        joint_regressor=_regressor(hand, n),
        skinning_weights=weights,
        parents=np.array(SMPLH.parents),
        joint_names=names,
        expression_directions=np.zeros((2 * n, 3, 0)),
        pose_directions=np.zeros((2 * n, 3, 0)),
        pose_blocks=tuple(blocks),
        mirror_vertices=np.concatenate([n + np.arange(n), np.arange(n)]),
        mirror_joints=np.array([names.index(swap_sides(name)) for name in names]),
    )


@pytest.fixture(scope="session")
def hand() -> SurfaceModel:
    return open_model("hand")


@pytest.fixture(scope="session")
def arms(hand: SurfaceModel) -> SurfaceModel:
    return _arms(hand)


@pytest.fixture(scope="session")
def official() -> ModuleType:
    """The module ``official_layouts`` of the folder above."""
    path = Path(__file__).parents[1] / "official_layouts.py"
    spec = importlib.util.spec_from_file_location("official_layouts_of_merging", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
