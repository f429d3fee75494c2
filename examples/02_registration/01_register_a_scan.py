"""Register a scan from Python: what ``corporeal register`` does, step by step."""

import sys
from pathlib import Path

from corporeal.export.gltf import write_glb
from corporeal.model.files import open_model
from corporeal.registration.evidence import LandmarkFinder
from corporeal.registration.register import register
from corporeal.registration.registration import FailedRegistration
from corporeal.scans.files import read_scan

default = Path(__file__).parents[2] / "assets" / "demo" / "scan.ply"
scan = read_scan(sys.argv[1] if len(sys.argv) > 1 else default)
print(f"{scan.name}: {len(scan.points)} points; {' '.join(scan.repairs)}")

hand = open_model("hand")
with LandmarkFinder(hand) as finder:
    evidence, notes = finder.find(scan)
print("; ".join(notes))

result = register(scan, hand, evidence)
if isinstance(result, FailedRegistration):
    sys.exit(f"failed: {result.reason}")
print(f"{result.status}: {result.side} hand; {result.reason}")
print("scan to registration, mm:", {k: round(v, 3) for k, v in result.distances.summary_mm().items()})

folder = Path("demo-out")
folder.mkdir(exist_ok=True)
fitted = result.parameters
write_glb(folder / "from_python.glb", result.model, fitted.shape, fitted.pose, fitted.translation)
print("wrote", folder / "from_python.glb")
