"""The one error a user sees: a line that says what is wrong and what to do next."""


class UserError(Exception):
    """Input that cannot be used (unreadable file, bad option); the command exits with status 2."""


class UnfitDataError(UserError):
    """Readable data that cannot carry the question (no motion, no torque); the command exits with status 1."""
