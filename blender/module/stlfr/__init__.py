"""Space-time light field rendering: any view of a capture at any instant, as a numpy array.

    import stlfr

    capture = stlfr.open(".captures/demo")
    first_s, last_s = capture.covered_s("cam3")
    image = capture.render((first_s + last_s) / 2, like="cam3", preset="balanced")

`Capture` renders views, and gives access to cameras, frames and offsets. `Moment` renders many views of one instant.
"""

from ._native import (
    Capture,
    Moment,
    __version__,
    check_rig,
    colmap_text,
    compare,
    displays,
    generate_rig,
    methods,
    open,
    options,
    project,
    read_rig,
)

__all__ = [
    "Capture",
    "Moment",
    "__version__",
    "check_rig",
    "colmap_text",
    "compare",
    "displays",
    "generate_rig",
    "methods",
    "open",
    "options",
    "project",
    "read_rig",
]
