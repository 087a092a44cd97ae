"""The exceptions of kinegrad: the errors of the command line, with their hints."""

from __future__ import annotations

__all__ = [
    "CheckpointError",
    "ConfigError",
    "DataError",
    "Error",
    "NotFiniteError",
    "StorageError",
    "UsageError",
]


class Error(Exception):
    """The base of all exceptions of kinegrad.

    Attributes:
        message: The problem, naming the file, key or argument.
        hint: A way to solve it, or `None`.
        exit_code: The exit code of the command line: 2 for invalid input, 1 if the run failed.
    """

    message: str
    hint: str | None
    exit_code: int

    def __init__(self, message: str, hint: str | None = None, exit_code: int = 2) -> None:
        super().__init__(message, hint, exit_code)
        self.message = message
        self.hint = hint or None
        self.exit_code = exit_code

    def __str__(self) -> str:
        return f"{self.message}\nhint: {self.hint}" if self.hint else self.message


class UsageError(Error, ValueError):
    """Arguments that contradict each other, or do not fit the model."""


class ConfigError(Error, ValueError):
    """An invalid key or value of a config."""


class DataError(Error, ValueError):
    """A dataset, motion or song that cannot be used."""


class CheckpointError(Error):
    """A run or checkpoint that is missing, damaged or does not fit."""


class NotFiniteError(Error, ArithmeticError):
    """A loss, gradient or sample with infinities or NaN."""


class StorageError(Error, OSError):
    """A file that cannot be read or written."""
