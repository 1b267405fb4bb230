"""Random models with relations of all kinds, and their solution without any event mechanism."""

from random import Random

import casadi as ca
import numpy as np

from casadi_models.dae import Dae, Model

SPAN = 2.0  # s
_BLOCK = 100  # steps of the independent solution between two of its rows


class _RandomModel:
    def __init__(self, seed: int) -> None:
        self.random = Random(seed)
        self.model = Model(f"random_{seed}", stop_time=SPAN)
        count = self.random.randint(2, 4)
        self.states = [
            self.model.state(f"x{i}", "1", self._number(-1, 1), "a state") for i in range(count)
        ]
        self.gain = self.model.parameter("k", "1", self._number(0.5, 2), "gain")

    def frozen(self, algebraic: bool) -> Dae:
        for i, x in enumerate(self.states):
            rate = -0.5 * x + self._smooth()
            if i == 0 or self.random.random() < 0.5:
                rate += self._term()
            if algebraic:
                z = self.model.algebraic(f"z{i}", "1", 0.0, "the rate of a state")
                self.model.equation((z - rate) * (1 + 0.1 * x**2))
                rate = z
            self.model.derivative(x, rate)
        return self.model.freeze()

    def happening(self) -> Dae:
        """Return a model with impacts, a counter and a sampled value besides the relations."""
        model, first = self.model, self.states[0]
        count = model.discrete("n", "1", 0.0, "number of events")
        sample = model.discrete("a", "1", 0.5, "a sampled value")
        for i, x in enumerate(self.states):
            more = self._term() + 0.3 * sample if i == 0 else 0
            model.derivative(x, -0.5 * x + self._smooth() + more)
        impact = {first: 0.8 * first - 0.05, count: count + 1}
        model.when(self._linear() > self._smooth(), impact, name="impact")
        if self.random.random() < 0.6:
            change = {sample: 0.3 * self._linear(), count: count + 10}
            model.when(self._linear() > 0.1 * count, change, name="change")
        period, offset = self._number(0.08, 0.5), self._number(0, 0.1)
        model.every(period, {sample: 0.7 * sample + 0.1 * self.states[1]}, offset=offset)
        return model.freeze()

    def _number(self, low, high):
        return round(self.random.uniform(low, high), 2)

    def _linear(self):
        chosen = self.random.sample(self.states, self.random.randint(1, 2))
        return sum(self._number(-2, 2) * x for x in chosen) + self._number(-0.5, 0.5)

    def _smooth(self):
        t = self.model.t
        match self.random.randrange(4):
            case 0:
                return self._linear()
            case 1:
                return ca.sin(self._linear() + self._number(0, 3) * t)
            case 2:
                return self.gain * ca.cos(self._linear())
        return self._number(-1, 1) * self.states[0] + ca.sin(self._number(1, 6) * t)

    def _condition(self, depth=0):
        t = self.model.t
        match self.random.randrange(8 if depth < 1 else 5):
            case 0 | 1:
                return self._linear() > self._smooth()
            case 2:
                return t > self._number(0.1, 1.9)
            case 3:
                return ca.fmod(t, self._number(0.2, 1)) < 0.1
            case 5:
                return ca.logic_and(self._condition(1), self._condition(1))
            case 6:
                return ca.logic_or(self._condition(1), self._condition(1))
            case 7:
                return ca.logic_not(self._condition(1))
        return self._linear() <= 0

    def _term(self):
        t, gap, smooth = self.model.t, self._linear(), self._smooth
        terms = [
            lambda: ca.if_else(self._condition(), smooth(), smooth()),
            lambda: -self._number(0.2, 2) * ca.sign(gap),
            lambda: ca.fabs(gap),
            lambda: ca.fmin(smooth(), smooth()),
            lambda: ca.fmax(0, smooth()),
            lambda: 0.3 * ca.floor(3 * gap),
            lambda: 0.2 * ca.floor(self._number(2, 6) * t),
            lambda: 0.2 * ca.ceil(2 * gap),
            lambda: ca.fmod(t, 0.37) + ca.fmod(gap, 1.3),
            lambda: ca.if_else(
                self._condition(),
                ca.if_else(self._condition(), smooth(), smooth()),
                ca.fmax(smooth(), gap),
            ),
            lambda: ca.fmax(gap, 0) ** 1.5,
            lambda: ca.if_else(gap > 0, ca.sqrt(gap), 0),
            lambda: -ca.sign(gap) * ca.sqrt(ca.fabs(gap)),
        ]
        return self.random.choice(terms)()


def random_model(seed: int, *, algebraic: bool = False) -> Dae:
    """Return a model of 2 to 4 states with relations of states and time in its equations.

    Args:
        seed: Of the random numbers.
        algebraic: Whether the rates are algebraic unknowns.
    """
    return _RandomModel(seed).frozen(algebraic)


def model_with_events(seed: int) -> Dae:
    """Return a random model with assignments at events of states and at samples."""
    return _RandomModel(seed).happening()


def solution(dae: Dae, step: float = 2e-5) -> np.ndarray:
    """Return the states every 100 steps of the classical Runge-Kutta method, without events."""
    p = ca.DM([variable.start for variable in dae.parameters])
    law = ca.Function("law", dae.arguments, [dae.ode])
    x, t, none = ca.SX.sym("x", dae.x.numel()), ca.SX.sym("t"), ca.SX(0, 1)

    def rate(time, state):
        return law(time, state, none, none, p)

    k1 = rate(t, x)
    k2 = rate(t + step / 2, x + step / 2 * k1)
    k3 = rate(t + step / 2, x + step / 2 * k2)
    k4 = rate(t + step, x + step * k3)
    end = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    steps = ca.Function("step", [x, t], [end], {"cse": True}).mapaccum("steps", _BLOCK)
    rows = [np.array([variable.start for variable in dae.states])]
    for block in range(round(SPAN / step / _BLOCK)):
        times = (np.arange(_BLOCK) + block * _BLOCK) * step
        rows.append(np.array(steps(rows[-1], times))[:, -1])
    return np.array(rows)
