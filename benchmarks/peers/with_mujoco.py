"""MuJoCo: `mj_forward`, two ball joints; contacts, constraints, actuators, sensors switched off.

A call computes poses, composite inertias and their factors, bias forces and accelerations.
"""

import ctypes
import tempfile
from collections.abc import Iterator
from pathlib import Path

import mujoco as mj
import numpy as np
from chain import chain
from entries import Evaluation
from problem import Problem

from cosim.codegen.compiler import compile_library

PACKAGES = ("mujoco",)
LOOP = """
#include <string.h>
typedef void Forward(const void *model, void *data);
void loop(Forward *forward, const void *model, void *data, double *qpos, double *qvel,
          const double *qacc, long long count, const double *q, const double *v, double *a) {
    for (long long i = 0; i < count; ++i) {
        memcpy(qpos, q + 8 * i, 8 * sizeof *q);
        memcpy(qvel, v + 6 * i, 6 * sizeof *v);
        forward(model, data);
        memcpy(a + 6 * i, qacc, 6 * sizeof *a);
    }
}
"""
OFF = ("contact", "constraint", "actuation", "sensor", "equality", "limit", "frictionloss")


def accelerations(problem: Problem) -> Iterator[Evaluation]:
    known = chain(problem)
    moments = " ".join(map(repr, known.moments.tolist()))
    body = '<body pos="0 0 {!r}"><joint type="ball"/><inertial pos="0 0 {!r}" mass="{!r}" '
    body += f'diaginertia="{moments}"/>'
    half = -known.length / 2
    links = body.format(0.0, half, known.m) + body.format(-known.length, half, known.m)
    flags = " ".join(f'{name}="disable"' for name in OFF)
    option = f'<option gravity="0 0 {-known.g!r}"><flag {flags}/></option>'
    world = f"<worldbody>{links}</body></body></worldbody>"
    model = mj.MjModel.from_xml_string(f"<mujoco>{option}{world}</mujoco>")
    data = mj.MjData(model)
    q, v = np.ascontiguousarray(known.quaternions), np.ascontiguousarray(known.rates)
    results = np.empty_like(v)
    (library,) = Path(mj.__file__).parent.glob("libmujoco.*")
    forward = ctypes.cast(ctypes.CDLL(str(library)).mj_forward, ctypes.c_void_p)
    with tempfile.TemporaryDirectory() as folder:
        code = Path(folder) / "loop.c"
        code.write_text(LOOP)
        loop = ctypes.CDLL(str(compile_library([code], code.with_suffix(".so")))).loop
    memory = [forward.value, model._address, data._address]
    memory += [array.ctypes.data for array in (data.qpos, data.qvel, data.qacc)]
    count = ctypes.c_longlong(len(q))
    arrays = [array.ctypes.data for array in (q, v, results)]
    arguments = (*map(ctypes.c_void_p, memory), count, *map(ctypes.c_void_p, arrays))
    loop(*arguments)
    print(f"MuJoCo: {known.difference(results):.0e} from the equations")
    yield Evaluation(
        "MuJoCo mj_forward", lambda: loop(*arguments), len(q), held=(model, data, q, v, results)
    )
    yield Evaluation("MuJoCo mj_forward", lambda: mj.mj_forward(model, data), one=True)
