"""Rig files and new rigs: the module `stlfr` checks and generates them as the command line does."""

from __future__ import annotations

import dataclasses
import json
import math
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import stlfr
from filming import (
    CORPUS,
    IDENTITY,
    changed,
    errors,
    native,
    rig,
    rig_camera,
    rig_content,
    run,
)


def refusal(path: Path, content: Any) -> str | None:
    """The error message when a rig file with this content is read for filming; None if it is accepted."""
    path.write_text(json.dumps(content), encoding="utf-8")
    try:
        rig.load(path)
    except errors.BadInputError as error:
        return str(error)
    return None


def by_command_line(program: Path, path: Path) -> str | None:
    """The command line's error message for a rig file; None if it accepts the file."""
    checked = run([str(program), "rig", "--check", str(path)])
    assert checked.returncode in (0, 2), checked
    return checked.stderr.removesuffix("\n") if checked.returncode else None


@pytest.mark.parametrize("changes", CORPUS["good"], ids=str)
def test_a_good_rig_is_read(tmp_path: Path, changes: dict[str, Any]) -> None:
    assert refusal(tmp_path / "rig.json", changed(changes)) is None
    stlfr.check_rig(changed(changes))


@pytest.mark.parametrize(("changes", "field"), CORPUS["bad"], ids=str)
def test_a_bad_rig_is_refused(
    tmp_path: Path, changes: dict[str, Any], field: str
) -> None:
    path = tmp_path / "rig.json"
    complaint = refusal(path, changed(changes))
    assert complaint is not None and complaint.startswith(f"{path}: ")
    assert field in complaint
    with pytest.raises(ValueError) as raised:
        stlfr.check_rig(changed(changes))
    assert f"{path}: {raised.value}" == complaint


def violations(schema: dict[str, Any], root: dict[str, Any]) -> Iterator[Any]:
    """Yields values that violate the JSON schema of one field; `root` is the whole schema."""
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
    if "maxLength" in schema:
        yield "a" * (schema["maxLength"] + 1)
    if kind == "array":
        items = schema.get("items", {})
        yield from ([value] for value in violations(items, root))
        count = schema.get("minItems")
        if count:
            yield []


