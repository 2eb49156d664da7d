"""Write lenses.json: where pycolmap projects points of the plane z = 1, for each of COLMAP's lens models.

Run by hand in the project's environment: .venv/bin/python tests/golden/make_lens_reference.py
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pycolmap

F, FX, FY, CX, CY = 400.0, 686.0, 680.0, 321.0, 239.0
MODELS: dict[str, list[float]] = {
    "SIMPLE_PINHOLE": [F, CX, CY],
    "PINHOLE": [FX, FY, CX, CY],
    "SIMPLE_RADIAL": [FX, CX, CY, -0.15],
    "RADIAL": [FX, CX, CY, -0.21, 0.07],
    "OPENCV": [FX, FY, CX, CY, -0.21, 0.07, 1e-3, -2e-3],
    "OPENCV_FISHEYE": [F, F, CX, CY, 0.02, -0.01, 0.004, -0.001],
    "FULL_OPENCV": [
        *(FX, FY, CX, CY, 0.3, -0.1, 1e-3, -2e-3),
        *(0.02, 0.5, 0.1, -0.01),
    ],
    "SIMPLE_RADIAL_FISHEYE": [F, CX, CY, -0.03],
    "RADIAL_FISHEYE": [F, CX, CY, 0.05, -0.02],
    "FOV": [F, F, CX, CY, 0.9],
    "THIN_PRISM_FISHEYE": [
        *(F, F, CX, CY, 0.02, -0.01, 1e-3, -2e-3),
        *(0.004, -0.001, 2e-3, -1e-3),
    ],
    "RAD_TAN_THIN_PRISM_FISHEYE": [
        *(F, F, CX, CY, 0.02, -0.01, 0.004, -0.001, 2e-4, -1e-4),
        *(1e-3, -2e-3, 2e-3, -1e-3, 1e-3, 5e-4),
    ],
    "SIMPLE_DIVISION": [FX, CX, CY, -0.2],
    "DIVISION": [FX, FY, CX, CY, 0.1],
    "SIMPLE_FISHEYE": [F, CX, CY],
    "FISHEYE": [F, F, CX, CY],
    "EUCM": [FX, FY, CX, CY, 0.6, 1.1],
}


def main() -> None:
    """Write the file beside this one."""
    points = np.random.default_rng(0).uniform(-0.45, 0.45, (6, 2))
    lenses = []
    for model, params in MODELS.items():
        camera = pycolmap.Camera(model=model, width=640, height=480, params=params)
        pixels = [camera.img_from_cam(np.array([*point, 1.0])) for point in points]
        lenses.append(
            {
                "model": model,
                "params": params,
                "points": points.tolist(),
                "pixels": [list(pixel) for pixel in pixels],
            }
        )
    text = json.dumps(lenses, indent=1) + "\n"
    (Path(__file__).parent / "lenses.json").write_text(text)


if __name__ == "__main__":
    main()
