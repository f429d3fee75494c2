"""What ``corporeal register`` leaves behind for one scan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from corporeal.export.gltf import write_glb
from corporeal.export.meshes import write_ply
from corporeal.export.overview import Overview, write_overview
from corporeal.registration.files import save_registration
from corporeal.registration.registration import Registration
from corporeal.registration.subjects import HAND, SUBJECTS, subject_of

_OUTPUTS = ("registration.npz", "registration.ply", "model.ply", "overview.png")
_GLB = {subject.name: f"{subject.name}.glb" for subject in SUBJECTS}


def remove_outputs(folder: Path) -> None:
    """Drop what an earlier run left: a scan that fails now must not show an old result beside its report."""
    for name in (*_OUTPUTS, *_GLB.values()):
        (folder / name).unlink(missing_ok=True)


def write_outputs(result: Registration, folder: Path, row: dict[str, Any]) -> dict[str, str]:
    """Write the results of one scan; metres in the .npz and the GLB, the scan's own unit in the PLYs."""
    glb = _GLB[subject_of(result.model).name]
    paths = {name: folder / name for name in (*_OUTPUTS[:3], glb, *_OUTPUTS[3:])}
    save_registration(result, paths["registration.npz"])
    scan, faces, parameters = result.scan, result.model.faces, result.parameters
    write_ply(paths["registration.ply"], scan.in_own_unit(result.vertices), faces)
    write_ply(paths["model.ply"], scan.in_own_unit(result.model_vertices), faces)
    write_glb(
        paths[glb], result.model, parameters.shape, parameters.pose, parameters.translation,
        correctives=result.correctives,
    )  # fmt: skip
    overview = Overview(
        scan_points=scan.points,
        scan_faces=None if scan.is_point_cloud else scan.faces,
        scan_normals=scan.normals,
        model_vertices=result.model_vertices,
        registration_vertices=result.vertices,
        faces=faces,
        point_errors_mm=np.where(result.distances.scored, 1e3 * result.distances.metres, np.nan),
        views=_views(result),
        view_names=("palm", "back") if subject_of(result.model) is HAND else ("front", "side"),
        title=_title(row, subject_of(result.model).name),
    )
    write_overview(paths["overview.png"], overview)
    return {name: str(path) for name, path in paths.items()}


def _title(row: dict[str, Any], kind: str) -> tuple[str, ...]:
    registration, model = row["s2m_mm"], row["model_s2m_mm"]
    subject = kind if row["side"] is None else f"{row['side']} {kind}"
    return (
        f"{Path(row['scan']).name}: {row['status']}, {subject}",
        f"scan to registration: mean {registration['mean']:.2f} mm, 95 % under {registration['p95']:.2f} mm; "
        f"scan to model alone: mean {model['mean']:.2f} mm",
    )


def _views(result: Registration) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Two views as (view direction, up) in the scan's frame: front and side, or palm and back of a hand."""
    model, root = result.model, result.parameters.pose[0]
    R_world_root = Rotation.from_rotvec(root).as_matrix()
    if subject_of(model) is not HAND:
        front, left, up = R_world_root @ [0, 0, 1.0], R_world_root @ [1.0, 0, 0], R_world_root @ [0, 1.0, 0]
        return ((-front, up), (-left, up))
    along = model.template.mean(0) - np.asarray(model.joint_regressor @ model.template)[0]
    fingers = R_world_root @ (along / np.linalg.norm(along))
    down = R_world_root @ np.array([0.0, -1.0, 0.0])
    return ((-down, fingers), (down, fingers))
