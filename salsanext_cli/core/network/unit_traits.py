# SPDX-License-Identifier: MIT
"""Traits of the scans or drives that a threshold was chosen on, as the card of weights has them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class UnitTraits:
    """Traits of a scan or drive and of its predicted labels, which need no truth."""

    unit: str  # Name of the scan or drive
    uncertainty: float  # Mean of the uncertainty that the threshold limits, 0…1
    # Share of the labelled points by predicted class, from train id 1 on, 0…1
    class_shares: tuple[float, ...]
    measures: tuple[float, ...] = ()  # As of `measures_of`; empty in files of early versions
    codes: tuple[str, ...] = ()  # Codes of the warnings about its scans
