"""Register the real scans, as they are and altered in every way a user's scan may differ.

Prints one row per variant: status, side, s2m of the registration against the *original* scan, s2m of the
model alone, how deep one finger stands in another, and the times. ``--out DIR`` keeps all results, pictures
included.

    python benchmarks/real_scans.py [--data DIR] [--out DIR] [--json FILE] [--only WORD]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import igl
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

import corporeal  # sets the thread policy before numba and OpenBLAS are loaded
from corporeal.geometry.self_intersection import part_penetration
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.model.parts import part_labels
from corporeal.registration.measures import beyond_cut, scan_to_mesh
from corporeal.scans.files import read_scan
from corporeal.terms.scan_to_surface import MovingSurface

DATA = Path(os.environ.get("CORPOREAL_DATA", Path(__file__).parents[2] / "shared" / "data"))
# Of the registration against the original scan, of the model alone, and how much an alteration may cost.
LIMITS_MM = {"mean": 0.6, "p95": 2.0, "penetration": 1.0, "model": 2.5, "change": 0.3}
HEADER = "scan                       status    side     s2m   p95  model inside  fit s wall s"
SCANS = {
    "hand5": ("scans/hand-scan2knit/hand5.off", "right", 0.5),
    "hand3": ("scans/hand-sense/hand3.stl", "left", 0.1),
    "hand1": ("scans/hand-sense/hand1.stl", None, None),
}


@dataclass(frozen=True)
class Variant:
    """An altered scan and the way back to the original's frame and millimetres."""

    label: str
    points: np.ndarray
    faces: np.ndarray
    options: tuple[str, ...]
    mirrored: bool
    back: np.ndarray  # (3, 4): original_mm = back @ (own unit, 1)


def variants(points: np.ndarray, faces: np.ndarray, share: float | None) -> Iterator[Variant]:
    """The scan as it is; and, for whole scans, the alterations of the issue."""
    same = np.eye(3, 4)
    yield Variant("as it is", points, faces, (), False, same)
    if share is None:
        return
    R = Rotation.random(random_state=7).as_matrix()
    yield Variant("turned", points @ R.T, faces, (), False, np.c_[R.T, np.zeros(3)])
    flip = np.diag([-1.0, 1, 1])
    yield Variant("mirrored", points @ flip, faces[:, ::-1], (), True, np.c_[flip, np.zeros(3)])
    yield Variant("in metres", points / 1000, faces, (), False, np.c_[1000 * np.eye(3), np.zeros(3)])
    yield Variant(
        "x 20.8, free", points * 20.8, faces, ("--unit", "free"), False, np.c_[np.eye(3) / 20.8, np.zeros(3)]
    )
    yield Variant("point cloud", points, np.zeros((0, 3), np.int64), (), False, same)
    thin_points, thin_faces = igl.qslim(points, faces, int(share * len(faces)))[:2]
    yield Variant(f"decimated to {share:.0%}", thin_points, thin_faces, (), False, same)


def run_variant(variant: Variant, name: str, folder: Path, model_name: str) -> dict:
    """Register one variant with the command line and measure against the original scan."""
    folder.mkdir(parents=True, exist_ok=True)
    scan = folder / f"{name}.ply"
    geometry = (
        trimesh.Trimesh(variant.points, variant.faces, process=False)
        if len(variant.faces)
        else trimesh.PointCloud(variant.points)
    )
    geometry.export(scan)
    result = folder / "result.json"
    command = [sys.executable, "-m", "corporeal.cli.main", "register", str(scan), "-o", str(folder), "--json"]
    begun = time.perf_counter()
    status = subprocess.run(
        [*command, str(result), "--model", model_name, *variant.options],
        capture_output=True,
        text=True,
        check=False,
    )
    wall = time.perf_counter() - begun
    if not result.exists():
        return {"status": "crashed", "reason": status.stderr[-300:], "wall": wall}
    row = json.loads(result.read_text())["items"][0]
    row["wall"] = wall
    return row


