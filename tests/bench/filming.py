"""Prints a table of the number of images filmed per hour, by one and by two processes.

Run as `.venv/bin/python -I tests/bench/filming.py [SECONDS]`. For each row, the scene `magazine` is filmed by Cycles at
640x480 with 16 samples, for at least SECONDS (120 by default). Images after the first one are counted; the time until
the first image is mainly Blender's start, and has its own column. The command is bound to one or two cores, which are
divided among its processes.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
FILM = ["--scene", "magazine", "--size", "640x480", "--frames", "200", "--no-truth"]
RUNS = {
    "one process, one thread": (["taskset", "-c", "0"], "1"),
    "one process, two threads": (["taskset", "-c", "0,1"], "1"),
    "two processes, one thread each": (["taskset", "-c", "0,1"], "2"),
}
LOOK_S = 0.05


def images_an_hour(
    bound: list[str], workers: str, seconds: float
) -> tuple[float, int, float]:
    """Film for some seconds, with the command prefix `bound`, which binds it to cores.

    Returns the seconds until the first image, the number of images after it, and their number per hour.
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "capture"
        command: list[str | Path] = [*bound, sys.executable, "-I"]
        command += [ROOT / "blender/capture.py", ROOT / "rigs/linear8.json", *FILM]
        command += ["--workers", workers, "-o", folder]
        process = subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            started_s = time.monotonic()
            count, first, began_s, passed_s = 0, 0, started_s, 0.0
            while passed_s < seconds and process.poll() is None:
                time.sleep(LOOK_S)
                found = len(list(folder.glob("cam*/*.png")))
                if count == 0 and found > 0:
                    began_s, first = time.monotonic(), found
                if found > count > 0:
                    passed_s = time.monotonic() - began_s
                count = found
            if passed_s == 0.0:
                raise SystemExit("no two images were filmed")
            images = count - first
            return began_s - started_s, images, 3600 * images / passed_s
        finally:
            os.killpg(process.pid, signal.SIGTERM)
            process.wait()


def main() -> None:
    """Film with every number of processes, and print the table."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 120.0
    print("| processes | start, s | images | images an hour |")
    print("|---|---|---|---|")
    for name, (bound, workers) in RUNS.items():
        start_s, images, rate = images_an_hour(bound, workers, seconds)
        print(f"| {name} | {start_s:.1f} | {images} | {rate:.0f} |", flush=True)


if __name__ == "__main__":
    main()
