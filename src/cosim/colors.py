"""Colors of all pictures: curves, solvers, outcomes, loads, frames and invalid runs.

Okabe and Ito's colors, which color-blind readers can distinguish, come first.
"""

from collections.abc import Sequence
from zlib import crc32

from casadi_models.dae.scenery import BLUE, DARK, GREEN, ORANGE, PINK, SKY, YELLOW

_VIOLET, _BROWN, _WINE = "#6A3D9A", "#8B6914", "#882255"

CURVES = (BLUE, ORANGE, GREEN, PINK, YELLOW, SKY, _VIOLET, _BROWN, DARK, _WINE)
SECOND = "#000000"  # the second of two runs that are compared
GROUND = "0.85"  # lines on the ground
INVALID = "#A02020"  # spans and texts of invalid runs
INVALID_BODY = "#999999"  # bodies of invalid runs
FRAME_AXES = ("#B03030", "#207020", "#2040B0")  # axes 1, 2 and 3 of a body's frame
LOAD, TURN, INK = "#A04A00", "#7A2A6A", "#303030"  # positive loads, positive angles, text

# Outcomes of extreme cases, from the best to the worst
OUTCOMES = ("#A8D5BA", "#4C78A8", "#D55E00", "#8B0000", "#9467BD", "#111111", "#E7298A")

_SOLVERS = (BLUE, SKY, PINK, ORANGE, GREEN, YELLOW, _BROWN, _VIOLET)
_OTHER_SOLVERS = (_WINE, DARK)
MARKERS = "osD^vX*Pp"


def solver_look(name: str, table: Sequence[str]) -> tuple[str, str]:
    """Return the color and the matplotlib marker of a solver.

    The look of a solver in the table follows from its position, that of any other from its name.
    """
    if name in table:
        position = table.index(name)
        palette = _SOLVERS if position < len(_SOLVERS) else _OTHER_SOLVERS
        return palette[position % len(palette)], MARKERS[position % len(MARKERS)]
    number = crc32(name.encode())
    color = _OTHER_SOLVERS[number % len(_OTHER_SOLVERS)]
    return color, MARKERS[number // len(_OTHER_SOLVERS) % len(MARKERS)]
