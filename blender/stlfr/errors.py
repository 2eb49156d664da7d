"""Errors that end a command with one sentence on stderr."""


class BadInputError(Exception):
    """Something the user gave is wrong: exit code 2."""

    exit_code = 2


class FailureError(Exception):
    """The input is right and the work failed: exit code 1."""

    exit_code = 1
