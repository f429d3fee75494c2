"""Pictures beside the tables of an evaluation: what correctives do, and equation 11 to the template."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from corporeal.export.corrective_sheet import CorrectiveCase, corrective_sheet
from corporeal.export.sheets import model_views, write_sheet
from corporeal.export.template_sheet import template_comparison
from corporeal.learning.evaluation.pose_generalisation import HeldOutScan
from corporeal.learning.evaluation.study import LearnedVariant
from corporeal.learning.evaluation.variants import WITHOUT_NEUTRAL_FIRST
from corporeal.learning.personal import fitted_poses
from corporeal.model.surface_model import SurfaceModel

_CASES = 4


def write_evaluation_pictures(
    folder: Path,
    model: SurfaceModel,
    personal: Mapping[str, SurfaceModel],
    scans: Sequence[HeldOutScan],
    variants: Sequence[LearnedVariant] = (),
) -> list[Path]:
    """Figures 9 and 8 of the MANO paper of a learned model.

    Args:
        folder: gets ``correctives.png``, the most bent held-out hands around their personal templates, and
            ``neutral_first.png``, the template with and without equation 11, where that variant was learned.
        model: learned.
        personal: hand -> its personal model.
        scans: held-out ones with their registrations.
        variants: models learned otherwise.

    Returns:
        The files.

    Raises:
        OSError: a file cannot be written.
    """
    written = []
    if model.has_correctives and scans:
        bent = sorted(scans, key=lambda scan: -float(np.square(scan.pose[1:]).sum()))[:_CASES]
        cases = [_case(scan, personal[scan.hand]) for scan in bent]
        written.append(folder / "correctives.png")
        write_sheet(written[-1], corrective_sheet(cases, model_views(model)[0]))
    for entry in variants:
        if entry.variant.label == WITHOUT_NEUTRAL_FIRST:
            picture = template_comparison(
                entry.learned.model.template,
                model.template,
                model.faces,
                model_views(model),
                ("without equation 11", "with"),
                reference=model.template,
                largest_mm=2.0,
            )
            written.append(folder / "neutral_first.png")
            write_sheet(written[-1], picture)
    return written


def _case(scan: HeldOutScan, own: SurfaceModel) -> CorrectiveCase:
    start = scan.vertices.mean(axis=0) - own.template.mean(axis=0)
    found = fitted_poses(own, scan.vertices[None], scan.pose[None], start[None])
    return CorrectiveCase(scan.name, own, found.poses[0], found.translations[0], scan.vertices)
