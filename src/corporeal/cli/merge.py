"""``corporeal merge``: a body model with the articulated hands of a hand model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.console import Console

from corporeal.cli.commands import Merge
from corporeal.cli.errors import CommandError
from corporeal.cli.files import check_result, write_result
from corporeal.cli.info import described
from corporeal.cli.named_models import named_model
from corporeal.model.files import ModelFileError, save_model
from corporeal.model.formats.vertex_lists import read_vertex_lists
from corporeal.model.merging.errors import MergeError
from corporeal.model.merging.merge import Merged, MergeOptions, degrees_of_freedom, merge_hands
from corporeal.model.merging.seam import seam_jump
from corporeal.model.merging.tree import SIDES
from corporeal.model.surface_model import SurfaceModel


def run(config: Merge) -> int:
    """Merge, write the model, and say where the hands lie and what the seam does.

    Raises:
        CommandError: a file cannot be read or written, or the models do not fit together.
    """
    _check_call(config)
    console = Console(stderr=True)
    body, hand = _model(config.body), _model(config.hand)
    other = None if config.other_hand is None else _model(config.other_hand)
    options = MergeOptions(
        hand_components=None if config.hand_pose == "full" else config.hand_components,
        most_joints=config.most_joints,
        seam_width=1e-3 * config.seam_width,
    )
    try:
        vertices = None if config.vertices is None else read_vertex_lists(config.vertices)
        merged = merge_hands(body, hand, other, vertices, options)
        model = merged.model.replace(name=config.name or f"{body.name}_with_hands")
        save_model(model, config.output, layout=config.layout, precision=config.precision)
    except (MergeError, ModelFileError) as error:
        raise CommandError(f"merge: {error}") from error
    jump = 1e3 * seam_jump(body, model, merged.seam, poses=config.seam_poses)
    for line in _summary(merged, config.output, jump):
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    if config.json is not None:
        write_result(config.json, _content(config, merged, model, jump))
    return 0


def _summary(merged: Merged, output: Path, jump: float) -> list[str]:
    lines = [
        f"{side} hand: {len(placement.vertices)} vertices ({placement.method}), templates at most "
        f"{1e3 * placement.largest:.2f} mm apart"
        for side, placement in merged.placements.items()
    ]
    return [
        *lines,
        f"seam: the displacement jumps by at most {jump:.2f} mm across {len(merged.seam)} edges",
        f"{output}: {merged.model.joint_count} joints, {degrees_of_freedom(merged.model)} degrees of freedom",
    ]


def _content(config: Merge, merged: Merged, model: SurfaceModel, jump: float) -> dict:
    return {
        "output": str(config.output),
        "model": described(model),
        "degrees_of_freedom": degrees_of_freedom(model),
        "hands": {
            side: {
                "vertices": len(merged.placements[side].vertices),
                "method": merged.placements[side].method,
                "largest_mm": 1e3 * merged.placements[side].largest,
            }
            for side in SIDES
        },
        "seam": {"edges": len(merged.seam), "poses": config.seam_poses, "largest_jump_mm": jump},
    }


def _model(path: Path) -> SurfaceModel:
    try:
        return named_model(path)
    except ModelFileError as error:
        raise CommandError(f"merge: {error}", 2) from error


def _check_call(config: Merge) -> None:
    if config.output.suffix not in (".npz", ".pkl"):
        raise CommandError(f"merge: -o {config.output}: name a file that ends in .npz or .pkl", 2)
    for source in (config.body, config.hand, config.other_hand):
        if source is not None and source.resolve() == config.output.resolve():
            raise CommandError(f"merge: {config.output} is a source itself; name another file", 2)
    if config.hand_components < 1:
        raise CommandError(f"--hand-components {config.hand_components}: expected 1 or more", 2)
    if config.most_joints is not None and config.most_joints < 1:
        raise CommandError(f"--most-joints {config.most_joints}: expected 1 or more", 2)
    if not (np.isfinite(config.seam_width) and config.seam_width >= 0):
        raise CommandError(f"--seam-width {config.seam_width}: expected millimetres, 0 or more", 2)
    if config.seam_poses < 1:
        raise CommandError(f"--seam-poses {config.seam_poses}: expected 1 or more", 2)
    if config.json is not None:
        check_result(config.json)
