"""The open hand in motion with its template and its start: tracked in a fraction of a second a frame."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from corporeal.export.meshes import write_ply
from corporeal.fitting.subject_template import personal_model
from corporeal.model.files import open_model, save_model
from corporeal.model.jacobian import evaluate

FPS = 30.0


def make_sequence(folder: Path, count: int, name: str = "open-hand") -> Path:
    """Writes FOLDER (sequence.json, scans in mm, truth.npz), and beside it template.npz and the start."""
    hand = open_model("hand")
    shape = np.array([0.8, -0.6, 0.4])
    personal = personal_model(hand, hand.template + hand.shape_directions[:, :, :3] @ shape)
    frames, truth = [], []
    for number in range(count):
        pose, place = motion(hand, number)
        truth.append(evaluate(personal, np.zeros(0), pose, place).vertices)
        file = f"scans/{number:04d}.ply"
        write_ply(folder / file, (1e3 * truth[-1]).astype(np.float32), hand.faces)
        frames.append({"name": f"{number:04d}", "file": file})
        if number == 0:
            write_start(folder.parent / "start.npz", hand, personal, pose, place)
    write_start(folder.parent / "body_start.npz", hand, personal, np.zeros((55, 3)), np.zeros(3))
    write_list(folder, name, frames)
    np.save(folder / "truth.npy", np.array(truth))
    save_model(personal, folder.parent / "template.npz")
    return folder


def motion(hand, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Pose and translation of a frame."""
    block = next(block for block in hand.pose_blocks if len(block.components))
    pose = np.zeros((hand.joint_count, 3))
    pose[0] = 0.02 * number, 0.01 * number, 0.0
    turned = block.mean + number * (0.04 * block.components[0] - 0.03 * block.components[1])
    pose[list(block.joints)] = turned.reshape(-1, 3)
    return pose, np.array([0.004 * number, 0.0, 0.002 * number])


def write_list(folder: Path, name: str, frames: list[dict[str, str]]) -> None:
    content = {"format": "corporeal-sequence-1", "name": name, "subject": "s", "fps": FPS, "unit": "mm"}
    (folder / "sequence.json").write_text(json.dumps(content | {"frames": frames}))


def write_start(path: Path, hand, personal, pose, place) -> None:
    """A registration.npz of a frame; nobody looks at its vertices."""
    vertices = personal.template
    np.savez(
        path, vertices=vertices, model_vertices=vertices, faces=hand.faces, pose=pose, shape=np.zeros(0),
        translation=place, side="right", landmark_names=np.array([], dtype=np.str_),
        landmarks=np.zeros((0, 3)), model="hand", correctives=True, status="ok", reason="", unit="mm",
        metres_per_unit=1e-3,
    )  # fmt: skip
