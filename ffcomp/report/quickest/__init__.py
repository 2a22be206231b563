"""The page of a comparison at equal error: how long a print would take."""
