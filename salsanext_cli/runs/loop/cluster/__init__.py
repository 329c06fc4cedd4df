# SPDX-License-Identifier: MIT
"""Workers of a run on the nodes of a Ray cluster, with the interface of `pool`.

The main process (`attempts`) decides which chunk is attempted, and how often (`chunk_queue`). It
starts a driver process (`driver_process`, `driver_program`), which alone uses Ray (`driver`,
`ray_cluster`) and starts workers on the nodes (`node_code`, `work`). They exchange `messages`.

Ray handles signals, prints, and ends the process that loses its cluster. In a process of its own
it does so to nobody else.
"""
