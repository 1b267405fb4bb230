"""Changes to generated C code: each exactly once, or an error that says so."""

import pytest

from cosim.codegen.casadi_patches import patched, run_time_grid, watched
from cosim.errors import UsageError

DRIVER = """static int casadi_f0(int a) {
  p.abstol = 1e-8;
  p.reltol = 1e-6;
  p.nz_err = 3;
  p.h_min = 1e-14;
  if (d->h_next < p->h_min) d->status = IVP_STEP_TOO_SMALL;
          case IVP_EVAL_RHS:
      if (d.status != IVP_SUCCESS) return 1;
}
"""


def test_tolerances_become_expressions():
    code = patched(DRIVER, "run_time_tolerances", relative="arg[2][7]", absolute="arg[2][8]")
    assert "p.reltol = arg[2][7];\n" in code
    assert "p.abstol = arg[2][8];\n" in code
    assert "1e-8" not in code
    assert "1e-6" not in code


def test_algebraic_unknowns_leave_the_error_test():
    assert "p.nz_err = 0;" in patched(DRIVER, "differential_errors")


def test_report_is_taken_before_the_driver_gives_up():
    code = watched(DRIVER)
    assert code.index("cosim_seen[i] = seen[i]") < code.index("!= IVP_SUCCESS) return 1;")
    assert "CASADI_SYMBOL_EXPORT void cosim_report(double *out)" in code


def test_run_can_be_halted_at_every_right_hand_side():
    code = watched(DRIVER)
    assert "case IVP_EVAL_RHS:\n          if (halted) return 1;" in code
    assert "SHARED void cosim_watch(int of_command)" in code


def test_smallest_step_is_what_time_resolves():
    code = patched(DRIVER, "smallest_step")
    assert "p.h_min = 1e-60;" in code
    assert "d->h_next < 2.3e-16 * fabs(d->t)" in code


def test_entry_is_flattened():
    assert patched(DRIVER, "in_one_piece").startswith(
        "__attribute__((flatten)) static int casadi_f0("
    )


@pytest.mark.parametrize("code", ["", DRIVER + DRIVER])
@pytest.mark.parametrize(
    "change",
    [
        lambda code: patched(code, "run_time_tolerances", relative="a", absolute="b"),
        lambda code: patched(code, "differential_errors"),
        watched,
        lambda code: patched(code, "in_one_piece"),
        lambda code: patched(code, "smallest_step"),
    ],
)
def test_unknown_form_of_the_driver_is_rejected(code, change):
    with pytest.raises(UsageError, match=r"casadi .* in another form .*run without compiling"):
        change(code)


def test_output_times_come_with_the_parameters():
    code = run_time_grid(LOOP, 9)
    assert "settings = arg[2] + 9" in code
    assert "for (j = 0; j*passed < points; ++j) {" in code
    assert "casadi_c5" not in code
    assert "casadi_s0" not in code
    with pytest.raises(UsageError, match="in another form"):
        run_time_grid(LOOP.replace("casadi_c5[k]", "grid[k]"), 9)


LOOP = """
  /* Initial state, parameters */
  for (j = 0; j < 2; ++j) {
    casadi_ivp_reset(&d, j ? casadi_c5[casadi_s0[j]-1] : 0., uv, j == 0);
    for (k = casadi_s0[j]; k < casadi_s0[j+1]; ++k) {
      casadi_ivp_advance(&d, casadi_c5[k], casadi_c5[casadi_s0[j+1]-1], 0);
"""
