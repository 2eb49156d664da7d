"""Pack the Blender extension: `python -I blender/package.py WHEEL -o OUT.zip`.

The zip file holds the folder stlfr/, the filming script, the wheel of the compiled module, and the extension's
manifest, which lists this wheel and its platform. The platform is printed. Blender's own tool builds and validates the
zip file. An error is one sentence on stderr, with exit code 2 for bad input and 1 for a failure.
"""

from __future__ import annotations

import argparse
import importlib.util
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent

PLATFORMS = {
    r"(many)?linux.*_x86_64": "linux-x64",
    r"(many)?linux.*_aarch64": "linux-arm64",
    r"macosx_.*_x86_64": "macos-x64",
    r"macosx_.*_arm64": "macos-arm64",
    r"win_amd64": "windows-x64",
    r"win_arm64": "windows-arm64",
}
"""Blender's names of platforms, by regular expressions for the platform tags of Python wheels."""


class PackageError(Exception):
    """An error while packing the extension; its message is one sentence for the user."""


def pack(wheel: Path, output: Path) -> str:
    """Build the zip file, validate it, and only then copy it to `output`. Returns Blender's name of its platform."""
    template = HERE / "stlfr" / "blender_manifest.toml"
    platform, manifest = manifest_with(wheel, template)
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "stlfr"
        shutil.copytree(
            HERE / "stlfr",
            folder,
            ignore=shutil.ignore_patterns("__pycache__", "*.pyc"),
        )
        for script in ("capture.py", "own_packages.py"):
            shutil.copyfile(HERE / script, folder / script)
        (folder / "wheels").mkdir()
        shutil.copyfile(wheel, folder / "wheels" / wheel.name)
        (folder / "blender_manifest.toml").write_text(manifest, encoding="utf-8")
        zip_file = Path(scratch) / "stlfr.zip"
        blender_tool("build", "--source-dir", folder, "--output-filepath", zip_file)
        blender_tool("validate", zip_file)
        shutil.copyfile(zip_file, output)
    return platform


def manifest_with(wheel: Path, manifest: Path) -> tuple[str, str]:
    """Blender's name of the wheel's platform, and the manifest's text with the wheel and the platform added.

    Raises `PackageError` if the wheel's name, version or platform doesn't suit the manifest.
    """
    text = manifest.read_text(encoding="utf-8")
    name, version, *_, tags = wheel.stem.split("-")
    expected = tomllib.loads(text)["version"]
    if (name, version) != ("stlfr", expected):
        raise PackageError(
            f"{wheel.name} is not the wheel of stlfr {expected}, the version in {manifest.name}"
        )
    platforms = {
        ours
        for part in tags.split(".")
        for pattern, ours in PLATFORMS.items()
        if re.fullmatch(pattern, part)
    }
    if len(platforms) != 1:
        raise PackageError(f"{wheel.name} is of no platform that Blender runs on")
    platform = platforms.pop()
    added = f'platforms = ["{platform}"]\nwheels = ["./wheels/{wheel.name}"]\n'
    head, tables, rest = text.partition("\n[permissions]")
    return platform, f"{head}{added}{tables}{rest}"


def blender_tool(*arguments: str | Path) -> None:
    """Run Blender's command line tool for extensions with these arguments. The tool is part of the module `bpy`.

    Raises `PackageError` if `bpy` isn't installed or the tool fails.
    """
    spec = importlib.util.find_spec("bpy")
    if spec is None or not spec.submodule_search_locations:
        raise PackageError("bpy isn't installed, which brings Blender's extension tool")
    root = Path(spec.submodule_search_locations[0])
    tools = sorted(root.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))
    if not tools:
        raise PackageError(f"{root} has no extension tool of Blender's")
    command = [sys.executable, "-I", "-B", str(tools[-1]), *map(str, arguments)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    if ended.returncode != 0:
        said = [line for line in (ended.stdout + ended.stderr).splitlines() if line]
        raise PackageError(
            f"Blender's extension tool refuses it: {said[-1] if said else ended.returncode}"
        )


def main() -> None:
    """Run the command; print an error as one sentence on stderr, and exit."""
    parser = argparse.ArgumentParser(description="Pack the Blender extension.")
    parser.add_argument("wheel", type=Path, help="wheel of the Python module stlfr")
    parser.add_argument("-o", dest="output", type=Path, required=True, metavar="ZIP")
    arguments = parser.parse_args()
    if not arguments.wheel.is_file():
        parser.exit(2, f"{arguments.wheel}: no such wheel\n")
    try:
        print(pack(arguments.wheel, arguments.output))
    except PackageError as error:
        sys.exit(str(error))
    except OSError as error:
        sys.exit(f"{error.filename2 or error.filename}: {error.strerror or error}")


if __name__ == "__main__":
    main()
