"""Where a learned hand's joints are wrong, and what that costs: joint by joint, and R^2 with the true ones.

True poses and templates are given, as in ``corporeal evaluate``. A row per joint: distance of the regressed
centre from the simulated bone's and its part along the bone, mm, means over hands. Then R^2 and errors of the
surface with the model's joints and with the true ones in their place; weights and correctives, which were
learned around the model's, stay.

    python benchmarks/joint_errors.py hand.npz REG [--hands 6] [--scans 40]

``hand.npz`` needs ``hand.learning.npz`` beside it; REG are registrations that it was learned from.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from corporeal.cli.registered_session import read_registered, true_scans
from corporeal.fitting.joint_places import with_shifted_joints
from corporeal.learning.evaluation.simulated_truth import (
    flexed,
    surfaces_at_true_poses,
    true_template,
    zero_pose,
)
from corporeal.learning.evaluation.truth import compare_with_truth
from corporeal.learning.files import load_learned
from corporeal.learning.personal import personal_model
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.simulation.simulate import true_hand


def bones(model: SurfaceModel, joints: np.ndarray) -> np.ndarray:
    """(K, 3) unit directions from every joint to its only child, or from its parent."""
    ends = []
    for joint, parent in enumerate(model.parents):
        children = np.flatnonzero(model.parents == joint)
        far = joints[children[0]] if len(children) else 2 * joints[joint] - joints[parent]
        ends.append(far - joints[joint])
    directions = np.stack(ends)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("model", type=Path)
    parser.add_argument("registrations", type=Path)
    parser.add_argument("--hands", type=int, default=6)
    parser.add_argument("--scans", type=int, default=40)
    asked = parser.parse_args()
    learned = load_learned(asked.model)
    model, templates = learned.model, dict(zip(learned.hands, learned.templates, strict=True))
    session = read_registered(asked.registrations, model)
    if session.simulation is None:
        raise SystemExit(f"{asked.registrations}: not of a simulated session, so that nothing is known")
    right = [hand for hand in sorted(templates) if hand.endswith("right")]
    scans = flexed(
        true_scans(session, right[:: max(1, len(right) // asked.hands)][: asked.hands]), asked.scans
    )
    zero = zero_pose(model, templates, scans, session.simulation)
    errors, own, exact = [], [], []
    for hand in sorted({scan.hand for scan in scans}):
        some = [scan for scan in scans if scan.hand == hand]
        who = true_hand(session.simulation, some[0].planned.subject, some[0].planned.side)
        template = true_template(who, zero)
        personal = personal_model(model, template.vertices)
        off = np.asarray(personal.joint_regressor @ personal.template) - template.joints
        along = np.einsum("ka,ka->k", off, bones(model, template.joints))
        errors.append(np.stack([np.linalg.norm(off, axis=1), along], axis=1))
        own += surfaces_at_true_poses(personal, template, some, zero)
        exact += surfaces_at_true_poses(with_shifted_joints(personal, -off), template, some, zero)
    for name, (distance, along) in zip(model.joint_names, 1e3 * np.mean(errors, axis=0), strict=True):
        print(f"{name:10s}{distance:6.1f}{along:+7.1f}")
    print(f"{'mean':10s}{1e3 * np.mean(errors, axis=(0, 1))[0]:6.2f}")
    for label, found in (("its joints", own), ("true joints", exact)):
        with_them, without, truth = (np.stack(arrays) for arrays in zip(*found, strict=True))
        result = compare_with_truth(label, with_them, without, truth)
        print(f"{label:14s}R^2 {result.r_squared:.3f}  error {result.error.mean:.2f} mm")


if __name__ == "__main__":
    main()
