"""What goes wrong when models are joined."""


class MergeError(ValueError):
    """Models that cannot be joined; the message names which, and what to do."""
