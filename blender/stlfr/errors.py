"""Errors that end a command with one sentence on stderr."""


class BadInputError(Exception):
    """The user's input is wrong; exit code 2."""

    exit_code = 2


class FailureError(Exception):
    """The input is valid, but the work failed; exit code 1."""

    exit_code = 1
