"""The nonlinear virtual printer."""
