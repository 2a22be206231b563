"""Definitions of the report's terms."""

from __future__ import annotations

GLOSSARY = {
    "contour error": "Distance from the nozzle to the nearest point of the reference path (its straight segments, not "
    "sampled points) among those due within 50 ms. It is what a print shows: being late on the path costs nothing.",
    "tracking error": "Distance from the nozzle to where it should be at that moment. It counts delay, which a print "
    "does not show as long as it is constant; “no delay” takes out the constant delay that explains most of it.",
    "where plastic flows": "Samples in moves that extrude. Travel moves count only under “all moves”.",
    "rms, 99 %, max": "Root mean square over time; the value that 99 % of the time stays below; the largest value.",
    "residual ringing": "Rms of the error where the reference motion is a straight line at constant speed or "
    "rest, about its mean in each such interval.",
    "carriage peaks": "Largest speed and acceleration commanded of any carriage, as differences over 4 ms, the time of "
    "one written segment. Speed and acceleration of the command, not of the vibrating machine.",
    "best fixed": "For each kind of shaper the frequencies and damping ratio with the least contour error on this very "
    "print, sought with the virtual printer known. No owner can tune this well: it is the fairest rival.",
    "calibrated": "What Klipper's resonance test at the middle of the bed would choose on this virtual printer.",
    "scheduled": "A shaper whose frequency follows the resonance at each position on the bed. No firmware has that; "
    "Marlin's can follow the height or the mass that was printed.",
    "Monte-Carlo plants": "Printers whose masses, stiffnesses, dampings and drives are all off by random shares, "
    "unknown to every method; “tuned again” is the best fixed shaper with its frequencies sought anew on each of them.",
    "equal quality": "Every move of the print is planned with one acceleration, raised until 1 % of the contour error "
    "exceeds the bound or a carriage exceeds its limits. Sought on half a minute of the print.",
    "virtual printer": "A nonlinear simulation of the printer named under “evaluated on”, apart from the model "
    "that the inversion uses. It knows nothing of plastic, heat, or loose screws.",
}
