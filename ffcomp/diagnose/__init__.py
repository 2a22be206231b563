"""Find where simulation and measurement disagree, and which physical effect is missing.

Stages, each a module that knows only the ones before it:

problem        interface to a machine: observations, parameters, candidate effects, simulation
               (printer_problem: a printer; axis_problem: one axis by itself; problems: the one that belongs
               to a machine file; validation: checks of recordings;
               observe: recordings as they are compared; excerpts: the parts of them in which effects are searched;
               excerpt_fits: fits that move between them and the whole)
noise          noise floor, and the whitener that puts every signal and frequency on its scale
estimation     parameter values in, whitened residual out
fit            fit parameters with priors; evidence and covariance (intervals: 90 % intervals)
score_test     screen candidates: one simulation each
progress       what a search says while it works
hypotheses     effects with all parameters fitted, and how hypotheses are compared
initial_fits   from promising candidates to quick fits
refinement     continue, refit and refine one hypothesis; converge on the shapes of its effects
               (beginnings: fits that go from the motions' beginnings to their ends)
parsimony      fewer effects, fewer parameters, where more are not significant
selection      the passes that lead to the best hypothesis
acceptance     tests before an effect is named (confounding: effects that it could be as well)
diagnosis      all stages together

Results: result (in the terms of the machine file), summary (for reports), residuals (where the residual is, without a
diagnosis), next_experiment (which move separates what is still in question), separating_moves and separation (which
recording of `ffcomp record plan` tells explanations apart that fit equally).
"""
