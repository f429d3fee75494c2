import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from corporeal.geometry import rotations, rotations_numeric

TO_MATRIX = {
    "axis_angle": rotations.matrix_from_axis_angle,
    "quaternion": rotations.matrix_from_quaternion,
    "6d": rotations.matrix_from_6d,
}
FROM_MATRIX = {
    "axis_angle": rotations.axis_angle_from_matrix,
    "quaternion": rotations.quaternion_from_matrix,
    "6d": rotations.sixd_from_matrix,
}
# At 0, where series take over (squared angle 1e-3), in the middle, near pi and at pi.
ANGLES = (0.0, 1e-160, 1e-9, 1e-4, 0.0316, 0.0317, 1.0, 2.0, np.pi - 1e-3, np.pi - 1e-8, np.pi)
AXES = ((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0), (0.6, 0, 0.8), (-0.6, 0.48, 0.64), (-1.0, 0, 0))


def vectors():
    return np.concatenate([angle * np.array(AXES) for angle in ANGLES])


def turned(matrix, turn):
    """exp(turn) matrix: a step on the manifold."""
    return rotations.matrix_from_axis_angle(turn) @ matrix


def test_matrices_agree_with_scipy():
    points = vectors()
    wanted = Rotation.from_rotvec(points).as_matrix()
    np.testing.assert_allclose(rotations.matrix_from_axis_angle(torch.tensor(points)), wanted, atol=4e-16)
    np.testing.assert_allclose(rotations_numeric.matrix_from_axis_angle(points), wanted, atol=4e-16)


def test_quaternions_agree_with_scipy(rng):
    quaternions = rng.standard_normal((200, 4))
    wanted = Rotation.from_quat(quaternions[:, [1, 2, 3, 0]])
    matrices = rotations.matrix_from_quaternion(torch.tensor(quaternions))
    np.testing.assert_allclose(matrices, wanted.as_matrix(), atol=1e-15)
    canonical = wanted.as_quat(canonical=True)[:, [3, 0, 1, 2]]
    np.testing.assert_allclose(rotations.quaternion_from_matrix(matrices), canonical, atol=1e-15)
    np.testing.assert_allclose(
        rotations_numeric.quaternion_from_matrix(matrices.numpy()), canonical, atol=1e-15
    )
    np.testing.assert_allclose(
        rotations.axis_angle_from_quaternion(torch.tensor(quaternions)), wanted.as_rotvec(), atol=2e-15
    )
    np.testing.assert_allclose(
        rotations_numeric.axis_angle_from_quaternion(quaternions), wanted.as_rotvec(), atol=2e-15
    )


def test_6d_is_the_orthonormalised_pair_of_columns(rng):
    six = torch.tensor(rng.standard_normal((50, 6)))
    matrices = rotations.matrix_from_6d(six)
    q, r = np.linalg.qr(six.reshape(50, 2, 3).transpose(1, 2).numpy())
    q = q * np.sign(np.einsum("nii->ni", r))[:, None, :]
    np.testing.assert_allclose(matrices[..., :2], q, atol=1e-14)
    np.testing.assert_allclose(torch.linalg.det(matrices), 1, atol=1e-14)


@pytest.mark.parametrize("representation", TO_MATRIX)
def test_there_and_back_is_exact_everywhere(representation):
    matrices = rotations.matrix_from_axis_angle(torch.tensor(vectors()))
    numbers = FROM_MATRIX[representation](matrices)
    np.testing.assert_allclose(TO_MATRIX[representation](numbers), matrices, atol=2e-15)


