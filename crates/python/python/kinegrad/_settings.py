"""Settings in Python as the `KEY=VALUE` overrides of the command line."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from typing import Any, Callable, Union

Path = Union[str, "os.PathLike[str]"]

Progress = Callable[[str, int, int], object]


def overrides(settings: Mapping[str, Any] | Sequence[str] | None) -> list[str]:
    """`{"optim.learning_rate": 1e-4}` as `["optim.learning_rate=0.0001"]`; lists are unchanged.

    Raises:
        TypeError: For a value that a config cannot contain.
    """
    if settings is None:
        return []
    if isinstance(settings, str):
        raise TypeError('settings are a dict such as {"optim.learning_rate": 1e-4}, or a list')
    if not isinstance(settings, Mapping):
        return [str(setting) for setting in settings]
    return [f"{key}={_toml(value)}" for key, value in settings.items()]


def _toml(value: Any) -> str:
    """A value in TOML, which equals JSON for numbers, strings, booleans and lists."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(k)} = {_toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    if isinstance(value, os.PathLike):
        value = os.fspath(value)
    if hasattr(value, "item"):  # a NumPy scalar
        value = value.item()
    if value is None or not isinstance(value, (bool, int, float, str)):
        raise TypeError(f"a config cannot contain {value!r}")
    return json.dumps(value)
