"""What pose correctives do, in the manner of figure 9 of the MANO paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, UInt8
from PIL import Image

from corporeal.export.sheets import (
    Layout,
    Tile,
    View,
    blank_sheet,
    overlaid,
    put_tile,
    put_words,
    sheet_camera,
    sheet_pixels,
)
from corporeal.geometry.rotations_numeric import matrix_from_axis_angle
from corporeal.model.pose import FullPose
from corporeal.model.surface_model import SurfaceModel

_TILE = (200, 240)
_RED, _GREEN, _PINK = (0.86, 0.42, 0.38), (0.48, 0.74, 0.45), (0.95, 0.70, 0.72)
_CYAN, _YELLOW = (0.45, 0.76, 0.82), (0.93, 0.82, 0.42)
_COLUMNS = (
    "without", "with", "registration", "without, overlaid", "with, overlaid", "template", "with correctives",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class CorrectiveCase:
    """One posed hand of the sheet.

    Attributes:
        label: what is said of it.
        model: a personal model, or any whose template is the person's.
        pose: (K, 3) axis-angle, radians.
        translation: metres.
        registration: (V, 3) what the model should look like in this pose, metres.
    """

    label: str
    model: SurfaceModel
    pose: Float[np.ndarray, "K 3"]
    translation: Float[np.ndarray, "3"]
    registration: Float[np.ndarray, "V 3"]


def corrective_sheet(cases: Sequence[CorrectiveCase], view: View) -> UInt8[np.ndarray, "H W 3"]:
    """A row per case; the colours are the paper's.

    Posed without correctives (red), with them (green), the registration (pink), the registration overlaid
    with each of the two, the template (cyan), and the template with the correctives of the pose (yellow).

    Args:
        cases: at least one.
        view: for a root that is not turned; the camera turns with each case's root.

    Raises:
        ValueError: no cases, a model without correctives, or a registration of another template.
    """
    if not cases:
        raise ValueError("cases: at least one is needed")
    for case in cases:
        _check(case)
    layout = Layout(_TILE, _COLUMNS, ("",) * len(cases))
    page = blank_sheet(layout)
    for row, case in enumerate(cases):
        _put_case(page, layout, case, view, row)
        put_words(page, layout, row, case.label)
    return sheet_pixels(page)


def _put_case(page: Image.Image, layout: Layout, case: CorrectiveCase, view: View, row: int) -> None:
    faces = case.model.faces
    without = Tile(_posed(case, correctives=False), faces, _RED)
    corrected = Tile(_posed(case, correctives=True), faces, _GREEN)
    registration = Tile(case.registration, faces, _PINK)
    template = Tile(case.model.template, faces, _CYAN)
    offset = Tile(case.model.template + _correctives(case), faces, _YELLOW)
    R_world_root = matrix_from_axis_angle(case.pose[:1])[0]
    turned = View(view.name, R_world_root @ view.direction, R_world_root @ view.up)
    posed = [
        without, corrected, registration, overlaid(without, registration), overlaid(corrected, registration),
    ]  # fmt: skip
    camera = sheet_camera(layout, turned, [tile.vertices for tile in posed[:3]])
    for column, tile in enumerate(posed):
        put_tile(page, layout, tile, camera, row, column)
    camera = sheet_camera(layout, view, [template.vertices, offset.vertices])
    for column, tile in enumerate((template, offset)):
        put_tile(page, layout, tile, camera, row, len(posed) + column)


def _posed(case: CorrectiveCase, correctives: bool) -> np.ndarray:
    values = FullPose(torch.from_numpy(case.pose[None].astype(np.float64)))
    translation = torch.from_numpy(case.translation[None].astype(np.float64))
    return case.model(None, values, translation=translation, correctives=correctives).vertices[0].numpy()


def _correctives(case: CorrectiveCase) -> np.ndarray:
    """(V, 3) offsets of the template (equation 3), metres."""
    return case.model.pose_directions @ (matrix_from_axis_angle(case.pose[1:]) - np.eye(3)).ravel()


def _check(case: CorrectiveCase) -> None:
    if not case.model.has_correctives:
        raise ValueError(f"cases: the model of {case.label!r} has no pose correctives to show")
    if case.registration.shape != case.model.template.shape:
        raise ValueError(
            f"cases: the registration of {case.label!r} has {len(case.registration)} vertices, "
            f"its model {case.model.vertex_count}"
        )
