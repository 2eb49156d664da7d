"""Compares two builds of the program on the same captures: whether results are byte-identical, and how long they take.

    python3 tests/bench/same_results.py OLD NEW CAPTURE [CAPTURE ...] [--runs 3] [--rename old_key=new_key ...]

OLD and NEW are binaries, run alternately. Each estimates the offsets, and renders synchronized images by every method,
views by every preset, slow motion and a trail. If the capture has ground truth, it also runs `stlfr compare`. Captures
are copied, so that the builds don't share caches. If files differ, their names are printed, and the exit code is 1.

`--rename` replaces a field name in the JSON files of both builds before they are compared. `report.html`,
`review.blend` and `timings.json` are not compared, because they contain sentences and durations.
"""

import argparse
import json
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

METHODS = ("nearest", "crossfade", "triangulation", "morph", "edge-morph", "refined")
PRESETS = ("draft", "balanced", "best")
WORDS_AND_DURATIONS = {"report.html", "review.blend", "timings.json"}


def view_beside(capture: Path) -> dict[str, Any]:
    """The camera object of a view a third of the way from the second camera to the third camera."""
    cameras = json.loads((capture / "capture.json").read_text())["cameras"]
    first, second = (cameras[min(k, len(cameras) - 1)] for k in (1, 2))
    view = {
        k: first[k] for k in ("width", "height", "model", "params", "cam_from_world")
    }
    ends = [camera["cam_from_world"]["translation"] for camera in (first, second)]
    between = [a + (b - a) / 3 for a, b in zip(*ends, strict=True)]
    return view | {"cam_from_world": first["cam_from_world"] | {"translation": between}}


def steps(capture: Path, out: Path, view: Path) -> dict[str, list[list[str]]]:
    """The commands of each measured step by its name; the arguments lack the binary."""
    clock = json.loads((capture / "capture.json").read_text())["cameras"][0]["clock"]
    times = clock.get("times_s") or [
        clock["first_s"] + k / clock["rate_hz"] for k in range(3)
    ]
    middle = 0.5 * (times[len(times) // 2 - 1] + times[len(times) // 2])
    at = ["--time", f"{middle:.6f}"]
    span = ["--times", f"{middle:.6f}:{middle + 0.02:.6f}:3"]
    like = ["render", str(capture), "--like", "cam2", *at]
    free = ["render", str(capture), "--camera", str(view)]
    renders = [[*like, "--sync", m, "-o", str(out / f"{m}.png")] for m in METHODS]
    renders += [
        [*free, *at, "--preset", p, "-o", str(out / f"{p}.png")] for p in PRESETS
    ]
    renders += [
        [*free, *at, "--proxy", "plane", "-o", str(out / "plane.png")],
        [*free, *span, "-o", str(out / "slow%d.png")],
        [
            *like,
            "--trail",
            "0.03",
            "--trail-instants",
            "4",
            "-o",
            str(out / "trail.png"),
        ],
    ]
    measured = {"offsets": [["offsets", str(capture), "--json"]], "render": renders}
    if (capture / "truth").is_dir():
        measured["compare"] = [["compare", str(capture), "-o", str(out / "review")]]
    return measured


def run(binary: str, original: Path, folder: Path) -> dict[str, float]:
    """Run every step by one binary on a new copy of a capture; outputs are written into `folder/out`.

    Returns the wall time of each step, seconds.
    """
    shutil.rmtree(folder, ignore_errors=True)
    capture, out, view = folder / "capture", folder / "out", folder / "view.json"
    ignored = shutil.ignore_patterns(".stlfr", "offsets.*", "review")
    shutil.copytree(original, capture, ignore=ignored)
    out.mkdir()
    view.write_text(json.dumps(view_beside(capture)))
    seconds = {}
    for name, commands in steps(capture, out, view).items():
        start = time.monotonic()
        for command in commands:
            done = subprocess.run(
                [binary, "-q", *command], check=True, capture_output=True
            )
            if name == "offsets":
                (out / "offsets.json").write_bytes(done.stdout)
        seconds[name] = time.monotonic() - start
    shutil.copy(capture / "offsets.svg", out)
    return seconds


def renamed(value: Any, names: dict[str, str]) -> Any:
    """A JSON value with renamed fields; `names` maps old names to new names."""
    if isinstance(value, dict):
        return {names.get(k, k): renamed(v, names) for k, v in value.items()}
    return [renamed(v, names) for v in value] if isinstance(value, list) else value


def differing(old: Path, new: Path, names: dict[str, str]) -> tuple[int, list[str]]:
    """The number of compared files, and the names of files that differ or exist in only one of the folders."""
    files = [
        {p.relative_to(f) for p in f.rglob("*") if p.is_file()} for f in (old, new)
    ]
    found = [
        str(name)
        for name in files[0] ^ files[1]
        if name.name not in WORDS_AND_DURATIONS
    ]
    both = [
        name
        for name in sorted(files[0] & files[1])
        if name.name not in WORDS_AND_DURATIONS
    ]
    for name in both:
        a, b = (old / name).read_bytes(), (new / name).read_bytes()
        if name.name in ("metrics.json", "review.json"):
            a, b = (renamed(json.loads(text), names) for text in (a, b))
            for content in (a, b):
                content.pop("version", None)
        if a != b:
            found.append(str(name))
    return len(both), found


def main() -> int:
    """Run both builds on all captures, and print the results. Returns the exit code: 1 if files differ."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old")
    parser.add_argument("new")
    parser.add_argument("captures", nargs="+", type=Path)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--rename", action="append", default=[], metavar="OLD=NEW")
    arguments = parser.parse_args()
    names = dict(pair.split("=") for pair in arguments.rename)
    builds = {"old": arguments.old, "new": arguments.new}
    all_same = True
    with tempfile.TemporaryDirectory() as folder:
        for capture in arguments.captures:
            seconds: dict[str, list[dict[str, float]]] = {"old": [], "new": []}
            for _ in range(arguments.runs):
                for name, binary in builds.items():
                    seconds[name].append(run(binary, capture, Path(folder, name)))
            count, found = differing(
                Path(folder, "old/out"), Path(folder, "new/out"), names
            )
            all_same &= not found
            print(
                f"{capture.name}: {count} files, {', '.join(found) or 'all the same'}"
            )
            for step in seconds["old"][0]:
                old, new = (
                    statistics.median(run[step] for run in seconds[b])
                    for b in ("old", "new")
                )
                print(f"  {step:8} {old:7.2f} s, {new:7.2f} s: {new / old:.2f}")
    return 0 if all_same else 1


if __name__ == "__main__":
    sys.exit(main())
