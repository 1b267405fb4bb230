"""Numbers printed in a book about a system, Unit 7, to compare with simulated ones."""

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


PRINTED = {  # by system
    "crank_shaft": (
        Printed("fx_A", 0.0, "-6.4994", "lbf"),
        Printed("fy_A", 0.0, "0.025998", "lbf"),
        Printed("fx_B", 0.0, "6.4994", "lbf"),
        Printed("fy_B", 0.0, "-0.025998", "lbf"),
        Printed("T", 0.0, "0.086659", "ft.lbf"),
    ),
    "bar_on_frame": (
        Printed("f1_G_F", 0.0, "-0.2", "lbf"),
        Printed("f1_G_F", 10.0, "-0.2", "lbf"),
        Printed("tk_G_F", 10.0, "0.01666", "ft.lbf"),
    ),
    "bicycle": (
        Printed("thetaF_dot", 0.0, "-13.1428571", "rad/s"),
        Printed("psi", 20.0, "13.65", "deg"),
        Printed("thetaR_dot", 20.0, "-15.41", "rad/s"),
        Printed("thetaF_dot", 20.0, "-13.21", "rad/s"),
    ),
}
