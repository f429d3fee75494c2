import dataclasses

from corporeal.registration.options import RegistrationOptions


def test_options_for_sessions_only_save_points_and_steps():
    usual, session = RegistrationOptions(), RegistrationOptions.for_sessions()
    for stages in ("surface", "free"):
        for one, other in zip(getattr(usual, stages), getattr(session, stages), strict=True):
            assert other.points < one.points and other.iterations < one.iterations
            assert dataclasses.replace(other, points=one.points, iterations=one.iterations) == one
    assert dataclasses.replace(session, surface=usual.surface, free=usual.free, bounds=usual.bounds) == usual
