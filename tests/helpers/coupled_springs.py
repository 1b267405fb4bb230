"""Two coupled parts that meet by a spring with a gap, and their solution by SciPy."""

from functools import partial
from random import Random

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

import cosim


class SpringWithGap:
    """x'' = -k x - d x' - F and y'' = F - 30 y - y', two parts; F = K max(x - y - gap, 0).

    Args:
        seed: Of the random numbers.
        play: Whether the spring has its gap, of 5 mm, on both sides.
    """

    def __init__(self, seed: int, *, play: bool = False) -> None:
        random = Random(seed)
        self.k, self.d = random.uniform(1, 20), random.uniform(0.1, 1)
        self.stiff, self.gap = random.uniform(50, 500), random.uniform(-0.1, 0.2)
        self.x0 = -random.uniform(0.3, 1)
        self.play = play
        if play:
            self.stiff, self.gap = 500.0, 0.005

    def system(self, stop: float) -> cosim.System:
        """Return the coupled parts, with 200 output intervals."""
        settings = {"stop_time": stop, "output_interval": stop / 200}
        first, second = cosim.Model("first", **settings), cosim.Model("second", **settings)
        k, d = (
            first.parameter("k", "N/m", 1.0, "spring"),
            first.parameter("d", "N.s/m", 1.0, "damper"),
        )
        x, v = first.state("x", "m", -1.0, "place"), first.state("v", "m/s", 0.0, "speed")
        f = first.input("f", "N", 0.0, "force")
        first.derivative(x, v)
        first.derivative(v, f - k * x - d * v)
        y, w = second.state("y", "m", 0.0, "place"), second.state("w", "m/s", 0.0, "speed")
        u = second.input("u", "m", 0.0, "place of the other")
        stiff = second.parameter("stiff", "N/m", 100.0, "spring between")
        gap = second.parameter("gap", "m", 0.0, "its gap")
        force = stiff * ca.fmax(u - y - gap, 0)
        if self.play:
            force -= stiff * ca.fmax(y - u - gap, 0)
        second.derivative(y, w)
        second.derivative(w, force - 30 * y - w)
        second.output("back", "N", -force, "force on the other")
        parts = {"first": first.freeze(), "second": second.freeze()}
        values = {"first.k": self.k, "first.d": self.d, "first.x": self.x0}
        values |= {"second.stiff": self.stiff, "second.gap": self.gap}
        wires = {"first.f": "second.back", "second.u": "first.x"}
        return cosim.couple(parts, wires, start_values=values)  # all share compiled code

    def solution(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """Return the states at times, s, by pieces that end where the spring touches or is left."""
        sides = (1, -1) if self.play else (1,)

        def beyond(s: np.ndarray, side: int) -> float:
            return side * (s[0] - s[2]) - self.gap

        def rates(_: float, s: np.ndarray, touching: int) -> list[float]:
            force = touching * self.stiff * beyond(s, touching)
            own = -self.k * s[0] - self.d * s[1]
            return [s[1], own - force, s[3], force - 30 * s[2] - s[3]]

        start = np.array([self.x0, 0.0, 0.0, 0.0])
        touching = next((side for side in sides if beyond(start, side) > 0), 0)
        found, now = [np.empty((4, 0))], times[0]
        while True:
            ends = [partial(lambda side, t, s, _: beyond(s, side), side) for side in sides]
            for side, end in zip(sides, ends, strict=True):
                end.terminal, end.direction = True, -1 if side == touching else 1
            run = solve_ivp(
                rates, (now, times[-1]), start, "DOP853", times[times >= now], events=ends,
                args=(touching,), rtol=1e-12, atol=1e-14, max_step=5e-3,
            )  # fmt: skip
            found.append(np.reshape(run.y, (4, -1)))
            if run.status == 0:
                break
            place = next(i for i, at in enumerate(run.t_events) if at.size)
            now, start = run.t_events[place][0], run.y_events[place][0]
            touching = 0 if touching else sides[place]
        names = ("first.x", "first.v", "second.y", "second.w")
        return dict(zip(names, np.hstack(found), strict=True))
