"""Hidden printers with straight axes: bed slingers and CoreXY, with equations of their own."""