def test_the_logarithm_inverts_the_exponential_with_relative_accuracy():
    points = vectors()
    inside = np.linalg.norm(points, axis=1) < np.pi - 1e-4
    back = rotations.axis_angle_from_matrix(rotations.matrix_from_axis_angle(torch.tensor(points[inside])))
    np.testing.assert_allclose(back, points[inside], rtol=1e-12, atol=1e-300)
    numeric = rotations_numeric.axis_angle_from_matrix(
        rotations_numeric.matrix_from_axis_angle(points[inside])
    )
    np.testing.assert_allclose(numeric, points[inside], rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("representation", TO_MATRIX)
def test_gradients_are_finite_everywhere(representation, dtype):
    matrices = rotations.matrix_from_axis_angle(torch.tensor(vectors(), dtype=dtype)).requires_grad_()
    numbers = FROM_MATRIX[representation](matrices)
    assert numbers.dtype == dtype
    (numbers * torch.arange(1.0, 1 + numbers.shape[-1])).sum().backward()
    assert torch.isfinite(matrices.grad).all()
    leaf = numbers.detach().requires_grad_()
    (TO_MATRIX[representation](leaf) * torch.arange(1.0, 10).reshape(3, 3)).sum().backward()
    assert torch.isfinite(leaf.grad).all()


@pytest.mark.parametrize("representation", TO_MATRIX)
def test_jacobians_to_matrices_agree_with_differences(representation):
    matrices = rotations.matrix_from_axis_angle(torch.tensor(vectors()))
    numbers = FROM_MATRIX[representation](matrices).requires_grad_()
    assert torch.autograd.gradcheck(TO_MATRIX[representation], numbers, eps=1e-6, atol=1e-8, rtol=1e-6)


@pytest.mark.parametrize("representation", FROM_MATRIX)
def test_jacobians_from_matrices_agree_with_differences_along_the_manifold(representation, rng):
    # At pi itself the logarithm jumps: there only finiteness and one-sided agreement can hold.
    points = torch.tensor(vectors())
    points = points[points.norm(dim=-1) < np.pi - 1e-4]
    matrices = rotations.matrix_from_axis_angle(points)
    turn = torch.zeros_like(points).requires_grad_()
    direction = torch.tensor(rng.standard_normal(points.shape))
    value, derivative = torch.autograd.functional.jvp(
        lambda turn: FROM_MATRIX[representation](turned(matrices, turn)), turn, direction
    )
    step = 1e-6
    plus = FROM_MATRIX[representation](turned(matrices, step * direction))
    minus = FROM_MATRIX[representation](turned(matrices, -step * direction))
    np.testing.assert_allclose(derivative, (plus - minus) / (2 * step), rtol=1e-6, atol=1e-8)
    assert torch.isfinite(value).all()


@pytest.mark.parametrize("angle", [np.pi - 1e-9, np.pi])
def test_the_logarithm_has_the_one_sided_derivative_at_a_half_turn(angle):
    # The axis is recovered with one sign; a step towards smaller angles stays on that branch.
    axes = torch.tensor(AXES, dtype=torch.float64)
    matrices = rotations.matrix_from_axis_angle(angle * axes)
    at = rotations.axis_angle_from_matrix(matrices)
    turn = torch.zeros_like(axes).requires_grad_()
    _, derivative = torch.autograd.functional.jvp(
        lambda turn: rotations.axis_angle_from_matrix(turned(matrices, turn)),
        turn,
        -at / at.norm(dim=-1, keepdim=True),
    )
    np.testing.assert_allclose(derivative, -at / at.norm(dim=-1, keepdim=True), atol=1e-8)


def test_second_derivatives_at_zero():
    zero = torch.zeros(1, 3, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradgradcheck(rotations.matrix_from_axis_angle, zero)


def test_derivative_at_zero_is_the_generators():
    jacobian = torch.autograd.functional.jacobian(
        rotations.matrix_from_axis_angle, torch.zeros(3, dtype=torch.float64)
    )
    np.testing.assert_array_equal(
        jacobian.permute(2, 0, 1), rotations.skew(torch.eye(3, dtype=torch.float64))
    )


def test_left_jacobian_turns_steps_into_rotations(rng):
    points = vectors()
    direction = rng.standard_normal(points.shape)
    step = 1e-5

    def relative(sign):
        moved = Rotation.from_rotvec(points + sign * step * direction)
        return (moved * Rotation.from_rotvec(points).inv()).as_rotvec()

    wanted = (relative(1) - relative(-1)) / (2 * step)
    got = np.einsum("nij,nj->ni", rotations_numeric.left_jacobian(points), direction)
    np.testing.assert_allclose(got, wanted, atol=1e-9)


def test_half_angles_keep_the_way_beyond_pi(rng):
    axis_angle = rng.standard_normal((20, 3)) * 4
    quaternions = rotations_numeric.quaternion_from_axis_angle(axis_angle)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1, atol=1e-15)
    np.testing.assert_allclose(
        rotations.matrix_from_quaternion(torch.tensor(quaternions)),
        Rotation.from_rotvec(axis_angle).as_matrix(),
        atol=2e-15,
    )
    assert (quaternions[:, 0] < 0).any()


def test_any_leading_dimensions(rng):
    points = torch.tensor(rng.standard_normal((2, 4, 5, 3)), dtype=torch.float32)
    matrices = rotations.matrix_from_axis_angle(points)
    assert matrices.shape == (2, 4, 5, 3, 3)
    assert matrices.dtype == torch.float32
    for name, inverse in FROM_MATRIX.items():
        again = TO_MATRIX[name](inverse(matrices))
        np.testing.assert_allclose(again, matrices, atol=1e-6)
