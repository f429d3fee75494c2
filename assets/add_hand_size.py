"""Adds to the open body's shape space that hands are larger or smaller than the body tells; see README.md.

python assets/add_hand_size.py [--body FILE] [--sexes FILE]

The identities that the shape space is made of have hands that follow from the body. Real hands do not: hand
length and stature correlate by about 0.7, so that seven tenths of its spread of 5 % (about 193 +- 10 mm in
men) are left when the stature is known. One number is added for both hands, as the eleventh, so that the
first ten mean what they meant. Run again, it gives the same file.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import numpy as np

from corporeal.atomic import write_bytes
from corporeal.model.files import load_model, save_model
from corporeal.model.surface_model import SurfaceModel

MODELS = Path(__file__).resolve().parents[1] / "src/corporeal/model/open_models"
# Of the size of a hand, and where the number stands.
SPREAD, PLACE = 0.037, 10
NOTE = "hand size"
HANDS = {"left_wrist": "left_hand", "right_wrist": "right_hand"}


def with_hand_size(model: SurfaceModel) -> SurfaceModel:
    """The model with a shape direction in which both hands grow about their wrists."""
    directions = model.shape_directions
    if NOTE in model.notes:
        directions = np.delete(directions, PLACE, axis=2)
    directions = np.insert(directions, PLACE, hand_growth(model), axis=2)
    notes = dict(model.notes) | {NOTE: f"shape number {PLACE + 1}: {SPREAD:.1%} of both hands' size"}
    return model.replace(shape_directions=directions, notes=notes)


def hand_growth(model: SurfaceModel) -> np.ndarray:
    """(V, 3) metres: by how much one standard deviation of size moves every vertex; the wrist fades it in."""
    joints = model.joint_regressor @ model.template
    growth = np.zeros_like(model.template)
    for wrist, block in HANDS.items():
        root = model.joint_names.index(wrist)
        carried = model.skinning_weights[:, [root, *model.block(block).joints]].sum(axis=1)
        growth += SPREAD * np.asarray(carried).reshape(-1, 1) * (model.template - joints[root])
    return growth


def with_hand_size_of_sexes(arrays: dict[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    """The sexes in the wider shape space: their hands are of the mean size and of the same spread."""
    wider = {}
    for name, array in arrays.items():
        if len(array) == count:
            wider[name] = array
        elif array.ndim == 1:
            wider[name] = np.insert(array, PLACE, 0.0)
        else:
            square = np.insert(np.insert(array, PLACE, 0.0, axis=0), PLACE, 0.0, axis=1)
            square[PLACE, PLACE] = 1.0
            wider[name] = square
    return wider


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--body", type=Path, default=MODELS / "body.npz")
    parser.add_argument("--sexes", type=Path, default=MODELS / "body_sexes.npz")
    options = parser.parse_args()
    model = with_hand_size(load_model(options.body))
    save_model(model, options.body, precision="float16")
    with np.load(options.sexes) as stored:
        sexes = with_hand_size_of_sexes(dict(stored), model.shape_count)
    content = io.BytesIO()
    np.savez_compressed(content, **sexes)
    write_bytes(options.sexes, content.getvalue())
    print(f"{options.body}: {options.body.stat().st_size / 1e6:.2f} MB, {model.shape_count} shape numbers")


if __name__ == "__main__":
    main()
