"""Find where simulation and measurement disagree, and which physical effect is missing.

Each module knows only the ones before it:

problem        the interface to a machine: observations, parameters, candidate effects, simulation
candidates     the catalogue's effects as candidates, and their numbers as tables of a machine file
printer_problem, axis_problem    a printer, and one axis by itself
problems       the one that a machine file describes; checks of its recordings
observations   recordings prepared for comparison, and excerpts
noise          the noise floor, and the whitener that puts every signal and frequency on its scale
settings       the numbers of the search
fit            parameter values in, whitened residual out; fits with priors, their evidence and intervals
score_test     screen candidates: one simulation each
hypotheses     effects with all parameters fitted, and how hypotheses are compared
fidelity       full fits, exact fits, and excerpts of the recordings
trace          every fit and decision of a search
search         the beam search over hypotheses
acceptance, dominance    tests before an effect is named, alone or with a rest
diagnosis      all stages together
request, verb  the options of `gap` and `diagnose`; from files to answers

Recordings: recording_clocks (repeats and delays), recording_faults (what makes a search pointless).

Results: where and gap (where the residual is), next_experiment (which recording of `ffcomp record plan` separates
explanations), result (in the terms of the machine file), sentences (in words). `identify update` is in update.
"""
