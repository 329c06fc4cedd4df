# SPDX-License-Identifier: MIT
"""Points to pixels and back: pure functions.

::

    projection          a scan seen from the sensor (paper eq. 1)
    ├── projection_numba    … compiled for the CPU
    ├── projection_torch    … on a torch device, the same bits
    └── view                the sensor's numbers as these take them
    normalise           the network's input from a range image
    knn                 labels of pixels to labels of points
    ├── knn_numba           … compiled for the CPU
    └── knn_torch           … on a torch device, the same labels
    compiled            how the CPU kernels are compiled, cached and shared among threads
"""
