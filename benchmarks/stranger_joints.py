"""Where simulated strangers' joints lie in their skin, against the open body's, and where tracking put them.

    python benchmarks/stranger_joints.py [TRACKED]

Strangers stand in the T-pose; the open body's regressor is laid onto the true places of its vertices.
Columns, in mm and for the left side: how far the simulator's joint lies from there, the mean of the first
four people, as (outwards, up, forwards); and the shifts that each sequence in TRACKED (of ``corporeal
track``) found. Then, as shares of the stature, heights and lengths of both, beside Winter's table
(Biomechanics and Motor Control of Human Movement, after Drillis and Contini).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from corporeal.fitting.files import TEMPLATE, load_subject_template
from corporeal.model.files import open_model
from corporeal.scans.simulation.bodies.files import load_body_simulator
from corporeal.scans.simulation.bodies.motion import BodyMotion
from corporeal.scans.simulation.bodies.people import body_subject
from corporeal.scans.simulation.bodies.person import MovingPerson

PEOPLE, SEED = 4, 0
SHOWN = ("left_hip", "left_knee", "left_ankle", "left_shoulder", "left_elbow", "left_wrist")
WINTER = {"knee height": 0.285, "thigh": 0.245, "shank": 0.246, "upper arm": 0.186, "forearm": 0.146}


def at_rest(number: int) -> tuple[np.ndarray, np.ndarray]:
    """The open template's vertices (V, 3) on a stranger in the T-pose, and the stranger's joints (55, 3)."""
    simulator = load_body_simulator()
    still = BodyMotion(np.zeros((3, 55, 3)), np.zeros((3, 3)))
    posed = MovingPerson(simulator, body_subject(simulator, number, SEED), still).posed(1)
    return simulator.on_template(posed.vertices), posed.joints


def proportions(surface: np.ndarray, joints: dict[str, np.ndarray]) -> dict[str, float]:
    """Heights and lengths as shares of the stature."""
    ground, stature = surface[:, 1].min(), np.ptp(surface[:, 1])
    bones = {
        "thigh": ("left_hip", "left_knee"),
        "shank": ("left_knee", "left_ankle"),
        "upper arm": ("left_shoulder", "left_elbow"),
        "forearm": ("left_elbow", "left_wrist"),
    }
    lengths = {bone: np.linalg.norm(joints[a] - joints[b]) / stature for bone, (a, b) in bones.items()}
    return {"knee height": (joints["left_knee"][1] - ground) / stature, **lengths}


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tracked", type=Path, nargs="?")
    asked = parser.parse_args()
    body = open_model("body")
    people = [at_rest(number) for number in range(PEOPLE)]
    off = np.mean([joints - body.joint_regressor @ surface for surface, joints in people], axis=0)
    columns = {"strangers": off}
    if asked.tracked is not None:
        for folder in sorted(path.parent for path in asked.tracked.glob(f"*/{TEMPLATE}")):
            shifts = load_subject_template(folder).joint_shifts
            columns |= {} if shifts is None else {folder.name[:12]: shifts}
    print(" " * 14 + "".join(f"{name:>16}" for name in columns))
    for name in SHOWN:
        joint = body.joint_names.index(name)
        words = (" ".join(f"{mm:4.0f}" for mm in 1e3 * shift[joint]) for shift in columns.values())
        print(f"{name:14}" + "".join(f"{word:>16}" for word in words))
    print(f"\n{'':14}{'open body':>12}{'strangers':>12}{'Winter':>12}")
    own = proportions(body.template, _named(body.joint_names, body.joint_regressor @ body.template))
    theirs = [proportions(surface, _named(body.joint_names, joints)) for surface, joints in people]
    for part, share in own.items():
        mean = np.mean([found[part] for found in theirs])
        print(f"{part:14}{share:12.3f}{mean:12.3f}{WINTER[part]:12.3f}")


def _named(names: tuple[str, ...], joints: np.ndarray) -> dict[str, np.ndarray]:
    return dict(zip(names, joints, strict=True))


if __name__ == "__main__":
    main()
