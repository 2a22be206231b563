"""Kinematics: one file per kind of machine."""
