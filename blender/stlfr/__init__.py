"""stlfr in Blender: the extension, and rigs, cameras, filming and truth as plain functions.

The extension and the headless scripts (`capture.py`, `check.py`) share these modules:

- `rig`: a rig and its shutter times
- `native`: what the compiled module `stlfr` does: rig files, new rigs, COLMAP's text
- `camera`: Blender's camera to COLMAP's `PINHOLE` and back
- `distortion`: COLMAP's `OPENCV` lens, as filming needs it
- `described`: a camera as capture.json spells it
- `rolling`: the rows of a rolling shutter, and the bands that are rendered at once
- `sensor`: from rendered light to a camera's pixels
- `scenes`: find a scene, build it or open a .blend, say where the rig stands
- `plan`: which images a capture consists of, and which of them are there already
- `film`: render one image, or its depth and motion
- `exr`: read the passes that Cycles wrote
- `png`: whole files, without notes, and their writing
- `video`: a camera's frames as one lossless video
- `truth`: what only a simulator knows
- `folder`: write the capture's files
- `workers`: film on several processes
- `in_blender`: a filming process inside Blender's own program
- `errors`: one sentence for the user

Of the extension alone:

- `engine`: the render engine `STLFR`
- `viewport`: its `Rendered` shading; `live` renders for it, `viewpoint` is the region's camera
- `view`: which image of the light field a frame of the scene shows; `camera_path`: all frames, as a path
- `pictures`: the `stlfr render` of a quilt or a stereo pair, which `picture` runs
- `fields`: the capture that is open; `timing`: which scene frames it covers; `spans`: read beside the main thread
- `properties`, `panels`, `operators`, `comparison`: what the user sees and presses
- `reels`: a comparison as scenes of strips
- `words`: sentences in the panels' words
- `rig_objects`: a rig file as camera objects, and back
- `filming`: what lies in a folder that is being filmed into
- `jobs`: long work in a process of its own; `estimate`, `compare` and `picture` are some, `long_work`
  their operators
- `paths`: `//` and what is absolute
- `wheel`: the compiled module has to be this extension's

`film`, `scenes`, and of the extension `comparison`, `engine`, `long_work`, `operators`, `panels`, `paths`,
`pictures`, `properties`, `reels`, `rig_objects`, `spans` and `viewport` import `bpy`; everything else starts at once and tests anywhere. Importing this
package registers nothing and imports none of them.
"""

from __future__ import annotations


def register() -> None:
    """Blender enables the extension. A module of another version is refused before anything is registered."""
    from . import wheel

    wheel.require()
    from . import comparison, engine, operators, panels, properties

    for module in (properties, operators, comparison, panels, engine):
        module.register()


def unregister() -> None:
    """Blender disables the extension: work under way is ended, and nothing is left."""
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
