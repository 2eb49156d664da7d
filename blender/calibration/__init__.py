"""Checks calibrations against pycolmap and Blender, estimates unknown calibrations, and refines given ones.

Modules that check a calibration:

- `capture`: reads cameras and poses from `capture.json` and from the COLMAP model beside it.
- `model`: compares the projections of Blender, pycolmap and the `stlfr` module.
- `frames`: one image per camera of about the same instant, with masks of moving pixels.
- `mapping`: the cameras' poses by pycolmap's structure from motion, from these images and the given intrinsics.
- `residuals`: the difference of these poses from the capture's poses, for each camera.
- `report`: the results of both checks, as JSON and as a table.

Modules that estimate or refine a calibration:

- `background`: each camera's static background, the median of its frames; needs no synchronization.
- `linear`: reprojection errors, and their derivatives by cameras, lenses and points.
- `adjustment`: bundle adjustment with priors on the lenses.
- `uncertainty`: the standard errors of poses and lenses.
- `estimation`: the commands `stlfr calibrate` and `stlfr refine`.
"""
