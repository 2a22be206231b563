"""Independent printers. `delta_plant`, `straight_plant`, `forced_axis` and `shapes` import nothing of the product."""
