"""How a model is learned: one record, one default in one place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class LearningOptions:
    """What is learned, and how strongly it is held back.

    Strengths are in observations: how many vertices, each of one registration, a prior outvotes.

    Attributes:
        sweeps: most passes over templates, poses, joints, correctives and weights.
        settled: a sweep that lowers the objective by a smaller share is the last.
        neutral_first: weigh registrations by equation 11 in the first templates.
        neutral_floor: least squared distance from the zero pose (the sum in equation 11): at 1 all fifteen
            joints of a hand are bent by 10 degrees. Equation 11 is singular at the zero pose.
        correctives: learn pose correctives.
        regularisation: "geodesic" (equation 10) or "constant" (SMPL).
        corrective_strength: of the correctives' prior at a distance of 1 cm. With 10 the hand in the box
            explained simulated bones a little worse (R^2 of 0.57 for 0.61 on people held out); two real
            hands, nearly flat, alike.
        constant_distance: metres of geodesic distance that the constant cost stands for.
        weights: learn skinning weights.
        weight_strength: of the start model's weights; a displacement of 1 cm per unit of weight is one
            observation.
        template_strength: of the start model's shape, per vertex of a personal template.
        joint_strength: least strength of the start model's joints.
        joint_share: strength of the start model's joints in a direction, as a share of what the registrations
            say less of it than of the direction that they say most of. It decides where a joint lies along an
            axis about which alone it turns.
        hinge_strength: of the axis of joints that recorded poses show to be hinges, in observations a
            centimetre away from it; 0 leaves them free.
        shape_count: most shape directions.
        start_shape_weight: of the start model's shape covariance, added to that of the learned people across
            their first component, the size; 0 is theirs alone. Thirty people do not span those that a model
            will meet: on two real hands the model of 31 simulated people alone was 1.4 and 2.4 mm off, with
            a weight of one 1.0 and 1.7, and with the mean of both covariances (refused) 1.1 and 1.8.
        mixture_components: of the pose mixture.
        trim: registrations that lie farther from the learned model than the median by so many median
            deviations are left out after the first sweeps; infinite keeps all.
        fewest_subjects: fewer are refused: their shape space would say nothing of other people.
        seed: of the mixture.
    """

    sweeps: int = 6
    settled: float = 2e-3
    neutral_first: bool = True
    neutral_floor: float = 1.0
    correctives: bool = True
    regularisation: Literal["geodesic", "constant"] = "geodesic"
    corrective_strength: float = 5.0
    constant_distance: float = 0.04
    weights: bool = True
    weight_strength: float = 20.0
    template_strength: float = 0.5
    joint_strength: float = 1.0
    joint_share: float = 0.005
    hinge_strength: float = 250.0
    shape_count: int = 30
    start_shape_weight: float = 0.0
    mixture_components: int = 10
    trim: float = 6.0
    fewest_subjects: int = 3
    seed: int = 0
