"""Makes recorded_poses.npz: python assets/hand_simulator/recorded.py MOTION_FOLDER

Recorded hand poses (Intel RealSense hand tracking samples, Apache-2.0; the folder holds animbank.pose and
hand_data_example.pose) as anatomical angles, a few hundred that differ most.
"""

from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from open_hand.recorded_poses import carried_over, read_poses, thumb_nail

from corporeal.atomic import write_bytes
from corporeal.model.files import open_model

_ROOT = Path(__file__).resolve().parents[2]
_OUT = _ROOT / "src/corporeal/scans/simulation/recorded_poses.npz"
_KEPT = 400
_SPREAD, _TWIST = 32.0, 50.0


def main() -> None:
    model = open_model("hand")
    joints = np.asarray(model.joint_regressor @ model.template)
    marks = model.landmarks["hand_21_mediapipe"]
    positions = dict(zip(marks.names, marks.positions(model.template, joints), strict=True))
    tips = np.array([positions[name] for name in _tip_names(marks.names)])
    poses = carried_over(read_poses(Path(sys.argv[1])), joints, tips).reshape(-1, 15, 3)
    axes = np.concatenate([_axes(joints[3 * f + 1 : 3 * f + 4], tips[f], thumb=f == 4) for f in range(5)])
    turned = Rotation.from_rotvec(poses.reshape(-1, 3)).as_matrix().reshape(-1, 15, 3, 3)
    own = axes @ turned @ axes.transpose(0, 2, 1)
    angles = Rotation.from_matrix(own.reshape(-1, 3, 3)).as_euler("XYZ", degrees=True).reshape(-1, 15, 3)
    # What the tracker got wrong: joints turned aside or about themselves as none can.
    angles = angles[(np.abs(angles[:, :, 1]) < _SPREAD).all(1) & (np.abs(angles[:, :, 2]) < _TWIST).all(1)]
    kept = _most_different(angles.reshape(len(angles), -1), _KEPT)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, hundredths_of_degree=np.round(100 * angles[kept]).astype(np.int16))
    write_bytes(_OUT, buffer.getvalue())
    low, high = np.percentile(angles[kept], [1, 99], axis=(0, 1))
    print(f"{len(kept)} of {len(angles)} poses, {len(buffer.getvalue()) / 1e3:.0f} kB; 1-99 %: {low} {high}")


def _axes(heads: np.ndarray, tip: np.ndarray, *, thumb: bool) -> np.ndarray:
    """(3, 3, 3) rows flexion, spread and twist axis of a finger's bones at zero pose, as the simulator's."""
    chain = np.vstack([heads, tip])
    back = thumb_nail(chain) if thumb else np.array([0.0, 1, 0])
    axes = []
    for bone in np.diff(chain, axis=0):
        along = bone / np.linalg.norm(bone)
        flexion = np.cross(back, along)
        flexion /= np.linalg.norm(flexion)
        axes.append([flexion, np.cross(along, flexion), along])
    return np.array(axes)


def _tip_names(names: tuple[str, ...]) -> list[str]:
    return [
        next(n for n in names if finger in n and "tip" in n)
        for finger in ("index", "middle", "little", "ring", "thumb")
    ]


def _most_different(rows: np.ndarray, count: int) -> np.ndarray:
    """Farthest-point sampling from the row nearest the mean."""
    chosen = [int(np.linalg.norm(rows - rows.mean(0), axis=1).argmin())]
    distance = np.linalg.norm(rows - rows[chosen[0]], axis=1)
    while len(chosen) < min(count, len(rows)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(rows - rows[chosen[-1]], axis=1))
    return np.sort(chosen)


if __name__ == "__main__":
    main()
