# SPDX-License-Identifier: MIT
"""Names of weights: what stands for a file, and what a wrong name probably means."""

from salsanext_cli.core.wording import command, setting

DEFAULT_NAME = "default"  # Weights of the package; a file of that name needs an absolute path
PAPER_NETWORKS = ("rangenet53", "salsanet", "salsanext-v1")
"""First letters of the networks in `examples/paper_networks`, which earlier versions had."""


def paper_networks_hint() -> str:
    """Return how to train the networks of `PAPER_NETWORKS`."""
    train = command("salsanext train DATASET RUN", setting("recipe.architecture", "NAME"))
    install = "run `pip install examples/paper_networks` in a clone"
    return f"{install}, and train its networks: `{train}`"
