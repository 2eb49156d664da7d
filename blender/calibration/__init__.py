"""Calibrations: checked against pycolmap and Blender, found where there is none, and refined.

- `capture`: what is checked: cameras and poses of `capture.json` and of the COLMAP model beside it.
- `model`: do Blender, pycolmap and the `stlfr` module project the same points to the same pixels?
- `frames`: the images of one instant, and what may have moved in them.
- `mapping`: where pycolmap puts the cameras from those images alone, intrinsics as given.
- `residuals`: how far that is from the capture's poses, camera by camera.
- `report`: both questions in one result, and as a table.

Found and refined:

- `background`: what stands still, the median of each camera's frames, which needs no synchronization.
- `linear`: reprojection errors, and how they change with cameras, lenses and points.
- `adjustment`: bundle adjustment with priors on the lenses.
- `uncertainty`: the standard errors of poses and lenses.
- `estimation`: `stlfr calibrate` and `stlfr refine` from these parts.
"""
