"""stlfr in Blender: the extension, and plain functions for rigs, cameras, filming and ground truth.

The extension and the headless scripts (`capture.py`, `check.py`) share these modules:

- `rig`: a simulated rig and its exposure times
- `native`: functions of the compiled module `stlfr` for rig files, new rigs and COLMAP's text model
- `camera`: conversion between Blender's camera and COLMAP's `PINHOLE`
- `distortion`: COLMAP's `OPENCV` lens distortion
- `described`: a camera object as in capture.json
- `rolling`: exposure times of a rolling shutter's rows, and the bands of rows that are rendered together
- `sensor`: from rendered light to a camera's pixels
- `scenes`: opens the scene to film, and finds the rig's pose
- `plan`: which images a capture consists of, and which of them exist already
- `film`: renders one image, or its depth and motion
- `tracks`: tracks of points on the scene's surfaces; `workbench`: textures that Workbench can't show
- `exr`: reads the passes that Cycles wrote
- `png`: checks and writes PNG files
- `reading`: reads files of untrusted origin
- `video`: packs a camera's frames into one lossless video
- `truth`: instants, offsets and exposure times of the ground truth
- `folder`: writes the capture's text files
- `workers`: films in several processes; `sharing`: divides the work among commands and machines
- `in_blender`: runs a worker process inside Blender's own program
- `errors`: errors with one sentence for the user

Only the extension uses these modules:

- `engine`: the render engine `STLFR`
- `viewport`: its `Rendered` shading; `live` renders for it, `viewpoint` computes the region's camera
- `view`: which image of the light field a frame of the scene shows; `camera_path`: all frames, as a path
- `pictures`: the arguments of `stlfr render` for a quilt or a stereo pair; `picture` runs this command
- `fields`: the open capture; `timing`: which scene frames it covers; `spans`: reads the covered span in the background
- `properties`, `panels`, `operators`, `comparison`: the user interface
- `reels`: a comparison as scenes in the video sequencer
- `words`: messages in the terms of the panels
- `rig_objects`: conversion between a rig file and camera objects
- `filming`: the files in a folder that is being filmed into
- `jobs`: long work in a child process, such as `estimate`, `compare` and `picture`; `long_work`: its operators
- `paths`: Blender's paths, which may begin with `//`
- `wheel`: checks that the compiled module belongs to this extension

The following modules import `bpy`: `film`, `scenes`, `tracks`, `workbench`, and of the extension's own `comparison`,
`engine`, `long_work`, `operators`, `panels`, `paths`, `pictures`, `properties`, `reels`, `rig_objects`, `spans` and
`viewport`. All other modules can be imported and tested without Blender. Importing this package imports none of them
and registers nothing.
"""

from __future__ import annotations


def register() -> None:
    """Called when Blender enables the extension. Raises `FailureError` if the module `stlfr` has another version."""
    from . import wheel

    wheel.require()
    from . import comparison, engine, operators, panels, properties

    for module in (properties, operators, comparison, panels, engine):
        module.register()


def unregister() -> None:
    """Called when Blender disables the extension: cancels running jobs, and unregisters everything."""
    from . import (
        comparison,
        engine,
        fields,
        jobs,
        live,
        long_work,
        operators,
        panels,
        properties,
    )

    jobs.end_all()
    for module in (long_work, engine, panels, comparison, operators, properties):
        module.unregister()
    fields.close(live.PATIENCE_S)
