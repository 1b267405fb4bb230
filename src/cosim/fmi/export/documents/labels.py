"""Where texts stand in a picture: beside their points, and neither on each other nor on lines."""

from collections.abc import Iterator, Sequence

import numpy as np

Box = tuple[float, float, float, float]  # left, top, right, bottom
_DIRECTIONS = 16
_RINGS = (1.0, 1.8, 2.8, 4.0)  # distances from the point, in gaps
_SAMPLE = 0.5  # distance of what stands for a line, in gaps
_ON_TEXT, _ON_LINE, _OUTSIDE, _FAR = 300.0, 8.0, 1000.0, 6.0  # costs


class Labels:
    """The places that are taken in a picture, pixels, y downward.

    Args:
        size: Width and height of the picture.
        gap: Between a text and its point.

    Attributes:
        boxes: Where the texts are.
    """

    def __init__(self, size: Sequence[float], gap: float) -> None:
        self._size, self._gap = size, gap
        self.boxes: list[Box] = []
        self._on_lines = np.zeros((0, 2))

    def line(self, start: Sequence[float], end: Sequence[float]) -> None:
        """Note a line that texts had better not cover."""
        ends = np.array([start, end], dtype=float)
        count = 2 + int(np.linalg.norm(ends[1] - ends[0]) / (_SAMPLE * self._gap))
        share = np.linspace(0, 1, count)[:, None]
        points = ends[0] + share * (ends[1] - ends[0])
        self._on_lines = np.vstack([self._on_lines, points])

    def place(self, at: Sequence[float], width: float, height: float) -> Box:
        """Return where a text of this size stands best beside a point, and note it."""
        box = min(self._around(at, width, height), key=lambda found: found[0])[1]
        self.boxes.append(box)
        return box

    def _around(
        self, at: Sequence[float], width: float, height: float
    ) -> Iterator[tuple[float, Box]]:
        """Yield boxes around a point, the right one first, with what they cost."""
        for ring in _RINGS:
            for i in range(_DIRECTIONS):
                angle = 2 * np.pi * i / _DIRECTIONS
                x, y = np.cos(angle), -np.sin(angle)
                middle_x = at[0] + x * (ring * self._gap + width / 2)
                middle_y = at[1] + y * (ring * self._gap + height / 2)
                box = (middle_x - width / 2, middle_y - height / 2)
                whole = (*box, box[0] + width, box[1] + height)
                yield self._cost(whole) + _FAR * (ring - 1), whole

    def _cost(self, box: Box) -> float:
        left, top, right, bottom = box
        texts = sum(_overlap(box, other) for other in self.boxes)
        x, y = self._on_lines.T
        covered = np.count_nonzero((x > left) & (x < right) & (y > top) & (y < bottom))
        within = left >= 0 and top >= 0 and right <= self._size[0] and bottom <= self._size[1]
        share = texts / ((right - left) * (bottom - top))
        return (
            (_ON_TEXT * (1 + share) if share else 0.0)
            + _ON_LINE * covered
            + _OUTSIDE * (not within)
        )


def _overlap(one: Box, other: Box) -> float:
    """Return the area that two boxes share."""
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    return max(width, 0.0) * max(height, 0.0)
