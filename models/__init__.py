"""What a machine is: parts, kinematics, vibrations, and the files that describe it. Knows no G-code."""
