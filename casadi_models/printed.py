"""Numbers printed in a book about a system, to compare with simulated ones."""

from typing import NamedTuple


class Printed(NamedTuple):
    """A number as it is printed; it holds for the values that the model has by default.

    Attributes:
        variable: Of which it is the value.
        time: When, s.
        value: As it is printed, e.g. "-6.4994": half of its last digit is the book's own rounding.
        unit: Of the value.
    """

    variable: str
    time: float
    value: str
    unit: str

    @property
    def rounding(self) -> float:
        """Half a unit of the last digit."""
        _, _, decimals = self.value.partition(".")
        return 0.5 * 10.0 ** -len(decimals)
