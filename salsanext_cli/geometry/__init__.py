# SPDX-License-Identifier: MIT
"""Points to pixels and back: pure functions.

::

    projection              a scan seen from the sensor (paper eq. 1)
    ├── projection_numba        … compiled for the CPU
    └── projection_torch        … on a torch device, the same bits
    beam_rows               rows of points by their beams, where the sensor knows these
    row_gaps                rows that sparse beams leave empty: their share, and filling them
    mounting                scans in the frame of their sensor
    few_points              a sample of the points of a scan
    intensity               intensities on the scale of another sensor; whether they are any
    normalise               the network's input, and its variance by the sensor's noise
    knn                     labels of pixels to labels of points
    ├── knn_numba               … compiled for the CPU
    └── knn_torch               … on a torch device, the same labels
    gather                  values of pixels onto points and back
    ranges                  distances of points, and which of them hold a measurement
"""
