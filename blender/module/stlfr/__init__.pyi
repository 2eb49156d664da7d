"""Space-time light field rendering: open a capture, project points, estimate offsets, render."""

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, Literal, Never, Self, TypedDict, final, type_check_only

import numpy as np
import numpy.typing as npt

__version__: str

@type_check_only
class CameraOffset(TypedDict, total=False):
    """A camera's clock: time on the reference's clock = time on the camera's clock + offset_s.

    An offset that is unknown is None, and `reason` says why. A clock that drifts has `rate_ppm` with its
    standard error. A readout time that was estimated with the offsets is `readout_s`. A camera that may have
    lost frames has `lost_before`: the indices of the images before which a frame is missing.
    """

    id: str
    offset_s: float | None
    std_err_s: float | None
    rate_ppm: float
    rate_std_err_ppm: float
    readout_s: float
    readout_std_err_s: float
    lost_before: list[int]
    reason: str

@type_check_only
class Offsets(TypedDict):
    """The offset of every camera."""

    reference: str
    cameras: list[CameraOffset]

@type_check_only
class Method(TypedDict):
    """A method by its name in the options, and what it does."""

    name: str
    help: str

@type_check_only
class Stage(TypedDict):
    """The methods of one stage, cheapest first."""

    default: str
    methods: list[Method]

def methods() -> dict[str, Stage]:
    """The methods of the stages `sync` and `proxy`, the modes of `trail`, and the names of `preset`."""

@type_check_only
class Option(TypedDict):
    """The declaration of one option of an options file."""

    name: str
    help: str
    kind: Literal["number", "integer", "boolean", "choice"]
    default: Any
    range: list[float] | None
    unit: str | None
    choices: list[Method]

def options() -> list[Option]:
    """All options, as `stlfr options --json` prints them. An option's name is its path, such as `blend.cameras`."""

@type_check_only
class Display(TypedDict):
    """A light-field display's quilt: a grid of views in a picture of `width` by `height` pixels.

    `aspect` is the display's width divided by its height. Its views span `cone_deg` degrees, or as much
    as the cameras cover. The name of a quilt's file ends in `suffix` before its own suffix.
    """

    name: str
    columns: int
    rows: int
    width: int
    height: int
    aspect: float
    cone_deg: float
    suffix: str

def displays() -> list[Display]:
    """The light-field displays that `stlfr render --quilt` knows by name."""

def open(path: str | PathLike[str]) -> Capture:
    """Open and check a capture's folder.

    Raises FileNotFoundError if there is no capture, and ValueError if the capture is invalid.
    """

