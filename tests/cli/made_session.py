"""A registered session made of the open hand's template: what curation and report are tested on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from corporeal.export.meshes import write_ply
from corporeal.model.files import open_model
from corporeal.registration.session.files import record_path, write_record
from corporeal.registration.session.records import SessionRecord

STATUSES = ("ok", "ok", "doubtful", "failed")


def make_session(folder: Path, count: int, rng: np.random.Generator) -> tuple[Path, Path]:
    """Writes SESSION (scans and truth) and REG (records, manifest); every fourth scan has no registration.

    The registration of scan i is the template moved by 0.5 + i / 10 mm along x; its truth is the template.
    """
    session, results = folder / "session", folder / "reg"
    model = open_model("hand")
    (session / "truth").mkdir(parents=True)
    for number in range(count):
        name, status = f"s{number % 3:02d}_p{number:02d}_right", STATUSES[number % 4]
        path = session / "scans" / f"{name}.ply"
        noisy = model.template + 0.0002 * rng.standard_normal(model.template.shape)
        write_ply(path, 1e3 * noisy, model.faces)
        joints = np.asarray(model.joint_regressor @ model.template)
        np.savez(session / "truth" / f"{name}.npz", template=model.template, joints=joints)
        row = {
            "scan": str(path), "name": name, "status": status, "reason": f"reason {number} <&>",
            "side": "right", "subject": f"s{number % 3:02d}", "protocol_pose": f"p{number % 5:02d}-pose",
            "unit": "mm",
            "metres_per_unit": 1e-3, "seconds": {"total": 0.5}, "s2m_mm": None, "model_s2m_mm": None,
            "notes": [], "outputs": {}, "signals": {"hole_share": 0.01 * number},
        }  # fmt: skip
        if status == "failed":
            write_record(record_path(results, name), SessionRecord(row))
            continue
        shift = np.array([0.0005 + number / 1e4, 0, 0])
        distances = {
            "mean": 0.2 + number / 100,
            "median": 0.2,
            "p95": 0.5,
            "under_1mm": 1.0,
            "scored_share": 0.9,
        }
        row |= {"s2m_mm": distances, "model_s2m_mm": distances}
        pose, shape = np.zeros((model.joint_count, 3)), np.zeros(model.shape_count)
        record = SessionRecord(row, model.template + shift, pose, shape, shift, "right")
        write_record(record_path(results, name), record)
    manifest = {"format": "corporeal-registered-session-1", "versions": {"corporeal": "0"}, "model": "hand"}
    (results / "manifest.json").write_text(json.dumps(manifest | {"options": {"correctives": True}}))
    return session, results
