# SPDX-License-Identifier: MIT
"""ROS bags: reading clouds, and copying bags with other clouds."""