def measures(variant: Variant, name: str, folder: Path, original: np.ndarray) -> dict:
    """s2m of the *original* scan's points to the registration, and the deepest penetration, mm."""
    archive = np.load(folder / name / "registration.npz")
    model = open_model("hand", str(archive["side"]))
    posed = evaluate(model, archive["shape"], archive["pose"], archive["translation"])
    # The original's points in the registration's frame, metres; and how many millimetres such a metre is.
    linear, shift = variant.back[:, :3], variant.back[:, 3]
    points = (original - shift) @ np.linalg.inv(linear).T * float(archive["metres_per_unit"])
    mm = np.cbrt(abs(np.linalg.det(linear))) / float(archive["metres_per_unit"])
    distances = scan_to_mesh(
        MovingSurface(archive["vertices"], model.faces),
        archive["vertices"],
        points,
        beyond_cut(points, model.cut, posed),
    )
    scored = mm * distances.metres[distances.scored]
    parts = part_labels(model)
    return {
        "mean": float(scored.mean()),
        "p95": float(np.percentile(scored, 95)),
        "scored_share": distances.scored_share,
        "penetration": 1e3 * part_penetration(archive["vertices"], model.faces, parts).deepest,
    }


def line(row: dict) -> str:
    """One row of the table."""
    m = row["against_original_mm"]
    numbers = f"{m['mean']:5.2f} {m['p95']:5.2f} {row['model_s2m_mm']['mean']:6.2f} {m['penetration']:6.2f}"
    times = f"{row['seconds']['fit']:6.2f} {row['wall']:6.1f}"
    reason = row["reason"] if row["status"] != "ok" else ""
    return f"{row['variant']:26} {row['status']:9} {row['side']:6} {numbers} {times}  {reason}"


def breaches(row: dict, first: dict | None, whole: bool) -> list[str]:
    """What a row misses; ``first`` is the row of the same scan as it is."""
    if row["status"] not in ("ok", "doubtful"):
        return [f"{row['status']}: {row['reason']}"]
    m, missed = row["against_original_mm"], []
    if not whole:
        return missed
    limits = {"mean": LIMITS_MM["mean"], "p95": LIMITS_MM["p95"], "penetration": LIMITS_MM["penetration"]}
    missed += [f"{name} {m[name]:.2f} over {limit}" for name, limit in limits.items() if m[name] > limit]
    if m["scored_share"] < 0.9:
        missed.append(f"only {m['scored_share']:.0%} scored")
    if row["side"] != row["expected_side"]:
        missed.append(f"side {row['side']}, expected {row['expected_side']}")
    if first is None and row["model_s2m_mm"]["mean"] > LIMITS_MM["model"]:
        missed.append(f"model alone {row['model_s2m_mm']['mean']:.2f} over {LIMITS_MM['model']}")
    if first is not None and m["mean"] - first["against_original_mm"]["mean"] > LIMITS_MM["change"]:
        missed.append(f"mean {m['mean']:.2f} against {first['against_original_mm']['mean']:.2f} as it is")
    return missed


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=DATA)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--only", default="", help="only variants whose name holds this")
    parser.add_argument("--model", default="hand")
    options = parser.parse_args()
    if not options.data.is_dir():
        print(f"real scans not found in {options.data}: nothing measured")
        return 0
    out = options.out or Path(tempfile.mkdtemp(prefix="corporeal-"))
    print(f"corporeal {corporeal.__version__}; results in {out}")
    print(HEADER)
    rows: list[dict] = []
    missed: list[str] = []
    for name, (file, side, share) in SCANS.items():
        scan = read_scan(options.data / file)
        original = 1e3 * scan.points
        for variant in variants(original, scan.faces, share):
            if options.only not in f"{name} {variant.label}":
                continue
            folder = out / f"{name}-{variant.label.replace(' ', '_').replace('%', '').replace(',', '')}"
            row = run_variant(variant, name, folder, options.model)
            flipped = {"left": "right", "right": "left"}
            expected = flipped[side] if variant.mirrored and side else side
            row |= {"variant": f"{name} {variant.label}", "expected_side": expected}
            if row["status"] in ("ok", "doubtful"):
                row["against_original_mm"] = measures(variant, name, folder, original)
                print(line(row), flush=True)
            else:
                print(f"{row['variant']:26} {row['status']:9} {row['reason']}", flush=True)
            first = next((r for r in rows if r["variant"] == f"{name} as it is"), None)
            missed += [f"{row['variant']}: {words}" for words in breaches(row, first, share is not None)]
            rows.append(row)
    if options.json:
        options.json.write_text(json.dumps({"items": rows}, indent=1))
    print("every limit kept" if not missed else "over a limit:\n  " + "\n  ".join(missed))
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
