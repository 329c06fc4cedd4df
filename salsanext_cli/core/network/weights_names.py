# SPDX-License-Identifier: MIT
"""Names of weights: what stands for a file, and what a wrong name probably means."""

from salsanext_cli.core.wording import command, setting

DEFAULT_NAME = "default"  # Weights of the package; a file of that name needs an absolute path
PAPER_NETWORKS = ("rangenet53", "salsanet", "salsanext-v1")
"""First letters of the networks of the extra `paper`."""


def paper_networks_hint() -> str:
    """Return how to install and train the networks of `PAPER_NETWORKS`."""
    # Only here, because the metadata of packages double the time of `--help`.
    from salsanext_cli.core.optional_packages import extra_command

    train = command("salsanext train DATASET RUN", setting("recipe.architecture", "NAME"))
    return f"{extra_command('paper')}; then train one of its networks: `{train}`"
