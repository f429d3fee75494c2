"""Adds the statistics of recorded body poses to the open body; see README.md beside this file.

python assets/add_body_poses.py [--body FILE] [--motion FOLDER] [--choose]

Run again, it gives the same file: limits are widened from the anatomical ranges every time.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from open_body.body_poses import block_with_statistics, body_poses, log_likelihood
from open_body.limits import body_limits
from open_body.recorded_motion import TEST_CLIPS, Clip, MovedBody, recorded_clips

from corporeal.model.files import load_model, save_model
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel

REPOSITORY = Path(__file__).resolve().parents[1]
BODY = REPOSITORY / "src/corporeal/model/open_models/body.npz"
MOTION = REPOSITORY / "../shared/data/motion/cmu"
NOTES = {
    "body poses": "CMU Graphics Lab Motion Capture Database, subjects 01-03, without clips "
    + ", ".join(TEST_CLIPS),
    "limits": "wide clinical ranges, widened where recorded poses lie beyond; hands those of the open hand",
}
_SHARES = (0.0, 0.02, 0.04, 0.06, 0.08, 0.12, 0.16)


def with_body_poses(model: SurfaceModel, clips: list[Clip], seed: int = 0) -> SurfaceModel:
    """The model with the statistics of the block "body"."""
    blocks = [
        block_with_statistics(_anatomical(block), body_poses(clips, seed), seed)
        if block.name == "body"
        else block
        for block in model.pose_blocks
    ]
    return model.replace(pose_blocks=tuple(blocks), notes=dict(model.notes) | NOTES)


def _anatomical(block: PoseBlock) -> PoseBlock:
    limits = body_limits()[np.array(block.joints) - 1].reshape(-1, 2)
    return PoseBlock(
        block.name, block.joints, block.mean, block.components, block.component_deviations, limits=limits
    )


def report(block: PoseBlock, clips: list[Clip], seed: int) -> None:
    """How likely clips are that the statistics have not seen."""
    poses = body_poses([clip for clip in clips if clip.name in TEST_CLIPS], seed)
    assert block.mixture is not None
    print(f"{len(poses)} held-out poses: {log_likelihood(block.mixture, poses).mean():.1f} nats (mixture)")


def choose(model: SurfaceModel, clips: list[Clip], seed: int) -> None:
    """Log-likelihood of a subject's poses under the other two's, by the widening."""
    plain = _anatomical(model.block("body"))
    for share in _SHARES:
        found = []
        for subject in ("01", "02", "03"):
            others = [clip for clip in clips if not clip.name.startswith(subject)]
            own = [clip for clip in clips if clip.name.startswith(subject)]
            block = block_with_statistics(plain, body_poses(others, seed), seed, share)
            assert block.mixture is not None
            found.append(float(np.mean(log_likelihood(block.mixture, body_poses(own, seed)))))
        print(f"widened by {share:.2f}: {np.mean(found):8.1f} nats a pose; by subject {np.round(found, 1)}")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--body", type=Path, default=BODY)
    parser.add_argument("--motion", type=Path, default=MOTION)
    parser.add_argument(
        "--choose", action="store_true", help="print how the widening was chosen, write nothing"
    )
    options = parser.parse_args()
    model = load_model(options.body)
    joints = model.joint_regressor @ model.template
    clips = recorded_clips(
        options.motion, MovedBody.of_surface(joints, model.template, model.skinning_weights)
    )
    used = [clip for clip in clips if clip.name not in TEST_CLIPS]
    if options.choose:
        choose(model, used, 0)
        return
    model = with_body_poses(model, used)
    report(model.block("body"), clips, 0)
    save_model(model, options.body, precision="float16")
    print(f"{options.body}: {options.body.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
