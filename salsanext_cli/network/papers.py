# SPDX-License-Identifier: MIT
"""What the papers print of the networks: facts, as text, so that every digit is theirs."""

from __future__ import annotations

from dataclasses import dataclass
from decimal import ROUND_DOWN, ROUND_HALF_UP, Decimal


@dataclass(frozen=True, slots=True, kw_only=True)
class Printed:
    """A network's row; a figure that is not known for sure is None.

    Attributes
    ----------
    row : str
        Which row, and of what.
    parameters : str
        In millions.
    flops : str or None
        Of one image of 64×2048, in 10⁹, every multiplication and every addition.
    miou_pixels, miou : str or None
        In the table of ablations, SemanticKITTI, without and with the vote of the nearest
        neighbours, in %.
    miou_test : str or None
        On the benchmark's test sequences, in %.
    determined : bool
        Whether the text says all that the network is made of.
    """

    row: str
    parameters: str
    flops: str | None = None
    miou_pixels: str | None = None
    miou: str | None = None
    miou_test: str | None = None
    determined: bool = True


V2 = "arXiv 2003.03653v3, Table II"
V1 = "arXiv 2003.03653v1, Table II"

PAPERS: dict[str, Printed] = {
    "salsanext": Printed(
        row=f"{V2}: + Lovász-Softmax",
        parameters="6.73",
        flops="125.68",
        miou_pixels="56.6",
        miou="59.5",
        miou_test="59.5",
    ),
    "salsanext-v1": Printed(row=f"{V1}: + Lovász-Softmax", parameters="23.26"),
    "rangenet53": Printed(
        row="arXiv 2003.03653v3, Tables I and III: RangeNet53++",
        parameters="50",
        flops="720.96",
        miou_test="52.2",
    ),
    "salsanet": Printed(
        row=f"{V2}: SalsaNet",
        parameters="6.58",
        flops="51.60",
        miou_pixels="43.5",
        miou="44.8",
        miou_test="45.4",
    ),
    "salsanet-context": Printed(
        row=f"{V2}: + context module",
        parameters="6.64",
        flops="69.20",
        miou_pixels="44.7",
        miou="46.0",
    ),
    "salsanet-dropout": Printed(
        row=f"{V2}: + central dropout",
        parameters="6.64",
        flops="69.20",
        miou_pixels="44.6",
        miou="46.3",
    ),
    "salsanet-pooling": Printed(
        row=f"{V2}: + average pooling",
        parameters="5.85",
        flops="66.78",
        miou_pixels="47.7",
        miou="49.9",
    ),
    "salsanet-dilated": Printed(
        row=f"{V2}: + dilated convolution",
        parameters="9.25",
        flops="161.60",
        miou_pixels="48.2",
        miou="50.4",
        determined=False,
    ),
    "salsanet-shuffle": Printed(
        row=f"{V2}: + pixel-shuffle",
        parameters="6.73",
        flops="125.68",
        miou_pixels="50.4",
        miou="53.0",
    ),
    "salsanext-v1-layers": Printed(row=f"{V1}: + extra layers", parameters="26.38"),
    "salsanext-v1-context": Printed(row=f"{V1}: + context module", parameters="26.40"),
    "salsanext-v1-dropout": Printed(row=f"{V1}: + new dropout", parameters="26.40"),
    "salsanext-v1-pooling": Printed(row=f"{V1}: + average pooling", parameters="23.26"),
}
"""By the name of the architecture. The test figures are of Table I; SalsaNet's there is not that of
its row in the table of ablations."""


def agrees(count: int, printed: str) -> bool:
    """Return whether a count is the printed number of millions, rounded or cut off."""
    digit, millions = Decimal(printed), Decimal(count) / 1_000_000
    return digit in (millions.quantize(digit, way) for way in (ROUND_HALF_UP, ROUND_DOWN))
