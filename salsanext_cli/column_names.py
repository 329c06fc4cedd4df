# SPDX-License-Identifier: MIT
"""Names of the columns of files that do not name them."""

MAX_COLUMNS = 64
COLUMNS_EXPECTED = (
    f"up to {MAX_COLUMNS} different names in lower case, with x, y and z, "
    "such as x,y,z,intensity,ring"
)
UNUSED_COLUMN = "_"
"""Name of a column that means nothing; the only one that may occur more than once."""


def are_columns(names: tuple[str, ...]) -> bool:
    """Say whether names can be those of the columns of a table of points."""
    if not isinstance(names, tuple) or not all(isinstance(name, str) for name in names):
        return False
    used = [name for name in names if name != UNUSED_COLUMN]
    complete = not names or {"x", "y", "z"} <= set(used)
    plain = all(name == name.lower().strip() and name for name in names)
    return complete and plain and len(set(used)) == len(used) and len(names) <= MAX_COLUMNS
