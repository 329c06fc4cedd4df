# SPDX-License-Identifier: MIT
"""Points to pixels and back: pure functions.

::

    projection              a scan in the frame of its sensor, and its range image (paper eq. 1)
    └── projection_torch        … on a torch device, the same bits
    network_input           … as input of a network: intensity, gaps between rows, normalisation
    knn                     labels of pixels to labels of points
    └── knn_torch               … on a torch device, the same labels
    label_transfer          labels of one scan onto another
"""
