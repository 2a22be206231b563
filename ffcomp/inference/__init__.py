"""One engine that estimates: a problem, one fit, one covariance and one noise model for every kind of measurement.

    Observation ─┐
    Unknown ─────┴─ EstimationProblem ── fit ── FitResult (values, covariance, evidence, status, history)

`ffcomp.estimate` and `ffcomp.estimation` are something else: the time that a print takes.
"""
