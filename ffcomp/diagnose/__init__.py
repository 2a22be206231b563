"""Where simulation and measurement disagree, and which physical effect is missing.

plant      what the engine asks of a machine: recordings, numbers that may move, candidate effects, a simulation
noise      the noise floor, and the whitener that puts every signal and frequency on its scale
fit        Gauss-Newton on the whitened output error, with priors, evidence and intervals
screen     one simulation a candidate: what is it worth, and for what can it be taken
search     hypotheses: begun, refined, in another shape, with an effect more or fewer
gates      what must hold before an effect is named
engine     the whole diagnosis, step by step
outcome    a diagnosis in the terms of the machine file
picture    a diagnosis as something to look at
where      the gap by signal, frequency, place and run, without a diagnosis
intake     what runs must be
delta      the printer as a plant
axis       a force-driven axis as a plant
"""
