"""How carriages move the nozzle, one file per kind of machine."""
