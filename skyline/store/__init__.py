"""Stores: HDF5 files of renderings or of places.

A rendering is a view with its skyline and keypoints. A store is written once, takes its name when
its bytes are on disk, and is never appended to. `skyline.survey.build` writes the parts of a store
and merges them.
"""
