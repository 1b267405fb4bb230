"""Functions as C needs them."""

import casadi as ca

from cosim.codegen.functions import dense


def test_zeros_that_casadi_does_not_store_are_written():
    """What is not written would be what the memory held before."""
    x = ca.MX.sym("x", 2)
    found = dense(ca.Function("rhs", [x], [ca.MX(2, 1), x]))
    assert [found.nnz_out(i) for i in range(2)] == [2, 2]
    code = ca.CodeGenerator("rhs", {})
    code.add(found)
    assert "0." in code.dump()


def test_dense_functions_stay_as_they_are():
    x = ca.MX.sym("x", 2)
    rhs = ca.Function("rhs", [x], [ca.sin(x)])
    assert dense(rhs) is rhs
