"""What learned correctives do for the open body's bends, against the soft person and bends not learned from.

    PYTHONPATH=assets python benchmarks/body_correctives.py [--model FILE] [--cache FOLDER] [--pictures FILE]

For every bend of one joint: the mean distance of a vertex near the joint from the settled flesh, the area of
the cross-section in the plane that halves the bend against that at rest (a joint that collapses has less than
1), and the volume of the whole body against rest. Compared are the flesh itself, linear skinning without
correctives, with those the body had before (dual quaternions), and with the model's own.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from open_body.bend_truth import held_out_bends
from open_body.bends import HELD_OUT_BENDS
from open_body.correctives import body_correctives
from open_body.rig import JOINT_NAMES
from open_body.soft_correctives import posed_surfaces
from open_body.soft_person import bone_motions
from settled_bends import SettledBends

from corporeal.cli.named_models import named_model
from corporeal.export.sheets import (
    Layout,
    Tile,
    View,
    blank_sheet,
    put_tile,
    sheet_camera,
    sheet_pixels,
    write_sheet,
)
from corporeal.geometry.topology import signed_volume
from corporeal.model.surface_model import SurfaceModel

_NEAR = 0.2
_CHILD = {"elbow": "wrist", "knee": "ankle", "hip": "knee", "shoulder": "elbow"}
_INWARD = np.array([1.0, 0.0, 0.0])
_BELOW_SHOULDER = 0.08
# Bends that are drawn, the direction in which they are looked at, the joints whose skin fills the tile.
_DRAWN = {
    ("right_elbow", "y", 130): ((0.2, -0.9, -0.4), (17, 19)),
    ("right_knee", "x", 125): ((0.95, 0.0, -0.3), (2, 5)),
    ("right_hip", "x", -105): ((0.8, -0.2, -0.6), (0, 2)),
    ("right_shoulder", "z", 80): ((0.0, -0.1, -1.0), (14, 17)),
    ("right_shoulder", "z", -80): ((0.0, -0.1, -1.0), (14, 17)),
    ("right_shoulder", "y", 90): ((0.0, -0.5, -0.9), (14, 17)),
}  # fmt: skip


def variants(model: SurfaceModel) -> dict[str, SurfaceModel]:
    """The same body without correctives, with the earlier ones, and with its own."""
    hand, weights = np.zeros((0, 3, 135)), np.asarray(model.skinning_weights)
    earlier = body_correctives(
        model.template, np.asarray(model.joint_regressor @ model.template), weights,
        model.faces, np.asarray(model.mirror_vertices), hand, np.zeros(0, dtype=int), 0,
    )  # fmt: skip
    return {
        "none": model.replace(pose_directions=np.zeros_like(model.pose_directions)),
        "earlier": model.replace(pose_directions=earlier),
        "learned": model,
    }


def section_area(
    vertices: np.ndarray, faces: np.ndarray, point: np.ndarray, normal: np.ndarray, origin: np.ndarray,
    inward: np.ndarray,
) -> float:  # fmt: skip
    """Area that a plane cuts out of a closed surface on one side of a line in the plane, square metres.

    Args:
        vertices: metres.
        faces: closed.
        point: of the plane.
        normal: of the plane.
        origin: of the line, in the plane.
        inward: towards the side that counts, across the line.
    """
    height = (vertices - point) @ normal
    cut = faces[(height[faces].min(1) < 0) & (height[faces].max(1) >= 0)]
    ends = []
    for a, b in ((0, 1), (1, 2), (2, 0)):
        h, g = height[cut[:, a]], height[cut[:, b]]
        crossing = (h < 0) != (g < 0)
        share = np.where(crossing, h / np.where(crossing, h - g, 1), np.nan)[:, None]
        # Upward crossings begin a piece, downward ones end it: all pieces run round the solid the same way.
        ends.append(np.where((h < 0)[:, None], 1, -1) * np.where(crossing, 1, 0)[:, None])
        ends.append(vertices[cut[:, a]] + share * (vertices[cut[:, b]] - vertices[cut[:, a]]))
    start, stop = (
        sum(np.where(ends[2 * k] == sign, ends[2 * k + 1], 0) for k in range(3)) - origin for sign in (1, -1)
    )
    inside = [piece @ inward for piece in (start, stop)]
    kept = (inside[0] > 0) | (inside[1] > 0)
    start, stop = start[kept], stop[kept]
    one, two = inside[0][kept], inside[1][kept]
    crossed = start + np.where(one == two, 0, one / np.where(one == two, 1, one - two))[:, None] * (
        stop - start
    )
    start, stop = np.where((one < 0)[:, None], crossed, start), np.where((two < 0)[:, None], crossed, stop)
    return abs(float((np.cross(start, stop) @ normal).sum() / 2))


def joint_section(model: SurfaceModel, surface: np.ndarray, pose: np.ndarray, joint: str) -> float:
    """Area in the plane that halves the angle between the bones that meet in a right-hand joint."""
    joints = np.asarray(model.joint_regressor @ model.template)
    motions = bone_motions(joints, np.asarray(model.parents), pose)
    index = JOINT_NAMES.index(joint)
    parent = int(model.parents[index])
    child = JOINT_NAMES.index("right_" + _CHILD[joint.removeprefix("right_")])
    before = joints[index] - joints[parent]
    if joint == "right_hip":
        before = np.array([0.0, -1.0, 0.0])
    after = motions[index, :3, :3] @ (joints[child] - joints[index])
    before = motions[parent, :3, :3] @ before
    normal = before / np.linalg.norm(before) + after / np.linalg.norm(after)
    normal /= np.linalg.norm(normal)
    point = motions[index, :3, :3] @ joints[index] + motions[index, :3, 3]
    if joint == "right_shoulder":
        across = np.cross(normal, [0.0, 0.0, 1.0])
        across *= np.sign(across[1])
        return section_area(surface, model.faces, point, normal, point - _BELOW_SHOULDER * across, across)
    # Up to the body's middle: the point of the plane nearest to the joint there.
    in_plane = -_INWARD + (_INWARD @ normal) * normal
    origin = point + (point[0] / max(-in_plane[0], 1e-9)) * in_plane
    return section_area(surface, model.faces, point, normal, origin, in_plane)


def print_bends(models: dict[str, SurfaceModel], bends: SettledBends) -> None:
    """One row for every bend of one joint."""
    model = models["learned"]
    names = ("flesh", *models)
    posed = {name: posed_surfaces(own, bends) for name, own in models.items()} | {"flesh": bends.surfaces}
    joints = np.asarray(model.joint_regressor @ model.template)
    volume = signed_volume(model.template, model.faces)
    print(f"{'':24s} {'distance, mm':^26s} {'section / rest':^35s} {'volume / rest':^35s}")
    print(f"{'':24s} " + "".join(f"{n:>9s}" for n in (*models, *names, *names)))
    for row, (joint, axis, degrees) in enumerate(HELD_OUT_BENDS):
        near = np.linalg.norm(model.template - joints[JOINT_NAMES.index(joint)], axis=1) < _NEAR
        rest = joint_section(model, model.template, np.zeros((55, 3)), joint)
        apart = [np.linalg.norm((posed[n][row] - bends.surfaces[row])[near], axis=1).mean() for n in models]
        areas = [joint_section(model, posed[n][row], bends.poses[row], joint) / rest for n in names]
        volumes = [signed_volume(posed[n][row], model.faces) / volume for n in names]
        reached = np.rad2deg(np.linalg.norm(bends.poses[row, JOINT_NAMES.index(joint)]))
        words = f"{joint} {axis} {np.sign(degrees) * reached:.0f}"
        print(
            f"{words:24s} "
            + "".join(f"{1e3 * d:9.2f}" for d in apart)
            + "".join(f"{a:9.3f}" for a in areas)
            + "".join(f"{v:9.4f}" for v in volumes)
        )


def print_drawn(models: dict[str, SurfaceModel], bends: SettledBends) -> None:
    """Root mean square distances over the skin that moves, in bends drawn for all joints at once."""
    model = models["learned"]
    skin = np.flatnonzero(model.skinning_weights[:, [*range(15), *range(16, 20)]].sum(1) > 0.05)
    drawn = np.arange(len(bends.poses)) >= len(HELD_OUT_BENDS)
    for words, rows in (
        ("template", drawn & (bends.people == 0)),
        ("a stranger", drawn & (bends.people == 1)),
    ):
        some = bends.subset(rows)
        errors = [
            np.square(posed_surfaces(own, some) - some.surfaces)[:, skin].sum(2).mean()
            for own in models.values()
        ]
        shown = ", ".join(f"{name} {1e3 * np.sqrt(e):.2f} mm" for name, e in zip(models, errors, strict=True))
        print(f"{int(rows.sum())} drawn bends, {words}: {shown}; R^2 {1 - errors[-1] / errors[0]:.3f}")


def draw(models: dict[str, SurfaceModel], bends: SettledBends, path: Path) -> None:
    """The largest bends: the flesh, then the models."""
    posed = {
        "settled flesh": bends.surfaces,
        **{name: posed_surfaces(m, bends) for name, m in models.items()},
    }
    titles = {"none": "no correctives", "earlier": "dual quaternions", "learned": "learned"}
    model = models["learned"]
    layout = Layout((240, 224), [titles.get(name, name) for name in posed], ("",) * len(_DRAWN))
    page = blank_sheet(layout)
    for row, (bend, (direction, joints)) in enumerate(_DRAWN.items()):
        index = HELD_OUT_BENDS.index(bend)
        own = model.skinning_weights[:, list(joints)].sum(1) > 0.4
        view = View("", np.array(direction), np.array([0.0, 1, 0]))
        camera = sheet_camera(layout, view, [surfaces[index][own] for surfaces in posed.values()])
        for column, surfaces in enumerate(posed.values()):
            put_tile(page, layout, Tile(surfaces[index], model.faces), camera, row, column)
    write_sheet(path, sheet_pixels(page))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", default="body")
    parser.add_argument(
        "--cache", type=Path, default=Path("build/bends"), help="where settled bends are kept"
    )
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    model = named_model(Path(options.model))
    bends = held_out_bends(model, options.cache / "held_out.npz")
    models = variants(model)
    print_bends(models, bends)
    print_drawn(models, bends)
    if options.pictures:
        draw(models, bends, options.pictures)


if __name__ == "__main__":
    main()
