"""Space-time light field rendering: the compiled module, under its name."""

from ._native import Capture, __version__, methods, open, project

__all__ = ["Capture", "__version__", "methods", "open", "project"]
