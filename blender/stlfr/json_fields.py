"""A JSON file read field by field: what is missing, wrong or left over is one sentence. No `bpy` here."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

from .errors import BadInputError

RESERVED_IDS = {"truth", "colmap", "review"}
"""A camera's id names its folder in the capture, beside these."""


def read_fields(path: Path, kind: str) -> Fields:
    """The fields of a file, which is of a kind, as people call it."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise BadInputError(f"{path}: no such {kind}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"{path}: can't be read as a {kind} ({error})") from None
    try:
        content = json.loads(text, object_pairs_hook=_object_without_duplicates)
    except ValueError as error:
        raise BadInputError(f"{path}: not valid JSON ({error})") from None
    return Fields(content, str(path), "")


def _object_without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    names = [name for name, _ in pairs]
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"field {name} appears twice")
    return dict(pairs)


class Fields:
    """One JSON object, read field by field; what is left over at `done` is an error."""

    def __init__(self, content: Any, file: str, where: str) -> None:
        self.file = file
        self.where = where
        if not isinstance(content, dict):
            raise BadInputError(f"{file}: {where or 'the file'} must be a JSON object")
        self.content = dict(content)

    def name(self, field: str) -> str:
        return f"{self.where}.{field}" if self.where else field

    def error(self, field: str, problem: str) -> BadInputError:
        return BadInputError(f"{self.file}: {self.name(field)} {problem}")

    def take(self, field: str, default: Any = None) -> Any:
        if field in self.content:
            return self.content.pop(field)
        if default is None:
            raise self.error(field, "is missing")
        return default

    def text(self, field: str, default: str | None = None) -> str:
        value = self.take(field, default)
        if not isinstance(value, str) or not value:
            raise self.error(field, f"must be text, not {json.dumps(value)}")
        return value

    def identifier(self, field: str) -> str:
        value = self.text(field)
        if (
            not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]*", value)
            or value in RESERVED_IDS
        ):
            raise self.error(
                field,
                f"can't be {json.dumps(value)}: it names a folder or file of the capture",
            )
        return value

    def truth_value(self, field: str, default: bool) -> bool:
        value = self.take(field, default)
        if not isinstance(value, bool):
            raise self.error(field, f"must be true or false, not {json.dumps(value)}")
        return value

    def whole_number(
        self, field: str, minimum: int, maximum: int, default: int | None = None
    ) -> int:
        value = self.take(field, default)
        if (
            isinstance(value, bool)
            or not isinstance(value, int)
            or not minimum <= value <= maximum
        ):
            raise self.error(
                field,
                f"must be a whole number from {minimum} to {maximum}, not {json.dumps(value)}",
            )
        return value

    def whole_numbers(self, field: str, minimum: int, maximum: int) -> tuple[int, ...]:
        value = self.take(field, [])
        if not isinstance(value, list):
            raise self.error(field, "must be a list")
        for entry in value:
            if (
                isinstance(entry, bool)
                or not isinstance(entry, int)
                or not minimum <= entry <= maximum
            ):
                raise self.error(
                    field,
                    f"must be whole numbers from {minimum} to {maximum}, not {json.dumps(entry)}",
                )
        return tuple(value)

    def number(
        self, field: str, minimum: float, maximum: float, default: float | None = None
    ) -> float:
        value = self.take(field, default)
        if (
            isinstance(value, bool)
            or not isinstance(value, (int, float))
            or not minimum <= value <= maximum
        ):
            raise self.error(
                field,
                f"must be a number from {minimum:g} to {maximum:g}, not {json.dumps(value)}",
            )
        return float(value)

    def numbers(self, field: str, count: int) -> list[float]:
        value = self.take(field)
        if not isinstance(value, list) or len(value) != count:
            raise self.error(field, f"must be {count} numbers")
        for entry in value:
            if (
                isinstance(entry, bool)
                or not isinstance(entry, (int, float))
                or not abs(entry) <= 1e6
            ):
                raise self.error(
                    field,
                    f"must be {count} numbers within 1e6 of 0, not {json.dumps(entry)}",
                )
        return [float(entry) for entry in value]

    def objects(self, field: str, default: list[Any] | None = None) -> list[Fields]:
        value = self.take(field, default)
        if not isinstance(value, list):
            raise self.error(field, "must be a list")
        return [
            Fields(entry, self.file, f"{self.name(field)}[{i}]")
            for i, entry in enumerate(value)
        ]

    def done(self) -> None:
        for field in self.content:
            raise self.error(field, "is not a field of this format")
