"""The report of `ffcomp diagnose`: what is missing, where it shows, what speaks for it, and what to measure next."""
