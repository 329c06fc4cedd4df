# SPDX-License-Identifier: MIT
"""A process that claims an output folder when it is told to, and holds it until told to end.

::

    python claimant.py OUT WEIGHTS [overwrite]
"""

import sys
from pathlib import Path

from salsanext_cli.errors import OutputError
from salsanext_cli.storage.output_run import claimed


def main(out: str, weights: str, overwrite: str = "") -> None:
    """Claim at the first line of stdin, end at the second."""
    _say("ready")
    sys.stdin.readline()
    settings, writes = {"weights": weights}, ("predictions",)
    try:
        with claimed(Path(out), "predict", settings, writes, overwrite=bool(overwrite)):
            _say("claimed")
            sys.stdin.readline()
    except OutputError as error:
        _say(f"refused: {error}")


def _say(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(*sys.argv[1:])