def broken_rigs(schema: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yields the names and contents of rigs that violate the schema, each in one field."""
    camera_schema, view_schema = (
        schema["$defs"][name] for name in ("RigCamera", "RigView")
    )
    places = {
        "": schema,
        "cameras.1.": camera_schema,
        "views.0.": view_schema,
        "cameras.1.cam_from_rig.": schema["$defs"]["PoseFormat"],
        "cameras.1.distortion.": schema["$defs"]["RigDistortion"],
    }
    for prefix, part in places.items():
        assert part["additionalProperties"] is False
        yield f"{prefix}unknown", 1
        for field, field_schema in part["properties"].items():
            for value in violations(field_schema, schema):
                yield f"{prefix}{field}", value


@pytest.fixture(scope="module")
def schema(program: Path) -> Any:
    """The JSON schema of rig files, as the program prints it."""
    printed = subprocess.run(
        [program, "rig", "--schema", "rig"], check=True, capture_output=True
    )
    return json.loads(printed.stdout)


def test_what_the_schema_refuses_is_refused_as_by_the_command_line(
    schema: Any, program: Path, tmp_path: Path
) -> None:
    path = tmp_path / "rig.json"
    count = 0
    base = {"cameras.1.distortion": {"k1": -0.1}}
    assert refusal(path, changed(base)) is None
    for field, value in broken_rigs(schema):
        complaint = refusal(path, changed({**base, field: value}))
        assert complaint is not None, (field, value)
        assert complaint.startswith(str(path))
        assert by_command_line(program, path) == complaint, (field, value)
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
        complaint = refusal(path, content)
        assert complaint is not None and last in complaint, field
        assert by_command_line(program, path) == complaint, field
    assert count > 120


def test_filmings_defaults_are_the_formats(schema: Any, tmp_path: Path) -> None:
    """If a field has filming's default value, the module omits it, so both have the same default."""
    path = tmp_path / "rig.json"
    content = changed({})
    path.write_text(json.dumps(content))
    assert native.read_rig(path) == content
    camera, view = rig.from_content(content).cameras[1], rig.from_content(content).views
    for kind, place, used in (
        ("RigCamera", "cameras.1", camera),
        ("RigView", "views.0", view[0]),
    ):
        parts = schema["$defs"][kind]
        optional = set(parts["properties"]) - set(parts["required"])
        assert len(optional) == (16 if kind == "RigCamera" else 2)
        for name in optional:
            value = getattr(used, name)
            if dataclasses.is_dataclass(value) and not isinstance(value, type):
                value = dataclasses.asdict(value)
            path.write_text(json.dumps(changed({f"{place}.{name}": value})))
            assert native.read_rig(path) == content, name


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
        (rig_content(rig_camera("a"), colour="red"), "unknown field `colour`"),
        (without(rig_content(rig_camera("a")), "seed"), "missing field `seed`"),
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
            "cameras[0].width: invalid type: floating point `64.5`",
        ),
        (
            rig_content(rig_camera("a", jitter_s=0.01)),
            "cameras[0].jitter_s must be a number from 0 to",
        ),
        (
            rig_content(rig_camera("a", jitter_stamped=1)),
            "cameras[0].jitter_stamped: invalid type: integer `1`, expected a boolean",
        ),
        (
            rig_content(rig_camera("a", color="blue")),
            "cameras[0].color: unknown variant `blue`, expected `rgb` or `gray`",
        ),
        (
            rig_content(rig_camera("a", frames=3)),
            "cameras[0].frames: unknown field `frames`",
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
            "cameras[0].cam_from_rig.translation: invalid length 2",
        ),
        ([], "invalid type: sequence, expected an object"),
    ],
)
def test_a_bad_rig_is_refused_with_its_file_and_field(
    tmp_path: Path, content: Any, complaint: str
) -> None:
    path = tmp_path / "bad.json"
    found = refusal(path, content)
    assert found is not None and found.startswith(f"{path}: ")
    assert complaint in found


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('{"format": NaN', "format: expected value"),
        ('{"seed": 1, "seed": 2}', "duplicate field `seed`"),
        ("\x00", "is no JSON: expected value"),
    ],
)
def test_a_file_that_is_not_json_is_refused(
    tmp_path: Path, text: str, complaint: str
) -> None:
    path = tmp_path / "bad.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(errors.BadInputError) as caught:
        rig.load(path)
    assert str(caught.value).startswith(f"{path}: {complaint}")


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(errors.BadInputError, match=r"none\.json: No such file"):
        rig.load(tmp_path / "none.json")


# New rigs


@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        ("line", {}),
        ("line --count 3 --seed 9007199254740992", {"layout": {"line": {"count": 3}}}),
        (
            "grid --rows 3 --columns 2 --rate 24,60 --drift 80 --lost 2 --lost-stamps mixed --jitter 0",
            {
                "layout": {"grid": {"rows": 3, "columns": 2}},
                "rates_hz": [24, 60],
                "jitters_s": [0],
                "max_drift_ppm": 80,
                "loss": {"count": 2, "within": 9, "stamps": "mixed"},
            },
        ),
        (
            "arc --distance 1.5 --spacing 0.1 --delays 0,0.01 --distortion=-0.1,0,0,0 --color gray,rgb",
            {
                "layout": {"arc": {"count": 8, "distance_m": 1.5}},
                "spacing_m": 0.1,
                "delays": {"listed": [0, 0.01]},
                "distortion": {"k1": -0.1},
                "colors": ["gray", "rgb"],
            },
        ),
    ],
)
def test_a_generated_rig_is_the_command_lines(
    program: Path, tmp_path: Path, arguments: str, options: dict[str, Any]
) -> None:
    """The same options and seed give exactly the same JSON, with the same order and digits."""
    seed = 2**53 if "--seed" in arguments else 7
    more = [] if "--seed" in arguments else ["--seed", "7"]
    path = tmp_path / "mine.json"
    command = [str(program), "rig", *arguments.split(), *more, "-o", str(path)]
    assert run(command).returncode == 0
    made = stlfr.generate_rig({**options, "name": "mine", "seed": seed})
    assert json.dumps(made) == json.dumps(json.loads(path.read_text()))
    assert native.read_rig(path) == made


