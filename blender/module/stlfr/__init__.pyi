"""Space-time light field rendering: open a capture, project points."""

from os import PathLike
from typing import final

import numpy as np
import numpy.typing as npt

__version__: str

def open(path: str | PathLike[str]) -> Capture:
    """Open and check a capture's folder. Raises ValueError with one sentence where it is wrong."""

@final
class Capture:
    """A capture: calibrated cameras and what they filmed."""

    @property
    def name(self) -> str:
        """The capture's name."""

    @property
    def camera_ids(self) -> list[str]:
        """The cameras' ids, in the order of capture.json."""

    @property
    def reference(self) -> str:
        """The id of the camera whose clock is everybody's time."""

    def project(self, camera_id: str, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """The pixels, (N, 2), that world points, (N, 3) in metres, fall on.

        The top-left pixel's centre is (0.5, 0.5). A point that has no image (behind the camera)
        gives a row of NaN. Pixels may lie outside the image.
        """

    def times(self, camera_id: str) -> npt.NDArray[np.float64]:
        """The middle of every frame's exposure, seconds on the camera's own clock."""
