"""Checks a capture's calibration against pycolmap and Blender, two implementations that aren't ours.

- `capture`: what is checked: cameras and poses of `capture.json` and of the COLMAP model beside it.
- `model`: do Blender, pycolmap and the `stlfr` module project the same points to the same pixels?
- `frames`: the images of one instant, and what may have moved in them.
- `mapping`: where pycolmap puts the cameras from those images alone, intrinsics as given.
- `residuals`: how far that is from the capture's poses, camera by camera.
- `report`: both questions in one result, and as a table.
"""
