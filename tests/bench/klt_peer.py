"""Runs OpenCV for comparison in the registration benchmarks: executes commands on stdin, one per line.

`threads N`                              calls cv2.setNumThreads
`images A B POINTS`                      reads two images, and points (float32 pairs, top-left pixel's centre at 0)
`track SIDE LEVELS ITERATIONS EPSILON`   calls calcOpticalFlowPyrLK, which also builds the pyramids
`tracked OUT`                            writes the tracked points: float32 x, y, and 1 if tracked, else 0
`dis`                                    computes DIS flow, preset medium, in both directions

The answer to each command is a line with its processor time and its wall time, both in milliseconds.
"""

import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np


def main() -> None:
    """Execute commands until stdin ends."""
    opencv: Any = cv2  # its stubs know neither None nor the presets
    first: Any = None
    second: Any = None
    points: Any = None
    tracked: Any = None
    status: Any = None
    dis = opencv.DISOpticalFlow_create(opencv.DISOPTICAL_FLOW_PRESET_MEDIUM)
    for line in sys.stdin:
        command, *words = line.split()
        start = (time.process_time(), time.perf_counter())
        if command == "threads":
            cv2.setNumThreads(int(words[0]))
        elif command == "images":
            first, second = (opencv.imread(w, cv2.IMREAD_GRAYSCALE) for w in words[:2])
            points = np.fromfile(words[2], np.float32).reshape(-1, 1, 2)
        elif command == "track":
            side, levels, iterations = (int(w) for w in words[:3])
            criteria = (
                cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT,
                iterations,
                float(words[3]),
            )
            start = (time.process_time(), time.perf_counter())
            tracked, status, _ = opencv.calcOpticalFlowPyrLK(
                first,
                second,
                points,
                None,
                winSize=(side, side),
                maxLevel=levels - 1,
                criteria=criteria,
            )
        elif command == "tracked":
            table = np.concatenate(
                [tracked.reshape(-1, 2), status.reshape(-1, 1)], axis=1
            )
            Path(words[0]).write_bytes(table.astype("<f4").tobytes())
        elif command == "dis":
            dis.calc(first, second, None)
            dis.calc(second, first, None)
        else:
            raise SystemExit(f"no such command: {command}")
        spent = (time.process_time() - start[0], time.perf_counter() - start[1])
        print(f"{1e3 * spent[0]:.6f} {1e3 * spent[1]:.6f}", flush=True)


if __name__ == "__main__":
    main()
