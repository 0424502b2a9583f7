"""The geometry of a camera, from its pixels to azimuths and elevations.

No other package of Skyline projects, levels or distorts, or takes derivatives of these steps. Four
kinds of coordinates follow one another:

* *pixels*: columns and rows; pixel centres are at whole numbers;
* *across, above*: right of and above a picture's middle, in halves of its width;
* *u, v*: the same on an image of unit focal length; see `Projection.rays`;
* *azimuth, elevation*: directions in a level frame, see `level`.
"""
