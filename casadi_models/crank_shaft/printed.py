"""The book's numbers of the crank shaft: Unit 7, Example 1."""

from casadi_models.printed import Printed

PRINTED = (
    Printed("fx_A", 0.0, "-6.4994", "lbf"),
    Printed("fy_A", 0.0, "0.025998", "lbf"),
    Printed("fx_B", 0.0, "6.4994", "lbf"),
    Printed("fy_B", 0.0, "-0.025998", "lbf"),
    Printed("T", 0.0, "0.086659", "ft.lbf"),
)
