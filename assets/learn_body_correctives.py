"""Learns the open body's pose correctives from a soft person; see README.md beside this file.

python assets/learn_body_correctives.py [--body FILE] [--cache FOLDER] [--choose]

Template, joints, weights and hands stay as they are. About ten minutes on one free core, nearly all of it the
bends, which ``--cache`` keeps. Run again, it gives the same file.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from open_body.bend_truth import training_bends
from open_body.soft_correctives import STRENGTH, learned_correctives, posed_surfaces
from settled_bends import SettledBends

from corporeal.model.files import load_model, save_model
from corporeal.model.surface_model import SurfaceModel

REPOSITORY = Path(__file__).resolve().parents[1]
BODY = REPOSITORY / "src/corporeal/model/open_models/body.npz"
NOTE = (
    "of the body's joints learned from {} settled bends of a soft body (assets/learn_body_correctives.py); "
    "jaw and eyes: dual-quaternion skinning minus linear blending"
)
_STRENGTHS = (0.0001, 0.0007, 0.005, 0.05)
_HELD = 5


def choose(model: SurfaceModel, bends: SettledBends) -> None:
    """Root mean square distance, by the strength of equation 10, in every fifth bend when it is left out."""
    left_out = np.arange(len(bends.poses)) % _HELD == 0
    test = bends.subset(left_out)
    for strength in _STRENGTHS:
        directions = learned_correctives(model, bends.subset(~left_out), strength)
        apart = np.square(posed_surfaces(model.replace(pose_directions=directions), test) - test.surfaces)
        filled = int((directions[:, :, :189] != 0).sum())
        print(
            f"strength {strength}: {1e3 * np.sqrt(apart.sum(2).mean()):.3f} mm, {filled} numbers", flush=True
        )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--body", type=Path, default=BODY)
    parser.add_argument(
        "--cache", type=Path, default=Path("build/bends"), help="where settled bends are kept"
    )
    parser.add_argument(
        "--choose", action="store_true", help="print how the strength was chosen, write nothing"
    )
    options = parser.parse_args()
    model = load_model(options.body)
    bends = training_bends(model, options.cache / "training.npz")
    if options.choose:
        choose(model, bends)
        return
    directions = learned_correctives(model, bends, STRENGTH)
    notes = dict(model.notes) | {"correctives": NOTE.format(len(bends.poses))}
    save_model(model.replace(pose_directions=directions, notes=notes), options.body, precision="float16")
    filled = float((directions != 0).mean())
    print(f"{options.body}: {options.body.stat().st_size / 1e6:.2f} MB, {filled:.1%} of all numbers not zero")


if __name__ == "__main__":
    main()
