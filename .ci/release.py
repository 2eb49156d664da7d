#!/usr/bin/env python3
"""Build and check what a release consists of, into a folder: `.ci/release.py [-o FOLDER]`. Nothing is uploaded.

- the crate, as `cargo package` packs, builds and checks it
- the wheel of the Python module and the command, for this machine's processor: abi3 for CPython 3.11 and newer, linked by
  zig for manylinux_2_17, with the licences of what it links; checked by auditwheel and twine, and tried in an empty
  environment by `test_wheel.py` and `release_wheel.py`
- the Blender extension, one zip a wheel, validated by Blender's own command
- SHA256SUMS

It builds the committed tree (HEAD), in a copy. The project's environment must be complete (`.ci/run`, or `stlfr setup`).
Wheels of other platforms, built on such machines, are taken from `--wheels FOLDER`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TOOLS = ROOT / ".venv.release"
PYTHON = ROOT / ".venv/bin/python"
COMPATIBILITY = "manylinux_2_17"
"""The oldest glibc that Rust's own targets run on."""
MAX_CRATE_BYTES = 10 << 20
"""The limit of crates.io."""
MAX_WHEEL_BYTES = 100 << 20
"""The limit of PyPI."""
LICENCE_FILES = ("LICENSE*", "LICENCE*", "COPYING*", "NOTICE*", "UNLICENSE*")


class ReleaseError(Exception):
    """One sentence for the user."""


def run(
    *command: str | Path, cwd: Path = ROOT, environment: dict[str, str] | None = None
) -> str:
    """Run a command, which has to succeed, with variables besides the present ones; its standard output."""
    return ended(*command, cwd=cwd, environment=environment).stdout


