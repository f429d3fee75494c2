"""A hand learned from true surfaces, against the bones below them: what learning does by itself.

No registration stands between: the surfaces of a simulated session are taken as registered, so that a change
of learning is judged in minutes. Printed are R^2 and joint errors as ``corporeal evaluate`` has them, on 40
flexed scans of the same people, and by how much learned poses are off the bones', the mean over people and
scans of every joint taken out.

    python benchmarks/learned_from_truth.py SESSION [--start soft_hand] [--sweeps 3]
    python benchmarks/learned_from_truth.py SESSION --model hand.npz

With ``--model`` nothing is learned: that model meets the session's people, whose templates are fitted to 16
scans each.

SESSION is what ``corporeal simulate SESSION --subjects 6 --sides right --seed 1000 --natural-share 0.3``
wrote.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from corporeal.cli.named_models import named_model
from corporeal.cli.registered_session import read_truth, simulation_of
from corporeal.learning.evaluation.results import TruthResult
from corporeal.learning.evaluation.simulated_truth import (
    TrueScan,
    ZeroPose,
    against_simulation,
    flexed,
    planned_scans,
    true_pose,
    true_template,
)
from corporeal.learning.learn import learn_model
from corporeal.learning.options import LearningOptions
from corporeal.learning.personal import personal_template
from corporeal.learning.training_set import TrainingSet
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.simulation.simulate import SimulationOptions, true_hand

FLEXED, TEMPLATE_SCANS = 40, 16
FLAT = ZeroPose(np.eye(3), np.tile(np.eye(3), (16, 1, 1)))


def true_surfaces(scans: dict[str, TrueScan], options: SimulationOptions) -> TrainingSet:
    """The true surfaces as registrations, at the true poses."""
    templates, rows = {}, []
    for scan in scans.values():
        if scan.hand not in templates:
            hand = true_hand(options, scan.planned.subject, scan.planned.side)
            templates[scan.hand] = true_template(hand, FLAT)
        template = templates[scan.hand]
        true = true_pose(template, scan.truth, template.joints, FLAT)
        rows.append((true.in_model(scan.truth.template), true))
    hands = tuple(scan.hand for scan in scans.values())
    return TrainingSet(
        vertices=np.stack([surface for surface, _ in rows]),
        poses=np.stack([true.pose for _, true in rows]),
        translations=np.stack([true.translation for _, true in rows]),
        shapes=np.zeros((len(rows), 1)),
        hands=hands,
        subjects=tuple(hand.split("/")[0] for hand in hands),
        protocol_poses=("",) * len(rows),
        names=tuple(scans),
    )


def off_degrees(poses: np.ndarray, true_poses: np.ndarray) -> np.ndarray:
    """(K - 1,) mean angles between learned and true turns of every joint, their common turn taken out."""
    angles = []
    for joint in range(1, poses.shape[1]):
        turned = Rotation.from_rotvec(true_poses[:, joint]).inv() * Rotation.from_rotvec(poses[:, joint])
        angles.append(np.rad2deg((turned.mean().inv() * turned).magnitude()).mean())
    return np.array(angles)


def met(model: SurfaceModel, training: TrainingSet) -> dict[str, np.ndarray]:
    """Hand -> its personal template, as the model fits it to some of its surfaces."""
    templates, hands = {}, np.array(training.hands)
    for hand in sorted(set(training.hands)):
        some = training.subset(np.flatnonzero(hands == hand)[:TEMPLATE_SCANS])
        templates[hand] = personal_template(model, some.vertices, some.poses, some.translations).template
    return templates


def line(found: TruthResult) -> str:
    """In words."""
    return (
        f"R^2 {found.r_squared:.3f}  error {found.error.mean:.2f} mm  joints {found.joint_error.mean:.2f} mm"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("session", type=Path)
    parser.add_argument("--start", default="soft_hand")
    parser.add_argument("--sweeps", type=int, default=3)
    parser.add_argument("--model", type=Path, help="judge this one, learn nothing")
    asked = parser.parse_args()
    options = simulation_of(asked.session)
    if options is None:
        raise SystemExit(f"{asked.session}: not a simulated session")
    scans = {}
    for name, (planned, hand) in planned_scans(options).items():
        path = asked.session / "truth" / f"{name}.npz"
        if planned.side == "right" and path.exists():
            truth = read_truth(path)
            if truth.fault in ("", "none"):
                scans[name] = TrueScan(planned, hand, truth)
    training = true_surfaces(scans, options)
    bent = flexed(list(scans.values()), FLEXED)
    if asked.model is not None:
        model = named_model(asked.model)
        print(line(against_simulation("model", model, met(model, training), bent, options)))
        return
    start = named_model(Path(asked.start))
    learned = learn_model(training, start, LearningOptions(sweeps=asked.sweeps))
    templates = dict(zip(learned.hands, learned.templates, strict=True))
    found = against_simulation("learned", learned.model, templates, bent, options)
    whose = dict(zip(training.names, training.poses, strict=True))
    off = off_degrees(np.asarray(learned.poses), np.stack([whose[name] for name in learned.names]))
    for name, angle in zip(start.joint_names[1:], off, strict=True):
        print(f"{name:10s}{angle:6.1f} degrees")
    print(f"{len(learned.names)} scans: {line(found)}  poses {off.mean():.1f} degrees")


if __name__ == "__main__":
    main()
