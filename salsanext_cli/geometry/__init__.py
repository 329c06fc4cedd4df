# SPDX-License-Identifier: MIT
"""Points to pixels and back: pure functions.

::

    projection          a scan seen from the sensor (paper eq. 1)
    ├── projection_numba    … compiled for the CPU
    ├── projection_torch    … on a torch device, the same bits
    └── projection_parameters   the sensor's numbers as these take them
    normalise           the network's input from a range image
    knn                 labels of pixels to labels of points
    ├── knn_numba           … compiled for the CPU
    └── knn_torch           … on a torch device, the same labels
    ranges              distances of points, and which points hold a measurement
    coverage            share of the points that lies outside a sensor's field of view
    noise               the variance of a range image by the sensor's noise
"""
