"""The methods of the paper, a module for each step.

- Section 3, the matcher: `curves` has local skylines, their Chamfer distance and the affine map of
  two skylines; `matcher` ranks the locations of a store by the distance after that map. Keypoints
  are in `skyline.skylines`, the depth images in `skyline.render.depth`.
- Section 4.1, the camera: its four views are also in `skyline.skylines`.
- Section 4.2, Equations 1 to 4: `tolerance_areas`.
- Section 4.3, the five strategies: `planners`. `plan` runs one on a terrain, and `plan_check`
  compares the coverage that it predicts with renderings.
"""
