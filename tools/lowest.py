# SPDX-License-Identifier: MIT
"""Print constraints with the lowest version of every dependency in pyproject.toml.

``python tools/lowest.py > constraints-lowest.txt``
"""

import re
import tomllib
from pathlib import Path

EXTRAS = ("dev",)
OTHERS = {"pyparsing": "3.1"}
"""Dependencies of dependencies whose later versions warn of the lowest matplotlib."""
REQUIREMENT = re.compile(r"(?P<name>[\w.-]+)(?:\[[\w,]+\])?>=(?P<version>[\w.]+)")


def lowest(pyproject: Path) -> dict[str, str]:
    """Return the lowest version of each dependency of the package and its extras, by name."""
    project = tomllib.loads(pyproject.read_text("utf-8"))["project"]
    extras = project["optional-dependencies"]
    required = [*project["dependencies"], *(text for extra in EXTRAS for text in extras[extra])]
    found = [REQUIREMENT.match(text) for text in required]
    return {match["name"]: match["version"] for match in found if match}


if __name__ == "__main__":
    print("# Written by tools/lowest.py")
    direct = lowest(Path(__file__).parents[1] / "pyproject.toml")
    for name, version in sorted((direct | OTHERS).items()):
        print(f"{name}=={version}")