def test_a_grid_stands_about_the_rigs_centre(tmp_path: Path) -> None:
    options = {"layout": {"grid": {"rows": 2, "columns": 4}}, "seed": 3}
    made = rig.from_content(stlfr.generate_rig(options))
    assert made.reference == "cam1" and len(made.cameras) == 8
    places = [-np.array(c.cam_from_rig.translation_m) for c in made.cameras]
    np.testing.assert_allclose(places[0], [-0.09, -0.03, 0], atol=1e-9)
    np.testing.assert_allclose(places[7], [0.09, 0.03, 0], atol=1e-9)
    delays = [c.delay_s for c in made.cameras]
    assert all(0 <= d < 1 / 30 for d in delays) and len(set(delays)) == 8
    assert stlfr.generate_rig(options) == stlfr.generate_rig(options)
    other = stlfr.generate_rig({**options, "seed": 4})
    assert [c["delay_s"] for c in other["cameras"]] != delays


@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        ("line --rate 30,0", {"rates_hz": [30, 0]}),
        ("line --name a/b", {"name": "a/b"}),
        (
            "arc --distance 0.1",
            {"layout": {"arc": {"count": 8, "distance_m": 0.1}}},
        ),
        (
            "line --lost 9",
            {"loss": {"count": 9, "within": 9, "stamps": "stamped"}},
        ),
    ],
)
def test_a_rig_that_cannot_be_is_refused_as_by_the_command_line(
    program: Path, arguments: str, options: dict[str, Any]
) -> None:
    with pytest.raises(ValueError) as raised:
        stlfr.generate_rig(options)
    printed = run([str(program), "rig", *arguments.split()])
    assert (printed.returncode, printed.stderr) == (2, f"{raised.value}\n")


def test_wrong_options_of_a_rig_are_named() -> None:
    for options, complaint in (
        ({"speed": 1}, "options: speed: unknown field `speed`"),
        ({"layout": {"line": {"count": 0}}}, "options: layout.line.count: "),
        ([], "options: invalid type: sequence"),
    ):
        with pytest.raises(ValueError) as raised:
            stlfr.generate_rig(options)  # type: ignore[arg-type]
        assert str(raised.value).startswith(complaint)


# COLMAP's text


def test_colmaps_text_is_written_as_python_spells_numbers() -> None:
    """Numbers have the fewest digits that give the same double.

    From 1e10 on, Rust and Python may round ties differently.
    """
    random = np.random.default_rng(6)
    for _ in range(200):
        values = (random.normal(size=9) * 10.0 ** random.integers(-300, 6, 9)).tolist()
        pose = {"rotation_wxyz": values[:4], "translation": values[4:7]}
        camera = {"width": 64, "height": 48, "model": "SIMPLE_PINHOLE"}
        camera |= {"params": values[7:], "cam_from_world": pose}
        files = stlfr.colmap_text([("a/0000.png", camera), ("b/0000.png", camera)])
        lens, place = (" ".join(map(repr, v)) for v in (values[7:], values[:7]))
        assert files["cameras.txt"].splitlines()[1:] == [
            f"{n} SIMPLE_PINHOLE 64 48 {lens}" for n in (1, 2)
        ]
        lines = [f"{n} {place} {n} {name}/0000.png" for n, name in ((1, "a"), (2, "b"))]
        assert files["images.txt"].splitlines()[2:] == [lines[0], "", lines[1], ""]
        assert files["points3D.txt"].startswith("#")


def test_colmaps_text_has_cameras_alone() -> None:
    with pytest.raises(ValueError, match=r"images: \[0\]\[1\].*`width`"):
        stlfr.colmap_text([("a/0000.png", {"height": 48})])
    pose = {"rotation_wxyz": [1, 0, 0, 0], "translation": [0, 0, 0]}
    camera = {"width": 64, "height": 48, "model": "PINHOLE", "cam_from_world": pose}
    camera |= {"params": [60, 60, 32, 24]}
    with pytest.raises(ValueError, match=r"images\[1\]: .* is no name of an image"):
        stlfr.colmap_text([("a/0000.png", camera), ("b\nc", camera)])
    whole = {**camera, "id": "a", "frames": "a/%d.png", "clock": {"times_s": [0.0]}}
    assert stlfr.colmap_text([("a", whole)]) == stlfr.colmap_text([("a", camera)])
