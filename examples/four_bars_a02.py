"""IFToMM benchmark A02: N four-bar linkages in a row, which pass singular configurations.

The constraints lose rank whenever all bars lie in one line. Simulate it with projection:

    cosim simulate examples/four_bars_a02.py:build --drift-control projection

Source  Gonzalez, Dopico, Lugris, Cuadrado, Multibody System Dynamics 16, 2006.
"""

import casadi as ca
from casadi import SX

from casadi_models.dae import Model
from casadi_models.mechanics.kane import InertialTerm, Load
from casadi_models.mechanics.mechanism import mechanism

N = 2  # linkages: N + 1 cranks and N couplers, each of 1 m and 1 kg


def build():
    """Return the DAE of the joints' positions, with bars of constant length as constraints."""
    model = Model("four_bars_a02", stop_time=10.0)
    names = [f"{axis}{i}" for i in range(N + 1) for axis in "xy"]
    starts = [number for i in range(N + 1) for number in (float(i), 1.0)]
    q = ca.vertcat(
        *(model.state(n, "m", s, f"joint: {n}") for n, s in zip(names, starts, strict=True))
    )
    u, P = SX.sym("u", q.numel()), [q[2 * i : 2 * i + 2] for i in range(N + 1)]
    bars = [(ca.vertcat(i, 0), P[i]) for i in range(N + 1)] + [(P[i], P[i + 1]) for i in range(N)]
    inertias, loads, potential = [], [], SX(0)
    for ends in bars:  # slender bar: velocity of its center, and half the difference of its ends
        center, half = (ends[0] + ends[1]) / 2, (ends[1] - ends[0]) / 2
        v, w = ca.jtimes(center, q, u), ca.jtimes(half, q, u)
        inertias += [InertialTerm(v, v), InertialTerm(w, w / 3)]
        loads.append(Load(v[1], SX(-9.81)))
        potential += 9.81 * center[1]
    loops = {f"bar{i}": (ca.sumsqr(b - a) - 1) / 2 for i, (a, b) in enumerate(bars)}
    found = mechanism(model, q, u, inertias, loads, loops, speed_starts={"x0": 1.0})
    model.energies(found.kinetic_energy, potential)
    return model.freeze()
