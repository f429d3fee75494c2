"""Pictures of a model's shape and pose components, in the manner of figures 4 and 10 of the MANO paper."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float, UInt8

from corporeal.export.sheets import (
    Layout,
    Tile,
    View,
    blank_sheet,
    model_views,
    put_tile,
    sheet_camera,
    sheet_pixels,
)
from corporeal.model.pose import FullPose
from corporeal.model.statistics import PoseBlock
from corporeal.model.surface_model import SurfaceModel

_SHAPE_TILE, _POSE_TILE = (190, 250), (150, 200)


def shape_sheet(
    model: SurfaceModel, components: int = 5, deviations: float = 3.0, view: View | None = None
) -> UInt8[np.ndarray, "H W 3"]:
    """The mean shape, and so many standard deviations along each of the first shape components, both ways.

    All tiles have one camera: a component that scales the hand shows as that. The deviation of a coefficient
    is 1, the convention of the shape directions.

    Args:
        model: drawn at its zero pose.
        components: how many columns beside the mean.
        deviations: how far along each, upper row plus and lower row minus.
        view: from where; the first of ``model_views`` where it is None.

    Raises:
        ValueError: more components than the model has, none, or deviations that are not positive.
    """
    _check(components, model.shape_count, deviations, "shape directions")

    def surface(component: int, sign: float) -> np.ndarray:
        return model.template + sign * deviations * model.shape_directions[:, :, component]

    view = view or model_views(model)[0]
    return _sheet(model, surface, components, f"{deviations:g}", ("shape", _SHAPE_TILE, view))


def pose_sheet(
    model: SurfaceModel, components: int = 10, deviations: float = 2.0, block: str | None = None,
    view: View | None = None,
) -> UInt8[np.ndarray, "H W 3"]:  # fmt: skip
    """The mean pose, and so many standard deviations along each of the first pose components, both ways.

    Args:
        model: drawn at zero shape, with its correctives.
        components: how many columns beside the mean.
        deviations: how far along each, upper row plus and lower row minus.
        block: name of the pose block; the first one where it is None.
        view: from where; the last of ``model_views``, where flexed fingers are seen, where it is None.

    Raises:
        ValueError: a model without pose blocks, more components than the block has, none, or deviations that
            are not positive.
        KeyError: a block that the model does not have.
    """
    if not model.pose_blocks:
        raise ValueError("model: it has no pose block, so there are no pose components to draw")
    statistics = model.pose_blocks[0] if block is None else model.block(block)
    _check(
        components, len(statistics.components), deviations, f"pose components of block {statistics.name!r}"
    )

    def surface(component: int, sign: float) -> np.ndarray:
        along = deviations * statistics.component_deviations[component] * statistics.components[component]
        return _posed(model, statistics, statistics.mean + sign * along)

    view = view or model_views(model)[2]
    return _sheet(model, surface, components, f"{deviations:g}", ("pose", _POSE_TILE, view))


def _sheet(
    model: SurfaceModel, surface: Callable[[int, float], np.ndarray], components: int, deviations: str,
    appearance: tuple[str, tuple[int, int], View],
) -> UInt8[np.ndarray, "H W 3"]:  # fmt: skip
    """Mean at the left between the rows, then a column per component."""
    name, tile, view = appearance
    layout = Layout(
        tile=tile,
        columns=("mean", *(f"{name} {number}" for number in range(1, components + 1))),
        rows=(f"+{deviations} sd", f"-{deviations} sd"),
    )
    mean = surface(0, 0.0)
    rows = [[surface(component, sign) for component in range(components)] for sign in (1.0, -1.0)]
    camera = sheet_camera(layout, view, [mean, *rows[0], *rows[1]])
    page = blank_sheet(layout)
    put_tile(page, layout, Tile(mean, model.faces), camera, 0.5, 0)
    for row, surfaces in enumerate(rows):
        for column, vertices in enumerate(surfaces):
            put_tile(page, layout, Tile(vertices, model.faces), camera, row, 1 + column)
    return sheet_pixels(page)


def _posed(model: SurfaceModel, block: PoseBlock, numbers: Float[np.ndarray, " D"]) -> np.ndarray:
    values = np.zeros((1, model.joint_count, 3))
    values[0, list(block.joints)] = numbers.reshape(-1, 3)
    return model(None, FullPose(torch.from_numpy(values))).vertices[0].numpy()


def _check(components: int, available: int, deviations: float, what: str) -> None:
    if not 1 <= components <= available:
        raise ValueError(f"components: expected 1 to {available}, the {what} of the model, got {components}")
    if not deviations > 0:
        raise ValueError(f"deviations: must be positive, got {deviations}")
