"""A run of many steps is patient alone."""

from concurrent.futures import ThreadPoolExecutor

from fmpy import sundials

from cosim.fmi.run import patient


def test_runs_in_other_threads_keep_the_usual_number_of_steps(monkeypatch):
    monkeypatch.setattr(sundials, "CVodeSolver", lambda **options: options)

    def options():
        return sundials.CVodeSolver(maxStep=0.1)

    with patient._many_steps(), ThreadPoolExecutor(1) as other:
        assert options() == {"maxStep": 0.1, "maxNumSteps": patient.PATIENT_STEPS}
        assert other.submit(options).result() == {"maxStep": 0.1}
    assert options() == {"maxStep": 0.1}
