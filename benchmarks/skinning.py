"""Posing against smplx 0.1.28 in one run: forward and forward + backward, and the distance from the bound.

    python benchmarks/skinning.py [--json FILE] [--baseline FILE] [--repeats N]

Both read the same random file of an official layout, with four skinning weights per vertex as official files
have, and get the same parameters in float32. smplx is called as its users call it, its own parameters off.
"""

from __future__ import annotations

import corporeal  # first: it tells the thread pools of numba and torch not to spin against each other

# isort: split
import argparse
import importlib.util
import io
import sys
import tempfile
import warnings
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import smplx
import torch
from measure import Row, paired_ratio, report, seconds

from corporeal.model.files import load_model
from corporeal.model.pose import FullPose
from corporeal.model.surface_model import SurfaceModel

BASELINE = Path(__file__).with_name("baseline.json")
LAYOUTS = Path(__file__).parents[1] / "tests" / "model" / "official_layouts.py"


@dataclass(frozen=True)
class Case:
    """One family's size, smplx's pose arguments with their joint counts, and the limits by batch."""

    family: str
    columns: int
    expressions: int
    file_name: str
    pose_arguments: dict[str, int]
    limits: dict[int, tuple[float, float]]


CASES = (
    Case(
        "mano", 10, 0, "MANO_RIGHT.pkl", {"global_orient": 1, "hand_pose": 15},
        {1: (0.15, 0.10), 16: (0.45, 0.35), 256: (0.65, 0.55)},
    ),
    Case(
        "smplx", 20, 10, "SMPLX_NEUTRAL.npz",
        {"global_orient": 1, "body_pose": 21, "jaw_pose": 1, "leye_pose": 1, "reye_pose": 1,
         "left_hand_pose": 15, "right_hand_pose": 15},
        {1: (0.40, 0.35), 16: (0.55, 0.50), 256: (0.40, 0.45)},
    ),
)  # fmt: skip


@dataclass(frozen=True)
class Machine:
    """Measured in this run: bytes per second of a large copy, flops per second of a product."""

    bandwidth: float
    flops: float

    @classmethod
    def measure(cls) -> Machine:
        """Time a copy of 64 MB and a product of 1500 x 1500."""
        source, target = torch.ones(16_000_000), torch.empty(16_000_000)
        square = torch.ones(1500, 1500)
        copying = seconds(lambda: target.copy_(source), 9)
        multiplying = seconds(lambda: torch.mm(square, square), 5)
        return cls(2 * 4 * len(source) / copying, 2 * 1500**3 / multiplying)

    def bound(self, model: SurfaceModel, batch: int, backward: bool) -> float:
        """Seconds that the products, or reading the model and writing the surface, take at the least."""
        rows = 3 * model.vertex_count
        columns = 1 + model.shape_count + model.expression_count + model.pose_directions.shape[2]
        passes = 2 if backward else 1
        products = passes * (2 * rows * columns + rows * 2 * (4 * 4 + 3)) * batch
        moved = passes * 4 * (rows * columns + rows * batch)
        return max(products / self.flops, moved / self.bandwidth)


def _both_models(case: Case, folder: Path) -> tuple[SurfaceModel, torch.nn.Module]:
    spec = importlib.util.spec_from_file_location("official_layouts", LAYOUTS)
    layouts = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = layouts
    spec.loader.exec_module(layouts)
    V, F, _ = layouts.FULL_SIZES[case.family]
    arrays = layouts.official_arrays(case.family, np.random.default_rng(7), (V, F, case.columns))
    write = layouts.write_plain_pickle if case.file_name.endswith("pkl") else layouts.write_npz
    path = write(folder / case.file_name, arrays)
    switches = {"betas", "transl", "expression", *case.pose_arguments}
    options = {f"create_{name}": False for name in switches} | {"use_pca": False, "flat_hand_mean": True}
    if case.expressions:
        options |= {"num_expression_coeffs": case.expressions, "num_betas": 10}
    with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        theirs = getattr(smplx, path.stem.split("_")[0])(str(path), ext=path.suffix[1:], **options)
        return load_model(path), theirs


def _calls(
    case: Case, ours: SurfaceModel, theirs: torch.nn.Module, batch: int
) -> tuple[Callable[[], torch.Tensor], Callable[[], torch.Tensor]]:
    generator = torch.Generator().manual_seed(11)

    def draw(columns: int, scale: float) -> torch.Tensor:
        return (scale * torch.randn(batch, columns, generator=generator)).requires_grad_()

    shape, move = draw(10, 1.0), draw(3, 1.0)
    parts = {name: draw(3 * joints, 0.3) for name, joints in case.pose_arguments.items()}
    faces = {"expression": draw(case.expressions, 1.0)} if case.expressions else {}
    full = torch.cat(list(parts.values()), dim=1).reshape(batch, -1, 3).detach().requires_grad_()

    def run_ours() -> torch.Tensor:
        return ours(shape, FullPose(full), faces.get("expression"), move).vertices

    def run_theirs() -> torch.Tensor:
        return theirs(betas=shape, transl=move, **parts, **faces).vertices

    with torch.no_grad():
        difference = (run_ours() - run_theirs()).abs().max().item()
    if difference > 1e-4:
        raise RuntimeError(f"{case.family}: the two differ by {difference:.1e} m; a ratio would mean nothing")
    return run_ours, run_theirs


def _without_gradients(call: Callable[[], torch.Tensor]) -> Callable[[], torch.Tensor]:
    def run() -> torch.Tensor:
        with torch.no_grad():
            return call()

    return run


def _with_backward(call: Callable[[], torch.Tensor], pull: torch.Tensor) -> Callable[[], None]:
    return lambda: call().backward(pull)


def measure(case: Case, machine: Machine, repeats: int) -> list[Row]:
    """The rows of one family."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        ours, theirs = _both_models(case, Path(folder))
    for batch, limits in case.limits.items():
        calls = _calls(case, ours, theirs, batch)
        pull = torch.randn(batch, ours.vertex_count, 3, generator=torch.Generator().manual_seed(13))
        pairs = [_without_gradients(c) for c in calls], [_with_backward(c, pull) for c in calls]
        for label, pair, limit, backward in zip(
            ("forward", "forward+backward"), pairs, limits, (False, True), strict=True
        ):
            ratio = paired_ratio(*pair, repeats if batch < 100 else max(5, repeats // 3))
            to_bound = ratio.ours_seconds / machine.bound(ours, batch, backward)
            name = f"{ours.vertex_count:,} vertices, B={batch}, {label}"
            rows.append(Row(name, ratio, limit, f"{to_bound:.1f} x bound"))
    return rows


def main() -> int:
    """Measure, print, and compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="store the ratios in this file")
    parser.add_argument("--baseline", type=Path, default=BASELINE, help="compare with this file")
    parser.add_argument("--repeats", type=int, default=30, help="pairs per row")
    options = parser.parse_args()
    machine = Machine.measure()
    print(f"corporeal {corporeal.__version__}, {torch.get_num_threads()} threads; ", end="")
    print(f"{machine.bandwidth / 1e9:.0f} GB/s copied, {machine.flops / 1e9:.0f} GFLOP/s multiplied")
    rows = [row for case in CASES for row in measure(case, machine, options.repeats)]
    return report("skinning", rows, json_path=options.json, baseline=options.baseline)


if __name__ == "__main__":
    sys.exit(main())
