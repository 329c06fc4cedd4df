# SPDX-License-Identifier: MIT
"""Objects of a street as meshes."""
