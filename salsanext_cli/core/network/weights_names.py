# SPDX-License-Identifier: MIT
"""Names of weights: what stands for a file, and what a wrong name probably means."""

from pathlib import Path

from salsanext_cli.core.errors import nearest

DEFAULT_NAME = "default"  # Weights of the package; a file of that name needs an absolute path
PAPER_NETWORKS = ("rangenet53", "salsanet", "salsanext-v1")
"""First letters of the networks in `examples/paper_networks`, which earlier versions had."""
PAPER_NETWORKS_HINT = (
    "run `pip install examples/paper_networks` in a clone, and train its networks: "
    "`salsanext train DATASET RUN --set architecture=NAME`"
)


def hint_for_missing(path: Path) -> str:
    """Return what helps if there is no weights file of a path."""
    from salsanext_cli.io.files.atomic import WEIGHTS_SUFFIX  # Only errors need numpy

    if str(path).startswith(PAPER_NETWORKS):
        return PAPER_NETWORKS_HINT
    beside = {file.name: str(file) for file in path.parent.glob(f"*{WEIGHTS_SUFFIX}")}
    if path.name == str(path):
        beside[DEFAULT_NAME] = DEFAULT_NAME
    likely = nearest(path.name, beside)
    return f"did you mean {beside[likely]}?" if likely else "check the name"
