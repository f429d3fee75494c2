"""The numbers of tracking: weights of equations 12-23 of Romero et al. 2017, found by experiment."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

HandPose = Literal["components", "full", "flat"]
HandPrior = Literal["mixture", "gaussian", "none"]


@dataclass(frozen=True)
class TrackingWeights:
    """Weights of the energies. Terms are half squares; metres and radians.

    Attributes:
        data: lambda_g, per scan point, times the annealing weight.
        body_pose: lambda_theta_b, over the annealing weight; of all frames of the first stage, where a wrong
            twist of a limb would go into the template, and of the first of the second (equations 12 and 22).
            In every frame of the second, the mixture's components take turns, and limbs jump with them.
        hand_pose: lambda_theta_h, over the annealing weight.
        shape: lambda_beta, first stage only.
        velocity: lambda_r, per joint (equation 21).
    """

    data: float = 50.0
    body_pose: float = 2e4
    hand_pose: float = 100.0
    shape: float = 1.0
    velocity: float = 300.0


@dataclass(frozen=True)
class AnnealingStep:
    """One solve of a frame.

    Attributes:
        weight: lambda_a.
        robust_scale: of Geman-McClure, metres.
        iterations: of dogleg, at most.
    """

    weight: float
    robust_scale: float
    iterations: int


@dataclass(frozen=True)
class FreeStage:
    """How free vertices follow the scan about a pose that is held.

    Attributes:
        coupling: lambda_c of their edges, over the annealing weight; edges relative to their length.
        robust_scale: of Geman-McClure, metres.
        passes: Gauss-Newton steps.
    """

    coupling: float
    robust_scale: float
    passes: int


@dataclass(frozen=True)
class TrackingBounds:
    """Beyond which a frame is doubtful or has failed.

    Attributes:
        doubtful_mm: mean distance of scan points to the model.
        again_mm: the same, for a second try from farther away.
        stray_share: share of the scan points over 6 cm from the model, for doubt, and for looking for an arm
            that was missing; a hand is 0.013 of a body.
        failed_mm: mean distance, for a failure.
        fewest_points: a frame with fewer is not fitted.
        covered_share: share of the model's area with scan beside it, under which a frame has failed.
        doubtful_share: the same, for doubt.
    """

    doubtful_mm: float = 4.0
    again_mm: float = 8.0
    stray_share: float = 0.006
    failed_mm: float = 15.0
    fewest_points: int = 500
    covered_share: float = 0.2
    doubtful_share: float = 0.5


@dataclass(frozen=True)
class TrackingOptions:
    """How a sequence is tracked; every ablation of the method is a field.

    Attributes:
        weights: of the energies.
        annealing: the solves of a frame (lambda_a from 100 to 500), the first with a wide robust scale. A
            scale of 3 mm at last was refused: of two strangers it brought one's hands from 5.2 to 4.6 mm and
            took the other's from 8.0 to 9.1.
        first: the solves of the first frame.
        retry: the solves of a frame that was lost, with a wider robust scale; the last as narrow as others'.
        hands: all 45 numbers, ``components`` per hand, or flat hands.
        components: per hand.
        hand_prior: the mixture, one Gaussian in its place, or none.
        velocity: False leaves the zero-velocity term out.
        free_vertices: a frame's surface follows the scan beyond the model (equation 23), off the hands; False
            leaves it the model's.
        template_free: the free vertices of the first stage (equation 20), which make the template. A loose
            coupling lets each frame follow its scan, and the mean over frames takes the noise out: with
            5e4, 1e4, 5e3 and 2e3 one stranger's body was 6.8, 6.4, 6.3 and 6.2 mm off in the second stage.
        frame_free: those of a tracked frame (equation 23), which follow the scan farther: bent skin may lie
            3 cm from the model. Of one sequence scans lie 1.1 mm from them, and 2.6 with the numbers of the
            first stage. Six passes in place of three took 0.3 s more of a frame and were 0.03 mm nearer.
        find_fingers: fingers that have lost their scan are looked for among recorded poses.
        predict: True starts a frame where the body's motion leads, False at the last frame as the paper does.
        samples: points drawn on a scan.
        body_points: of those, how many are fitted to; on the hands, and where the mesh is fine, all are.
        hand_weight: weight of a point on a hand.
        weigh_by_fineness: others weigh as much as the model's mesh is finer there than its mean, up to
            ``hand_weight``, in place of 1: toes are a tenth of a body's vertices and a hundredth of its skin,
            and lay 4 mm back.
        coarse_weight: at least they weigh this; with 0.3 an arm that came back elsewhere was found three
            frames later.
        template_coarse_weight: the same in the first stage. With 1 trunk and limbs, where others' skin
            differs most, drew hands and feet along: one stranger was 5.4 mm off and visible hands 3.8, with
            0.3 4.8 and 3.2.
        hand_back: weight of distances back from hands to the scan, as a share of the data's.
        minimum_cosine: pairs whose normals disagree more are not matched.
        template_frames: of the first stage, at most.
        place_joints: a body's joints are placed in the subject's skin by the frames of the first stage, which
            are then gone through once more.
        shape_count: shape numbers of the first stage, at most those that the model has.
        bounds: of the verdict.
        seed: of the points drawn.
    """

    weights: TrackingWeights = field(default_factory=TrackingWeights)
    annealing: tuple[AnnealingStep, ...] = (AnnealingStep(100.0, 0.1, 4), AnnealingStep(500.0, 0.01, 5))
    first: tuple[AnnealingStep, ...] = (AnnealingStep(100.0, 0.03, 10), AnnealingStep(500.0, 0.01, 15))
    retry: tuple[AnnealingStep, ...] = (
        AnnealingStep(100.0, 0.15, 12), AnnealingStep(500.0, 0.02, 10), AnnealingStep(500.0, 0.01, 10)
    )  # fmt: skip
    hands: HandPose = "full"
    components: int = 6
    hand_prior: HandPrior = "mixture"
    velocity: bool = True
    free_vertices: bool = True
    template_free: FreeStage = FreeStage(coupling=2e3, robust_scale=0.02, passes=6)
    frame_free: FreeStage = FreeStage(coupling=5e3, robust_scale=0.03, passes=3)
    find_fingers: bool = True
    predict: bool = True
    samples: int = 48_000
    body_points: int = 5_000
    hand_weight: float = 6.0
    weigh_by_fineness: bool = True
    coarse_weight: float = 1.0
    template_coarse_weight: float = 0.3
    hand_back: float = 1.5
    minimum_cosine: float = 0.3
    template_frames: int = 50
    place_joints: bool = True
    shape_count: int = 25
    bounds: TrackingBounds = field(default_factory=TrackingBounds)
    seed: int = 0

    def __post_init__(self) -> None:
        if self.samples < 1 or self.body_points < 1 or self.template_frames < 1:
            raise ValueError("samples, body_points, template_frames: expected at least 1")
        if not self.annealing or not self.first or not self.retry:
            raise ValueError("annealing, first, retry: expected at least one step each")
