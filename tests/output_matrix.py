"""Every output of every command against every kind of target; prints a table in Markdown.

    cargo build --release && python3 tests/output_matrix.py target/release/stlfr CAPTURE [COMMAND ...]

As root, because it makes device nodes and mounts small disks; on Linux. CAPTURE is any capture with
truth, such as target/test-captures/tiny; it is copied. Commands named after it are tried alone. A cell holds the exit code and the sentence. Below
the table stands what was lost that should not have been, or that nothing was; then the exit code is 1.
"""

from __future__ import annotations

import json
import os
import shutil
import stat
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

FULL_KIB = 16
"""Size of the full disk; what is written into it is larger than what is left."""


@dataclass(frozen=True)
class Option:
    """An output option: its command line, with the capture as CAPTURE, and the output's suffix."""

    name: str
    line: str
    suffix: str
    own_file: str
    """A file of the capture that the option could name; empty for a folder of it."""

    @property
    def is_folder(self) -> bool:
        return not self.suffix


OPTIONS = [
    Option(
        "render -o image",
        "render CAPTURE --like cam3 --time 0.1 --preset draft -o",
        ".png",
        "cam0/0000.png",
    ),
    Option(
        "render -o images",
        "render CAPTURE --like cam3 --times 0.1:0.11:1 --preset draft -o",
        "%d.png",
        "cam0/000%d.png",
    ),
    Option(
        "render -o video",
        "render CAPTURE --like cam3 --times 0.1:0.11:2 --preset draft -o",
        ".mkv",
        "truth/a.mkv",
    ),
    Option(
        "render -o layers",
        "render CAPTURE --like cam3 --time 0.1 --preset draft -o",
        ".exr",
        "truth/a.exr",
    ),
    Option("plan -o", "plan CAPTURE -o", ".json", "truth/truth.json"),
    Option("rig -o", "rig line --count 400 -o", ".json", "capture.json"),
    Option("check --json", "check CAPTURE --json", ".json", "capture.json"),
    Option(
        "export nerf -o", "export CAPTURE --format nerf -o", ".json", "capture.json"
    ),
    Option(
        "export llff -o",
        "export CAPTURE --format llff --near 1 --far 6 -o",
        ".npy",
        "cam0/0000.png",
    ),
    Option("setup --extension", "setup --extension", ".zip", "truth/a.zip"),
    Option("export colmap -o", "export CAPTURE --format colmap -o", "", "colmap"),
    Option(
        "export colmap-text -o", "export CAPTURE --format colmap-text -o", "", "colmap"
    ),
    Option("compare -o", "compare CAPTURE --preset draft -o", "", "truth"),
    Option("tradeoff -o", "tradeoff CAPTURE --rounds 0 --runs 1 -o", "", "cam0"),
    Option("farm -o", "farm CAPTURE -o", "", "truth"),
    Option("calibrate -o", "calibrate CAPTURE -o", "", "truth"),
    Option("refine -o", "refine CAPTURE -o", "", "truth"),
    Option(
        "export --frames -o", "export CAPTURE --format nerf --frames -o", "", "truth"
    ),
    Option(
        "export --synchronized -o",
        "export CAPTURE --format colmap --synchronized --preset draft -o",
        "",
        "truth",
    ),
    Option("publish -o", "publish CAPTURE --max-mb 1 -o", "", "truth"),
    Option("import -o", "import CAPTURE/colmap --images CAPTURE --rate 30 -o", "", ""),
    Option(
        "capture -o",
        "capture rigs/linear8.json --scene still --frames 2 --size 64x48 --no-truth -o",
        "",
        "truth",
    ),
    Option("demo -o", "demo --size 64x48 --frames 5 --samples 1 -o", "", "truth"),
]

TARGETS = [
    "device",
    "pipe",
    "folder",
    "file",
    "link",
    "link to nothing",
    "read-only folder",
    "full disk",
    "the capture's own",
]


