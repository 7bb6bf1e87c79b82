"""Edges on more than two triangles: which of these go on in which, and what overlaps.

Around such an edge, each triangle either enters the solid or leaves it.  In how many
solids a place is follows from the triangles up to there.  So a triangle that leaves
belongs to the last one that entered; and where a place is in two solids, they overlap.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from typing import NamedTuple

import numpy as np

from rattlesweep.arrays import Flags, Floats, Integers
from rattlesweep.physics.mesh.solid import MERGED

# Two triangles that are nearer than this share of the longest side lie in one plane.
SAME_SHEET = 4 * MERGED


class Sheets(NamedTuple):
    """Pairs of triangles that go on in each other, and how much lies in two solids.

    This is the volume of the sectors around the edges, as far as their triangles reach:
    it tells an overlap from rounding, not how large it is.
    """

    first: Integers
    second: Integers
    twice: float


class _Sheet(NamedTuple):
    """A triangle at an edge."""

    triangle: int
    leaves: bool  # whether the solid ends there
    angle: float
    height: float  # over the edge


def sheets_at(
    vertices: Floats,
    faces: Integers,
    corners: Integers,
    edge: Integers,
    is_forward: Flags,
) -> Sheets:
    """Return what goes on in what at some edges.

    `corners` are the numbers of corners, row by row, behind which the edges lie; those
    of one edge follow each other, with its number in `edge`, and are as often forward
    as not.
    """
    if not len(corners):
        none = np.zeros(0, np.int64)
        return Sheets(none, none, 0.0)
    triangle, place = np.divmod(corners, 3)
    start = faces[triangle, place]
    end = faces[triangle, (place + 1) % 3]
    tip = vertices[faces[triangle, (place + 2) % 3]]
    low = vertices[np.where(is_forward, start, end)]
    along = vertices[np.where(is_forward, end, start)] - low
    length = np.linalg.norm(along, axis=1)
    along = along / length[:, None]
    across = tip - low
    across -= np.sum(across * along, axis=1)[:, None] * along
    height = np.linalg.norm(across, axis=1)

    # Angles around the edge are counted from its first triangle that has an area.
    begins = np.flatnonzero(np.diff(edge, prepend=-1) != 0)
    tallest = np.array(
        [part.argmax() for part in np.split(height, begins[1:])], np.int64
    )
    count = np.diff(begins, append=len(edge))
    zero = np.repeat(across[begins + tallest], count, axis=0)
    ahead = np.cross(along, zero)
    angle = np.arctan2(np.sum(across * ahead, axis=1), np.sum(across * zero, axis=1))

    tolerance = SAME_SHEET * float(np.ptp(vertices, axis=0).max())
    pairs: list[tuple[int, int]] = []
    twice = 0.0
    columns = (triangle.tolist(), is_forward.tolist(), angle.tolist(), height.tolist())
    sheets = [_Sheet(*row) for row in zip(*columns, strict=True)]
    for begin, size in zip(begins.tolist(), count.tolist(), strict=True):
        clusters = _clusters(sheets[begin : begin + size], tolerance)
        twice += float(length[begin]) * _overlap(clusters)
        pairs += _pairs(clusters)
    first, second = np.array(pairs, np.int64).T
    return Sheets(first, second, twice)


def _clusters(sheets: Sequence[_Sheet], tolerance: float) -> list[list[_Sheet]]:
    """Return the sheets at an edge in turn, those of one plane together.

    The first cluster follows the place that is in the fewest solids.
    """
    turn = sorted(sheets, key=lambda sheet: sheet.angle)
    gaps = []
    for before, sheet in zip([turn[-1], *turn[:-1]], turn, strict=True):
        gap = (sheet.angle - before.angle) % (2 * np.pi)
        gaps.append(gap * min(sheet.height, before.height))
    widest = gaps.index(max(gaps))
    turn = turn[widest:] + turn[:widest]
    gaps = gaps[widest:] + gaps[:widest]
    starts = np.cumsum([False, *(gap > tolerance for gap in gaps[1:])])
    clusters = [
        [sheet for _, sheet in group]
        for _, group in groupby(
            zip(starts.tolist(), turn, strict=True), key=lambda pair: pair[0]
        )
    ]
    depths = _depths(clusters)
    least = depths.index(min(depths)) + 1
    return clusters[least:] + clusters[:least]


def _depths(clusters: Sequence[Sequence[_Sheet]]) -> list[int]:
    """Return in how many solids a place behind each cluster is, up to a constant."""
    depth = 0
    depths = []
    for cluster in clusters:
        depth += sum(-1 if sheet.leaves else 1 for sheet in cluster)
        depths.append(depth)
    return depths


def _overlap(clusters: Sequence[Sequence[_Sheet]]) -> float:
    """Return the area of the sectors that are in two solids or more."""
    area = 0.0
    following = [*clusters[1:], clusters[0]]
    for depth, here, there in zip(_depths(clusters), clusters, following, strict=True):
        if depth > 1:
            angle = (there[0].angle - here[-1].angle) % (2 * np.pi)
            radius = min(sheet.height for sheet in (*here, *there))
            area += (depth - 1) * angle * radius**2 / 2
    return area


def _pairs(clusters: Sequence[Sequence[_Sheet]]) -> list[tuple[int, int]]:
    """Return which triangle that leaves belongs to which one that enters."""
    entered: list[int] = []
    left: list[int] = []
    pairs = []
    is_inside = not any(_depths(clusters))
    for number, cluster in enumerate(clusters):
        leaving = [sheet.triangle for sheet in cluster if sheet.leaves]
        entering = [sheet.triangle for sheet in cluster if not sheet.leaves]
        if is_inside and number == 0:
            # All around is in one solid, or in none: what lies in one plane are the
            # walls of two, which belong to what is entered last.
            left = leaving
            leaving = []
        while leaving or entering:
            if leaving and entered:
                pairs.append((entered.pop(), leaving.pop()))
            elif entering:
                entered.append(entering.pop())
            else:
                left.append(leaving.pop())
    pairs += zip(entered, left, strict=True)
    return pairs
