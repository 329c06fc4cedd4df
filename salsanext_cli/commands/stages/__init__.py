# SPDX-License-Identifier: MIT
"""Stages: one file per command, from folder to folder, or from file to file.

`eval` is in `evaluate`, and `view` in `report`; `training_scenes` serves `train`.
"""
