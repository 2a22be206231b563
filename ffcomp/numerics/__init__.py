"""Signals moved in time, the one serialiser, stages of long work, and folders of caches."""
