"""Models alone, without free vertices, on the real hands: the paper's protocol with pose and shape free.

Every scan is registered once, with the hand in the box; all models begin on that registration, laid onto its
vertices (``start_on``), and then on each other's fits: of a model's fits the one of lowest objective counts.
Begun once, those of the left hand scattered by 0.1 mm with the start. None may use landmarks, limits of
joints or free vertices. Printed are unrobust distances from the scan to each fitted model beyond the wrist
plane, millimetres, and the norm of the shape coefficients, which says how far a model had to go from the
people it knows.

    python benchmarks/model_alone.py [--models hand soft_hand start_hand FILE ...] [--shapes 30]
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from real_scans import DATA, SCANS, run_variant, variants

from corporeal.cli.named_models import named_model
from corporeal.learning.evaluation.fit_start import start_on
from corporeal.learning.evaluation.model_fit import ModelFit, fit_model
from corporeal.learning.evaluation.protocols import PoseAndShape
from corporeal.model.jacobian import evaluate
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


@dataclass(frozen=True, eq=False)
class Contender:
    """A model as it is fitted: of the scan's side, with its correctives or without."""

    name: str
    model: SurfaceModel
    correctives: bool

    def begun(self, scan: Scan, pose: np.ndarray, vertices: np.ndarray, protocol: PoseAndShape) -> ModelFit:
        """Fitted to a scan, begun on a surface."""
        start = start_on(self.model, pose, vertices, protocol, correctives=self.correctives)
        return fit_model(self.model, scan, start, protocol, correctives=self.correctives)

    def surface(self, fit: ModelFit) -> np.ndarray:
        """(V, 3) of a fit, metres."""
        found = fit.parameters
        return evaluate(
            self.model, found.shape, found.pose, found.translation, correctives=self.correctives
        ).vertices


def best_fits(
    contenders: list[Contender], scan: Scan, registration: dict[str, np.ndarray], protocol: PoseAndShape
) -> list[ModelFit]:
    """Of each contender the fit of lowest objective, begun on the registration and on the others' fits."""
    first = [one.begun(scan, registration["pose"], registration["vertices"], protocol) for one in contenders]
    best = list(first)
    for other, fit in zip(contenders, first, strict=True):
        if fit.status != "ok":
            continue
        surface = other.surface(fit)
        for number, one in enumerate(contenders):
            if one is not other:
                again = one.begun(scan, fit.parameters.pose, surface, protocol)
                best[number] = min(best[number], again, key=lambda found: found.objective)
    return best


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
            contenders = []
            for name in options.models:
                right = named_model(Path(name))
                model = right if str(registration["side"]) == "right" else mirror_model(right)
                contenders += [Contender(name, model, True), Contender(name, model, False)]
            fits = best_fits(contenders, scan, registration, PoseAndShape(options.shapes))
            for one, fit in zip(contenders, fits, strict=True):
                print(
                    f"{scan_name:8s}{one.name:14s}{'on' if one.correctives else 'off':>12s}{line(fit)}",
                    flush=True,
                )


def line(fit: ModelFit) -> str:
    """Its distances and the norm of its shape, or why there is none."""
    if fit.status != "ok":
        return f"  {fit.reason}"
    mm, size = fit.s2m_mm, np.linalg.norm(fit.parameters.shape)
    return f"{mm['mean']:7.3f}{mm['median']:8.2f}{mm['p95']:7.2f}{size:12.1f}"


if __name__ == "__main__":
    main()
