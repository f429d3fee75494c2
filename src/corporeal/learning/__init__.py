"""Registrations -> SurfaceModel: personal templates, pose correctives, skinning weights, joints, shape space."""
