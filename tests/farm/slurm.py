"""The scripts of `stlfr farm` on a Slurm cluster, of which a node is killed while it films, and one while it renders.

Run as `python3 tests/farm/slurm.py PROGRAM KILL...` where sbatch, squeue and scontrol are on the path and reach the
cluster; its nodes must share this machine's files. PROGRAM is stlfr; KILL is a command that ends a node's daemon,
and gets the node's name as a further argument. Of the node's tasks that run on this machine, the processes are
killed too, as in a crash. Exits with 1 unless the capture and the rendered images have the bytes of those that single
commands make, all steps end, and no image was filmed twice.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FILM = ["--scene", "magazine", "--engine", "workbench", "--size", "160x120"]
FILM += ["--frames", "12", "--instants", "1"]
RENDERED = 240
PATIENCE_S = 1200.0
RIG = str(ROOT / "rigs/linear8.json")


def said(*command: object, **more: object) -> str:
    """What a command prints; it must succeed."""
    words = [str(word) for word in command]
    ended = subprocess.run(words, check=False, capture_output=True, text=True, **more)
    if ended.returncode != 0:
        sys.exit(f"{' '.join(words)}: {ended.stderr}")
    return ended.stdout


def images(capture: Path) -> dict[str, bytes]:
    """All that filming writes."""
    found = [*capture.glob("cam*/*"), *capture.glob("truth/**/*"), *capture.glob("*")]
    found += capture.glob("colmap/*")
    names = {p: str(p.relative_to(capture)) for p in found if p.is_file()}
    return {n: p.read_bytes() for p, n in names.items() if "offsets" not in n}


def kill_processes(node: str) -> int:
    """End the node's tasks on this machine, and first what would tell the cluster of their end."""
    tasks, keepers = set(), set()
    for process in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            words = (process / "environ").read_bytes().split(b"\0")
            if f"SLURMD_NODENAME={node}".encode() not in words:
                continue
            tasks.add(int(process.name))
            status = (process / "status").read_text()
            parent = next(w for w in status.splitlines() if w.startswith("PPid:"))
            keeper = int(parent.split()[1])
            if Path(f"/proc/{keeper}/comm").read_text().startswith("slurmstepd"):
                keepers.add(keeper)
    for process_id in (*keepers, *(tasks - keepers)):
        with contextlib.suppress(OSError):
            os.kill(process_id, signal.SIGKILL)
    return len(tasks | keepers)


def node_of(step: str) -> str:
    """A node with a running task of the step, or nothing."""
    running = said("squeue", "-h", "-t", "R", "-n", f"stlfr-{step}", "-o", "%N")
    return running.split()[-1] if running.split() else ""


class Watched:
    """Notes every version of every image."""

    def __init__(self, capture: Path) -> None:
        self.capture = capture
        self.versions: defaultdict[Path, set[tuple[int, int]]] = defaultdict(set)

    def look(self) -> None:
        """Note what is there now."""
        for path in (
            *self.capture.glob("cam*/*.png"),
            *self.capture.glob("truth/views/*"),
        ):
            status = path.stat()
            self.versions[path].add((status.st_ino, status.st_mtime_ns))


def main() -> None:
    """Submit, kill, wait, and compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("program", type=Path)
    parser.add_argument("kill", nargs="+")
    arguments = parser.parse_args()
    program = arguments.program.resolve()
    with tempfile.TemporaryDirectory() as name:
        capture, job = Path(name) / "a capture", Path(name) / "it's a job"
        farm = ["--rig", RIG, *FILM, "--film-parts", 24, "--film-chunk", 4]
        farm += ["--like", "cam3", "--times", f"0.1:0.2:{RENDERED}"]
        farm += ["--render-chunk", 80, "--cores", 1, "--memory", 1000]
        said(program, "farm", capture, "-o", job, *farm)
        print(said("sh", job / "submit.sh").strip())
        watched, killed, began_s = Watched(capture), dict[str, str](), time.monotonic()
        while said("squeue", "-h", "--me").strip():
            time.sleep(0.1)
            watched.look()
            made = {
                "film": (len(watched.versions), 30),
                "render": (len(list(job.glob("frames/*.png"))), 10),
            }
            for step, (count, wanted) in made.items():
                if step in killed or count < wanted or not (node := node_of(step)):
                    continue
                killed[step] = node
                said(*arguments.kill, node)
                ended = kill_processes(node)
                print(f"{step}, {count} images: killed {node}, {ended} processes")
            if time.monotonic() - began_s > PATIENCE_S:
                sys.exit(said("squeue") + "didn't end")
        restarts = said("scontrol", "-o", "show", "job").count("Restarts=1")
        said(program, "-q", "capture", RIG, *FILM, "-o", Path(name) / "one")
        alone = Path(name) / "alone"
        times = ["--times", f"0.1:0.2:{RENDERED}", "-o", alone / "%04d.png"]
        said(program, "-q", "render", Path(name) / "one", "--like", "cam3", *times)
        twice = [p for p, seen in watched.versions.items() if len(seen) > 1]
        checks = {
            "two nodes were killed, and their tasks ran again": len(killed) == 2
            and restarts == 2,
            "no image was filmed twice": not twice,
            "same bytes as by one command": images(capture)
            == images(Path(name) / "one"),
            "no claims are left": [p.name for p in (capture / ".film").iterdir()]
            == ["plan.txt"],
            "all images rendered": len(list(job.glob("frames/*"))) == RENDERED,
            "same images as by one command": sorted(
                p.read_bytes() for p in job.glob("frames/*")
            )
            == sorted(p.read_bytes() for p in alone.iterdir()),
            "compared": (capture / "review/report.html").is_file(),
        }
        for what, holds in checks.items():
            print(f"{what}: {'yes' if holds else 'NO'}")
        if not all(checks.values()):
            for log in sorted(job.glob("*.out")):
                print(f"--- {log.name}\n{log.read_text().strip()}")
        print(f"{time.monotonic() - began_s:.0f} s, {len(watched.versions)} images")
        sys.exit(0 if all(checks.values()) else 1)


if __name__ == "__main__":
    main()
