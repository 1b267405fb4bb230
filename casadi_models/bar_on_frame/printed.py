"""The book's numbers of the bar on a frame: Unit 7, Example 2."""

from casadi_models.printed import Printed

PRINTED = (
    Printed("f1_G_F", 0.0, "-0.2", "lbf"),
    Printed("f1_G_F", 10.0, "-0.2", "lbf"),
    Printed("tk_G_F", 10.0, "0.01666", "ft.lbf"),
)
