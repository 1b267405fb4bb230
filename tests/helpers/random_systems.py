"""Random coupled systems, and their solution without any code of the product for coupling."""

from random import Random

import casadi as ca
import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import root

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
        last = np.zeros(sum(".y" in name for name in self._names))

        def evaluated(t, x, y, which):
            states = np.split(x, self._split)
            ways = zip(self._laws, states, self._wires, strict=True)
            return np.concatenate([np.array(law(t, s, y[w])[which]).ravel() for law, s, w in ways])

        def outputs(t, x):
            nonlocal last
            y = evaluated(t, x, last, 1)
            if (evaluated(t, x, y, 1) != y).any():
                y = root(lambda guess: evaluated(t, x, guess, 1) - guess, y, tol=1e-14).x
            last = y
            return y

        method = "Radau" if self._fast > 20 else "DOP853"
        found = solve_ivp(
            lambda t, x: evaluated(t, x, outputs(t, x), 0), (0, times[-1]), self._starts, method,
            t_eval=times, rtol=1e-11, atol=1e-13,
        )  # fmt: skip
        rows = [np.concatenate((x, outputs(t, x))) for t, x in zip(times, found.y.T, strict=True)]
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
