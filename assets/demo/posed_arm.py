"""One person's bent right hand with half a forearm, from the MakeHuman mesh: not the mesh of the open model.

Skinned with dual quaternions, where the model blends linearly and adds correctives.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

_PERSON = {"gender": 0.15, "age": 0.75, "muscle": 0.6, "weight": 0.55, "height": 0.42, "proportions": 0.6}
_CHANGES = {
    "r-hand-fingers-diameter-incr": 0.5,
    "r-hand-fingers-length-incr": -0.15,
    "r-hand-scale-incr": 0.05,
    "r-lowerarm-fat-incr": 0.2,
}
# Degrees of flexion of every finger's three joints, from the rig's rest pose; the thumb is finger 1.
_FLEXION = {"2": (6, 12, 8), "3": (14, 18, 10), "4": (18, 22, 12), "5": (14, 18, 10), "1": (4, 8, 14)}
_WRIST = 12.0  # degrees towards the back of the hand
_ARM_KEPT = 0.12  # metres behind the wrist joint


@dataclass(frozen=True, eq=False)
class Arm:
    """Coarse surface of hand and forearm in metres in the source's frame; the forearm does not move.

    Attributes:
        vertices: (V, 3).
        faces: (F, 3), open at the forearm.
        wrist: (3,) the wrist joint.
        along: (3,) unit direction from elbow to wrist.
    """

    vertices: np.ndarray
    faces: np.ndarray
    wrist: np.ndarray
    along: np.ndarray


def posed_arm(cache: Path) -> Arm:
    """The person's bent right hand with the forearm."""
    import anny
    import torch
    from anny.paths import set_anny_cache_path

    set_anny_cache_path(str(cache))
    source = anny.Anny(
        rig="anny", topology="anny", local_changes="all", phenotypes="all",
        pose_parameterization="world", skinning_method="dqs",
    )  # fmt: skip
    person = {
        "phenotype_kwargs": {k: torch.tensor([v], dtype=torch.float64) for k, v in _PERSON.items()},
        "local_changes_kwargs": {k: torch.tensor([v], dtype=torch.float64) for k, v in _CHANGES.items()},
    }
    with torch.no_grad():
        rest = source(**person)
        bones = list(source.bone_labels)
        poses = rest["rest_bone_poses"][0].numpy()
        heads = dict(zip(bones, poses[:, :3, 3], strict=True))
        moved = _moved_bones(bones, list(source.bone_parents), heads) @ poses
        vertices = source(torch.as_tensor(moved)[None], **person)["vertices"][0].numpy()
    faces = source.get_triangular_faces().numpy()
    return _cut(vertices, faces, rest["rest_vertices"][0].numpy(), heads)


def _moved_bones(bones: list[str], parents: list[int], heads: dict[str, np.ndarray]) -> np.ndarray:
    """(B, 4, 4) motion of every bone from the rest pose: own turns chained down the tree."""
    wrist, index, little = (heads[bone] for bone in ("wrist.R", "finger2-1.R", "finger5-1.R"))
    palm = _unit(np.cross(index - wrist, little - wrist))
    own = {"wrist.R": Rotation.from_rotvec(np.deg2rad(-_WRIST) * _unit(np.cross(index - wrist, palm)))}
    for finger, degrees in _FLEXION.items():
        chain = [heads[f"finger{finger}-{k}.R"] for k in (1, 2, 3)]
        # The thumb bends across the palm, the fingers into it.
        pad = _unit(palm + 1.5 * _unit(little - index)) if finger == "1" else palm
        axis = _unit(np.cross(chain[2] - chain[0], pad))
        for k, angle in enumerate(np.deg2rad(degrees)):
            own[f"finger{finger}-{k + 1}.R"] = Rotation.from_rotvec(angle * axis)
    motion = np.tile(np.eye(4), (len(bones), 1, 1))
    for b, (bone, parent) in enumerate(zip(bones, parents, strict=True)):
        if bone in own:
            motion[b, :3, :3] = own[bone].as_matrix()
            motion[b, :3, 3] = heads[bone] - motion[b, :3, :3] @ heads[bone]
        if parent >= 0:
            motion[b] = motion[parent] @ motion[b]
    return motion


def _cut(vertices: np.ndarray, faces: np.ndarray, rest: np.ndarray, heads: dict[str, np.ndarray]) -> Arm:
    """The faces in front of a plane across the forearm and near the wrist; chosen at the rest pose."""
    wrist = heads["wrist.R"]
    along = _unit(wrist - heads["lowerarm01.R"])
    from_wrist = rest - wrist
    kept = (from_wrist @ along > -_ARM_KEPT) & (np.linalg.norm(from_wrist, axis=1) < 0.3)
    kept_faces = faces[kept[faces].all(axis=1)]
    used = np.unique(kept_faces)
    renumbered = np.full(len(vertices), -1)
    renumbered[used] = np.arange(len(used))
    return Arm(vertices[used], renumbered[kept_faces], wrist, along)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)
