"""Generalisation of the pose space (figure 13 of Romero et al. 2017): s2m by number of pose components."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass

import numba
import numpy as np
import torch
from jaxtyping import Float

from corporeal.learning.evaluation.fit_start import start_on
from corporeal.learning.evaluation.model_fit import ModelFit, ModelFitter
from corporeal.learning.evaluation.protocols import FitProtocol
from corporeal.learning.evaluation.results import PoseCurve, ScanError, ScanResult, Summary
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.session.pool import single_threaded
from corporeal.scans.scan import Scan


@dataclass(frozen=True, eq=False)
class HeldOutScan:
    """A scan that no compared model was learned from, with a registration of it, where all fits begin.

    Attributes:
        name: of the scan.
        subject: whose hand it is; intervals are taken over subjects.
        hand: which hand of that subject, for instance "s01/right".
        scan: in metres.
        pose: (K, 3) axis-angle of its registration, radians.
        vertices: (V, 3) of its registration, metres, in the scan's frame.
    """

    name: str
    subject: str
    hand: str
    scan: Scan
    pose: Float[np.ndarray, "K 3"]
    vertices: Float[np.ndarray, "V 3"]


@dataclass(frozen=True, eq=False)
class ComparedModel:
    """One curve: a model as it is fitted.

    Attributes:
        label: of the curve.
        models: hand -> the model for it, of its side. For ``PoseOnly`` the personal ones; for
            ``PoseAndShape`` the same model may stand for all hands of a side.
        protocol: what is free.
        components: ascending numbers of pose components; the full pose is always fitted besides.
        correctives: False leaves the model's pose correctives out.
    """

    label: str
    models: Mapping[str, SurfaceModel]
    protocol: FitProtocol
    components: tuple[int, ...] = ()
    correctives: bool = True


def pose_generalisation(
    compared: Sequence[ComparedModel],
    scans: Sequence[HeldOutScan],
    workers: int,
    on_scan: Callable[[int, int], None] | None = None,
) -> tuple[PoseCurve, ...]:
    """Fit every model to every scan; one curve per model, over the same scans.

    A scan to which any of a curve's fits failed has the status "failed: ..." there: it stays in the list but
    is not in the means; ``n_scans`` counts the others. Results do not depend on ``workers``.

    Args:
        compared: the models.
        scans: what they are fitted to.
        workers: spawned processes of one thread each.
        on_scan: told how many fits of a model to a scan are done, and how many there are.

    Raises:
        ValueError: a label twice, a hand for which a model is missing, or what ``fit_model`` raises.
    """
    _check(compared, scans)
    jobs = [(curve, scan) for scan in range(len(scans)) for curve in range(len(compared))]
    found: dict[tuple[int, int], ScanResult] = {}
    for done, (job, result) in enumerate(_run(compared, scans, jobs, workers), start=1):
        found[job] = result
        if on_scan is not None:
            on_scan(done, len(jobs))
    return tuple(
        curve_of(model, [found[number, scan] for scan in range(len(scans))])
        for number, model in enumerate(compared)
    )


def fitted(model: ComparedModel, held_out: HeldOutScan) -> ScanResult:
    """All fits of one model to one scan."""
    own = model.models[held_out.hand]
    start = start_on(own, held_out.pose, held_out.vertices, model.protocol, correctives=model.correctives)
    fitter = ModelFitter(own, held_out.scan, start, model.protocol, correctives=model.correctives)
    fits, full = fitter.fit_all(model.components)
    failed = next((fit for fit in [*fits, full] if fit.status == "failed"), None)
    status = "ok" if failed is None else f"failed: {failed.reason}"
    return ScanResult(
        held_out.name, held_out.subject, status, tuple(_mean(fit) for fit in fits), _error(full)
    )


def curve_of(model: ComparedModel, results: Sequence[ScanResult]) -> PoseCurve:
    """Means and standard deviations over the scans that were fitted."""
    scored = [result for result in results if result.status == "ok"]
    by_components = np.array([result.by_components for result in scored])
    columns = by_components.reshape(len(scored), len(model.components)).T
    return PoseCurve(
        label=model.label,
        protocol=model.protocol.name,
        components=tuple(model.components),
        mean=tuple(Summary.of(column).mean for column in columns),
        sd=tuple(Summary.of(column).sd for column in columns),
        n_scans=len(scored),
        n_subjects=len({result.subject for result in scored}),
        full=Summary.of(np.array([result.full.mean for result in scored])),
        scans=tuple(results),
    )


def _mean(fit: ModelFit) -> float:
    return fit.s2m_mm.get("mean", float("nan"))


def _error(fit: ModelFit) -> ScanError:
    return ScanError(*(fit.s2m_mm.get(key, float("nan")) for key in ("mean", "median", "p95")))


def _check(compared: Sequence[ComparedModel], scans: Sequence[HeldOutScan]) -> None:
    labels = [model.label for model in compared]
    if len(set(labels)) != len(labels):
        raise ValueError(f"compared: labels must differ, got {labels}")
    for model in compared:
        missing = sorted({scan.hand for scan in scans} - set(model.models))
        if missing:
            raise ValueError(f"compared: {model.label!r} has no model for hand {missing[0]!r}")


# What a worker process compares: sent to it once, when it starts, and not with every job.
_WORK: list[tuple[Sequence[ComparedModel], Sequence[HeldOutScan]]] = []


def _begin(compared: Sequence[ComparedModel], scans: Sequence[HeldOutScan]) -> None:
    numba.set_num_threads(1)
    torch.set_num_threads(1)
    _WORK[:] = [(compared, scans)]


def _fit_job(job: tuple[int, int]) -> ScanResult:
    ((compared, scans),) = _WORK
    return fitted(compared[job[0]], scans[job[1]])


def _run(
    compared: Sequence[ComparedModel],
    scans: Sequence[HeldOutScan],
    jobs: list[tuple[int, int]],
    workers: int,
) -> Iterator[tuple[tuple[int, int], ScanResult]]:
    context = multiprocessing.get_context("spawn")
    with (
        single_threaded(),
        ProcessPoolExecutor(
            max(1, min(workers, len(jobs))),
            mp_context=context,
            initializer=_begin,
            initargs=(compared, scans),
        ) as pool,
    ):
        futures = {pool.submit(_fit_job, job): job for job in jobs}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
