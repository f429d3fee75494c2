"""Preconditioned L-BFGS."""

import numpy as np

from corporeal.solve.quasi_newton import QuasiNewtonOptions, descend


def quadratic(rng, size=12, condition=1e3):
    Q = np.linalg.qr(rng.normal(size=(3 * size, 3 * size)))[0]
    A = Q @ np.diag(np.geomspace(1, condition, 3 * size)) @ Q.T
    x = rng.normal(size=(size, 3))

    def energy(p):
        d = (p - x).ravel()
        return float(0.5 * d @ A @ d), (A @ d).reshape(-1, 3)

    return energy, x, A


def test_it_finds_the_minimum_of_a_bad_quadratic(rng):
    energy, x, _ = quadratic(rng)
    options = QuasiNewtonOptions(iterations=1000, tolerance=1e-10, memory=30)
    found = descend(energy, np.zeros_like(x), lambda g: g / 1e3, options)
    assert found.converged
    np.testing.assert_allclose(found.x, x, atol=1e-6)


def test_the_exact_inverse_needs_few_steps(rng):
    energy, x, A = quadratic(rng)
    inverse = np.linalg.inv(A)
    options = QuasiNewtonOptions(tolerance=1e-9)
    found = descend(energy, np.zeros_like(x), lambda g: (inverse @ g.ravel()).reshape(-1, 3), options)
    assert found.iterations <= 5
    np.testing.assert_allclose(found.x, x, atol=1e-8)


def test_the_energy_never_rises(rng):
    energy, x, _ = quadratic(rng)
    values = []

    def watched(p):
        value, gradient = energy(p)
        values.append(value)
        return value, gradient

    before = energy(np.zeros_like(x))[0]
    last = before
    for iterations in (1, 5, 20):
        found = descend(
            watched, np.zeros_like(x), lambda g: g / 1e3, QuasiNewtonOptions(iterations=iterations)
        )
        assert found.energy < last
        last = found.energy


def test_too_few_steps_are_said(rng):
    energy, x, _ = quadratic(rng)
    found = descend(energy, np.zeros_like(x), lambda g: g / 1e3, QuasiNewtonOptions(iterations=3))
    assert not found.converged
    assert found.iterations == 3


def test_an_energy_that_changes_on_the_way_is_followed(rng):
    target = {"x": rng.normal(size=(5, 3))}
    final = rng.normal(size=(5, 3))

    def energy(p):
        return float(0.5 * ((p - target["x"]) ** 2).sum()), p - target["x"]

    def refresh(_):
        target["x"] = final
        return True

    options = QuasiNewtonOptions(tolerance=1e-10, refresh_every=1)
    found = descend(energy, np.zeros((5, 3)), lambda g: 0.5 * g, options, refresh)
    np.testing.assert_allclose(found.x, final, atol=1e-8)
