"""Rig files: one corpus for both readers, and what each complaint names."""

from __future__ import annotations

import json
import math
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from filming import CORPUS, IDENTITY, changed, errors, rig, rig_camera, rig_content


def refusal(path: Path, content: Any) -> str | None:
    """What Blender's reader says of a rig file, if it refuses it."""
    path.write_text(json.dumps(content), encoding="utf-8")
    try:
        rig.load(path)
    except errors.BadInputError as error:
        return str(error)
    return None


@pytest.mark.parametrize("changes", CORPUS["good"], ids=str)
def test_a_good_rig_is_read(tmp_path: Path, changes: dict[str, Any]) -> None:
    assert refusal(tmp_path / "rig.json", changed(changes)) is None


@pytest.mark.parametrize(("changes", "field"), CORPUS["bad"], ids=str)
def test_a_bad_rig_is_refused(
    tmp_path: Path, changes: dict[str, Any], field: str
) -> None:
    path = tmp_path / "rig.json"
    complaint = refusal(path, changed(changes))
    assert complaint is not None and complaint.startswith(f"{path}: ")
    assert field in complaint


def violations(schema: dict[str, Any], root: dict[str, Any]) -> Iterator[Any]:
    """Values that a schema of one field refuses."""
    if "$ref" in schema:
        schema = {**root["$defs"][schema["$ref"].rsplit("/")[-1]], **schema}
    kind = schema.get("type")
    yield None
    yield {"object": [], "array": {}, "string": 7}.get(str(kind), "text")
    for limit, beyond in (("minimum", -1), ("maximum", 1)):
        if limit in schema:
            yield (
                schema[limit] + beyond
                if kind == "integer"
                else np.nextafter(schema[limit], math.inf * beyond).item()
            )
    if "const" in schema or "enum" in schema:
        yield 5 if kind == "integer" else "other"
    if "pattern" in schema:
        yield from ("", "-a", "a b", "a/b", "ä")
    if kind == "array":
        items = schema.get("items", {})
        yield from ([value] for value in violations(items, root))
        count = schema.get("minItems")
        if count:
            yield []


def broken_rigs(schema: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Rigs that the schema refuses, one wrong field each."""
    camera_schema, view_schema = (
        schema["$defs"][name] for name in ("RigCamera", "RigView")
    )
    places = {
        "": schema,
        "cameras.1.": camera_schema,
        "views.0.": view_schema,
        "cameras.1.cam_from_rig.": schema["$defs"]["PoseFormat"],
        "cameras.1.distortion.": schema["$defs"]["Distortion"],
    }
    for prefix, part in places.items():
        assert part["additionalProperties"] is False
        yield f"{prefix}unknown", 1
        for field, field_schema in part["properties"].items():
            for value in violations(field_schema, schema):
                yield f"{prefix}{field}", value


def test_both_readers_refuse_what_the_schema_refuses(
    program: Path, tmp_path: Path
) -> None:
    schema = json.loads(
        subprocess.run(
            [program, "rig", "--schema", "rig"], check=True, capture_output=True
        ).stdout
    )
    path = tmp_path / "rig.json"
    count = 0
    base = {"cameras.1.distortion": {"k1": -0.1}}
    assert refusal(path, changed(base)) is None
    for field, value in broken_rigs(schema):
        complaint = refusal(path, changed({**base, field: value}))
        assert complaint is not None, (field, value)
        checked = subprocess.run([program, "rig", "--check", path], capture_output=True)
        assert checked.returncode == 2, (field, value, checked)
        assert checked.stderr.startswith(str(path).encode())
        count += 1
    for field in schema["required"] + [
        f"cameras.1.{f}" for f in schema["$defs"]["RigCamera"]["required"]
    ]:
        content = changed({})
        at: Any = content
        *parents, last = field.split(".")
        for step in parents:
            at = at[int(step) if step.isdecimal() else step]
        del at[last]
        assert refusal(path, content) is not None, field
        checked = subprocess.run([program, "rig", "--check", path], capture_output=True)
        assert checked.returncode == 2, field
    assert count > 120


def without(content: dict[str, Any], field: str) -> dict[str, Any]:
    return {name: value for name, value in content.items() if name != field}


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (
            rig_content(rig_camera("a"), format="rig"),
            'format must be "stlfr-rig", not "rig"',
        ),
        (rig_content(rig_camera("a"), version=2), "version must be 1, not 2"),
        (
            rig_content(rig_camera("a"), reference="b"),
            'reference names no camera of the rig: "b"',
        ),
        (
            rig_content(rig_camera("a"), colour="red"),
            "colour is not a field of this format",
        ),
        (without(rig_content(rig_camera("a")), "seed"), "seed is missing"),
        (
            rig_content(rig_camera("a"), cameras=[]),
            "cameras must hold at least one camera",
        ),
        (rig_content(rig_camera("a"), rig_camera("a")), 'have two entries with id "a"'),
        (rig_content(rig_camera("truth")), 'cameras[0].id can\'t be "truth"'),
        (rig_content(rig_camera("../a")), 'cameras[0].id can\'t be "../a"'),
        (
            rig_content(rig_camera("a", lens_mm=-1)),
            "cameras[0].lens_mm must be a number from 1 to 5000, not -1",
        ),
        (
            rig_content(rig_camera("a", width=64.5)),
            "cameras[0].width must be a whole number",
        ),
        (
            rig_content(rig_camera("a", jitter_s=0.01)),
            "cameras[0].jitter_s must be a number from 0 to",
        ),
        (
            rig_content(rig_camera("a", jitter_stamped=1)),
            "cameras[0].jitter_stamped must be true or false",
        ),
        (
            rig_content(rig_camera("a", color="blue")),
            'cameras[0].color must be "rgb" or "gray"',
        ),
        (
            rig_content(rig_camera("a", frames=3)),
            "cameras[0].frames is not a field of this format",
        ),
        (
            rig_content(
                rig_camera(
                    "a", cam_from_rig={**IDENTITY, "rotation_wxyz": [1, 1, 0, 0]}
                )
            ),
            "cameras[0].cam_from_rig.rotation_wxyz must have length 1, not 1.41421",
        ),
        (
            rig_content(
                rig_camera("a", cam_from_rig={**IDENTITY, "translation": [0, 0]})
            ),
            "cameras[0].cam_from_rig.translation must be 3 numbers",
        ),
        ([], "the file must be a JSON object"),
    ],
)
def test_a_bad_rig_is_refused_with_its_file_and_field(
    tmp_path: Path, content: Any, complaint: str
) -> None:
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(errors.BadInputError) as caught:
        rig.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert complaint in str(caught.value)


@pytest.mark.parametrize("text", ['{"format": NaN', '{"seed": 1, "seed": 2}', "\x00"])
def test_a_file_that_is_not_json_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "bad.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(errors.BadInputError, match="not valid JSON"):
        rig.load(path)
