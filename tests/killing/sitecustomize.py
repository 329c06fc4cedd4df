# SPDX-License-Identifier: MIT
"""Module that Python imports first, if PYTHONPATH names its folder, instead of the system's own."""

import file_steps  # noqa: F401
