"""A stored view seen from a displaced eye, without rendering (paper 4.2).

The planners ask how far from a view its skyline still serves (`PREDICTORS`); `predict` gives the
views themselves. A displacement t is (right, up, forward) in the
view's own axes, metres, and up holds the change of the ground's height; the T of the paper's
Equation 4 is -t.

The drop by curvature and refraction is taken over from the stored view. Moving by t changes it,
seen from the new eye, by at most |t| (1 - k) / R in v: 0.013 px for 300 m.
"""

from skyline.prediction.predicted import predict
from skyline.prediction.predictors import PREDICTORS, Predictor
from skyline.prediction.shells import shell_edges_m
from skyline.prediction.truth import true_errors_px

__all__ = [
    "PREDICTORS",
    "Predictor",
    "predict",
    "shell_edges_m",
    "true_errors_px",
]
