"""Two templates beside each other, in the manner of figure 8 of the MANO paper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int, UInt8

from corporeal.export.overview import error_colours
from corporeal.export.sheets import (
    Layout,
    Tile,
    View,
    blank_sheet,
    put_tile,
    put_words,
    sheet_camera,
    sheet_pixels,
)

_TILE = (300, 340)


def template_comparison(
    template_a: Float[np.ndarray, "V 3"],
    template_b: Float[np.ndarray, "V 3"],
    faces: Int[np.ndarray, "F 3"],
    views: Sequence[View],
    labels: tuple[str, str] = ("a", "b"),
    *,
    reference: Float[np.ndarray, "V 3"] | None = None,
    largest_mm: float = 3.0,
) -> UInt8[np.ndarray, "H W 3"]:
    """A row per template, a column per view, all rows under one camera.

    Args:
        template_a: upper row, metres; for instance learned with constant regularisation.
        template_b: lower row, in the same frame; for instance with the geodesic one.
        faces: corner indices.
        views: for instance ``model_views``.
        labels: names of the rows.
        reference: where given, every vertex is coloured by its distance to the reference's (dark blue 0, dark
            red ``largest_mm`` and more); with ``template_b`` itself the upper row shows where the two differ.
        largest_mm: the distance at the end of the scale, millimetres, > 0.

    Raises:
        ValueError: no views, or ``largest_mm`` is not positive.
    """
    if not views:
        raise ValueError("views: at least one is needed")
    if not largest_mm > 0:
        raise ValueError(f"largest_mm: must be positive, got {largest_mm}")
    title = "" if reference is None else f"distance: blue 0, dark red {largest_mm:g} mm and more"
    layout = Layout(_TILE, tuple(view.name for view in views), ("", ""), title)
    page = blank_sheet(layout)
    for column, view in enumerate(views):
        camera = sheet_camera(layout, view, [template_a, template_b])
        for row, template in enumerate((template_a, template_b)):
            tile = Tile(template, faces)
            if reference is not None:
                distance_mm = 1e3 * np.linalg.norm(template - reference, axis=1)
                # The scale of error_colours ends at 3 mm.
                tile = Tile(template, faces, error_colours(3.0 * distance_mm / largest_mm))
            put_tile(page, layout, tile, camera, row, column)
    for row, label in enumerate(labels):
        put_words(page, layout, row, label)
    return sheet_pixels(page)
