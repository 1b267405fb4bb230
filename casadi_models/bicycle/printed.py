"""The book's numbers of the upright bicycle: Unit 7, Example 3."""

from casadi_models.printed import Printed

PRINTED = (
    Printed("thetaF_dot", 0.0, "-13.1428571", "rad/s"),
    Printed("psi", 20.0, "13.65", "deg"),
    Printed("thetaR_dot", 20.0, "-15.41", "rad/s"),
    Printed("thetaF_dot", 20.0, "-13.21", "rad/s"),
)
