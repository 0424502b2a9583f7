"""The store: an HDF5 file of renderings (views with skylines and keypoints) or of places.

A store is written once, takes its name when its bytes are on disk, and is never appended to.
`skyline.survey.build` writes the parts of a store and merges them.
"""
