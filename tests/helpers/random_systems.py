"""Random coupled systems, and their solution without any code of the product for coupling."""

from random import Random

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp

from casadi_models.dae import Dae, Model

SPAN = 2.0  # s


class RandomSystem:
    """Two to four smooth parts whose inputs follow outputs of others, also through loops.

    Attributes:
        parts: Models by name.
        connections: Inputs by name, with the outputs that drive them.
    """

    def __init__(self, seed: int, *, relations: bool = False) -> None:
        """Draw a system.

        Args:
            seed: Of the random numbers.
            relations: Whether rates have kinks, jumps and dry friction.
        """
        self._random, self._relations = Random(seed), relations
        self._fast = self._random.choice([1, 1, 5, 30])
        self.parts, self._laws, self._starts = dict[str, Dae](), [], list[float]()
        sizes = [self._sizes() for _ in range(self._random.randint(2, 4))]
        for i, size in enumerate(sizes):
            self._draw(f"part{i}", *size)
        outputs = [(i, k) for i, size in enumerate(sizes) for k in range(size[2])]
        self.connections, self._wires = dict[str, str](), [[] for _ in sizes]
        for i, (_, n_u, _) in enumerate(sizes):
            for k in range(n_u):
                source = self._random.choice([o for o in outputs if o[0] != i])
                self.connections[f"part{i}.u{k}"] = f"part{source[0]}.y{source[1]}"
                self._wires[i].append(outputs.index(source))
        self._names = [f"part{i}.x{k}" for i, size in enumerate(sizes) for k in range(size[0])]
        self._names += [f"part{i}.y{k}" for i, k in outputs]
        self._split = np.cumsum([size[0] for size in sizes])[:-1]

    def solution(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """Return states and outputs at times, by scipy, loops solved in every evaluation."""
        t, x = ca.MX.sym("t"), ca.MX.sym("x", len(self._starts))
        y = ca.MX.sym("y", sum(".y" in name for name in self._names))
        ends = [0, *self._split.tolist(), len(self._starts)]
        ways = zip(self._laws, ca.vertsplit(x, ends), self._wires, strict=True)
        found = [law(t, states, y[wires]) for law, states, wires in ways]
        rates, outputs = (ca.vertcat(*column) for column in zip(*found, strict=True))
        loops = {"x": y, "p": ca.vertcat(t, x), "g": outputs - y}
        solved = ca.rootfinder("loops", "newton", loops, {"abstol": 1e-14})(0, ca.vertcat(t, x))
        both = ca.Function("both", [t, x, y], [rates, y])(t, x, solved)
        whole = ca.Function("whole", [t, x], both)

        def evaluated(t, x, which):
            return np.array(whole(t, x)[which]).ravel()

        run = solve_ivp(
            lambda t, x: evaluated(t, x, 0), (0, times[-1]), self._starts,
            "DOP853", t_eval=times, rtol=3e-14, atol=1e-15,
        )  # fmt: skip
        rows = [
            np.concatenate((x, evaluated(t, x, 1))) for t, x in zip(times, run.y.T, strict=True)
        ]
        return dict(zip(self._names, np.array(rows).T, strict=True))

    def _sizes(self) -> tuple[int, int, int]:
        return self._random.randint(1, 3), self._random.randint(1, 2), self._random.randint(1, 2)

    def _number(self, low: float, high: float) -> float:
        return round(self._random.uniform(low, high), 3)

    def _sum(self, symbols):
        return sum(self._number(-1, 1) * symbol for symbol in symbols)

    def _draw(self, name: str, n_x: int, n_u: int, n_y: int) -> None:
        random, model = self._random, Model(name, stop_time=SPAN, output_interval=0.02)
        starts = [self._number(-1, 1) for _ in range(n_x)]
        x = [model.state(f"x{i}", "1", start, "a state") for i, start in enumerate(starts)]
        u = [model.input(f"u{i}", "1", 0.0, "an input") for i in range(n_u)]
        rates, outputs = [], []
        for state in x:
            speed = self._number(0.3, 2) * (self._fast if random.random() < 0.3 else 1)
            line = self._sum([*x, *u])
            law = [line, ca.sin(line), ca.tanh(2 * line), line / (1 + line**2)]
            force = random.choice([*law, ca.cos(2 * model.t) * line])
            if self._relations and random.random() < 0.4:
                gap = self._sum([*x, *u]) + self._number(-0.3, 0.3)
                step = ca.if_else(model.t > self._number(0.2, 1.8), 0.6, 0)
                force += random.choice([ca.fmax(gap, 0), ca.fabs(gap), 0.5 * ca.sign(gap), step])
            rates.append(speed * (force - state))
            model.derivative(state, rates[-1])
        for i in range(n_y):
            y = self._sum(x)
            if random.random() < 0.3:
                y += self._number(-0.6, 0.6) * random.choice(u)
            outputs.append(ca.sin(y) if random.random() < 0.3 else y)
            model.output(f"y{i}", "1", outputs[-1], "an output")
        self.parts[name] = model.freeze()
        law = [model.t, ca.vertcat(*x), ca.vertcat(*u)], [ca.vertcat(*rates), ca.vertcat(*outputs)]
        self._laws.append(ca.Function("law", *law))
        self._starts += starts
