"""stlfr in Blender: rigs, cameras, filming and truth as plain functions.

The extension and the headless scripts (`capture.py`, `check.py`) share these modules:

- `rig`: the rig file and its shutter times
- `camera`: Blender's camera to COLMAP's `PINHOLE` and back
- `distortion`: COLMAP's `OPENCV` lens
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
- `errors`: one sentence for the user

Only `film` and `scenes` import `bpy`, so that everything else starts at once and tests anywhere.
"""