def project(camera: dict[str, Any], points: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Project world points, as `Capture.project` does, with a camera object as in capture.json."""

def compare(
    path: str | PathLike[str],
    *,
    options: dict[str, Any] | None = None,
    lines: bool = False,
) -> dict[str, str]:
    """Compare rendered views with a capture's truth, as `stlfr compare` does, but without `review.blend`.

    Writes the results into the capture's folder `review`. Returns the paths of the files `report` (HTML) and
    `review` (the layout of the review, JSON). With `lines`, progress is printed on standard output, one JSON
    object with `done`, `total` and `what` per line. Raises ValueError if the comparison fails.
    """

def read_rig(path: str | PathLike[str]) -> dict[str, Any]:
    """Read and check a rig file. The result lacks fields that have their default values.

    Raises ValueError if the rig is invalid; the message names the file and the field.
    """

def check_rig(rig: dict[str, Any]) -> None:
    """Check a rig, given as a rig file's content.

    Raises ValueError if the rig is invalid, with the message of `stlfr rig --check` without the file's name.
    """

def generate_rig(options: dict[str, Any] | None = None) -> dict[str, Any]:
    """The content of the rig file that `stlfr rig` writes for the same options and seed.

    Options, all of them optional: `name`, `layout`, `spacing_m`, `sizes_px`, `lenses_mm`,
    `sensor_width_mm`, `distortion`, `rates_hz`, `delays`, `jitters_s`, `jitter_stamped`,
    `max_drift_ppm`, `loss`, `clock_shared`, `exposures_s`, `gains`, `noises`, `colors`, `bit_depth`
    and `seed`. The entries of a list are assigned to the cameras in turn, repeatedly. `layout` is `{"line": {"count"}}`,
    `{"grid": {"rows", "columns"}}` or `{"arc": {"count", "distance_m"}}`; `delays` is `"none"`,
    `"random"` or `{"listed": [seconds]}`; `loss` is `{"count", "within", "stamps"}` with stamps
    `"stamped"`, `"hidden"` or `"mixed"`. The defaults are the paper's rig: eight cameras in a line.

    Raises ValueError if the options are invalid.
    """

def colmap_text(images: Sequence[tuple[str, dict[str, Any]]]) -> dict[str, str]:
    """The files of COLMAP's text model by their names: `cameras.txt`, `images.txt`, `points3D.txt`.

    An image is given by its name and its camera object as in capture.json. Each image gets its own camera in
    the model, which has no points. Raises ValueError if an object is no valid camera.
    """

@type_check_only
class PathFrame(TypedDict):
    """A frame of a camera path: the instant, seconds on the reference's clock, and a camera object."""

    time_s: float
    camera: dict[str, Any]

@final
class Capture:
    """A capture: calibrated cameras with their recorded frames."""

    def __new__(cls, *_arguments: Never) -> Self:
        """Raises TypeError, as a capture is opened with `stlfr.open`."""

    @property
    def name(self) -> str:
        """The capture's name."""

    @property
    def camera_ids(self) -> list[str]:
        """The cameras' ids, in the order of capture.json."""

    @property
    def cameras(self) -> list[dict[str, Any]]:
        """The cameras as `camera` gives them, in the order of capture.json."""

    def camera(self, name: str) -> dict[str, Any]:
        """A camera object by its id, or by the name of a true view: width, height, model, params and cam_from_world."""

    def covered_s(self, camera_id: str | None = None) -> tuple[float, float]:
        """The first and the last time at which a camera has images, seconds on the reference's clock.

        Without `camera_id`, those at which any camera has images. Unknown offsets are estimated.
        """

    @property
    def reference(self) -> str:
        """The id of the reference camera, on whose clock times of views are given."""

    def project(self, camera_id: str, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Project world points, (N, 3) in metres, to pixels, (N, 2).

        The top-left pixel's centre is (0.5, 0.5). A point that has no image (behind the camera,
        or beyond the radius where the lens model folds back) gives a row of NaN. Pixels may lie outside the image.
        """

    def times(self, camera_id: str) -> npt.NDArray[np.float64]:
        """The middle of every frame's exposure, seconds on the camera's own clock."""

    def frame(
        self, camera_id: str, index: int
    ) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16]:
        """A camera's frame, (H, W, channels): RGB or grey as `color` says, in the camera's bit depth."""

    def offsets(
        self, options: dict[str, Any] | None = None, *, preset: str | None = None
    ) -> Offsets:
        """The offsets of all cameras, read from the capture's folder, or else estimated and saved there."""

    def render(
        self,
        time_s: float,
        *,
        camera: dict[str, Any] | None = None,
        like: str | None = None,
        options: dict[str, Any] | None = None,
        preset: str | None = None,
        alpha: bool | None = None,
        proceed: Callable[[int, int], object] | None = None,
    ) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16]:
        """Render the view of `camera`, or of the camera or true view with the name `like`.

        `camera` is a camera object in the form that the method `camera` returns. `time_s` is in seconds on the
        reference's clock. The result is an array (H, W, channels) in the input's bit depth. Channels are RGB
        or grey, followed by alpha if `alpha` is true. By default, alpha follows only if some pixels are seen by
        no camera. `options` has the content of an options file of `stlfr render`, and overrides `preset`. Its
        names may be paths, such as `blend.cameras`; `proxy` and `blend` may also be the names of methods.
        Before every step of an instant, `proceed(done, total)` is called with the number of finished instants
        and of all instants of the trail (1 without a trail). If it returns a false value, rendering stops with
        an InterruptedError.
        """

    def path(
        self,
        path: str | PathLike[str] | dict[str, Any],
        *,
        rate_hz: float | None = None,
        duration_s: float | None = None,
        time_s: float | None = None,
        options: dict[str, Any] | None = None,
        preset: str | None = None,
    ) -> list[PathFrame]:
        """The frames of a camera path, as `stlfr render --path` renders them.

        `path` is the name of a ready-made path (`sweep`, `orbit`, `bullet-time`, `dolly`), the name of a
        path's file, or a dict with the content of such a file. A ready-made path is fitted to this capture,
        by depths that are estimated with these options. `rate_hz` is the frame rate, by default the path's
        own or 30. `duration_s` stretches the path; a ready-made one lasts 4 s by default. `time_s` stops time
        at an instant. Render a frame by `render(frame["time_s"], camera=frame["camera"])`.
        """

    def preview(
        self,
        time_s: float,
        *,
        camera: dict[str, Any],
        options: dict[str, Any] | None = None,
        preset: str | None = None,
        alpha: bool | None = None,
    ) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16] | None:
        """Render a view quickly by scene flow, for a viewpoint or time that changes; a trail is ignored.

        There is a view if three things hold: `render` was called with the same options before, these options
        choose scene flow, and depth and motion of the frames are in memory or stored by `stlfr prepare`.
        Otherwise, the result is None.
        """

    def load_preview(
        self,
        time_s: float,
        *,
        camera: dict[str, Any],
        options: dict[str, Any] | None = None,
        preset: str | None = None,
    ) -> bool:
        """Load into memory what `preview` needs for this view. Returns whether `preview` can then render it.

        Loading takes as long for a small view as for a large one.
        """

    def moment(
        self,
        time_s: float,
        *,
        options: dict[str, Any] | None = None,
        preset: str | None = None,
    ) -> Moment:
        """Prepare one instant for many views. Results that don't depend on the viewpoint are computed once, here.

        A trail in the options is ignored.
        """

@final
class Moment:
    """One instant of a capture."""

    def view(
        self, camera: dict[str, Any], *, alpha: bool | None = None
    ) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16]:
        """Render the view of a camera object, as `Capture.render` does."""
