"""Learns the start hand's pose correctives from a soft hand: soft_hand.npz; see README.md beside this file.

python assets/learn_hand_correctives.py [--out FILE] [--choose]

All but the correctives is the start hand's. Two minutes on one free core, nearly all of it the bends. Run
again, it gives the same file.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from open_hand.finger_bends import settled_bends
from open_hand.soft_correctives import STRENGTH, distances_to, learned_correctives
from settled_bends import SettledBends

from corporeal.model.files import open_model, save_model
from corporeal.model.surface_model import SurfaceModel

OUT = Path(__file__).resolve().parents[1] / "src/corporeal/model/open_models/soft_hand.npz"
NOTE = "learned from {} settled bends of a soft body (assets/learn_hand_correctives.py)"
# Bends of the template, then of drawn people.
_TRAINING, _HELD_OUT = (100, 40, 40), (20, 20)
_STRENGTHS = (5.0, 0.5, 0.05, 0.005)


def compare(model: SurfaceModel, training: SettledBends, held_out: SettledBends, strength: float) -> None:
    """Print what held-out bends are off without correctives, with the start hand's and with learned ones."""
    learned = learned_correctives(model, training, strength)
    candidates = {
        "none": np.zeros_like(learned), "start hand": model.pose_directions, "learned": learned,
    }  # fmt: skip
    figures = ", ".join(
        f"{name} {1e3 * distances_to(model.replace(pose_directions=directions), held_out).mean():.2f} mm"
        for name, directions in candidates.items()
    )
    print(f"strength {strength}: held-out bends: {figures}; {(learned != 0).mean():.0%} filled", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=OUT)
    parser.add_argument("--choose", action="store_true", help="compare strengths, write nothing")
    options = parser.parse_args()
    model = open_model("start_hand")
    training, held_out = settled_bends(model, _TRAINING, 5), settled_bends(model, _HELD_OUT, 99)
    if options.choose:
        for strength in _STRENGTHS:
            compare(model, training, held_out, strength)
        return
    compare(model, training, held_out, STRENGTH)
    directions = learned_correctives(model, training, STRENGTH)
    notes = dict(model.notes) | {"correctives": NOTE.format(len(training.poses))}
    save_model(
        model.replace(name="soft_hand", pose_directions=directions, notes=notes), options.out,
        precision="float16",
    )  # fmt: skip
    print(f"{options.out}: {options.out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
