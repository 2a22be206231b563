; A delta's RepRapFirmware configuration, made up for the start page: the parts that a machine file is made of.
M550 P"Delta of the start page"
M665 R140.000 L300.000 B130.0 H300.5
M666 X0 Y0 Z0
M350 X16 Y16 Z16 E16 I1
M92 X80 Y80 Z80 E420
M566 X600 Y600 Z600 E1200
M203 X18000 Y18000 Z18000 E7200
M201 X4000 Y4000 Z4000 E3000
M204 P4000 T4000
M593 P"mzv" F38
