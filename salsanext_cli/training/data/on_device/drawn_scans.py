# SPDX-License-Identifier: MIT
"""Scans that are drawn for a batch: those of its images, those mixed with them, those pasted."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.records import Indices, Mask
from salsanext_cli.training.data.on_device.batch_random import BatchRandom
from salsanext_cli.training.recipe import Recipe


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class DrawnScans:
    """Scans of a batch of B images: B first ones, then those mixed, then those pasted.

    Attributes
    ----------
    whole : (M,) int
        Indices of the scans with all their points.
    pasted : (Q,) int
        Indices of the scans whose rare points are pasted.
    image_of_scan : (M + Q,) int
        Number of the image of each scan.
    is_mixed : (M + Q,) bool
        Whether a scan is mixed into an image, so that it fills the odd cells of a checkerboard.
    """

    whole: Indices
    pasted: Indices
    image_of_scan: Indices
    is_mixed: Mask

    @property
    def count(self) -> int:
        """Number of scans."""
        return len(self.image_of_scan)


def draw_scans(
    first: Indices, counts: Sequence[int], recipe: Recipe, random: BatchRandom
) -> DrawnScans:
    """Draw the scans of a batch.

    Parameters
    ----------
    first : (B,) int
        Indices of the scans of the images; they continue over all data sets.
    counts : sequence of int
        Number of scans of each data set.
    recipe : Recipe
        Its `mix`, `paste` and `also` count.
    random : BatchRandom
        Random numbers of the batch.

    Returns
    -------
    DrawnScans
    """
    mixed = np.flatnonzero(random.happens(recipe.mix, len(first)))
    pasted = np.flatnonzero(random.happens(recipe.paste, len(first)))
    partners = draw_partners(first[mixed], counts, recipe.also, random.host)
    is_mixed = np.zeros(len(first) + len(mixed) + len(pasted), np.bool_)
    is_mixed[len(first) :][: len(mixed)] = True
    return DrawnScans(
        whole=np.concatenate([first, partners]),
        pasted=draw_partners(first[pasted], counts, recipe.also, random.host),
        image_of_scan=np.concatenate([np.arange(len(first)), mixed, pasted]),
        is_mixed=is_mixed,
    )


def draw_partners(
    index: Indices, counts: Sequence[int], also: float, random: np.random.Generator
) -> Indices:
    """Return another scan for each scan, from further data sets as often as samples are.

    Parameters
    ----------
    index : (S,) int
        Indices of the scans.
    counts : sequence of int
        Number of scans of each data set.
    also : float
        Share of the scans that are of further data sets.
    random : Generator
        Source of random numbers.

    Returns
    -------
    (S,) int
        Another index; the same one only in a data set of a single scan.
    """
    source = np.zeros(len(index), np.intp)
    if len(counts) > 1:
        is_further = random.random(len(index)) < also
        further = random.integers(1, len(counts), len(index))
        source = np.where(is_further, further, source)
    count = np.asarray(counts)[source]
    start = np.concatenate([[0], np.cumsum(counts)])[source]
    place = index - start
    is_same_source = (place >= 0) & (place < count)
    away = 1 + random.integers(np.maximum(1, count - 1))
    anywhere = random.integers(count)
    return start + np.where(is_same_source, (place + away) % count, anywhere)