class Bench:
    """A scratch folder with a copy of the capture, a read-only disk and a full one."""

    def __init__(self, program: Path, capture: Path, root: Path) -> None:
        self.program, self.root = program, root
        self.capture = root / "capture"
        shutil.copytree(capture, self.capture, symlinks=True)
        self.before = contents(self.capture)
        self.read_only, self.full = root / "read-only", root / "full"
        for disk, options in [(self.read_only, "ro"), (self.full, f"size={FULL_KIB}k")]:
            disk.mkdir()
            run("mount", "-t", "tmpfs", "-o", options, "tmpfs", str(disk))
        with (self.full / "fill").open("wb", buffering=0) as stream:
            try:
                while stream.write(b"0" * 4096):
                    pass
            except OSError:
                pass

    def close(self) -> None:
        for disk in (self.read_only, self.full):
            run("umount", str(disk))

    def try_one(self, option: Option, target: str) -> tuple[str, str]:
        """The cell, and what was lost, if something was."""
        folder = Path(tempfile.mkdtemp(dir=self.root))
        path = folder / f"out{option.suffix}"
        made = folder / f"out{option.suffix}".replace("%d", "0")
        goal = folder / "goal"
        goal.write_text("kept")
        match target:
            case "device":
                os.mknod(made, 0o666 | stat.S_IFCHR, os.makedev(1, 3))
            case "pipe":
                os.mkfifo(made)
            case "folder":
                made.mkdir()
                (made / "mine").write_text("kept")
            case "file":
                made.write_text("replaced")
            case "link":
                made.symlink_to("goal")
            case "link to nothing":
                made.symlink_to("nowhere")
            case "read-only folder":
                path = self.read_only / f"out{option.suffix}"
            case "full disk":
                path = self.full / f"out{option.suffix}"
            case _:
                path = self.capture / option.own_file
        kind = kind_of(made)
        cell = self.run_option(option, path)
        lost = []
        may_replace = target == "file" and not option.is_folder
        if kind and not may_replace and kind_of(made) != kind:
            lost.append("it was replaced")
        if goal.read_text() != "kept":
            lost.append("the link's file was written over")
        if target == "folder" and (
            not made.is_dir() or (made / "mine").read_text() != "kept"
        ):
            lost.append("the folder's file was lost")
        leftovers = list(folder.rglob(".stlfr-*"))
        lost += [f"left {p.name}" for p in leftovers]
        lost += [
            f"{p} changed"
            for p, b in self.before.items()
            if contents_of(self.capture / p) != b
        ]
        for disk in (self.read_only, self.full):
            lost += [f"left {p.name}" for p in disk.glob(".stlfr-*")]
        shutil.rmtree(folder)
        shutil.rmtree(self.full / "out", ignore_errors=True)
        return cell.replace(f"{folder.name}/", ""), "; ".join(lost)

    def run_option(self, option: Option, path: Path) -> str:
        words = [
            str(self.capture) if w == "CAPTURE" else w for w in option.line.split()
        ]
        words = [w.replace("CAPTURE/", f"{self.capture}/") for w in words]
        try:
            ended = subprocess.run(
                [self.program, "-q", *words, path],
                capture_output=True,
                text=True,
                check=False,
                timeout=900,
            )
        except subprocess.TimeoutExpired:
            return "**it hung**"
        sentence = (
            ended.stderr.strip().replace(f"{self.root}/", "").replace("\n", " ⏎ ")
        )
        return f"{ended.returncode} {sentence}".strip().replace("|", "\\|")


def run(*command: str) -> None:
    """Run a command, which must succeed."""
    subprocess.run(command, check=True)


def kind_of(path: Path) -> int | None:
    """A file's type and permissions; nothing is no file."""
    return path.lstat().st_mode if path.is_symlink() or path.exists() else None


def contents_of(path: Path) -> bytes | None:
    """A regular file's bytes."""
    return path.read_bytes() if path.is_file() and not path.is_symlink() else None


def contents(folder: Path) -> dict[Path, bytes | None]:
    """The capture's files, without what the program itself writes there."""
    own = ("offsets.json", "offsets.svg", "review", ".stlfr")
    files = (p.relative_to(folder) for p in folder.rglob("*") if p.is_file())
    return {p: contents_of(folder / p) for p in files if p.parts[0] not in own}


def main() -> int:
    """Print the table and what was lost."""
    program, capture = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve()
    json.loads((capture / "capture.json").read_text())
    root = Path(tempfile.mkdtemp(prefix="outputs-"))
    bench = Bench(program, capture, root)
    all_lost = []
    try:
        print("| output | " + " | ".join(TARGETS) + " |")
        print("|---" * (len(TARGETS) + 1) + "|")
        commands = sys.argv[3:]
        for option in OPTIONS:
            if commands and option.line.split()[0] not in commands:
                continue
            cells = []
            for target in TARGETS:
                cell, lost = bench.try_one(option, target)
                cells.append(f"{cell} **{lost}**" if lost else cell)
                all_lost += [f"{option.name}, {target}: {lost}"] if lost else []
            print(f"| `{option.name}` | " + " | ".join(cells) + " |", flush=True)
    finally:
        bench.close()
        shutil.rmtree(root)
    print("\n" + ("\n".join(f"- {lost}" for lost in all_lost) or "Nothing was lost."))
    return 1 if all_lost else 0


if __name__ == "__main__":
    sys.exit(main())
