"""Space-time light field rendering: the compiled module, under its name."""

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
