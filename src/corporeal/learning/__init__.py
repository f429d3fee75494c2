"""Registrations -> SurfaceModel: templates, pose correctives, skinning weights, joints, shape space."""
