# SPDX-License-Identifier: MIT
"""Names of the folders of results, and the stages that fill them."""

from salsanext_cli.core.uncertainty.kinds import UNCERTAINTY

SINGLE_SCAN_STAGES = ("predict", "knn-refine", "uncertainty")
FUSED = "fused"  # Folder of the fused labels in the folder of the labels of single scans
PREDICTION_STAGES = (*SINGLE_SCAN_STAGES, "fuse")  # Stages whose results later stages read
ERROR = "uncertainty/error"
LEAST_CONFIDENCE = "uncertainty/least_confidence"  # 1 − the largest probability
ORIGINS = "origins"  # Position of the sensor of each registered scan
DISAGREEMENT = "uncertainty/disagreement"  # Share of the scans against the label
COLOURINGS = ("label", "truth", "wrong", "intensity", "range", *UNCERTAINTY)
"""Values for the colours of point clouds."""
COLOURS = (*COLOURINGS, "uncertainty")  # "uncertainty": see `ResultFolder.default_uncertainty`
SUFFIX_OF_FOLDER = {
    "range": ".npy",
    "pixels": ".npy",
    ORIGINS: ".npy",
    "pixel_labels": ".npy",
    "predictions": ".label",
    "probabilities": ".npy",
    "votes": ".npy",
    "views": ".npy",
    "objects": ".csv",
    **{f"uncertainty/{kind}": ".npy" for kind in UNCERTAINTY},
    "pictures": ".png",
    "ply": ".ply",
    **{f"ply/{name}": ".ply" for name in COLOURINGS},
    "las": ".las",
    "laz": ".laz",
}
"""Folders of a sequence in an output folder, and the suffix of the files in each."""
