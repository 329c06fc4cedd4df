# SPDX-License-Identifier: MIT
"""Ground, mounting and view of a sensor, found from its scans."""
