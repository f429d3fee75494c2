"""Settled bends of several people: what correctives are learned from and measured against."""

from __future__ import annotations

import hashlib
import io
from dataclasses import fields
from pathlib import Path

import numpy as np
from settled_bends import SettledBends, people_of

from corporeal.atomic import write_bytes
from corporeal.model.surface_model import SurfaceModel

from .bends import HELD_OUT_BENDS, random_bends, single_bends
from .soft_person import TETRAHEDRA, SoftPerson
from .symmetry import MIRROR


def with_mirror_images(bends: SettledBends, model: SurfaceModel) -> SettledBends:
    """Followed by their mirror images; people are symmetric as the model is."""
    vertices, joints = np.asarray(model.mirror_vertices), np.asarray(model.mirror_joints)
    return SettledBends(
        np.concatenate([bends.surfaces, bends.surfaces[:, vertices] * MIRROR]),
        np.concatenate([bends.poses, bends.poses[:, joints] * [1, -1, -1]]),
        np.tile(bends.people, 2),
        bends.templates,
        np.tile(bends.volume_ratios, 2),
    )


def training_bends(model: SurfaceModel, cache: Path | None = None) -> SettledBends:
    """The template in most bends, two drawn people in others."""
    poses = random_bends(model, 92, seed=1)
    return settled_bends(model, people_of(model, 3, seed=3), poses, np.repeat([0, 1, 2], [64, 14, 14]), cache)


def held_out_bends(model: SurfaceModel, cache: Path | None = None) -> SettledBends:
    """Bends of one joint and drawn ones of the template, then drawn ones of a stranger."""
    drawn = random_bends(model, 18, seed=2)
    poses = np.concatenate([single_bends(), drawn])
    people = np.repeat([0, 1], [len(HELD_OUT_BENDS) + 12, 6])
    return settled_bends(model, people_of(model, 2, seed=4), poses, people, cache)


def settled_bends(
    model: SurfaceModel,
    templates: np.ndarray,
    poses: np.ndarray,
    people: np.ndarray,
    cache: Path | None = None,
) -> SettledBends:
    """Settle every pose (N, 55, 3) of its person (N,); ``cache`` keeps them for the same question again."""
    asked = _digest(model.template, templates, poses, people, *_tetrahedra())
    kept = _read(cache, asked)
    if kept is not None:
        return kept
    surfaces = np.empty((len(poses), *model.template.shape))
    reached, ratios = np.empty_like(poses), np.empty(len(poses))
    for h, template in enumerate(templates):
        person = SoftPerson(model, template)
        for row in np.flatnonzero(people == h):
            settled = person.posed(poses[row])
            surfaces[row], reached[row] = settled.surface, settled.pose
            ratios[row] = settled.flesh.volume_ratio
            print(
                f"person {h}, bend {row}: {settled.flesh.iterations} steps, volume {ratios[row]:.4f}",
                flush=True,
            )
    bends = SettledBends(surfaces, reached, people, templates, ratios)
    if cache is not None:
        buffer = io.BytesIO()
        np.savez(buffer, asked=asked, **vars(bends))
        cache.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(cache, buffer.getvalue())
    return bends


def _read(cache: Path | None, asked: str) -> SettledBends | None:
    if cache is None or not cache.is_file():
        return None
    with np.load(cache) as arrays:
        if str(arrays["asked"]) != asked:
            return None
        return SettledBends(**{field.name: arrays[field.name] for field in fields(SettledBends)})


def _digest(*arrays: np.ndarray) -> str:
    """Of the question; a change of the flesh's own constants is not seen: give another cache then."""
    digest = hashlib.sha256()
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _tetrahedra() -> tuple[np.ndarray, ...]:
    with np.load(TETRAHEDRA) as arrays:
        return arrays["tet_vertices"], arrays["tets"]
