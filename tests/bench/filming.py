"""Images that are filmed in an hour, by one process and by two, as a table.

Run as `.venv/bin/python -I tests/bench/filming.py [SECONDS]`. Each row films the scene `magazine` by Cycles, 640x480 at
16 samples, for at least so many seconds (120 if not given), and counts the images after the first one: the time until
that is Blender's start, a column of its own. The command is bound to one core or to two, among which its processes share
their threads.
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
    """Seconds until the first image, the number of images after it, and their number in an hour."""
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
    """Film, count, print."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 120.0
    print("| processes | start, s | images | images an hour |")
    print("|---|---|---|---|")
    for name, (bound, workers) in RUNS.items():
        start_s, images, rate = images_an_hour(bound, workers, seconds)
        print(f"| {name} | {start_s:.1f} | {images} | {rate:.0f} |", flush=True)


if __name__ == "__main__":
    main()
