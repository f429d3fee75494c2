"""Models alone, without free vertices, on the real hands: the paper's protocol with pose and shape free.

Every scan is registered once, with the hand in the box; all models begin on that registration, laid onto its
vertices (``start_on``). None may use landmarks, limits of joints or free vertices. Printed are unrobust
distances from the scan to each fitted model beyond the wrist plane, millimetres, and the norm of the shape
coefficients, which says how far a model had to go from the people it knows.

    python benchmarks/model_alone.py [--models hand soft_hand start_hand FILE ...] [--shapes 30]
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from real_scans import DATA, SCANS, run_variant, variants

from corporeal.cli.named_models import named_model
from corporeal.learning.evaluation.fit_start import start_on
from corporeal.learning.evaluation.model_fit import ModelFit, fit_model
from corporeal.learning.evaluation.protocols import PoseAndShape
from corporeal.model.mirror import mirror_model
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.files import read_scan
from corporeal.scans.scan import Scan


def registered(name: str, out: Path) -> tuple[Scan, dict[str, np.ndarray]]:
    """A real scan in metres, and its registration."""
    path = DATA / SCANS[name][0]
    scan = read_scan(path)
    variant = next(variants(1e3 * scan.points, scan.faces, None))
    row = run_variant(variant, name, out, "hand")
    if row["status"] != "ok":
        raise SystemExit(f"{name}: {row['status']}: {row['reason']}")
    with np.load(out / name / "registration.npz") as archive:
        return scan, dict(archive)


def fitted(
    model: SurfaceModel, scan: Scan, registration: dict[str, np.ndarray], shapes: int, correctives: bool
) -> ModelFit:
    """A model alone, begun on the registration."""
    protocol = PoseAndShape(shapes)
    start = start_on(model, registration["pose"], registration["vertices"], protocol, correctives=correctives)
    return fit_model(model, scan, start, protocol, correctives=correctives)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--models", nargs="+", default=["hand", "soft_hand", "start_hand"])
    parser.add_argument("--shapes", type=int, default=30, help="most shape coefficients")
    options = parser.parse_args()
    if not DATA.is_dir():
        print(f"real scans not found in {DATA}: nothing measured")
        return
    print("scan    model         correctives   mean  median    p95  shape norm")
    with tempfile.TemporaryDirectory(prefix="corporeal-") as folder:
        for scan_name in ("hand5", "hand3"):
            scan, registration = registered(scan_name, Path(folder))
            for name in options.models:
                right = named_model(Path(name))
                model = right if str(registration["side"]) == "right" else mirror_model(right)
                for correctives in (True, False) if name == options.models[0] else (True,):
                    fit = fitted(model, scan, registration, options.shapes, correctives)
                    if fit.status != "ok":
                        print(f"{scan_name:8s}{name:14s} {fit.reason}")
                        continue
                    mm, size = fit.s2m_mm, np.linalg.norm(fit.parameters.shape)
                    print(
                        f"{scan_name:8s}{name:14s}{'on' if correctives else 'off':>12s}"
                        f"{mm['mean']:7.3f}{mm['median']:8.2f}{mm['p95']:7.2f}{size:12.1f}",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
