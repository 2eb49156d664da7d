"""Writes flip_reference.json beside this file: small images and what NVIDIA's flip-evaluator says.

Needs `pip install flip-evaluator==1.7 numpy`. The test is `equals_nvidias_evaluator` in
src/compare/flip.rs.
"""

import json
from pathlib import Path

import flip_evaluator
import numpy as np

WIDTH, HEIGHT = 24, 20


def scene() -> np.ndarray:
    """Smooth colours, a bright square and a thin line, in 0..255."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float64)
    image = np.stack(
        [90 + 5 * x, 160 - 4 * y, 60 + 40 * np.sin(x / 3) * np.cos(y / 4)],
        axis=-1,
    )
    image[5:12, 8:15] = [240, 230, 40]
    image[:, 19] = [10, 20, 60]
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def cases() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Name -> reference, test."""
    random = np.random.default_rng(5)
    reference = scene()
    noisy = np.clip(reference + random.normal(0, 12, reference.shape), 0, 255).astype(np.uint8)
    return {
        "shifted by a pixel": (reference, np.roll(reference, 1, axis=1)),
        "noise": (reference, noisy),
        "darker and greener": (reference, (reference * [0.7, 0.9, 0.6]).astype(np.uint8)),
        "random against random": (
            random.integers(0, 256, reference.shape, dtype=np.uint8),
            random.integers(0, 256, reference.shape, dtype=np.uint8),
        ),
        "the same": (reference, reference),
    }


def evaluate(name: str, reference: np.ndarray, test: np.ndarray) -> dict:
    """One case with its map, row by row."""
    images = [image.astype(np.float32) / np.float32(255) for image in (reference, test)]
    flip_map, mean, parameters = flip_evaluator.evaluate(*images, "LDR", applyMagma=False)
    return {
        "name": name,
        "pixels_per_degree": float(parameters["ppd"]),
        "reference": reference.ravel().tolist(),
        "test": test.ravel().tolist(),
        "mean": round(float(mean), 7),
        "map": [round(float(v), 5) for v in np.asarray(flip_map).reshape(HEIGHT, WIDTH, -1)[..., 0].ravel()],
    }


def main() -> None:
    evaluated = [evaluate(name, *images) for name, images in cases().items()]
    golden = {
        "made_with": "flip-evaluator 1.7",
        "width": WIDTH,
        "height": HEIGHT,
        "pixels_per_degree": evaluated[0]["pixels_per_degree"],
        "cases": [{k: v for k, v in case.items() if k != "pixels_per_degree"} for case in evaluated],
    }
    path = Path(__file__).with_name("flip_reference.json")
    path.write_text(json.dumps(golden, separators=(",", ":")).replace('{"name"', '\n{"name"') + "\n")


if __name__ == "__main__":
    main()
