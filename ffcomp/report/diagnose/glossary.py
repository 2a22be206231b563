"""What the words of the report mean, exactly."""

from __future__ import annotations

GLOSSARY = {
    "error": "Measured less simulated, inside the band that is compared. Before: with the machine file as it is; "
    "after: with the effects and retuned numbers of the best explanation.",
    "% off": "Root of the summed squares of the error by that of what was measured, all signals of all runs (nrms).",
    "noise": "What differs between two runs of the same experiment: at each frequency, for each signal. An error of 1 "
    "times the noise is noise.",
    "excess": "Mean square of the error in units of the noise, less one: 0 is noise alone, 3 an error twice the noise. "
    "Shares of the excess are shares of this, weighed by how much was compared.",
    "retuning": "Moving the file's own numbers within the uncertainty it states. What that explains is no missing "
    "effect.",
    "−2 ln Z": "Evidence: how badly a hypothesis fits plus what its numbers cost. 10 less is strong, 30 practically "
    "certain, as far as errors are noise; real effects never match the model exactly, so it is not the only test.",
    "left out of the fit": "Each position in turn: all parameters are fitted to the runs at the other positions, then "
    "this position is simulated. An effect that only bends the curves to fit fails here.",
    "90 %": "The interval in which the value lies with 90 % probability if the effect is of the kind named.",
    "cos²": "Of the angle between what two effects do to these very runs, less what retuning can do: 1 if one can be "
    "taken for the other, 0 if they have nothing in common.",
    "visible": "An effect of a usual size would stand 3 standard deviations out of the noise in these runs.",
}
