"""The report of `ffcomp compare`: a verdict in words, figures, and one HTML page that opens offline."""
