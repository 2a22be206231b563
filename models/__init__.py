"""Machines: parts, kinematics, vibrations, and their files. No G-code here."""