def ended(
    *command: str | Path, cwd: Path = ROOT, environment: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command, which has to succeed, with variables besides the present ones."""
    process = subprocess.run(
        [str(part) for part in command],
        cwd=cwd,
        env={**os.environ, **(environment or {})},
        capture_output=True,
        text=True,
        check=False,
    )
    if process.returncode != 0:
        raise ReleaseError(
            f"{process.stdout}{process.stderr}{' '.join(map(str, command))}: failed with status {process.returncode}"
        )
    return process


def say(sentence: str) -> None:
    """A line of progress."""
    print(sentence, flush=True)


def install_tools() -> None:
    """Install the pinned tools into an environment of their own; at once if they are there."""
    if not (TOOLS / "bin/python").exists():
        run(PYTHON, "-I", "-m", "venv", TOOLS)
    pip = (TOOLS / "bin/python", "-I", "-m", "pip", "install", "--quiet")
    pins = ROOT / ".ci/release-requirements.txt"
    run(*pip, "--disable-pip-version-check", "--requirement", pins)


def committed_tree(folder: Path) -> None:
    """Copy the committed files into a folder."""
    if run("git", "status", "--porcelain"):
        say("Uncommitted changes are not in this release.")
    archive = folder.with_suffix(".tar")
    run("git", "archive", "--output", archive, "HEAD")
    shutil.unpack_archive(archive, folder, filter="data")
    archive.unlink()


def build_crate(tree: Path, dist: Path) -> None:
    """Pack the crate, and build it from its pack; a warning is an error."""
    say("Packing the crate.")
    target = ROOT / "target"
    said = ended(
        "cargo", "package", "--locked", "--target-dir", target, cwd=tree
    ).stderr
    if "warning" in said:
        raise ReleaseError(f"{said}cargo package: warns")
    (crate,) = (target / "package").glob(f"stlfr-{version(tree)}.crate")
    if crate.stat().st_size > MAX_CRATE_BYTES:
        raise ReleaseError(f"{crate.name}: is larger than crates.io takes")
    shutil.copyfile(crate, dist / crate.name)


def version(tree: Path) -> str:
    """The version that all of it has."""
    with (tree / "Cargo.toml").open("rb") as file:
        return str(tomllib.load(file)["package"]["version"])


def rust_target() -> str:
    """Rust's name of this machine, which has to be one with glibc."""
    if platform.system() != "Linux" or platform.libc_ver()[0] != "glibc":
        raise ReleaseError(
            "wheels are built on Linux with glibc; take others by --wheels"
        )
    return f"{platform.machine()}-unknown-linux-gnu"


def licences(tree: Path, target: str) -> str:
    """The licences of the crates that the wheel links, and each text once, with the crates that have it."""
    options = ("--features", "python", "--locked")
    listed = run(
        *("cargo", "tree", "--target", target, "--edges", "normal", "--prefix", "none"),
        *("--format", "{p}", *options),
        cwd=tree,
    )
    linked = {tuple(line.split()[:2]) for line in listed.splitlines() if line}
    metadata = json.loads(
        run("cargo", "metadata", "--format-version", "1", *options, cwd=tree)
    )
    table, texts = [], dict[str, list[str]]()
    for package in sorted(metadata["packages"], key=lambda p: str(p["name"])):
        name, release = package["name"], package["version"]
        if (name, f"v{release}") not in linked or package["source"] is None:
            continue
        table.append(f"{name} {release}: {package['license']}")
        folder = Path(package["manifest_path"]).parent
        for file in sorted({f for p in LICENCE_FILES for f in folder.rglob(p)}):
            if file.is_file():
                text = file.read_text("utf-8", "replace").strip()
                texts.setdefault(text, []).append(f"{name}: {file.name}")
    parts = ("\n".join([*sorted({*names}), "", text]) for text, names in texts.items())
    rule = f"\n\n{'=' * 80}\n\n"
    return rule.join(["\n".join(table), *parts]) + "\n"


def build_wheel(tree: Path, dist: Path) -> Path:
    """Build the wheel, with the licences of what it links."""
    say("Building the wheel.")
    target = rust_target()
    notices = tree / "blender/LICENSE-THIRD-PARTY"
    notices.write_text(licences(tree, target), encoding="utf-8")
    home = Path(os.environ.get("CARGO_HOME", Path.home() / ".cargo"))
    out = tree / "wheels"
    run(
        *(TOOLS / "bin/maturin", "build", "--release", "--strip", "--locked", "--zig"),
        *("--compatibility", COMPATIBILITY, "--auditwheel", "check"),
        *("--target", target, "--features", "python,portable", "--out", out),
        *("--interpreter", PYTHON, "--target-dir", ROOT / "target/release-wheel"),
        cwd=tree / "blender",
        environment={
            "PATH": f"{TOOLS / 'bin'}:{os.environ['PATH']}",
            # No path of this machine in the messages of panics.
            "RUSTFLAGS": f"--remap-path-prefix={home}=cargo",
        },
    )
    (wheel,) = out.glob("*.whl")
    return Path(shutil.copyfile(wheel, dist / wheel.name))


def check_wheel(wheel: Path) -> None:
    """By auditwheel and twine, then in use, in an empty environment."""
    say(f"Checking {wheel.name}.")
    shown = run(TOOLS / "bin/auditwheel", "show", wheel)
    found = " ".join(shown.split())
    if f'tag: "{COMPATIBILITY}_{platform.machine()}"' not in found:
        raise ReleaseError(f"{shown}{wheel.name}: is not of {COMPATIBILITY}")
    say(run(TOOLS / "bin/twine", "check", "--strict", wheel).strip())
    if wheel.stat().st_size > MAX_WHEEL_BYTES:
        raise ReleaseError(f"{wheel.name}: is larger than PyPI takes")
    test = (
        *("-I", "-m", "pytest", "-q", "-c", "blender/pyproject.toml"),
        *("--rootdir", ".", "tests/python/test_wheel.py"),
        "tests/python/release_wheel.py",
    )
    say(run(PYTHON, *test, environment={"STLFR_TEST_WHEEL": str(wheel)}).strip())


def build_extension(wheel: Path, tree: Path, dist: Path) -> Path:
    """Pack the extension with an unmodified wheel; Blender's tool of the project's environment validates it."""
    say(f"Packing the extension with {wheel.name}.")
    whole = tree / "extension.zip"
    script = tree / "blender/package.py"
    its_platform = run(PYTHON, "-I", script, wheel, "-o", whole).strip()
    # As Blender names the zips that it splits by platform.
    name = f"stlfr-{version(tree)}-{its_platform.replace('-', '_')}.zip"
    return Path(shutil.copyfile(whole, dist / name))


def try_in_blender(blender: str, extension: Path) -> None:
    """Validate an extension by a Blender's own command, install it into an empty configuration, and use it."""
    with tempfile.TemporaryDirectory() as user:
        environment = {"BLENDER_USER_RESOURCES": user, "HOME": user}
        command = (blender, "--command", "extension")
        say(run(*command, "validate", extension, environment=environment).strip())
        install = ("install-file", "--repo", "user_default", "--enable", extension)
        run(*command, *install, environment=environment)
        use = (
            "import bpy, stlfr; bpy.context.scene.render.engine = 'STLFR'; "
            "print('enabled in Blender', bpy.app.version_string, 'with the module', stlfr.__version__)"
        )
        failing = ("--python-exit-code", "1", "--python-expr", use)
        said = run(blender, "--background", *failing, environment=environment)
        say(next(line for line in said.splitlines() if line.startswith("enabled in")))


def runs_here(extension: Path) -> bool:
    """Whether an extension is of this machine's platform."""
    machine = {"x86_64": "x64", "aarch64": "arm64"}.get(platform.machine())
    return extension.stem.endswith(f"linux_{machine}")


def release(arguments: argparse.Namespace) -> None:
    """All of it."""
    dist: Path = arguments.output
    if not PYTHON.exists():
        raise ReleaseError("the project's environment isn't complete: run .ci/run")
    dist.mkdir(parents=True, exist_ok=True)
    replaced = earlier(dist)
    install_tools()
    with tempfile.TemporaryDirectory() as scratch:
        tree, made = Path(scratch) / "stlfr", Path(scratch) / "dist"
        made.mkdir()
        committed_tree(tree)
        build_crate(tree, made)
        check_wheel(build_wheel(tree, made))
        for wheel in sorted(arguments.wheels.glob("*.whl") if arguments.wheels else []):
            shutil.copyfile(wheel, made / wheel.name)
        extensions = [
            build_extension(wheel, tree, made) for wheel in sorted(made.glob("*.whl"))
        ]
        for extension in filter(runs_here, extensions):
            if arguments.blender:
                try_in_blender(arguments.blender, extension)
            else:
                say(f"{extension.name} was not tried: no Blender on the path.")
        if len(extensions) == 1:
            say("This machine's platform only: --wheels adds others.")
        for file in replaced:
            file.unlink(missing_ok=True)
        for file in made.iterdir():
            shutil.copyfile(file, dist / file.name)
    write_sums(dist)


def earlier(dist: Path) -> list[Path]:
    """The files of an earlier release, which its hashes name; a folder with other files is refused."""
    sums = dist / "SHA256SUMS"
    lines = sums.read_text(encoding="utf-8").splitlines() if sums.is_file() else []
    files = [sums, *(dist / Path(line.split()[-1]).name for line in lines)]
    others = {file.name for file in dist.iterdir()} - {file.name for file in files}
    if others:
        raise ReleaseError(f"{dist} holds other files, such as {min(others)}")
    return files


def write_sums(dist: Path) -> None:
    """Write the hashes, and print the sizes."""
    lines = []
    for file in sorted(dist.iterdir()):
        lines.append(f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n")
        say(f"{file.stat().st_size / 1e6:6.1f} MB  {file}")
    (dist / "SHA256SUMS").write_text("".join(lines), encoding="utf-8")


def main() -> None:
    """Run; what went wrong is one sentence on stderr, after what the failed command printed."""
    parser = argparse.ArgumentParser(
        description="Build and check a release. Nothing is uploaded."
    )
    parser.add_argument(
        *("-o", "--output"), type=Path, default=ROOT / "target/dist", metavar="FOLDER"
    )
    parser.add_argument("--wheels", type=Path, help="folder of other platforms' wheels")
    parser.add_argument(
        *("--blender", "-b"),
        default=shutil.which("blender"),
        help="a Blender to try the extension in (the path's)",
    )
    arguments = parser.parse_args()
    if arguments.wheels and not arguments.wheels.is_dir():
        parser.exit(2, f"{arguments.wheels}: no such folder\n")
    try:
        release(arguments)
    except ReleaseError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
