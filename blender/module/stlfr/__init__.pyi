"""Space-time light field rendering: open a capture, project points, estimate offsets, render."""

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, Literal, TypedDict, final, type_check_only

import numpy as np
import numpy.typing as npt

__version__: str

@type_check_only
class CameraOffset(TypedDict, total=False):
    """Time on the reference's clock = time on the camera's clock + offset_s; None is unknown.

    rate_ppm and its standard error are there for a clock that drifts, lost_before for a camera that
    may have lost frames: the images before which one is missing.
    """

    id: str
    offset_s: float | None
    std_err_s: float | None
    rate_ppm: float
    rate_std_err_ppm: float
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
    """The methods of `sync` and `proxy`, the modes of `trail`, and `preset`: named options of all stages."""

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
    """Every option, by its path in an options file, such as `blend.cameras`; as `stlfr options --json`."""

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

    Raises FileNotFoundError if there is no capture, and ValueError with one sentence where it is wrong.
    """

def project(camera: dict[str, Any], points: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """The pixels of world points in a camera object as in capture.json; as `Capture.project`."""

def compare(
    path: str | PathLike[str],
    *,
    options: dict[str, Any] | None = None,
    lines: bool = False,
) -> dict[str, str]:
    """Compare a capture with its truth into its folder `review`, as `stlfr compare` does, but for `review.blend`.

    Gives the files `report` (HTML) and `review` (what stands beside what, JSON). With `lines`, progress goes to
    standard output, one JSON object `done`, `total`, `what` a line. Raises ValueError with one sentence.
    """

def read_rig(path: str | PathLike[str]) -> dict[str, Any]:
    """The content of a rig file, checked. Fields that have their default values are left out.

    Raises ValueError with one sentence, which names the file and the field, where it is wrong.
    """

def check_rig(rig: dict[str, Any]) -> None:
    """Check a rig, given as a rig file's content.

    Raises ValueError with the sentence that `stlfr rig --check` prints, without the file.
    """

def generate_rig(options: dict[str, Any] | None = None) -> dict[str, Any]:
    """The content of the rig file that `stlfr rig` writes for the same options and seed.

    Options, all of them optional: `name`, `layout`, `spacing_m`, `sizes_px`, `lenses_mm`,
    `sensor_width_mm`, `distortion`, `rates_hz`, `delays`, `jitters_s`, `jitter_stamped`,
    `max_drift_ppm`, `loss`, `clock_shared`, `exposures_s`, `gains`, `noises`, `colors`, `bit_depth`
    and `seed`. A list's entries go to the cameras in turn. `layout` is `{"line": {"count"}}`,
    `{"grid": {"rows", "columns"}}` or `{"arc": {"count", "distance_m"}}`; `delays` is `"none"`,
    `"random"` or `{"listed": [seconds]}`; `loss` is `{"count", "within", "stamps"}` with stamps
    `"stamped"`, `"hidden"` or `"mixed"`. The defaults are the paper's rig: eight cameras in a line.

    Raises ValueError with one sentence where there is no such rig.
    """

def colmap_text(images: Sequence[tuple[str, dict[str, Any]]]) -> dict[str, str]:
    """The files of COLMAP's text model by their names: `cameras.txt`, `images.txt`, `points3D.txt`.

    Each image is its name and its camera object as in capture.json, and has a camera of its own.
    There are no points. Raises ValueError where an object isn't a camera's.
    """

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
    def cameras(self) -> list[dict[str, Any]]:
        """The cameras as `camera` gives them, in the order of capture.json."""

    def camera(self, name: str) -> dict[str, Any]:
        """A camera object by its id, or by the name of a true view: width, height, model, params and cam_from_world."""

    def covered_s(self, camera_id: str | None = None) -> tuple[float, float]:
        """The first and the last time at which a camera has images, or any camera without one.

        Seconds on the reference's clock. Offsets that aren't known yet are estimated.
        """

    @property
    def reference(self) -> str:
        """The id of the camera whose clock is everybody's time."""

    def project(self, camera_id: str, points: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """The pixels, (N, 2), that world points, (N, 3) in metres, fall on.

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
        """Every camera's offset: those saved in the capture's folder, else estimated and saved there."""

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
        """The view of a camera object as `camera` gives it, or of the camera or true view that `like` names.

        An array (H, W, channels) in the input's bit depth. Channels are RGB or grey. With `alpha` true,
        alpha comes after them, with `alpha` false never, by default where no camera sees some of the
        pixels. Time is seconds on the reference's clock.
        `options` is what a file for `stlfr render --options` holds; names may be paths, such as
        `blend.cameras`, and `proxy` and `blend` may be their methods. They override those of `preset`.
        `proceed(done, total)` is called before every step of every instant of a trail, of one instant
        without a trail; where it returns something false, rendering stops with an InterruptedError.
        """

    def moment(
        self,
        time_s: float,
        *,
        options: dict[str, Any] | None = None,
        preset: str | None = None,
    ) -> Moment:
        """The instant for many views of it: what doesn't depend on the viewpoint is computed once, here.

        A trail in the options is left out.
        """

@final
class Moment:
    """One instant of a capture."""

    def view(
        self, camera: dict[str, Any], *, alpha: bool | None = None
    ) -> npt.NDArray[np.uint8] | npt.NDArray[np.uint16]:
        """The view of a camera object, as `Capture.render` gives it, but over depth per pixel.

        There, the depths of all cameras share one range, and a view takes those of the cameras nearest to it:
        pixels differ slightly.
        """
